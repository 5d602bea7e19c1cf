"""Titles of sweeps: what varies, and the projectile."""

import re
from collections.abc import Mapping
from typing import Any

from service.jobs.models import StoredSweep

NAMES = {
    "impact.velocity_m_s": "speed",
    "impact.oblique_angle_deg": "angle",
    "target.compressive_strength_pa": "strength",
}
"""Shorter than what the contract says of a field; the others are named as there, without the unit."""
UNIT = re.compile(r"_(?:m_s|rad_s|kg_m2|kg_m3|kg|pa|deg|m|s)$")
PROJECTILE = {"diameter_m": (1e3, "mm"), "mass_kg": (1.0, "kg")}


def title_of(sweep: StoredSweep) -> str:
    """Return the title of a sweep that has been given none."""
    varied = " × ".join(map(name_of, sweep.fields))
    projectile = sweep.request["base"].get("projectile", {})
    fixed = {name: unit for name, unit in PROJECTILE.items() if f"projectile.{name}" not in sweep.fields}
    return ", ".join([varied, *(shown(projectile, name, *unit) for name, unit in fixed.items() if name in projectile)])


def name_of(field: str) -> str:
    """Return a field in words."""
    return NAMES.get(field) or UNIT.sub("", field.rpartition(".")[2]).replace("_", " ")


def shown(part: Mapping[str, Any], name: str, factor: float, unit: str) -> str:
    """Return a value with its unit."""
    return f"{part[name] * factor:.4g} {unit}"
