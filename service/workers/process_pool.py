"""Executors on this machine: a pool of worker processes, and a thread of the service."""

import asyncio
import itertools
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from multiprocessing.util import get_temp_dir
from typing import Any, TypeVar, TypeVarTuple

from service.errors import ExecutorError, PoolUnavailableError, TaskTimeoutError
from service.workers import Call, CallResult
from service.workers.supervisor import CHUNK, END, PROBE, SINGLE, Task, TaskQueue, WorkerSupervisor
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


SOCKET_FOLDER_BYTES = 70
"""Longest path of a folder for sockets: the names below it take 32, and macOS allows 103 in all, Linux 107."""


def socket_folder() -> str:
    """Return the folder for temporary files, or /tmp if the path of a socket in it would be too long."""
    folder = tempfile.gettempdir()
    return folder if len(os.fsencode(folder)) <= SOCKET_FOLDER_BYTES else "/tmp"  # noqa: S108 (folders in it are private)


def prepare_fork_server() -> None:
    """Have the fork server import nothing from the working folder, and listen where its path is short enough."""
    os.environ["PYTHONSAFEPATH"] = "1"  # else it runs a user's solver.py or secrets.py in place of the installed one
    usual, tempfile.tempdir = tempfile.tempdir, socket_folder()
    try:
        get_temp_dir()  # multiprocessing makes its folder at the first call and keeps it
    finally:
        tempfile.tempdir = usual


KILL_SECONDS = 0.5
"""Kept back from the grace time to end workers that are still busy."""


class ProcessPool:
    """Runs functions in worker processes.

    Parameters
    ----------
    workers
        Number of processes.
    task_seconds
        Wall time one call may take; its worker is killed then, as nothing else interrupts compiled code.
    preload
        Modules that the main module of this process needs: each worker imports it anew.
    """

    on_cluster = False
    prefetch = 1
    """Chunks beyond one a worker that should wait here: the supervisors share them, so that one is enough."""
    last_error = "no worker answered in time"
    """Why a probe fails."""
    busy = False

    def __init__(self, *, workers: int, task_seconds: float, preload: Sequence[str] = ()) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["service.workers.preload", "service.workers.worker", *preload])
        self._tasks = TaskQueue()
        self._numbers = itertools.count()
        self._unfinished: set[Future[Any]] = set()
        self._stopping = False
        self._closed = threading.Event()
        self._supervisors = [WorkerSupervisor(context, self._tasks, self._closed, task_seconds) for _ in range(workers)]

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers that are up."""
        return [supervisor.worker.pid for supervisor in self._supervisors if supervisor.worker is not None]

    @property
    def restarts(self) -> int:
        """Workers that had to be replaced."""
        return sum(max(0, supervisor.starts - 1) for supervisor in self._supervisors)

    @property
    def queued(self) -> int:
        """Calls submitted singly, probes among them, that wait for a worker."""
        return self._tasks.urgent

    @property
    def capacity(self) -> int:
        """Chunks that can run at the same time."""
        return len(self._supervisors)

    @property
    def single_capacity(self) -> int:
        """Calls submitted singly that can run at the same time."""
        return len(self._supervisors)

    async def start(self) -> None:
        """Bring every worker up, warm.

        Raises
        ------
        PoolUnavailableError
            If one could not be started.
        """
        prepare_fork_server()
        for supervisor in self._supervisors:
            supervisor.thread.start()
        try:
            await asyncio.gather(*(asyncio.wrap_future(supervisor.started) for supervisor in self._supervisors))
        except BaseException:
            await self.stop(0.0)
            raise

    async def submit(self, function: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result:
        """Run a picklable function in a worker and return what it returns, or raise what it raises.

        Cancelled while it waits for a worker, it never runs; once running, it ends or is ended within 0.5 s.

        Raises
        ------
        WorkerCrashedError, TaskTimeoutError, PoolUnavailableError
            If the pool could not bring it to an end.
        """
        (finished,) = await self._finished(self._enqueue(SINGLE, [(function, arguments)]))
        if finished.error is not None:
            raise finished.error
        result: Result = finished.value
        return result

    async def run(self, calls: Sequence[Call]) -> list[CallResult]:
        """Run a chunk of calls one after the other in one worker, behind what is submitted singly.

        A call that fails, takes too long or ends the worker twice says so in its place; the others are run all the
        same. Cancelled while it waits, it never runs; once running, the call it is on ends or is ended within 0.5 s,
        and those after it do not run.

        Raises
        ------
        PoolUnavailableError
            If no worker can be started or the pool is stopping.
        """
        if not calls:
            return []
        return await self._finished(self._enqueue(CHUNK, calls))

    async def probe(self, seconds: float) -> bool:
        """Return whether a worker answers within this time; overtakes all that waits, and chunks between two calls."""
        with suppress(ExecutorError, TimeoutError):
            task = self._enqueue(PROBE, [(os.getpid, ())])
            (finished,) = await asyncio.wait_for(asyncio.wrap_future(task.future), seconds)
            return finished.error is None
        workers = [supervisor.worker for supervisor in self._supervisors]
        self.busy = any(worker is not None and not worker.stopped for worker in workers)
        return False

    async def stop(self, grace: float) -> None:
        """Take no more work, let what there is finish, and have ended all workers within the grace time. [s]"""
        self._stopping = True
        await asyncio.to_thread(self._wind_down, time.monotonic() + grace)

    async def _finished(self, task: Task) -> list[CallResult]:
        """Wait for a task; have its supervisor give it up if nothing waits for it any more."""
        try:
            return await asyncio.wrap_future(task.future)
        except asyncio.CancelledError:
            task.cancelled = time.monotonic()
            raise

    def _enqueue(self, priority: int, calls: Sequence[Call]) -> Task:
        if self._stopping:
            raise PoolUnavailableError("the service is stopping")
        task = Task(priority, next(self._numbers), calls)
        self._unfinished.add(task.future)
        task.future.add_done_callback(self._unfinished.discard)
        self._tasks.put(task)
        return task

    def _wind_down(self, deadline: float) -> None:
        wait(list(self._unfinished), timeout=max(0.0, deadline - KILL_SECONDS - time.monotonic()))
        self._closed.set()
        for supervisor in self._supervisors:
            supervisor.kill_worker()
            self._tasks.put(
                Task(END, next(self._numbers))
            )  # after the tasks left over, which the supervisors now refuse
        for supervisor in self._supervisors:
            if supervisor.thread.is_alive():
                supervisor.thread.join(max(0.0, deadline - time.monotonic()))
