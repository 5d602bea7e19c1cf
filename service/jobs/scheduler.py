"""Computes the cases of jobs: a few chunks at a time, owners in turn, until no case is left.

A crash may come at any instant. The results of a chunk are kept first and its cases marked after, so a chunk is either
marked, or found in the cache when the job goes on, or computed then.
"""

import asyncio
import logging
from collections import Counter, defaultdict, deque
from collections.abc import AsyncGenerator, Callable, Coroutine, Mapping, Sequence
from contextlib import aclosing, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, NamedTuple, TypeAlias, TypeVar

from anyio.to_thread import run_sync
from opentelemetry.trace import Tracer

from service.errors import (
    DamagedCasesError,
    JobGoneError,
    StorageError,
    case_problem,
)
from service.fairness import ChunkSizer, FairQueue, Permit
from service.jobs.models import BLOCK_SIZE, CaseResult, CaseState, JobState, Status, block_of
from service.jobs.runner import TEMPORARY, CaseRunner, ChunkAnswers
from service.jobs.store import VERSIONS, JobStore
from service.jobs.studies import Report, StudyService
from service.jobs.traces import span_of
from service.operations import KeyedRequest, is_study
from service.queries import Count, QueryService, Rate

AHEAD = 10
"""Blocks of cases looked up in the cache at once: what is there is marked without a chunk being made of it."""
CHUNKS_KEPT = 2
"""Chunks beside those in the executor, being prepared or kept."""
CHUNK_SECONDS = 0.25
"""Work in a chunk: what a crash costs at most, and a hundred times what handing it over does."""
STORED = "stored"
"""Outcome that is counted for a case whose result was in the cache, as the record is not read."""
RETRY_SECONDS = 1.0
"""Pause before cases that no worker could take are tried again."""
OVERLONG_SECONDS = 10.0
"""Time after which a chunk is given up: cases that take far longer than those before are handed out again in smaller
chunks, so that all workers share them and other work gets in between."""

GiveBack: TypeAlias = Callable[[str, int, int], None]
"""Takes back cases of a quota: id of the API key, cases, begin of the entry that has them."""
Value = TypeVar("Value")
log = logging.getLogger(__name__)


class PendingCase(NamedTuple):
    """A case without a result."""

    number: int
    key: str


@dataclass(eq=False)
class ActiveJob:
    """A job that has not ended, and its work."""

    state: JobState
    queue: str
    """Owner in whose turn it is computed."""
    ended: Callable[[JobState], object] = lambda _: None
    """Called once, with the last state."""
    sizer: ChunkSizer = field(default_factory=lambda: ChunkSizer(CHUNK_SECONDS))
    waiting: deque[PendingCase] = field(default_factory=deque)
    """Cases that are not in the cache, to be computed next."""
    looked_up: int = 0
    """Number of blocks that have been looked up in the cache."""
    work: set["asyncio.Task[None]"] = field(default_factory=set)
    """Tasks that look cases up, compute a chunk or compute a study."""
    stops: set[Callable[[], object]] = field(default_factory=set)
    """Functions that give up what the work waits for."""
    damaged: set[int] = field(default_factory=set)
    """Blocks of cases that cannot be read."""
    ending: bool = False
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    """Set at the next change, and another one put in its place."""

    @property
    def left(self) -> bool:
        """Whether there are cases to hand out."""
        return not self.ending and (bool(self.waiting) or self.looked_up * BLOCK_SIZE < self.state.total)

    def take(self) -> list[PendingCase]:
        """Take out the cases of the next chunk."""
        return [self.waiting.popleft() for _ in range(min(self.sizer.cases, len(self.waiting)))]

    def update(self, state: JobState) -> None:
        """Take over a newer state, and wake those who follow it."""
        if state.revision > self.state.revision:
            before, self.state = self.state, state
            if state.final and not before.final:
                self.ended(state)
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()


