"""The files of results: segments, written once and named by the hash of their content, and the folder they are in.

lock                                       held by the service the folder belongs to
results/segments/<first two digits>/<name>.h5
results/.partial/                          being written; what a crash leaves there is removed at the next start
damaged/<name>.h5                          files that were not what had been written, set aside
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
"""Number of segments remembered as intact, in some 20 MB of memory."""


class Segments:
    """Files of a data folder.

    Parameters
    ----------
    folder
        Data folder of the service.

    Notes
    -----
    No fsync: what a power cut leaves of a file does not have the hash that is its name and is computed again, which
    costs less than waiting for the disk at every one.
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
        """Remove what a crash left half written, and make the folder: it is copied when there is none in it too."""
        shutil.rmtree(self._partial, ignore_errors=True)
        with suppress(OSError):
            make_private_folder(self._segments)

    def names(self) -> set[str]:
        """Names of all that are there."""
        files = {name for _, _, names in os.walk(self._segments) for name in names}
        return {name.removesuffix(".h5") for name in files if FILE.fullmatch(name)}

    def path(self, name: str) -> Path:
        """Return the file that holds a segment, whether it exists or not."""
        return self._segments / name[:2] / f"{name}.h5"

    def stage(self, content: bytes) -> Path:
        """Write the content to a file that is none of the segments yet.

        Raises
        ------
        OSError
            If it cannot be written; nothing is left of it then.
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
        """Make the staged file the segment of this name, whole at once.

        Raises
        ------
        OSError
            If it cannot be; nothing is left of it then.
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
            If it is not what was written.
        OSError
            If it cannot be read.
        """
        content = self.path(name).read_bytes()
        if digest_of(content) != name:
            raise DamagedFileError("the content does not have the hash that is its name")
        return content

    def check(self, name: str) -> None:
        """See that a segment is whole; read only if it was not seen so before.

        Raises
        ------
        DamagedFileError
            If it is not what was written.
        OSError
            If it cannot be read.
        """
        signature = _signature(self.path(name))
        if self._whole.get(name) != signature:
            self.read(name)
            self._remember(name, signature)

    def decoded(self, name: str) -> DecodedSegment:
        """Content of a segment; that of the latest is kept, as a job is read in pieces smaller than a segment.

        Raises
        ------
        DamagedFileError
            If it is not what was written.
        OSError
            If it cannot be read.
        """
        with self._decoding:  # another reader may be about to need the same
            signature, latest = _signature(self.path(name)), self._latest
            if latest is None or latest[:2] != (name, signature):
                latest = self._latest = None  # before as much memory is taken again
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
        """Move a damaged segment out of the way.

        Raises
        ------
        OSError
            If it cannot be moved.
        """
        self._whole.pop(name, None)
        set_aside(self.path(name), self._damaged, reason)

    def _remember(self, name: str, signature: tuple[int, int]) -> None:
        if len(self._whole) >= MOST_REMEMBERED:
            self._whole.clear()  # they are checked again when they are used
        self._whole[name] = signature


def discard(path: Path) -> None:
    """Remove a file if that can be done."""
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _signature(path: Path) -> tuple[int, int]:
    """Size and time of last change, which identify the file that was checked."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns
