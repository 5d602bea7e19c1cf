"""Results of cases: those of a job in blocks, and those of small batches that are answered at once."""

import asyncio
import itertools
import math
from collections import Counter, defaultdict
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import orjson
from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.cache.record import Record
from service.errors import ComputationCancelled, DamagedCasesError, PoolUnavailableError, QueueFullError, case_problem
from service.fairness import ChunkSizer, FairSemaphore
from service.jobs.models import CaseResult, CaseRow, CaseState, JobCase, JobState, block_of
from service.jobs.store import VERSIONS, JobStore
from service.jobs.studies import StudyService
from service.operations import KeyedRequest, is_study, result_key
from service.queries import QueryService, Rate

CHUNK_SECONDS = 0.1
"""Work in a chunk: the client sees the first results soon."""
RETRY_SECONDS = 0.1
"""Before a case that another was computing and gave up is tried again."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Answer to all cases with one key."""

    key: str
    record: Record | None
    problem: dict[str, Any] | None
    own: bool


class InlineBatch:
    """Runs a few cases for a client that waits for them.

    Parameters
    ----------
    queries
        Computes the cases.
    chunks
        Permits for chunks in the executor, shared with the jobs.
    rate
        Counts every case that is done.
    """

    def __init__(self, queries: QueryService, chunks: FairSemaphore, rate: Rate) -> None:
        self.queued: Counter[str] = Counter()
        """Cases that wait or are being computed, by owner."""
        self._queries = queries
        self._permits = chunks
        self._rate = rate
        self._sizers: dict[str, ChunkSizer] = defaultdict(lambda: ChunkSizer(CHUNK_SECONDS))

    async def run(
        self, operation: str, cases: Sequence[JobCase], *, owner: str, urgent: bool = True
    ) -> AsyncGenerator[CaseResult, None]:
        """Yield the result of every case as it finishes; closed, it stops the work.

        Owners take turns; what is urgent goes before jobs.

        Raises
        ------
        PoolUnavailableError
            If no worker can take the cases.
        """
        left, work = len(cases), set[asyncio.Task[list[Outcome]]]()
        self.queued[owner] += left
        try:
            numbers: dict[str, list[int]] = defaultdict(list)
            for number, case in enumerate(cases):
                numbers[case.request.key].append(number)
            known: Mapping[str, Record] = await run_sync(self._queries.cache.get_many, list(numbers))
            finished = [Outcome(key, record, None, own=False) for key, record in known.items()]
            missing = [cases[same[0]].request for key, same in numbers.items() if key not in known]
            work |= self._begin(operation, missing, owner, urgent=urgent)
            while True:
                for outcome in finished:
                    for number in numbers[outcome.key]:
                        left -= 1
                        self.queued[owner] -= 1
                        cached = not outcome.own or number != numbers[outcome.key][0]
                        yield CaseResult(number, cases[number].custom_id, outcome.record, outcome.problem, cached)
                if not work:
                    return
                done, work = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
                finished = [outcome for chunk in done for outcome in chunk.result()]
                self._rate.add(sum(len(numbers[outcome.key]) for outcome in finished))
        finally:
            self.queued -= Counter({owner: left})  # and forget owners who have nothing queued
            for chunk in work:
                chunk.cancel()
            if work:
                await asyncio.wait(work)

    def _begin(
        self, operation: str, missing: Sequence[KeyedRequest], owner: str, *, urgent: bool
    ) -> set["asyncio.Task[list[Outcome]]"]:
        share = math.ceil(len(missing) / self._queries.executor.capacity)
        size = max(1, min(self._sizers[operation].cases, share))
        chunks = [missing[i : i + size] for i in range(0, len(missing), size)]
        work = {asyncio.create_task(self._compute(operation, chunk, owner, urgent=urgent)) for chunk in chunks}
        for task in work:  # seen, even if nothing waits for it any more
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return work

    async def _compute(
        self, operation: str, chunk: Sequence[KeyedRequest], owner: str, *, urgent: bool
    ) -> list[Outcome]:
        outcomes: list[Outcome] = []
        left = {case.key: case for case in chunk}
        while left:
            for outcome in await self._try(operation, list(left.values()), owner, urgent=urgent):
                del left[outcome.key]
                outcomes.append(outcome)
            if left:
                await asyncio.sleep(RETRY_SECONDS)
        return outcomes

    async def _try(self, operation: str, cases: Sequence[KeyedRequest], owner: str, *, urgent: bool) -> list[Outcome]:
        """Compute these cases; those that were in flight elsewhere and given up there are left out."""
        permit = await self._permits.acquire(owner, urgent=urgent)
        chunk = self._queries.begin(operation, cases, permit.release)
        answers = {**chunk.own, **chunk.shared}
        try:
            await asyncio.wait([chunk.kept])
            if chunk.shared:
                await asyncio.wait(chunk.shared.values())
        except asyncio.CancelledError:
            chunk.stop()
            raise
        outcomes, nbytes = [], 0
        for key, future in answers.items():
            error = None if future.cancelled() else future.exception()
            if future.cancelled() or isinstance(error, ComputationCancelled | QueueFullError):
                continue
            if isinstance(error, PoolUnavailableError) or not isinstance(error, Exception | None):
                raise error
            record = None if error else future.result()[0]
            nbytes += len(record.json) if record else 0
            outcomes.append(Outcome(key, record, case_problem(error) if error else None, own=key in chunk.own))
        self._sizers[operation].note(chunk.seconds, nbytes)
        return outcomes


