"""How many cases each key has asked for within the last hour, also over a restart."""

import asyncio
import math
import time
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import orjson
from anyio import to_thread

from service.access.keyring import open_private
from service.errors import QuotaError

FILE = "usage.json"
WINDOW = 3600
"""Looked back. [s]"""
STEP = 60
"""What is asked for within this time is counted as one entry, and falls out of the window as one. [s]"""

KEEP_SECONDS = 10
"""Between two times that counts are written. [s]"""


class Usage:
    """Cases that one key has asked for.

    Parameters
    ----------
    most
        Within the window; None if there is no limit.
    entries
        Of before: when each began, in seconds since 1970, and its cases.
    """

    def __init__(self, most: int | None, entries: list[tuple[int, int]] | None = None) -> None:
        self.most = most
        now = time.time()
        self.entries = deque((began, count) for began, count in entries or () if began <= now)
        self._count = sum(count for _, count in self.entries)

    def take(self, count: int) -> None:
        """Count cases that are asked for.

        Raises
        ------
        QuotaError
            If there would be too many; none has been counted then.
        """
        now = time.time()
        self._forget(now)
        if self.most is not None and self._count + count > self.most:
            raise QuotaError(self.most, count, self._seconds_until(count, now))
        began = int(now) // STEP * STEP
        if self.entries and self.entries[-1][0] >= began:
            began, before = self.entries.pop()
            count_here = before + count
        else:
            count_here = count
        self.entries.append((began, count_here))
        self._count += count

    def give_back(self, count: int) -> None:
        """Count cases no longer that were refused after all, the latest first."""
        while count > 0 and self.entries:
            began, here = self.entries.pop()
            if here > count:
                self.entries.append((began, here - count))
            self._count -= min(here, count)
            count -= here

    def _seconds_until(self, count: int, now: float) -> int:
        """Return when so many more are allowed; if they never are, when the window is empty."""
        left = self._count
        for began, here in self.entries:
            left -= here
            if left + count <= (self.most or 0):
                return max(1, math.ceil(began + STEP + WINDOW - now))
        last = self.entries[-1][0] + STEP + WINDOW - now if self.entries else WINDOW
        return max(1, math.ceil(last))

    def _forget(self, now: float) -> None:
        while self.entries and self.entries[0][0] + STEP + WINDOW <= now:
            self._count -= self.entries.popleft()[1]


class Usages:
    """The usage of every key, kept in the data folder. What was asked for since it was last kept is lost in a crash.

    Parameters
    ----------
    folder
        Data folder of the service.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        self._of_keys: dict[str, Usage] = {}
        self._before: dict[str, list[tuple[int, int]]] = {}
        self._written = b""
        with suppress(OSError, ValueError, TypeError, AttributeError):  # of an hour: not worth a start that fails
            rows = orjson.loads(self._path.read_bytes()).items()
            self._before = {name: [(began, count) for began, count in row] for name, row in rows}

    def of(self, name: str, most: int | None) -> Usage:
        """Return the usage of the key with this id."""
        found = self._of_keys.get(name)
        if found is None:
            found = self._of_keys[name] = Usage(most, self._before.get(name))
        found.most = most
        return found

    @asynccontextmanager
    async def kept(self) -> AsyncIterator[None]:
        """Write the counts every few seconds meanwhile, and at the end."""
        keeping = asyncio.create_task(self._keep_on())
        try:
            yield
        finally:
            keeping.cancel()
            await self.keep()

    async def keep(self) -> None:
        """Write the counts, if there are any; a disk that does not take them is passed over."""
        rows = {name: list(usage.entries) for name, usage in self._of_keys.items()}
        content = orjson.dumps(self._before | rows)
        if rows and content != self._written:
            with suppress(OSError):
                await to_thread.run_sync(self._write, content)

    async def _keep_on(self) -> None:
        while True:
            await asyncio.sleep(KEEP_SECONDS)
            await self.keep()

    def _write(self, content: bytes) -> None:
        staged = self._path.with_suffix(".new")
        with open_private(staged, "wb") as file:
            file.write(content)
        staged.replace(self._path)
        self._written = content
