"""The tables of the files that hold results: their columns, with units and descriptions."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from service.results.record import FloatColumns, Record

Table = npt.NDArray[Any]

UNITS = {
    "_m_s": "m/s",
    "_rad_s": "rad/s",
    "_n_m": "N m",
    "_deg": "deg",
    "_m": "m",
    "_s": "s",
    "_n": "N",
    "_j": "J",
}
"""Unit by the end of a name, longer ends first."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    name
        As in the contract.
    description
        What it holds, without the unit.
    dtype
        Of NumPy; texts are UTF-8, filled up with zeros, which take no room once compressed.
    """

    name: str
    description: str
    dtype: str = "<f8"

    @property
    def unit(self) -> str:
        """Unit of its numbers."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(end)), "")

    def fill(self, values: Sequence[Any]) -> Table:
        """Return the values as an array; None becomes NaN or an empty text.

        Raises
        ------
        ValueError
            If a text is too long to be kept whole.
        """
        dtype = np.dtype(self.dtype)
        if dtype.kind != "S":
            return np.array(values, dtype)
        texts = [b"" if value is None else value.encode() for value in values]
        if max(map(len, texts), default=0) > dtype.itemsize:
            raise ValueError(f"a text of column {self.name} is longer than {dtype.itemsize} bytes")
        return np.array(texts, dtype)


MOTION = (
    Column("time_s", "since first contact"),
    Column("center_of_gravity_depth_m", "depth of the centre of gravity, positive inside the target"),
    Column("center_of_gravity_lateral_m", "way of the centre of gravity along the face since first contact"),
    Column("nose_tip_depth_m", "depth of the nose tip, positive inside the target"),
    Column("axis_angle_deg", "from the inward normal of the face to the axis; grows as the nose turns to the face"),
    Column("depth_velocity_m_s", "of the centre of gravity, along the inward normal"),
    Column("lateral_velocity_m_s", "of the centre of gravity, along the face"),
    Column("angular_velocity_rad_s", "rate of the axis angle"),
    Column("depth_force_n", "resistance along the inward normal"),
    Column("lateral_force_n", "resistance along the face"),
    Column("moment_n_m", "moment of the resistance about the centre of gravity"),
    Column("kinetic_energy_j", "of translation and rotation"),
)
IDENTITY = (
    Column("key", "of the result; empty if the case has none", "S64"),
    Column("operation", "what was asked for", "S32"),
    Column("engine_version", "of the solver", "S32"),
    Column("schema_version", "of the contract", "S32"),
)
ESTIMATE = (
    Column("strength_factor", "that fits best"),
    Column("standard_error", "of the strength factor"),
    Column("confidence_low", "lower end of the confidence interval of the strength factor"),
    Column("confidence_high", "upper end of it"),
)
SCALARS = {
    "trajectory": (
        Column("outcome", "how the run ended", "S32"),
        Column("maximum_depth_m", "greatest depth of the nose tip"),
        Column("strength_factor", "in use, at this oblique angle"),
        *(
            Column(f"final_{column.name}", f"{column.description}; at the event that ended the run")
            for column in MOTION
        ),
    ),
    "cra": (
        Column("status", "how the search ended", "S32"),
        Column("critical_angle_deg", "smallest oblique angle, from the normal, at which the projectile is turned away"),
        Column("bracket_low_deg", "lower of the angles between which the change was last pinned down"),
        Column("bracket_high_deg", "upper of these"),
        Column("critical_angle_standard_error_deg", "of the angle, from the covariance of the strength factor"),
        Column("strength_factor", "in use at the critical angle"),
    ),
    "calibration_depth": ESTIMATE,
    "calibration_motion": (
        *ESTIMATE,
        Column("normalized_root_mean_square", "of the residuals, each quantity over its span"),
        Column("best_decay_law", "that fits best", "S32"),
    ),
}
"""What a summary tells of an answer, by operation."""
WARNINGS = Column("warnings", "codes of the warnings, with spaces between", "S512")
NUMBERING = (
    Column("index", "of the case in the batch, from 0", "<i8"),
    Column("custom_id", "name of the case in the batch", "S512"),
    Column("problem", "type of the problem of a case that has no result", "S128"),
)
"""What a summary tells of the cases of a batch, besides."""
CASE = Column("case", "row of the summary it belongs to, from 0", "<i8")
TRIALS = (
    Column("oblique_angle_deg", "angle tried, from the inward normal of the face to the velocity"),
    Column("final_position_m", "depth of the nose tip at the end of the trial"),
    Column("outcome", "how the trial ended", "S32"),
    Column("fine", "whether it was computed as finely as asked for, or only to see where to look", "?"),
)

QUANTITIES = {
    "depth_displacement_m": "displacement of the centre of gravity along the inward normal of the face",
    "lateral_displacement_m": "displacement of the centre of gravity along the face",
    "rotation_deg": "change of the axis angle",
}
RUN = Column("run", "place of the run in the request, from 0", "<i8")
RESIDUALS = (
    RUN,
    Column("oblique_angle_deg", "from the inward normal of the face to the velocity"),
    Column("strength_factor", "as given"),
    Column("residual", "given minus fitted strength factor"),
    Column("velocity_m_s", "at first contact"),
    Column("group", "that the test belongs to", "S512"),
    Column("depth_m", "greatest depth of the nose tip, as given"),
    Column("predicted_depth_m", "with the strength factor that fits best"),
    Column("residual_m", "given minus predicted depth"),
    Column("time_s", "since first contact"),
    *(Column(name, f"{text}, as given") for name, text in QUANTITIES.items()),
    *(Column(f"predicted_{name}", "with the strength factor that fits best") for name in QUANTITIES),
    *(Column(f"residual_{name}", "given minus predicted") for name in QUANTITIES),
)
"""Of every calibration; each has some of these."""


