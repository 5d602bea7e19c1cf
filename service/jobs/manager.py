"""Accepts batches of cases: small ones run at once, jobs in the background and through restarts and crashes."""

import asyncio
import logging
import math
from collections import Counter
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import aclosing, suppress
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import orjson
from anyio import CancelScope, CapacityLimiter
from anyio.to_thread import run_sync
from opentelemetry.trace import Tracer

from service.cache.record import CaseResult
from service.clock import SYSTEM, Clock, ClockWatch
from service.errors import IdempotencyBusyError, IdempotencyConflictError, QueueFullError, StorageError
from service.jobs.models import BLOCK_SIZE, CaseBlock, Charge, Idempotency, JobCase, JobState, Status, StoredSweep
from service.jobs.reader import ResultReader
from service.jobs.runner import CaseRunner
from service.jobs.scheduler import GiveBack, Scheduler, problem_name
from service.jobs.store import JobStore
from service.jobs.studies import StudyService
from service.operations import KeyedRequest, is_study
from service.queries import Answered, Count, QueryService, Rate
from service.telemetry import NO_TRACER, current_traceparent

EXPIRY_SECONDS = 3600.0
"""Interval between removals of jobs past their retention, which is counted in days [s]."""
REOPEN_SECONDS = 5.0
"""Time between attempts to read a folder of jobs that could not be read at the start."""
CHECKPOINT_SECONDS = 5.0
"""Longest time whose progress a damaged log can cost; a checkpoint takes some milliseconds."""
CHANGE_SECONDS = 0.2
"""Shortest interval between two changes of a job that are sent as events [s]."""
OWNER = "local"

Value = TypeVar("Value")
log = logging.getLogger(__name__)


