"""The executor that is a thread of the service."""

import asyncio
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar, TypeVarTuple

from service.errors import ExecutorError, PoolUnavailableError, TaskTimeoutError
from service.workers import Call, CallResult
from service.workers.worker import answer, dumps, loads
from solver import warm_up

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")


class InThreadExecutor:
    """Runs functions in one thread, call by call.

    They pass through the same pickling as in a worker process, so that what works here works there. What a thread
    cannot do: it ends no call. One that takes too long is answered as such, but only once it has ended, and one that
    ends its process ends this one.

    Parameters
    ----------
    task_seconds
        Wall time one call may take.
    """

    worker_pids: list[int]
    restarts = 0
    capacity = 1
    on_cluster = False
    single_capacity = 1
    prefetch = 1
    last_error = "no worker answered in time"
    busy = False

    def __init__(self, *, task_seconds: float) -> None:
        self.worker_pids = [os.getpid()]
        self._task_seconds = task_seconds
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="ricochet-calls")
        self._singles = 0
        self._in_flight: set[asyncio.Task[list[CallResult]]] = set()
        self._stopping = False

    @property
    def queued(self) -> int:
        """Calls submitted singly that wait for the thread."""
        return max(0, self._singles - 1)

    async def start(self) -> None:
        """Compile the solver, or load what was compiled."""
        await asyncio.get_running_loop().run_in_executor(self._thread, warm_up)

    async def submit(self, function: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result:
        """Run a picklable function and return what it returns, or raise what it raises."""
        self._singles += 1
        try:
            (finished,) = await self._see_through([(function, arguments)])
        finally:
            self._singles -= 1
        if finished.error is not None:
            raise finished.error
        result: Result = finished.value
        return result

    async def run(self, calls: Sequence[Call]) -> list[CallResult]:
        """Run a chunk of calls one after the other; others get in between any two of them."""
        return await self._see_through(calls)

    async def probe(self, seconds: float) -> bool:
        """Return whether the thread gets round to it within this time."""
        with suppress(ExecutorError, TimeoutError):
            await asyncio.wait_for(self.submit(os.getpid), seconds)
            return True
        self.busy = not self._stopping
        return False

    async def stop(self, grace: float) -> None:
        """Take no more work, and give up what has not finished at the end of the grace time. [s]"""
        self._stopping = True
        if self._in_flight:
            await asyncio.wait(self._in_flight, timeout=grace)
        for work in list(self._in_flight):
            work.cancel()
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def _see_through(self, calls: Sequence[Call]) -> list[CallResult]:
        if self._stopping:
            raise PoolUnavailableError("the service is stopping")
        work = asyncio.create_task(self._work_off(calls))
        self._in_flight.add(work)
        work.add_done_callback(self._in_flight.discard)
        try:
            return await work
        except asyncio.CancelledError:
            if self._stopping and not _cancelled_from_outside():
                raise PoolUnavailableError("the service is stopping") from None
            raise

    async def _work_off(self, calls: Sequence[Call]) -> list[CallResult]:
        loop, finished = asyncio.get_running_loop(), []
        for call in calls:
            reply = loads(await loop.run_in_executor(self._thread, answer, dumps(call)))
            if reply.seconds > self._task_seconds:
                error = TaskTimeoutError(f"not finished after {self._task_seconds:g} s")
                reply = CallResult(None, error, self._task_seconds)
            finished.append(reply)
        return finished


def _cancelled_from_outside() -> bool:
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
