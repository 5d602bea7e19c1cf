"""HDF5 files of results for download, and functions that they share with the segments of the cache.

A file of results describes itself:

    summary/      summaries of the answers, one row per result or case of a batch
    requests      canonical requests as JSON, one row per row of the summary
    answers       answers as JSON without the histories, or problems of cases without a result
    iterations/   all trials of the searches
    history/      motions over time
    residuals/    residuals of calibrations, curves and quantiles of studies of uncertainty, or results of formulas

Texts are declared as UTF-8. Numbers are arrays with their unit in the attribute `units`.
"""

import io
import itertools
import threading
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any

import h5py
import numpy as np
import orjson

from service.cache.record import CaseResult, Record
from service.cache.tables import (
    Rows,
    Table,
    histories_of,
    residual_table,
    summary_of,
    table_of,
    trial_table_columns,
    trials_of,
)
from service.columns import CASE, IDENTITY, NUMBERING, RESIDUALS, WARNINGS, Column
from service.operations import OPERATIONS
from service.schemas.answers import MotionInHistory
from service.schemas.fields import columns_of
from service.schemas.quantities import Num

NEW_FILE: Mapping[str, Any] = {"libver": ("earliest", "v108"), "track_order": True}
"""Options of new files: the oldest structures of the format, which HDF5 1.8, MATLAB, Octave, R and Julia can read, and
columns in the order in which they were created."""
GZIP_LEVEL = 3
"""Compression level of gzip. The next higher levels take twice the time and save a tenth."""
COMPRESSED_BYTES = 4096
"""Size from which a dataset of fixed length is compressed [bytes]. Compression requires chunks, and a chunk takes 2 kB
in addition to its data, so compression would enlarge smaller datasets."""
CHUNK_ROWS = 4096
"""Number of rows of a chunk in a file that is written in blocks: few enough to be held in memory, and enough to be
compressed well."""
CHUNK_BYTES = 1024 * 1024
"""Size of a chunk of texts [bytes]. It is not a number of rows, because the rows of texts can be long."""
CHUNK_CACHE_BYTES = 64 * 1024
"""Size of HDF5's chunk cache for each dataset [bytes]. Only whole chunks are written, which need no cache. The default
of several megabytes would take hundreds of megabytes for some tens of datasets."""
SPOOLED_BYTES = 8 * 1024 * 1024
"""Size up to which texts are held in memory until they are written [bytes]; larger ones are held in a temporary
file."""
LAYOUT = "2"
"""Version of the layout, raised when a change requires programs that read the files to change."""
DESCRIPTIONS = {
    "summary": "main numbers of the answers, one row for each case",
    "requests": "canonical requests as JSON with all defaults filled in, in the order of the summary",
    "answers": "answers as JSON without their histories, in the order of the summary",
    "iterations": "all trials of the searches, in order",
    "history": "motions over time, at even intervals and at the event that ended the run",
    "residuals": "residuals of calibrations, curves and quantiles of uncertainty studies, or results of formulas",
}

HDF5 = threading.RLock()
"""Lock held while a file is open, because the HDF5 library is not thread-safe. The lock of h5py should suffice, but a
server once crashed with corrupted memory, for a reason that was not found. Eight threads write 200 files of 64 results
in 1.4 s and read them in 1.7 s with this lock, and in 1.1 s and 2.1 s without it; the bytes are the same."""


def to_hdf5(record: Record) -> bytes:
    """Encode one result as a file for download."""
    content = io.BytesIO()
    with (
        HDF5,
        h5py.File(content, "w", **NEW_FILE) as file,
        closing(Contents(file, record.operation, spool=None)) as contents,
    ):
        contents.write([record], [summary_of(record)])
        contents.finish()
    return content.getvalue()


