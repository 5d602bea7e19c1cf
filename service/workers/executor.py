"""Base class of executors, with the queue of work, and functions that pickle calls and unpickle replies."""

import asyncio
import os
import pickle
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
"""Part of the grace period reserved for stopping running calls [s]. A call has 0.3 s before its worker is killed."""


class Executor(ABC):
    """Base class of executors. `tests/service/test_executor_contract.py` tests this interface for every executor.

    Parameters
    ----------
    task_seconds
        Timeout of a call, in wall time. [s]
    """

    on_cluster = False
    """True if chunks currently run on a cluster rather than on this machine."""
    last_error = "no worker answered in time"
    """Reason why the last probe failed."""

    def __init__(self, *, task_seconds: float) -> None:
        self.queue = WorkQueue()
        self.task_seconds = task_seconds
        self.stopping = False
        self._unfinished: set[Work] = set()

    @property
    @abstractmethod
    def worker_pids(self) -> list[int]:
        """Process ids of the running workers on this machine."""

    @property
    @abstractmethod
    def restarts(self) -> int:
        """Number of workers on this machine that were replaced."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """True if a failure of the last probe means only that every worker was busy."""

    @property
    @abstractmethod
    def capacity(self) -> int:
        """Number of chunks that can run at the same time. It may change as workers come and go."""

    @property
    @abstractmethod
    def single_capacity(self) -> int:
        """Number of single calls that can run at the same time."""

    @property
    def start_failures(self) -> int:
        """Number of failed attempts to start a worker on this machine."""
        return 0

    @abstractmethod
    async def start(self) -> None:
        """Start the workers, and wait until they have loaded the compiled solver.

        Raises
        ------
        PoolUnavailableError
            If a worker cannot be started.
        """

    @abstractmethod
    async def close(self, seconds: float) -> None:
        """Stop all workers, including those that are computing, within `seconds`."""

    async def submit(
        self,
        function: Callable[[*Arguments], Result],
        *arguments: *Arguments,
        owner: str = "",
        cost: float = 1.0,
        begun: Callable[[], None] = lambda: None,
        longest_wait: float | None = None,
    ) -> Result:
        """Run a picklable function, and return its value or raise its exception.

        A call that is cancelled in the queue never runs. If it is cancelled while it runs in a worker process, the call
        is stopped, or its worker is killed, within 0.5 s.

        Parameters
        ----------
        owner
            Owner whose share of the workers the call counts against.
        cost
            Cost of the call. [ordinary cases]
        begun
            Function called when a worker takes the call.
        longest_wait
            Timeout for a worker to take the call; None for no timeout. [s]

        Raises
        ------
        WorkerCrashedError, TaskTimeoutError, PoolUnavailableError
            If the call could not be finished.
        QueueTimeoutError
            If no worker took the call in time.
        """
        waiting: asyncio.TimerHandle | None = None

        def taken() -> None:
            if waiting is not None:
                waiting.cancel()
            begun()

        # A single call is a whole request, so its remaining cost equals its cost.
        work = Work(Kind.SINGLE, [(function, arguments)], owner, cost, cost, taken)
        if longest_wait is not None:
            # The timer covers only the time in the queue: a call that has begun has the timeout of the worker.
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
        """Run a chunk of calls one after the other. Single calls may run before it, or between two of its calls.

        A call that fails, exceeds the timeout or kills its workers has the error as its result, and the others run
        nevertheless. A chunk that is cancelled in the queue never runs; one that is cancelled while it runs ends after
        the present call at the latest.

        Parameters
        ----------
        owner, cost, begun
            As for `submit`. By default each call costs one ordinary case.
        remaining
            Cost of the unfinished part of the job, if the chunk belongs to one. [ordinary cases]

        Raises
        ------
        PoolUnavailableError
            If no worker can take the chunk, or the executor is stopping.
        """
        if not calls:
            return []
        cost = len(calls) if cost is None else cost
        return await self._finished(Work(Kind.CHUNK, calls, owner, cost, max(cost, remaining or 0.0), begun))

    async def probe(self, seconds: float) -> bool:
        """Return True if a worker replies within `seconds`.

        A probe runs before all waiting work, or between two calls of a running chunk.
        """
        with suppress(ExecutorError, TimeoutError):
            # `getpid` is the cheapest call that only a living worker can answer.
            work = Work(Kind.PROBE, [(os.getpid, ())])
            (finished,) = await asyncio.wait_for(self._finished(work), seconds)
            return finished.error is None
        return False

    async def stop(self, grace: float) -> None:
        """Refuse new work, let accepted work finish, and stop unfinished work, all within `grace` seconds."""
        self.stopping = True
        # `asyncio.wait` raises an error for an empty set.
        if self._unfinished:
            await asyncio.wait([work.future for work in self._unfinished], timeout=max(0.0, grace - KILL_SECONDS))
        error = PoolUnavailableError("the service is stopping")
        self.queue.fail_all(error)
        await self.close(min(grace, KILL_SECONDS))
        # `fail_all` covers only work in the queue. The callers of running work are still waiting.
        for work in list(self._unfinished):
            work.fail(error)

    async def _finished(self, work: Work) -> list[CallResult]:
        if self.stopping:
            raise PoolUnavailableError("the service is stopping")
        # Without a worker in the pool, work is refused at once rather than after its timeout in the queue.
        if self.queue.unavailable and not (self.on_cluster and work.kind is Kind.CHUNK):
            raise PoolUnavailableError(self.queue.unavailable)
        self._unfinished.add(work)
        try:
            self.queue.put(work)
            return await work.future
        finally:
            self._unfinished.discard(work)


def dumps(call: Call) -> bytes:
    """Pickle a call. A call that cannot be pickled is replaced by one that raises PicklingError with the reason."""
    try:
        return pickle.dumps(call, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (arguments may hold anything)
        return pickle.dumps((refuse, (str(error),)))


def refuse(why: str) -> None:
    """Raise PicklingError. A worker runs this in place of a call that could not be pickled."""
    raise pickle.PicklingError(why)


def loads(reply: bytes | memoryview) -> CallResult:
    """Unpickle the reply to a call."""
    try:
        return CallResult(*pickle.loads(reply))  # noqa: S301 (from our own worker)
    except Exception as error:  # noqa: BLE001 (some exceptions can be pickled but not unpickled)
        return CallResult(None, error, 0.0)
