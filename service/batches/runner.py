"""Batches of cases: small work at once, jobs in the background, through restarts and crashes."""

import asyncio
import logging
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from anyio import CancelScope, CapacityLimiter
from anyio.to_thread import run_sync

from service.admission import Rate
from service.batches.dispatch import Dispatcher
from service.batches.reading import Reader
from service.batches.small import CaseResult, SmallWork
from service.batches.turns import Slots
from service.engine import Engine
from service.errors import IdempotencyBusyError, IdempotencyConflictError, QueueFullError, StorageError
from service.jobs.slices import SLICE, Case, pack
from service.jobs.store import Idempotency, JobState, JobStore

__all__ = [
    "Case",
    "CaseResult",
    "Idempotency",
    "IdempotencyBusyError",
    "IdempotencyConflictError",
    "JobState",
    "QueueFullError",
    "Runner",
    "StorageError",
]

CHUNKS_KEPT = 2
"""Beside those in the pool, being made or kept: this bounds the memory they take."""
SWEEP_SECONDS = 3600.0
RETRY_SECONDS = 5.0
"""Between looks at a folder of jobs that could not be read at the start."""
CHANGE_SECONDS = 0.2
"""Between two changes told of a job: more than anyone reads."""
THREADS = 2
"""They wait for the disk."""
OWNER = "local"

Value = TypeVar("Value")
log = logging.getLogger(__name__)


