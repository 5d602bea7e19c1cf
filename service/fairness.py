"""Decides what runs next and how much of it: owners take turns, and urgent work goes before that of jobs."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Generic, TypeVar

Item = TypeVar("Item")

FIRST_CASES = 4
"""Cases of the first chunk, when their time is unknown: the slowest take a minute each."""
MOST_CASES = 256
MOST_BYTES = 16 * 1024 * 1024
"""Size of the answers of one chunk: those with long histories take 4 MB each."""
SHRUNK = 8
"""Factor by which chunks shrink after one that took far too long."""
NEWEST = 0.3
"""Weight of the latest chunk in the mean, as the cases of a sweep become slower or faster on the way."""


class FairQueue(Generic[Item]):
    """Queue of waiting items in which owners take turns."""

    def __init__(self) -> None:
        self._queues: dict[str, deque[Item]] = {}
        """Items by owner; the owner whose turn is next comes first."""

    def __len__(self) -> int:
        """Return how many items wait."""
        return sum(map(len, self._queues.values()))

    def add(self, owner: str, item: Item) -> None:
        """Add the item after the others of its owner."""
        self._queues.setdefault(owner, deque()).append(item)

    def remove(self, owner: str, item: Item) -> None:
        """Remove the item, if it is there."""
        queue = self._queues.get(owner, deque())
        if item in queue:
            queue.remove(item)
        if not queue:
            self._queues.pop(owner, None)

    def take(self) -> Item:
        """Take out the first item of the owner whose turn it is, who comes last from now on; there must be one."""
        owner, queue = next(iter(self._queues.items()))
        item = queue.popleft()
        del self._queues[owner]
        if queue:
            self._queues[owner] = queue
        return item

    def take_from_longest(self, owner: str) -> Item | None:
        """Take out the last item of the owner who has most, if another of this owner would still be fewer."""
        longest = max(self._queues.values(), key=len, default=deque[Item]())
        return longest.pop() if len(longest) > len(self._queues.get(owner, ())) + 1 else None


class Permit:
    """One permit of a semaphore, which is given back once however often it is released."""

    def __init__(self, semaphore: "FairSemaphore") -> None:
        self._semaphore: FairSemaphore | None = semaphore

    def release(self) -> None:
        """Give the permit back."""
        semaphore, self._semaphore = self._semaphore, None
        if semaphore is not None:
            semaphore.release()


class FairSemaphore:
    """Semaphore for whose permits owners take turns.

    Parameters
    ----------
    count
        Returns how many there are now: with workers that come and go it changes, and is called whenever a permit is
        acquired or released.
    """

    def __init__(self, count: Callable[[], int]) -> None:
        self.taken = 0
        """Number of permits that have not been released."""
        self._count = count
        self._waiting: dict[bool, FairQueue[asyncio.Future[None]]] = {True: FairQueue(), False: FairQueue()}

    @property
    def waiting(self) -> int:
        """Number of those who wait for a permit."""
        return sum(map(len, self._waiting.values()))

    @asynccontextmanager
    async def held(self, owner: str, *, urgent: bool = True) -> AsyncIterator[Permit]:
        """Hold a permit, which may be released before the end of the context."""
        permit = await self.acquire(owner, urgent=urgent)
        try:
            yield permit
        finally:
            permit.release()

    async def acquire(self, owner: str, *, urgent: bool = True) -> Permit:
        """Wait for a permit; urgent work goes first."""
        if self.taken < self._count():
            self.taken += 1
            return Permit(self)
        turn = asyncio.get_running_loop().create_future()
        self._waiting[urgent].add(owner, turn)
        try:
            await turn
        except asyncio.CancelledError:
            if (
                turn.done() and not turn.cancelled() and turn.exception() is None
            ):  # It was given the permit just before it was cancelled.
                self.release()
            raise
        finally:
            self._waiting[urgent].remove(owner, turn)
        return Permit(self)

    def make_room(self, owner: str, error: Exception) -> bool:
        """Refuse the last of the owner who has most urgent work waiting in favour of this owner, who has less.

        Returns whether there was one, which gets this error.
        """
        turn = self._waiting[True].take_from_longest(owner)
        if turn is not None and not turn.done():
            turn.set_exception(error)
        return turn is not None

    def release(self) -> None:
        """Pass a permit on; if there are more permits than before, several."""
        self.taken -= 1
        for waiting in (self._waiting[True], self._waiting[False]):
            while waiting and self.taken < self._count():
                turn = waiting.take()
                if not turn.done():
                    self.taken += 1
                    turn.set_result(None)


class ChunkSizer:
    """Sizes chunks from the time and the bytes that their cases take.

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
        """Number of cases that the next chunk should hold."""
        if self._seconds is None:
            return FIRST_CASES
        by_time = self._target / max(self._seconds, 1e-6)
        by_bytes = MOST_BYTES / max(self._nbytes, 1.0)
        return max(1, int(min(by_time, by_bytes, self._most)))

    def shrink(self, cases: int) -> None:
        """Make the next chunks smaller, because one of so many cases took far too long."""
        self._most = max(1, min(self._most, cases // SHRUNK))

    def note(self, seconds: Sequence[float], nbytes: int) -> None:
        """Take the times of these cases into account; `nbytes` is the size of all their answers."""
        if not seconds:
            return
        mean, size = sum(seconds) / len(seconds), nbytes / len(seconds)
        if self._seconds is None:
            self._seconds, self._nbytes = mean, size
        self._seconds += NEWEST * (mean - self._seconds)
        self._nbytes += NEWEST * (size - self._nbytes)
