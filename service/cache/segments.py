"""Segments: files of results that are written once and named by the hash of their content.

lock                                       lock of the service that owns the folder
results/segments/<first two digits>/<name>.h5
results/.partial/                          files being written; remains of a crash are removed at the next start
damaged/<name>.h5                          damaged files that were set aside

A segment contains the data from which the cache answers a repeated request:

    key, outcome, request, answer   one row per result; requests and answers as JSON
    history/                        motions, one dataset per column; `case` is the row of the result
"""

import hashlib
import io
import itertools
import os
import re
import shutil
import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

import h5py
import numpy as np

from service.cache.damaged import set_aside
from service.cache.hdf5 import HDF5, LAYOUT, NEW_FILE, add_dataset
from service.cache.record import FloatColumns, Record
from service.cache.tables import histories_of
from service.columns import CASE, Column
from service.errors import DamagedFileError
from service.private_files import make_private_folder, open_private

FILE = re.compile(r"[0-9a-f]{32}\.h5")
SEGMENT_BYTES = 16 * 1024 * 1024
"""Largest size of the histories and texts of a segment of several results [bytes]. The whole segment is read and
decompressed even to return a single result."""
MOST_REMEMBERED = 100_000
"""Largest number of segments remembered as intact, which takes some 25 MB. When it is reached, all are forgotten and
read again at their next check."""

Segment: TypeAlias = tuple[Sequence[str], bytes]
"""Keys of the records of a segment, in the order of its rows, and the content of the file."""


def digest_of(content: bytes) -> str:
    """Return the hash of a segment, which is its name.

    The hash is checked before a file is opened, because a damaged file can crash the HDF5 library.
    """
    return hashlib.sha256(content).hexdigest()[:32]


def to_segment(*records: Record) -> bytes:
    """Encode results of one operation and version as a segment. The same results give the same bytes."""
    first, content = records[0], io.BytesIO()
    texts = {
        "key": [record.key.encode() for record in records],
        "outcome": [record.outcome.encode() for record in records],
        "request": [record.request_json for record in records],
        "answer": [record.answer_json for record in records],
    }
    with HDF5, h5py.File(content, "w", **NEW_FILE) as file:
        file.attrs["title"], file.attrs["layout"] = "segment of ricochet results", LAYOUT
        for name in ("operation", "engine_version", "schema_version"):
            file.attrs[name] = getattr(first, name)
        for name, lines in texts.items():
            longest = max(1, *map(len, lines))
            add_dataset(file, name, np.array(lines, f"S{longest}"))
        histories = histories_of(records)
        group = file.create_group("history", track_order=True) if histories else file
        for name, values in histories.items():
            add_dataset(group, name, values).attrs["units"] = Column(name, "").unit
    return content.getvalue()


def encode_segments(records: Sequence[Record]) -> list[Segment]:
    """Encode records of one operation as one segment, or as several if they exceed `SEGMENT_BYTES`."""
    segments: list[Segment] = []
    part: list[Record] = []
    histories, longest = 0, 0
    for record in records:
        nbytes = sum(column.nbytes for column in (record.history or {}).values())
        # Texts have a fixed length in the file, so each row takes as much space as the longest one.
        text = len(record.answer_json) + len(record.request_json)
        if part and histories + nbytes + (len(part) + 1) * max(longest, text) > SEGMENT_BYTES:
            segments.append(([each.key for each in part], to_segment(*part)))
            part, histories, longest = [], 0, 0
        part.append(record)
        histories, longest = histories + nbytes, max(longest, text)
    if part:
        segments.append(([each.key for each in part], to_segment(*part)))
    return segments


class DecodedSegment:
    """Decoded content of a segment, from which records are made.

    Raises
    ------
    DamagedFileError
        If the file was not written by `to_segment` of this version.
    """

    def __init__(self, data: bytes) -> None:
        try:
            with HDF5, h5py.File(io.BytesIO(data)) as file:
                self.keys = [key.decode() for key in file["key"][()].tolist()]
                self._outcomes = [outcome.decode() for outcome in file["outcome"][()].tolist()]
                self._requests, self._answers = file["request"][()].tolist(), file["answer"][()].tolist()
                self._history = {name: dataset[()] for name, dataset in file.get("history", {}).items()}
                names = ("operation", "engine_version", "schema_version")
                self._operation, self._engine, self._schema = (file.attrs[name] for name in names)
        # The hash has been checked, so a file that cannot be decoded was written by another version.
        except (LookupError, OSError, TypeError, ValueError, AttributeError) as error:
            raise DamagedFileError(f"no segment of this version: {error}") from error

    def records(self, rows: Iterable[int]) -> list[Record]:
        """Return the results in the given rows.

        Raises
        ------
        DamagedFileError
            If a row does not exist.
        """
        try:
            return [
                Record(
                    self.keys[row],
                    self._operation,
                    self._requests[row],
                    self._answers[row],
                    self._history_of(row),
                    outcome=self._outcomes[row],
                    engine_version=self._engine,
                    schema_version=self._schema,
                )
                for row in rows
            ]
        except IndexError as error:
            raise DamagedFileError(str(error)) from error

    def _history_of(self, row: int) -> FloatColumns | None:
        if not self._history:
            return None
        start, end = np.searchsorted(self._history[CASE.name], [row, row + 1])
        columns = {name: column for name, column in self._history.items() if name != CASE.name}
        # The rows are copied, because a view would keep the whole array of the segment in memory.
        return {name: column[start:end].copy() for name, column in columns.items()} if end > start else None