class Runner:
    """Runs batches.

    Parameters
    ----------
    engine
        Computes and keeps results.
    jobs
        Keeps the jobs.
    max_queued_cases
        Cases that may wait, of all jobs together.
    """

    def __init__(self, engine: Engine, jobs: JobStore, *, max_queued_cases: int) -> None:
        self._jobs = jobs
        self._engine = engine
        self._most_queued = max_queued_cases
        self._rate = Rate()
        slots = Slots(lambda: engine.places)
        room = Slots(lambda: engine.places + CHUNKS_KEPT)
        self._dispatcher = Dispatcher(engine, jobs, slots, room, self._rate)
        self._small = SmallWork(engine, slots, self._rate)
        self._reader = Reader(engine, jobs, self._small)
        self._accepting: set[tuple[str, str]] = set()
        """Owners and idempotency keys of what is being received."""
        self._received = 0
        """Cases of jobs that are not yet accepted."""
        self._going_on = False
        """Whether the jobs of before have been taken on."""
        self._beginning = asyncio.Lock()
        self._stopping = False
        self._tasks: list[asyncio.Task[None]] = []
        self._threads = CapacityLimiter(THREADS)

    @property
    def queued_cases(self) -> int:
        """Cases that wait or are being computed."""
        waiting = sum(job.state.total - job.state.done for job in self._dispatcher.active.values())
        return self._received + self._small.queued + waiting

    @property
    def running_chunks(self) -> int:
        """Chunks of jobs in the making, in the pool or being kept."""
        return sum(len(job.work) for job in self._dispatcher.active.values())

    @property
    def rate(self) -> float:
        """Cases done in a second, lately."""
        return self._rate.per_second

    async def start(self) -> None:
        """Go on with the jobs that are not finished. Without a folder for them the service runs all the same."""
        try:
            await self._go_on()
        except StorageError as error:
            log.warning("%s", error)
        self._tasks = [asyncio.create_task(self._dispatcher.run()), asyncio.create_task(self._sweep())]

    async def stop(self) -> None:
        """Give up what is being computed: the next start goes on with it."""
        self._stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._dispatcher.stop()
        await self._thread(self._jobs.close)

    def run_now(self, operation: str, cases: Sequence[Case]) -> AsyncGenerator[CaseResult, None]:
        """Yield the result of every case as it finishes; closing it (`aclose`) stops the work.

        Raises
        ------
        QueueFullError
            At once, if too many cases wait.
        PoolUnavailableError
            While it runs, if no worker can take the cases.
        """
        self._admit(len(cases))
        return self._small.run(operation, cases)

    async def accept(
        self,
        operation: str,
        slices: AsyncIterator[Sequence[Case]],
        *,
        owner: str = OWNER,
        idempotency: Idempotency | None = None,
    ) -> tuple[JobState, bool]:
        """Take on a job: from the return of this on it will be finished, whatever happens.

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
            Out of `slices`. Nothing is left of the job then.
        """
        token = (owner, idempotency.token) if idempotency is not None else None
        if token is None or idempotency is None:
            return await self._receive(operation, slices, owner, None), True
        if token in self._accepting:
            raise IdempotencyBusyError("the request with this idempotency key is still being accepted; try again")
        self._accepting.add(token)
        try:
            found = await self._thread(self._jobs.token, *token)
            if found is None:
                return await self._receive(operation, slices, owner, idempotency), True
            if not isinstance(idempotency.digest, str):
                async for _ in slices:  # the digest is known when the body has been read
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

    async def jobs(self, owner: str | None = OWNER) -> list[JobState]:
        """Jobs of the owner, newest first; None stands for all owners."""
        stored = await self._thread(self._jobs.jobs, owner)
        return [self._present(state.id) or state for state in reversed(stored)]

    async def results(
        self, name: str, *, start: int = 0, limit: int | None = None
    ) -> AsyncGenerator[list[CaseResult], None]:
        """Yield what is ready of a job, in order, in slices of up to 200, from case `start` on.

        Ends at the first case that is not ready yet; if the job has ended, such cases are left out. What the cache has
        lost is computed again.
        """
        async for results in self._reader.read(lambda: self._state(name), start, limit):
            yield results

    async def cancel(self, name: str, owner: str | None = OWNER) -> JobState | None:
        """End the job as it is, if it has not ended; return it."""
        state = await self.job(name, owner)
        active = self._dispatcher.active.get(name)
        if state is None or active is None:
            return state
        return await self._dispatcher.end(active, "dismissed")

    async def delete(self, name: str, owner: str | None = OWNER) -> bool:
        """Cancel the job and remove it; return whether there was one."""
        state = await self.cancel(name, owner)
        if state is None:
            return False
        await self._thread(self._jobs.discard, state.number)
        self._dispatcher.unwritten.pop(name, None)
        return True

    async def changes(self, name: str) -> AsyncGenerator[JobState, None]:
        """Yield the job as it is, then at each change, at most five times a second; ends after the last."""
        told = None
        while not self._stopping:
            active = self._dispatcher.active.get(name)
            changed = active.changed if active is not None else None
            state = await self._state(name)
            if state is None:
                return
            if state.revision != told:
                told = state.revision
                yield state
            if state.final or changed is None:
                return
            await changed.wait()
            await asyncio.sleep(CHANGE_SECONDS)

    def _admit(self, count: int) -> None:
        over = self.queued_cases + count - self._most_queued
        if over > 0:
            raise QueueFullError(self._rate.seconds_for(over))

    async def _receive(
        self, operation: str, slices: AsyncIterator[Sequence[Case]], owner: str, idempotency: Idempotency | None
    ) -> JobState:
        self._admit(0)
        await self._go_on()
        job = await self._thread(self._jobs.create, operation, owner)
        received = 0
        try:
            waiting: list[Case] = []
            number = 0
            async for cases in slices:
                self._admit(len(cases))
                received += len(cases)
                self._received += len(cases)
                waiting += cases
                while len(waiting) >= SLICE:
                    await self._thread(self._append, operation, job, number, waiting[:SLICE])
                    waiting, number = waiting[SLICE:], number + 1
            if waiting:
                await self._thread(self._append, operation, job, number, waiting)
            state = await self._thread(self._jobs.accept, job, received, idempotency)
        except BaseException:
            with CancelScope(shield=True), suppress(StorageError):  # the next start removes what is left
                await self._thread(self._jobs.discard, job)
            raise
        finally:
            self._received -= received
        self._dispatcher.add(state)
        return state

    def _append(self, operation: str, job: int, number: int, cases: Sequence[Case]) -> None:
        self._jobs.append(job, number, pack(operation, cases))

    def _present(self, name: str) -> JobState | None:
        """Job as it is in memory, if it is there."""
        active = self._dispatcher.active.get(name)
        return active.state if active is not None else self._dispatcher.unwritten.get(name)

    async def _state(self, name: str) -> JobState | None:
        return self._present(name) or await self._thread(self._jobs.job, name)

    async def _go_on(self) -> None:
        """Take on the jobs of before, unless that was done; no other is stored until then, as half a job may be."""
        async with self._beginning:
            if self._going_on:
                return
            removed = await self._thread(self._sweep_at_start)
            for state in await self._thread(self._jobs.unfinished):
                self._dispatcher.add(state)
            self._going_on = True
            if removed or self._dispatcher.active:
                log.info("jobs: %d to go on with, %d removed", len(self._dispatcher.active), removed)

    def _sweep_at_start(self) -> int:
        return self._jobs.sweep(at_start=True)

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_SECONDS if self._going_on else RETRY_SECONDS)
            await self._dispatcher.write_ends()
            with suppress(StorageError):
                await self._go_on()
                await self._thread(self._jobs.sweep)

    async def _thread(self, function: Callable[..., Value], *arguments: Any) -> Value:
        return await run_sync(function, *arguments, limiter=self._threads)
