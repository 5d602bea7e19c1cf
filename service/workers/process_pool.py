"""Pool of worker processes. A `WorkerServer` for each process takes work from the queue and sends it to the process."""

import asyncio
import logging

from service.errors import PoolUnavailableError
from service.workers.executor import Executor
from service.workers.work_queue import Accepts, WorkQueue, any_work
from service.workers.worker_process import WorkerServer
from solver.compilation import compilation_progress

log = logging.getLogger(__name__)


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
        Function that returns True for the work that the pool takes from its queue.
    """

    def __init__(
        self,
        *,
        workers: int,
        task_seconds: float,
        queue: WorkQueue | None = None,
        accepts: Accepts = any_work,
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
        # compiling takes about a minute of CPU time, and otherwise every worker would do it at once.
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
