"""The pool of worker processes: each has a supervisor, a thread that feeds it and replaces it when it dies."""

import asyncio
import itertools
import multiprocessing
import os
import pickle
import queue
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.context import ForkServerContext
from typing import Any, TypeVar, TypeVarTuple

from service.errors import ExecutorError, PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.workers import Call, CallResult
from service.workers.fork_server import start_fork_server
from service.workers.worker import STOP, WorkerDiedError, WorkerProcess, dumps, loads

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")

PROBE, SINGLE, CHUNK, END = range(4)
"""Priorities of tasks. A probe and a single call overtake chunks, also one that runs, between two of its calls."""
OVERTAKE_SECONDS = 0.02
"""Between asking one supervisor and the next to leave its chunk: with many cores, one call must not halt them all."""
DEATHS = 2
"""A call that has ended this many workers is given up."""
START_SECONDS = 120.0
"""For a worker to come up. The fork server compiles the solver before, however long that takes."""
START_AGAIN_SECONDS = 0.2
"""Before a worker that did not come up is tried once more."""
IDLE_CHECK_SECONDS = 1.0
"""How often an idle worker is looked at, so that a dead one is replaced before it is needed."""
BUSY_CHECK_SECONDS = 0.02
"""How often the supervisor of a busy worker looks for what it should stop for, replies or not; a look costs 10 µs."""
CANCEL_SECONDS = 0.3
"""For the call a cancelled chunk is on to end by itself; then its worker is ended, the only way to stop it."""


@dataclass(order=True, slots=True)
class Task:
    """Calls that one worker runs in turn; lower priorities first, then in order of arrival."""

    priority: int
    number: int
    calls: Sequence[Call] = field(default=(), compare=False)
    future: Future[list[CallResult]] = field(default_factory=Future, compare=False)
    finished: list[CallResult] = field(default_factory=list, compare=False)
    cancelled: float | None = field(default=None, compare=False)
    """When it was given up while it ran, on the monotonic clock."""
    crashes: int = field(default=0, compare=False)
    """Workers that the first unfinished call has ended."""
    _messages: list[bytes] = field(default_factory=list, compare=False)

    def begin(self) -> bool:
        """Return whether it is still wanted; it has been begun before if another overtook it."""
        if not self._messages:
            if not self.future.set_running_or_notify_cancel():
                return False
            self._messages = [dumps(call) for call in self.calls]
        return True

    @property
    def left(self) -> list[bytes]:
        """What a worker is to be given now: all that is not finished, but a call that has ended a worker goes alone."""
        first = len(self.finished)
        return self._messages[first : first + 1 if self.crashes else None]

    def finish(self, finished: CallResult) -> None:
        """Note what became of the first unfinished call."""
        self.finished.append(finished)
        self.crashes = 0


class TaskQueue(queue.PriorityQueue[Task]):
    """Tasks that wait for a supervisor."""

    urgent = 0
    """Those of them that overtake chunks."""
    _overtaken = 0.0

    def _put(self, item: Task) -> None:
        super()._put(item)
        self.urgent += item.priority < CHUNK

    def _get(self) -> Task:
        task = super()._get()
        self.urgent -= task.priority < CHUNK
        return task

    def overtakes(self, task: Task) -> bool:
        """Return whether a running task should be left for one that is more urgent."""
        if task.priority < CHUNK or not self.urgent:
            return False
        now = time.monotonic()
        if now < self._overtaken + OVERTAKE_SECONDS:
            return False
        self._overtaken = now
        return True


