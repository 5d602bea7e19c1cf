"""The pool: one worker process to a core, one task at a time in each, behind an awaitable ``submit``.

Each worker has a thread and a pipe of its own, and they share nothing: no queue, no lock. So a worker may be killed
at any instant, also halfway through sending a result, and the only task it can take with it is the one it was on.
The libraries looked at share a pipe among the workers: there one SIGKILL fails every task in flight
(``concurrent.futures``, loky) or stops the pool for good (pebble).
"""

import asyncio
import itertools
import multiprocessing
import os
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from typing import Any, TypeVar, TypeVarTuple

from service.lane import ExecutorError, Job, Lane, PoolUnavailableError

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")

KILL_SECONDS = 0.5
"""Kept back from the grace time to end workers that are still busy."""
PROBE, WORK, END = 0, 1, 2
"""Priorities: a probe overtakes waiting work."""


class PoolExecutor:
    """Runs functions in worker processes.

    Parameters
    ----------
    workers
        Number of processes.
    task_seconds
        Wall time one task may take; its worker is killed then, as nothing else interrupts compiled code.
    """

    def __init__(self, *, workers: int, task_seconds: float) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["service.preload", "service.worker"])
        self._jobs: queue.PriorityQueue[Job] = queue.PriorityQueue()
        self._numbers = itertools.count()
        self._unfinished: set[Future[Any]] = set()
        self._stopping = False
        self._closed = threading.Event()
        self._lanes = [Lane(context, self._jobs, self._closed, task_seconds) for _ in range(workers)]

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers that are up."""
        return [lane.worker.pid for lane in self._lanes if lane.worker is not None]

    async def start(self) -> None:
        """Bring every worker up, warm.

        Raises
        ------
        PoolUnavailableError
            If one could not be started.
        """
        for lane in self._lanes:
            lane.thread.start()
        try:
            await asyncio.gather(*(asyncio.wrap_future(lane.started) for lane in self._lanes))
        except BaseException:
            await self.stop(0.0)
            raise

    async def submit(self, function: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result:
        """Run a picklable function in a worker and return what it returns, or raise what it raises.

        Cancelled while it waits for a worker, it never runs; once running, it runs to its end.

        Raises
        ------
        WorkerCrashedError, TaskTimeoutError, PoolUnavailableError
            If the pool could not bring it to an end.
        """
        result: Result = await self._enqueue(WORK, function, arguments)
        return result

    async def probe(self, seconds: float) -> bool:
        """Tell whether a worker answers within this time; overtakes what waits, not what runs."""
        with suppress(ExecutorError, TimeoutError):
            await asyncio.wait_for(self._enqueue(PROBE, os.getpid, ()), seconds)
            return True
        return False

    async def stop(self, grace: float) -> None:
        """Take no more work, let what there is finish, and have ended all workers within the grace time. [s]"""
        self._stopping = True
        await asyncio.to_thread(self._wind_down, time.monotonic() + grace)

    def _enqueue(self, priority: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> asyncio.Future[Any]:
        if self._stopping:
            raise PoolUnavailableError("the service is stopping")
        job = Job(priority, next(self._numbers), (function, arguments))
        self._unfinished.add(job.future)
        job.future.add_done_callback(self._unfinished.discard)
        self._jobs.put(job)
        return asyncio.wrap_future(job.future)

    def _wind_down(self, deadline: float) -> None:
        wait(list(self._unfinished), timeout=max(0.0, deadline - KILL_SECONDS - time.monotonic()))
        self._closed.set()
        for lane in self._lanes:
            lane.kill_worker()
            self._jobs.put(Job(END, next(self._numbers)))  # after the jobs left over, which the lanes now refuse
        for lane in self._lanes:
            if lane.thread.is_alive():
                lane.thread.join(max(0.0, deadline - time.monotonic()))
