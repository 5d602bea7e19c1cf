"""Scheduler of jobs. Among the jobs of an owner, the one with the fewest cases left comes first.

The service may crash at any time. The results of a chunk are stored before its cases are marked as done, so that after
a restart its cases are either done, or found in the cache, or computed again.
"""

import asyncio
import logging
import math
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, aclosing, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, TypeAlias

from anyio import CancelScope
from anyio.to_thread import run_sync
from opentelemetry.trace import Tracer

from service.cache.record import CaseResult
from service.errors import DamagedCasesError, JobGoneError, StorageError, case_problem, problem_of
from service.jobs.models import BLOCK_SIZE, CaseRow, CaseState, JobCase, JobState, Status, is_of
from service.jobs.runner import Blocks, CaseRunner
from service.jobs.store import VERSIONS, JobStore
from service.jobs.studies import StudyService
from service.operations import KeyedRequest
from service.queries import Count, QueryService
from service.telemetry import span_within
from solver import ParameterError

AHEAD = 10
"""Number of blocks of cases looked up in the cache at once, 2,000 cases. Chosen by judgement: a cached job is marked in
few transactions, and the cases take little memory."""
STORED = "stored"
"""Outcome in the metrics of a case whose result was in the cache; the record with its actual outcome is not read."""

GiveBack: TypeAlias = Callable[[str, int, int], None]
"""Function that gives cases back to a quota. Its arguments are the id of the API key, the number of cases, and the
start of the time step in which they were charged, in seconds since 1970."""
log = logging.getLogger(__name__)


@dataclass(eq=False)
class ActiveJob:
    """A job that has not ended, and its running task."""

    state: JobState
    queue: str
    """Owner whose share of the workers the cases count against."""
    samples: int = 1
    """Number of samples that each case counts as: 1 or, for studies, the largest number of samples of the first one."""
    ended: Callable[[JobState], object] = lambda _: None
    """Function called once, with the final state."""
    scope: CancelScope = field(default_factory=CancelScope)
    """Scope that cancels the work."""
    work: "asyncio.Task[None] | None" = None
    """Task of the work; None before it has begun."""
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    """Event set at the next change of the state, and then replaced with a new one."""

    @property
    def left(self) -> int:
        """Number of unfinished cases or, for studies, of samples that they may still take.

        For a job of one study it is 0 until the first report of its progress.
        """
        if self.state.is_study:
            progress = self.state.progress or {"max_samples": 0, "samples": 0}
            return int(progress["max_samples"] - progress["samples"])
        return self.samples * (self.state.total - self.state.done)

    def update(self, state: JobState) -> None:
        """Set a newer state, and wake the followers of the job."""
        # Cases are marked in threads, which may finish in any order, so the given state may be the older one.
        if state.revision > self.state.revision:
            before, self.state = self.state, state
            if state.final and not before.final:
                self.ended(state)
        # The event is replaced before it is set, so that a follower that wakes at once waits for the next change.
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()


