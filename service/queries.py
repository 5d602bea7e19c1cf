"""Single queries: cache lookup, sharing of computations in flight, computation by a worker, storage of the result."""

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
from service.cache.record import Record
from service.cache.segments import Segment
from service.errors import ComputationCancelled, QueriesWaitingError, QueueTimeoutError
from service.operations import KeyedRequest, Operation
from service.schemas.calibration_motion import Calibration
from service.schemas.requests import Case
from service.workers import Call, CallResult
from service.workers.executor import Executor
from service.workers.worker import close_chunk, compute_case, compute_single
from solver import ParameterError
from solver.units import Amount
from solver.warnings import IMPLAUSIBLE

MEMORY_SECONDS = 30.0
"""Window over which the rate is measured [s]: it covers a few chunks of slow work, but not the work of earlier jobs."""
SHORTEST_SECONDS = 0.05
"""Shortest window [s]. The first chunk of a job may take less time, which would give a nearly infinite rate."""
STEP_SECONDS = 0.5
"""Time within which completed cases share one entry of the window, which limits it to about 60 entries. [s]"""
LONGEST_WAIT_SECONDS = 3600
"""Longest wait that is announced [s]. A rate measured over half a minute does not predict longer waits."""
CASE_SECONDS = 0.02
"""Assumed time of an ordinary case on one core until a rate has been measured [s]; such cases take 10 to 20 ms."""
ABANDONED_SECONDS = 0.5
"""Time for which a running query continues after its last client has left [s], enough for an ordinary query to be
completed and cached."""


def check_work(case: Any, most: float) -> None:
    """Refuse a request with the method `panels` that has too many panels and time steps.

    Raises
    ------
    ParameterError
        If the product of panels and time steps is above `most`.
    """
    work = case.panel_steps() if isinstance(case, Case | Calibration) else 0.0
    if work > most:
        raise ParameterError(
            "numerics.panels",
            "times the termination time over `time_step_s` must be at most {}, got {}: take fewer panels, longer steps "
            "or an earlier end",
            Amount(most, ""),
            Amount(work, ""),
        )


class Rate:
    """Rate at which cases are completed, measured over a sliding window in which idle time does not count.

    Parameters
    ----------
    cores
        Function that returns the number of cases that are computed at the same time.
    clock
        Function that returns the time. [s]
    """

    def __init__(self, cores: Callable[[], int], clock: Callable[[], float] = time.monotonic) -> None:
        self._cores = cores
        self._clock = clock
        self._entries: deque[tuple[float, int]] = deque()
        self._count = 0
        self._begin = 0.0
        """Start of the window, in busy time. [s]"""
        self._at_work = 0
        self._paused = self._idle = clock()
        """Time at which work last ended, and the idle time so far, counted from the origin of the clock. [s]"""

    @contextmanager
    def working(self) -> Iterator[None]:
        """Count the time during the block as busy. Blocks may overlap."""
        if not self._at_work:
            self._idle += self._clock() - self._paused
        self._at_work += 1
        try:
            yield
        finally:
            self._at_work -= 1
            self._paused = self._clock()

    def add(self, count: int) -> None:
        """Count cases that have just been completed."""
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
        """Mean rate over the last `MEMORY_SECONDS` of work; 0 if no case was completed. [1/s]"""
        now = self._now()
        self._forget(now)
        if not self._entries:
            return 0.0
        return self._count / max(now - self._begin, SHORTEST_SECONDS)

    def seconds_for(self, count: int, weight: int = 1) -> int:
        """Return the estimated time until `count` more cases are done, in whole seconds and at least 1. [s]

        `weight`, the cost of a case, is used only while no rate has been measured.
        """
        rate = self.per_second or self._cores() / (CASE_SECONDS * weight)
        return min(LONGEST_WAIT_SECONDS, max(1, math.ceil(count / rate)))

    def _now(self) -> float:
        """Return the busy time so far. [s]"""
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
"""Function that counts answered cases. Its arguments are the operation, the outcome, `hit` or `miss`, and the number of
cases."""

log = logging.getLogger(__name__)

IMPLAUSIBLE_MARK = f'"code":"{IMPLAUSIBLE}"'.encode()
"""Bytes that the JSON of an answer contains if and only if it has the warning `implausible`. Searching for them is
cheaper than parsing every answer."""
MAX_WAITING = 1000
"""Default limit on the number of single queries that wait for a worker: at 10 ms each, they keep one worker
busy for 10 s."""
QUEUE_SECONDS = 30.0
"""Default queue timeout of a single query, shorter than the 60 s after which proxies give up. [s]"""


