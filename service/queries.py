"""Answers single queries: looks them up, shares computations in flight, computes and keeps the rest."""

import asyncio
import logging
import math
import secrets
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, TypeVarTuple

from anyio import CancelScope, current_time
from anyio.to_thread import run_sync

from service.cache.cache import ResultCache
from service.cache.hdf5 import Segment
from service.cache.record import Record
from service.errors import ComputationCancelled, QueriesWaitingError, QueueTimeoutError
from service.operations import KeyedRequest, Operation
from service.schemas.calibration_motion import Calibration
from service.schemas.requests import Case
from service.workers import Call, CallResult
from service.workers.executor import Executor
from service.workers.worker import close_chunk, compute_case, compute_single
from solver import ParameterError
from solver.warnings import IMPLAUSIBLE

MEMORY_SECONDS = 30.0
"""Time over which a rate is measured: it covers a few chunks of slow work and forgets what is older."""
SHORTEST_SECONDS = 0.05
"""Shortest time that a rate is measured over: the first chunk of a job may take less."""
STEP_SECONDS = 0.5
"""Cases done within this time share one entry, so that the list of entries stays short."""
LONGEST_WAIT_SECONDS = 3600
"""Longest wait that is announced: a measured rate says nothing about a later time."""
CASE_SECONDS = 0.02
"""Time of an ordinary case on one core, assumed as long as no rate has been measured."""
ABANDONED_SECONDS = 0.5
"""Time that a running query has after its last client has left: an ordinary one ends, and its result is kept."""


def check_work(case: Any, most: float) -> None:
    """Refuse a case whose runs could take longer than the time limit of a computation.

    Raises
    ------
    ParameterError
        If the product of panels and time steps is above `most`.
    """
    work = case.panel_steps() if isinstance(case, Case | Calibration) else 0.0
    if work > most:
        raise ParameterError(
            "numerics.panels",
            f"times the termination time over `time_step_s` must be at most {most:g}, got {work:g}: take fewer panels, "
            "longer steps or an earlier end",
        )


class Rate:
    """Measures how many cases are done in a second of work; time in which there is nothing to do does not count.

    Parameters
    ----------
    cores
        Returns how many cases are computed at the same time.
    clock
        Returns the time. [s]
    """

    def __init__(self, cores: Callable[[], int], clock: Callable[[], float] = time.monotonic) -> None:
        self._cores = cores
        self._clock = clock
        self._entries: deque[tuple[float, int]] = deque()
        self._count = 0
        self._begin = 0.0
        """Time since which the entries count. [s]"""
        self._at_work = 0
        self._paused = self._idle = clock()
        """When work ended, and time without any. [s]"""

    @contextmanager
    def working(self) -> Iterator[None]:
        """Let time count, as long as this or another piece of work lasts."""
        if not self._at_work:
            self._idle += self._clock() - self._paused
        self._at_work += 1
        try:
            yield
        finally:
            self._at_work -= 1
            self._paused = self._clock()

    def add(self, count: int) -> None:
        """Count cases that have just been done."""
        now = self._now()
        self._count += count
        if self._entries and now - self._entries[-1][0] < STEP_SECONDS:
            began, before = self._entries.pop()
            self._entries.append((began, before + count))
        else:
            self._entries.append((now, count))
        self._forget(now)

    @property
    def per_second(self) -> float:
        """Mean over the last `MEMORY_SECONDS` of work; 0 if no case was done in them."""
        now = self._now()
        self._forget(now)
        if not self._entries:
            return 0.0
        return self._count / max(now - self._begin, SHORTEST_SECONDS)

    def seconds_for(self, count: int, weight: int = 1) -> int:
        """Whole seconds until so many more cases are done, at least 1; `weight` counts if no rate has been measured."""
        rate = self.per_second or self._cores() / (CASE_SECONDS * weight)
        return min(LONGEST_WAIT_SECONDS, max(1, math.ceil(count / rate)))

    def _now(self) -> float:
        """Time that has been worked. [s]"""
        return (self._clock() if self._at_work else self._paused) - self._idle

    def _forget(self, now: float) -> None:
        while self._entries and now - self._entries[0][0] > MEMORY_SECONDS:
            self._begin, count = self._entries.popleft()
            self._count -= count


Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")
CacheStatus: TypeAlias = Literal["hit", "miss"]
Answered: TypeAlias = tuple[Record, CacheStatus]

