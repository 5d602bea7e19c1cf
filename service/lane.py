"""A lane of the pool: one worker process, the pipe to it, and the thread that keeps it busy."""

import pickle
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.context import ForkServerContext
from typing import Any

from service.worker import serve

ATTEMPTS = 2
"""A task that has ended this many workers is given up."""
START_SECONDS = 120.0
"""For a worker to come up; the first ever on a machine compiles the solver, which takes up to a minute."""
RETRY_SECONDS = 0.2
"""Before a worker that did not come up is tried once more."""
IDLE_CHECK_SECONDS = 1.0
"""How often an idle worker is looked at, so that a dead one is replaced before it is needed."""


class ExecutorError(Exception):
    """Root of what goes wrong in the pool rather than in the task."""


class WorkerCrashedError(ExecutorError):
    """The task ended every worker process it was given to."""


class TaskTimeoutError(ExecutorError):
    """The task took longer than a task may."""


class PoolUnavailableError(ExecutorError):
    """No worker process could be started, or the pool is stopping."""


class _WorkerDiedError(Exception):
    """The worker has gone, and with it what it was doing."""


@dataclass(order=True, slots=True)
class Job:
    """A call waiting for a worker; lower priorities first, then in order of arrival."""

    priority: int
    number: int
    call: tuple[Callable[..., Any], tuple[Any, ...]] | None = field(default=None, compare=False)
    """None asks the thread that takes it to end."""
    future: Future[Any] = field(default_factory=Future, compare=False)


class WorkerProcess:
    """One process, and the parent's end of the pipe to it."""

    _starting = threading.Lock()  # multiprocessing's own bookkeeping is not made for threads

    def __init__(self, context: ForkServerContext) -> None:
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs,), name="ricochet-worker", daemon=True)
        try:
            with self._starting:
                self._process.start()
        except (OSError, EOFError) as error:
            self._pipe.close()
            raise PoolUnavailableError("no worker process could be started") from error
        finally:
            theirs.close()  # the worker's copy is then the only one: its death is the end of the stream

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether an idle or busy worker still holds its end of the pipe; call it with no answer unread."""
        try:
            return not self._pipe.poll()
        except OSError:
            return False

    def receive(self, seconds: float) -> bytes:
        """Next message of the worker."""
        try:
            if self._pipe.poll(seconds):
                return self._pipe.recv_bytes()
        except (EOFError, OSError) as error:
            raise _WorkerDiedError from error
        raise TaskTimeoutError(f"not finished after {seconds:g} s")

    def send(self, message: bytes) -> None:
        """Give the worker its next task."""
        try:
            self._pipe.send_bytes(message)
        except OSError as error:
            raise _WorkerDiedError from error

    def kill(self) -> None:
        """End the process now, whatever it is doing."""
        if self._process.is_alive():
            self._process.kill()

    def close(self) -> None:
        """Give up the pipe; an idle worker ends by itself then."""
        self._pipe.close()


class Lane:
    """Takes jobs from the queue of the pool and sees each to its end.

    Parameters
    ----------
    context
        Of the fork server.
    jobs
        Shared by all lanes of a pool.
    closed
        Set when the pool gives up what is not finished.
    task_seconds
        Wall time of one task.
    """

    def __init__(
        self,
        context: ForkServerContext,
        jobs: "queue.PriorityQueue[Job]",
        closed: threading.Event,
        task_seconds: float,
    ) -> None:
        self.worker: WorkerProcess | None = None
        self.started: Future[None] = Future()
        self.thread = threading.Thread(target=self._run, name="ricochet-lane", daemon=True)
        self._context = context
        self._jobs = jobs
        self._closed = closed
        self._task_seconds = task_seconds

    def kill_worker(self) -> None:
        """End the worker, also in the middle of a task; may be called from any thread."""
        worker = self.worker
        if worker is not None:
            worker.kill()

    def _run(self) -> None:
        try:
            self._live_worker()
        except ExecutorError as error:
            self.started.set_exception(error)
            return
        self.started.set_result(None)
        while True:
            try:
                job = self._jobs.get(timeout=IDLE_CHECK_SECONDS)
            except queue.Empty:
                with suppress(ExecutorError):
                    self._live_worker()
                continue
            if job.call is None:
                return
            if job.future.set_running_or_notify_cancel():
                self._finish(job)

    def _finish(self, job: Job) -> None:
        try:
            succeeded, value = pickle.loads(self._ask(pickle.dumps(job.call)))  # noqa: S301 (from our own worker)
        except Exception as error:  # noqa: BLE001 (whoever waits for the job raises it)
            job.future.set_exception(error)
        else:
            (job.future.set_result if succeeded else job.future.set_exception)(value)

    def _ask(self, message: bytes) -> bytes:
        for _ in range(ATTEMPTS):
            worker = self._live_worker()
            try:
                worker.send(message)
                return worker.receive(self._task_seconds)
            except _WorkerDiedError:
                self._discard(worker)
            except TaskTimeoutError:
                self._discard(worker)
                raise
        if self._closed.is_set():
            raise PoolUnavailableError("the service is stopping")
        raise WorkerCrashedError(f"the task ended {ATTEMPTS} worker processes")

    def _live_worker(self) -> WorkerProcess:
        """Worker of this lane, a new one if it has died while idle."""
        if self.worker is not None and self.worker.alive:
            return self.worker
        if self.worker is not None:
            self._discard(self.worker)
        try:
            return self._start_worker()
        except PoolUnavailableError:  # it may be the fork server that is dying; the next start brings up a new one
            self._closed.wait(RETRY_SECONDS)
            return self._start_worker()

    def _start_worker(self) -> WorkerProcess:
        if self._closed.is_set():
            raise PoolUnavailableError("the service is stopping")
        self.worker = worker = WorkerProcess(self._context)
        if self._closed.is_set():  # whoever closed the pool since has not seen this worker
            worker.kill()
        try:
            worker.receive(START_SECONDS)
        except (_WorkerDiedError, TaskTimeoutError) as error:
            self._discard(worker)
            raise PoolUnavailableError("a worker process did not come up") from error
        return worker

    def _discard(self, worker: WorkerProcess) -> None:
        self.worker = None
        worker.kill()
        worker.close()
