"""Whose turn it is: small work first, then owners one after the other, the jobs of each in order of arrival."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Turns(Generic[Item]):
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


class Place:
    """One place in the pool; given back once, however often it is left."""

    def __init__(self, slots: "Slots") -> None:
        self._slots: Slots | None = slots

    def leave(self) -> None:
        """Leave the place to whoever waits."""
        slots, self._slots = self._slots, None
        if slots is not None:
            slots.give_back()


class Slots:
    """Places for chunks.

    Parameters
    ----------
    count
        How many there are now: with workers that come and go it changes, and is asked for whenever a place is taken or
        left.
    """

    def __init__(self, count: Callable[[], int]) -> None:
        self._count = count
        self._taken = 0
        self._waiting: dict[bool, deque[asyncio.Future[None]]] = {True: deque(), False: deque()}

    async def take(self, *, urgent: bool) -> Place:
        """Wait for a place; urgent work goes first."""
        if self._taken < self._count():
            self._taken += 1
            return Place(self)
        turn = asyncio.get_running_loop().create_future()
        self._waiting[urgent].append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if not turn.cancelled():  # it was given the place just before
                self.give_back()
            raise
        return Place(self)

    def give_back(self) -> None:
        """Leave a place to whoever waits; if there are more places than before, to several."""
        self._taken -= 1
        for waiting in (self._waiting[True], self._waiting[False]):
            while waiting and self._taken < self._count():
                turn = waiting.popleft()
                if not turn.done():
                    self._taken += 1
                    turn.set_result(None)
