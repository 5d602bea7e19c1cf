"""Result files for download, written on request, shared by clients, and kept until they are evicted."""

import asyncio
import os
import shutil
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from io import BufferedReader
from pathlib import Path
from secrets import token_hex
from weakref import WeakSet, WeakValueDictionary

from anyio import CancelScope
from anyio.to_thread import run_sync

from service.errors import DownloadsFullError, StorageError
from service.private_files import make_private, make_private_folder

FOLDER = "downloads"
"""Name of the folder of downloads in the data folder."""
SHARE = 0.1
"""Fraction of the disk limit of the cache that downloads may take. The value is arbitrary, and small because a download
can be written again from results, while a result has to be computed again."""
WRITTEN_AT_ONCE = 2
"""Number of files that are written at the same time. Each takes some 10 MB of memory and most of a core."""
PIECE_BYTES = 256 * 1024
"""Size of the pieces in which a file is sent [bytes]. A smaller piece costs more switches between threads, a larger one
more memory per client; the value is arbitrary."""


class Downloads:
    """On-disk cache of files for download. The least recently used files are evicted.

    Parameters
    ----------
    folder
        Folder of the files, created when the first one is written.
    most_bytes
        Limit on the disk space of all files, including those that have been removed from the folder but are still being
        sent. A larger file is written for one client, and deleted once it has been sent. [bytes]
    check_folder
        Function called before a file is written; raises StorageError if the data folder must not be written to.
    """

    def __init__(self, folder: Path, most_bytes: int, check_folder: Callable[[], None]) -> None:
        self._folder = folder
        self._most_bytes = most_bytes
        self._check_folder = check_folder
        self._kept: OrderedDict[str, int] = OrderedDict()
        """Sizes of the files in the folder, keyed by name; the most recently used file is last. [bytes]"""
        self._open: WeakSet[BufferedReader] = WeakSet()
        """Open files that are being sent to clients."""
        self._turns = asyncio.Semaphore(WRITTEN_AT_ONCE)
        self._writing: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        """Locks of the files that are being opened or written, keyed by name; dropped when no request uses them."""

    def clear(self) -> None:
        """Remove the files of an earlier process, which listed them in memory only."""
        shutil.rmtree(self._folder, ignore_errors=True)

    async def open(self, name: str, write: Callable[[Path], Awaitable[None]], *, keep: bool) -> BufferedReader:
        """Open a file, and write it first if it does not exist. Simultaneous requests for one file share it.

        The open file stays readable after it has been evicted. Cancellation stops the writing and removes the partial
        file.

        Raises
        ------
        DownloadsFullError
            If removed files that are still being sent take all the disk space of downloads.
        StorageError
            If the disk is full, or the data folder has been replaced.
        """
        lock = self._writing.setdefault(name, asyncio.Lock())
        async with lock:
            file = await self._open_kept(name)
            if file is None:
                async with self._turns:
                    file = await self._write(name, write, keep=keep)
            self._open.add(file)
            return file

    @property
    def _sent_bytes(self) -> int:
        """Size of removed files that are still being sent; they take disk space until they are closed. [bytes]"""
        found = [os.fstat(file.fileno()) for file in self._open if not file.closed]
        return sum({(each.st_dev, each.st_ino): each.st_size for each in found if not each.st_nlink}.values())

    async def _make_room(self) -> None:
        """Evict the least recently used files until the total is within the limit."""
        while self._kept and sum(self._kept.values()) + self._sent_bytes > self._most_bytes:
            await self.remove([next(iter(self._kept))])

    async def _open_kept(self, name: str) -> BufferedReader | None:
        if name not in self._kept:
            return None
        try:
            file = await run_sync((self._folder / name).open, "rb")
        except FileNotFoundError:  # The file was removed by hand, or evicted after the test above.
            self._kept.pop(name, None)
            return None
        if name in self._kept:
            self._kept.move_to_end(name)
        return file

    async def _write(self, name: str, write: Callable[[Path], Awaitable[None]], *, keep: bool) -> BufferedReader:
        # Writing under a temporary name keeps a partial file from being taken for a whole one.
        path = self._folder / f"{token_hex(16)}.partial"
        await run_sync(self._check_folder)
        if self._sent_bytes >= self._most_bytes:
            raise DownloadsFullError
        try:
            await run_sync(make_private_folder, path.parent)
            await run_sync(make_private, path)
            await write(path)
            file = await run_sync(path.open, "rb")
            size = os.fstat(file.fileno()).st_size
            if keep and size <= self._most_bytes:
                await run_sync(path.replace, self._folder / name)
                self._kept[name] = size
            await self._make_room()
            return file
        except OSError as error:  # The HDF5 error message contains the path, which clients must not see.
            why = os.strerror(error.errno) if error.errno else "the disk refuses it"
            raise StorageError(f"the file cannot be written: {why}") from error
        finally:
            with CancelScope(shield=True):  # The partial file is removed even if the task is cancelled.
                await run_sync(lambda: path.unlink(missing_ok=True))

    async def remove(self, names: Iterable[str]) -> None:
        """Remove files. A client that is downloading a file still gets all of it, because the file is open."""
        for name in names:
            self._kept.pop(name, None)
            await run_sync(lambda path: path.unlink(missing_ok=True), self._folder / name)

    async def remove_of(self, job: str) -> None:
        """Remove the files of a job, whose names begin with its id."""
        await self.remove([name for name in self._kept if name.startswith(job)])


async def file_pieces(file: BufferedReader) -> AsyncIterator[bytes]:
    """Yield the content of a file in pieces, and close it."""
    try:
        while piece := await run_sync(file.read, PIECE_BYTES):
            yield piece
    finally:
        file.close()
