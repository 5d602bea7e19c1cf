"""Runs cases in chunks, those of batches answered at once and those of jobs."""

import asyncio
import math
from collections import Counter, defaultdict, deque
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, aclosing, nullcontext
from dataclasses import dataclass, field
from typing import TypeAlias

from anyio import CancelScope, create_task_group
from anyio.abc import TaskGroup
from anyio.to_thread import run_sync

from service.cache.record import CaseResult, Record
from service.errors import ComputationCancelled, PoolUnavailableError, QueueFullError, case_problem
from service.jobs.chunk_sizer import ChunkSizer
from service.jobs.models import JobCase
from service.queries import Answered, QueryService, Rate

URGENT_SECONDS = 0.1
"""Work in a chunk that a client waits for: short, so that the first results are there soon."""
CHUNK_SECONDS = 0.25
"""Work in a chunk of a job: what a crash costs at most, and a hundred times what handing it over does."""
AHEAD_SHARE = 8
"""Workers to each chunk of a run that waits for one, beyond the first: to prepare a chunk takes far less time."""
CHUNKS_KEPT = 2
"""Chunks of a run that may be prepared or kept, beyond two a worker: with a slow disk they would fill the memory."""
NO_WORKER_SECONDS = 1.0
"""Delay before retrying cases of a job for which there was no worker [s]."""
OVERLONG_SECONDS = 10.0
"""Time after which a chunk is given up: cases that take far longer than those before are handed out again in smaller
chunks, so that all workers share them and other work gets in between."""
TEMPORARY = (ComputationCancelled, PoolUnavailableError, QueueFullError)
"""Errors that do not come from the case itself: it is tried again. A case whose worker died was tried again by the
executor (`DEATHS` in `service/workers/process_pool.py`)."""

Blocks: TypeAlias = AsyncGenerator[Mapping[int, JobCase], None]
"""Cases by their numbers, read when there is a turn to compute some."""
Take: TypeAlias = Callable[[list[CaseResult]], Awaitable[None]]
"""Takes results as they finish; the next chunk of a job may wait for it."""


@dataclass(eq=False)
class Run:
    """Cases that are being run. The parameters are those of `CaseRunner.run`."""

    operation: str
    blocks: Blocks
    take: Take
    owner: str
    urgent: bool
    traced: Callable[[int], AbstractContextManager[object]]
    group: TaskGroup
    remaining: Callable[[], float]
    capacity: int
    """Number of chunks that can run at the same time."""
    sizer: ChunkSizer = field(init=False)
    cases: dict[str, dict[int, JobCase]] = field(default_factory=dict)
    """Cases without a result, by key: only the first with a key is computed."""
    waiting: deque[str] = field(default_factory=deque)
    """Keys of cases to be computed next."""
    read: bool = False
    """True once all blocks have been read."""
    share: int = 1
    """Largest chunk from then on, so that all workers have a share of the last cases."""
    preparing: bool = False
    """True while the cases of a chunk are being read."""
    queued: set[object] = field(default_factory=set)
    """A token for each chunk that waits for a worker."""
    underway: int = 0
    """Chunks that are being prepared, wait, are computed or kept."""

    @property
    def may_begin(self) -> bool:
        """True if another chunk should be prepared now."""
        if self.preparing or (self.read and not self.waiting):
            return False
        return len(self.queued) <= self.capacity // AHEAD_SHARE and self.underway < 2 * self.capacity + CHUNKS_KEPT

    def __post_init__(self) -> None:
        self.sizer = ChunkSizer(URGENT_SECONDS if self.urgent else CHUNK_SECONDS)

    async def next_chunk(self) -> list[JobCase]:
        """Take out the cases of the next chunk, no two alike; there are none when all are done or underway."""
        while not self.read and len(self.waiting) < self.sizer.cases:
            block = await anext(self.blocks, None)
            self.read = block is None
            for number, case in (block or {}).items():
                key = case.request.key
                if key not in self.cases:
                    self.waiting.append(key)
                self.cases.setdefault(key, {})[number] = case
        size = min(self.sizer.cases, len(self.waiting))
        if self.read:
            self.share = max(self.share, math.ceil(len(self.waiting) / self.capacity))
            size = min(size, self.share)
        return [next(iter(self.cases[self.waiting.popleft()].values())) for _ in range(size)]

    def results(self, key: str, record: Record | None, error: Exception | None, *, own: bool) -> list[CaseResult]:
        """Return the results of all cases with a key; `own` says whether the first was computed for it."""
        problem = None if error is None else case_problem(error)
        return [
            CaseResult(number, case.custom_id, record, problem, cached=not own or place > 0)
            for place, (number, case) in enumerate(self.cases.pop(key).items())
        ]


