"""The one line that a table has for an answer: its numbers without lists."""

from collections.abc import Mapping
from typing import Any

FINAL = (
    "time_s",
    "center_of_gravity_depth_m",
    "center_of_gravity_lateral_m",
    "nose_tip_depth_m",
    "axis_angle_deg",
    "depth_velocity_m_s",
    "lateral_velocity_m_s",
    "angular_velocity_rad_s",
    "depth_force_n",
    "lateral_force_n",
    "moment_n_m",
    "kinetic_energy_j",
)
SCALARS: Mapping[str, tuple[str, ...]] = {
    "trajectory": ("outcome", "maximum_depth_m", "strength_factor", *(f"final_{name}" for name in FINAL)),
    "cra": (
        "status",
        "critical_angle_deg",
        "bracket_low_deg",
        "bracket_high_deg",
        "critical_angle_standard_error_deg",
        "strength_factor",
    ),
}
"""Columns of the table of an operation, between what names the case and what is to be said of it."""


def scalars_of(operation: str, answer: Mapping[str, Any]) -> list[Any]:
    """Return the values of these columns, empty where the answer has none."""
    values = dict(answer)
    if operation == "cra":
        values |= zip(("bracket_low_deg", "bracket_high_deg"), answer.get("bracket_deg", ()), strict=False)
    else:
        values |= {f"final_{name}": value for name, value in answer["final"].items()}
    return [values.get(name, "") for name in SCALARS[operation]]


def codes_of(answer: Mapping[str, Any]) -> str:
    """Return the codes of the warnings, with blanks between them."""
    return " ".join(warning["code"] for warning in answer["warnings"])