class WorkerSupervisor:
    """Takes tasks from the queue of the pool and sees each to its end.

    Parameters
    ----------
    context
        The fork server's.
    tasks
        Shared by all supervisors of a pool.
    closed
        Set when the pool gives up what is not finished.
    task_seconds
        Wall time of one call.
    """

    def __init__(
        self, context: ForkServerContext, tasks: TaskQueue, closed: threading.Event, task_seconds: float
    ) -> None:
        self.worker: WorkerProcess | None = None
        self.started: Future[None] = Future()
        self.started.set_running_or_notify_cancel()  # a start that is cancelled leaves it to the thread, which sets it
        self.starts = 0  # workers that have come up
        self.thread = threading.Thread(target=self._run, name="ricochet-supervisor", daemon=True)
        self._context = context
        self._tasks = tasks
        self._closed = closed
        self._task_seconds = task_seconds

    def kill_worker(self) -> None:
        """End the worker, also in the middle of a call; may be called from any thread."""
        worker = self.worker
        if worker is not None:
            worker.kill()

    def _run(self) -> None:
        try:
            self._live_worker()
        except Exception as error:  # noqa: BLE001 (raised where the pool is started)
            self.started.set_exception(error)
            return
        self.started.set_result(None)
        self._work()
        if self.worker is not None:
            self._discard(self.worker)

    def _work(self) -> None:
        while True:
            try:
                task = self._tasks.get(timeout=IDLE_CHECK_SECONDS)
            except queue.Empty:
                self._look_after_worker()
                continue
            if task.priority == END:
                return
            if task.begin():
                self._see_through(task)
            if self.worker is None:  # the next task should not wait for a new one
                self._look_after_worker()

    def _see_through(self, task: Task) -> None:
        """Bring a task to its end, or to where another overtakes it."""
        try:
            while task.left and task.cancelled is None:
                self._advance(task)
                if task.left and task.priority == CHUNK and self._tasks.urgent:
                    self._tasks.put(task)
                    return
        except Exception as error:  # noqa: BLE001 (raised where the task is awaited)
            if self.worker is not None:  # nobody knows what it would say next
                self._discard(self.worker)
            task.future.set_exception(error)
        else:
            task.future.set_result(task.finished)

    def _advance(self, task: Task) -> None:
        """Have the worker run what is left of a task, as far as it gets."""
        worker, begun = self._live_worker(), time.monotonic()
        try:
            self._converse(worker, task)
        except WorkerDiedError:
            self._discard(worker)
            if self._closed.is_set():
                raise PoolUnavailableError("the service is stopping") from None
            task.crashes += 1
            if task.crashes == DEATHS:
                error = WorkerCrashedError(f"the task ended {DEATHS} worker processes")
                task.finish(CallResult(None, error, time.monotonic() - begun))
        except TaskTimeoutError as error:
            self._discard(worker)
            if task.left:
                task.finish(CallResult(None, error, self._task_seconds))

    def _converse(self, worker: WorkerProcess, task: Task) -> None:
        """Send what is left of a task; take the replies up to the last, or to where the worker has stopped."""
        calls, stopping = task.left, False
        last = len(task.finished) + len(calls)
        worker.send(pickle.dumps(calls), self._task_seconds)
        since = time.monotonic()
        while stopping or len(task.finished) < last:
            if not stopping and (task.cancelled is not None or self._tasks.overtakes(task)):
                with suppress(WorkerDiedError):  # it may have said more before
                    worker.send(STOP, self._task_seconds)
                stopping = True
            reply = worker.receive(BUSY_CHECK_SECONDS)
            now = time.monotonic()
            if reply == STOP:
                return
            if reply is not None:
                task.finish(loads(reply))
                since = now
            elif task.cancelled is not None and now > task.cancelled + CANCEL_SECONDS:
                raise WorkerDiedError
            elif now > since + self._task_seconds:
                if worker.stopped:  # the call is not to blame
                    raise PoolUnavailableError("the worker process was stopped from outside and is being replaced")
                raise TaskTimeoutError(f"not finished after {self._task_seconds:g} s")

    def _look_after_worker(self) -> None:
        with suppress(ExecutorError):  # the next task tries again
            self._live_worker()

    def _live_worker(self) -> WorkerProcess:
        """Worker of this supervisor, a new one if it has died while idle."""
        if self.worker is not None and self.worker.alive:
            return self.worker
        if self.worker is not None:
            self._discard(self.worker)
        try:
            return self._start_worker()
        except PoolUnavailableError:  # it may be the fork server that is dying; the next start brings up a new one
            self._closed.wait(START_AGAIN_SECONDS)
            return self._start_worker()

    def _start_worker(self) -> WorkerProcess:
        if self._closed.is_set():
            raise PoolUnavailableError("the service is stopping")
        self.worker = worker = WorkerProcess(self._context)
        if self._closed.is_set():  # closed since, without seeing this worker
            worker.kill()
        try:
            ready = worker.receive(START_SECONDS)
        except WorkerDiedError:
            ready = None
        if ready is None:
            self._discard(worker)
            raise PoolUnavailableError("a worker process did not come up")
        self.starts += 1
        return worker

    def _discard(self, worker: WorkerProcess) -> None:
        self.worker = None
        worker.kill()
        worker.close()


KILL_SECONDS = 0.5
"""Kept back from the grace time to end workers that are still busy."""


class ProcessPool:
    """Runs functions in worker processes; what `Executor` says of its methods is not repeated.

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
        self._preload = preload
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
        """Bring every worker up, warm."""
        start_fork_server(self._preload)
        for supervisor in self._supervisors:
            supervisor.thread.start()
        try:
            await asyncio.gather(*(asyncio.wrap_future(supervisor.started) for supervisor in self._supervisors))
        except BaseException:
            await self.stop(0.0)
            raise

    async def submit(self, function: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result:
        """Run a picklable function in a worker and return what it returns, or raise what it raises."""
        (finished,) = await self._finished(self._enqueue(SINGLE, [(function, arguments)]))
        if finished.error is not None:
            raise finished.error
        result: Result = finished.value
        return result

    async def run(self, calls: Sequence[Call]) -> list[CallResult]:
        """Run a chunk of calls one after the other in one worker, ended within 0.5 s if this is cancelled."""
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
