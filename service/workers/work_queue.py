"""Fair priority queue of work for the workers.

Owners share the workers equally by start-time fair queueing (Goyal, Vin and Cheng, 1996). Each owner has a virtual
time, which grows by the cost of the owner's work when a worker takes it, and the owner with the least virtual time is
served next. An owner who was idle starts at the present virtual time, and so gains no credit for idle time. Within an
owner, the work with the least remaining cost comes first.
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
    """Kinds of work. Probes and single calls may interrupt a running chunk between two of its calls; chunks cannot."""

    PROBE = 0
    SINGLE = 1
    CHUNK = 2


_numbers = count()


@dataclass(eq=False, slots=True)
class Work:
    """Item of the queue: calls that one worker runs one after the other.

    Parameters
    ----------
    owner
        Owner whose share of the workers the work counts against.
    cost
        Cost of all calls. [ordinary cases]
    remaining
        Remaining cost of the request or job that the work belongs to. The work of an owner with the least remaining
        cost is taken first. [ordinary cases]
    begun
        Function called once, when a worker first takes the work.
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
    """Number of workers that the first unfinished call has killed."""
    alone: bool = False
    """True if the calls are run one at a time, because one of them, not yet identified, has killed a worker."""
    losses: int = 0
    """Number of workers of a cluster that took the work and did not return it."""
    number: int = field(default_factory=lambda: next(_numbers))
    """Serial number, so that of two items with equal remaining cost and kind the earlier one is taken first."""

    @property
    def left(self) -> Sequence[Call]:
        """Unfinished calls to send to a worker: all of them, or only the first if a call has killed a worker."""
        first = len(self.results)
        return self.calls[first : first + 1 if self.crashes or self.alone else None]

    @property
    def cost_left(self) -> float:
        """Cost of the unfinished calls. [ordinary cases]"""
        return self.cost * (len(self.calls) - len(self.results)) / max(1, len(self.calls))

    def begin(self) -> None:
        """Call `begun` if a worker takes the work for the first time."""
        begun, self.begun = self.begun, None
        if begun is not None:
            begun()

    def finish(self, result: CallResult) -> None:
        """Set the result of the first unfinished call."""
        self.results.append(result)
        self.crashes = 0

    def fail(self, error: Exception) -> None:
        """Set an error as the outcome of the work, unless it has an outcome already."""
        if not self.future.done():
            self.future.set_exception(error)

    @property
    def order(self) -> tuple[float, int, int]:
        """Sort key of the work of one owner."""
        return self.remaining, self.kind, self.number


Accepts = Callable[[Work], bool]
"""Function that returns True for work that a server may take."""


def any_work(_: Work) -> bool:
    """Accept any work."""
    return True


class Server(NamedTuple):
    """Task that is waiting for work to send to a worker.

    Parameters
    ----------
    worker
        Name of the worker; empty if the worker has only one server.
    places
        Number of servers of that worker.
    """

    accepts: Accepts
    worker: str
    places: int


