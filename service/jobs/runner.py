"""Runner that computes the cases of jobs, and of batches that are answered at once, in chunks."""

import asyncio
import math
from collections import Counter, defaultdict, deque
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, aclosing, nullcontext
from dataclasses import dataclass, field
from typing import TypeAlias

import orjson
from anyio import CancelScope, create_task_group
from anyio.abc import TaskGroup
from anyio.to_thread import run_sync

from service.cache.record import CaseResult, Record
from service.errors import ComputationCancelled, PoolUnavailableError, QueueFullError, case_problem
from service.jobs.models import JobCase
from service.operations import Operation
from service.queries import Answered, QueryService, Rate
from service.schemas.quantities import named_units
from solver.units import written_in

URGENT_SECONDS = 0.1
"""Desired duration of a chunk that a client waits for, short so that the first results come soon [s]."""
CHUNK_SECONDS = 0.25
"""Desired duration of a chunk of a job [s]. A crash loses about this much work of each worker, and the overhead of a
chunk is a hundredth of it."""
AHEAD_SHARE = 8
"""Number of workers for each additional chunk in the queue. A run keeps one chunk queued, and one more for every eight
workers, so that no worker is idle. This suffices, since preparing a chunk takes far less time than computing it."""
CHUNKS_KEPT = 2
"""Number of unfinished chunks that a run may have, in addition to two per worker. Without a limit, computed chunks
would fill the memory while a slow disk stores them."""
NO_WORKER_SECONDS = 1.0
"""Delay before retrying cases of a job for which there was no worker [s]. A worker starts in about 1 s."""
OVERLONG_SECONDS = 10.0
"""Timeout of a chunk of several cases [s]: forty times the desired duration, by judgement. Cases that take far longer
than earlier ones are queued again in smaller chunks, so that all workers share them and other work can run between."""
TEMPORARY = (ComputationCancelled, PoolUnavailableError, QueueFullError)
"""Errors that are not caused by the case, and after which it is retried. A case whose worker died is not among them,
because the executor has already retried it (`DEATHS` in `service/workers/worker_process.py`)."""
FIRST_CASES = 4
"""Number of cases in chunks before any time has been measured. It is small because the slowest cases take a minute.
Studies of uncertainty, each of at least 256 samples, begin with single cases."""
MOST_CASES = 256
"""Largest number of cases in a chunk. With cases of 1 ms such a chunk takes 0.25 s, the usual duration."""
MOST_BYTES = 16 * 1024 * 1024
"""Largest size of the answers of one chunk, the same as of a segment [bytes]. Some answers take 4 MB each."""
SHRUNK = 8
"""Factor by which chunks shrink after one that exceeded its timeout. Chosen by judgement: two steps lead from the usual
20 cases or so to single ones."""
NEWEST = 0.3
"""Weight of the latest chunk in the moving averages, which follow a sweep as its cases become slower or faster. Chosen
by judgement: one unusual chunk should have little effect, and none after some ten further chunks."""

Blocks: TypeAlias = AsyncGenerator[Mapping[int, JobCase], None]
"""Generator of blocks of cases by number. It is advanced when a chunk is prepared."""
Take: TypeAlias = Callable[[list[CaseResult]], Awaitable[None]]
"""Function that receives results as they finish. A slow one delays the next chunks, so that results do not pile up."""


