"""The pool of worker processes: a task for each takes work from the queue, and replaces the worker when it dies."""

import asyncio
import logging
from collections.abc import Callable

from service.errors import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.workers import CallResult
from service.workers.executor import Executor
from service.workers.work_queue import Accepts, Kind, Work, WorkQueue
from service.workers.worker import loads
from service.workers.worker_process import WorkerDiedError, WorkerProcess
from solver.compilation import compilation_progress

DEATHS = 2
"""Number of workers that a call may kill before it fails."""
IDLE_CHECK_SECONDS = 1.0
"""Interval between checks of an idle worker, so that a dead one is replaced before it is needed. [s]"""
LARGE_BYTES = 1 << 18
"""Size of a reply from which it is read in a thread: an answer with a history of 4 MB takes 3 ms."""
RETRY_SECONDS, LONGEST_RETRY_SECONDS = 0.2, 5.0
"""Delay before a failed start of a worker is tried again, doubled each time up to the second. [s]"""

log = logging.getLogger(__name__)


class WorkerServer:
    """Takes work from the queue and has its worker do it.

    Parameters
    ----------
    queue
        What the servers of a pool take their work from.
    accepts
        Work that they take.
    task_seconds
        Wall time of one call. [s]
    on_start
        Called with the text of an error when a worker could not be started, with an empty one when it could.
    """

    def __init__(
        self, queue: WorkQueue, accepts: Accepts, task_seconds: float, on_start: Callable[[str], None]
    ) -> None:
        self.worker: WorkerProcess | None = None
        self.starts = 0
        """Workers that have come up."""
        self._queue = queue
        self._accepts = accepts
        self._task_seconds = task_seconds
        self._on_start = on_start

    async def start_worker(self) -> None:
        """Start a worker.

        Raises
        ------
        PoolUnavailableError
            If it does not come up.
        """
        worker = WorkerProcess()
        await worker.start()
        self.worker = worker
        self.starts += 1

    async def run(self) -> None:
        """Work off the queue until this is cancelled."""
        worker = await self._live_worker()
        while True:
            try:
                async with asyncio.timeout(IDLE_CHECK_SECONDS):
                    work = await self._queue.get(self._accepts)
            except TimeoutError:
                worker = await self._live_worker()
                continue
            if worker.alive:
                await self._serve(worker, work)
            else:
                self._queue.put_back(work)
            if not worker.alive:
                worker = await self._live_worker()

    def close(self) -> None:
        """End the worker."""
        worker, self.worker = self.worker, None
        if worker is not None:
            worker.close()

    async def _live_worker(self) -> WorkerProcess:
        """Return the worker, a new one if it has died or is stopped; try until there is one."""
        delay = RETRY_SECONDS
        while self.worker is None or not self.worker.alive or self.worker.stopped:
            self.close()
            try:
                await self.start_worker()
            except PoolUnavailableError as error:
                self._on_start(str(error))
                await asyncio.sleep(delay)
                delay = min(2.0 * delay, LONGEST_RETRY_SECONDS)
            else:
                self._on_start("")
        return self.worker

    async def _serve(self, worker: WorkerProcess, work: Work) -> None:
        """Have the worker do this, as far as it gets."""
        work.begin()
        if work.kind is Kind.CHUNK:
            self._queue.begin_chunk(work, worker.make_way)

        serving = True

        def abandon(_: object) -> None:
            # The event loop calls this after the future is cancelled. By then the answer may have been read, and the
            # worker may be on the calls of somebody else.
            if serving:
                worker.stop_call()

        work.future.add_done_callback(abandon)
        try:
            await self._converse(worker, work)
        except PoolUnavailableError as error:
            self.close()
            work.fail(error)
        except WorkerDiedError:
            self.close()
            # Idle workers that are killed at one blow are not ended by the call that was about to be sent to them.
            work.crashes += worker.begun
            if work.crashes == DEATHS:
                work.finish(CallResult(None, WorkerCrashedError(f"the task ended {DEATHS} worker processes"), 0.0))
        finally:
            serving = False
            work.future.remove_done_callback(abandon)
            self._queue.end_chunk(work)
        if work.left:
            self._queue.put_back(work)
        elif not work.future.done():
            work.future.set_result(work.results)

    async def _converse(self, worker: WorkerProcess, work: Work) -> None:
        """Send what is left of the work; take the results up to the last, or to where the worker leaves it."""
        calls, overdue = len(work.left), False
        worker.send(work.left)
        while calls or worker.yielding:
            try:
                async with asyncio.timeout(None if overdue else self._task_seconds):
                    reply = await worker.receive()
            except TimeoutError:
                if worker.stopped:  # The call is not to blame.
                    raise PoolUnavailableError(
                        "the worker process was stopped from outside and is being replaced"
                    ) from None
                overdue = bool(calls)
                worker.stop_call()
                continue
            except WorkerDiedError:
                if not overdue:
                    raise
                self._time_out(work)
                self.close()
                return
            if reply is None:
                return
            calls -= 1
            if overdue:
                overdue = False
                self._time_out(work)
            else:
                large = len(reply) > LARGE_BYTES
                work.finish(await asyncio.to_thread(loads, reply) if large else loads(reply))

    def _time_out(self, work: Work) -> None:
        """Note that the first unfinished call took too long."""
        error = TaskTimeoutError(f"not finished after {self._task_seconds:g} s")
        work.finish(CallResult(None, error, self._task_seconds))