class BatchFile:
    """Writer of a file with the cases of a batch. At most about one chunk of each table is held in memory.

    Parameters
    ----------
    path
        File to write; an existing file is replaced.
    operation
        Operation of all cases.
    axes
        Fields that a sweep varies, which become columns of the summary.
    base
        Base of a sweep as JSON, which becomes an attribute of the file; empty for other batches.

    Notes
    -----
    Used as a context manager, it closes the file at the end of the block. The file is complete if `finish` was called
    or the block raised no exception.
    """

    def __init__(self, path: Path, operation: str, *, axes: Sequence[str] = (), base: str = "") -> None:
        self._axes = tuple(axes)
        more = (*NUMBERING, *(Column(name, "value of the axis of the sweep") for name in axes))
        with HDF5:
            self._file = h5py.File(path, "w", rdcc_nbytes=CHUNK_CACHE_BYTES, **NEW_FILE)
            self._contents = Contents(self._file, operation, spool=path.parent, more=more)
            if base:
                self._file.attrs["base"], self._file.attrs["axes"] = base, list(axes)

    def __enter__(self) -> "BatchFile":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self._contents.close()
            with HDF5, suppress(OSError):  # The write that failed has already reported a full disk.
                self._file.close()

    def finish(self) -> None:
        """Write the remaining rows, and close the file."""
        with HDF5:
            if self._file:
                self._contents.finish()
                self._file.close()

    def write(self, cases: Sequence[CaseResult], points: Sequence[Sequence[float]] = ()) -> None:
        """Add cases; for a sweep, `points` has the values of the axes at each case."""
        summaries = []
        for case, point in zip(cases, points or itertools.repeat(()), strict=False):
            summary = summary_of(case.record) if case.record else {}
            problem = case.problem.get("type") if case.problem else None
            summary |= {"index": case.number, "custom_id": case.custom_id, "problem": problem}
            summaries.append(summary | dict(zip(self._axes, point, strict=True)))
        with HDF5:
            self._contents.write([case.record for case in cases], summaries, [case.problem for case in cases])


class Contents:
    """Tables and texts of a file of results while it is being written.

    Parameters
    ----------
    file
        Open, empty file.
    operation
        Operation of the results.
    spool
        Folder for texts that are held until the file is finished; None for the system's folder of temporary files.
    more
        Additional columns at the beginning of the summary.
    """

    def __init__(self, file: h5py.File, operation: str, *, spool: Path | None, more: Sequence[Column] = ()) -> None:
        file.attrs["title"], file.attrs["layout"] = "ricochet results", LAYOUT
        known = OPERATIONS.get(operation)
        self._summary = (*more, *IDENTITY, *(known.columns if known else ()), WARNINGS)
        self._trials = trial_table_columns(known.answer) if known else ()
        self._texts = {name: GrowingText(file, name, spool) for name in ("requests", "answers")}
        columns = {
            "summary": self._summary,
            "iterations": (CASE, *self._trials),
            "history": (CASE, *columns_of(MotionInHistory[Num])),
            "residuals": (CASE, *RESIDUALS),
        }
        self._tables = {name: GrowingTable(file, name, of) for name, of in columns.items()}
        self._rows = 0

    def write(
        self,
        records: Sequence[Record | None],
        summaries: Sequence[Mapping[str, Any]],
        problems: Sequence[dict[str, Any] | None] = (),
    ) -> None:
        """Add results with their summaries, and problems for cases without a result."""
        answers = [record.answer_json if record else b"" for record in records]
        for row, problem in enumerate(problems):
            answers[row] = answers[row] or orjson.dumps({"problem": problem})
        self._texts["requests"].append([record.request_json if record else b"null" for record in records])
        self._texts["answers"].append(answers)
        self._tables["summary"].append(table_of(self._summary, summaries))
        self._tables["iterations"].append(trials_of(self._trials, records, self._rows))
        self._tables["history"].append(histories_of(records, self._rows))
        self._tables["residuals"].append(residual_table(records, self._rows))
        self._rows += len(records)

    def finish(self) -> None:
        """Write the remaining rows, and the texts."""
        for table in self._tables.values():
            table.finish()
        for text in self._texts.values():
            text.finish()

    def close(self) -> None:
        """Discard the texts that have not been written."""
        for text in self._texts.values():
            text.close()


