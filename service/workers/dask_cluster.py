"""Connection to a Dask cluster: its workers, and the plugin that runs a process pool on each of them."""

import asyncio
import logging
import platform
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from typing import Any, TypeVar, cast

import dask.config
from distributed import Client, Worker, get_worker
from distributed import WorkerPlugin as Plugin
from distributed.worker_state_machine import TaskStateState

from service.operations import SCHEMA_VERSION
from service.version import VERSION
from service.workers import CallResult
from service.workers.process_pool import ProcessPool
from service.workers.worker import answer
from solver import ENGINE_VERSION

PACKAGES = ("h5py", "llvmlite", "numba", "numpy", "orjson", "pydantic", "scipy")
"""Packages whose version may change the last bit of a result, or its encoding."""
STOP_SECONDS = 1.0
"""Time allowed for the pool of a worker to stop, the same as for the pool of the service. [s]"""


class UnfitWorkerError(Exception):
    """The worker runs versions other than those of the service, or has no pool."""


@cache
def versions() -> dict[str, str]:
    """Return the versions that service and workers must share."""
    # Pickles and compiled code depend on the minor version of Python, not on the patch.
    python = ".".join(platform.python_version_tuple()[:2])
    own = {"ricochet": VERSION, "engine": ENGINE_VERSION, "schema": SCHEMA_VERSION, "python": python}
    return own | {name: version(name) for name in PACKAGES}


def differences(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    """Describe the differences between two sets of versions; empty if there are none."""
    names = [name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name)]
    return ", ".join(f"{name} {theirs.get(name, 'none')} instead of {ours.get(name, 'none')}" for name in names)


class WorkerPlugin(Plugin):
    """Plugin that runs a process pool on a Dask worker, with one process per thread of the worker.

    Parameters
    ----------
    task_seconds
        Timeout of a call, in wall time. [s]
    """

    def __init__(self, task_seconds: float) -> None:
        self._task_seconds = task_seconds
        self._running: dict[str, asyncio.Task[list[CallResult]]] = {}

    async def setup(self, worker: Worker) -> None:
        """Start the pool. Dask calls this when the plugin is added to a worker."""
        self._pool = ProcessPool(workers=worker.state.nthreads, task_seconds=self._task_seconds)
        await self._pool.start()

    async def teardown(self, worker: Worker) -> None:
        """Stop the pool. Dask calls this when the worker closes."""
        await self._pool.stop(STOP_SECONDS)

    def transition(self, key: object, start: TaskStateState, finish: TaskStateState, **_: object) -> None:
        """Cancel a chunk that the scheduler has released; Dask itself would let it run to its end."""
        if finish == "released" and isinstance(key, str) and key in self._running:
            self._running[key].cancel()

    async def run(self, key: str, messages: Sequence[bytes]) -> list[CallResult]:
        """Run pickled calls in the pool. The value of a result is the pickled reply to its call."""
        running = self._running[key] = asyncio.create_task(
            self._pool.run([(answer, (message,)) for message in messages])
        )
        try:
            return await running  # A Dask worker that closes cancels this, and the chunk is then sent again.
        finally:
            del self._running[key]


async def introduce(task_seconds: float, expected: Mapping[str, str], dask_worker: Worker) -> dict[str, str]:
    """Return the versions of this worker, and start its pool if they are as expected."""
    name = plugin_name(task_seconds)
    if versions() == expected and name not in dask_worker.plugins:
        done = await dask_worker.plugin_add(WorkerPlugin(task_seconds), name=name)
        if done["status"] != "OK":
            with suppress(KeyError):
                del dask_worker.plugins[name]
            raise UnfitWorkerError(f"its pool did not start: {done.get('exception_text')}")
    return versions()


async def run_chunk(
    key: str, task_seconds: float, expected: Mapping[str, str], messages: Sequence[bytes]
) -> list[CallResult]:
    """Run a chunk in the pool of the Dask worker that executes this function.

    Raises
    ------
    UnfitWorkerError
        If the versions of the worker differ, or it has no pool.
    """
    host = get_worker().plugins.get(plugin_name(task_seconds))
    if host is None or versions() != expected:
        raise UnfitWorkerError(differences(expected, versions()) or "it has no pool yet")
    return await cast(WorkerPlugin, host).run(key, messages)