class ChunkSizer:
    """Chooses the size of chunks from the time and the bytes of earlier cases.

    Parameters
    ----------
    seconds
        Desired duration of a chunk. [s]
    first
        Number of cases in a chunk before any time has been measured.
    """

    def __init__(self, seconds: float, first: int = FIRST_CASES) -> None:
        self._target = seconds
        self._first = first
        self._seconds: float | None = None
        self._nbytes = 0.0
        self._most = MOST_CASES

    @property
    def cases(self) -> int:
        """Number of cases for the next chunk."""
        if self._seconds is None:
            return self._first
        by_time = self._target / max(self._seconds, 1e-6)
        by_bytes = MOST_BYTES / max(self._nbytes, 1.0)
        return max(1, int(min(by_time, by_bytes, self._most)))

    def shrink(self, cases: int) -> None:
        """Make the next chunks smaller, because a chunk of `cases` cases exceeded its timeout."""
        self._most = max(1, min(self._most, cases // SHRUNK))

    def note(self, seconds: Sequence[float], nbytes: int) -> None:
        """Update the averages with the times of cases [s] and the size of all their answers [bytes]."""
        if not seconds:
            return
        mean, size = sum(seconds) / len(seconds), nbytes / len(seconds)
        if self._seconds is None:
            self._seconds, self._nbytes = mean, size
        self._seconds += NEWEST * (mean - self._seconds)
        self._nbytes += NEWEST * (size - self._nbytes)


@dataclass(eq=False)
class Run:
    """State of one call of `CaseRunner.run`. The fields before `group` are its parameters, as is `remaining`."""

    operation: Operation
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
    """Largest number of cases in a chunk once all blocks have been read: the last cases are shared by all workers."""
    preparing: bool = False
    """True while the cases of a chunk are being read."""
    queued: set[object] = field(default_factory=set)
    """Tokens of the chunks that wait for a worker."""
    underway: int = 0
    """Number of chunks that are being prepared, queued, computed or stored."""

    @property
    def may_begin(self) -> bool:
        """True if another chunk should be prepared now."""
        # Only one chunk is prepared at a time, because all read from the same generator of blocks.
        if self.preparing or (self.read and not self.waiting):
            return False
        return len(self.queued) <= self.capacity // AHEAD_SHARE and self.underway < 2 * self.capacity + CHUNKS_KEPT

    def __post_init__(self) -> None:
        first = FIRST_CASES if self.operation.study is None else 1
        self.sizer = ChunkSizer(URGENT_SECONDS if self.urgent else CHUNK_SECONDS, first)

    async def next_chunk(self) -> list[JobCase]:
        """Remove and return the cases of the next chunk, one for each key; none if no case is waiting."""
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
            # The maximum keeps the share of the first such chunk. Otherwise chunks would shrink with the cases left.
            self.share = max(self.share, math.ceil(len(self.waiting) / self.capacity))
            size = min(size, self.share)
        return [next(iter(self.cases[self.waiting.popleft()].values())) for _ in range(size)]

    def samples(self, key: str) -> int:
        """Return the number of samples that each case with a key counts as."""
        return self.operation.samples(next(iter(self.cases[key].values())).request.json)

    def results(self, key: str, record: Record | None, error: Exception | None, *, own: bool) -> list[CaseResult]:
        """Return the results of all cases with a key. `own` is True if the result was computed by this run."""
        cases = self.cases.pop(key)
        problem = None
        if error is not None:
            [case, *_] = cases.values()
            with written_in(named_units(orjson.loads(case.request.json))):
                problem = case_problem(error)
        return [
            CaseResult(number, case.custom_id, record, problem, cached=not own or place > 0)
            for place, (number, case) in enumerate(cases.items())
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
        """Numbers of cases that calls of `results` have not finished yet, by owner."""
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
            Number of cases of the same request that follow in later calls.

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
                    weight = self._queries.operations[operation].cost(cases[0].request)
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
            self.queued -= Counter({owner: left})  # In-place subtraction of a Counter also removes owners at zero.
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
        """Compute all cases of the given blocks, except those found in the cache. Cancellation stops the work.

        Parameters
        ----------
        take
            Function that receives the results after they have been stored.
        owner
            Owner whose share of the workers the cases count against.
        remaining
            Function that returns the cost of the unfinished cases, by which the queue sorts the work of an owner.
            [ordinary cases]
        urgent
            True if a client waits: chunks are short, and are not retried when no worker can take them.
        traced
            Function that returns a context manager, such as a span, for a chunk of the given number of cases.

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
                    run = Run(
                        self._queries.operations[operation],
                        blocks,
                        take,
                        owner,
                        urgent,
                        traced,
                        group,
                        remaining,
                        capacity,
                    )
                    self._begin_chunk(run)
        except ExceptionGroup as errors:  # The first error has cancelled the other chunks, and is the cause.
            raise errors.exceptions[0] from None

    def _begin_chunk(self, run: Run) -> None:
        if run.may_begin:
            run.preparing = True
            run.group.start_soon(self._run_chunk, run)

    async def _run_chunk(self, run: Run) -> None:
        """Prepare and compute the next chunk, and begin the chunk after it as soon as `Run.may_begin` allows."""
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
        """Compute the cases of a chunk, except those now in the cache or being computed for another request."""

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
                run.operation.name, own, owner=run.owner, remaining=run.remaining(), begun=begun, longest=longest
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
        count = 0
        unavailable: Exception | None = None
        for key, future in futures.items():
            error = ComputationCancelled() if future.cancelled() else future.exception()
            before, samples = len(results), run.samples(key)
            if error is None:
                results += run.results(key, future.result()[0], None, own=own)
            elif isinstance(error, TEMPORARY) or not isinstance(error, Exception):
                again.append(key)
                unavailable = error if isinstance(error, PoolUnavailableError) else unavailable
            else:
                results += run.results(key, None, error, own=own)
            count += samples * (len(results) - before)
        if results:
            self._rate.add(count)
            await run.take(results)
        if unavailable is not None:
            if run.urgent:
                raise unavailable
            # No client waits for a job, so it can wait until there is a worker again.
            await asyncio.sleep(NO_WORKER_SECONDS)
        if again:
            # The cases return to the front of the queue, in their order, so that results remain roughly in order.
            run.waiting.extendleft(reversed(again))
            self._begin_chunk(run)


async def only(block: Mapping[int, JobCase]) -> Blocks:
    """Yield a single block of cases."""
    yield block
