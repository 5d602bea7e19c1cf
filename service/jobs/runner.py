"""Runs cases: chunks of them take turns in the executor, those of batches answered at once and those of jobs."""

import asyncio
import math
from collections import Counter, defaultdict
from collections.abc import AsyncGenerator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from anyio.to_thread import run_sync

from service.cache.record import Record
from service.errors import ComputationCancelled, PoolUnavailableError, QueueFullError, case_problem
from service.fairness import ChunkSizer, FairSemaphore
from service.jobs.models import CaseResult, JobCase
from service.operations import KeyedRequest
from service.queries import QueryService, Rate

CHUNK_SECONDS = 0.1
"""Work in a chunk: the client sees the first results soon."""
RETRY_SECONDS = 0.1
"""Before a case that another was computing and gave up is tried again."""


@dataclass(frozen=True, slots=True)
class CaseAnswer:
    """Answer to all cases with one key."""

    key: str
    record: Record | None
    problem: dict[str, Any] | None
    own: bool


class CaseRunner:
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
        left, work = len(cases), set[asyncio.Task[list[CaseAnswer]]]()
        self.queued[owner] += left
        try:
            numbers: dict[str, list[int]] = defaultdict(list)
            for number, case in enumerate(cases):
                numbers[case.request.key].append(number)
            known: Mapping[str, Record] = await run_sync(self._queries.cache.get_many, list(numbers))
            finished = [CaseAnswer(key, record, None, own=False) for key, record in known.items()]
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
    ) -> set["asyncio.Task[list[CaseAnswer]]"]:
        share = math.ceil(len(missing) / self._queries.executor.capacity)
        size = max(1, min(self._sizers[operation].cases, share))
        chunks = [missing[i : i + size] for i in range(0, len(missing), size)]
        work = {asyncio.create_task(self._compute(operation, chunk, owner, urgent=urgent)) for chunk in chunks}
        for task in work:  # seen, even if nothing waits for it any more
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return work

    async def _compute(
        self, operation: str, chunk: Sequence[KeyedRequest], owner: str, *, urgent: bool
    ) -> list[CaseAnswer]:
        outcomes: list[CaseAnswer] = []
        left = {case.key: case for case in chunk}
        while left:
            for outcome in await self._try(operation, list(left.values()), owner, urgent=urgent):
                del left[outcome.key]
                outcomes.append(outcome)
            if left:
                await asyncio.sleep(RETRY_SECONDS)
        return outcomes

    async def _try(
        self, operation: str, cases: Sequence[KeyedRequest], owner: str, *, urgent: bool
    ) -> list[CaseAnswer]:
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
            outcomes.append(CaseAnswer(key, record, case_problem(error) if error else None, own=key in chunk.own))
        self._sizers[operation].note(chunk.seconds, nbytes)
        return outcomes
