"""Readers of calibration data: penetration tests, strength factors at several oblique angles, and motions of runs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.readers.dyna import (
    NODOUT_MARK,
    RBDOUT_MARK,
    CoordinateAxis,
    States,
    along,
    is_binout,
    read_binout,
    read_nodout,
    read_rbdout,
)
from service.readers.files import FileError, Readings, lines_of, read_bytes
from service.readers.table import (
    ANGLE,
    ANGULAR_VELOCITY,
    LENGTH,
    MASS,
    PURE,
    SPEED,
    TIME,
    Quantity,
    UnknownUnitError,
    factor_to_si,
    read_columns,
    read_table,
)
from service.readers.workbook import is_workbook, sheet_as_csv
from solver import Impact, Projectile, Shot
from solver.arrays import FloatArray
from solver.calibration import DepthTest, MotionHistory, ObliquityPoint
from solver.checks import BOUNDS

VELOCITY_NAMES = ("striking_velocity", "impact_velocity", "speed", "impact_speed", "striking_speed")
TEST_NUMBERS = (
    Quantity("velocity", SPEED, (*VELOCITY_NAMES, "v", "v0", "vs"), required=True),
    Quantity("depth", LENGTH, ("penetration_depth", "depth_of_penetration", "penetration", "p"), required=True),
    Quantity("mass", MASS, ("projectile_mass",)),
    Quantity("weight", PURE),
)
SHOT_NUMBERS = (*TEST_NUMBERS[:3], Quantity("diameter", LENGTH, ("projectile_diameter", "caliber", "calibre")))
GROUP = Quantity("group", None, required=True)
DEPTH_TESTS = (*TEST_NUMBERS, GROUP)
SI_UNIT = {
    "velocity": "m/s",
    "depth": "m",
    "mass": "kg",
    "diameter": "m",
    "time": "s",
    "depth_displacement": "m",
    "lateral_displacement": "m",
    "rotation": "rad",
}
ANGLE_NAMES = ("obliquity", "angle_of_incidence", "incidence")
OBLIQUITY_POINTS = (
    Quantity("oblique_angle", ANGLE, ANGLE_NAMES, required=True),
    Quantity("strength_factor", PURE, required=True),
    Quantity("standard_error", PURE),
)
MAX_VELOCITY = BOUNDS["impact.velocity"].upper
MAX_DIAMETERS = 1000.0
"""Largest plausible ratio of depth to diameter, and of diameter to depth [1]. Long rods at any speed stay below 100;
depths in a wrong unit are mostly off by a factor of 1000."""
FILE = Quantity("file", None, ("history",), required=True)
MOTION_RUNS = (
    FILE,
    Quantity("oblique_angle", ANGLE, ANGLE_NAMES),
    Quantity("velocity", SPEED, VELOCITY_NAMES),
    Quantity("angle_of_attack", ANGLE),
    Quantity("angular_velocity", ANGULAR_VELOCITY),
    Quantity("until", TIME),
)
RUN_UNITS = {"velocity": "m/s", "until": "s", "oblique_angle": "rad"}


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
        Headers by quantity, for columns that are not named after their quantity.
    units
        Units by quantity, for headers without a unit; the default is SI.
    diameter
        Diameter of the projectile. Depths that are implausible for it are refused. [m]
    grouped
        True if a column names the group of each test.

    Raises
    ------
    FileError
        If the file is not a valid table of two tests or more; the error names the line.
    """
    quantities = (*TEST_NUMBERS, GROUP) if grouped else TEST_NUMBERS
    readings, text = read_columns(read_table(path), quantities, columns or {}, units or {})
    _check_depth_tests(readings, diameter)
    groups = text.get(GROUP.name, [None] * readings.rows)
    return [DepthTest(**numbers, group=group) for numbers, group in zip(readings.each_row(), groups, strict=True)]


def read_shots(path: str | Path) -> list[Shot]:
    """Read the user's own shots: velocity, depth and, if there are such columns, mass and diameter.

    Raises
    ------
    FileError
        If the file is not a valid table of shots; the error names the line.
    """
    readings, _ = read_columns(read_table(path), SHOT_NUMBERS, {}, {})
    readings.require_rows(1)
    for name, column in readings.values.items():
        readings.require(name, column > 0.0, "must be greater than 0", SI_UNIT[name])
    return [Shot(**numbers) for numbers in readings.each_row()]


