"""Depth tests and strength factors by oblique angle, from CSV files."""

import math
from collections.abc import Mapping
from pathlib import Path

from service.readers.readings import Readings
from service.readers.table import read_columns, read_table
from service.readers.units import ANGLE, LENGTH, MASS, PURE, SPEED, Quantity
from solver.calibration import DepthTest, ObliquityPoint

NUMBERS_OF_A_TEST = (
    Quantity("velocity", SPEED, ("striking_velocity", "impact_velocity"), required=True),
    Quantity("depth", LENGTH, ("penetration_depth",), required=True),
    Quantity("mass", MASS),
    Quantity("weight", PURE),
)
GROUP = Quantity("group", None, required=True)
DEPTH_TESTS = (*NUMBERS_OF_A_TEST, GROUP)
SI_UNIT = {"velocity": "m/s", "depth": "m", "mass": "kg"}
OBLIQUITY_POINTS = (
    Quantity("oblique_angle", ANGLE, required=True),
    Quantity("strength_factor", PURE, required=True),
    Quantity("standard_error", PURE),
)
MOST_VELOCITY = 1e4  # m/s, far above what any body survives
MOST_DIAMETERS = 1000.0  # of depth; long rods at any speed stay below 100


def read_depth_tests(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    diameter: float | None = None,
    grouped: bool = False,
) -> list[DepthTest]:
    """Read depth tests: velocity, depth and, where there are such columns, mass and weight.

    Parameters
    ----------
    columns
        Header by quantity, where a column is not named as the quantity is.
    units
        Unit by quantity, where the header gives none; SI if neither does.
    diameter
        Of the projectile, to tell depths that cannot be meant. [m]
    grouped
        Whether the tests are of groups; then there must be a column that names them.

    Raises
    ------
    FileError
        With the line, if the file does not hold such tests.
    """
    quantities = (*NUMBERS_OF_A_TEST, GROUP) if grouped else NUMBERS_OF_A_TEST
    readings, text = read_columns(read_table(path), quantities, columns or {}, units or {})
    _check_depth_tests(readings, diameter)
    groups = text.get(GROUP.name, [None] * readings.rows)
    return [DepthTest(**numbers, group=group) for numbers, group in zip(readings.each_row(), groups, strict=True)]


def read_obliquity_points(
    path: str | Path, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> list[ObliquityPoint]:
    """Read strength factors by oblique angle and, where there is such a column, their standard errors.

    Parameters
    ----------
    columns, units
        As for `read_depth_tests`.

    Raises
    ------
    FileError
        With the line, if the file does not hold such points.
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
        velocity <= MOST_VELOCITY,
        f"is above {MOST_VELOCITY / 1e3:g} km/s (wrong unit?)",
        SI_UNIT["velocity"],
    )
    if diameter is not None:
        most = MOST_DIAMETERS * diameter
        readings.require("depth", depth <= most, f"is above {MOST_DIAMETERS:g} diameters (wrong unit?)", "m")
        least = diameter / MOST_DIAMETERS
        readings.require("depth", depth >= least, f"is below a diameter over {MOST_DIAMETERS:g} (wrong unit?)", "m")