MOST_CASES = 200
FIRST_CASES = 4
"""Before it is known how large the results of a job are."""
READ_BYTES = 1024 * 1024
"""Answers read at once, about: those with long histories take 4 MB each."""
BLOCKS_AT_ONCE = 2
"""Blocks of results in memory, of all readers together: one can take twenty times its answers while it is encoded."""

Value = TypeVar("Value")


class ResultReader:
    """Reads results.

    Parameters
    ----------
    queries
        Has the cache.
    jobs
        Keeps the jobs.
    inline, studies
        Compute what the cache has lost.
    """

    def __init__(self, queries: QueryService, jobs: JobStore, inline: InlineBatch, studies: StudyService) -> None:
        self._queries = queries
        self._jobs = jobs
        self._inline = inline
        self._studies = studies
        self._blocks = CapacityLimiter(BLOCKS_AT_ONCE)

    async def read(
        self,
        current: Callable[[], Awaitable[JobState | None]],
        use: Callable[[list[CaseResult]], Value],
        start: int,
        limit: int | None,
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
        """
        count, left = FIRST_CASES, math.inf if limit is None else limit
        while left > 0 and (state := await current()) is not None:
            rows = await self._thread(self._jobs.rows, state.number, start, int(min(count, left)))
            ready = rows_ready(rows, final=state.final)
            if ready:
                count, used = await self._use(state, ready, use)
                yield used
                del used
            if not rows or (len(ready) < len(rows) and not state.final):
                return
            start += len(rows)
            left -= len(ready)

    async def _use(
        self, state: JobState, rows: Sequence[CaseRow], use: Callable[[list[CaseResult]], Value]
    ) -> tuple[int, Value]:
        """Return how many cases to read next, and what `use` makes of the results of these."""
        again: dict[int, CaseResult] = {}

        def gather() -> list[CaseRow] | tuple[int, Value]:
            """Return what the cache has lost, or use the results if it has all; they live no longer than this."""
            stored = [row for row in rows if row.problem is None and row.number not in again]
            records = self._queries.cache.get_many(list({row.key for row in stored}))
            if lost := [row for row in stored if row.key not in records]:
                return lost
            results = [
                again.get(row.number)
                or CaseResult(
                    row.number, row.custom_id, records.get(row.key), row.problem, row.state == CaseState.CACHED
                )
                for row in rows
            ]
            return next_count(results), use(results)

        while isinstance(found := await run_sync(gather, limiter=self._blocks), list):
            again |= await self._compute(state, found)  # may take long, and holds up no other reader
        return found

    async def _compute(self, state: JobState, rows: Sequence[CaseRow]) -> dict[int, CaseResult]:
        """Compute these cases again."""

        def load() -> list[JobCase]:
            keys = [row.key for row in rows]
            if state.versions != VERSIONS:  # they are of an earlier engine, whose results cannot be had any more
                keys = [result_key(state.operation, orjson.loads(requests[row.number])) for row in rows]
            found = zip(rows, keys, strict=True)
            return [JobCase(KeyedRequest(key, requests[row.number]), row.custom_id) for row, key in found]

        requests = await self._thread(self._jobs.requests, state.number, [row.number for row in rows])
        lost = {row.number: self._lost(state, row) for row in rows if row.number not in requests}
        rows = [row for row in rows if row.number in requests]
        cases = await self._thread(load)
        if is_study(state.operation):
            found = {row.number: await self._study(state, row, case) for row, case in zip(rows, cases, strict=True)}
            return found | lost
        found = lost
        async with aclosing(self._inline.run(state.operation, cases, owner=state.owner)) as results:
            async for result in results:
                row = rows[result.number]
                found[row.number] = replace(result, number=row.number, cached=row.state == CaseState.CACHED)
        return found

    def _lost(self, state: JobState, row: CaseRow) -> CaseResult:
        """Result of a case that neither the cache nor the jobs have any more."""
        problem = case_problem(DamagedCasesError(*block_of(row.number, state.total)))
        return CaseResult(row.number, row.custom_id, None, problem, cached=False)

    async def _study(self, state: JobState, row: CaseRow, case: JobCase) -> CaseResult:
        """Compute a study again, of whose samples most may still be there."""
        run = partial(self._inline.run, owner=state.owner)
        record, _ = await self._studies.answer(state.operation, case.request, run)
        return CaseResult(row.number, row.custom_id, record, None, row.state == CaseState.CACHED)

    async def _thread(self, function: Callable[..., Value], *arguments: Any) -> Value:
        return await run_sync(function, *arguments)


def rows_ready(rows: Sequence[CaseRow], *, final: bool) -> list[CaseRow]:
    """Return the cases that have a result: up to the first that has none, all of them if nothing is to come."""
    if final:
        return [row for row in rows if row.state]
    return list(itertools.takewhile(lambda row: row.state, rows))


def next_count(results: Sequence[CaseResult]) -> int:
    """Return how many cases to read next, going by the size of these."""
    nbytes = sum(result.record.length for result in results if result.record is not None)
    return max(1, min(MOST_CASES, READ_BYTES * len(results) // max(nbytes, 1)))