class ProcessPool(Executor):
    """Runs functions in worker processes.

    Parameters
    ----------
    workers
        Number of processes.
    task_seconds
        Wall time one call may take. It is asked to stop then; if it does not, its worker is killed. [s]
    queue
        What the pool takes its work from, if another executor shares it.
    accepts
        Work of that queue that it takes.
    """

    def __init__(
        self,
        *,
        workers: int,
        task_seconds: float,
        queue: WorkQueue | None = None,
        accepts: Accepts = lambda _: True,
    ) -> None:
        super().__init__(task_seconds=task_seconds)
        self.queue = queue or self.queue
        self._accepts = accepts
        self._failures = 0
        self._servers = [WorkerServer(self.queue, accepts, task_seconds, self._note_start) for _ in range(workers)]
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers that are up."""
        return [server.worker.pid for server in self._servers if server.worker is not None]

    @property
    def restarts(self) -> int:
        """Workers that had to be replaced."""
        return sum(max(0, server.starts - 1) for server in self._servers)

    @property
    def start_failures(self) -> int:
        """Attempts to start a worker that failed."""
        return self._failures

    @property
    def busy(self) -> bool:
        """Whether a worker is up and moves, so that a probe that failed only came late."""
        return not self.stopping and any(
            server.worker is not None and not server.worker.stopped for server in self._servers
        )

    @property
    def capacity(self) -> int:
        """Chunks that can run at the same time."""
        return len(self._servers)

    @property
    def single_capacity(self) -> int:
        """Calls submitted singly that can run at the same time."""
        return len(self._servers)

    async def start(self) -> None:
        """Bring every worker up, warm."""
        # One worker compiles, if that has to be done; the others then load what it has kept.
        first = 1 if compilation_progress().left else len(self._servers)
        try:
            for servers in (self._servers[:first], self._servers[first:]):
                await asyncio.gather(*(server.start_worker() for server in servers))
        except BaseException:
            await self.close(0.0)
            raise
        self._tasks = [asyncio.create_task(server.run()) for server in self._servers]

    async def close(self, seconds: float) -> None:
        """End all workers, also those at work."""
        self.stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for server in self._servers:
            server.close()

    def _note_start(self, error: str) -> None:
        """Log that a worker could not be started; refuse work while there is none at all."""
        if error:
            self._failures += 1
            log.error("%s", error)
        self.queue.unavailable = "" if any(server.worker is not None for server in self._servers) else error
        if self.queue.unavailable:
            self.last_error = self.queue.unavailable
            self.queue.fail_all(PoolUnavailableError(self.queue.unavailable), self._accepts)