class QueryService:
    """Service that answers single queries and computes chunks of jobs.

    Parameters
    ----------
    cache
        Cache in which results are looked up and stored.
    executor
        Executor that computes results.
    operations
        Operations, keyed by name.
    max_waiting
        Largest number of single queries that wait for a worker.
    queue_seconds
        Longest time that a single query waits for a worker. [s]
    count
        Function that counts answered single queries.
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
        """Cost of the single queries that wait or run. [ordinary cases]"""
        self._submitted = 0
        """Number of single queries that wait or run."""
        self._in_flight: dict[str, asyncio.Future[Answered]] = {}
        self._running: set[asyncio.Future[Answered]] = set()
        """Single queries that a worker is computing."""
        self._queued: set[asyncio.Future[Answered]] = set()
        """Answers in flight whose chunk is still in the queue."""
        self._clients: Counter[asyncio.Future[Answered]] = Counter()
        """Number of clients that wait for each answer in flight."""
        self.implausible = 0
        """Number of computed answers with the warning `implausible`, each a fault of the program."""

    @property
    def queued(self) -> int:
        """Number of single queries that wait for a worker."""
        return self.executor.queue.singles

    def seconds_until_done(self) -> int:
        """Return the estimated time until the present single queries are done, in whole seconds and at least 1. [s]

        The estimate from the measured rate is capped by the time limits of the queries. The cap matters if large
        queries all run into their limit: none of them is completed, and at the assumed rate their work seems to take
        hours.
        """
        longest = math.ceil(self._submitted * self.executor.task_seconds / max(1, self.executor.single_capacity))
        return max(1, min(self._rate.seconds_for(self._work), longest))

    async def answer(self, operation: str, request: KeyedRequest, owner: str = "") -> Answered:
        """Return the record of a request, and whether it came from the cache.

        Equal requests in flight share one computation, queued for the owner of the first request. It is cancelled when
        all their clients have left: at once while it is queued, after `ABANDONED_SECONDS` while it runs.

        Raises
        ------
        QueriesWaitingError
            If the queue is full, or this query has waited too long.
        """
        record = self.cache.recall(request.key)
        if record is not None:
            self._count(operation, record.outcome, "hit", 1)
            return record, "hit"
        # The loop repeats only if the shared computation was cancelled by its owner.
        while True:
            # A chunk in the queue is not shared: it may have to wait behind the other work of a busy owner.
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
        """Return the record stored under a key, or None."""
        return self.cache.recall(key) or await run_sync(self.cache.get, key)

    def in_flight(self, keys: Iterable[str], *, queued: bool = True) -> dict[str, "asyncio.Future[Answered]"]:
        """Return the computations in flight with these keys. Callers may wait for them, but must not cancel them.

        A computation that is cancelled by its owner raises `ComputationCancelled`.

        Parameters
        ----------
        queued
            Include cases whose chunk is still queued, possibly behind much other work of its owner.
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
        """Compute and store a chunk of cases.

        From this call on, other chunks share its computations. Single queries share them once a worker has taken the
        chunk.

        Parameters
        ----------
        cases
            Cases with different keys, none of which is in flight.
        owner
            Owner whose share of the workers the chunk counts against.
        remaining
            Cost of the unfinished part of the job. [ordinary cases]
        begun
            Function called when a worker takes the chunk.
        longest
            Timeout of the chunk from the moment a worker takes it; None for no timeout. [s]
        """
        loop = asyncio.get_running_loop()
        futures: dict[str, asyncio.Future[Answered]] = {case.key: loop.create_future() for case in cases}
        outcomes: Sequence[Record | Exception] = [ComputationCancelled()] * len(cases)
        results: Sequence[CallResult] | None = None
        limit = CancelScope()
        compute, chunk = self.operations[operation].compute, secrets.token_hex(8)
        calls: list[Call] = [(compute_case, (compute, operation, case.key, case.json, chunk)) for case in cases]
        calls.append((close_chunk, (chunk,)))
        cost = sum(map(self.operations[operation].cost, cases))

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
                # Results are stored before the futures are set, so that the result of a case marked as done can be
                # read.
                with CancelScope(shield=True):
                    outcomes = await run_sync(self._put, operation, cases, results)
        except Exception as error:  # noqa: BLE001 (set on the futures, and raised where they are awaited)
            outcomes = [error] * len(cases)
        finally:
            self._queued.difference_update(futures.values())
            # The keys are removed before the futures are set: a key that stayed here could never be computed again.
            for key, future in futures.items():
                if self._in_flight.get(key) is future:
                    del self._in_flight[key]
            for future, outcome in zip(futures.values(), outcomes, strict=True):
                if isinstance(outcome, Record):
                    future.set_result((outcome, "miss"))
                else:
                    future.set_exception(outcome)
                    future.exception()  # Retrieving it keeps asyncio from reporting it if nobody awaits the future.
        seconds = [result.seconds for result in (results or ())[: len(cases)]]
        nbytes = sum(len(outcome.json) for outcome in outcomes if isinstance(outcome, Record))
        return Chunk(futures, seconds, nbytes, limit.cancelled_caught)

    async def _wait_for(self, key: str, found: "asyncio.Future[Answered]") -> Answered:
        """Wait for a computation in flight; a single query is cancelled when its last client leaves."""
        self._clients[found] += 1
        try:
            return await asyncio.shield(found)
        finally:
            self._clients[found] -= 1
            if not self._clients[found]:
                del self._clients[found]
                if found in self._running:
                    asyncio.get_running_loop().call_later(ABANDONED_SECONDS, self._give_up, key, found)
                elif isinstance(found, asyncio.Task):  # Cases of a chunk are plain futures, which end with the chunk.
                    self._give_up(key, found)

    def _give_up(self, key: str, found: "asyncio.Future[Answered]") -> None:
        """Cancel a single query, unless it is done or another client is now waiting for it."""
        if not found.done() and not self._clients[found]:
            self._forget(key, found)
            found.cancel()

    async def _find(self, operation: str, request: KeyedRequest, owner: str) -> Answered:
        record = await run_sync(self.cache.get, request.key)
        if record is not None:
            return record, "hit"
        json, outcome = await self.submit(
            compute_single,
            self.operations[operation].compute,
            operation,
            request.key,
            request.json,
            owner=owner,
            cost=request.work,
            begun=partial(self._running.add, self._in_flight[request.key]),
        )
        self._rate.add(request.work)
        self._count(operation, outcome, "miss", 1)
        record = self._record(operation, request, json, outcome)
        return await run_sync(self.cache.put, record), "miss"

    async def submit(
        self,
        function: Callable[[*Arguments], Result],
        *arguments: *Arguments,
        owner: str,
        cost: int,
        begun: Callable[[], None] = lambda: None,
    ) -> Result:
        """Run a function in a worker as `Executor.submit` does, within the limits on waiting queries.

        Raises
        ------
        QueriesWaitingError
            If the queue is full, or this call has waited too long.
        """
        queue = self.executor.queue
        if queue.singles >= self._max_waiting:
            busy = QueriesWaitingError(self.seconds_until_done())
            if not queue.make_room(owner, busy):
                raise busy
        self._work += cost
        self._submitted += 1
        try:
            with self._rate.working():
                return await self.executor.submit(
                    function, *arguments, owner=owner, cost=cost, begun=begun, longest_wait=self._queue_seconds
                )
        except QueueTimeoutError:
            # The query has waited for work that takes precedence, such as jobs of the same owner with less remaining
            # cost. The estimate leaves jobs out, and another attempt may have to wait just as long, so the client is
            # told to wait at least for the longest time in the queue.
            seconds = max(self.seconds_until_done(), math.ceil(self._queue_seconds))
            raise QueriesWaitingError(seconds) from None
        finally:
            self._work -= cost
            self._submitted -= 1

    def _put(
        self, operation: str, cases: Sequence[KeyedRequest], results: Sequence[CallResult]
    ) -> list[Record | Exception]:
        """Store the results of a chunk, and return the record or the error of each case."""
        outcomes: list[Record | Exception] = []
        for case, result in zip(cases, results[: len(cases)], strict=True):
            if result.error is not None:
                outcomes.append(result.error)
            else:
                json, outcome = result.value
                outcomes.append(self._record(operation, case, json, outcome))
        records = {outcome.key: outcome for outcome in outcomes if isinstance(outcome, Record)}
        known = self.cache.known(list(records))  # Another chunk may have stored some of these results in the meantime.
        segments: Sequence[Segment] = results[-1].value or () if results and results[-1].error is None else ()
        missing = [record for key, record in records.items() if key not in known]
        # A file written by a worker is added to the cache without rewriting only if the cache has none of its results.
        segments = [segment for segment in segments if all(key in records and key not in known for key in segment[0])]
        records |= {record.key: record for record in self.cache.put_many(missing, segments)}
        return [records[outcome.key] if isinstance(outcome, Record) else outcome for outcome in outcomes]

    def _record(self, operation: str, request: KeyedRequest, json: bytes, outcome: str) -> Record:
        """Return the record of a computed answer; log and count implausible answers."""
        if IMPLAUSIBLE_MARK in json:
            self.implausible += 1
            log.warning("implausible answer of %s, result %s: %s", operation, request.key, request.json.decode())
        return Record(request.key, operation, request.json, json=json, outcome=outcome)

    def _forget(self, key: str, task: "asyncio.Future[Answered]") -> None:
        self._running.discard(task)
        if self._in_flight.get(key) is task:
            del self._in_flight[key]
        if task.done() and not task.cancelled():
            task.exception()  # Retrieving it keeps asyncio from reporting it if nobody awaits the task.


class Chunk(NamedTuple):
    """A chunk of cases that has been computed or cancelled.

    Parameters
    ----------
    answers
        Futures of the answers, keyed by the key of the result; all of them are done.
    seconds
        Time that each case took in its worker; empty if no worker has computed the chunk. [s]
    nbytes
        Size of all answers. [bytes]
    late
        True if the chunk exceeded its timeout.
    """

    answers: Mapping[str, "asyncio.Future[Answered]"]
    seconds: Sequence[float]
    nbytes: int
    late: bool
