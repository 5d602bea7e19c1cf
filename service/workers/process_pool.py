"""Pool of worker processes. One task per worker takes items from the queue, and replaces the worker when it dies."""

import asyncio
import logging
from collections.abc import Callable

from service.errors import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.workers import CallResult
from service.workers.executor import Executor, loads
from service.workers.work_queue import Accepts, Kind, Work, WorkQueue
from service.workers.worker_process import WorkerDiedError, WorkerProcess
from solver.compilation import compilation_progress

DEATHS = 2
"""Number of workers that a call may kill before it fails. The first may have died for another reason, such as a lack of
memory on the machine."""
IDLE_CHECK_SECONDS = 1.0
"""Interval between checks of an idle worker, so that a dead one is replaced before it is needed. [s]"""
LARGE_BYTES = 1 << 18
"""Size above which a reply is unpickled in a thread [bytes]. Unpickling a history of 4 MB takes 3 ms."""
RETRY_SECONDS, LONGEST_RETRY_SECONDS = 0.2, 5.0
"""First and longest backoff between attempts to start a worker, doubled each time [s]. Chosen by judgement: a lack of
processes may pass within a second, and longer delays would keep a service without workers needlessly."""

log = logging.getLogger(__name__)


class WorkerServer:
    """Takes items from the queue and has its worker process run them.

    Parameters
    ----------
    queue
        Queue that the servers of a pool share.
    accepts
        Filter of the items that the pool takes.
    task_seconds
        Timeout of a call, in wall time. [s]
    on_start
        Function called after each attempt to start a worker, with the error message or an empty text.
    """

    def __init__(
        self, queue: WorkQueue, accepts: Accepts, task_seconds: float, on_start: Callable[[str], None]
    ) -> None:
        self.worker: WorkerProcess | None = None
        self.starts = 0
        """Number of workers started so far, the first one included."""
        self._queue = queue
        self._accepts = accepts
        self._task_seconds = task_seconds
        self._on_start = on_start

    async def start_worker(self) -> None:
        """Start a worker.

        Raises
        ------
        PoolUnavailableError
            If the worker cannot be started.
        """
        worker = WorkerProcess()
        await worker.start()
        self.worker = worker
        self.starts += 1

    async def run(self) -> None:
        """Serve the queue until this task is cancelled."""
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
        """Kill the worker, if there is one."""
        worker, self.worker = self.worker, None
        if worker is not None:
            worker.close()

    async def _live_worker(self) -> WorkerProcess:
        """Return the worker, and replace it if it has died or is stopped; retry until there is one."""
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
        """Have the worker run an item, and put back what it has not finished."""
        work.begin()
        if work.kind is Kind.CHUNK:
            self._queue.begin_chunk(work, worker.make_way)

        serving = True

        def abandon(_: object) -> None:
            # The event loop calls this some time after the future is cancelled. By then the reply may have been read,
            # and the worker may be running other work.
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
            # If the worker had not begun to read the calls, it was killed while idle, and the call is not to blame.
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
        """Send the unfinished calls, and receive results until the last one, or until the worker skips the rest."""
        calls, overdue = len(work.left), False
        worker.send(work.left)
        while calls or worker.yielding:
            try:
                async with asyncio.timeout(None if overdue else self._task_seconds):
                    reply = await worker.receive()
            except TimeoutError:
                if worker.stopped:  # Somebody has stopped the process (SIGSTOP, a debugger); the call is not at fault.
                    raise PoolUnavailableError(
                        "the worker process was stopped from outside and is being replaced"
                    ) from None
                # `stop_call` kills the worker if the call does not stop, so the next wait needs no timeout.
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
        """Set the timeout as the result of the first unfinished call."""
        error = TaskTimeoutError(f"not finished after {self._task_seconds:g} s")
        work.finish(CallResult(None, error, self._task_seconds))


class ProcessPool(Executor):
    """Executor with a fixed number of worker processes.

    Parameters
    ----------
    workers
        Number of processes.
    task_seconds
        Timeout of a call, in wall time [s]. A call that exceeds it is stopped or, if that fails, its worker is killed.
    queue
        Queue of another executor to share.
    accepts
        Filter of the items of that queue that the pool takes.
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
        """Process ids of the running workers."""
        return [server.worker.pid for server in self._servers if server.worker is not None]

    @property
    def restarts(self) -> int:
        """Number of workers that were replaced."""
        return sum(max(0, server.starts - 1) for server in self._servers)

    @property
    def start_failures(self) -> int:
        """Number of failed attempts to start a worker."""
        return self._failures

    @property
    def busy(self) -> bool:
        """True if a worker runs and is not stopped: a probe that failed was only waiting for a running call."""
        return not self.stopping and any(
            server.worker is not None and not server.worker.stopped for server in self._servers
        )

    @property
    def capacity(self) -> int:
        """Number of chunks that can run at the same time."""
        return len(self._servers)

    @property
    def single_capacity(self) -> int:
        """Number of single calls that can run at the same time."""
        return len(self._servers)

    async def start(self) -> None:
        """Start all workers, and wait until they have loaded the compiled solver."""
        # If the solver is not compiled yet, the first worker alone compiles it and the others load the result:
        # compiling takes half a minute of a core, and all workers would otherwise do it at the same time.
        first = 1 if compilation_progress().left else len(self._servers)
        try:
            for servers in (self._servers[:first], self._servers[first:]):
                await asyncio.gather(*(server.start_worker() for server in servers))
        except BaseException:
            await self.close(0.0)
            raise
        self._tasks = [asyncio.create_task(server.run()) for server in self._servers]

    async def close(self, seconds: float) -> None:
        """Kill all workers, including those that are computing."""
        self.stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for server in self._servers:
            server.close()

    def _note_start(self, error: str) -> None:
        """Log a failed start of a worker, and refuse work while there is no worker at all."""
        if error:
            self._failures += 1
            log.error("%s", error)
        self.queue.unavailable = "" if any(server.worker is not None for server in self._servers) else error
        if self.queue.unavailable:
            self.last_error = self.queue.unavailable
            self.queue.fail_all(PoolUnavailableError(self.queue.unavailable), self._accepts)