class CaseRunner:
    """Runs cases in chunks.

    Parameters
    ----------
    queries
        Computes the cases.
    rate
        Counts every case that is done.
    """

    def __init__(self, queries: QueryService, rate: Rate) -> None:
        self.queued: Counter[str] = Counter()
        """Cases of `results` that wait or are being computed, by owner."""
        self.job_chunks = 0
        """Number of chunks of jobs that are being prepared, wait, are computed or kept."""
        self._queries = queries
        self._rate = rate

    async def results(
        self, operation: str, cases: Sequence[JobCase], more: int = 0, *, owner: str, urgent: bool = True
    ) -> AsyncGenerator[CaseResult, None]:
        """Yield the result of every case as it finishes; closed, it stops the work.

        Parameters
        ----------
        more
            Number of cases that the same request will have after these.

        Raises
        ------
        PoolUnavailableError
            If no worker can take the cases and they are urgent.
        """
        left, finished = len(cases), asyncio.Queue[list[CaseResult] | None]()

        async def work() -> None:
            try:
                numbers: dict[str, list[int]] = defaultdict(list)
                for number, case in enumerate(cases):
                    numbers[case.request.key].append(number)
                known: Mapping[str, Record] = await run_sync(self._queries.cache.get_many, list(numbers))
                found = [(number, record) for key, record in known.items() for number in numbers[key]]
                finished.put_nowait(
                    [CaseResult(i, cases[i].custom_id, record, None, cached=True) for i, record in found]
                )
                missing = {number: case for number, case in enumerate(cases) if case.request.key not in known}
                if missing:
                    weight = self._queries.operations[operation].weight
                    await self.run(
                        operation,
                        only(missing),
                        finished.put,
                        owner=owner,
                        urgent=urgent,
                        remaining=lambda: weight * (left + more),
                    )
            finally:
                finished.put_nowait(None)

        self.queued[owner] += left
        working = asyncio.create_task(work())
        try:
            while (results := await finished.get()) is not None:
                for result in results:
                    left -= 1
                    self.queued[owner] -= 1
                    yield result
            await working
        finally:
            self.queued -= Counter({owner: left})  # The subtraction also forgets owners who have nothing queued.
            working.cancel()
            with CancelScope(shield=True):
                await asyncio.wait([working])

    async def run(
        self,
        operation: str,
        blocks: Blocks,
        take: Take,
        *,
        owner: str,
        remaining: Callable[[], float],
        urgent: bool = True,
        traced: Callable[[int], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        """Compute all cases of these blocks, except those that have been kept meanwhile; cancelled, it stops the work.

        Parameters
        ----------
        take
            Takes the results, after they have been kept.
        owner
            In whose turn they are computed.
        remaining
            Returns the cost of the cases that are not done: of the work of one owner the least goes first.
        urgent
            Whether somebody waits for them: chunks are short, and have no retries when no worker can take them.
        traced
            Called with the number of cases of each chunk; its context lasts as long as the chunk.

        Raises
        ------
        PoolUnavailableError
            If no worker can take the cases and they are urgent.
        Exception
            Out of `blocks` and `take`.
        """
        capacity = self._queries.executor.capacity
        try:
            with self._rate.working():
                async with aclosing(blocks), create_task_group() as group:
                    run = Run(operation, blocks, take, owner, urgent, traced, group, remaining, capacity)
                    self._begin_chunk(run)
        except ExceptionGroup as errors:  # The first one has cancelled the other chunks.
            raise errors.exceptions[0] from None

    def _begin_chunk(self, run: Run) -> None:
        if run.may_begin:
            run.preparing = True
            run.group.start_soon(self._run_chunk, run)

    async def _run_chunk(self, run: Run) -> None:
        """Prepare and compute the next cases."""
        run.underway += 1
        self.job_chunks += not run.urgent
        token = object()
        try:
            cases = await run.next_chunk()
            run.preparing = False
            if cases:
                run.queued.add(token)
                self._begin_chunk(run)
                with run.traced(len(cases)):
                    await self._compute(run, cases, token)
        finally:
            run.queued.discard(token)
            run.underway -= 1
            self.job_chunks -= not run.urgent
        self._begin_chunk(run)

    async def _compute(self, run: Run, cases: Sequence[JobCase], token: object) -> None:
        """Compute these cases, except those that have been kept since, or are in flight elsewhere."""

        def begun() -> None:
            run.queued.discard(token)
            self._begin_chunk(run)

        known = await run_sync(self._queries.cache.get_many, [case.request.key for case in cases])
        found = [result for key, record in known.items() for result in run.results(key, record, None, own=False)]
        if found:
            await run.take(found)
        unknown = {case.request.key: case.request for case in cases if case.request.key not in known}
        shared = self._queries.in_flight(unknown, queued=not run.urgent)
        if shared:
            run.group.start_soon(self._take_answers, run, shared)
        if own := [request for key, request in unknown.items() if key not in shared]:
            longest = OVERLONG_SECONDS if len(own) > 1 else None
            chunk = await self._queries.compute(
                run.operation, own, owner=run.owner, remaining=run.remaining(), begun=begun, longest=longest
            )
            if chunk.late:
                run.sizer.shrink(len(own))
            run.sizer.note(chunk.seconds, chunk.nbytes)
            await self._take_answers(run, chunk.answers, own=True)

    async def _take_answers(
        self, run: Run, futures: Mapping[str, "asyncio.Future[Answered]"], *, own: bool = False
    ) -> None:
        """Take answers when they are there; cases without one for a reason that is not their own are tried again."""
        await asyncio.wait(futures.values())
        results: list[CaseResult] = []
        again: list[str] = []
        unavailable: Exception | None = None
        for key, future in futures.items():
            error = ComputationCancelled() if future.cancelled() else future.exception()
            if error is None:
                results += run.results(key, future.result()[0], None, own=own)
            elif isinstance(error, TEMPORARY) or not isinstance(error, Exception):
                again.append(key)
                unavailable = error if isinstance(error, PoolUnavailableError) else unavailable
            else:
                results += run.results(key, None, error, own=own)
        if results:
            self._rate.add(len(results))
            await run.take(results)
        if unavailable is not None:
            if run.urgent:
                raise unavailable
            await asyncio.sleep(NO_WORKER_SECONDS)
        if again:
            run.waiting.extendleft(reversed(again))
            self._begin_chunk(run)


async def only(block: Mapping[int, JobCase]) -> Blocks:
    """Yield this block of cases."""
    yield block
