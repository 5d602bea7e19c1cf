"""The queue of work that waits for a worker: owners get equal shares, and of one owner's work the smallest goes first.

Owners share the workers by start-time fair queueing (Goyal, Vin and Cheng, 1996). Each owner has a virtual time: the
cost of the work that it has been given. The owner with the least is served next. One who had nothing to do begins at
the time of those who are served now, so that idle time is no credit.
"""

import asyncio
from bisect import insort
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import count
from typing import NamedTuple

from service.workers import Call, CallResult


class Kind(IntEnum):
    """What kind of work it is; work that waits overtakes a running chunk, unless it is a chunk itself."""

    PROBE = 0
    SINGLE = 1
    CHUNK = 2


_numbers = count()


@dataclass(eq=False, slots=True)
class Work:
    """Calls that one worker runs one after the other.

    Parameters
    ----------
    owner
        Whose share of the workers it counts against.
    cost
        What it counts as. [ordinary cases]
    remaining
        Cost of all that is left of the request it belongs to: of an owner's work the least goes first.
    begun
        Called once, when a worker takes it.
    """

    kind: Kind
    calls: Sequence[Call]
    owner: str = ""
    cost: float = 1.0
    remaining: float = 1.0
    begun: Callable[[], None] | None = None
    future: "asyncio.Future[list[CallResult]]" = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )
    results: list[CallResult] = field(default_factory=list)
    crashes: int = 0
    """Workers that the first unfinished call has ended."""
    alone: bool = False
    """True if its calls are run one at a time, because one of them, not yet identified, has killed a worker."""
    losses: int = 0
    """Workers of a cluster that were given it and did not bring it to its end."""
    number: int = field(default_factory=lambda: next(_numbers))
    """Place among work of equal cost, which keeps its order of arrival."""

    @property
    def left(self) -> Sequence[Call]:
        """Calls to give a worker now: all unfinished ones, but a call that has ended a worker goes alone."""
        first = len(self.results)
        return self.calls[first : first + 1 if self.crashes or self.alone else None]

    @property
    def cost_left(self) -> float:
        """Cost of the unfinished calls."""
        return self.cost * (len(self.calls) - len(self.results)) / max(1, len(self.calls))

    def begin(self) -> None:
        """Note that a worker has taken it, the first time."""
        begun, self.begun = self.begun, None
        if begun is not None:
            begun()

    def finish(self, result: CallResult) -> None:
        """Note the outcome of the first unfinished call."""
        self.results.append(result)
        self.crashes = 0

    def fail(self, error: Exception) -> None:
        """End the work with an error, unless it has ended."""
        if not self.future.done():
            self.future.set_exception(error)

    @property
    def order(self) -> tuple[float, int, int]:
        """Key that the work of one owner is sorted by."""
        return self.remaining, self.kind, self.number


Accepts = Callable[[Work], bool]
"""True if a worker can run this work."""


class Server(NamedTuple):
    """A server that waits for work.

    Parameters
    ----------
    worker
        Name of the worker that it serves, if others serve it too.
    places
        Number of servers of that worker.
    """

    accepts: Accepts
    worker: str
    places: int


