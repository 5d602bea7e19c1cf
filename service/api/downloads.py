"""Writes files of results to be sent: a few at a time, each once, and keeps them while there is room."""

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
"""Name of their folder in the data folder."""
SHARE = 0.1
"""Share of the limit of the cache that these files may take; results take the rest."""
WRITTEN_AT_ONCE = 2
"""Number of files that are written at the same time: each takes some 10 MB of memory and most of a core."""
PIECE_BYTES = 256 * 1024
"""Size of the pieces in which a file is sent [bytes]."""


class Downloads:
    """Files on the disk, of which those used longest ago are removed.

    Parameters
    ----------
    folder
        Where they are; made when it is needed.
    most_bytes
        How much they may take, those included that are gone from the folder but still being sent. A larger file is made
        for one client at a time, and gone once that has been sent.
    check_folder
        Called before anything is written; raises StorageError if nothing may be.
    """

    def __init__(self, folder: Path, most_bytes: int, check_folder: Callable[[], None]) -> None:
        self._folder = folder
        self._most_bytes = most_bytes
        self._check_folder = check_folder
        self._kept: OrderedDict[str, int] = OrderedDict()
        """Sizes by name, the latest used last."""
        self._open: WeakSet[BufferedReader] = WeakSet()
        """Files that are being sent."""
        self._turns = asyncio.Semaphore(WRITTEN_AT_ONCE)
        self._writing: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    def clear(self) -> None:
        """Remove what an earlier service has left."""
        shutil.rmtree(self._folder, ignore_errors=True)

    async def open(self, name: str, write: Callable[[Path], Awaitable[None]], *, keep: bool) -> BufferedReader:
        """Open the file of this name, which is written unless it is kept; clients that want the same one share it.

        The open file is whole for as long as it is open, also once it is no longer kept. If this is cancelled, so is
        the writing, and nothing is left of it.

        Raises
        ------
        DownloadsFullError
            If files that are being sent take all the room.
        StorageError
            If the disk has no room for it, or the data folder has been replaced.
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
        """Size of what has been removed while it was being sent, and goes on taking room until that has ended."""
        found = [os.fstat(file.fileno()) for file in self._open if not file.closed]
        return sum({(each.st_dev, each.st_ino): each.st_size for each in found if not each.st_nlink}.values())

    async def _make_room(self) -> None:
        """Remove the files used longest ago until the rest and what is being sent take no more than they may."""
        while self._kept and sum(self._kept.values()) + self._sent_bytes > self._most_bytes:
            await self.remove([next(iter(self._kept))])

    async def _open_kept(self, name: str) -> BufferedReader | None:
        if name not in self._kept:
            return None
        try:
            file = await run_sync((self._folder / name).open, "rb")
        except FileNotFoundError:  # Someone else has removed it.
            self._kept.pop(name, None)
            return None
        if name in self._kept:
            self._kept.move_to_end(name)
        return file

    async def _write(self, name: str, write: Callable[[Path], Awaitable[None]], *, keep: bool) -> BufferedReader:
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
        except OSError as error:  # The message of HDF5 contains the path, so it is not passed on.
            why = os.strerror(error.errno) if error.errno else "the disk refuses it"
            raise StorageError(f"the file cannot be written: {why}") from error
        finally:
            with CancelScope(shield=True):
                await run_sync(lambda: path.unlink(missing_ok=True))

    async def remove(self, names: Iterable[str]) -> None:
        """Remove files; clients that are being sent one get it all the same."""
        for name in names:
            self._kept.pop(name, None)
            await run_sync(lambda path: path.unlink(missing_ok=True), self._folder / name)

    async def remove_of(self, job: str) -> None:
        """Remove the files of a job."""
        await self.remove([name for name in self._kept if name.startswith(job)])


async def file_pieces(file: BufferedReader) -> AsyncIterator[bytes]:
    """Yield the content of a file, and close it."""
    try:
        while piece := await run_sync(file.read, PIECE_BYTES):
            yield piece
    finally:
        file.close()
