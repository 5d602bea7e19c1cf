"""Runner that computes cases in chunks, both of batches that are answered at once and of jobs."""

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
"""Desired duration of a chunk that a client waits for, short so that the first results come soon [s]."""
CHUNK_SECONDS = 0.25
"""Desired duration of a chunk of a job [s]. A crash costs at most this much work, and the overhead of a chunk is a
hundredth of it."""
AHEAD_SHARE = 8
"""Number of workers for each extra chunk that a run queues so that no worker is idle. Preparing a chunk takes far less
time than computing it, so that one extra chunk for eight workers suffices."""
CHUNKS_KEPT = 2
"""Number of chunks of a run that may be in preparation or being stored, in addition to two per worker. Without a limit,
finished chunks would fill the memory while a slow disk stores them."""
NO_WORKER_SECONDS = 1.0
"""Delay before retrying cases of a job for which there was no worker [s]. A worker starts in about 1 s."""
OVERLONG_SECONDS = 10.0
"""Timeout of a chunk [s]. Cases that take far longer than earlier ones are queued again in smaller chunks, so that all
workers share them and other work can pass. A judgement: forty times the desired duration."""
TEMPORARY = (ComputationCancelled, PoolUnavailableError, QueueFullError)
"""Errors that are not caused by the case, which is retried. A case whose worker died has been retried by the executor
(`DEATHS` in `service/workers/process_pool.py`)."""

Blocks: TypeAlias = AsyncGenerator[Mapping[int, JobCase], None]
"""Blocks of cases by number, read when a chunk is prepared."""
Take: TypeAlias = Callable[[list[CaseResult]], Awaitable[None]]
"""Function that receives results as they finish. The next chunk may wait for it, which limits a fast producer."""


@dataclass(eq=False)
class Run:
    """State of the cases of one call of `CaseRunner.run`, whose parameters the first fields are."""

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
    """Unfinished cases by key. Equal cases are computed once."""
    waiting: deque[str] = field(default_factory=deque)
    """Keys of the cases to compute next."""
    read: bool = False
    """True once all blocks have been read."""
    share: int = 1
    """Largest number of cases in a chunk after that, so that the last cases are spread over all workers."""
    preparing: bool = False
    """True while the cases of a chunk are being read."""
    queued: set[object] = field(default_factory=set)
    """Tokens of the chunks that wait for a worker."""
    underway: int = 0
    """Number of chunks that are being prepared, queued, computed or stored."""

    @property
    def may_begin(self) -> bool:
        """True if another chunk should be prepared now."""
        # Only one chunk is prepared at a time, as all read from the same generator of blocks.
        if self.preparing or (self.read and not self.waiting):
            return False
        return len(self.queued) <= self.capacity // AHEAD_SHARE and self.underway < 2 * self.capacity + CHUNKS_KEPT

    def __post_init__(self) -> None:
        self.sizer = ChunkSizer(URGENT_SECONDS if self.urgent else CHUNK_SECONDS)

    async def next_chunk(self) -> list[JobCase]:
        """Remove and return the cases of the next chunk, with different keys; none if nothing is left to begin."""
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
            # Computed anew for each chunk, the share would shrink with the cases left, and the chunks with it.
            self.share = max(self.share, math.ceil(len(self.waiting) / self.capacity))
            size = min(size, self.share)
        return [next(iter(self.cases[self.waiting.popleft()].values())) for _ in range(size)]

    def results(self, key: str, record: Record | None, error: Exception | None, *, own: bool) -> list[CaseResult]:
        """Return the results of all cases with a key. `own` is True if the result was computed by this run."""
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
        Query service that computes the chunks.
    rate
        Rate that counts completed cases.
    """

    def __init__(self, queries: QueryService, rate: Rate) -> None:
        self.queued: Counter[str] = Counter()
        """Numbers of unfinished cases of `results`, by owner."""
        self.job_chunks = 0
        """Number of chunks of jobs that are being prepared, queued, computed or stored."""
        self._queries = queries
        self._rate = rate

    async def results(
        self, operation: str, cases: Sequence[JobCase], more: int = 0, *, owner: str, urgent: bool = True
    ) -> AsyncGenerator[CaseResult, None]:
        """Compute cases, and yield the result of each as it finishes. Closing the generator stops the work.

        Parameters
        ----------
        more
            Number of further cases of the same request.

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
            self.queued -= Counter({owner: left})  # The subtraction also removes owners with nothing queued.
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
        """Compute all cases of these blocks that are not in the cache by then. Cancellation stops the work.

        Parameters
        ----------
        take
            Function that receives the results after they have been stored.
        owner
            Owner in whose turn the cases are computed.
        remaining
            Returns the cost of the unfinished cases, by which the queue sorts the work of an owner. [ordinary cases]
        urgent
            True if a client waits: chunks are short, and are not retried when no worker can take them.
        traced
            Returns the context of a chunk from its number of cases, such as a span.

        Raises
        ------
        PoolUnavailableError
            If no worker can take the cases and they are urgent.
        Exception
            Raised by `blocks` or `take`.
        """
        capacity = self._queries.executor.capacity
        try:
            with self._rate.working():
                async with aclosing(blocks), create_task_group() as group:
                    run = Run(operation, blocks, take, owner, urgent, traced, group, remaining, capacity)
                    self._begin_chunk(run)
        except ExceptionGroup as errors:  # The first error has cancelled the other chunks, and is the cause.
            raise errors.exceptions[0] from None

    def _begin_chunk(self, run: Run) -> None:
        if run.may_begin:
            run.preparing = True
            run.group.start_soon(self._run_chunk, run)

    async def _run_chunk(self, run: Run) -> None:
        """Prepare and compute the next chunk, and begin another one when possible."""
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
        """Compute these cases, except those that are in the cache by now or in flight elsewhere."""

        def begun() -> None:
            run.queued.discard(token)
            self._begin_chunk(run)

        # Another run may have computed some of the cases since they were read.
        known = await run_sync(self._queries.cache.get_many, [case.request.key for case in cases])
        found = [result for key, record in known.items() for result in run.results(key, record, None, own=False)]
        if found:
            await run.take(found)
        unknown = {case.request.key: case.request for case in cases if case.request.key not in known}
        shared = self._queries.in_flight(unknown, queued=not run.urgent)
        if shared:
            run.group.start_soon(self._take_answers, run, shared)
        if own := [request for key, request in unknown.items() if key not in shared]:
            # A chunk of one case cannot be split, and has the timeout of a call.
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
        """Wait for answers, and pass them to `take`. Cases that failed with a temporary error are queued again."""
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
            # A job has no client that waits for it, and can wait for a worker.
            await asyncio.sleep(NO_WORKER_SECONDS)
        if again:
            # The cases go to the front, in their order, so that the first results of a job come first.
            run.waiting.extendleft(reversed(again))
            self._begin_chunk(run)


async def only(block: Mapping[int, JobCase]) -> Blocks:
    """Yield a single block of cases."""
    yield block
