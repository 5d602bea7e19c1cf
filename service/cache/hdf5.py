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
import threading
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import h5py
import numpy as np
from h5py import h5d, h5f, h5p, h5t

from service.cache.record import CaseResult, FloatColumns, Record
from service.cache.tables import Contents, Rows, residuals_of, summary_of, write_attribute
from service.columns import CASE, NUMBERING, Column
from service.errors import DamagedFileError

BLOCK = 512
"""Smallest place HDF5 keeps free for others at the start of a file. [bytes]"""
SEGMENT_BYTES = 16 * 1024 * 1024
"""Largest size of the histories of one segment: what is read and decompressed for a single result of it."""
CHUNK_BYTES = 1024 * 1024
"""Chunk of a file written block by block: little enough to wait in memory, and enough to be compressed well."""

HDF5 = threading.RLock()
"""Held while a file is open: the HDF5 library is not made for threads. h5py has a lock itself, which should
do; but a server once ended with its memory damaged, for a cause that was not found. Measured, eight threads that write
and read 200 files of 64 results: 1.4 and 1.7 s with this lock, 1.1 and 2.1 s without, the same bytes."""
MEMORY_STEP = 64 * 1024
"""By which a file in memory grows. [bytes]"""
FORMAT = h5f.LIBVER_V110
"""HDF5 1.10, of 2016: a file of one result takes half as much as in the older formats."""
numpy_type = lru_cache(maxsize=256)(lambda encoded: h5t.decode(encoded).dtype)
"""NumPy type of an HDF5 one, in the code of HDF5, which is slow to make too."""
numbers = itertools.count()
"""Each file in memory has the next in its name."""

Segment: TypeAlias = tuple[Sequence[str], bytes]
"""Keys of the records of a file, in its order, and its content."""


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
        Operation of all its cases.
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

    def write(self, cases: Sequence[CaseResult], points: Sequence[Sequence[float]] = ()) -> None:
        """Add these cases; those of a sweep with their points."""
        summaries = []
        for case, point in zip(cases, points or itertools.repeat(()), strict=False):
            summary = summary_of(case.record) if case.record else {}
            problem = case.problem.get("type") if case.problem else None
            summary |= {"index": case.number, "custom_id": case.custom_id, "problem": problem}
            summaries.append(summary | dict(zip(self._axes, point, strict=True)))
        with HDF5:
            self._contents.write([case.record for case in cases], summaries, [case.problem for case in cases])


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


class DecodedSegment:
    """The tables of a file made by `to_hdf5`, from which any of its records are made.

    Raises
    ------
    DamagedFileError
        If the file is not what was written.
    """

    def __init__(self, data: bytes) -> None:
        with _opened(data) as file:
            summary = read_single(file, "summary")
            self._requests, self._answers = (
                read_single(file, name).tobytes().split(b"\n") for name in ("requests", "answers")
            )
            has_history = b"history" in file.id
            self._history = read_single(file, "history") if has_history else np.empty(0, [(CASE.name, CASE.dtype)])
            names = ("key", "operation", "engine_version", "schema_version")
            self.keys, self._operations, self._engines, self._schemas = (_texts(summary, name) for name in names)
            ending = next((name for name in ("outcome", "status") if name in (summary.dtype.names or ())), None)
            self._outcomes: Sequence[str | None] = [None] * len(summary) if ending is None else _texts(summary, ending)

    def records(self, rows: Iterable[int]) -> list[Record]:
        """Results in these rows.

        Raises
        ------
        DamagedFileError
            If there is no such row.
        """
        try:
            return [
                Record(
                    self.keys[row],
                    self._operations[row],
                    self._requests[row],
                    self._answers[row],
                    history_of(self._history, row),
                    outcome=self._outcomes[row],
                    engine_version=self._engines[row],
                    schema_version=self._schemas[row],
                )
                for row in rows
            ]
        except IndexError as error:
            raise DamagedFileError(str(error)) from error


def read_single(file: h5py.File, name: str) -> Rows:
    """All of a dataset that is a single chunk, decompressed here.

    Measured, by hand and by HDF5: 26 and 63 ms for 256 histories, 0.24 and 0.65 ms for one critical angle.

    Raises
    ------
    KeyError
        If there is none of this name.
    """
    dataset = h5d.open(file.id, name.encode())
    dtype = numpy_type(dataset.get_type().encode())
    _, chunk = dataset.read_direct_chunk((0,))
    planes = np.frombuffer(zlib.decompress(chunk), np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(planes.T).reshape(-1).view(dtype)


def history_of(table: Rows, row: int) -> FloatColumns | None:
    """History that belongs to a row of the summary."""
    if not len(table):
        return None
    start, end = np.searchsorted(table[CASE.name], [row, row + 1])
    names = [name for name in table.dtype.names or () if name != CASE.name]
    return {name: np.ascontiguousarray(table[name][start:end]) for name in names} if end > start else None


def memory_file(image: bytes | None = None) -> h5py.File:
    """Open a file in memory, with this content or empty."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(MEMORY_STEP, False)
    access.set_fclose_degree(h5f.CLOSE_STRONG)
    access.set_libver_bounds(FORMAT, FORMAT)
    name = f"results in memory {next(numbers)}".encode()  # HDF5 refuses two open files of one name
    if image is None:
        creation = h5p.create(h5p.FILE_CREATE)
        creation.set_obj_track_times(False)  # the same content, the same bytes
        return h5py.File(h5f.create(name, h5f.ACC_EXCL, creation, access))
    access.set_file_image(image)
    return h5py.File(h5f.open(name, h5f.ACC_RDWR, fapl=access))


@contextmanager
def _opened(data: bytes) -> Iterator[h5py.File]:
    check(data)
    try:
        with HDF5, memory_file(data[BLOCK:]) as file:
            yield file
    except (LookupError, OSError, TypeError, ValueError, zlib.error) as error:  # sealed, but not by this service
        raise DamagedFileError(str(error)) from error


def _texts(summary: Rows, name: str) -> list[str]:
    return [text.decode() for text in summary[name].tolist()]


def _seal(digest: str) -> bytes:
    return f"ricochet results, HDF5 from byte {BLOCK}, sha256 {digest}\n".encode().ljust(BLOCK)
