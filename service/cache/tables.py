"""Contents of a file of results: tables of summaries, trials, histories and residuals, written in compressed chunks."""

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import orjson
from h5py import h5a, h5d, h5p, h5s, h5t

from service.cache.record import Record
from service.columns import (
    CASE,
    IDENTITY,
    RESIDUALS,
    RUN,
    WARNINGS,
    Column,
    summarize,
)
from service.operations import OPERATIONS
from service.schemas.answers import MotionInHistory
from service.schemas.fields import columns_of, part_of
from service.schemas.quantities import Num, Part

Rows = npt.NDArray[Any]


def fill(column: Column, values: Sequence[Any]) -> Rows:
    """Return the values of a column as an array; None becomes NaN or an empty text.

    Raises
    ------
    ValueError
        If a text is too long to be kept whole.
    """
    dtype = np.dtype(column.dtype)
    if dtype.kind != "S":
        return np.array(values, dtype)
    texts = [b"" if value is None else value.encode() for value in values]
    if max(map(len, texts), default=0) > dtype.itemsize:
        raise ValueError(f"a text of column {column.name} is longer than {dtype.itemsize} bytes")
    return np.array(texts, dtype)


def summary_of(record: Record) -> dict[str, Any]:
    """Return the row of the summary of a result, by column."""
    return summarize(record.answer) | {column.name: getattr(record, column.name) for column in IDENTITY}


def table_of(columns: Iterable[Column], rows: Sequence[Mapping[str, Any]]) -> Rows:
    """Rows as a table with these columns."""
    return _joined(_filled(columns, rows), len(rows))


def trial_table_columns(answer: type[Part]) -> tuple[Column, ...]:
    """Return the columns of the trials of a search, from the model of its answer."""
    trial = part_of(answer, "iterations") if "iterations" in answer.model_fields else None
    return columns_of(trial) if trial else ()


def trials_of(columns: Iterable[Column], records: Sequence[Record | None], first: int) -> Rows:
    """Every trial of these results, in order, with the row of the summary, the first of which is given."""
    searches = [record.answer.get("iterations", ()) if record else () for record in records]
    trials = [trial for search in searches for trial in search]
    rows = np.repeat(np.arange(first, first + len(records)), list(map(len, searches)))
    return _joined({CASE.name: rows} | _filled(columns, trials), len(trials))


def residuals_of(record: Record) -> dict[str, list[Any]]:
    """Return what a calibration was given, what it predicts and what is left, by column.

    From a study of uncertainty it is the probability over the angle, or probabilities and quantiles; from the formulas
    all that they give; from other results nothing.
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
    """Return the answers of the formulas by column; NaN where one has none."""
    limits = ("penetration_depth_m", "scabbing_thickness_m", "perforation_thickness_m")
    rows = [dict.fromkeys(limits, math.nan) | row for row in answer["formulas"]]
    columns = {name: [row[name] for row in rows] for name in ("formula", *limits)}
    columns["in_range"] = ["yes" if row["in_range"] else "no" if row["out_of_range"] else "unknown" for row in rows]
    columns["note"] = [row.get("note", "") for row in rows]
    columns["verified"] = ["yes" if row["verified"] else "no" for row in rows]
    return columns | {"source": [row["source"] for row in rows]}


def _estimates(answer: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the curve of probabilities; of one strike its probabilities and quantiles, one below the other."""
    if "probability" in answer:
        return dict(answer["probability"])
    rows = [{"quantity": each["outcome"], "level": math.nan, **each} for each in answer["outcomes"]]
    for name in ("maximum_depth_m", "exit_speed_m_s", "exit_angle_deg", "residual_speed_m_s"):
        rows += [{"quantity": name, **each} for each in answer.get(name, ())]
    for part in ("ricochet_exit", "perforation_exit"):
        for name, quantiles in answer.get(part, {}).items():
            rows += [{"quantity": f"{part}_{name}", **each} for each in quantiles]
    return {name: [row[name] for row in rows] for name in ("quantity", "level", "value", "lower", "upper")}


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