class Segments:
    """Segments of a data folder.

    Parameters
    ----------
    folder
        Data folder of the service.

    Notes
    -----
    Files are not synchronised to the disk (fsync). A file that is incomplete after a power cut does not match the hash
    in its name, and its results are computed again, which costs less than waiting for the disk at every file.
    """

    def __init__(self, folder: Path) -> None:
        self._segments = folder / "results" / "segments"
        self._partial = folder / "results" / ".partial"
        self._damaged = folder / "damaged"
        self._numbers = itertools.count()
        self._whole: dict[str, tuple[int, int]] = {}
        self._latest: tuple[str, tuple[int, int], DecodedSegment] | None = None
        self._decoding = threading.Lock()

    def sweep(self) -> None:
        """Remove files that a crash left half written, and create the folder of the segments.

        The folder exists even when it is empty, so that a backup command that names it does not fail.
        """
        shutil.rmtree(self._partial, ignore_errors=True)
        with suppress(OSError):
            make_private_folder(self._segments)

    def names(self) -> set[str]:
        """Return the names of all segments on the disk."""
        files = {name for _, _, names in os.walk(self._segments) for name in names}
        return {name.removesuffix(".h5") for name in files if FILE.fullmatch(name)}

    def path(self, name: str) -> Path:
        """Return the path of a segment, whether it exists or not."""
        return self._segments / name[:2] / f"{name}.h5"

    def stage(self, content: bytes) -> Path:
        """Write the content of a segment to a temporary file.

        `place` then renames it, so that a crash never leaves a partial segment under the name of a complete one.

        Raises
        ------
        OSError
            If the file cannot be written; it is then removed.
        """
        staged = self._partial / f"{os.getpid()}-{next(self._numbers)}"
        try:
            make_private_folder(self._partial)
            with open_private(staged, "wb") as file:
                file.write(content)
        except OSError:
            discard(staged)
            raise
        return staged

    def place(self, staged: Path, name: str) -> None:
        """Turn a staged file into the segment with this name.

        Raises
        ------
        OSError
            If the file cannot be renamed; it is then removed.
        """
        path = self.path(name)
        try:
            signature = _signature(staged)
            make_private_folder(path.parent)
            staged.replace(path)
        except OSError:
            discard(staged)
            raise
        self._remember(name, signature)

    def read(self, name: str) -> bytes:
        """Return the content of a segment.

        Raises
        ------
        DamagedFileError
            If the content does not match the name.
        OSError
            If the file cannot be read.
        """
        content = self.path(name).read_bytes()
        if digest_of(content) != name:
            raise DamagedFileError("the content does not have the hash that is its name")
        return content

    def check(self, name: str) -> None:
        """Check that a segment is intact. The file is read only if it has changed since the last check.

        Raises
        ------
        DamagedFileError
            If the content does not match the name.
        OSError
            If the file cannot be read.
        """
        signature = _signature(self.path(name))
        if self._whole.get(name) != signature:
            self.read(name)
            self._remember(name, signature)

    def decoded(self, name: str) -> DecodedSegment:
        """Return the decoded content of a segment.

        The latest segment is kept decoded, because a job is read in blocks that are smaller than a segment.

        Raises
        ------
        DamagedFileError
            If the content does not match the name, or is not a segment of this version.
        OSError
            If the file cannot be read.
        """
        with self._decoding:  # One segment is decoded at a time, and readers of the same one share it.
            signature, latest = _signature(self.path(name)), self._latest
            if latest is None or latest[:2] != (name, signature):
                latest = self._latest = None  # Frees the memory of the previous segment before loading this one.
                latest = self._latest = (name, signature, DecodedSegment(self.read(name)))
            return latest[2]

    def remove(self, names: Sequence[str]) -> None:
        """Remove segments.

        Raises
        ------
        OSError
            If a file cannot be removed; a missing one is no error.
        """
        for name in names:
            self.path(name).unlink(missing_ok=True)
            self._whole.pop(name, None)

    def set_aside(self, name: str, reason: str) -> None:
        """Move a damaged segment to the folder `damaged`.

        Raises
        ------
        OSError
            If the file cannot be moved.
        """
        self._whole.pop(name, None)
        set_aside(self.path(name), self._damaged, reason)

    def _remember(self, name: str, signature: tuple[int, int]) -> None:
        if len(self._whole) >= MOST_REMEMBERED:
            self._whole.clear()  # Segments that are no longer remembered are checked again when they are used.
        self._whole[name] = signature


def discard(path: Path) -> None:
    """Remove a file, and ignore errors."""
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _signature(path: Path) -> tuple[int, int]:
    """Return size and modification time, which identify the state of a file that was checked."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns
