"""Reader of the results of jobs in blocks. Evicted results are computed again."""

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
from service.jobs.models import UNKNOWN, CaseRow, CaseState, JobCase, JobState, is_of
from service.jobs.runner import CaseRunner
from service.jobs.store import VERSIONS, JobStore
from service.jobs.studies import StudyService
from service.operations import OPERATIONS, KeyedRequest, result_key
from service.queries import QueryService

MOST_CASES = 200
"""Largest number of results read at once, as many as in a stored block of cases."""
FIRST_CASES = 4
"""Number of results read first, while their size is unknown. Four with long histories take 16 MB."""
READ_BYTES = 1024 * 1024
"""Approximate size of the answers read at once [bytes]. Answers with long histories take 4 MB each."""
BLOCKS_AT_ONCE = 2
"""Number of blocks of results in memory, across all readers. While a block is encoded it can take twenty times the size
of its answers."""

Value = TypeVar("Value")
Take: TypeAlias = Callable[[int], None]
"""Function that charges cost to the quota of a reader. [ordinary cases]"""


class ResultReader:
    """Reads the results of jobs.

    Parameters
    ----------
    queries
        Query service with the cache.
    jobs
        Store of the jobs.
    runner, studies
        Services that compute evicted results again.
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
        """Read results, beginning with case `start`, and yield the value of `use` for each block.

        The reading ends at the first case without a result; in a job that has ended, such cases are skipped.

        Parameters
        ----------
        current
            Function that returns the present state of the job; None once the job has been deleted.
        use
            Function called with each block in a thread, for at most `BLOCKS_AT_ONCE` blocks at a time. Its value
            should not hold the results, but only the data to be sent.
        limit
            Largest number of results; None for all.
        take
            Function that charges the cost of results that are computed again; raises QuotaError if the quota is too
            small.
        whole
            True to raise QuotaError. By default the error becomes the problem of the cases, since the response may
            have begun.
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
        """Return the number of cases to read next, and the value of `use` for the results of the given cases."""
        again: dict[int, CaseResult] = {}

        def gather() -> list[CaseRow] | tuple[int, Value]:
            """Return the evicted cases or, if there are none, the return value of `_use`."""
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
            # This runs outside the limiter, so that computing evicted results does not hold up other readers.
            again |= await self._compute(state, found, take, whole=whole)
        return found

    async def _compute(
        self, state: JobState, rows: Sequence[CaseRow], take: Take, *, whole: bool
    ) -> dict[int, CaseResult]:
        """Compute evicted cases again, and charge the client who reads. Cases that cannot be computed get a problem."""
        cases = await run_sync(lambda: [again_of(state, row) for row in rows])
        found = {row.number: damaged(row) for row, case in zip(rows, cases, strict=True) if case is None}
        places = [(row, case) for row, case in zip(rows, cases, strict=True) if case is not None]
        try:
            if state.is_study:
                run = partial(self._runner.results, owner=state.owner)
                for row, case in places:  # Only samples that have been evicted too are computed again.
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
    """Return the case of an evicted result, to be computed again; None if its request or operation is damaged."""
    if row.request is None or state.operation == UNKNOWN:
        return None
    # The result of an earlier engine cannot be computed any more, so the case gets the key of the current versions.
    key = row.key if state.versions == VERSIONS else result_key(state.operation, orjson.loads(row.request))
    if not is_of(state.operation, row.request, key):
        return None
    known = OPERATIONS.get(state.operation)
    request: Any = None if known is None else known.request.model_validate_json(row.request)
    work = 1 if request is None else KeyedRequest.of(state.operation, request).work
    return JobCase(KeyedRequest(key, row.request, work), row.custom_id)


def belongs(state: JobState, row: CaseRow, record: Record) -> bool:
    """Return True if a record answers the request of a case. A damaged key may belong to another record."""
    if row.request is None or record.request_json == row.request:
        return True
    return is_of(state.operation, row.request, result_key(state.operation, record.request))


def damaged(row: CaseRow) -> CaseResult:
    """Return a result that reports a case as damaged."""
    problem = problem_of(DamagedCasesError(row.number, row.number))
    return CaseResult(row.number, row.custom_id, None, problem, cached=False)


def rows_ready(rows: Sequence[CaseRow], *, final: bool) -> list[CaseRow]:
    """Return the finished cases up to the first unfinished one, or all finished cases of a job that has ended."""
    if final:
        return [row for row in rows if row.state]
    return list(itertools.takewhile(lambda row: row.state, rows))


def next_count(results: Sequence[CaseResult]) -> int:
    """Return the number of cases to read next, from the size of the results read last."""
    nbytes = sum(result.record.length for result in results if result.record is not None)
    return max(1, min(MOST_CASES, READ_BYTES * len(results) // max(nbytes, 1)))