class JobManager:
    """Accepts, runs and ends batches.

    Parameters
    ----------
    queries
        Computes and keeps results.
    jobs
        Keeps the jobs.
    max_queued_cases
        Cases that may wait, of all jobs together; an owner has room for half of what the others leave.
    count
        Counts cases by how they ended; see `Count`.
    give_back
        Takes back what an ended job has not used of its quota; see `GiveBack`.
    tracer
        Traces the work of jobs.
    clock
        By whose dates jobs expire.
    """

    def __init__(
        self,
        queries: QueryService,
        jobs: JobStore,
        *,
        max_queued_cases: int,
        count: Count = lambda *_: None,
        give_back: GiveBack = lambda *_: None,
        tracer: Tracer = NO_TRACER,
        clock: Clock = SYSTEM,
    ) -> None:
        self.warning = ""
        """What somebody should know of the jobs that were there before."""
        self._clocks = ClockWatch(clock)
        self._count = count
        self._jobs = jobs
        self._queries = queries
        self._most_queued = max_queued_cases
        self._rate = Rate(lambda: queries.executor.capacity)
        self._runner = CaseRunner(queries, self._rate)
        self._studies = StudyService(queries)
        self._scheduler = Scheduler(
            queries, jobs, self._runner, self._count, self._studies, self._run_samples, give_back, tracer
        )
        self._reader = ResultReader(queries, jobs, self._runner, self._studies)
        self._accepting: set[tuple[str, str]] = set()
        """Owners and idempotency keys of what is being received."""
        self._received: Counter[str] = Counter()
        """Cases of jobs that are not yet accepted, by owner."""
        self._going_on = False
        """True once the unfinished jobs in the store have been loaded."""
        self._beginning = asyncio.Lock()
        self._stopping = False
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def queued_cases(self) -> int:
        """Cases that wait or are being computed."""
        return self._queued.total()

    @property
    def running_chunks(self) -> int:
        """Number of chunks of jobs that are being prepared, computed or kept."""
        return self._runner.job_chunks

    @property
    def rate(self) -> float:
        """Cases done in a second, over the last half minute."""
        return self._rate.per_second

    def jobs_ahead(self, state: JobState) -> int:
        """Number of jobs of the same owner that go before a job."""
        return len(self._scheduler.ahead(state))

    def seconds_until_done(self, state: JobState) -> int:
        """Whole seconds until a job is likely to have ended: with what goes before it, of a study with all its samples.

        By the measured rate; before there is one, by the cost of the cases of the job.
        """
        operation = self._queries.operations.get(state.operation)
        weight = 1 if operation is None else operation.weight
        return self._rate.seconds_for(self._scheduler.cases_until_done(state), weight)

    async def start(self) -> None:
        """Go on with the jobs that are not finished. Without a folder for them the service runs all the same."""
        try:
            await self._go_on()
        except StorageError as error:
            log.warning("%s", error)
        self._tasks = [asyncio.create_task(work) for work in (self._expire(), self._checkpoint(), self._clocks.run())]

    async def check(self) -> None:
        """See that jobs can be accepted as far as their file goes.

        Raises
        ------
        StorageError
            If it, or the data folder, has been removed or replaced, or jobs could not be read at the start nor now.
        """
        await run_sync(self._jobs.check)
        await self._go_on()

    async def stop(self) -> None:
        """Give up what is being computed: the next start goes on with it."""
        self._stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._scheduler.stop()
        await run_sync(self._jobs.close)

    def run_now(
        self, operation: str, cases: Sequence[JobCase], more: int = 0, *, owner: str = OWNER
    ) -> AsyncGenerator[CaseResult, None]:
        """Yield the result of every case as it finishes; closing it (`aclose`) stops the work.

        Parameters
        ----------
        more
            Number of cases that the same request will have after these.

        Raises
        ------
        QueueFullError
            At once, if too many cases wait.
        PoolUnavailableError
            While it runs, if no worker can take the cases.
        """
        self._admit(owner, len(cases))
        return self._counted(operation, self._runner.results(operation, cases, more, owner=owner))

    async def answer_study(
        self,
        operation: str,
        request: KeyedRequest,
        study: Any,
        *,
        owner: str = OWNER,
        take: Callable[[int], None] = lambda _: None,
        limiter: CapacityLimiter | None = None,
    ) -> Answered:
        """Return the record of a study, and whether it was there or computed for another who had requested the same.

        Parameters
        ----------
        study
            The validated request.
        owner
            In whose turn its samples are computed.
        take
            Called with the number of samples before they are computed.
        limiter
            Limiter of the threads in which samples are validated.

        Raises
        ------
        QueueFullError, PoolUnavailableError
            As `run_now`.
        """
        run = partial(self.run_now, owner=owner)
        return await self._studies.answer(operation, request, run, study=study, take=take, limiter=limiter)

    async def accept(
        self,
        operation: str,
        blocks: AsyncIterator[Sequence[JobCase]],
        *,
        owner: str = OWNER,
        queue: str = "",
        idempotency: Idempotency | None = None,
        sweep: StoredSweep | None = None,
        charge: Charge | None = None,
        count: int = 0,
        estimate: Callable[[], int] = lambda: 0,
    ) -> tuple[JobState, bool]:
        """Take on a job: from the return of this on it will be finished, whatever happens.

        Parameters
        ----------
        blocks
            Its cases.
        queue
            Owner in whose turn they are computed until the service starts anew, if another.
        sweep
            The request, if it is a sweep.
        charge
            What it counts as against a quota, if less may be used.
        count
            Number of its cases, if known before they are read: too many are refused before any is stored.
        estimate
            Returns about how many there are, else, once some are read: a refusal says when there is room for them all.

        Returns
        -------
        state
            The job.
        new
            False if it was there already.

        Raises
        ------
        IdempotencyConflictError, IdempotencyBusyError
            If the idempotency key has another request, or one still being accepted.
        QueueFullError
            If too many cases wait.
        StorageError
            If the job cannot be stored.
        Exception
            Out of `blocks`. Nothing is left of the job then.
        """
        receive = partial(
            self._receive, operation, blocks, owner, queue or owner, idempotency, sweep, charge, count, estimate
        )
        if idempotency is None:
            return await receive(), True
        token = owner, idempotency.token
        if token in self._accepting:
            raise IdempotencyBusyError("the request with this idempotency key is still being accepted; try again")
        self._accepting.add(token)
        try:
            found = await run_sync(self._jobs.token, *token)
            if found is None:
                return await receive(), True
            if not isinstance(idempotency.digest, str):
                async for _ in blocks:  # the digest is known when the body has been read
                    pass
            if found[0] != idempotency.whole_digest:
                raise IdempotencyConflictError("this idempotency key was sent with another request before")
            return await self.job(found[1].id, owner) or found[1], False
        finally:
            self._accepting.discard(token)

    async def job(self, name: str, owner: str | None = OWNER) -> JobState | None:
        """Job with this id, if the owner has one; None stands for any owner."""
        state = await self._state(name)
        return state if state is not None and owner in {None, state.owner} else None

    async def jobs(self, owner: str | None = OWNER, *, before: int = 0, limit: int | None = None) -> list[JobState]:
        """Jobs of the owner, newest first; None stands for all owners. `before` and `limit` as in `JobStore.jobs`."""
        stored = await run_sync(lambda: self._jobs.jobs(owner, before=before, limit=limit))
        return [self._present(state.id) or state for state in stored]

    async def tally(self) -> Counter[Status]:
        """Return how many jobs of all owners there are, by status."""
        present = self._scheduler.unwritten | {name: job.state for name, job in self._scheduler.active.items()}
        return await run_sync(self._jobs.tally, present) + Counter(state.status for state in present.values())

    async def sweep(self, job: JobState) -> StoredSweep | None:
        """Return the request of a job, if it is a sweep."""
        return await run_sync(self._jobs.sweep, job.number)

    async def request(self, job: JobState) -> dict[str, Any] | None:
        """Return the request of a job, if it is a sweep or a study; None too if that of a study is damaged."""
        if not is_study(job.operation):
            sweep = await self.sweep(job)
            return None if sweep is None else sweep.request
        [case] = await run_sync(self._jobs.rows, job, 0, 1)
        return None if case.request is None else orjson.loads(case.request)

    async def partial(self, job: JobState) -> dict[str, Any] | None:
        """Return the latest partial answer of a study that is not finished."""
        if job.progress is None or job.status == "successful":
            return None
        return await run_sync(self._jobs.partial, job.number)

    async def results(
        self,
        name: str,
        use: Callable[[list[CaseResult]], Value],
        *,
        start: int = 0,
        limit: int | None = None,
        take: Callable[[int], None] = lambda _: None,
        whole: bool = False,
    ) -> AsyncGenerator[Value, None]:
        """Yield what `use` makes of the results that are ready of a job, in order, in blocks, from case `start` on.

        Ends at the first case that is not ready yet; if the job has ended, such cases are left out. What the cache has
        lost is computed again: `take` and `whole` as in `ResultReader.read`. `use` is called in a thread, for two
        blocks of all jobs at a time, so that readers take memory for what they send alone.
        """
        async for used in self._reader.read(lambda: self._state(name), use, start, limit, take, whole=whole):
            yield used

    async def cancel(self, name: str, owner: str | None = OWNER) -> JobState | None:
        """End the job as it is, if it has not ended; return it."""
        state = await self.job(name, owner)
        active = self._scheduler.active.get(name)
        if state is None or active is None:
            return state
        return await self._scheduler.end(active, "dismissed")

    async def rename(self, name: str, title: str, owner: str | None = OWNER) -> JobState | None:
        """Give the job another title; return it."""
        state = await self.job(name, owner)
        if state is None:
            return None
        renamed = await run_sync(self._jobs.rename, state.number, title)
        if active := self._scheduler.active.get(name):
            active.state = replace(active.state, title=title)
        if unwritten := self._scheduler.unwritten.get(name):
            self._scheduler.unwritten[name] = replace(unwritten, title=title)
        return self._present(name) or renamed

    async def delete(self, name: str, owner: str | None = OWNER) -> bool:
        """Cancel the job and remove it; return whether there was one."""
        state = await self.cancel(name, owner)
        if state is None:
            return False
        await run_sync(self._jobs.discard, state.number)
        self._scheduler.unwritten.pop(name, None)
        return True

    async def changes(self, name: str) -> AsyncGenerator[JobState, None]:
        """Yield the job as it is, then at each change, at most five times a second; ends after the last."""
        sent = None
        while not self._stopping:
            active = self._scheduler.active.get(name)
            changed = active.changed if active is not None else None
            state = await self._state(name)
            if state is None:
                return
            if state.revision != sent:
                sent = state.revision
                yield state
            if state.final or changed is None:
                return
            await changed.wait()
            await asyncio.sleep(CHANGE_SECONDS)

    def _run_samples(
        self, operation: str, cases: Sequence[JobCase], more: int, *, owner: str
    ) -> AsyncGenerator[CaseResult, None]:
        """Yield the results of samples of a study that is a job."""
        return self._counted(operation, self._runner.results(operation, cases, more, owner=owner, urgent=False))

    @property
    def _queued(self) -> Counter[str]:
        """Cases that wait or are being computed, by owner."""
        queued = self._received + self._runner.queued
        for job in self._scheduler.active.values():
            queued[job.queue] += job.state.total - job.state.done
        return queued

    def _admit(self, owner: str, count: int, more: int = 0) -> None:
        """Refuse cases of an owner if too many would wait; `more` of the same request are to come.

        Half of what the others leave is always free for the next owner, however many there are.
        """
        queued = self._queued
        over = queued[owner] + count - math.ceil((self._most_queued - queued.total() + queued[owner]) / 2)
        if over > 0:
            raise QueueFullError(self._rate.seconds_for(over + more))

    async def _receive(
        self,
        operation: str,
        blocks: AsyncIterator[Sequence[JobCase]],
        owner: str,
        queue: str,
        idempotency: Idempotency | None,
        sweep: StoredSweep | None,
        charge: Charge | None,
        count: int,
        estimate: Callable[[], int],
    ) -> JobState:
        self._admit(queue, count)
        await self._go_on()
        traceparent = current_traceparent()
        job = await run_sync(lambda: self._jobs.create(operation, owner, sweep, traceparent=traceparent))
        received = 0

        def append(number: int, cases: Sequence[JobCase]) -> None:
            """Compress and store a block, both of which take long."""
            self._jobs.append(job, number, CaseBlock.of(cases))

        try:
            waiting: list[JobCase] = []
            number = 0
            async for cases in blocks:
                self._admit(queue, len(cases), max(0, estimate() - received - len(cases)))
                received += len(cases)
                self._received[queue] += len(cases)
                waiting += cases
                while len(waiting) >= BLOCK_SIZE:
                    await run_sync(append, number, waiting[:BLOCK_SIZE])
                    waiting, number = waiting[BLOCK_SIZE:], number + 1
            if waiting:
                await run_sync(append, number, waiting)
            state = await run_sync(self._jobs.accept, job, received, idempotency, charge)
        except BaseException:
            with CancelScope(shield=True), suppress(StorageError):  # the next start removes what is left
                await run_sync(self._jobs.discard, job)
            raise
        finally:
            self._received -= Counter({queue: received})
        self._scheduler.add(state, queue)
        return state

    async def _counted(
        self, operation: str, results: AsyncGenerator[CaseResult, None]
    ) -> AsyncGenerator[CaseResult, None]:
        async with aclosing(results):
            async for result in results:
                if result.problem is not None:
                    self._count(operation, problem_name(result.problem), "miss", 1)
                elif result.record is not None:
                    self._count(operation, result.record.outcome, "hit" if result.cached else "miss", 1)
                yield result

    def _present(self, name: str) -> JobState | None:
        """Job as it is in memory, if it is there."""
        active = self._scheduler.active.get(name)
        return active.state if active is not None else self._scheduler.unwritten.get(name)

    async def _state(self, name: str) -> JobState | None:
        return self._present(name) or await run_sync(self._jobs.job, name)

    async def _go_on(self) -> None:
        """Load unfinished jobs once, before any new job is stored, so that a half-written one is never picked up."""
        async with self._beginning:
            if self._going_on:
                return
            removed = await run_sync(partial(self._jobs.expire, at_start=True))
            for state in await run_sync(self._jobs.unfinished):
                self._scheduler.add(state)
            self._going_on = True
            if self._jobs.was_missing and self._queries.cache.found_results:
                self.warning = (
                    "jobs.sqlite was missing or empty at the start, though there are results: earlier jobs are lost"
                )
                log.warning("%s; restore it from a backup before new jobs are made", self.warning)
            if removed or self._scheduler.active:
                log.info("jobs: %d to go on with, %d removed", len(self._scheduler.active), removed)

    async def _expire(self) -> None:
        while True:
            await asyncio.sleep(EXPIRY_SECONDS if self._going_on else REOPEN_SECONDS)
            await self._scheduler.write_ends()
            with suppress(StorageError):
                await self._go_on()
                await run_sync(self._jobs.expire)

    async def _checkpoint(self) -> None:
        while True:
            await asyncio.sleep(CHECKPOINT_SECONDS)
            with suppress(StorageError):
                await run_sync(self._jobs.checkpoint)