def residual_table(records: Sequence[Record | None], first: int) -> Rows:
    """Residuals of a calibration as a table, with the row of the summary; its file holds no other result."""
    found = [
        (row, columns) for row, record in enumerate(records, first) if record and (columns := residuals_of(record))
    ]
    if not found:
        return np.empty(0)
    ((row, columns),) = found
    table = {column.name: fill(column, columns[column.name]) for column in RESIDUALS if column.name in columns}
    length = len(next(iter(table.values())))
    return _joined({CASE.name: np.full(length, row)} | table, length)


def histories_of(records: Sequence[Record | None], first: int) -> Rows:
    """Every history of these results, in order, with the row of the summary. They must have the same columns."""
    histories = [(row, record.history) for row, record in enumerate(records, first) if record and record.history]
    if not histories:
        return np.empty(0)
    lengths = [len(next(iter(history.values()))) for _, history in histories]
    columns: dict[str, Rows] = {CASE.name: np.repeat([row for row, _ in histories], lengths)}
    columns |= {name: np.concatenate([history[name] for _, history in histories]) for name in histories[0][1]}
    return _joined(columns, sum(lengths))


def _filled(columns: Iterable[Column], rows: Sequence[Mapping[str, Any]]) -> dict[str, Rows]:
    return {column.name: fill(column, [row.get(column.name) for row in rows]) for column in columns}


def _joined(columns: Mapping[str, Rows], length: int) -> Rows:
    table = np.empty(length, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


LEVEL = 3
"""Compression level: the next ones take twice the time for a tenth less."""

LAYOUT = "1"
"""Raised when the layout changes so much that programs that read it must change too."""
DESCRIPTIONS = {
    "summary": "the answers in short, a row each",
    "requests": "canonical requests, every default filled in: JSON Lines in UTF-8, a line a row of the summary",
    "answers": "answers, JSON Lines in UTF-8: without the histories, which are a table of this file",
    "iterations": "every trial of the searches, in order",
    "history": "the motions at even intervals and at the event that ended the run",
    "residuals": "what a calibration was given, what it predicts and what is left",
}

datatype = lru_cache(maxsize=256)(lambda dtype: h5t.py_create(dtype, logical=True))
"""HDF5 type of a NumPy one; making it takes as long as all the rest of a dataset."""


class Stream:
    """A dataset of one dimension that grows; not there at all if it stays empty.

    Parameters
    ----------
    file
        Where it goes.
    name, description
        Name and description of the dataset.
    columns
        What is known of the columns, if it is a table.
    chunk_bytes
        Largest chunk; None for a single one, of whatever size.
    """

    def __init__(
        self, file: h5py.File, name: str, description: str, *, columns: Sequence[Column], chunk_bytes: int | None
    ) -> None:
        self._file = file
        self._name = name
        self._description = description
        self._columns = {column.name: column for column in columns}
        self._chunk_bytes = chunk_bytes
        self._chunk = 0
        self._waiting: list[Rows] = []
        self._length = 0
        self._dataset: h5d.DatasetID | None = None

    def append(self, rows: Rows) -> None:
        """Add rows; chunks that they fill are written."""
        if not len(rows):
            return
        self._waiting.append(rows)
        if self._chunk_bytes is None or sum(part.nbytes for part in self._waiting) <= self._chunk_bytes:
            return
        waiting, chunk = np.concatenate(self._waiting), max(1, self._chunk_bytes // rows.itemsize)
        whole = len(waiting) // chunk * chunk
        for start in range(0, whole, chunk):
            self._write(waiting[start : start + chunk])
        self._waiting = [waiting[whole:].copy()]

    def finish(self) -> None:
        """Write what is left."""
        if sum(map(len, self._waiting)):
            self._write(np.concatenate(self._waiting))

    def _write(self, rows: Rows) -> None:
        """Write a chunk: the last may be shorter, and is filled up as HDF5 wants it.

        Compressed here, as `read_single` decompresses it: HDF5 would leave out compression where it does not pay.
        Measured, by hand and by HDF5: 0.85 and 1.10 ms to write a critical angle, 12.5 and 12.9 ms for 256, of equal
        size.
        """
        if self._dataset is None:
            self._dataset = self._create(rows)
            self._chunk = len(rows)
        start, missing = self._length, self._chunk - len(rows)
        self._length += len(rows)
        if start:
            self._dataset.set_extent((self._length,))
        if missing:
            rows = np.concatenate([rows, np.zeros(missing, rows.dtype)])
        self._dataset.write_direct_chunk((start,), _shuffled_and_compressed(rows))

    def _create(self, rows: Rows) -> h5d.DatasetID:
        layout = h5p.create(h5p.DATASET_CREATE)
        layout.set_chunk(rows.shape)
        layout.set_fill_time(h5d.FILL_TIME_NEVER)
        layout.set_obj_track_times(False)
        if rows.itemsize > 1:
            layout.set_shuffle()
        layout.set_deflate(LEVEL)
        space = h5s.create_simple(rows.shape, rows.shape if self._chunk_bytes is None else (h5s.UNLIMITED,))
        dataset = h5d.create(self._file.id, self._name.encode(), datatype(rows.dtype), space, layout)
        write_attribute(dataset, "description", self._description)
        if rows.dtype.names:
            columns = [self._columns.get(name) or Column(name, "") for name in rows.dtype.names]
            write_attribute(dataset, "column_units", *(column.unit for column in columns))
            write_attribute(dataset, "column_descriptions", *(column.description for column in columns))
        return dataset


def write_attribute(owner: h5py.h5g.GroupID | h5d.DatasetID, name: str, *texts: str) -> None:
    """Give an object of the file an attribute, a text or several."""
    array, kind, space = prepared(texts)
    h5a.create(owner, name.encode(), kind, space).write(array)


@lru_cache(maxsize=256)
def prepared(texts: tuple[str, ...]) -> tuple[Rows, h5t.TypeID, h5s.SpaceID]:
    """Texts as HDF5 wants them: of one length, with their type and extent."""
    array = np.array(texts, "S") if len(texts) > 1 else np.array(texts[0], "S")
    return array, h5t.py_create(array.dtype), h5s.create_simple(array.shape) if array.shape else h5s.create(h5s.SCALAR)


def _shuffled_and_compressed(rows: Rows) -> bytes:
    """Shuffle and compress as HDF5 does: the first bytes of all rows, then the second ones, and so on."""
    planes = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), rows.itemsize).T
    return zlib.compress(np.ascontiguousarray(planes).data, LEVEL)


