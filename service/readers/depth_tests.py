"""Penetration tests, and strength factors over the oblique angle, from CSV files."""

import math
from collections.abc import Mapping
from pathlib import Path

from service.readers.files import Readings
from service.readers.table import ANGLE, LENGTH, MASS, PURE, SPEED, Quantity, read_columns, read_table
from solver.calibration import DepthTest, ObliquityPoint

TEST_NUMBERS = (
    Quantity("velocity", SPEED, ("striking_velocity", "impact_velocity"), required=True),
    Quantity("depth", LENGTH, ("penetration_depth",), required=True),
    Quantity("mass", MASS),
    Quantity("weight", PURE),
)
GROUP = Quantity("group", None, required=True)
DEPTH_TESTS = (*TEST_NUMBERS, GROUP)
SI_UNIT = {"velocity": "m/s", "depth": "m", "mass": "kg"}
OBLIQUITY_POINTS = (
    Quantity("oblique_angle", ANGLE, required=True),
    Quantity("strength_factor", PURE, required=True),
    Quantity("standard_error", PURE),
)
MAX_VELOCITY = 1e4
"""Far above what any projectile survives. [m/s]"""
MAX_DIAMETERS = 1000.0
"""Depth over diameter; long rods at any speed stay below 100. [1]"""


def read_depth_tests(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    diameter: float | None = None,
    grouped: bool = False,
) -> list[DepthTest]:
    """Read penetration tests: velocity, depth and, if there are such columns, mass and weight.

    Parameters
    ----------
    columns
        Header by quantity, if a column is not named as the quantity.
    units
        Unit by quantity, if the header has none; the default is SI.
    diameter
        Diameter of the projectile, to find implausible depths. [m]
    grouped
        Whether a column names the group of each test.

    Raises
    ------
    FileError
        With the line, if the file holds no such tests.
    """
    quantities = (*TEST_NUMBERS, GROUP) if grouped else TEST_NUMBERS
    readings, text = read_columns(read_table(path), quantities, columns or {}, units or {})
    _check_depth_tests(readings, diameter)
    groups = text.get(GROUP.name, [None] * readings.rows)
    return [DepthTest(**numbers, group=group) for numbers, group in zip(readings.each_row(), groups, strict=True)]


def read_obliquity_points(
    path: str | Path, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> list[ObliquityPoint]:
    """Read strength factors over the oblique angle and, if there is such a column, their standard errors.

    Parameters
    ----------
    columns, units
        Columns and units, as for `read_depth_tests`.

    Raises
    ------
    FileError
        With the line, if the file holds no such points.
    """
    readings, _ = read_columns(read_table(path), OBLIQUITY_POINTS, columns or {}, units or {})
    angles = readings.values["oblique_angle"]
    readings.require(
        "oblique_angle", abs(angles) < math.pi / 2.0, "must be less than 90° from the normal (wrong unit?)", "rad"
    )
    for name in readings.values.keys() - {"oblique_angle"}:
        readings.require(name, readings.values[name] > 0.0, "must be greater than 0", "")
    return [ObliquityPoint(**numbers) for numbers in readings.each_row()]


def _check_depth_tests(readings: Readings, diameter: float | None) -> None:
    readings.require_rows(2)
    for name in readings.values:
        readings.require(name, readings.values[name] > 0.0, "must be greater than 0", SI_UNIT.get(name, ""))
    velocity, depth = readings.values["velocity"], readings.values["depth"]
    readings.require(
        "velocity",
        velocity <= MAX_VELOCITY,
        f"is above {MAX_VELOCITY / 1e3:g} km/s (wrong unit?)",
        SI_UNIT["velocity"],
    )
    if diameter is not None:
        most = MAX_DIAMETERS * diameter
        readings.require("depth", depth <= most, f"is above {MAX_DIAMETERS:g} diameters (wrong unit?)", "m")
        least = diameter / MAX_DIAMETERS
        readings.require("depth", depth >= least, f"is below a diameter over {MAX_DIAMETERS:g} (wrong unit?)", "m")
