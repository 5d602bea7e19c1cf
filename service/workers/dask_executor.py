"""Chunks on a Dask cluster, single calls on a pool of our own.

A client waits for a single call: the pool answers in a millisecond and does not care how the cluster is. Chunks are
what there are many of. Both come from one queue. Each worker of the cluster is given chunks as it finishes others; one
that it does not return goes back to the queue, for another worker and, while there is none, for the pool. So a job
always goes on.
"""

import asyncio
import logging
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from distributed import Future, KilledWorker

from service.errors import WorkerCrashedError
from service.workers import Call, CallResult
from service.workers.dask_cluster import Cluster, in_time, run_chunk, versions
from service.workers.executor import Executor
from service.workers.process_pool import DEATHS, ProcessPool
from service.workers.work_queue import Kind, Work
from service.workers.worker import dumps, loads

LOSSES = 5
"""Number of times that a chunk may be lost to the network, or by a worker that left, before it is left to the pool."""
PAUSE_SECONDS = 0.1
"""Backoff before a worker that lost a chunk is given another; doubled each time. [s]"""
PATIENCE_SECONDS = 5.0
"""Time that chunks wait for a cluster that has been lost, rather than fill the pool: most restarts take less. [s]"""
CANCEL_SECONDS = 1.0
"""Time for the scheduler to hear that a chunk is not wanted any more. [s]"""
CHUNKS_A_THREAD = 2
"""Chunks that each thread of a worker has: the next is there when it has finished one."""
DELIVERY_SECONDS = 30.0
"""Time that a chunk may be underway beyond the time limits of its calls, and of the chunk before it. [s]"""
TEND_SECONDS = 1.0
"""Longest interval between checks of whether the pool should take chunks. [s]"""

log = logging.getLogger(__name__)


class LostError(Exception):
    """The cluster has not brought the chunk to its end."""