def plugin_name(task_seconds: float) -> str:
    """Return the name of the plugin. It contains the timeout: services with different ones may share a cluster."""
    return f"ricochet-{task_seconds:g}"


LOOK_SECONDS = 1.0
"""Interval between checks of the list of workers, chosen by judgement [s]. Each check is one request to the
scheduler."""
CONNECT_SECONDS = 5.0
"""Timeout for a reply of the scheduler, chosen by judgement [s]. A reply takes milliseconds, so a scheduler that
exceeds the timeout is considered lost."""
INTRODUCTION_SECONDS = 180.0
"""Timeout for a worker to report its versions and start its pool [s]. A machine's first pool compiles the solver."""
LOOK_AGAIN_SECONDS = 30.0
"""Delay before retrying a worker that did not report its versions or start its pool, chosen by judgement [s]."""
SILENT_SECONDS = 10.0
"""Time without a heartbeat after which a worker counts as frozen and its chunks are given to others. [s]

Workers send a heartbeat every half second, or every five seconds in a cluster of hundreds. Dask itself waits for five
minutes before it gives up on a worker.
"""
LIBRARIES = ("distributed", "tornado", "bokeh")
"""Libraries whose loggers get handlers when Dask is imported."""

Value = TypeVar("Value")
log = logging.getLogger(__name__)


