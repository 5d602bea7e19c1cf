"""Results as tables: columns of summaries, trials, histories and residuals."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from service.cache.record import Record
from service.columns import (
    CASE,
    IDENTITY,
    RESIDUALS,
    RUN,
    Column,
    summarize,
)
from service.schemas.fields import columns_of, part_of
from service.schemas.quantities import Part

Rows = npt.NDArray[Any]
Table = dict[str, Rows]
"""Columns of equal length by name; empty if the table has no rows."""

MISSING = -1
"""Value of an integer column where a row has no value. Integer columns hold counts and numbers from 0, so the value is
not taken for one of them."""


def fill(column: Column, values: Sequence[Any]) -> Rows:
    """Return the values of a column as an array, with NaN, `MISSING` or an empty string for None.

    Raises
    ------
    ValueError
        If a string is longer than the column, because numpy would truncate it silently.
    """
    dtype = np.dtype(column.dtype)
    if dtype.kind == "i":
        return np.array([MISSING if value is None else value for value in values], dtype)
    if dtype.kind != "S":
        return np.array(values, dtype)
    texts = [b"" if value is None else value.encode() for value in values]
    # Lengths are compared in bytes, since the column holds UTF-8.
    if max(map(len, texts), default=0) > dtype.itemsize:
        raise ValueError(f"a text of column {column.name} is longer than {dtype.itemsize} bytes")
    return np.array(texts, dtype)


def summary_of(record: Record) -> dict[str, Any]:
    """Return the summary of a result as a row, by column."""
    return summarize(record.answer) | {column.name: getattr(record, column.name) for column in IDENTITY}


def table_of(columns: Iterable[Column], rows: Sequence[Mapping[str, Any]]) -> Table:
    """Convert rows to a table with the given columns."""
    return {column.name: fill(column, [row.get(column.name) for row in rows]) for column in columns} if rows else {}


def trial_table_columns(answer: type[Part]) -> tuple[Column, ...]:
    """Return the columns of the trials of a search, from the model of its answer."""
    trial = part_of(answer, "iterations") if "iterations" in answer.model_fields else None
    return columns_of(trial) if trial else ()


def trials_of(columns: Iterable[Column], records: Sequence[Record | None], first: int) -> Table:
    """Return all trials of the given results, each with the row of its search in the summary, counted from `first`."""
    searches = [record.answer.get("iterations", ()) if record else () for record in records]
    trials = [trial for search in searches for trial in search]
    rows = np.repeat(np.arange(first, first + len(records)), list(map(len, searches)))
    return {CASE.name: rows} | table_of(columns, trials) if trials else {}


def residuals_of(record: Record) -> dict[str, list[Any]]:
    """Return the detailed table of a result, by column.

    For a calibration it contains data, predictions and residuals; for a study of uncertainty, the probability against
    the angle, or probabilities and quantiles; for the formulas, all their values. Other results have no such table.
    """
    kind = record.operation
    if kind.endswith("_uncertainty"):
        return _estimates(record.answer)
    if not kind.startswith("calibration_"):
        return formula_columns(record.answer) if kind == "formulas" else {}
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


def formula_columns(answer: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the results of the formulas by column, with NaN for limits that a formula does not give."""
    limits = ("penetration_depth_m", "scabbing_thickness_m", "perforation_thickness_m")
    rows = [dict.fromkeys(limits, math.nan) | row for row in answer["formulas"]]
    columns = {name: [row[name] for row in rows] for name in ("formula", *limits)}
    columns["in_range"] = ["yes" if row["in_range"] else "no" if row["out_of_range"] else "unknown" for row in rows]
    columns["note"] = [row.get("note", "") for row in rows]
    columns["verified"] = ["yes" if row["verified"] else "no" for row in rows]
    return columns | {"source": [row["source"] for row in rows]}


def _estimates(answer: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the probability curve of a study of angles, or probabilities and quantiles of a study of one strike."""
    if "probability" in answer:
        return dict(answer["probability"])
    rows = [{"quantity": each["outcome"], "level": math.nan, **each} for each in answer["outcomes"]]
    for name in ("maximum_depth_m", "exit_speed_m_s", "exit_angle_deg", "residual_speed_m_s"):
        rows += [{"quantity": name, **each} for each in answer.get(name, ())]
    for part in ("ricochet_exit", "perforation_exit"):
        quantities = dict(answer.get(part, {}))
        flight = quantities.pop("flight", {})
        quantities |= {f"flight_{name}": quantiles for name, quantiles in flight.items()}
        for name, quantiles in quantities.items():
            rows += [{"quantity": f"{part}_{name}", **each} for each in quantiles]
    return {name: [row[name] for row in rows] for name in ("quantity", "level", "value", "lower", "upper")}


def _motion(history: Mapping[str, Any], fit: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return data, predictions and residuals of a fitted motion, by column."""
    columns = dict(fit["residuals"])
    time = columns.pop("time_s")
    used = {name: history[name][: len(time)] for name in columns}
    predicted = {f"predicted_{name}": fit["predicted"][name] for name in columns}
    return {"time_s": time} | used | predicted | {f"residual_{name}": column for name, column in columns.items()}


def _stacked(motions: Sequence[Mapping[str, list[Any]]]) -> dict[str, list[Any]]:
    """Concatenate the tables of several runs, with NaN for quantities that were not measured in a run."""
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
    """Return the detailed tables of records with their rows in the summary; empty if none has one.

    Several records must be of one operation, whose tables have the same columns.
    """
    found = [
        (row, columns) for row, record in enumerate(records, first) if record and (columns := residuals_of(record))
    ]
    if not found:
        return {}
    tables = [
        {column.name: fill(column, columns[column.name]) for column in RESIDUALS if column.name in columns}
        for _, columns in found
    ]
    lengths = [len(next(iter(table.values()))) for table in tables]
    rows = np.repeat([row for row, _ in found], lengths)
    return {CASE.name: rows} | {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def histories_of(records: Sequence[Record | None], first: int = 0) -> Table:
    """Return all histories of the given results with their row in the summary. All must have the same columns."""
    histories = [(row, record.history) for row, record in enumerate(records, first) if record and record.history]
    if not histories:
        return {}
    lengths = [len(next(iter(history.values()))) for _, history in histories]
    columns = {name: np.concatenate([history[name] for _, history in histories]) for name in histories[0][1]}
    return {CASE.name: np.repeat([row for row, _ in histories], lengths)} | columns
