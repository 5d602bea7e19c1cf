"""Works off the jobs: a few chunks at a time, owners in turn, until no case is left.

A crash may come at any instant. The results of a chunk are kept first and its cases marked after, so a chunk is either
marked, or found in the cache when the job goes on, or computed then.
"""

import asyncio
import logging
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, TypeVar

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.admission import Rate
from service.batches.active import ActiveJob, Waiting
from service.batches.marks import Marks
from service.batches.turns import Place, Slots, Turns
from service.engine import Engine, Wanted
from service.errors import JobGoneError, StorageError, case_problem
from service.jobs.slices import CaseState
from service.jobs.store import VERSIONS, JobState, JobStore, Status

AHEAD = 10
"""Slices looked up in the cache at once: what is there is marked without a chunk being made of it."""
THREADS = 2
"""They parse and wait for the disk; more of them would hold up the event loop."""
RETRY_SECONDS = 1.0
"""Before cases that no worker could take are tried again."""
OVERLONG_SECONDS = 10.0
"""For a chunk: cases that take far longer than those before are handed out again in smaller ones, so that all workers
share them and other work is let in between."""

Value = TypeVar("Value")
log = logging.getLogger(__name__)


class Dispatcher:
    """Hands out the cases of all jobs.

    Parameters
    ----------
    slots
        Places in the pool, shared with small work.
    room
        Places for chunks that are in the making, in the pool or being kept.
    rate
        Told of every case that is done.
    """

    def __init__(self, engine: Engine, jobs: JobStore, slots: Slots, room: Slots, rate: Rate) -> None:
        self.active: dict[str, ActiveJob] = {}
        self.unwritten: dict[str, JobState] = {}
        """Jobs that have ended though it could not be written: the next start would go on with them."""
        self._engine = engine
        self._jobs = jobs
        self._slots = slots
        self._rate = rate
        self._turns: Turns[ActiveJob] = Turns()
        self._room = room
        self._threads = CapacityLimiter(THREADS)
        self._step: asyncio.Task[None] | None = None

    def add(self, state: JobState) -> None:
        """Take on a job."""
        if not state.final:
            self.active[state.id] = job = ActiveJob(state)
            self._turns.add(state.owner, job)

    async def run(self) -> None:
        """Hand out cases until cancelled."""
        while True:
            job = await self._turns.next()
            room = await self._room.take(urgent=False)
            try:
                place = await self._slots.take(urgent=False)
            except asyncio.CancelledError:
                room.leave()
                raise
            step = self._step = asyncio.create_task(self._advance(job, room, place))
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
        self._turns.remove(job.state.owner, job)
        while others := job.work - {asyncio.current_task()}:
            for stop in list(job.stops):
                stop()
            await asyncio.wait(others, timeout=0.1)

    async def end(self, job: ActiveJob, status: Status, problem: dict[str, Any] | None = None) -> JobState | None:
        """End a job as it is, and all its work within a second; return it, unless it was deleted meanwhile."""
        await self.halt(job)
        try:
            state = await self.thread(self._jobs.end, job.state.number, status, problem)
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
                    await self.thread(self._jobs.end, state.number, state.status, state.problem)
                self.unwritten.pop(state.id, None)

    async def thread(self, function: Callable[..., Value], *arguments: Any) -> Value:
        """Run what waits for the disk, or takes long, in a thread."""
        return await run_sync(function, *arguments, limiter=self._threads)

    async def _advance(self, job: ActiveJob, room: Place, place: Place) -> None:
        """Start the next chunk of the job, if it has one."""
        cases: list[Waiting] = []
        try:
            if not job.ending:
                cases = await self._next(job)
        except Exception as error:  # noqa: BLE001 (the other jobs go on)
            await self._fail(job, error)
        if job.ending or not cases:
            place.leave()
            room.leave()
        else:
            chunk = asyncio.create_task(self._run_chunk(job, cases, place))
            chunk.add_done_callback(lambda _: place.leave())
            chunk.add_done_callback(lambda _: room.leave())
            self._belongs(job, chunk)

    def _belongs(self, job: ActiveJob, work: "asyncio.Task[None]") -> None:
        """See that the job waits for this work, and is put where it belongs after."""

        def ended(done: "asyncio.Task[None]") -> None:
            job.work.discard(done)
            self._settle(job)

        job.work.add(work)
        work.add_done_callback(ended)

    def _settle(self, job: ActiveJob) -> None:
        """Put the job where it belongs now."""
        if job.left:
            self._turns.add(job.state.owner, job, first=True)
            return
        self._turns.remove(job.state.owner, job)
        if job.state.final and not job.work and not job.ending:
            self.active.pop(job.state.id, None)

    async def _next(self, job: ActiveJob) -> list[Waiting]:
        state = job.state
        if not job.left:
            return []
        if state.versions != VERSIONS:
            await self.thread(self._jobs.renew_keys, state.number)
            job.state = replace(state, versions=VERSIONS)
        if state.status == "accepted":
            job.update(await self.thread(self._jobs.begin, state.number))
        if not job.waiting:
            unknown, marked = await self.thread(self._look_up, state.number, job.looked_up)
            job.looked_up += AHEAD
            job.waiting.extend(unknown)
            if marked is not None:
                self._rate.add(max(0, marked.done - job.state.done))
                job.update(marked)
        return job.take()

    def _look_up(self, job: int, first: int) -> tuple[list[Waiting], JobState | None]:
        """Mark what is in the cache of the next slices; return the rest."""
        waiting = [Waiting(*case) for case in self._jobs.waiting(job, first, AHEAD)]
        known = self._engine.cache.known([case.key for case in waiting])
        if not known:
            return waiting, None
        marked = self._jobs.mark(job, {case.number: CaseState.CACHED for case in waiting if case.key in known})
        return [case for case in waiting if case.key not in known], marked

    async def _run_chunk(self, job: ActiveJob, cases: Sequence[Waiting], place: Place) -> None:
        try:
            numbers: dict[str, list[int]] = defaultdict(list)
            for number, key in cases:
                numbers[key].append(number)
            wanted, marks = await self.thread(self._build, job, numbers)
            if job.ending:
                return
            chunk = self._engine.begin(job.state.operation, wanted, place.leave)
            if not await self._stoppable(job, chunk.kept, chunk.stop, OVERLONG_SECONDS if len(wanted) > 1 else None):
                chunk.stop()
                job.pace.shrink(len(wanted))
                await asyncio.wait([chunk.kept])
            if not chunk.pool.cancelled() and chunk.pool.exception() is None:
                sizes = [len(future.result()[0].json) for future in chunk.own.values() if future.exception() is None]
                job.pace.note([finished.seconds for finished in chunk.pool.result()], sum(sizes))
            marks.take(numbers, chunk.own, CaseState.DONE)
            await self._mark(job, marks)
            if chunk.shared:
                waiting = asyncio.ensure_future(asyncio.wait(chunk.shared.values()))
                await self._stoppable(job, waiting, waiting.cancel)
                late = Marks()
                late.take(numbers, chunk.shared, CaseState.CACHED)
                await self._mark(job, late)
        except Exception as error:  # noqa: BLE001 (the other jobs go on)
            await self._fail(job, error)

    def _build(self, job: ActiveJob, numbers: Mapping[str, Sequence[int]]) -> tuple[list[Wanted], Marks]:
        """Make what is to be computed of stored requests; other jobs may have answered some of them since."""
        marks, wanted = Marks(), []
        operation = self._engine.operations[job.state.operation]
        known = self._engine.cache.known(list(numbers))
        first = {key: cases[0] for key, cases in numbers.items() if key not in known}
        requests = self._jobs.requests(job.state.number, first.values())
        marks.states.update(dict.fromkeys((n for key in known for n in numbers[key]), CaseState.CACHED))
        for key, number in first.items():
            try:
                request = operation.parse(requests[number])
                wanted.append(Wanted(key, requests[number], request, operation.call(request)))
            except Exception as error:  # noqa: BLE001 (of this case alone)
                marks.fail(numbers[key], error)
        return wanted, marks

    async def _stoppable(
        self,
        job: ActiveJob,
        waiting: "asyncio.Future[Any]",
        stop: Callable[[], object],
        seconds: float | None = None,
    ) -> bool:
        """Wait for something that the end of the job puts an end to; tell whether it came in time."""
        job.stops.add(stop)
        done, _ = await asyncio.wait([waiting], timeout=seconds)
        job.stops.discard(stop)
        return bool(done)

    async def _mark(self, job: ActiveJob, marks: Marks) -> None:
        if marks.states:
            job.update(await self.thread(self._jobs.mark, job.state.number, marks.states, marks.problems))
            self._rate.add(len(marks.states))
        if marks.again and not job.ending:
            if marks.unavailable:
                pause = asyncio.ensure_future(asyncio.sleep(RETRY_SECONDS))
                await self._stoppable(job, pause, pause.cancel)
            job.waiting.extendleft(reversed(marks.again))

    async def _fail(self, job: ActiveJob, error: Exception) -> None:
        """End a job that cannot go on."""
        if not job.ending:
            log.error("job %s failed", job.state.id, exc_info=error)
            await self.end(job, "failed", case_problem(error))