class WorkQueue:
    """Work that waits, and the servers that wait for work. Belongs to one event loop."""

    def __init__(self) -> None:
        self._probes: deque[Work] = deque()
        self._lines: dict[str, list[Work]] = {}
        """Waiting work by owner, in order."""
        self._times: dict[str, float] = {}
        """Virtual time at which the next work of an owner begins."""
        self._now = 0.0
        """Virtual time of the work that was taken last."""
        self._servers: dict[asyncio.Future[Work], Server] = {}
        self._chunks: dict[Work, Callable[[], None]] = {}
        """Running chunks, and how to ask each to make way."""
        self.unavailable = ""
        """Why there is no worker in the pool; empty if there is one, or one is being started."""
        self.singles = 0
        """Number of single calls that wait."""

    @property
    def waiting(self) -> list[Work]:
        """All work that waits."""
        return [*self._probes, *(work for line in self._lines.values() for work in line)]

    def put(self, work: Work) -> None:
        """Add work; if no server is free, one that runs a chunk is asked to make way for it, unless it is a chunk."""
        self._add(work)
        work.future.add_done_callback(lambda _: self._remove(work))
        self.hand_out()
        if work.kind is not Kind.CHUNK and self._waits(work) and self._chunks:
            self._chunks.pop(next(iter(self._chunks)))()

    def put_back(self, work: Work) -> None:
        """Add work that a server has not finished, ahead of what came after it; its owner gets the cost back."""
        self._times[work.owner] = self._times.get(work.owner, self._now) - work.cost_left
        if not work.future.done():
            self._add(work)
            self.hand_out()

    async def get(self, accepts: Accepts = lambda _: True, worker: str = "", places: int = 1) -> Work:
        """Take the next work that is accepted, as soon as there is one.

        Of several workers, that one is served first which has the largest part of its places free.
        """
        turn = asyncio.get_running_loop().create_future()
        self._servers[turn] = Server(accepts, worker, places)
        self.hand_out()
        try:
            work: Work = await turn
        except asyncio.CancelledError:
            self._servers.pop(turn, None)
            if turn.done() and not turn.cancelled():  # It was given work just before it was cancelled.
                self.put_back(turn.result())
            raise
        else:
            return work

    def hand_out(self) -> None:
        """Give waiting work to servers that wait; to be called too when what they accept has changed."""
        while (self._probes or self._lines) and self._hand_out_one():
            pass

    def _hand_out_one(self) -> bool:
        """Give one piece of work to the server whose worker has most room; return whether one has taken any."""
        free = Counter(server.worker for server in self._servers.values())
        by_room = sorted(self._servers.items(), key=lambda item: -free[item[1].worker] / item[1].places)
        for turn, server in by_room:
            work = None if turn.done() else self._take(server.accepts)
            if work is not None:
                del self._servers[turn]
                turn.set_result(work)
                return True
        return False

    def begin_chunk(self, work: Work, make_way: Callable[[], None]) -> None:
        """Note a running chunk; `make_way` is called, at most once, when it should let other work pass."""
        self._chunks[work] = make_way

    def end_chunk(self, work: Work) -> None:
        """Forget a chunk that no longer runs."""
        self._chunks.pop(work, None)

    def make_room(self, owner: str, error: Exception) -> bool:
        """Refuse the newest single call of the owner with most of them, if another of `owner` would still be fewer.

        Returns whether there was one, which gets this error.
        """
        singles = {name: [work for work in line if work.kind is Kind.SINGLE] for name, line in self._lines.items()}
        most = max(singles.values(), key=len, default=[])
        if len(most) <= len(singles.get(owner, ())) + 1:
            return False
        newest = max(most, key=lambda work: work.number)
        newest.fail(error)
        self._remove(newest)
        return True

    def fail_all(self, error: Exception, accepts: Accepts = lambda _: True) -> None:
        """End all work that waits, or what a server that waits in vain would accept."""
        for work in filter(accepts, self.waiting):
            work.fail(error)
            self._remove(work)

    def _add(self, work: Work) -> None:
        if work.kind is Kind.PROBE:
            self._probes.append(work)
            return
        if work.owner not in self._lines:
            self._lines[work.owner] = []
            self._times[work.owner] = max(self._now, self._times.get(work.owner, 0.0))
        insort(self._lines[work.owner], work, key=lambda each: each.order)
        self.singles += work.kind is Kind.SINGLE

    def _waits(self, work: Work) -> bool:
        return work in self._probes if work.kind is Kind.PROBE else work in self._lines.get(work.owner, ())

    def _remove(self, work: Work) -> None:
        """Remove work if it waits."""
        if not self._waits(work):
            return
        if work.kind is Kind.PROBE:
            self._probes.remove(work)
            return
        line = self._lines[work.owner]
        line.remove(work)
        self.singles -= work.kind is Kind.SINGLE
        if not line:
            del self._lines[work.owner]

    def _take(self, accepts: Accepts) -> Work | None:
        if self._probes and accepts(self._probes[0]):
            return self._probes.popleft()
        for owner in sorted(self._lines, key=self._times.__getitem__):
            for work in self._lines[owner]:
                if accepts(work):
                    self._remove(work)
                    self._charge(work)
                    return work
        return None

    def _charge(self, work: Work) -> None:
        """Let the virtual time of the owner go on, and forget owners that would begin anew at the present time."""
        self._now = max(self._now, self._times[work.owner])
        self._times[work.owner] += work.cost_left
        for owner in [name for name, time in self._times.items() if time <= self._now and name not in self._lines]:
            del self._times[owner]
