"""The interface of executors, and what all have in common: calls become work of one queue, which servers take."""

import asyncio
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar, TypeVarTuple

from service.errors import ExecutorError, PoolUnavailableError, QueueTimeoutError
from service.workers import Call, CallResult
from service.workers.work_queue import Kind, Work, WorkQueue

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")

KILL_SECONDS = 0.5
"""Part of the grace time that is left for stopping running calls. [s]"""


class Executor(ABC):
    """Runs calls elsewhere. `tests/service/test_executor_contract.py` holds every executor to this.

    Parameters
    ----------
    task_seconds
        Wall time one call may take. [s]
    """

    on_cluster = False
    """True if chunks currently run on a cluster rather than on this machine."""
    last_error = "no worker answered in time"
    """Why the last probe failed."""

    def __init__(self, *, task_seconds: float) -> None:
        self.queue = WorkQueue()
        self.task_seconds = task_seconds
        self.stopping = False
        self._unfinished: set[Work] = set()

    @property
    @abstractmethod
    def worker_pids(self) -> list[int]:
        """Process ids of the workers on this machine that are up."""

    @property
    @abstractmethod
    def restarts(self) -> int:
        """Workers on this machine that had to be replaced."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """True if the last probe failed only because every worker was busy."""

    @property
    @abstractmethod
    def capacity(self) -> int:
        """Chunks that can run at the same time, now; it may change as workers come and go."""

    @property
    @abstractmethod
    def single_capacity(self) -> int:
        """Calls submitted singly that can run at the same time."""

    @property
    def start_failures(self) -> int:
        """Attempts to start a worker on this machine that failed."""
        return 0

    @abstractmethod
    async def start(self) -> None:
        """Bring the workers up, warm.

        Raises
        ------
        PoolUnavailableError
            If there can be none.
        """

    @abstractmethod
    async def close(self, seconds: float) -> None:
        """End all workers, also those at work, within this time. [s]"""

    async def submit(
        self,
        function: Callable[[*Arguments], Result],
        *arguments: *Arguments,
        owner: str = "",
        cost: float = 1.0,
        begun: Callable[[], None] = lambda: None,
        longest_wait: float | None = None,
    ) -> Result:
        """Run a picklable function and return what it returns, or raise what it raises.

        Cancelled while it waits for a worker, it never runs; once running, it ends or its worker is ended within 0.5 s,
        where it has a process for itself.

        Parameters
        ----------
        owner
            In whose turn it runs.
        cost
            What it counts as. [ordinary cases]
        begun
            Called when a worker takes it.
        longest_wait
            Time for a worker to take it. [s]

        Raises
        ------
        WorkerCrashedError, TaskTimeoutError, PoolUnavailableError
            If it could not be brought to an end.
        QueueTimeoutError
            If no worker has taken it in time.
        """
        waiting: asyncio.TimerHandle | None = None

        def taken() -> None:
            if waiting is not None:
                waiting.cancel()
            begun()

        work = Work(Kind.SINGLE, [(function, arguments)], owner, cost, cost, taken)
        if longest_wait is not None:
            waiting = asyncio.get_running_loop().call_later(longest_wait, work.fail, QueueTimeoutError())
        try:
            (finished,) = await self._finished(work)
        finally:
            if waiting is not None:
                waiting.cancel()
        if finished.error is not None:
            raise finished.error
        result: Result = finished.value
        return result

    async def run(
        self,
        calls: Sequence[Call],
        *,
        owner: str = "",
        cost: float | None = None,
        remaining: float | None = None,
        begun: Callable[[], None] = lambda: None,
    ) -> list[CallResult]:
        """Run a chunk of calls one after the other; single calls pass it, also between two of its calls.

        A call that fails, takes too long or ends one worker after another says so in its place; the others are run
        all the same. Cancelled while it waits, it never runs; once running, the calls after the one it is on do not
        run.

        Parameters
        ----------
        owner, cost, begun
            As for `submit`; by default each call counts as an ordinary case.
        remaining
            Cost of all that is left of the job, if it is one chunk of many.

        Raises
        ------
        PoolUnavailableError
            If no worker can take it, or the executor is stopping.
        """
        if not calls:
            return []
        cost = len(calls) if cost is None else cost
        return await self._finished(Work(Kind.CHUNK, calls, owner, cost, max(cost, remaining or 0.0), begun))

    async def probe(self, seconds: float) -> bool:
        """Return whether a worker answers within this time; passes all that waits, and chunks between two calls."""
        with suppress(ExecutorError, TimeoutError):
            work = Work(Kind.PROBE, [(os.getpid, ())])
            (finished,) = await asyncio.wait_for(self._finished(work), seconds)
            return finished.error is None
        return False

    async def stop(self, grace: float) -> None:
        """Take no more work, let what there is finish, and give up the rest at the end of the grace time. [s]"""
        self.stopping = True
        if self._unfinished:
            await asyncio.wait([work.future for work in self._unfinished], timeout=max(0.0, grace - KILL_SECONDS))
        error = PoolUnavailableError("the service is stopping")
        self.queue.fail_all(error)
        await self.close(min(grace, KILL_SECONDS))
        for work in list(self._unfinished):
            work.fail(error)

    async def _finished(self, work: Work) -> list[CallResult]:
        """Queue work and wait for its results."""
        if self.stopping:
            raise PoolUnavailableError("the service is stopping")
        if self.queue.unavailable and not (self.on_cluster and work.kind is Kind.CHUNK):
            raise PoolUnavailableError(self.queue.unavailable)
        self._unfinished.add(work)
        try:
            self.queue.put(work)
            return await work.future
        finally:
            self._unfinished.discard(work)
