"""Executor that runs chunks on a Dask cluster and single calls in a local process pool.

Clients wait for single calls, which the pool runs with a millisecond of overhead, whatever the state of the cluster.
Chunks make up most of the work. Both come from one queue. Each worker of the cluster gets a new chunk when it has
finished one. A chunk that is not returned goes back to the queue, for another worker or, if there is none, for the
pool, so that a job always makes progress.
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
from service.workers.executor import Executor, dumps, loads
from service.workers.process_pool import ProcessPool
from service.workers.work_queue import Kind, Work
from service.workers.worker_process import DEATHS

LOSSES = 5
"""Number of times that a chunk may be lost, by the network or with its worker, before the pool runs it. Chosen by
judgement: an unstable network should not keep a job from ending."""
PAUSE_SECONDS = 0.1
"""Unit of the backoff after the loss of a chunk [s]. After the nth loss of a chunk, the task that sent it waits for 2^n
times this value before it sends another chunk. Chosen by judgement."""
PATIENCE_SECONDS = 5.0
"""Time that chunks wait for a lost cluster before the pool takes them. Most restarts of a scheduler take less. [s]"""
CANCEL_SECONDS = 1.0
"""Timeout for the scheduler to acknowledge a cancellation, whose reply is not needed, and for tasks of the service to
end; chosen by judgement [s]."""
CHUNKS_A_THREAD = 2
"""Number of chunks assigned to each thread of a worker, so that the next chunk has arrived when the thread is free."""
DELIVERY_SECONDS = 30.0
"""Time allowed for transferring a chunk, in addition to the timeouts of all calls in it and in the chunk before it;
chosen by judgement [s]."""
TEND_SECONDS = 1.0
"""Longest interval between checks of whether the pool should take chunks, well below `PATIENCE_SECONDS`. [s]"""

log = logging.getLogger(__name__)


class LostError(Exception):
    """The cluster has not returned a chunk."""


class DaskExecutor(Executor):
    """Executor with a Dask cluster for chunks and a local pool for single calls.

    Parameters
    ----------
    address
        Address of the scheduler, such as ``tcp://scheduler:8786``.
    workers
        Number of processes of the pool.
    task_seconds
        Timeout of a call, in wall time. [s]
    """

    def __init__(self, *, address: str, workers: int, task_seconds: float) -> None:
        super().__init__(task_seconds=task_seconds)
        self.cluster = Cluster(address, task_seconds)
        self._pool = ProcessPool(workers=workers, task_seconds=task_seconds, queue=self.queue, accepts=self._for_pool)
        self._servers: dict[str, list[asyncio.Task[None]]] = {}
        """Tasks that send chunks to the workers of the cluster, by address of the worker."""
        self._tending: asyncio.Task[None] | None = None
        self._busy = False

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers in the pool."""
        return self._pool.worker_pids

    @property
    def restarts(self) -> int:
        """Number of workers of the pool that were replaced."""
        return self._pool.restarts

    @property
    def start_failures(self) -> int:
        """Number of failed attempts to start a worker of the pool."""
        return self._pool.start_failures

    @property
    def busy(self) -> bool:
        """True if a failure of the last probe means only that every worker of the pool was busy."""
        return self._busy

    @property
    def capacity(self) -> int:
        """Number of chunks that can run at the same time, on the cluster or, without one, in the pool."""
        return self.cluster.capacity or self._pool.capacity

    @property
    def on_cluster(self) -> bool:  # type: ignore[override] # elsewhere it never changes
        """True if the cluster has usable workers."""
        return bool(self.cluster.capacity)

    @property
    def single_capacity(self) -> int:
        """Number of single calls that can run at the same time in the pool."""
        return self._pool.single_capacity

    async def start(self) -> None:
        """Start the pool, and connect to the cluster. It is no error if the cluster cannot be reached yet."""
        await self._pool.start()
        try:
            await self.cluster.start()
        except BaseException:
            await self.close(0.0)
            raise
        self._adapt()
        self._tending = asyncio.create_task(self._tend())

    async def probe(self, seconds: float) -> bool:
        """Return True if a worker of the pool and the scheduler of a usable cluster reply within `seconds`."""
        pool, cluster = await asyncio.gather(self._pool.probe(seconds), self.cluster.answers(seconds))
        self._busy = cluster and self._pool.busy
        self.last_error = "cluster unreachable: no worker of it can be used" if pool else self._pool.last_error
        return pool and cluster

    async def stop(self, grace: float) -> None:
        """Stop as in `Executor.stop`; the local pool refuses new work from now on as well."""
        self._pool.stopping = True
        await super().stop(grace)

    async def close(self, seconds: float) -> None:
        """Stop the pool, and close the connection to the cluster."""
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
        """Return True if the pool takes this work: a chunk only if the cluster has lost it often or has no worker."""
        if work.kind is not Kind.CHUNK or work.losses >= LOSSES:
            return True
        return not self.cluster.capacity and time.monotonic() > self.cluster.lost + PATIENCE_SECONDS

    def _for_cluster(self, work: Work) -> bool:
        return not self._for_pool(work)

    async def _tend(self) -> None:
        """Start and cancel tasks as workers join and leave the cluster, until this is cancelled."""
        while True:
            changed = self.cluster.changed
            with suppress(TimeoutError):
                await asyncio.wait_for(changed.wait(), TEND_SECONDS)
            self._adapt()
            self.queue.hand_out()  # `_for_pool` may return True for chunks by now, which the queue cannot notice.

    def _adapt(self) -> None:
        """Start or cancel tasks, so that each thread of a usable worker has `CHUNKS_A_THREAD` of them."""
        for address in self._servers.keys() - self.cluster.threads.keys():
            for server in self._servers.pop(address):
                server.cancel()
        for address in self.cluster.threads.keys() - self._servers.keys():
            count = CHUNKS_A_THREAD * self.cluster.threads[address]
            self._servers[address] = [asyncio.create_task(self._serve(address, count)) for _ in range(count)]

    async def _serve(self, address: str, places: int) -> None:
        """Send chunks to a worker, one at a time, until this task is cancelled."""
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
                # A worker that left while the connection stayed up may have been killed by the chunk. A worker that is
                # frozen, or unreachable with the whole cluster, was not.
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
        """Record that a worker died while it ran the work.

        From then on the calls run one at a time, so that the call that kills workers can be identified.
        """
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
        """Send the unfinished calls to a worker, and set their results.

        Raises
        ------
        KilledWorker
            If Dask reports that the worker died.
        LostError
            If the chunk was not returned for another reason.
        """
        client, calls = self.cluster.client, work.left
        if client is None:
            raise LostError("there is no connection")
        # Calls are pickled one by one here, so that a call that cannot be pickled does not fail the whole chunk.
        messages = await asyncio.to_thread(all_dumped, calls)
        key = f"ricochet-{uuid.uuid4().hex}"
        try:
            task: Future[Any] = client.submit(
                run_chunk, key, self.task_seconds, versions(), messages, key=key, pure=False, workers=[address]
            )
        except Exception as error:
            raise LostError(str(error)) from error
        # Cancelling this future could cancel the request in which Dask fetches the results of other chunks too.
        result = asyncio.ensure_future(task.result())
        try:
            longest = CHUNKS_A_THREAD * len(calls) * self.task_seconds + DELIVERY_SECONDS
            await asyncio.wait([result, work.future], timeout=longest, return_when=asyncio.FIRST_COMPLETED)
            if not result.done() and not work.future.done():
                self.cluster.distrust(address)
                raise LostError(f"it has not returned within {longest:g} s")
            if result.done():
                for reply in await asyncio.to_thread(all_loaded, replies_of(result, len(calls))):
                    work.finish(reply)
        finally:
            # Retrieving the exception keeps asyncio from logging it as never retrieved.
            result.add_done_callback(lambda done: done.cancelled() or done.exception())
            if not result.done():
                await give_up(task)


def replies_of(result: "asyncio.Future[list[CallResult]]", calls: int) -> list[CallResult]:
    """Return the replies to a chunk, one for each of its calls, or raise the reason why there are none."""
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
    """Cancel a chunk on the scheduler, and wait up to `CANCEL_SECONDS` for the acknowledgement."""
    with suppress(Exception):  # The scheduler may be down, and the chunk lost with it.
        await in_time(task.cancel, CANCEL_SECONDS)


def all_dumped(calls: Sequence[Call]) -> list[bytes]:
    """Pickle each call separately."""
    return [dumps(call) for call in calls]


def all_loaded(replies: Sequence[CallResult]) -> list[CallResult]:
    """Unpickle the replies to calls. A result that is an error of the worker's pool is returned unchanged."""
    return [reply if reply.error is not None else loads(reply.value) for reply in replies]