@dataclass(slots=True)
class CaseUpdates:
    """New states of cases, by number; `again` are those to be tried once more."""

    states: dict[int, CaseState] = field(default_factory=dict)
    problems: dict[int, dict[str, Any]] = field(default_factory=dict)
    outcomes: Counter[str] = field(default_factory=Counter)
    """How the computed cases ended."""
    again: list[PendingCase] = field(default_factory=list)
    refused: bool = False
    """Whether no worker could take them."""

    def fail(self, numbers: Sequence[int], problem: dict[str, Any]) -> None:
        """Note that these cases, all alike, have no answer."""
        self.states |= dict.fromkeys(numbers, CaseState.FAILED)
        self.problems |= dict.fromkeys(numbers, problem)

    def take(self, numbers: Mapping[str, Sequence[int]], answers: ChunkAnswers) -> None:
        """Note these answers: of cases with one key only the first was computed, if any was."""
        for answer in answers.found:
            same = numbers[answer.key]
            if answer.record is None:
                self.fail(same, answer.problem or {})
                continue
            self.states |= dict.fromkeys(same, CaseState.CACHED)
            if answer.own:
                self.states[same[0]] = CaseState.DONE
                self.outcomes[answer.record.outcome] += 1
        self.again.extend(PendingCase(number, key) for key in answers.again for number in numbers[key])
        self.refused |= answers.refused is not None