Count: TypeAlias = Callable[[str, str, str, int], None]
"""Function that counts cases that are done: operation, outcome, `hit` or `miss`, number."""

log = logging.getLogger(__name__)

IMPLAUSIBLE_MARK = f'"code":"{IMPLAUSIBLE}"'.encode()
"""Text that the JSON of an answer contains if and only if it has this warning."""
MAX_WAITING = 1000
"""Number of single queries that may wait for a worker: at 10 ms each, a few seconds of work."""
QUEUE_SECONDS = 30.0
"""Longest time that a single query waits for a worker."""


class QueryService:
    """Answers single queries, and computes chunks of cases.

    Parameters
    ----------
    cache
        Keeps the records.
    executor
        Computes them.
    operations
        What can be computed, by name.
    max_waiting
        Single queries that may wait for a worker.
    queue_seconds
        Longest that one waits for a worker. [s]
    count
        Counts single queries that are answered.
    """

    def __init__(
        self,
        cache: ResultCache,
        executor: Executor,
        operations: Mapping[str, Operation],
        *,
        max_waiting: int = MAX_WAITING,
        queue_seconds: float = QUEUE_SECONDS,
        count: Count = lambda *_: None,
    ) -> None:
        self.cache = cache
        self.executor = executor
        self.operations = operations
        self._max_waiting = max_waiting
        self._count = count
        self._queue_seconds = queue_seconds
        self._rate = Rate(lambda: executor.single_capacity)
        self._work = 0
        """Work of the single queries that wait or run, in ordinary cases."""
        self._submitted = 0
        """Number of single queries that wait or run."""
        self._in_flight: dict[str, asyncio.Future[Answered]] = {}
        self._running: set[asyncio.Future[Answered]] = set()
        """Single queries that a worker has."""
        self._queued: set[asyncio.Future[Answered]] = set()
        """Answers in flight whose chunk waits for a worker."""
        self._clients: Counter[asyncio.Future[Answered]] = Counter()
        """Number of clients that wait for each."""
        self.implausible = 0
        """Number of computed answers that break a rule which every correct answer keeps."""

    @property
    def queued(self) -> int:
        """Single queries that wait for a worker."""
        return self.executor.queue.singles

    def seconds_until_done(self) -> int:
        """Whole seconds until the single queries that wait or run now are likely to be done, at least 1.

        By the measured rate, but no query runs beyond its time limit. The second matters for large queries that all
        end at the limit: none of them counts as done, so that their work seems to take hours at the assumed rate.
        """
        longest = math.ceil(self._submitted * self.executor.task_seconds / max(1, self.executor.single_capacity))
        return max(1, min(self._rate.seconds_for(self._work), longest))

    async def answer(self, operation: str, request: KeyedRequest, owner: str = "") -> Answered:
        """Return the record of the request, and whether it was there already.

        Equal requests in flight share one computation, in the turn of the owner who was first. When all have left, it
        is given up: at once while it waits for a worker, after `ABANDONED_SECONDS` when it runs.

        Raises
        ------
        QueriesWaitingError
            If too many wait for a worker, or this one has waited too long.
        """
        record = self.cache.recall(request.key)
        if record is not None:
            self._count(operation, record.outcome, "hit", 1)
            return record, "hit"
        while True:
            found = self.in_flight([request.key], queued=False).get(request.key)
            shared = found is not None
            if found is None:
                found = asyncio.create_task(self._find(operation, request, owner))
                self._in_flight[request.key] = found
                found.add_done_callback(lambda done: self._forget(request.key, done))
            with suppress(ComputationCancelled):
                answered = await self._wait_for(request.key, found)
                if shared or answered[1] == "hit":
                    self._count(operation, answered[0].outcome, "hit", 1)
                return answered

    async def result(self, key: str) -> Record | None:
        """Return the record of this key, if there is one."""
        return self.cache.recall(key) or await run_sync(self.cache.get, key)

    def in_flight(self, keys: Iterable[str], *, queued: bool = True) -> dict[str, "asyncio.Future[Answered]"]:
        """Return the answers with these keys that are being computed; to be waited for, never to be cancelled.

        One that is given up raises `ComputationCancelled`.

        Parameters
        ----------
        queued
            Whether to include those whose chunk waits for its turn: it may be the turn of an owner with much to do.
        """
        found = {key: self._in_flight[key] for key in keys if key in self._in_flight}
        return {key: future for key, future in found.items() if queued or future not in self._queued}

    async def compute(
        self,
        operation: str,
        cases: Sequence[KeyedRequest],
        *,
        owner: str = "",
        remaining: float = 0.0,
        begun: Callable[[], None] = lambda: None,
        longest: float | None = None,
    ) -> "Chunk":
        """Compute and keep a chunk of cases, no two alike and none in flight; from the call on, others share them.

        Parameters
        ----------
        owner
            In whose turn it is computed.
        remaining
            Cost of all that is left of the job. [ordinary cases]
        begun
            Called when a worker takes it.
        longest
            Time after which it is given up, from then on. [s]
        """
        loop = asyncio.get_running_loop()
        futures: dict[str, asyncio.Future[Answered]] = {case.key: loop.create_future() for case in cases}
        outcomes: Sequence[Record | Exception] = [ComputationCancelled()] * len(cases)
        results: Sequence[CallResult] | None = None
        limit = CancelScope()
        compute, chunk = self.operations[operation].compute, secrets.token_hex(8)
        calls: list[Call] = [(compute_case, (compute, operation, case.key, case.json, chunk)) for case in cases]
        calls.append((close_chunk, (chunk,)))
        cost = len(cases) * self.operations[operation].weight

        def taken() -> None:
            if longest is not None:
                limit.deadline = current_time() + longest
            self._queued.difference_update(futures.values())
            begun()

        self._in_flight |= futures
        self._queued.update(futures.values())
        try:
            with limit:
                results = await self.executor.run(calls, owner=owner, cost=cost, remaining=remaining, begun=taken)
            if results is not None:
                with CancelScope(shield=True):  # What has been computed is kept before anything that waits goes on.
                    outcomes = await run_sync(self._put, operation, cases, results)
        except Exception as error:  # noqa: BLE001 (raised where the cases are waited for)
            outcomes = [error] * len(cases)
        finally:
            self._queued.difference_update(futures.values())
            for key, future in futures.items():  # This comes first, as a key that stays here is never answered again.
                if self._in_flight.get(key) is future:
                    del self._in_flight[key]
            for future, outcome in zip(futures.values(), outcomes, strict=True):
                if isinstance(outcome, Record):
                    future.set_result((outcome, "miss"))
                else:
                    future.set_exception(outcome)
                    future.exception()  # Retrieved, so that asyncio does not report it if nothing waits.
        seconds = [result.seconds for result in (results or ())[: len(cases)]]
        nbytes = sum(len(outcome.json) for outcome in outcomes if isinstance(outcome, Record))
        return Chunk(futures, seconds, nbytes, limit.cancelled_caught)

    async def _wait_for(self, key: str, found: "asyncio.Future[Answered]") -> Answered:
        """Wait for an answer in flight; the last client to leave gives a single query up."""
        self._clients[found] += 1
        try:
            return await asyncio.shield(found)
        finally:
            self._clients[found] -= 1
            if not self._clients[found]:
                del self._clients[found]
                if found in self._running:
                    asyncio.get_running_loop().call_later(ABANDONED_SECONDS, self._give_up, key, found)
                elif isinstance(found, asyncio.Task):  # Cases of a chunk are not tasks; their chunk gives them up.
                    self._give_up(key, found)

    def _give_up(self, key: str, found: "asyncio.Future[Answered]") -> None:
        """Cancel a single query, unless it is done or somebody waits for it again."""
        if not found.done() and not self._clients[found]:
            self._forget(key, found)
            found.cancel()

    async def _find(self, operation: str, request: KeyedRequest, owner: str) -> Answered:
        record = await run_sync(self.cache.get, request.key)
        if record is not None:
            return record, "hit"
        json, outcome = await self._compute(operation, request, owner)
        self._rate.add(request.work)
        self._count(operation, outcome, "miss", 1)
        record = self._record(operation, request, json, outcome)
        return await run_sync(self.cache.put, record), "miss"

    async def _compute(self, operation: str, request: KeyedRequest, owner: str) -> tuple[bytes, str]:
        """Compute one request when it is its owner's turn."""
        return await self.submit(
            compute_single,
            self.operations[operation].compute,
            operation,
            request.key,
            request.json,
            owner=owner,
            cost=request.work,
            begun=partial(self._running.add, self._in_flight[request.key]),
        )

    async def submit(
        self,
        function: Callable[[*Arguments], Result],
        *arguments: *Arguments,
        owner: str,
        cost: int,
        begun: Callable[[], None] = lambda: None,
    ) -> Result:
        """Run a function in a worker when it is its owner's turn, as `Executor.submit` does.

        Raises
        ------
        QueriesWaitingError
            If too many wait for a worker, or this one has waited too long.
        """
        queue, busy = self.executor.queue, QueriesWaitingError(self.seconds_until_done())
        if queue.singles >= self._max_waiting and not queue.make_room(owner, busy):
            raise busy
        self._work += cost
        self._submitted += 1
        try:
            with self._rate.working():
                return await self.executor.submit(
                    function, *arguments, owner=owner, cost=cost, begun=begun, longest_wait=self._queue_seconds
                )
        except QueueTimeoutError:
            # It has waited this long behind cheaper work of its owner, jobs among it, that `_work` does not count:
            # nothing says that another attempt would wait less.
            seconds = max(self.seconds_until_done(), math.ceil(self._queue_seconds))
            raise QueriesWaitingError(seconds) from None
        finally:
            self._work -= cost
            self._submitted -= 1

    def _put(
        self, operation: str, cases: Sequence[KeyedRequest], results: Sequence[CallResult]
    ) -> list[Record | Exception]:
        """Keep the results of a chunk, in one file."""
        outcomes: list[Record | Exception] = []
        for case, result in zip(cases, results[: len(cases)], strict=True):
            if result.error is not None:
                outcomes.append(result.error)
            else:
                json, outcome = result.value
                outcomes.append(self._record(operation, case, json, outcome))
        records = {outcome.key: outcome for outcome in outcomes if isinstance(outcome, Record)}
        known = self.cache.known(list(records))  # another chunk may have kept some since they were looked up
        segments: Sequence[Segment] = results[-1].value or () if results and results[-1].error is None else ()
        missing = [record for key, record in records.items() if key not in known]
        segments = [segment for segment in segments if all(key in records and key not in known for key in segment[0])]
        records |= {record.key: record for record in self.cache.put_many(missing, segments)}
        return [records[outcome.key] if isinstance(outcome, Record) else outcome for outcome in outcomes]

    def _record(self, operation: str, request: KeyedRequest, json: bytes, outcome: str) -> Record:
        """Return the record of a computed answer; log and count an implausible one."""
        if IMPLAUSIBLE_MARK in json:
            self.implausible += 1
            log.warning("implausible answer of %s, result %s: %s", operation, request.key, request.json.decode())
        return Record(request.key, operation, request.json, json=json, outcome=outcome)

    def _forget(self, key: str, task: "asyncio.Future[Answered]") -> None:
        self._running.discard(task)
        if self._in_flight.get(key) is task:
            del self._in_flight[key]
        if task.done() and not task.cancelled():
            task.exception()  # Retrieved, so that asyncio does not report it if nothing waits.


class Chunk(NamedTuple):
    """A chunk of cases that has been computed, or given up.

    Parameters
    ----------
    answers
        Answers by key.
    seconds
        Time that each case took in its worker; empty if no worker has computed the chunk.
    nbytes
        Size of all answers.
    late
        Whether it was given up because it took too long.
    """

    answers: Mapping[str, "asyncio.Future[Answered]"]
    seconds: Sequence[float]
    nbytes: int
    late: bool