def summary_columns(operation: str) -> tuple[Column, ...]:
    """Columns of a summary of results of this operation."""
    return (*IDENTITY, *SCALARS.get(operation, ()), WARNINGS)


def summarize(record: Record) -> dict[str, Any]:
    """Return what the summary tells of a result, by column; what the answer does not have is left out."""
    answer = record.answer
    row = {name: value for name, value in answer.items() if isinstance(value, float | int | str)}
    row |= {f"final_{name}": value for name, value in answer.get("final", {}).items()}
    row |= {name: getattr(record, name) for name in ("key", "operation", "engine_version", "schema_version")}
    if bracket := answer.get("bracket_deg"):
        row["bracket_low_deg"], row["bracket_high_deg"] = min(bracket), max(bracket)
    if interval := answer.get("confidence_interval"):
        row["confidence_low"], row["confidence_high"] = interval
    row["warnings"] = " ".join(dict.fromkeys(warning["code"] for warning in answer.get("warnings", ())))
    return row


def table_of(columns: Iterable[Column], rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows as a table with these columns."""
    return _joined(_filled(columns, rows), len(rows))


def trials_of(records: Sequence[Record | None], first: int) -> Table:
    """Every trial of these results, in order, with the row of the summary, the first of which is given."""
    searches = [record.answer.get("iterations", ()) if record else () for record in records]
    trials = [trial for search in searches for trial in search]
    rows = np.repeat(np.arange(first, first + len(records)), list(map(len, searches)))
    return _joined({CASE.name: rows} | _filled(TRIALS, trials), len(trials))


def residuals_of(record: Record) -> dict[str, list[Any]]:
    """Return what a calibration was given, what it predicts and what is left, by column; of other results nothing."""
    kind = record.operation
    if not kind.startswith("calibration_"):
        return {}
    answer = record.answer
    if kind == "calibration_depth":
        tests = record.request["tests"]
        given = {
            name: [test[name] for test in tests] for name in ("velocity_m_s", "group", "depth_m") if name in tests[0]
        }
        return given | {"predicted_depth_m": answer["predicted_depth_m"], "residual_m": answer["residuals"]}
    if kind == "calibration_obliquity":
        points = record.request["points"]
        given = {name: [point[name] for point in points] for name in ("oblique_angle_deg", "strength_factor")}
        return given | {"residual": answer["residuals"]}
    if "runs" in answer:
        return _stacked(
            [_motion(run["history"], fit) for run, fit in zip(record.request["runs"], answer["runs"], strict=True)]
        )
    return _motion(record.request["history"], answer)


def _motion(history: Mapping[str, Any], fit: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the rows of a motion that were fitted, by column."""
    columns = dict(fit["residuals"])
    time = columns.pop("time_s")
    used = {name: history[name][: len(time)] for name in columns}
    predicted = {f"predicted_{name}": fit["predicted"][name] for name in columns}
    return {"time_s": time} | used | predicted | {f"residual_{name}": column for name, column in columns.items()}


def _stacked(motions: Sequence[Mapping[str, list[Any]]]) -> dict[str, list[Any]]:
    """Return the rows of several runs one below the other; what a run was not given is not a number there."""
    names = [column.name for column in RESIDUALS if any(column.name in motion for motion in motions)]
    lengths = [len(motion["time_s"]) for motion in motions]
    stacked: dict[str, list[Any]] = {RUN.name: [run for run, length in enumerate(lengths) for _ in range(length)]}
    for name in names:
        stacked[name] = [
            value
            for motion, length in zip(motions, lengths, strict=True)
            for value in motion.get(name, [math.nan] * length)
        ]
    return stacked


def residual_table(records: Sequence[Record | None], first: int) -> Table:
    """Residuals of a calibration as a table, with the row of the summary; its file holds no other result."""
    found = [
        (row, columns) for row, record in enumerate(records, first) if record and (columns := residuals_of(record))
    ]
    if not found:
        return np.empty(0)
    ((row, columns),) = found
    table = {column.name: column.fill(columns[column.name]) for column in RESIDUALS if column.name in columns}
    length = len(next(iter(table.values())))
    return _joined({CASE.name: np.full(length, row)} | table, length)


def histories_of(records: Sequence[Record | None], first: int) -> Table:
    """Every history of these results, likewise. They must have the same columns."""
    histories = [(row, record.history) for row, record in enumerate(records, first) if record and record.history]
    if not histories:
        return np.empty(0)
    lengths = [len(next(iter(history.values()))) for _, history in histories]
    columns: dict[str, Table] = {CASE.name: np.repeat([row for row, _ in histories], lengths)}
    columns |= {name: np.concatenate([history[name] for _, history in histories]) for name in histories[0][1]}
    return _joined(columns, sum(lengths))


def history_of(table: Table, row: int) -> FloatColumns | None:
    """History that belongs to a row of the summary."""
    if not len(table):
        return None
    start, end = np.searchsorted(table[CASE.name], [row, row + 1])
    names = [name for name in table.dtype.names or () if name != CASE.name]
    return {name: np.ascontiguousarray(table[name][start:end]) for name in names} if end > start else None


def _filled(columns: Iterable[Column], rows: Sequence[Mapping[str, Any]]) -> dict[str, Table]:
    return {column.name: column.fill([row.get(column.name) for row in rows]) for column in columns}


def _joined(columns: Mapping[str, Table], length: int) -> Table:
    table = np.empty(length, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table
