"""Titles of sweeps: what varies, and the projectile."""

from collections.abc import Mapping
from typing import Any

from service.jobs.models import StoredSweep
from service.names import QUANTITIES, TITLES, named

PROJECTILE = {"diameter_m": (1e3, "mm"), "mass_kg": (1.0, "kg")}


def title_of(sweep: StoredSweep) -> str:
    """Return the title of a sweep that has been given none."""
    varied = " × ".join(map(name_of, sweep.fields))
    projectile = sweep.request["base"].get("projectile", {})
    fixed = {name: unit for name, unit in PROJECTILE.items() if f"projectile.{name}" not in sweep.fields}
    return ", ".join([varied, *(shown(projectile, name, *unit) for name, unit in fixed.items() if name in projectile)])


def name_of(field: str) -> str:
    """Return a field in words."""
    return TITLES.get(field) or named(QUANTITIES, field).lower()


def shown(part: Mapping[str, Any], name: str, factor: float, unit: str) -> str:
    """Return a value with its unit."""
    return f"{part[name] * factor:.4g} {unit}"
