"""Quotas of keys: the cost requested within the last hour, kept across restarts."""

import asyncio
import math
import sqlite3
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from anyio import to_thread

from service.auth.api_keys import connected
from service.clock import SYSTEM, Clock
from service.errors import QuotaError, QuotaTooSmallError

WINDOW = 3600
"""Length of the sliding window over which cost is counted, an hour because quotas are in cases per hour. [s]"""
STEP = 60
"""Length of the time steps in which cases are counted [s]. The cases of one step leave the window together, so a key
has at most 61 counts."""
SAVE_SECONDS = 10
"""Interval between writes of the counts to disk, chosen by judgement [s]. A crash loses the counts of one interval."""


def steady(clock: Clock) -> Callable[[], float]:
    """Return a clock that starts at the present time and ignores later changes of the system clock. [s since 1970]

    Setting the clock of the machine therefore does not change what is left of a quota.
    """
    since_1970 = clock.now() - clock.monotonic()
    return lambda: since_1970 + clock.monotonic()


class Quota:
    """Cases of one key within the sliding window.

    Parameters
    ----------
    most
        Largest number of cases within the window; None for no limit.
    entries
        Saved counts: start of each time step, in seconds since 1970, and number of cases charged in it.
    time
        Clock; see `steady`. [s since 1970]
    """

    def __init__(
        self,
        most: int | None,
        entries: list[tuple[int, int]] | None = None,
        time: Callable[[], float] | None = None,
    ) -> None:
        self.most = most
        self._time = time or steady(SYSTEM)
        now = self._time()
        # Counts dated in the future were saved before the clock was set back. They would stay in the window too long.
        self.entries = deque((began, count) for began, count in entries or () if began <= now)
        self._count = sum(count for _, count in self.entries)

    def take(self, count: int, before: int = 0) -> int:
        """Charge cases, and return the start of the time step in which they are counted. [s since 1970]

        Parameters
        ----------
        before
            Number of cases of the same request that have already been charged.

        Raises
        ------
        QuotaError
            If fewer cases are left; none of the cases is charged.
        QuotaTooSmallError
            If the request has more cases than the quota allows in an hour.
        """
        now = self._time()
        self._forget(now)
        if self.most is not None and before + count > self.most:
            raise QuotaTooSmallError(self.most, before + count)
        if self.most is not None and self._count + count > self.most:
            raise QuotaError(self.most, count, max(0, self.most - self._count), self._seconds_until(count, now))
        began = int(now) // STEP * STEP
        if self.entries and self.entries[-1][0] >= began:
            began, before = self.entries.pop()
            count_here = before + count
        else:
            count_here = count
        self.entries.append((began, count_here))
        self._count += count
        return began

    def give_back(self, count: int) -> None:
        """Give back refused cases, taking them from the latest time steps first."""
        while count > 0 and self.entries:
            began, here = self.entries.pop()
            if here > count:
                self.entries.append((began, here - count))
            self._count -= min(here, count)
            count -= here

    def give_back_from(self, began: int, count: int) -> None:
        """Give back cases charged in the time step that began at `began`, unless it has left the window."""
        self._forget(self._time())
        for place, (begin, here) in enumerate(self.entries):
            if begin == began:
                self.entries[place] = (begin, max(0, here - count))
                self._count -= min(here, count)

    def _seconds_until(self, count: int, now: float) -> int:
        """Return the time until `count` more cases are allowed; if they never are, until the window is empty. [s]"""
        left = self._count
        for began, here in self.entries:
            left -= here
            if left + count <= (self.most or 0):
                return max(1, math.ceil(began + STEP + WINDOW - now))
        last = self.entries[-1][0] + STEP + WINDOW - now if self.entries else WINDOW
        return max(1, math.ceil(last))

    def fields(self) -> dict[str, str]:
        """Return the `RateLimit` header fields (draft-ietf-httpapi-ratelimit-headers-10), or none without a limit.

        The policy is named `cases` because it counts cases, not requests.
        """
        if self.most is None:
            return {}
        now = self._time()
        self._forget(now)
        begins = self.entries[0][0] if self.entries else now - STEP
        seconds = math.ceil(begins + STEP + WINDOW - now)
        left = max(0, self.most - self._count)
        return {"RateLimit-Policy": f'"cases";q={self.most};w={WINDOW}', "RateLimit": f'"cases";r={left};t={seconds}'}

    def _forget(self, now: float) -> None:
        while self.entries and self.entries[0][0] + STEP + WINDOW <= now:
            self._count -= self.entries.popleft()[1]


class QuotaStore:
    """Quotas of all keys, saved in `auth.sqlite`. A crash loses the counts since the last save.

    Parameters
    ----------
    folder
        Data folder of the service.
    clock
        Clock of the quotas.
    """

    def __init__(self, folder: Path, clock: Clock = SYSTEM) -> None:
        self._folder = folder
        self._time = steady(clock)
        self._quotas: dict[str, Quota] = {}
        self._earlier: dict[str, list[tuple[int, int]]] = {}
        self._saved: list[tuple[str, int, int]] = []
        # Losing the counts of one hour is better than not starting.
        with suppress(sqlite3.Error), connected(folder) as connection:
            for row in connection.execute("SELECT * FROM quotas ORDER BY began"):
                self._earlier.setdefault(row["key"], []).append((row["began"], row["cases"]))

    def quota(self, key_id: str, most: int | None) -> Quota:
        """Return the quota of a key, with `most` as its present limit."""
        found = self._quotas.get(key_id)
        if found is None:
            found = self._quotas[key_id] = Quota(most, self._earlier.get(key_id), self._time)
        found.most = most
        return found

    def give_back(self, key_id: str, count: int, began: int) -> None:
        """Refund unused cases to the quota of a key. They were charged in the time step that began at `began`."""
        if key_id not in self._quotas:
            # The limit is not known here. `quota` sets it when the key is next used.
            self._quotas[key_id] = Quota(None, self._earlier.get(key_id), self._time)
        self._quotas[key_id].give_back_from(began, count)

    @asynccontextmanager
    async def saved_regularly(self) -> AsyncIterator[None]:
        """Save the counts every `SAVE_SECONDS` during the block, and at its end."""
        saving = asyncio.create_task(self._save_regularly())
        try:
            yield
        finally:
            saving.cancel()
            await self.save()

    async def save(self) -> None:
        """Save the counts if they have changed. Disk errors are ignored; they are no reason to refuse requests."""
        counts = self._earlier | {key_id: list(quota.entries) for key_id, quota in self._quotas.items()}
        rows = [(key_id, began, cases) for key_id, entries in counts.items() for began, cases in entries]
        if self._quotas and rows != self._saved:
            with suppress(sqlite3.Error):
                await to_thread.run_sync(self._write, rows)

    async def _save_regularly(self) -> None:
        while True:
            await asyncio.sleep(SAVE_SECONDS)
            await self.save()

    def _write(self, rows: list[tuple[str, int, int]]) -> None:
        with connected(self._folder) as connection:
            connection.execute("DELETE FROM quotas")
            connection.executemany("INSERT INTO quotas VALUES (?, ?, ?)", rows)
        self._saved = rows
