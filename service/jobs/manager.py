"""Job manager: runs small batches at once, and jobs in the background, across restarts and crashes."""

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
from service.operations import KeyedRequest
from service.queries import Answered, Count, QueryService, Rate
from service.telemetry import NO_TRACER, current_traceparent

EXPIRY_SECONDS = 3600.0
"""Interval between removals of expired jobs [s]. Jobs are kept for days, so an hour more does not matter."""
REOPEN_SECONDS = 5.0
"""Interval between attempts to load jobs that could not be read at the start, chosen by judgement. [s]"""
CHECKPOINT_SECONDS = 5.0
"""Interval between checkpoints of the job database [s]. A checkpoint takes a few milliseconds. If the write-ahead log
is damaged, the progress of about one interval is lost."""
CHANGE_SECONDS = 0.2
"""Shortest interval between events of a job [s]. Five updates a second look continuous to a person."""
OWNER = "local"

Value = TypeVar("Value")
log = logging.getLogger(__name__)


class JobManager:
    """Accepts, runs, reads and ends jobs, and runs small batches.

    Parameters
    ----------
    queries
        Query service that computes and stores results.
    jobs
        Store of the jobs.
    max_queued_cases
        Largest number of unfinished cases of all jobs and batches together. One owner may take half of what the other
        owners leave.
    count
        Function that counts finished cases; see `Count`.
    give_back
        Function that gives unused cases of an ended job back to its quota; see `GiveBack`.
    tracer
        Tracer for the spans of jobs.
    clock
        Clock by which jobs expire.
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
        """Warning that jobs were lost, for the readiness probe; empty if none were."""
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
        """Owners and idempotency keys of requests that are being accepted."""
        # Cases are counted while a body is being read, since several large bodies could otherwise exceed the limit
        # together.
        self._received: Counter[str] = Counter()
        """Numbers of cases received so far for jobs whose bodies are being read, by owner."""
        self._resumed = False
        """True once the unfinished jobs in the store have been loaded."""
        self._resuming = asyncio.Lock()
        self._stopping = False
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def queued_cases(self) -> int:
        """Number of cases that wait or are being computed."""
        return self._queued.total()

    @property
    def running_chunks(self) -> int:
        """Number of chunks of jobs that are being prepared, queued, computed or stored."""
        return self._runner.job_chunks

    @property
    def rate(self) -> float:
        """Rate of completed cases over the last half minute of work. [1/s]"""
        return self._rate.per_second

    def jobs_ahead(self, state: JobState) -> int:
        """Return the number of jobs of the same owner that are computed before a job."""
        return len(self._scheduler.ahead(state))

    def seconds_until_done(self, state: JobState) -> int:
        """Return the estimated time until a job ends, in whole seconds.

        The estimate counts the cases that are computed before the end of the job, and all samples that a running study
        may still take. It uses the measured rate or, before there is one, the cost of the cases.
        """
        operation = self._queries.operations.get(state.operation)
        weight = 1 if operation is None else operation.weight
        return self._rate.seconds_for(self._scheduler.cases_until_done(state), weight)

    async def start(self) -> None:
        """Continue unfinished jobs. If the store cannot be read, the service runs without jobs and retries."""
        try:
            await self._resume()
        except StorageError as error:
            log.warning("%s", error)
        self._tasks = [asyncio.create_task(work) for work in (self._expire(), self._checkpoint(), self._clocks.run())]

    async def check(self) -> None:
        """Check that jobs can be stored.

        Raises
        ------
        StorageError
            If the file of jobs or the data folder has been removed or replaced, or the jobs cannot be read.
        """
        await run_sync(self._jobs.check)
        await self._resume()

    async def stop(self) -> None:
        """Stop the manager. Running jobs are interrupted, and resume at the next start."""
        self._stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._scheduler.stop()
        await run_sync(self._jobs.close)

    def run_now(
        self, operation: str, cases: Sequence[JobCase], more: int = 0, *, owner: str = OWNER
    ) -> AsyncGenerator[CaseResult, None]:
        """Run cases at once, and yield the result of each as it finishes. Closing the generator stops the work.

        Parameters
        ----------
        more
            Number of cases of the same request that follow in later calls.

        Raises
        ------
        QueueFullError
            By the call itself, if too many cases are waiting.
        PoolUnavailableError
            During the iteration, if no worker can take the cases.
        """
        # The check is made before the generator starts, so that a route can refuse the request with an error status
        # instead of breaking off a response.
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
        """Return the record of a study, and whether it came from the cache or from an equal study in flight.

        Parameters
        ----------
        study
            Validated request.
        owner
            Owner whose share of the workers the samples count against.
        take
            Function called with the cost of samples before they are computed. [ordinary cases]
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
        """Store and queue a job. Once this has returned, the job will be finished even after a crash.

        Parameters
        ----------
        blocks
            Blocks of cases.
        queue
            Owner whose share of the workers the cases count against, if other than `owner`. After a restart of the
            service it is `owner`.
        sweep
            Request for a sweep.
        charge
            Cost charged to a quota. The unused part is given back at the end of the job.
        count
            Number of cases, if it is known beforehand. Too many cases are then refused before any is stored.
        estimate
            Function that returns an estimate of the number of cases, for the `Retry-After` of a refusal while the body
            is being read.

        Returns
        -------
        state
            State of the job.
        new
            False if the idempotency key has a job already.

        Raises
        ------
        IdempotencyConflictError, IdempotencyBusyError
            If the idempotency key belongs to another request, or its request is still being read.
        QueueFullError
            If too many cases are waiting.
        StorageError
            If the job cannot be stored.
        Exception
            Raised by `blocks`; the job is then removed.
        """
        receive = partial(
            self._receive, operation, blocks, owner, queue or owner, idempotency, sweep, charge, count, estimate
        )
        if idempotency is None:
            return await receive(), True
        # Two owners may choose the same idempotency key by chance.
        token = owner, idempotency.token
        if token in self._accepting:
            raise IdempotencyBusyError("the request with this idempotency key is still being accepted; try again")
        self._accepting.add(token)
        try:
            found = await run_sync(self._jobs.token, *token)
            if found is None:
                return await receive(), True
            if not isinstance(idempotency.digest, str):
                async for _ in blocks:  # The digest is complete only after the whole body has been read.
                    pass
            if found[0] != idempotency.whole_digest:
                raise IdempotencyConflictError("this idempotency key was sent with another request before")
            return await self.job(found[1].id, owner) or found[1], False
        finally:
            self._accepting.discard(token)

    async def job(self, name: str, owner: str | None = OWNER) -> JobState | None:
        """Return the job with this id if it belongs to the owner; None stands for any owner."""
        state = await self._state(name)
        return state if state is not None and owner in {None, state.owner} else None

    async def jobs(self, owner: str | None = OWNER, *, before: int = 0, limit: int | None = None) -> list[JobState]:
        """Return the jobs of an owner, newest first; None stands for all owners. See `JobStore.jobs`."""
        stored = await run_sync(lambda: self._jobs.jobs(owner, before=before, limit=limit))
        return [self._present(state.id) or state for state in stored]

    async def tally(self) -> Counter[Status]:
        """Return the numbers of jobs of all owners by status."""
        # The state in memory is newer than the file: the end of a job might not have been written yet.
        present = self._scheduler.unwritten | {name: job.state for name, job in self._scheduler.active.items()}
        return await run_sync(self._jobs.tally, present) + Counter(state.status for state in present.values())

    async def sweep(self, job: JobState) -> StoredSweep | None:
        """Return the request for a sweep; None for other jobs, and for a damaged sweep."""
        return await run_sync(self._jobs.sweep, job.number)

    async def request(self, job: JobState) -> dict[str, Any] | None:
        """Return the request for a sweep or a study; None for other jobs, and for a damaged request."""
        if not job.is_study:
            sweep = await self.sweep(job)
            return None if sweep is None else sweep.request
        [case] = await run_sync(self._jobs.rows, job, 0, 1)
        return None if case.request is None else orjson.loads(case.request)

    async def partial(self, job: JobState) -> dict[str, Any] | None:
        """Return the latest partial answer of a study that has not succeeded; None for other jobs."""
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
        """Read the available results of a job in blocks, and yield the value of `use` for each block.

        The reading ends at the first case without a result; if the job has ended, such cases are skipped. Evicted
        results are computed again; see `ResultReader.read` for `take` and `whole`. `use` runs in a thread, for at most
        two blocks of all readers at a time, which bounds their memory.
        """
        async for used in self._reader.read(lambda: self._state(name), use, start, limit, take, whole=whole):
            yield used

    async def cancel(self, name: str, owner: str | None = OWNER) -> JobState | None:
        """Cancel a job unless it has ended, and return it; None if there is no such job."""
        state = await self.job(name, owner)
        active = self._scheduler.active.get(name)
        if state is None or active is None:
            return state
        return await self._scheduler.end(active, "dismissed")

    async def rename(self, name: str, title: str, owner: str | None = OWNER) -> JobState | None:
        """Change the title of a job, and return it; None if there is no such job."""
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
        """Cancel and remove a job; return False if there is no such job."""
        state = await self.cancel(name, owner)
        if state is None:
            return False
        await run_sync(self._jobs.discard, state.number)
        self._scheduler.unwritten.pop(name, None)
        return True

    async def changes(self, name: str) -> AsyncGenerator[JobState, None]:
        """Yield the state of a job, and again after changes, at most five times a second, until it has ended."""
        sent = None
        while not self._stopping:
            active = self._scheduler.active.get(name)
            # The event is read before the state, so that a change between the two is noticed by `wait` below.
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
            # The pause limits the rate of events. All changes during it are sent as one.
            await asyncio.sleep(CHANGE_SECONDS)

    def _run_samples(
        self, operation: str, cases: Sequence[JobCase], more: int, *, owner: str
    ) -> AsyncGenerator[CaseResult, None]:
        """Run samples of a study that is a job, and yield their results."""
        return self._counted(operation, self._runner.results(operation, cases, more, owner=owner, urgent=False))

    @property
    def _queued(self) -> Counter[str]:
        """Numbers of cases that wait or are being computed, by owner."""
        queued = self._received + self._runner.queued
        for job in self._scheduler.active.values():
            queued[job.queue] += job.state.total - job.state.done
        return queued

    def _admit(self, owner: str, count: int, more: int = 0) -> None:
        """Refuse cases of an owner if too many would wait.

        One owner may fill half of the space that the others leave, so that there is always room for another owner.

        Parameters
        ----------
        more
            Number of cases of the request that follow, for the `Retry-After` of the refusal.
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
        await self._resume()
        # The job runs after this request has ended, and its spans refer to the span of the request.
        traceparent = current_traceparent()
        job = await run_sync(lambda: self._jobs.create(operation, owner, sweep, traceparent=traceparent))
        received = 0
        first: bytes | None = None

        def append(number: int, cases: Sequence[JobCase]) -> None:
            """Compress and store a block. Both take long, so this runs in a thread."""
            self._jobs.append(job, number, CaseBlock.of(cases))

        try:
            waiting: list[JobCase] = []
            number = 0
            async for cases in blocks:
                self._admit(queue, len(cases), max(0, estimate() - received - len(cases)))
                received += len(cases)
                first = first or (cases[0].request.json if cases else None)
                self._received[queue] += len(cases)
                waiting += cases
                while len(waiting) >= BLOCK_SIZE:
                    await run_sync(append, number, waiting[:BLOCK_SIZE])
                    waiting, number = waiting[BLOCK_SIZE:], number + 1
            if waiting:
                await run_sync(append, number, waiting)
            state = await run_sync(self._jobs.accept, job, received, idempotency, charge)
        except BaseException:
            # If the removal fails, the next start removes the job, because it was never accepted.
            with CancelScope(shield=True), suppress(StorageError):
                await run_sync(self._jobs.discard, job)
            raise
        finally:
            self._received -= Counter({queue: received})
        self._scheduler.add(state, first, queue)
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
        """Return the state of a job in memory, which is newer than the stored one; None if it is not in memory."""
        active = self._scheduler.active.get(name)
        return active.state if active is not None else self._scheduler.unwritten.get(name)

    async def _state(self, name: str) -> JobState | None:
        return self._present(name) or await run_sync(self._jobs.job, name)

    async def _resume(self) -> None:
        """Load the unfinished jobs of an earlier process, and remove those that it did not accept completely.

        This is done once, before any new job is stored, since it would also remove jobs that are being received.
        """
        async with self._resuming:
            if self._resumed:
                return
            removed = await run_sync(partial(self._jobs.expire, at_start=True))
            for state in await run_sync(self._jobs.unfinished):
                rows = await run_sync(self._jobs.rows, state, 0, 1)
                self._scheduler.add(state, rows[0].request if rows else None)
            self._resumed = True
            if self._jobs.was_missing and self._queries.cache.found_results:
                self.warning = (
                    "jobs.sqlite was missing or empty at the start, though there are results: earlier jobs are lost"
                )
                log.warning("%s; restore it from a backup before new jobs are made", self.warning)
            if removed or self._scheduler.active:
                log.info("jobs: %d to resume, %d removed", len(self._scheduler.active), removed)

    async def _expire(self) -> None:
        while True:
            # Until the jobs have been loaded, this task also retries loading them, and runs more often.
            await asyncio.sleep(EXPIRY_SECONDS if self._resumed else REOPEN_SECONDS)
            await self._scheduler.write_ends()
            with suppress(StorageError):
                await self._resume()
                await run_sync(self._jobs.expire)

    async def _checkpoint(self) -> None:
        while True:
            await asyncio.sleep(CHECKPOINT_SECONDS)
            with suppress(StorageError):
                await run_sync(self._jobs.checkpoint)
