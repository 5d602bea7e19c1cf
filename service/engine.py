"""From a request to its record: look it up, share work in flight, run it, keep it."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.cache import ResultCache
from service.executor import PoolExecutor
from service.keys import SCHEMA_VERSION, result_key
from service.record import FloatColumns, Record
from solver import ENGINE_VERSION

CacheStatus: TypeAlias = Literal["hit", "miss"]
Call: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
Answer: TypeAlias = tuple[dict[str, Any], FloatColumns | None]

CACHE_THREADS = 2
"""Encoding holds the interpreter lock: more threads would only make the event loop wait longer for its turn."""


class Request(Protocol):
    """A validated request."""

    def canonical(self) -> dict[str, Any]:
        """Every field as JSON, defaults filled in."""
        ...


@dataclass(frozen=True, slots=True)
class Operation:
    """How one kind of request is computed and answered.

    Parameters
    ----------
    call
        Picklable function and arguments that compute the request, run in a worker.
    answer
        Request and what the worker returned, to the JSON answer without history and the columns of the history.
    """

    call: Callable[[Any], Call]
    answer: Callable[[Any, Any], Answer]


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
    """

    def __init__(self, cache: ResultCache, executor: PoolExecutor, operations: Mapping[str, Operation]) -> None:
        self._cache = cache
        self._executor = executor
        self._operations = operations
        self._underway: dict[str, asyncio.Task[tuple[Record, CacheStatus]]] = {}
        self._threads = CapacityLimiter(CACHE_THREADS)

    async def answer(self, operation: str, request: Request) -> tuple[Record, CacheStatus]:
        """Record of the request, and whether it was there already.

        Equal requests underway share one computation. It belongs to none of them: it goes on if whoever asked first,
        or everyone, has left, and its result is kept.
        """
        canonical = request.canonical()
        key = result_key(operation, canonical)
        record = self._cache.recall(key)
        if record is not None:
            return record, "hit"
        task = self._underway.get(key)
        if task is None:
            task = asyncio.create_task(self._find(key, operation, request, canonical))
            self._underway[key] = task
            task.add_done_callback(lambda done: self._forget(key, done))
        return await asyncio.shield(task)

    async def result(self, key: str) -> Record | None:
        """Record of this key, if there is one."""
        return self._cache.recall(key) or await run_sync(self._cache.get, key, limiter=self._threads)

    async def _find(
        self, key: str, name: str, request: Request, canonical: dict[str, Any]
    ) -> tuple[Record, CacheStatus]:
        record = await run_sync(self._cache.get, key, limiter=self._threads)
        if record is not None:
            return record, "hit"
        operation = self._operations[name]
        function, arguments = operation.call(request)
        result = await self._executor.submit(function, *arguments)

        def keep() -> Record:
            answer, history = operation.answer(request, result)
            return self._cache.put(Record(key, name, canonical, answer, history, ENGINE_VERSION, SCHEMA_VERSION))

        return await run_sync(keep, limiter=self._threads), "miss"

    def _forget(self, key: str, task: asyncio.Task[tuple[Record, CacheStatus]]) -> None:
        del self._underway[key]
        if not task.cancelled():
            task.exception()  # seen, even if nobody waits for it any more