class Scheduler:
    """Runs the cases of all jobs.

    Parameters
    ----------
    queries
        Query service with the cache.
    jobs
        Store of the jobs.
    runner
        Runner of the cases.
    count
        Function that counts finished cases.
    studies, run_cases
        Service that answers studies, and function that computes their samples.
    give_back
        Function that gives unused cases of an ended job back to its quota.
    tracer
        Tracer of chunks and studies.
    """

    def __init__(
        self,
        queries: QueryService,
        jobs: JobStore,
        runner: CaseRunner,
        count: Count,
        studies: StudyService,
        run_cases: Callable[..., AsyncGenerator[CaseResult, None]],
        give_back: GiveBack,
        tracer: Tracer,
    ) -> None:
        self.active: dict[str, ActiveJob] = {}
        self.unwritten: dict[str, JobState] = {}
        """Final states that could not be written yet, by id. The next start continues a job whose final state is not
        written."""
        self._queries = queries
        self._jobs = jobs
        self._runner = runner
        self._count = count
        self._studies = studies
        self._run_cases = run_cases
        self._give_back = give_back
        self._tracer = tracer
        self._stopping = False
        self._handing_out: set[ActiveJob] = set()
        """Jobs that have begun and still have cases to hand to the runner."""

    def add(self, state: JobState, first: bytes | None, queue: str = "") -> None:
        """Queue a job.

        Parameters
        ----------
        first
            Canonical request of its first case; None if that is damaged.
        queue
            Owner whose share of the workers the job counts against, if other than its own.
        """
        if state.final:
            return
        operation = self._queries.operations.get(state.operation)
        samples = 1 if operation is None or first is None else operation.samples(first)
        job = self.active[state.id] = ActiveJob(state, queue or state.owner, samples, self._settle_charge)
        self._begin_jobs(job.queue)

    def ahead(self, state: JobState) -> list[ActiveJob]:
        """Return the jobs of the same owner that are computed before a job.

        They have fewer cases left, or as many and are older.
        """
        own = self.active.get(state.id)
        if own is None:
            return []
        place = (own.left, state.number)
        return [job for job in self.active.values() if job.queue == own.queue and (job.left, job.state.number) < place]

    def cases_until_done(self, state: JobState) -> int:
        """Estimate the number of cases that will be computed before a job ends, including its own.

        Jobs of the same owner with fewer cases are computed first. As owners share the workers equally, each other
        owner has as many cases computed in that time, or all of its cases if it has fewer.
        """
        own = self.active.get(state.id)
        if own is None:
            return 0
        mine = own.left + sum(job.left for job in self.ahead(state))
        others = Counter[str]()
        for job in self.active.values():
            if job.queue != own.queue:
                others[job.queue] += job.left
        return mine + sum(min(mine, theirs) for theirs in others.values())

    async def stop(self) -> None:
        """Interrupt the running jobs. They resume at the next start."""
        self._stopping = True
        await asyncio.gather(*(self.halt(job) for job in self.active.values()))
        for job in self.active.values():
            job.update(job.state)
        await self.write_ends()

    async def halt(self, job: ActiveJob) -> None:
        """Cancel the work of a job, and wait until it has ended."""
        job.scope.cancel()
        # The task of a job may call this itself, and must not wait for itself.
        if job.work is not None and job.work is not asyncio.current_task():
            await asyncio.wait([job.work])

    async def end(self, job: ActiveJob, status: Status, problem: dict[str, Any] | None = None) -> JobState | None:
        """Cancel the work of a job, which takes up to a second, and end it. Return None if it has been deleted."""
        await self.halt(job)
        try:
            state = await run_sync(self._jobs.end, job.state.number, status, problem)
        except JobGoneError:
            self.active.pop(job.state.id, None)
            job.update(job.state)
            return None
        except StorageError:
            # The disk is full or missing. Clients are told that the job has ended; the final state is written later.
            now, revision = datetime.now(UTC), job.state.revision + 1
            state = replace(job.state, status=status, finished=now, problem=problem, revision=revision)
            self.unwritten[state.id] = state
        job.update(state)
        self.active.pop(state.id, None)
        return state

    async def write_ends(self) -> None:
        """Try again to write the final states in `unwritten`."""
        with suppress(StorageError):
            for state in list(self.unwritten.values()):
                with suppress(JobGoneError):
                    await run_sync(self._jobs.end, state.number, state.status, state.problem)
                self.unwritten.pop(state.id, None)

    def _begin_jobs(self, owner: str) -> None:
        """Begin the owner's job with the fewest cases left, unless a job with as few or fewer still hands out cases.

        All jobs could begin at once, because the queue of the executor sorts them in the same way. Beginning them one
        by one limits the number of blocks of cases in memory.
        """
        jobs = [job for job in self.active.values() if job.queue == owner and not job.scope.cancel_called]
        waiting = sorted((job for job in jobs if job.work is None), key=lambda job: job.left)
        fewest = min((job.left for job in jobs if job in self._handing_out), default=math.inf)
        if waiting and waiting[0].left < fewest and not self._stopping:
            self._handing_out.add(waiting[0])
            waiting[0].work = asyncio.create_task(self._run(waiting[0]))

    def _note_handed_out(self, job: ActiveJob) -> None:
        """Record that a job has handed out its last case, and begin the next job of the owner."""
        if job in self._handing_out:
            self._handing_out.discard(job)
            self._begin_jobs(job.queue)

    async def _run(self, job: ActiveJob) -> None:
        state = job.state
        try:
            with job.scope:
                if state.is_study:
                    with self._span("study", state, 1):
                        await self._run_study(job)
                else:
                    traced = partial(self._span, "chunk", state)
                    mark, blocks = partial(self._mark, job), self._blocks(job)
                    weight = self._queries.operations[state.operation].weight
                    await self._runner.run(
                        state.operation,
                        blocks,
                        mark,
                        owner=job.queue,
                        remaining=lambda: weight * job.left,
                        urgent=False,
                        traced=traced,
                    )
        except Exception as error:
            # A job that was cancelled is ended, or left to the next start, by the caller of `halt`.
            if not job.scope.cancel_called:
                log.error("job %s failed", state.id, exc_info=error)
                await self.end(job, "failed", case_problem(error))
        finally:
            self._note_handed_out(job)
        if job.state.final:
            self.active.pop(state.id, None)

    def _span(self, name: str, state: JobState, cases: int) -> AbstractContextManager[None]:
        return span_within(
            self._tracer,
            name,
            state.traceparent,
            {"ricochet.job": state.id, "ricochet.operation": state.operation, "ricochet.cases": cases},
        )

    async def _run_study(self, job: ActiveJob) -> None:
        """Answer a study, the only case of its job."""

        async def report(progress: dict[str, Any], partial: dict[str, Any] | None) -> None:
            with suppress(JobGoneError):  # If this job is deleted, others may still follow the same computation.
                job.update(await run_sync(self._jobs.report, job.state.number, progress, partial))

        run = partial(self._run_cases, owner=job.queue)
        async with aclosing(self._blocks(job)) as blocks:
            async for cases in blocks:
                self._note_handed_out(job)
                for number, case in cases.items():
                    try:
                        record, status = await self._studies.answer(
                            job.state.operation, case.request, run, urgent=False, report=report
                        )
                    except ParameterError as error:  # A line of a batch in JSON lines has not been checked before.
                        result = CaseResult(number, None, None, case_problem(error), cached=False)
                    else:
                        result = CaseResult(number, None, record, None, cached=status == "hit")
                    await self._mark(job, [result])

    async def _blocks(self, job: ActiveJob) -> Blocks:
        """Yield the unfinished cases of a job in blocks, and mark those that are already in the cache as done."""
        state = job.state
        if state.versions != VERSIONS:  # The service was upgraded since the job was accepted.
            await run_sync(self._jobs.renew_keys, state.number)
            job.state = replace(state, versions=VERSIONS)
        if state.status == "accepted":
            job.update(await run_sync(self._jobs.begin, state.number))
        for first in range(0, -(-state.total // BLOCK_SIZE), AHEAD):
            waiting, cached, marked = await run_sync(self._look_up, state, first)
            if marked is not None:
                self._count(state.operation, STORED, "hit", cached)
                job.update(marked)
            for begin in range(0, len(waiting), BLOCK_SIZE):
                yield await self._load(job, waiting[begin : begin + BLOCK_SIZE])
        self._note_handed_out(job)

    def _look_up(self, state: JobState, first: int) -> tuple[list[CaseRow], int, JobState | None]:
        """Mark cached cases of the next blocks; return the other cases, the number marked, and the new state."""
        waiting = self._jobs.waiting(state, first, AHEAD)
        known = self._queries.cache.known([row.key for row in waiting])
        # Only keys are looked up: reading the records would take far longer, and they may never be requested.
        cached = {row.number: CaseState.CACHED for row in waiting if row.key in known}
        marked = self._jobs.mark(state.number, cached) if cached else None
        return [row for row in waiting if row.key not in known], len(cached), marked

    async def _load(self, job: ActiveJob, waiting: Sequence[CaseRow]) -> dict[int, JobCase]:
        """Load the cases to compute. Those whose key does not belong to their request are marked as damaged."""

        def check() -> dict[int, JobCase]:
            """Read and hash the requests. Both take long, so this runs in a thread."""
            requests = self._jobs.requests(job.state.number, [row.number for row in waiting])
            return {
                row.number: JobCase(KeyedRequest(row.key, requests[row.number]))
                for row in waiting
                if is_of(job.state.operation, requests[row.number], row.key)
            }

        cases = await run_sync(check)
        if damaged := [row.number for row in waiting if row.number not in cases]:
            problems = {number: problem_of(DamagedCasesError(number, number)) for number in damaged}
            await self._mark(
                job, [CaseResult(number, None, None, each, cached=False) for number, each in problems.items()]
            )
        return cases

    async def _mark(self, job: ActiveJob, results: Sequence[CaseResult]) -> None:
        """Mark cases with stored results as done, count them, and publish the new state of the job.

        Raises
        ------
        StorageError
            If the disk has refused a result: a job must not succeed with results that are missing.
        """
        # The results are stored before the cases are marked; see the module docstring.
        if any(result.record is not None and not result.record.stored for result in results):
            raise StorageError(f"results cannot be stored: {self._queries.cache.last_error or 'the disk refused them'}")
        states: dict[int, CaseState] = {}
        problems: dict[int, dict[str, Any]] = {}
        counts: Counter[tuple[str, str]] = Counter()
        for result in results:
            if result.problem is not None:
                states[result.number] = CaseState.FAILED
                problems[result.number] = result.problem
                counts[problem_name(result.problem), "miss"] += 1
            elif result.cached or result.record is None:
                states[result.number] = CaseState.CACHED
                counts[STORED, "hit"] += 1
            else:
                states[result.number] = CaseState.DONE
                counts[result.record.outcome, "miss"] += 1
        state = await run_sync(self._jobs.mark, job.state.number, states, problems)
        for (outcome, status), count in counts.items():
            self._count(state.operation, outcome, status, count)
        job.update(state)

    def _settle_charge(self, state: JobState) -> None:
        if state.charge is not None:
            self._give_back(state.charge.key_id, state.unused_cases, state.charge.began)


def problem_name(problem: Mapping[str, Any]) -> str:
    """Return the last part of the type of a problem, which is its label in the metrics."""
    name: str = problem["type"].rpartition(":")[2]
    return name