def read_obliquity_points(
    path: str | Path, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> list[ObliquityPoint]:
    """Read strength factors at several oblique angles and, if there is such a column, their standard errors.

    Parameters
    ----------
    columns, units
        Columns and units, as for `read_depth_tests`.

    Raises
    ------
    FileError
        If the file is not a valid table of points; the error names the line.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionRunRow:
    """A row of a table of runs, which gives the history of a run and its impact.

    Parameters
    ----------
    name
        Path of the history as written in the table.
    file
        Path of the history; relative paths are resolved from the folder of the table.
    line
        Line of the table.
    impact
        Quantities of the impact in the table, by name. [m/s, rad, rad/s]
    until
        End of the fitted part, if the table gives one. [s]
    """

    name: str
    file: Path
    line: int
    impact: Mapping[str, float]
    until: float | None


def read_motion_runs(path: str | Path) -> list[MotionRunRow]:
    """Read a table of runs: the file of each and, if there are such columns, its impact and the end of the fit.

    Raises
    ------
    FileError
        If the file is not a valid table of runs; the error names the line.
    """
    table = read_table(path)
    readings, text = read_columns(table, MOTION_RUNS, {}, {})
    for name, column in readings.values.items():
        if name in ("velocity", "until"):
            readings.require(name, column > 0.0, "must be greater than 0", RUN_UNITS[name])
        if name == "oblique_angle":
            inside = (column >= 0.0) & (column < math.pi / 2.0)
            readings.require(name, inside, "must be from 0° to less than 90° from the normal (wrong unit?)", "rad")
    numbers = readings.each_row() if readings.values else [{} for _ in table.rows]
    rows = []
    for name, line, values in zip(text[FILE.name], table.lines, numbers, strict=True):
        impact = dict(values)
        until = impact.pop("until", None)
        rows.append(MotionRunRow(name=name, file=Path(path).parent / name, line=line, impact=impact, until=until))
    return rows


MOTION = (
    Quantity("time", TIME, required=True),
    Quantity("depth_displacement", LENGTH),
    Quantity("lateral_displacement", LENGTH),
    Quantity("rotation", ANGLE),
)
MAX_SPEED_RATIO, MIN_SPEED_RATIO = 1.5, 0.1
"""Largest plausible mean speed up to any row, and smallest one up to half of the displacement, relative to the initial
speed [1]. The values are arbitrary; they are wide apart, because wrong units are mostly off by a factor of 1000."""

ROTATION_SCATTER = math.radians(5.0)
"""Allowance for the scatter of measured rotations, an arbitrary choice. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Impact against which a history is checked for plausibility."""

    impact: Impact
    projectile: Projectile


def read_motion(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    axes: Mapping[str, CoordinateAxis] | None = None,
    part: int | None = None,
    node: int | None = None,
    contact: float | None = None,
    expected: Expected | None = None,
) -> MotionHistory:
    """Read the motion of a centre of gravity since first contact.

    The format is recognized by the content: LS-DYNA's rbdout, nodout or binary binout, otherwise CSV.

    Parameters
    ----------
    columns
        CSV: headers by quantity, for columns that are not named after their quantity.
    units
        Units by quantity, for LS-DYNA files, which have none, and for CSV headers without a unit; the default is SI.
    axes
        LS-DYNA: global axis of each quantity. Quantities without an axis are left out.
    part, node
        LS-DYNA: the rigid body or the node to read, if there are several.
    contact
        Time of first contact in the file. Earlier rows are left out, and time and displacements are measured from it.
        By default LS-DYNA files are measured from their first state, and CSV files are read unchanged. [s]
    expected
        Impact of the run. A motion that is implausible after it is refused.

    Returns
    -------
    MotionHistory

    Raises
    ------
    FileError
        If the file does not hold a valid history; the error names the line or, in a binary file, the state.
    """
    content = sheet_as_csv(path) if is_workbook(path) else read_bytes(path)
    states = _read_dyna(path, content, part, node)
    if states is not None:
        if columns:
            raise FileError(path, "only CSV files have columns; name axes instead")
        readings = _to_si(along(states, axes or {}), units or {})
        contact = float(readings.values["time"][0]) if contact is None else contact
    else:
        if axes or part is not None or node is not None:
            raise FileError(path, "a CSV file has no axes, parts or nodes; name columns instead")
        table = read_table(path, content)
        readings, _ = read_columns(table, MOTION, columns or {}, units or {})
        if readings.values.keys() == {"time"}:
            raise FileError(path, f"no column of {', '.join(q.name for q in MOTION[1:])}", table.header_line)
    _check_rows(readings, contact)
    if contact is not None:
        readings = _since(readings, contact)
    if expected is not None:
        _check_speed(readings, expected)
    return MotionHistory(**readings.values)


def _read_dyna(path: str | Path, content: bytes, part: int | None, node: int | None) -> States | None:
    """Return the states of an LS-DYNA file; None for a file of another format."""
    if is_binout(content):
        return read_binout(path, content, part, node)
    if RBDOUT_MARK.encode() in content:
        return read_rbdout(path, lines_of(path, content, strict=False), part)
    if NODOUT_MARK.encode() in content:
        return read_nodout(path, lines_of(path, content, strict=False), node)
    return None


def _to_si(readings: Readings, units: Mapping[str, str]) -> Readings:
    """Convert columns from the units of a finite element model to SI."""
    try:
        factors = {q.name: factor_to_si(q, units[q.name]) for q in MOTION if q.name in units}
    except UnknownUnitError as error:
        raise FileError(readings.path, str(error)) from None
    return replace(readings, values={name: factors.get(name, 1.0) * column for name, column in readings.values.items()})


def _check_rows(readings: Readings, contact: float | None) -> None:
    readings.require_rows(2)
    for name, column in readings.values.items():
        readings.require(name, np.isfinite(column), "must be a finite number", SI_UNIT[name])
    time = readings.values["time"]
    if contact is None:
        readings.require("time", time >= 0.0, "must be at least 0, first contact (or set the time of contact)", "s")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        row = int(late[0]) + 1
        raise readings.error(row, f"time must increase from row to row, got {time[row]:g} s after {time[row - 1]:g} s")


def _since(readings: Readings, contact: float) -> Readings:
    """Return the columns with all quantities measured from first contact, which may lie between two rows."""
    time = readings.values["time"]
    if not time[0] <= contact < time[-1]:
        raise FileError(
            readings.path, f"the contact, {contact:g} s, must be from {time[0]:g} s on and before {time[-1]:g} s"
        )
    first = int(np.searchsorted(time, contact, side="right"))
    values = {
        name: np.concatenate(([0.0], column[first:] - np.interp(contact, time, column)))
        for name, column in readings.values.items()
    }
    lines = None if readings.lines is None else [readings.lines[first - 1], *readings.lines[first:]]
    return replace(readings, values=values, lines=lines)


def _check_speed(readings: Readings, expected: Expected) -> None:
    """Raise an error if a motion is implausible after an impact at this speed, most likely because of a wrong unit."""
    time, impact = readings.values["time"], expected.impact
    free = impact.velocity * time
    share = {
        "depth_displacement": math.cos(impact.oblique_angle),
        "lateral_displacement": math.sin(impact.oblique_angle),
    }
    for name in share.keys() & readings.values.keys():
        way = abs(readings.values[name])
        _refuse(readings, way > MAX_SPEED_RATIO * free + 0.5 * expected.projectile.diameter, name, "more", impact)
        most = MAX_SPEED_RATIO * impact.velocity * np.diff(time) + 0.5 * expected.projectile.diameter
        _refuse_step(readings, most, name, impact)
        # The lower bound is checked at half of the displacement only: afterwards the projectile may be slow or at rest
        # for most of the time.
        half = np.arange(len(time)) == (int(np.argmax(way >= 0.5 * way.max())) if way.any() else len(time) - 1)
        _refuse(readings, half & (way < MIN_SPEED_RATIO * share[name] * free), name, "much less", impact)
    if "rotation" in readings.values:
        turned = abs(readings.values["rotation"])
        rate = MAX_SPEED_RATIO * impact.velocity / (0.5 * expected.projectile.length) + abs(impact.angular_velocity)
        most = rate * time + ROTATION_SCATTER
        _refuse(readings, turned > most, "rotation", "more", impact)
        _refuse_step(readings, rate * np.diff(time) + ROTATION_SCATTER, "rotation", impact)


def _refuse_step(readings: Readings, most: FloatArray, name: str, impact: Impact) -> None:
    """Raise an error for the first step between two rows that exceeds its largest plausible value.

    The likely causes are missing rows, rows of another run, and an angle that wraps around after a full turn.
    """
    column, time = readings.values[name], readings.values["time"]
    rows = np.flatnonzero(abs(np.diff(column)) > most)
    if rows.size:
        row = int(rows[0]) + 1
        raise readings.error(
            row,
            f"{name} goes from {column[row - 1]:.4g} to {column[row]:.4g} {SI_UNIT[name]} within "
            f"{time[row] - time[row - 1]:.4g} s, more than possible after an impact at {impact.velocity:g} m/s "
            "(a row of another run, or an angle beyond a turn?)",
        )


def _refuse(readings: Readings, refused: NDArray[np.bool_], name: str, more: str, impact: Impact) -> None:
    rows = np.flatnonzero(refused)
    if rows.size:
        value, time = readings.values[name][rows[0]], readings.values["time"][rows[0]]
        raise readings.error(
            int(rows[0]),
            f"{name} of {value:.4g} {SI_UNIT[name]} after {time:.4g} s is {more} than possible after an impact at "
            f"{impact.velocity:g} m/s (wrong unit?)",
        )
