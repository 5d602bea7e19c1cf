"""Results of a job in their order, as far as they are there; what the cache has lost is computed again."""

import itertools
import math
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import aclosing
from dataclasses import replace
from typing import Any, TypeVar

import orjson
from anyio.to_thread import run_sync

from service.cache_key import KeyedRequest, result_key
from service.jobs.inline import InlineBatch
from service.jobs.models import Case, CaseResult, CaseRow, CaseState, JobState
from service.jobs.store import VERSIONS, JobStore
from service.queries import QueryService

MOST_CASES = 200
FIRST_CASES = 16
"""Before it is known how large the results of a job are."""
READ_BYTES = 8 * 1024 * 1024
"""Answers read at once, about: those with long histories take 4 MB each."""

Value = TypeVar("Value")


class ResultReader:
    """Reads results.

    Parameters
    ----------
    queries
        Has the cache.
    jobs
        Keeps the jobs.
    inline
        Computes what the cache has lost.
    """

    def __init__(self, queries: QueryService, jobs: JobStore, inline: InlineBatch) -> None:
        self._queries = queries
        self._jobs = jobs
        self._inline = inline

    async def read(
        self, current: Callable[[], Awaitable[JobState | None]], start: int, limit: int | None
    ) -> AsyncGenerator[list[CaseResult], None]:
        """Yield results from case `start` on, block by block.

        Ends at the first case without a result; in a job that has ended, such cases are left out.

        Parameters
        ----------
        current
            The job as it is now; None once it has been deleted.
        limit
            Of results; None for all.
        """
        count, left = FIRST_CASES, math.inf if limit is None else limit
        while left > 0 and (state := await current()) is not None:
            rows = await self._thread(self._jobs.rows, state.number, start, int(min(count, left)))
            ready = rows_ready(rows, final=state.final)
            if ready:
                results = await self._results(state, ready)
                count = next_count(results)
                yield results
            if not rows or (len(ready) < len(rows) and not state.final):
                return
            start += len(rows)
            left -= len(ready)

    async def _results(self, state: JobState, rows: Sequence[CaseRow]) -> list[CaseResult]:
        answered = [row for row in rows if row.problem is None]
        records = await self._thread(self._queries.cache.get_many, list({row.key for row in answered}))
        lost = [row for row in answered if row.key not in records]
        again = await self._compute(state, lost) if lost else {}
        return [
            again[row.number]
            if row.number in again
            else CaseResult(row.number, row.custom_id, records.get(row.key), row.problem, row.state == CaseState.CACHED)
            for row in rows
        ]

    async def _compute(self, state: JobState, rows: Sequence[CaseRow]) -> dict[int, CaseResult]:
        """Compute these cases again."""

        def load() -> list[Case]:
            requests = self._jobs.requests(state.number, [row.number for row in rows])
            keys = [row.key for row in rows]
            if state.versions != VERSIONS:  # they are of an earlier engine, whose results cannot be had any more
                keys = [result_key(state.operation, orjson.loads(requests[row.number])) for row in rows]
            found = zip(rows, keys, strict=True)
            return [Case(KeyedRequest(key, requests[row.number]), row.custom_id) for row, key in found]

        found: dict[int, CaseResult] = {}
        async with aclosing(self._inline.run(state.operation, await self._thread(load))) as results:
            async for result in results:
                row = rows[result.number]
                found[row.number] = replace(result, number=row.number, cached=row.state == CaseState.CACHED)
        return found

    async def _thread(self, function: Callable[..., Value], *arguments: Any) -> Value:
        return await run_sync(function, *arguments)


def rows_ready(rows: Sequence[CaseRow], *, final: bool) -> list[CaseRow]:
    """Return the cases that have a result: up to the first that has none, all of them if nothing is to come."""
    if final:
        return [row for row in rows if row.state]
    return list(itertools.takewhile(lambda row: row.state, rows))


def next_count(results: Sequence[CaseResult]) -> int:
    """Return how many cases to read next, going by the size of these."""
    nbytes = sum(len(result.record.json) for result in results if result.record is not None)
    return max(1, min(MOST_CASES, READ_BYTES * len(results) // max(nbytes, 1)))
