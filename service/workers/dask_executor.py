"""Chunks on a Dask cluster, single calls on a pool of our own.

A client waits for a single call: the pool answers in a millisecond and does not care how the cluster is. Chunks are
what there are many of. Each is one task of Dask, and comes back whole or is given out again: when its worker or the
scheduler has died, to the workers that are left and, while there are none, to the pool. So a job always goes on.
"""

import asyncio
import logging
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar, TypeVarTuple

from distributed import Future, KilledWorker

from service.errors import PoolUnavailableError, WorkerCrashedError
from service.workers import Call, CallResult
from service.workers.dask_cluster import Cluster, in_time, run_chunk, versions
from service.workers.process_pool import ProcessPool
from service.workers.worker import answer, dumps, loads

LOSSES = 5
"""A chunk that was lost so many times, to the network or a worker that left, is left to the pool."""
PAUSE_SECONDS = 0.1
"""Before a chunk that was lost is given out again; twice as long each time."""
PATIENCE_SECONDS = 5.0
"""For which chunks wait for a cluster that has been lost, rather than fill the pool: most restarts take less."""
CANCEL_SECONDS = 1.0
"""For the scheduler to hear that a chunk is not wanted any more."""

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")
log = logging.getLogger(__name__)


class LostError(Exception):
    """The cluster has not brought the chunk to its end."""


