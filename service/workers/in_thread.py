"""Executor that runs calls in a thread of the service, for use with a debugger."""

import asyncio
import os
from concurrent.futures import ThreadPoolExecutor

from service.errors import TaskTimeoutError
from service.workers import CallResult
from service.workers.executor import Executor, dumps, loads
from service.workers.work_queue import Kind, Work
from service.workers.worker import answer
from solver import warm_up


class InThreadExecutor(Executor):
    """Runs calls one after the other in a thread.

    Calls and results are pickled as for a worker process, so that code that works here also works in one. Unlike a
    process, a thread cannot be stopped: a call that exceeds its timeout fails only once it has ended, and a call that
    ends its process ends the service.

    Parameters
    ----------
    task_seconds
        Timeout of a call, in wall time. [s]
    """

    restarts = 0
    capacity = 1
    single_capacity = 1

    def __init__(self, *, task_seconds: float) -> None:
        super().__init__(task_seconds=task_seconds)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="ricochet-calls")
        self._making_way = False
        self._task: asyncio.Task[None] | None = None

    @property
    def worker_pids(self) -> list[int]:
        """Process id of the service."""
        return [os.getpid()]

    @property
    def busy(self) -> bool:
        """True unless the executor is stopping: a probe that failed was only waiting for the running call."""
        return not self.stopping

    async def start(self) -> None:
        """Load the compiled solver, and begin to take work. The first start of an installation compiles the solver."""
        await asyncio.get_running_loop().run_in_executor(self._thread, warm_up)
        self._task = asyncio.create_task(self._serve())

    async def close(self, seconds: float) -> None:
        """Stop taking calls. The running call continues to its end."""
        if self._task is not None:
            self._task.cancel()
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def _serve(self) -> None:
        while True:
            work = await self.queue.get()
            work.begin()
            await self._work_off(work)

    async def _work_off(self, work: Work) -> None:
        """Run the calls of a work item until it is finished or cancelled, or until other work has to run first."""
        loop, self._making_way = asyncio.get_running_loop(), False
        if work.kind is Kind.CHUNK:
            self.queue.begin_chunk(work, self._make_way)
        for call in work.left:
            reply = loads(await loop.run_in_executor(self._thread, answer, dumps(call)))
            if reply.seconds > self.task_seconds:
                error = TaskTimeoutError(f"not finished after {self.task_seconds:g} s")
                reply = CallResult(None, error, self.task_seconds)
            work.finish(reply)
            if self._making_way or work.future.done():
                break
        self.queue.end_chunk(work)
        if work.left:
            self.queue.put_back(work)
        elif not work.future.done():
            work.future.set_result(work.results)

    def _make_way(self) -> None:
        self._making_way = True
