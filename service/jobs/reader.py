"""Results of jobs, read in blocks; what the cache has lost is computed again."""

import itertools
import math
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import aclosing
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias, TypeVar

import orjson
from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.cache.record import CaseResult, Record
from service.errors import DamagedCasesError, QuotaError, problem_of
from service.jobs.models import CaseRow, CaseState, JobCase, JobState
from service.jobs.rows import UNKNOWN, is_of
from service.jobs.runner import CaseRunner
from service.jobs.store import VERSIONS, JobStore
from service.jobs.studies import StudyService
from service.operations import OPERATIONS, KeyedRequest, is_study, result_key
from service.queries import QueryService

MOST_CASES = 200
"""Largest number of results read at once, however small they are."""
FIRST_CASES = 4
"""Number of results read first, when their size is unknown."""
READ_BYTES = 1024 * 1024
"""Approximate size of the answers read at once: those with long histories take 4 MB each."""
BLOCKS_AT_ONCE = 2
"""Blocks of results in memory, of all readers together: one can take twenty times its answers while it is encoded."""

Value = TypeVar("Value")
Take: TypeAlias = Callable[[int], None]
"""Takes work from the quota of a reader."""


class ResultReader:
    """Reads results.

    Parameters
    ----------
    queries
        Has the cache.
    jobs
        Keeps the jobs.
    runner, studies
        Compute what the cache has lost.
    """

    def __init__(self, queries: QueryService, jobs: JobStore, runner: CaseRunner, studies: StudyService) -> None:
        self._queries = queries
        self._jobs = jobs
        self._runner = runner
        self._studies = studies
        self._blocks = CapacityLimiter(BLOCKS_AT_ONCE)

    async def read(
        self,
        current: Callable[[], Awaitable[JobState | None]],
        use: Callable[[list[CaseResult]], Value],
        start: int,
        limit: int | None,
        take: Take = lambda _: None,
        *,
        whole: bool = False,
    ) -> AsyncGenerator[Value, None]:
        """Yield what `use` makes of the results from case `start` on, block by block.

        Ends at the first case without a result; in a job that has ended, such cases are left out.

        Parameters
        ----------
        current
            The job as it is now; None once it has been deleted.
        use
            Called in a thread, for few blocks at a time; what it returns should hold no more than is sent.
        limit
            Largest number of results; None for all.
        take
            Called with the work of what is computed again; raises QuotaError if that is more than the reader may.
        whole
            Whether that is raised; else the cases have it as their problem, as the answer may have begun.
        """
        count, left = FIRST_CASES, math.inf if limit is None else limit
        while left > 0 and (state := await current()) is not None:
            rows = await run_sync(self._jobs.rows, state, start, int(min(count, left)))
            ready = rows_ready(rows, final=state.final)
            if ready:
                count, used = await self._use(state, ready, use, take, whole=whole)
                yield used
                del used
            if not rows or (len(ready) < len(rows) and not state.final):
                return
            start += len(rows)
            left -= len(ready)

    async def _use(
        self,
        state: JobState,
        rows: Sequence[CaseRow],
        use: Callable[[list[CaseResult]], Value],
        take: Take,
        *,
        whole: bool,
    ) -> tuple[int, Value]:
        """Return how many cases to read next, and what `use` makes of the results of these."""
        again: dict[int, CaseResult] = {}

        def gather() -> list[CaseRow] | tuple[int, Value]:
            """Return what the cache has lost, or use the results if it has all; they live no longer than this."""
            stored = [row for row in rows if row.problem is None and row.number not in again]
            records = self._queries.cache.get_many(list({row.key for row in stored}))
            if lost := [row for row in stored if row.key not in records]:
                return lost
            again.update({row.number: damaged(row) for row in stored if not belongs(state, row, records[row.key])})
            results = [
                again.get(row.number)
                or CaseResult(
                    row.number, row.custom_id, records.get(row.key), row.problem, row.state == CaseState.CACHED
                )
                for row in rows
            ]
            return next_count(results), use(results)

        while isinstance(found := await run_sync(gather, limiter=self._blocks), list):
            again |= await self._compute(
                state, found, take, whole=whole
            )  # It may take long, but does not hold up other readers.
        return found

    async def _compute(
        self, state: JobState, rows: Sequence[CaseRow], take: Take, *, whole: bool
    ) -> dict[int, CaseResult]:
        """Compute these cases again, which counts as work of the reader; those that cannot be have a problem."""
        cases = await run_sync(lambda: [again_of(state, row) for row in rows])
        found = {row.number: damaged(row) for row, case in zip(rows, cases, strict=True) if case is None}
        places = [(row, case) for row, case in zip(rows, cases, strict=True) if case is not None]
        try:
            if is_study(state.operation):
                run = partial(self._runner.results, owner=state.owner)
                for row, case in places:  # Most of its samples may still be there.
                    record, _ = await self._studies.answer(state.operation, case.request, run, take=take)
                    found[row.number] = CaseResult(
                        row.number, row.custom_id, record, None, row.state == CaseState.CACHED
                    )
                return found
            take(sum(case.request.work for _, case in places))
        except QuotaError as error:
            if whole:
                raise
            return {
                row.number: CaseResult(row.number, row.custom_id, None, problem_of(error), cached=False) for row in rows
            }
        todo = [case for _, case in places]
        async with aclosing(self._runner.results(state.operation, todo, owner=state.owner)) as results:
            async for result in results:
                row = places[result.number][0]
                found[row.number] = replace(result, number=row.number, cached=row.state == CaseState.CACHED)
        return found


def again_of(state: JobState, row: CaseRow) -> JobCase | None:
    """Return a case that is computed again; None if it is not known what it was."""
    if row.request is None or state.operation == UNKNOWN:
        return None
    # Results of an earlier engine cannot be computed any more: the case gets the key of this one.
    key = row.key if state.versions == VERSIONS else result_key(state.operation, orjson.loads(row.request))
    if not is_of(state.operation, row.request, key):
        return None
    known = OPERATIONS.get(state.operation)
    request: Any = None if known is None else known.request.model_validate_json(row.request)
    work = 1 if request is None else KeyedRequest.of(state.operation, request).work
    return JobCase(KeyedRequest(key, row.request, work), row.custom_id)


def belongs(state: JobState, row: CaseRow, record: Record) -> bool:
    """Return whether the result that was found by the key of a case is that of its request."""
    if row.request is None or record.request_json == row.request:
        return True
    return is_of(state.operation, row.request, result_key(state.operation, record.request))


def damaged(row: CaseRow) -> CaseResult:
    """Return the result of a case of which something is damaged."""
    problem = problem_of(DamagedCasesError(row.number, row.number))
    return CaseResult(row.number, row.custom_id, None, problem, cached=False)


def rows_ready(rows: Sequence[CaseRow], *, final: bool) -> list[CaseRow]:
    """Return the cases that have a result: up to the first that has none, all of them if nothing is to come."""
    if final:
        return [row for row in rows if row.state]
    return list(itertools.takewhile(lambda row: row.state, rows))


def next_count(results: Sequence[CaseResult]) -> int:
    """Return how many cases to read next, going by the size of these."""
    nbytes = sum(result.record.length for result in results if result.record is not None)
    return max(1, min(MOST_CASES, READ_BYTES * len(results) // max(nbytes, 1)))
