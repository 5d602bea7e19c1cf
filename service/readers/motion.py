"""Motion histories, whatever the program that wrote them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.readers import nodout, rbdout
from service.readers.axes import Axis, States, along
from service.readers.binout import read_binout
from service.readers.errors import FileError
from service.readers.lsda import is_lsda
from service.readers.nodout import read_nodout
from service.readers.rbdout import read_rbdout
from service.readers.readings import Readings
from service.readers.table import read_columns, read_table
from service.readers.text import lines_of, read_bytes
from service.readers.units import ANGLE, LENGTH, TIME, Quantity, UnknownUnitError, factor_to_si
from solver import Impact, Projectile
from solver.calibration import MotionHistory

MOTION = (
    Quantity("time", TIME, required=True),
    Quantity("depth_displacement", LENGTH),
    Quantity("lateral_displacement", LENGTH),
    Quantity("rotation", ANGLE),
)
SI_UNIT = {"time": "s", "depth_displacement": "m", "lateral_displacement": "m", "rotation": "rad"}
MOST_SPEED, LEAST_SPEED = 1.5, 0.1
"""Over the initial one, on the first half of the way; a wrong unit is mostly a factor of 1000."""

MOST_FIRST_TURN = math.radians(5.0)
"""Of the rotation, for the scatter of measured ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """The strike that a history should be of, to tell one that cannot be meant."""

    impact: Impact
    projectile: Projectile


def read_motion(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    axes: Mapping[str, Axis] | None = None,
    part: int | None = None,
    node: int | None = None,
    contact: float | None = None,
    expected: Expected | None = None,
) -> MotionHistory:
    """Read the motion of a centre of gravity since first contact.

    The file tells its format: LS-DYNA's rbdout, nodout and binary binout, or else CSV.

    Parameters
    ----------
    columns
        Of a CSV file: header by quantity, where a column is not named as the quantity is.
    units
        Unit by quantity, where the header of a CSV file gives none; SI if neither does. LS-DYNA's files never do.
    axes
        Of LS-DYNA's files: global axis by quantity. What has no axis is left out.
    part, node
        Of LS-DYNA's files: the rigid body or the node to read, where there are several.
    contact
        Time of first contact in the file. What is before is left out, and time and displacements count from there;
        not given, LS-DYNA's files count from their first state, and CSV files are taken as they are. [s]
    expected
        The strike, to refuse histories that cannot be of it.

    Returns
    -------
    MotionHistory

    Raises
    ------
    FileError
        With the line, if the file does not hold such a history.
    """
    content = read_bytes(path)
    states = _read_dyna(path, content, part, node)
    if states is not None:
        if columns:
            raise FileError(path, "only CSV files have columns to name: give axes")
        readings = _to_si(along(states, axes or {}), units or {})
        contact = float(readings.values["time"][0]) if contact is None else contact
    else:
        if axes or part is not None or node is not None:
            raise FileError(path, "a CSV file has no axes, parts or nodes to choose: name its columns")
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
    """Return the states of one of LS-DYNA's files, None if it is none."""
    if is_lsda(content):
        return read_binout(path, content, part, node)
    if rbdout.MARK.encode() in content:
        return read_rbdout(path, lines_of(path, content, strict=False), part)
    if nodout.MARK.encode() in content:
        return read_nodout(path, lines_of(path, content, strict=False), node)
    return None


def _to_si(readings: Readings, units: Mapping[str, str]) -> Readings:
    """Convert from the units of a model."""
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
        readings.require("time", time >= 0.0, "must be at least 0, first contact (name its time otherwise)", "s")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        row = int(late[0]) + 1
        raise readings.error(row, f"time must rise from row to row, got {time[row]:g} s after {time[row - 1]:g} s")


def _since(readings: Readings, contact: float) -> Readings:
    """Count time and displacements from first contact, which may lie between two rows."""
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
    """Refuse a motion that is far from the speed of the strike: its units are wrong, most likely."""
    time, strike = readings.values["time"], expected.impact
    free = strike.velocity * time
    share = {
        "depth_displacement": math.cos(strike.oblique_angle),
        "lateral_displacement": math.sin(strike.oblique_angle),
    }
    for name in share.keys() & readings.values.keys():
        way = abs(readings.values[name])
        _refuse(readings, way > MOST_SPEED * free + 0.5 * expected.projectile.diameter, name, "more", strike)
        # Where half of the way is done, the body has not been slow for long.
        half = np.arange(len(time)) == (int(np.argmax(way >= 0.5 * way.max())) if way.any() else len(time) - 1)
        _refuse(readings, half & (way < LEAST_SPEED * share[name] * free), name, "much less", strike)
    if "rotation" in readings.values:
        turned = abs(readings.values["rotation"])
        rate = MOST_SPEED * strike.velocity / (0.5 * expected.projectile.length) + abs(strike.angular_velocity)
        most = rate * time + MOST_FIRST_TURN
        _refuse(readings, turned > most, "rotation", "more", strike)


def _refuse(readings: Readings, refused: NDArray[np.bool_], name: str, more: str, strike: Impact) -> None:
    rows = np.flatnonzero(refused)
    if rows.size:
        value, time = readings.values[name][rows[0]], readings.values["time"][rows[0]]
        raise readings.error(
            int(rows[0]),
            f"{name} of {value:.4g} {SI_UNIT[name]} after {time:.4g} s is {more} than a body that strikes at "
            f"{strike.velocity:g} m/s can make (wrong unit?)",
        )