class DaskExecutor:
    """Runs chunks on a cluster.

    Parameters
    ----------
    address
        Address of the scheduler, such as ``tcp://scheduler:8786``.
    workers
        Processes of the pool.
    task_seconds
        Wall time one call may take.
    """

    def __init__(self, *, address: str, workers: int, task_seconds: float) -> None:
        self.last_error = ""
        self.busy = False
        self.cluster = Cluster(address, task_seconds)
        self._pool = ProcessPool(workers=workers, task_seconds=task_seconds)
        self._task_seconds = task_seconds
        self._in_flight: set[asyncio.Task[list[CallResult]]] = set()
        self._stopping = False

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers of the pool."""
        return self._pool.worker_pids

    @property
    def restarts(self) -> int:
        """Workers of the pool that had to be replaced."""
        return self._pool.restarts

    @property
    def queued(self) -> int:
        """Calls submitted singly, probes among them, that wait for a worker."""
        return self._pool.queued

    @property
    def capacity(self) -> int:
        """Chunks that can run at the same time: on the cluster or, while there is none, here."""
        return self.cluster.capacity or self._pool.capacity

    @property
    def on_cluster(self) -> bool:
        """Whether the cluster has workers that can be used."""
        return bool(self.cluster.capacity)

    @property
    def single_capacity(self) -> int:
        """Calls submitted singly that can run at the same time, in the pool."""
        return self._pool.single_capacity

    @property
    def prefetch(self) -> int:
        """One for each worker: the next is there when it has finished, rather than on its way through the scheduler."""
        return self.cluster.capacity or self._pool.prefetch

    async def start(self) -> None:
        """Bring the pool up, and those workers of the cluster that are there; without any it starts all the same."""
        await self._pool.start()
        try:
            await self.cluster.start()
        except BaseException:
            await self.stop(0.0)
            raise

    async def submit(self, function: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result:
        """Run a picklable function in the pool."""
        return await self._pool.submit(function, *arguments)

    async def run(self, calls: Sequence[Call]) -> list[CallResult]:
        """Run a chunk of calls one after the other on a worker of the cluster."""
        if self._stopping:
            raise PoolUnavailableError("the service is stopping")
        if not calls:
            return []
        work = asyncio.create_task(self._see_through(calls))
        self._in_flight.add(work)
        work.add_done_callback(self._in_flight.discard)
        try:
            await asyncio.wait([work])
        except asyncio.CancelledError:
            work.cancel()
            raise
        if work.cancelled():
            raise PoolUnavailableError("the service is stopping")
        return work.result()

    async def probe(self, seconds: float) -> bool:
        """Return whether a worker of the pool answers within this time, and the cluster."""
        pool, cluster = await asyncio.gather(self._pool.probe(seconds), self.cluster.answers(seconds))
        self.busy = cluster and self._pool.busy
        self.last_error = "cluster unreachable: no worker of it can be used" if pool else self._pool.last_error
        return pool and cluster

    async def stop(self, grace: float) -> None:
        """Take no more work, let what there is finish, and have ended all within the grace time. [s]"""
        self._stopping = True
        ending = asyncio.create_task(self._pool.stop(grace))
        if self._in_flight:
            await asyncio.wait(self._in_flight, timeout=max(0.0, grace - CANCEL_SECONDS))
        left = list(self._in_flight)
        for work in left:
            work.cancel()
        if left:
            await asyncio.wait(left, timeout=CANCEL_SECONDS)
        await self.cluster.stop()
        await ending

    async def _see_through(self, calls: Sequence[Call]) -> list[CallResult]:
        messages = await asyncio.to_thread(all_dumped, calls)
        return await asyncio.to_thread(all_loaded, await self._replies(messages))

    async def _replies(self, messages: Sequence[bytes]) -> list[CallResult]:
        """Bring pickled calls to their end, wherever."""
        for attempt in range(LOSSES):
            if not await self._cluster_there():
                break
            try:
                return await self._attempt(messages)
            except KilledWorker:
                if len(messages) == 1:
                    return [CallResult(None, WorkerCrashedError("the task ended every worker it was given to"), 0.0)]
                half = len(messages) // 2
                return [*await self._replies(messages[:half]), *await self._replies(messages[half:])]
            except LostError as error:
                log.debug("chunk of %d calls was lost %d times: %s", len(messages), attempt + 1, error)
                await asyncio.sleep(PAUSE_SECONDS * 2**attempt)
        return await self._pool.run([(answer, (message,)) for message in messages])

    async def _cluster_there(self) -> bool:
        """Return whether a worker can be had; soon, if the cluster has been gone for long."""
        left = self.cluster.lost + PATIENCE_SECONDS - time.monotonic()
        return bool(self.cluster.capacity) or await self.cluster.wait_for_capacity(max(0.0, left))

    async def _attempt(self, messages: Sequence[bytes]) -> list[CallResult]:
        """Have a worker run these calls.

        Raises
        ------
        KilledWorker
            If as many have died over it as `distributed.scheduler.allowed-failures` says.
        LostError
            If none has run them for another reason.
        """
        client, workers = self.cluster.client, list(self.cluster.threads)
        if client is None:
            raise LostError("there is no connection")
        key = f"ricochet-{uuid.uuid4().hex}"
        try:
            task: Future[Any] = client.submit(
                run_chunk, key, self._task_seconds, versions(), messages, key=key, pure=False, workers=workers
            )
        except Exception as error:
            raise LostError(str(error)) from error
        result = asyncio.ensure_future(task.result())  # never cancelled: gathering is shared among chunks
        try:
            while not result.done():
                if self.cluster.client is not client or self.cluster.threads.keys().isdisjoint(workers):
                    raise LostError("its workers have gone")
                changed = asyncio.ensure_future(self.cluster.changed.wait())
                await asyncio.wait([result, changed], return_when=asyncio.FIRST_COMPLETED)
                changed.cancel()
            return replies_of(result, len(messages))
        finally:
            result.add_done_callback(lambda done: done.cancelled() or done.exception())  # seen
            if not result.done():
                await give_up(task)


def replies_of(result: "asyncio.Future[list[CallResult]]", calls: int) -> list[CallResult]:
    """Return the replies to a chunk of so many calls, one for each, or raise why there are none."""
    if result.cancelled():
        raise LostError("the connection was lost")
    error = result.exception()
    if isinstance(error, KilledWorker):
        raise error
    if error is not None:
        raise LostError(f"{type(error).__name__}: {error}") from error
    replies = result.result()
    if len(replies) != calls:
        raise LostError(f"{len(replies)} replies to {calls} calls")
    return replies


async def give_up(task: "Future[Any]") -> None:
    """Release this on the scheduler: nothing waits for it any more."""
    with suppress(Exception):  # there may be no scheduler
        await in_time(task.cancel, CANCEL_SECONDS)


def all_dumped(calls: Sequence[Call]) -> list[bytes]:
    """Pickle calls."""
    return [dumps(call) for call in calls]


def all_loaded(replies: Sequence[CallResult]) -> list[CallResult]:
    """Return what became of calls, each as reported by its process, or by the pool of the worker."""
    return [reply if reply.error is not None else loads(reply.value) for reply in replies]
