"""Results as an HDF5 file that explains itself: requests and answers as JSON Lines, numbers as tables with units.

    summary      one row a result, or a case of a batch
    requests     a line of JSON a row of the summary, as bytes of UTF-8
    answers      a line of JSON a row of the summary, as bytes of UTF-8
    iterations   every trial of the searches
    history      the motions over time
    residuals    what a calibration was given, what it predicts and what is left

Before the HDF5 data stands a block of 512 bytes, which HDF5 allows for and its tools skip, with the hash of all that
follows. So every byte is checked before the HDF5 library, which does not take damage well, gets to see any.
"""

import hashlib
import itertools
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import h5py
import numpy as np
import orjson

from service.cache.record import Record
from service.cache.tables import (
    HDF5,
    Stream,
    Table,
    histories_of,
    history_of,
    memory_file,
    read_single,
    residual_table,
    residuals_of,
    summary_of,
    table_of,
    trials_of,
    write_attribute,
)
from service.columns import CASE, MOTION, NUMBERING, RESIDUALS, TRIALS, Column, summary_columns
from service.errors import DamagedFileError

BLOCK = 512
"""Smallest place HDF5 keeps free for others at the start of a file. [bytes]"""
LAYOUT = "1"
"""Raised when the layout changes so much that programs that read it must change too."""
SEGMENT_BYTES = 16 * 1024 * 1024
"""Largest size of the histories of one segment: what is read and decompressed for a single result of it."""
CHUNK_BYTES = 1024 * 1024
"""Chunk of a file written block by block: little enough to wait in memory, and enough to be compressed well."""

DESCRIPTIONS = {
    "summary": "the answers in short, a row each",
    "requests": "canonical requests, every default filled in: JSON Lines in UTF-8, a line a row of the summary",
    "answers": "answers, JSON Lines in UTF-8: without the histories, which are a table of this file",
    "iterations": "every trial of the searches, in order",
    "history": "the motions at even intervals and at the event that ended the run",
    "residuals": "what a calibration was given, what it predicts and what is left",
}


Segment: TypeAlias = tuple[Sequence[str], bytes]
"""Keys of the records of a file, in its order, and its content."""


class Case(Protocol):
    """A finished case of a batch."""

    @property
    def number(self) -> int:
        """Place in the batch, from 0."""

    @property
    def custom_id(self) -> str | None:
        """Name its sender gave it."""

    @property
    def record(self) -> Record | None:
        """Its result, if it has one."""

    @property
    def problem(self) -> dict[str, Any] | None:
        """What went wrong otherwise."""


def to_hdf5(*records: Record) -> bytes:
    """Content of a file of these results; the same results give the same bytes."""
    with HDF5, memory_file() as file:
        contents = Contents(file, records[0].operation, chunk_bytes=None)
        contents.write(records, [summary_of(record) for record in records])
        contents.finish()
        file.flush()
        image: bytes = file.id.get_file_image()
    return _seal(hashlib.sha256(image).hexdigest()) + image


def encode_segments(records: Sequence[Record]) -> list[Segment]:
    """Return the files that hold these records of one operation.

    One, or several if their histories are very large; one for each result that has residuals.
    """
    segments: list[Segment] = []
    part: list[Record] = []
    size = 0
    for record in records:
        nbytes = sum(column.nbytes for column in (record.history or {}).values())
        if part and (size + nbytes > SEGMENT_BYTES or residuals_of(record)):
            segments.append(([each.key for each in part], to_hdf5(*part)))
            part, size = [], 0
        part.append(record)
        size += nbytes
    if part:
        segments.append(([each.key for each in part], to_hdf5(*part)))
    return segments