class Scheduler:
    """Hands out the cases of all jobs.

    Parameters
    ----------
    queries
        Computes the cases.
    jobs
        Keeps the jobs.
    runner
        Runs chunks of cases.
    rate, count
        Count every case that is done.
    studies, run_cases
        Answer studies, and compute their samples.
    give_back
        Takes back what an ended job has not used of its quota.
    tracer
        Traces chunks and studies.
    """

    def __init__(
        self,
        queries: QueryService,
        jobs: JobStore,
        runner: CaseRunner,
        rate: Rate,
        count: Count,
        studies: StudyService,
        run_cases: Callable[..., AsyncGenerator[CaseResult, None]],
        give_back: GiveBack,
        tracer: Tracer,
    ) -> None:
        self.active: dict[str, ActiveJob] = {}
        self.unwritten: dict[str, JobState] = {}
        """Jobs that have ended though it could not be written: the next start would go on with them."""
        self._queries = queries
        self._jobs = jobs
        self._runner = runner
        self._rate = rate
        self._count = count
        self._studies = studies
        self._run_cases = run_cases
        self._give_back = give_back
        self._tracer = tracer
        self._queue: FairQueue[ActiveJob] = FairQueue()
        self._begun: set[asyncio.Task[None]] = set()
        """Chunks that are being prepared, computed or kept: their number bounds the memory they take."""
        self._step: asyncio.Task[None] | None = None

    def add(self, state: JobState, queue: str = "") -> None:
        """Take on a job; `queue` is the owner in whose turn it is computed, if not its own."""
        if not state.final:
            self.active[state.id] = job = ActiveJob(state, queue or state.owner, self._settle_charge)
            self._queue.add(job.queue, job)

    async def run(self) -> None:
        """Hand out cases until cancelled."""
        while True:
            job = await self._queue.next()
            while len(self._begun) >= self._queries.chunk_limit + CHUNKS_KEPT:
                await asyncio.wait(self._begun, return_when=asyncio.FIRST_COMPLETED)
            permit = await self._runner.permits.acquire(job.queue, urgent=False)
            step = self._step = asyncio.create_task(self._advance(job, permit))
            self._belongs(job, step)
            await asyncio.shield(step)

    async def stop(self) -> None:
        """Give up what is underway; the next start goes on with it. Call it when `run` has been cancelled."""
        if self._step is not None:
            await asyncio.wait([self._step])
        await asyncio.gather(*(self.halt(job) for job in self.active.values()))
        for job in self.active.values():
            job.update(job.state)
        await self.write_ends()

    async def halt(self, job: ActiveJob) -> None:
        """Hand out nothing more of the job, and give up what is computed for it."""
        job.ending = True
        self._queue.remove(job.queue, job)
        while others := job.work - {asyncio.current_task()}:
            for stop in list(job.stops):
                stop()
            await asyncio.wait(others, timeout=0.1)

    async def end(self, job: ActiveJob, status: Status, problem: dict[str, Any] | None = None) -> JobState | None:
        """End a job as it is, and all its work within a second; return it, unless it was deleted meanwhile."""
        await self.halt(job)
        try:
            state = await run_sync(self._jobs.end, job.state.number, status, problem)
        except JobGoneError:
            self.active.pop(job.state.id, None)
            job.update(job.state)
            return None
        except StorageError:
            now, revision = datetime.now(UTC), job.state.revision + 1
            state = replace(job.state, status=status, finished=now, problem=problem, revision=revision)
            self.unwritten[state.id] = state
        job.update(state)
        self.active.pop(state.id, None)
        return state

    async def write_ends(self) -> None:
        """Write what could not be written before, if it can be now."""
        with suppress(StorageError):
            for state in list(self.unwritten.values()):
                with suppress(JobGoneError):
                    await run_sync(self._jobs.end, state.number, state.status, state.problem)
                self.unwritten.pop(state.id, None)

    async def _advance(self, job: ActiveJob, permit: Permit) -> None:
        """Start the next chunk of the job, if it has one."""
        cases: list[PendingCase] = []
        try:
            if not job.ending:
                cases = await self._next(job)
        except Exception as error:  # noqa: BLE001 (the other jobs go on)
            await self._fail(job, error)
        if job.ending or not cases:
            permit.release()
        elif is_study(job.state.operation):  # The samples of a study take permits themselves.
            permit.release()
            study = self._traced(job, "study", 1, self._run_study(job, cases[0]))
            self._belongs(job, asyncio.create_task(study))
        else:
            chunk = asyncio.create_task(self._traced(job, "chunk", len(cases), self._run_chunk(job, cases, permit)))
            chunk.add_done_callback(lambda _: permit.release())
            self._begun.add(chunk)
            chunk.add_done_callback(self._begun.discard)
            self._belongs(job, chunk)

    async def _traced(self, job: ActiveJob, name: str, cases: int, work: Coroutine[Any, Any, None]) -> None:
        with span_of(self._tracer, name, job.state, cases):
            await work

    def _settle_charge(self, state: JobState) -> None:
        if state.charge is not None:
            self._give_back(state.charge.key_id, state.unused_cases, state.charge.began)

    def _belongs(self, job: ActiveJob, work: "asyncio.Task[None]") -> None:
        """Add this work to the job, and queue or close the job when the work is done."""

        def ended(done: "asyncio.Task[None]") -> None:
            job.work.discard(done)
            self._settle(job)

        job.work.add(work)
        work.add_done_callback(ended)

    def _settle(self, job: ActiveJob) -> None:
        """Queue the job if it has cases to hand out; close it if it has ended."""
        if job.left:
            self._queue.add(job.queue, job, first=True)
            return
        self._queue.remove(job.queue, job)
        if job.state.final and not job.work and not job.ending:
            self.active.pop(job.state.id, None)

    async def _next(self, job: ActiveJob) -> list[PendingCase]:
        state = job.state
        if not job.left:
            return []
        if state.versions != VERSIONS:
            await run_sync(self._jobs.renew_keys, state.number)
            job.state = replace(state, versions=VERSIONS)
        if not job.looked_up and (repaired := await run_sync(self._jobs.repair, state.number)):
            log.error("job %s: what was stored of its progress is damaged; it goes on with what is left", state.id)
            job.update(repaired)
        if state.status == "accepted":
            job.update(await run_sync(self._jobs.begin, state.number))
        if not job.waiting:
            unknown, cached, marked = await run_sync(self._look_up, state.number, job.looked_up)
            job.looked_up += AHEAD
            job.waiting.extend(unknown)
            if marked is not None:
                self._note(job, CaseUpdates(states=cached), marked)
        return job.take()

    def _look_up(self, job: int, first: int) -> tuple[list[PendingCase], dict[int, CaseState], JobState | None]:
        """Mark what is in the cache of the next blocks; return the rest, and what was marked."""
        waiting = [PendingCase(*case) for case in self._jobs.waiting(job, first, AHEAD)]
        known = self._queries.cache.known([case.key for case in waiting])
        if not known:
            return waiting, {}, None
        cached = {case.number: CaseState.CACHED for case in waiting if case.key in known}
        return [case for case in waiting if case.key not in known], cached, self._jobs.mark(job, cached)

    async def _run_chunk(self, job: ActiveJob, cases: Sequence[PendingCase], permit: Permit) -> None:
        try:
            numbers: dict[str, list[int]] = defaultdict(list)
            for number, key in cases:
                numbers[key].append(number)
            requests, updates = await run_sync(self._requests, job, numbers)
            if job.ending:
                return
            wait = partial(self._stoppable, job)
            chunk = self._runner.run_chunk(job.state.operation, requests, permit, job.sizer, wait, OVERLONG_SECONDS)
            async with aclosing(chunk) as parts:
                async for answers in parts:
                    updates.take(numbers, answers)
                    await self._mark(job, updates)
                    updates = CaseUpdates()
        except Exception as error:  # noqa: BLE001 (the other jobs go on)
            await self._fail(job, error)

    async def _run_study(self, job: ActiveJob, case: PendingCase) -> None:
        """Compute a study, the only case of its job."""
        numbers = {case.key: [case.number]}
        try:
            requests, updates = await run_sync(self._requests, job, numbers)
            for request in requests:  # none if it has been answered meanwhile
                answer = self._studies.answer(
                    job.state.operation,
                    request,
                    partial(self._run_cases, owner=job.queue),
                    urgent=False,
                    report=self._report_of(job),
                )
                running = asyncio.ensure_future(answer)
                await self._stoppable(job, running, running.cancel)
                error = None if running.cancelled() else running.exception()
                if error is not None and not isinstance(error, TEMPORARY):
                    raise error
                cached = not running.cancelled() and error is None and running.result()[1] == "hit"
                updates.take(numbers, ChunkAnswers.of({case.key: running}, own=not cached))
            await self._mark(job, updates)
        except Exception as error:  # noqa: BLE001 (the other jobs go on)
            await self._fail(job, error)

    def _report_of(self, job: ActiveJob) -> Report:
        async def report(progress: dict[str, Any], partial: dict[str, Any] | None) -> None:
            with suppress(JobGoneError):  # another job with the same study goes on
                job.update(await run_sync(self._jobs.report, job.state.number, progress, partial))

        return report

    def _requests(self, job: ActiveJob, numbers: Mapping[str, Sequence[int]]) -> tuple[list[KeyedRequest], CaseUpdates]:
        """Return the stored requests of cases; other jobs may have answered some of them since."""
        known = self._queries.cache.known(list(numbers))
        updates = CaseUpdates(dict.fromkeys((n for key in known for n in numbers[key]), CaseState.CACHED))
        unknown = {key: cases for key, cases in numbers.items() if key not in known}
        stored = self._jobs.requests(job.state.number, [number for cases in unknown.values() for number in cases])
        requests = []
        for key, cases in unknown.items():
            whole = next((number for number in cases if number in stored), None)  # of equal cases one is enough
            if whole is not None:
                requests.append(KeyedRequest(key, stored[whole]))
                continue
            for number in cases:
                error = DamagedCasesError(*block_of(number, job.state.total))
                updates.fail([number], case_problem(error))
                if number // BLOCK_SIZE not in job.damaged:
                    log.error("job %s: %s", job.state.id, error)
                    job.damaged.add(number // BLOCK_SIZE)
        return requests, updates

    async def _stoppable(
        self,
        job: ActiveJob,
        waiting: "asyncio.Future[Any]",
        stop: Callable[[], object],
        seconds: float | None = None,
    ) -> bool:
        """Wait for something that ends with the job; return whether it came in time."""
        job.stops.add(stop)
        done, _ = await asyncio.wait([waiting], timeout=seconds)
        job.stops.discard(stop)
        return bool(done)

    async def _mark(self, job: ActiveJob, updates: CaseUpdates) -> None:
        if updates.states:
            state = await run_sync(self._jobs.mark, job.state.number, updates.states, updates.problems)
            self._note(job, updates, state)
        if updates.again and not job.ending:
            if updates.refused:
                pause = asyncio.ensure_future(asyncio.sleep(RETRY_SECONDS))
                await self._stoppable(job, pause, pause.cancel)
            job.waiting.extendleft(reversed(updates.again))

    def _note(self, job: ActiveJob, updates: CaseUpdates, state: JobState) -> None:
        """Count cases that have been marked, and pass the new state of their job on."""
        operation = state.operation
        self._rate.add(len(updates.states))
        for outcome, count in updates.outcomes.items():
            self._count(operation, outcome, "miss", count)
        if cached := sum(state is CaseState.CACHED for state in updates.states.values()):
            self._count(operation, STORED, "hit", cached)
        for problem in updates.problems.values():
            self._count(operation, problem_name(problem), "miss", 1)
        job.update(state)

    async def _fail(self, job: ActiveJob, error: Exception) -> None:
        """End a job that cannot go on."""
        if not job.ending:
            log.error("job %s failed", job.state.id, exc_info=error)
            await self.end(job, "failed", case_problem(error))


def problem_name(problem: Mapping[str, Any]) -> str:
    """Return the last part of the type of a problem, as it is counted."""
    name: str = problem["type"].rpartition(":")[2]
    return name
