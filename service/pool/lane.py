"""A lane of the pool: one worker process, the channel to it, and the thread that keeps it busy."""

import pickle
import queue
import socket
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.context import ForkServerContext

from service.errors import ExecutorError, PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.pool.backlog import CHUNK, END, Backlog, Job
from service.pool.worker import STOP, Channel, Finished, serve, unpacked

ATTEMPTS = 2
"""A call that has ended this many workers is given up."""
START_SECONDS = 120.0
"""For a worker to come up; the first ever on a machine compiles the solver, which takes up to a minute."""
RETRY_SECONDS = 0.2
"""Before a worker that did not come up is tried once more."""
IDLE_CHECK_SECONDS = 1.0
"""How often an idle worker is looked at, so that a dead one is replaced before it is needed."""
BUSY_CHECK_SECONDS = 0.02
"""How often the lane of a busy worker looks for what it should stop for, replies or not; a look costs 10 µs."""
CANCEL_SECONDS = 0.3
"""For the call a cancelled chunk is on to end by itself; then its worker is ended, the only way to stop it."""


class _WorkerDiedError(Exception):
    """The worker has gone or has to go, and with it the call it was on."""


class WorkerProcess:
    """One process, and the parent's end of the channel to it."""

    _starting = threading.Lock()  # multiprocessing's own bookkeeping is not made for threads

    def __init__(self, context: ForkServerContext) -> None:
        ours, theirs = socket.socketpair()
        self._channel = Channel(ours)
        self._process = context.Process(target=serve, args=(theirs,), name="ricochet-worker", daemon=True)
        try:
            with self._starting:
                self._process.start()
        except (OSError, EOFError) as error:
            self._channel.close()
            raise PoolUnavailableError("no worker process could be started") from error
        finally:
            theirs.close()  # the worker's copy is then the only one: its death is the end of the stream

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether an idle worker still holds its end of the channel: it has nothing to say but its end."""
        return not self._channel.waiting()

    def receive(self, seconds: float) -> bytes | None:
        """Next message of the worker; None if nothing has come within this time."""
        try:
            return self._channel.receive(seconds)
        except (EOFError, OSError) as error:
            raise _WorkerDiedError from error

    def send(self, message: bytes, seconds: float) -> None:
        """Send a message, which the worker has this long to take."""
        try:
            self._channel.send(message, seconds)
        except OSError as error:  # also for a worker that does not read: it is as good as dead
            raise _WorkerDiedError from error

    def kill(self) -> None:
        """End the process now, whatever it is doing."""
        if self._process.is_alive():
            self._process.kill()

    def close(self) -> None:
        """Give up the channel; an idle worker ends by itself then."""
        self._channel.close()


class Lane:
    """Takes jobs from the backlog of the pool and sees each to its end.

    Parameters
    ----------
    context
        Of the fork server.
    jobs
        Shared by all lanes of a pool.
    closed
        Set when the pool gives up what is not finished.
    task_seconds
        Wall time of one call.
    """

    def __init__(self, context: ForkServerContext, jobs: Backlog, closed: threading.Event, task_seconds: float) -> None:
        self.worker: WorkerProcess | None = None
        self.started: Future[None] = Future()
        self.starts = 0  # workers that have come up
        self.thread = threading.Thread(target=self._run, name="ricochet-lane", daemon=True)
        self._context = context
        self._jobs = jobs
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
        except Exception as error:  # noqa: BLE001 (whoever starts the pool raises it)
            self.started.set_exception(error)
            return
        self.started.set_result(None)
        self._work()
        if self.worker is not None:
            self._discard(self.worker)

    def _work(self) -> None:
        while True:
            try:
                job = self._jobs.get(timeout=IDLE_CHECK_SECONDS)
            except queue.Empty:
                self._look_after_worker()
                continue
            if job.priority == END:
                return
            if job.begin():
                self._see_through(job)
            if self.worker is None:  # the next job should not wait for a new one
                self._look_after_worker()

    def _see_through(self, job: Job) -> None:
        """Bring a job to its end, or to where another overtakes it."""
        try:
            while job.left and job.cancelled is None:
                self._advance(job)
                if job.left and job.priority == CHUNK and self._jobs.urgent:
                    self._jobs.put(job)
                    return
        except Exception as error:  # noqa: BLE001 (whoever waits for the job raises it)
            if self.worker is not None:  # nobody knows what it would say next
                self._discard(self.worker)
            job.future.set_exception(error)
        else:
            job.future.set_result(job.finished)

    def _advance(self, job: Job) -> None:
        """Have the worker run what is left of a job, as far as it gets."""
        worker, begun = self._live_worker(), time.monotonic()
        try:
            self._converse(worker, job)
        except _WorkerDiedError:
            self._discard(worker)
            if self._closed.is_set():
                raise PoolUnavailableError("the service is stopping") from None
            job.crashes += 1
            if job.crashes == ATTEMPTS:
                error = WorkerCrashedError(f"the task ended {ATTEMPTS} worker processes")
                job.finish(Finished(None, error, time.monotonic() - begun))
        except TaskTimeoutError as error:
            self._discard(worker)
            if job.left:
                job.finish(Finished(None, error, self._task_seconds))

    def _converse(self, worker: WorkerProcess, job: Job) -> None:
        """Send what is left of a job; take the replies up to the last, or to where the worker has stopped."""
        calls, stopping = job.left, False
        last = len(job.finished) + len(calls)
        worker.send(pickle.dumps(calls), self._task_seconds)
        since = time.monotonic()
        while stopping or len(job.finished) < last:
            if not stopping and (job.cancelled is not None or self._jobs.asks(job)):
                with suppress(_WorkerDiedError):  # it may have said more before
                    worker.send(STOP, self._task_seconds)
                stopping = True
            reply = worker.receive(BUSY_CHECK_SECONDS)
            now = time.monotonic()
            if reply == STOP:
                return
            if reply is not None:
                job.finish(unpacked(reply))
                since = now
            elif job.cancelled is not None and now > job.cancelled + CANCEL_SECONDS:
                raise _WorkerDiedError
            elif now > since + self._task_seconds:
                raise TaskTimeoutError(f"not finished after {self._task_seconds:g} s")

    def _look_after_worker(self) -> None:
        with suppress(ExecutorError):  # whoever needs one next tries again
            self._live_worker()

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
            ready = worker.receive(START_SECONDS)
        except _WorkerDiedError:
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