class WorkQueue:
    """Queue of work and of servers that are waiting for work. It belongs to one event loop."""

    def __init__(self) -> None:
        self._probes: deque[Work] = deque()
        self._lines: dict[str, list[Work]] = {}
        """Waiting work of each owner, sorted by `Work.order`."""
        self._times: dict[str, float] = {}
        """Virtual time of each owner. [ordinary cases]"""
        self._now = 0.0
        """Present virtual time: the largest that an owner had when work of that owner was taken. [ordinary cases]"""
        self._servers: dict[asyncio.Future[Work], Server] = {}
        self._chunks: dict[Work, Callable[[], None]] = {}
        """Running chunks that have not been interrupted, each with the function that interrupts it for other work."""
        self.unavailable = ""
        """Reason why the pool has no worker: the latest failed start; empty if it has one, or none has failed yet."""
        self.singles = 0
        """Number of waiting single calls."""

    @property
    def waiting(self) -> list[Work]:
        """All waiting work: probes, and then the work of each owner."""
        return [*self._probes, *(work for line in self._lines.values() for work in line)]

    def put(self, work: Work) -> None:
        """Add work. If no server is free for a probe or a single call, one running chunk is interrupted for it."""
        self._add(work)
        work.future.add_done_callback(lambda _: self._remove(work))
        self.hand_out()
        if work.kind is not Kind.CHUNK and self._waits(work) and self._chunks:
            self._chunks.pop(next(iter(self._chunks)))()

    def put_back(self, work: Work) -> None:
        """Return work to its former place in the queue, and refund the cost of the unfinished calls to its owner."""
        self._times[work.owner] = self._times.get(work.owner, self._now) - work.cost_left
        if not work.future.done():
            self._add(work)
            self.hand_out()

    async def get(self, accepts: Accepts = any_work, worker: str = "", places: int = 1) -> Work:
        """Wait for work for which `accepts` returns True, and take it from the queue.

        Among several workers, the one with the largest fraction of idle servers is served first.
        """
        turn = asyncio.get_running_loop().create_future()
        self._servers[turn] = Server(accepts, worker, places)
        self.hand_out()
        try:
            work: Work = await turn
        except asyncio.CancelledError:
            self._servers.pop(turn, None)
            if turn.done() and not turn.cancelled():  # Work was assigned to this server just before the cancellation.
                self.put_back(turn.result())
            raise
        else:
            return work

    def hand_out(self) -> None:
        """Give waiting work to waiting servers. Must be called when an `accepts` function changes its result."""
        while (self._probes or self._lines) and self._hand_out_one():
            pass

    def _hand_out_one(self) -> bool:
        """Give one item to a server; return False if no server takes one.

        Servers of the worker with the largest fraction of idle servers come first.
        """
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
        """Register a running chunk. `make_way` is called at most once, to interrupt the chunk for other work."""
        self._chunks[work] = make_way

    def end_chunk(self, work: Work) -> None:
        """Remove a chunk that is no longer running."""
        self._chunks.pop(work, None)

    def make_room(self, owner: str, error: Exception) -> bool:
        """Evict the newest single call of the owner with the most of them, if `owner` has at least two fewer.

        Only calls in the queue count. Return True if a call was evicted; the evicted call fails with `error`.
        """
        singles = {name: [work for work in line if work.kind is Kind.SINGLE] for name, line in self._lines.items()}
        most = max(singles.values(), key=len, default=[])
        if len(most) <= len(singles.get(owner, ())) + 1:
            return False
        newest = max(most, key=lambda work: work.number)
        newest.fail(error)
        self._remove(newest)
        return True

    def fail_all(self, error: Exception, accepts: Accepts = any_work) -> None:
        """Fail the waiting work for which `accepts` returns True, by default all."""
        for work in filter(accepts, self.waiting):
            work.fail(error)
            self._remove(work)

    def _add(self, work: Work) -> None:
        if work.kind is Kind.PROBE:
            self._probes.append(work)
            return
        if work.owner not in self._lines:
            self._lines[work.owner] = []
            # An owner who was idle starts at the present virtual time; one who was ahead of it stays ahead.
            self._times[work.owner] = max(self._now, self._times.get(work.owner, 0.0))
        insort(self._lines[work.owner], work, key=lambda each: each.order)
        self.singles += work.kind is Kind.SINGLE

    def _waits(self, work: Work) -> bool:
        return work in self._probes if work.kind is Kind.PROBE else work in self._lines.get(work.owner, ())

    def _remove(self, work: Work) -> None:
        """Remove work if it is in the queue."""
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
        """Advance the virtual time of the owner by the cost of the unfinished calls."""
        self._now = max(self._now, self._times[work.owner])
        self._times[work.owner] += work.cost_left
        # An owner without work whose virtual time has passed would start at the present time anyway. Such owners are
        # removed to keep the table small.
        for owner in [name for name, time in self._times.items() if time <= self._now and name not in self._lines]:
            del self._times[owner]
