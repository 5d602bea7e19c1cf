"""What runs next, and how much of it: inline batches first, then the jobs of owners in turn."""

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

Item = TypeVar("Item")

FIRST_CASES = 4
"""Before anything is known of the cases: the slowest take a minute each."""
MOST_CASES = 256
MOST_BYTES = 16 * 1024 * 1024
"""Answers in one chunk: those with long histories take 4 MB each."""
SHRUNK = 8
"""A job whose cases differ that much goes on with chunks of an eighth."""
NEWEST = 0.3
"""Weight of the latest chunk: cases of a sweep become slower or faster on the way."""


class FairQueue(Generic[Item]):
    """What has work to hand out, by owner."""

    def __init__(self) -> None:
        self._queues: dict[str, deque[Item]] = {}
        """The owner whose turn is next comes first."""
        self._added = asyncio.Event()

    def add(self, owner: str, item: Item, *, first: bool = False) -> None:
        """Put the item behind the others of its owner, or before them."""
        queue = self._queues.setdefault(owner, deque())
        if item not in queue:
            (queue.appendleft if first else queue.append)(item)
        self._added.set()

    def remove(self, owner: str, item: Item) -> None:
        """Take the item out, if it is there."""
        queue = self._queues.get(owner, deque())
        if item in queue:
            queue.remove(item)
        if not queue:
            self._queues.pop(owner, None)

    async def next(self) -> Item:
        """First item of the owner whose turn it is, which stays first; wait until there is one."""
        while not self._queues:
            self._added.clear()
            await self._added.wait()
        owner = next(iter(self._queues))
        queue = self._queues.pop(owner)
        self._queues[owner] = queue
        return queue[0]


class Permit:
    """One permit in the pool; given back once, however often it is left."""

    def __init__(self, semaphore: "PrioritySemaphore") -> None:
        self._semaphore: PrioritySemaphore | None = semaphore

    def release(self) -> None:
        """Give the permit back."""
        semaphore, self._semaphore = self._semaphore, None
        if semaphore is not None:
            semaphore.release()


class PrioritySemaphore:
    """Permits for chunks.

    Parameters
    ----------
    count
        Returns how many there are now: with workers that come and go it changes, and is called whenever a permit is
        acquired or released.
    """

    def __init__(self, count: Callable[[], int]) -> None:
        self._count = count
        self._taken = 0
        self._waiting: dict[bool, deque[asyncio.Future[None]]] = {True: deque(), False: deque()}

    async def acquire(self, *, urgent: bool) -> Permit:
        """Wait for a permit; urgent work goes first."""
        if self._taken < self._count():
            self._taken += 1
            return Permit(self)
        turn = asyncio.get_running_loop().create_future()
        self._waiting[urgent].append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if not turn.cancelled():  # it was given the permit just before
                self.release()
            raise
        return Permit(self)

    def release(self) -> None:
        """Pass a permit on; if there are more permits than before, several."""
        self._taken -= 1
        for waiting in (self._waiting[True], self._waiting[False]):
            while waiting and self._taken < self._count():
                turn = waiting.popleft()
                if not turn.done():
                    self._taken += 1
                    turn.set_result(None)


class ChunkSizer:
    """Seconds and bytes that a case takes.

    Parameters
    ----------
    seconds
        Duration that one chunk should have. [s]
    """

    def __init__(self, seconds: float) -> None:
        self._target = seconds
        self._seconds: float | None = None
        self._nbytes = 0.0
        self._most = MOST_CASES

    @property
    def cases(self) -> int:
        """How many the next chunk should hold."""
        if self._seconds is None:
            return FIRST_CASES
        by_time = self._target / max(self._seconds, 1e-6)
        by_bytes = MOST_BYTES / max(self._nbytes, 1.0)
        return max(1, int(min(by_time, by_bytes, self._most)))

    def shrink(self, cases: int) -> None:
        """Take nothing for granted any more: a chunk of so many cases took far too long."""
        self._most = max(1, min(self._most, cases // SHRUNK))

    def note(self, seconds: Sequence[float], nbytes: int) -> None:
        """Take these cases into account; `nbytes` is of all their answers."""
        if not seconds:
            return
        mean, size = sum(seconds) / len(seconds), nbytes / len(seconds)
        if self._seconds is None:
            self._seconds, self._nbytes = mean, size
        self._seconds += NEWEST * (mean - self._seconds)
        self._nbytes += NEWEST * (size - self._nbytes)