class GrowingTable:
    """A group of datasets of equal length, one for each column. An empty table is not written.

    Parameters
    ----------
    file
        Open file in which the group is created.
    name
        Name of the group, a key of `DESCRIPTIONS`.
    columns
        Units and descriptions of the columns.
    """

    def __init__(self, file: h5py.File, name: str, columns: Sequence[Column]) -> None:
        self._file = file
        self._name = name
        self._columns = {column.name: column for column in columns}
        self._waiting: list[Table] = []
        self._rows = 0
        """Number of rows that are not written yet."""
        self._group: h5py.Group | None = None

    def append(self, table: Table) -> None:
        """Add rows, and write the chunks that are full."""
        if table:
            self._waiting.append(table)
            self._rows += len(next(iter(table.values())))
        if self._rows >= CHUNK_ROWS:
            self._write(self._rows // CHUNK_ROWS * CHUNK_ROWS)

    def finish(self) -> None:
        """Write the remaining rows."""
        if self._rows:
            self._write(self._rows)

    def _write(self, count: int) -> None:
        """Write the first `count` of the waiting rows."""
        names = list(self._waiting[0])
        table = {name: np.concatenate([part.pop(name) for part in self._waiting]) for name in names}
        if self._group is None:
            self._group = self._file.create_group(self._name, track_order=True)
            self._group.attrs["description"] = DESCRIPTIONS[self._name]
        for name, values in table.items():
            if name in self._group:
                dataset = self._group[name]
                dataset.resize(len(dataset) + count, 0)
                dataset[len(dataset) - count :] = values[:count].astype(dataset.dtype)
            else:
                dataset = add_dataset(self._group, name, values[:count], grows=count % CHUNK_ROWS == 0)
                column = self._columns.get(name) or Column(name, "")
                dataset.attrs["units"], dataset.attrs["description"] = column.unit, column.description
        self._rows -= count
        self._waiting = [{name: values[count:].copy() for name, values in table.items()}] if self._rows else []


class GrowingText:
    """A dataset of lines of text, which is written when the longest line is known.

    The lines are padded to this length, because HDF5 does not compress texts of variable length: without padding, the
    file of a job would be ten times as large.

    Parameters
    ----------
    file
        Open file in which the dataset is created.
    name
        Name of the dataset, a key of `DESCRIPTIONS`.
    folder
        Folder of the temporary file with the lines; None for the system's folder of temporary files.
    """

    def __init__(self, file: h5py.File, name: str, folder: Path | None) -> None:
        self._file = file
        self._name = name
        self._lines = SpooledTemporaryFile(SPOOLED_BYTES, dir=None if folder is None else str(folder))  # noqa: SIM115 (closed by `close`)
        self._count, self._longest = 0, 1

    def append(self, lines: Sequence[bytes]) -> None:
        """Add lines, which are held until `finish` writes them."""
        self._lines.writelines(line + b"\n" for line in lines)
        self._count += len(lines)
        self._longest = max(self._longest, *map(len, lines))

    def finish(self) -> None:
        """Write all lines to the dataset, padded to the length of the longest one."""
        dtype, rows = h5py.string_dtype("utf-8", self._longest), max(1, CHUNK_BYTES // self._longest)
        chunks = (min(rows, max(1, self._count)),)
        dataset = self._file.create_dataset(
            self._name, (self._count,), dtype, chunks=chunks, compression="gzip", compression_opts=GZIP_LEVEL
        )
        dataset.attrs["description"] = DESCRIPTIONS[self._name]
        self._lines.seek(0)
        for start in range(0, self._count, rows):
            lines = [line.rstrip(b"\n") for line in itertools.islice(self._lines, rows)]
            dataset[start : start + len(lines)] = np.array(lines, dtype)

    def close(self) -> None:
        """Discard the lines that have not been written."""
        self._lines.close()


def add_dataset(group: h5py.Group, name: str, values: Rows, *, grows: bool = False) -> h5py.Dataset:
    """Create a one-dimensional dataset with the given values. Texts are declared as UTF-8.

    Parameters
    ----------
    grows
        True if rows can be appended later. The dataset is then compressed, whatever its size.
    """
    is_text = values.dtype.kind == "S"
    if is_text:
        values = values.astype(h5py.string_dtype("utf-8", values.dtype.itemsize))
    more: dict[str, Any] = {}
    if grows or values.nbytes >= COMPRESSED_BYTES:
        # Shuffling stores the first bytes of all values, then all second bytes, and so on. It makes compressed numbers
        # smaller, but compressed texts larger by half.
        more = {"compression": "gzip", "compression_opts": GZIP_LEVEL, "shuffle": not is_text}
        more |= {"chunks": (CHUNK_ROWS,), "maxshape": (None,)} if grows else {"chunks": values.shape}
    return group.create_dataset(name, data=values, **more)