class Cluster:
    """Connection to a Dask scheduler, re-established when it is lost, and the list of its usable workers.

    A worker gets no chunk before it has reported its versions. A worker with other versions is not used, and is named
    in the log. Workers that join later are checked in the same way.

    Parameters
    ----------
    address
        Address of the scheduler.
    task_seconds
        Timeout of a call, in wall time. [s]
    """

    def __init__(self, address: str, task_seconds: float) -> None:
        self.address = address
        self.client: Client | None = None
        """Client of the scheduler; None while there is no connection."""
        self.threads: dict[str, int] = {}
        """Numbers of threads of the usable workers, by address."""
        self.changed = asyncio.Event()
        """Event that is set, and replaced with a new one, when a worker becomes usable or unusable."""
        self.lost = time.monotonic()
        """Time at which the last usable worker was lost, at first the time of the start, on the monotonic clock. [s]"""
        self._task_seconds = task_seconds
        self._seen: dict[str, asyncio.Task[None]] = {}
        self._heartbeats: dict[str, tuple[float, float]] = {}
        """Time of each worker's latest heartbeat by the scheduler's clock, and time of its receipt by our clock. [s]

        The clocks of the machines may differ, so the time of a heartbeat is compared only with the time of the previous
        one.
        """
        self._watching: asyncio.Task[None] | None = None

    @property
    def capacity(self) -> int:
        """Number of chunks that can run at the same time."""
        return sum(self.threads.values())

    async def start(self) -> None:
        """Connect if the scheduler is running, and wait for the versions of the present workers."""
        use_our_log()
        await self._update_workers()
        if self._seen:
            await asyncio.wait(self._seen.values())
        if not self.capacity:
            log.warning("no worker of the Dask cluster at %s can be used yet", self.address)
        self._watching = asyncio.create_task(self._watch())

    async def stop(self) -> None:
        """Stop checking the workers, and close the connection."""
        if self._watching is not None:
            self._watching.cancel()
            await asyncio.wait([self._watching])
        await self._hang_up()

    async def answers(self, seconds: float) -> bool:
        """Return True if there is a usable worker and the scheduler answers within `seconds`."""
        client = self.client
        if client is None or not self.capacity:
            return False
        return await in_time(client.nthreads, seconds) is not None

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(LOOK_SECONDS)
            try:
                await self._update_workers()
            except Exception:
                log.exception("checking the Dask cluster failed")

    async def _update_workers(self) -> None:
        """Reconnect if necessary, and update the list of workers."""
        if self.client is None or self.client.status != "running":
            await self._hang_up()
            await self._connect()
        present = await in_time(self._present, CONNECT_SECONDS) if self.client is not None else None
        if present is None:
            await self._hang_up()
            return
        for address in self._seen.keys() - present.keys():
            self._seen.pop(address).cancel()
            self._note(address, 0)
        for address in present.keys() - self._seen.keys():
            self._seen[address] = asyncio.create_task(self._meet(address, present[address]))

    async def _present(self) -> dict[str, int]:
        """Return the numbers of threads of the workers that send heartbeats, by address."""
        assert self.client is not None  # noqa: S101 (called only with a client)
        assert self.client.scheduler is not None  # noqa: S101 (it is connected)
        found = (await self.client.scheduler.identity(n_workers=-1))["workers"]
        now, before = time.monotonic(), self._heartbeats
        self._heartbeats = {}
        for address, worker in found.items():
            beat, seen = before.get(address, (None, now))
            self._heartbeats[address] = (worker["last_seen"], seen if beat == worker["last_seen"] else now)
            if address in self.threads and self._silent(address):
                log.error("worker %s has been silent for %g s: its chunks go to others", address, SILENT_SECONDS)
        return {address: found[address]["nthreads"] for address in found if not self._silent(address)}

    def knows(self, address: str) -> bool:
        """Return True if the scheduler lists a worker, frozen ones included."""
        return address in self._heartbeats

    def _silent(self, address: str) -> bool:
        return time.monotonic() > self._heartbeats[address][1] + SILENT_SECONDS

    def distrust(self, address: str) -> None:
        """Stop using a worker, and check it again after `LOOK_AGAIN_SECONDS`."""
        log.error("worker %s has not returned a chunk in time: it is left out for %g s", address, LOOK_AGAIN_SECONDS)
        self._note(address, 0)
        asyncio.get_running_loop().call_later(LOOK_AGAIN_SECONDS, self._seen.pop, address, None)

    async def _connect(self) -> None:
        connecting: Client = Client(  # type: ignore[no-untyped-call]
            self.address, asynchronous=True, set_as_default=False, timeout=CONNECT_SECONDS, name="ricochet"
        )
        try:
            self.client = await connecting
        except (OSError, ValueError) as error:  # Nothing, or a program other than a scheduler, listens there.
            log.debug("no Dask scheduler at %s: %s", self.address, error)
            await in_time(connecting.close, CONNECT_SECONDS)
        else:
            log.info("connected to the Dask scheduler at %s", self.address)

    async def _hang_up(self) -> None:
        client, self.client = self.client, None
        for meeting in self._seen.values():
            meeting.cancel()
        self._seen.clear()
        for address in list(self.threads):
            self._note(address, 0)
        if client is not None:
            log.info("disconnected from the Dask scheduler at %s", self.address)
            await in_time(client.close, CONNECT_SECONDS)

    async def _meet(self, address: str, threads: int) -> None:
        """Request the versions of a worker, and use it if they equal the versions of the service."""
        client = self.client
        if client is None:
            return

        async def introduced() -> dict[str, Any]:
            answer = client.run(introduce, self._task_seconds, versions(), workers=[address], on_error="return")
            return dict(await answer)

        theirs = (await in_time(introduced, INTRODUCTION_SECONDS) or {}).get(address)
        if theirs == versions():
            log.info("worker %s takes chunks, %d at a time", address, threads)
            self._note(address, threads)
        elif isinstance(theirs, dict):
            log.error("worker %s is not used: it has %s", address, differences(versions(), theirs))
        else:
            log.error("worker %s is not used: %s", address, theirs or "it did not answer")
            asyncio.get_running_loop().call_later(LOOK_AGAIN_SECONDS, self._seen.pop, address, None)

    def _note(self, address: str, threads: int) -> None:
        """Set the number of chunks that a worker takes at a time; 0 stops its use."""
        if threads:
            self.threads[address] = threads
        elif self.threads.pop(address, 0) and not self.threads:
            self.lost = time.monotonic()
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()


async def in_time(call: Callable[[], Awaitable[Value]], seconds: float) -> Value | None:
    """Return the result of a call to the cluster, or None if the connection fails or `seconds` have passed."""
    try:
        async with asyncio.timeout(seconds):
            return await call()
    except (OSError, TimeoutError, AttributeError):  # A client that has been closed has no attribute `scheduler`.
        return None


def use_our_log() -> None:
    """Pass Dask's log entries to the log of the service, except client errors and warnings about large chunks."""
    for name, logger in logging.root.manager.loggerDict.items():
        if name.startswith(LIBRARIES) and isinstance(logger, logging.Logger):
            logger.handlers.clear()
            logger.propagate = True
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # The executor logs lost chunks itself.
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
