"""Segments: files of results that are written once and named by the hash of their content.

lock                                       lock of the service that owns the folder
results/segments/<first two digits>/<name>.h5
results/.partial/                          files being written; remains of a crash are removed at the next start
damaged/<name>.h5                          damaged files that were set aside
"""

import itertools
import os
import re
import shutil
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from service.cache.damaged import set_aside
from service.cache.hdf5 import DecodedSegment, digest_of
from service.errors import DamagedFileError
from service.private_files import make_private_folder, open_private

FILE = re.compile(r"[0-9a-f]{32}\.h5")
MOST_REMEMBERED = 100_000
"""Number of segments remembered as intact, in some 20 MB of memory. Others are read when they are checked."""


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
            If the file cannot be written; it is removed then.
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
            If the file cannot be renamed; it is removed then.
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

        The last one is kept, because a job is read in blocks that are smaller than a segment.

        Raises
        ------
        DamagedFileError
            If the content does not match the name.
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
            If one cannot be removed.
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