class Contents:
    """What is in a file, as it is written.

    Parameters
    ----------
    file
        Open and empty.
    operation
        Operation of its results.
    chunk_bytes
        Largest chunk of a dataset; None if all is written at once.
    more
        Further columns of the summary, the first ones.
    """

    def __init__(
        self, file: h5py.File, operation: str, *, chunk_bytes: int | None, more: Sequence[Column] = ()
    ) -> None:
        root = h5py.h5g.open(file.id, b"/")
        for name, text in {"title": "ricochet results", "layout": LAYOUT}.items():
            write_attribute(root, name, text)
        known = OPERATIONS.get(operation)
        self._summary = (*more, *IDENTITY, *(known.columns if known else ()), WARNINGS)
        self._trials = trial_table_columns(known.answer) if known else ()
        self._rows = 0
        columns = {
            "summary": self._summary,
            "iterations": (CASE, *self._trials),
            "history": (CASE, *columns_of(MotionInHistory[Num])),
            "residuals": (CASE, *RESIDUALS),
        }
        self._streams = {
            name: Stream(file, name, description, columns=columns.get(name, ()), chunk_bytes=chunk_bytes)
            for name, description in DESCRIPTIONS.items()
        }

    def write(
        self,
        records: Sequence[Record | None],
        summaries: Sequence[Mapping[str, Any]],
        problems: Sequence[dict[str, Any] | None] = (),
    ) -> None:
        """Add these results and their summaries; where there is no result, the problem."""
        answers = [record.answer_json if record else b"" for record in records]
        for row, problem in enumerate(problems):
            answers[row] = answers[row] or orjson.dumps({"problem": problem})
        tables = {
            "summary": table_of(self._summary, summaries),
            "requests": _lines(record.request_json if record else b"null" for record in records),
            "answers": _lines(answers),
            "iterations": trials_of(self._trials, records, self._rows),
            "history": histories_of(records, self._rows),
            "residuals": residual_table(records, self._rows),
        }
        for name, table in tables.items():
            self._streams[name].append(table)
        self._rows += len(records)

    def finish(self) -> None:
        """Write what is left."""
        for stream in self._streams.values():
            stream.finish()


def _lines(texts: Iterable[bytes]) -> Rows:
    return np.frombuffer(b"".join(text + b"\n" for text in texts), np.uint8)
