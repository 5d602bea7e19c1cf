"""Tables of several runs: the file of each history, and its impact."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from service.readers.table import read_columns, read_table
from service.readers.units import ANGLE, ANGULAR_VELOCITY, SPEED, TIME, Quantity

FILE = Quantity("file", None, ("history",), required=True)
MOTION_RUNS = (
    FILE,
    Quantity("oblique_angle", ANGLE),
    Quantity("velocity", SPEED, ("striking_velocity", "impact_velocity")),
    Quantity("angle_of_attack", ANGLE),
    Quantity("angular_velocity", ANGULAR_VELOCITY),
    Quantity("until", TIME),
)
SI_UNIT = {"velocity": "m/s", "until": "s", "oblique_angle": "rad"}


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionRunRow:
    """A row of such a table.

    Parameters
    ----------
    name
        The file as the table names it.
    file
        The file with the history, beside the table if its path is relative.
    line
        Of the table.
    impact
        The given quantities of the impact, by name. [m/s, rad, rad/s]
    until
        End of the fitted part, if the table gives one. [s]
    """

    name: str
    file: Path
    line: int
    impact: Mapping[str, float]
    until: float | None


def read_motion_runs(path: str | Path) -> list[MotionRunRow]:
    """Read a table of runs: the file of each and, where there are such columns, its impact and the end of the fit.

    Raises
    ------
    FileError
        With the line, if the table holds no such runs.
    """
    table = read_table(path)
    readings, text = read_columns(table, MOTION_RUNS, {}, {})
    for name, column in readings.values.items():
        if name in ("velocity", "until"):
            readings.require(name, column > 0.0, "must be greater than 0", SI_UNIT[name])
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
