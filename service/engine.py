"""From a request to its record: look it up, share work in flight, run it, keep it."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.admission import Rate
from service.errors import ComputationCancelled, QueriesWaitingError
from service.executors.face import Executor
from service.jobs.slices import Request
from service.keys import SCHEMA_VERSION, result_key
from service.pool.worker import Call, Finished
from service.results.cache import ResultCache
from service.results.record import FloatColumns, Record
from solver import ENGINE_VERSION

__all__ = [
    "CacheStatus",
    "Chunk",
    "ComputationCancelled",
    "Engine",
    "Named",
    "Operation",
    "Request",
    "Wanted",
    "name_request",
]

CacheStatus: TypeAlias = Literal["hit", "miss"]
Answer: TypeAlias = tuple[dict[str, Any], FloatColumns | None]
Answered: TypeAlias = tuple[Record, CacheStatus]
Named: TypeAlias = tuple[str, dict[str, Any]]
"""Key and canonical form of a request."""

CACHE_THREADS = 2
"""Encoding holds the interpreter lock: more threads would only make the event loop wait longer for its turn."""
CHUNK_THREADS = 1
"""Likewise; of their own, so that single queries need not wait for the records of a chunk."""
MOST_WAITING = 1000
"""Single queries that may wait for a worker: at 10 ms each, a few seconds of work."""


@dataclass(frozen=True, slots=True)
class Operation:
    """How one kind of request is computed and answered.

    Parameters
    ----------
    call
        Picklable function and arguments that compute the request, run in a worker.
    answer
        Request and what the worker returned, to the JSON answer without history and the columns of the history.
    parse
        The validated request from the JSON of its canonical form, as batches keep it.
    """

    call: Callable[[Any], Call]
    answer: Callable[[Any, Any], Answer]
    parse: Callable[[bytes], Any]


@dataclass(frozen=True, slots=True)
class Wanted:
    """A case to be computed. Its canonical request may be given as JSON."""

    key: str
    canonical: dict[str, Any] | bytes
    request: Request
    call: Call


class Engine:
    """Answers requests.

    Parameters
    ----------
    cache
        Where records are kept.
    executor
        Where they are computed.
    operations
        What can be asked for, by name.
    most_waiting
        Single queries that may wait for a worker.
    """

    def __init__(
        self,
        cache: ResultCache,
        executor: Executor,
        operations: Mapping[str, Operation],
        *,
        most_waiting: int = MOST_WAITING,
    ) -> None:
        self.cache = cache
        self.operations = operations
        self._executor = executor
        self._most_waiting = most_waiting
        self._rate = Rate()
        self._underway: dict[str, asyncio.Future[Answered]] = {}
        self._threads = CapacityLimiter(CACHE_THREADS)
        self._chunk_threads = CapacityLimiter(CHUNK_THREADS)

    @property
    def width(self) -> int:
        """Chunks that can run at the same time, now."""
        return self._executor.width

    @property
    def places(self) -> int:
        """Chunks that should be begun at the same time, now: some wait, so that no worker does."""
        return self._executor.width + self._executor.spare

    async def answer(self, operation: str, request: Request, named: Named | None = None) -> Answered:
        """Record of the request, and whether it was there already.

        Equal requests underway share one computation. It belongs to none of them: it goes on if whoever asked first,
        or everyone, has left, and its result is kept. Large requests are named before, off the event loop.

        Raises
        ------
        QueriesWaitingError
            If too many wait for a worker.
        """
        key, canonical = named or name_request(operation, request)
        record = self.cache.recall(key)
        if record is not None:
            return record, "hit"
        while True:
            found = self._underway.get(key)
            if found is None:
                found = asyncio.create_task(self._find(key, operation, request, canonical))
                self._underway[key] = found
                found.add_done_callback(lambda done: self._forget(key, done))
            with suppress(ComputationCancelled):
                return await asyncio.shield(found)

    async def result(self, key: str) -> Record | None:
        """Record of this key, if there is one."""
        return self.cache.recall(key) or await run_sync(self.cache.get, key, limiter=self._threads)

    def begin(self, operation: str, wanted: Sequence[Wanted], computed: Callable[[], None]) -> "Chunk":
        """Begin to compute a chunk of cases, no two alike, but for those that are underway already.

        Parameters
        ----------
        computed
            Called when the pool is done with the chunk, however it ended.
        """
        shared = {case.key: self._underway[case.key] for case in wanted if case.key in self._underway}
        own = [case for case in wanted if case.key not in shared]
        loop = asyncio.get_running_loop()
        futures: dict[str, asyncio.Future[Answered]] = {case.key: loop.create_future() for case in own}
        self._underway |= futures
        pool = asyncio.ensure_future(self._executor.run([case.call for case in own]))
        pool.add_done_callback(lambda _: computed())
        kept = asyncio.create_task(self._keep(operation, own, futures, pool))
        return Chunk(futures, shared, pool, kept)

    async def _find(self, key: str, name: str, request: Request, canonical: dict[str, Any]) -> Answered:
        record = await run_sync(self.cache.get, key, limiter=self._threads)
        if record is not None:
            return record, "hit"
        queued = self._executor.queued
        if queued >= self._most_waiting:
            raise QueriesWaitingError(self._rate.seconds_for(queued))
        operation = self.operations[name]
        function, arguments = operation.call(request)
        result = await self._executor.submit(function, *arguments)
        self._rate.add(1)

        def keep() -> Record:
            answer, history = operation.answer(request, result)
            return self.cache.put(Record(key, name, canonical, answer, history, ENGINE_VERSION, SCHEMA_VERSION))

        return await run_sync(keep, limiter=self._threads), "miss"

    async def _keep(
        self,
        name: str,
        own: Sequence[Wanted],
        futures: Mapping[str, asyncio.Future[Answered]],
        pool: "asyncio.Future[list[Finished]]",
    ) -> None:
        """See a chunk to its end: its results are kept before anyone hears of them."""
        outcomes: Sequence[Record | Exception] = [ComputationCancelled()] * len(own)
        try:
            await asyncio.wait([pool])
            if not pool.cancelled():
                error = pool.exception()
                if isinstance(error, Exception):
                    outcomes = [error] * len(own)
                elif error is None:
                    outcomes = await run_sync(self._put, name, own, pool.result(), limiter=self._chunk_threads)
        except Exception as error:  # noqa: BLE001 (whoever waits for the cases raises it)
            outcomes = [error] * len(own)
        finally:
            for (key, future), outcome in zip(futures.items(), outcomes, strict=True):
                del self._underway[key]
                if isinstance(outcome, Record):
                    future.set_result((outcome, "miss"))
                else:
                    future.set_exception(outcome)
                    future.exception()  # seen, even if nobody waits for it any more

    def _put(self, name: str, own: Sequence[Wanted], finished: Sequence[Finished]) -> list[Record | Exception]:
        """Make the records of a chunk and keep them, all in one place."""
        outcomes: list[Record | Exception] = []
        for case, end in zip(own, finished, strict=True):
            try:
                outcomes.append(end.error or self._record(name, case, end.value))
            except Exception as error:  # noqa: BLE001 (of this case alone)
                outcomes.append(error)
        records = {outcome.key: outcome for outcome in outcomes if isinstance(outcome, Record)}
        known = self.cache.known(list(records))  # another may have kept some since they were looked up
        missing = [record for key, record in records.items() if key not in known]
        records |= {record.key: record for record in self.cache.put_many(missing)}
        return [records[outcome.key] if isinstance(outcome, Record) else outcome for outcome in outcomes]

    def _record(self, name: str, case: Wanted, result: object) -> Record:
        answer, history = self.operations[name].answer(case.request, result)
        return Record(case.key, name, case.canonical, answer, history, ENGINE_VERSION, SCHEMA_VERSION)

    def _forget(self, key: str, task: "asyncio.Future[Answered]") -> None:
        del self._underway[key]
        if not task.cancelled():
            task.exception()  # seen, even if nobody waits for it any more


def name_request(operation: str, request: Request) -> Named:
    """Return key and canonical form of a request."""
    canonical = request.canonical()
    return result_key(operation, canonical), canonical


@dataclass(frozen=True, slots=True)
class Chunk:
    """Cases being computed.

    Parameters
    ----------
    own, shared
        Answers by key: those this chunk computes, and those of others it waits for. One that is given up raises
        `ComputationCancelled`. To be waited for, never to be cancelled.
    pool
        What the pool makes of the own ones.
    kept
        Ends when all own answers are there.
    """

    own: Mapping[str, "asyncio.Future[Answered]"]
    shared: Mapping[str, "asyncio.Future[Answered]"]
    pool: "asyncio.Future[list[Finished]]"
    kept: "asyncio.Task[None]"

    def stop(self) -> None:
        """Give up what the pool has not answered; what it has is kept."""
        self.pool.cancel()