class DaskExecutor(Executor):
    """Runs chunks on a cluster.

    Parameters
    ----------
    address
        Address of the scheduler, such as ``tcp://scheduler:8786``.
    workers
        Processes of the pool.
    task_seconds
        Wall time one call may take. [s]
    """

    def __init__(self, *, address: str, workers: int, task_seconds: float) -> None:
        super().__init__(task_seconds=task_seconds)
        self.cluster = Cluster(address, task_seconds)
        self._pool = ProcessPool(workers=workers, task_seconds=task_seconds, queue=self.queue, accepts=self._for_pool)
        self._servers: dict[str, list[asyncio.Task[None]]] = {}
        """Tasks that give chunks to each worker of the cluster."""
        self._tending: asyncio.Task[None] | None = None
        self._busy = False

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers of the pool."""
        return self._pool.worker_pids

    @property
    def restarts(self) -> int:
        """Workers of the pool that had to be replaced."""
        return self._pool.restarts

    @property
    def start_failures(self) -> int:
        """Attempts to start a worker of the pool that failed."""
        return self._pool.start_failures

    @property
    def busy(self) -> bool:
        """True if the last probe failed only because every worker of the pool was busy."""
        return self._busy

    @property
    def capacity(self) -> int:
        """Chunks that can run at the same time: on the cluster or, while there is none, here."""
        return self.cluster.capacity or self._pool.capacity

    @property
    def on_cluster(self) -> bool:  # type: ignore[override] # elsewhere it never changes
        """True if the cluster has usable workers."""
        return bool(self.cluster.capacity)

    @property
    def single_capacity(self) -> int:
        """Calls submitted singly that can run at the same time, in the pool."""
        return self._pool.single_capacity

    async def start(self) -> None:
        """Bring the pool up, and those workers of the cluster that are there; without any it starts all the same."""
        await self._pool.start()
        try:
            await self.cluster.start()
        except BaseException:
            await self.close(0.0)
            raise
        self._adapt()
        self._tending = asyncio.create_task(self._tend())

    async def probe(self, seconds: float) -> bool:
        """Return whether a worker of the pool answers within this time, and the cluster."""
        pool, cluster = await asyncio.gather(self._pool.probe(seconds), self.cluster.answers(seconds))
        self._busy = cluster and self._pool.busy
        self.last_error = "cluster unreachable: no worker of it can be used" if pool else self._pool.last_error
        return pool and cluster

    async def stop(self, grace: float) -> None:
        """Take no more work, let what there is finish, and have ended all within the grace time. [s]"""
        self._pool.stopping = True
        await super().stop(grace)

    async def close(self, seconds: float) -> None:
        """End the pool, and hang up."""
        tasks = [task for tasks in self._servers.values() for task in tasks]
        if self._tending is not None:
            tasks.append(self._tending)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=CANCEL_SECONDS)
        await self.cluster.stop()
        await self._pool.stop(seconds)

    def _for_pool(self, work: Work) -> bool:
        """Return whether the pool takes this work: chunks only if the cluster cannot."""
        if work.kind is not Kind.CHUNK or work.losses >= LOSSES:
            return True
        return not self.cluster.capacity and time.monotonic() > self.cluster.lost + PATIENCE_SECONDS

    def _for_cluster(self, work: Work) -> bool:
        return not self._for_pool(work)

    async def _tend(self) -> None:
        """Follow the workers as they come and go."""
        while True:
            changed = self.cluster.changed
            with suppress(TimeoutError):
                await asyncio.wait_for(changed.wait(), TEND_SECONDS)
            self._adapt()
            self.queue.hand_out()  # It may be the turn of the pool by now.

    def _adapt(self) -> None:
        """Begin or end tasks, so that each worker that can be used has its own."""
        for address in self._servers.keys() - self.cluster.threads.keys():
            for server in self._servers.pop(address):
                server.cancel()
        for address in self.cluster.threads.keys() - self._servers.keys():
            count = CHUNKS_A_THREAD * self.cluster.threads[address]
            self._servers[address] = [asyncio.create_task(self._serve(address, count)) for _ in range(count)]

    async def _serve(self, address: str, places: int) -> None:
        """Give chunks to a worker, which has so many places, until this is cancelled, as the worker has gone."""
        while True:
            work, client = await self.queue.get(self._for_cluster, address, places), self.cluster.client
            work.begin()
            try:
                await self._attempt(address, work)
            except KilledWorker:
                self._blame(work)
            except LostError as error:
                self._note_loss(work, error)
                await asyncio.sleep(PAUSE_SECONDS * 2**work.losses)
            except asyncio.CancelledError:
                if self.cluster.client is client and not self.cluster.knows(address):
                    self._blame(work)
                else:
                    self._note_loss(work, LostError("the worker is silent or cannot be reached"))
                raise
            finally:
                if work.left:
                    self.queue.put_back(work)
                elif not work.future.done():
                    work.future.set_result(work.results)

    @staticmethod
    def _blame(work: Work) -> None:
        """Note that a worker has died over the work: its calls are run one by one, and what kills more is given up."""
        if work.alone:
            work.crashes += 1
        if work.crashes >= DEATHS:
            work.finish(CallResult(None, WorkerCrashedError("the task ended every worker it was given to"), 0.0))
        work.alone = True

    @staticmethod
    def _note_loss(work: Work, error: LostError) -> None:
        work.losses += 1
        log.debug("chunk of %d calls was lost %d times: %s", len(work.calls), work.losses, error)

    async def _attempt(self, address: str, work: Work) -> None:
        """Have a worker run what is left of the work.

        Raises
        ------
        KilledWorker
            If it has died over it.
        LostError
            If it has not run it for another reason.
        """
        client, calls = self.cluster.client, work.left
        if client is None:
            raise LostError("there is no connection")
        messages = await asyncio.to_thread(all_dumped, calls)
        key = f"ricochet-{uuid.uuid4().hex}"
        try:
            task: Future[Any] = client.submit(
                run_chunk, key, self.task_seconds, versions(), messages, key=key, pure=False, workers=[address]
            )
        except Exception as error:
            raise LostError(str(error)) from error
        result = asyncio.ensure_future(task.result())  # never cancelled: gathering is shared among chunks
        try:
            longest = CHUNKS_A_THREAD * len(calls) * self.task_seconds + DELIVERY_SECONDS
            await asyncio.wait([result, work.future], timeout=longest, return_when=asyncio.FIRST_COMPLETED)
            if not result.done() and not work.future.done():
                self.cluster.distrust(address)
                raise LostError(f"it has not come back in {longest:g} s")
            if result.done():
                for reply in await asyncio.to_thread(all_loaded, replies_of(result, len(calls))):
                    work.finish(reply)
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