class BatchFile:
    """A file of the cases of a batch, written slice by slice, so that only a slice need be in memory.

    Parameters
    ----------
    path
        Where it goes.
    operation
        Of all its cases.
    axes
        Fields of a sweep, which become columns of the summary.
    base
        JSON of the base of the sweep, an attribute of the file.

    Notes
    -----
    A context manager: closed at the end of its block, whole if `finish` was called or the block ended well.
    """

    def __init__(self, path: Path, operation: str, *, axes: Sequence[str] = (), base: str = "") -> None:
        self._path = path
        self._axes = tuple(axes)
        more = (*NUMBERING, *(Column(name, "value of the axis of the sweep") for name in axes))
        with HDF5:
            self._file = h5py.File(path, "w", libver=("v110", "v110"), userblock_size=BLOCK)
            self._contents = Contents(self._file, operation, chunk_bytes=CHUNK_BYTES, more=more)
            if base:
                root = h5py.h5g.open(self._file.id, b"/")
                write_attribute(root, "base", base)
                write_attribute(root, "axes", *axes)

    def __enter__(self) -> "BatchFile":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.finish()
        with HDF5, suppress(OSError):  # reported already
            self._file.close()

    def finish(self) -> None:
        """Write what is left and the hash of it all, for which the whole file is read."""
        with HDF5:
            if not self._file:
                return
            self._contents.finish()
            self._file.close()
        with self._path.open("r+b") as file:
            file.seek(BLOCK)
            digest = hashlib.file_digest(file, "sha256")
            file.seek(0)
            file.write(_seal(digest.hexdigest()))

    def write(self, cases: Sequence[Case], points: Sequence[Sequence[float]] = ()) -> None:
        """Add these cases; those of a sweep with their points."""
        summaries = []
        for case, point in zip(cases, points or itertools.repeat(()), strict=False):
            summary = summary_of(case.record) if case.record else {}
            problem = case.problem.get("type") if case.problem else None
            summary |= {"index": case.number, "custom_id": case.custom_id, "problem": problem}
            summaries.append(summary | dict(zip(self._axes, point, strict=True)))
        with HDF5:
            self._contents.write([case.record for case in cases], summaries, [case.problem for case in cases])


class Contents:
    """What is in a file, as it is written.

    Parameters
    ----------
    file
        Open and empty.
    operation
        Of its results.
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
        self._summary = (*more, *summary_columns(operation))
        self._trials = TRIALS.get(operation, ())
        self._rows = 0
        known = {
            "summary": self._summary,
            "iterations": (CASE, *self._trials),
            "history": (CASE, *MOTION),
            "residuals": (CASE, *RESIDUALS),
        }
        self._streams = {
            name: Stream(file, name, description, columns=known.get(name, ()), chunk_bytes=chunk_bytes)
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


def check(data: bytes) -> None:
    """Compare the content of a file with its hash.

    Raises
    ------
    DamagedFileError
        If a single byte differs from what was written.
    """
    if data[:BLOCK] != _seal(hashlib.sha256(memoryview(data)[BLOCK:]).hexdigest()):
        raise DamagedFileError("the content does not match its checksum")


def read_keys(data: bytes) -> list[str]:
    """Keys of the results in a file made by `to_hdf5`, row by row.

    Raises
    ------
    DamagedFileError
        If the file is not what was written.
    """
    with _opened(data) as file:
        return _texts(read_single(file, "summary"), "key")


def read_records(data: bytes, rows: Iterable[int] | None = None) -> list[Record]:
    """Results in these rows of a file made by `to_hdf5`, or all of them.

    Raises
    ------
    DamagedFileError
        If the file is not what was written, or has no such row.
    """
    with _opened(data) as file:
        summary = read_single(file, "summary")
        requests, answers = (read_single(file, name).tobytes().split(b"\n") for name in ("requests", "answers"))
        history = read_single(file, "history") if b"history" in file.id else np.empty(0, [(CASE.name, CASE.dtype)])
        names = ("key", "operation", "engine_version", "schema_version")
        keys, operations, engines, schemas = (_texts(summary, name) for name in names)
        ending = next((name for name in ("outcome", "status") if name in (summary.dtype.names or ())), None)
        outcomes: Sequence[str | None] = [None] * len(keys) if ending is None else _texts(summary, ending)
        return [
            Record(
                keys[row],
                operations[row],
                requests[row],
                answers[row],
                history_of(history, row),
                outcome=outcomes[row],
                engine_version=engines[row],
                schema_version=schemas[row],
            )
            for row in (range(len(keys)) if rows is None else rows)
        ]


@contextmanager
def _opened(data: bytes) -> Iterator[h5py.File]:
    check(data)
    try:
        with HDF5, memory_file(data[BLOCK:]) as file:
            yield file
    except (LookupError, OSError, TypeError, ValueError, zlib.error) as error:  # sealed, but not by this service
        raise DamagedFileError(str(error)) from error


def _texts(summary: Table, name: str) -> list[str]:
    return [text.decode() for text in summary[name].tolist()]


def _lines(texts: Iterable[bytes]) -> Table:
    return np.frombuffer(b"".join(text + b"\n" for text in texts), np.uint8)


def _seal(digest: str) -> bytes:
    return f"ricochet results, HDF5 from byte {BLOCK}, sha256 {digest}\n".encode().ljust(BLOCK)
