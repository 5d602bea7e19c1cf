"""A Dask cluster as the executor sees it: its workers, and the plugin with a process pool that runs on each."""

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
"""What decides the last bit of a result, or how it is encoded."""
STOP_SECONDS = 1.0
"""Time allowed for the pool of a worker to stop. [s]"""


class UnfitWorkerError(Exception):
    """The worker runs other versions than the service, or they are not known yet."""


@cache
def versions() -> dict[str, str]:
    """Return what has to be the same in the service and on every worker."""
    python = ".".join(platform.python_version_tuple()[:2])
    own = {"ricochet": VERSION, "engine": ENGINE_VERSION, "schema": SCHEMA_VERSION, "python": python}
    return own | {name: version(name) for name in PACKAGES}


def differences(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    """Return in words where two sets of versions differ; nothing if they do not."""
    names = [name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name)]
    return ", ".join(f"{name} {theirs.get(name, 'none')} instead of {ours.get(name, 'none')}" for name in names)


class WorkerPlugin(Plugin):
    """The pool of a worker, as wide as the worker.

    Parameters
    ----------
    task_seconds
        Wall time one call may take.
    """

    def __init__(self, task_seconds: float) -> None:
        self._task_seconds = task_seconds
        self._running: dict[str, asyncio.Task[list[CallResult]]] = {}

    async def setup(self, worker: Worker) -> None:
        """Bring the pool up."""
        self._pool = ProcessPool(workers=worker.state.nthreads, task_seconds=self._task_seconds)
        await self._pool.start()

    async def teardown(self, worker: Worker) -> None:
        """End the pool."""
        await self._pool.stop(STOP_SECONDS)

    def transition(self, key: object, start: TaskStateState, finish: TaskStateState, **_: object) -> None:
        """Stop a chunk that the scheduler no longer wants: Dask itself lets it run to its end."""
        if finish == "released" and isinstance(key, str) and key in self._running:
            self._running[key].cancel()

    async def run(self, key: str, messages: Sequence[bytes]) -> list[CallResult]:
        """Have these calls run, each dumps; the value of each that was brought to an end is its dumps reply."""
        running = self._running[key] = asyncio.create_task(
            self._pool.run([(answer, (message,)) for message in messages])
        )
        try:
            return await running  # cancelled when the worker closes: Dask gives the chunk to another one then
        finally:
            del self._running[key]


async def introduce(task_seconds: float, expected: Mapping[str, str], dask_worker: Worker) -> dict[str, str]:
    """Return the versions of this worker, and set up its pool if they are as expected."""
    name = plugin_name(task_seconds)
    if versions() == expected and name not in dask_worker.plugins:
        done = await dask_worker.plugin_add(WorkerPlugin(task_seconds), name=name)
        if done["status"] != "OK":
            with suppress(KeyError):
                del dask_worker.plugins[name]
            raise UnfitWorkerError(f"its pool did not come up: {done.get('exception_text')}")
    return versions()


async def run_chunk(
    key: str, task_seconds: float, expected: Mapping[str, str], messages: Sequence[bytes]
) -> list[CallResult]:
    """Run a chunk on the worker that this is called on.

    Raises
    ------
    UnfitWorkerError
        If it runs other versions, or has no pool.
    """
    host = get_worker().plugins.get(plugin_name(task_seconds))
    if host is None or versions() != expected:
        raise UnfitWorkerError(differences(expected, versions()) or "it has no pool yet")
    return await cast(WorkerPlugin, host).run(key, messages)


def plugin_name(task_seconds: float) -> str:
    """Name of the plugin: services with different time limits may share a cluster."""
    return f"ricochet-{task_seconds:g}"


LOOK_SECONDS = 1.0
"""Interval between checks of the list of workers [s]."""
CONNECT_SECONDS = 5.0
"""Timeout for an answer of the scheduler [s]."""
INTRODUCTION_SECONDS = 180.0
"""Timeout for a worker to report its versions and start its pool [s]; the first on a machine compiles the solver."""
LOOK_AGAIN_SECONDS = 30.0
"""Delay before retrying a worker that failed to report its versions or start its pool [s]."""
SILENT_SECONDS = 10.0
"""Time without a heartbeat after which a worker is taken for frozen, and its chunks are given to others. [s]

Workers send one every half second, in clusters of hundreds every five seconds; Dask itself waits for five minutes.
"""
LIBRARIES = ("distributed", "tornado", "bokeh")
"""Libraries whose loggers get handlers when Dask is imported."""

Value = TypeVar("Value")
log = logging.getLogger(__name__)


class Cluster:
    """Keeps up a connection to the scheduler, and an eye on the workers.

    A worker takes no chunk before it has said its versions: those of other versions are left out, with a line in the
    log, and a worker that joins later is checked in the same way.

    Parameters
    ----------
    address
        Address of the scheduler.
    task_seconds
        Wall time one call may take.
    """

    def __init__(self, address: str, task_seconds: float) -> None:
        self.address = address
        self.client: Client | None = None
        """None while there is no connection."""
        self.threads: dict[str, int] = {}
        """Threads of the workers that can be used, by address."""
        self.changed = asyncio.Event()
        """Set when workers have come or gone, and another one put in its place."""
        self.lost = time.monotonic()
        """Time at which the last worker was lost, on the monotonic clock [s]."""
        self._task_seconds = task_seconds
        self._seen: dict[str, asyncio.Task[None]] = {}
        self._heartbeats: dict[str, tuple[float, float]] = {}
        """Latest heartbeat of each worker by the clock of the scheduler, and when it was seen on the monotonic one."""
        self._watching: asyncio.Task[None] | None = None

    @property
    def capacity(self) -> int:
        """Chunks that can run at the same time."""
        return sum(self.threads.values())

    async def start(self) -> None:
        """Connect if the scheduler is there, and wait for the workers that are there to introduce themselves."""
        use_our_log()
        await self._look()
        if self._seen:
            await asyncio.wait(self._seen.values())
        if not self.capacity:
            log.warning("no worker of the Dask cluster at %s can be used yet", self.address)
        self._watching = asyncio.create_task(self._watch())

    async def stop(self) -> None:
        """Hang up."""
        if self._watching is not None:
            self._watching.cancel()
            await asyncio.wait([self._watching])
        await self._hang_up()

    async def answers(self, seconds: float) -> bool:
        """Return whether the scheduler answers within this time and has a worker for us."""
        client = self.client
        if client is None or not self.capacity:
            return False
        return await in_time(client.nthreads, seconds) is not None

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(LOOK_SECONDS)
            try:
                await self._look()
            except Exception:
                log.exception("the Dask cluster could not be looked at")

    async def _look(self) -> None:
        """Connect anew if need be; take note of workers that have come or gone."""
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
        """Return the threads of the workers that are there and not frozen, by address."""
        assert self.client is not None  # noqa: S101 (asked only then)
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
        """Return whether the scheduler has this worker, be it frozen."""
        return address in self._heartbeats

    def _silent(self, address: str) -> bool:
        return time.monotonic() > self._heartbeats[address][1] + SILENT_SECONDS

    def distrust(self, address: str) -> None:
        """Give a worker no chunk until it has introduced itself again, later."""
        log.error("worker %s has not returned a chunk in time: it is left out for %g s", address, LOOK_AGAIN_SECONDS)
        self._note(address, 0)
        asyncio.get_running_loop().call_later(LOOK_AGAIN_SECONDS, self._seen.pop, address, None)

    async def _connect(self) -> None:
        connecting: Client = Client(  # type: ignore[no-untyped-call]
            self.address, asynchronous=True, set_as_default=False, timeout=CONNECT_SECONDS, name="ricochet"
        )
        try:
            self.client = await connecting
        except (OSError, ValueError) as error:  # nobody there, or no scheduler
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
        """Request the versions of a worker, and use it if they are ours."""
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
        """Note how many chunks this worker takes at a time."""
        if threads:
            self.threads[address] = threads
        elif self.threads.pop(address, 0) and not self.threads:
            self.lost = time.monotonic()
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()


async def in_time(call: Callable[[], Awaitable[Value]], seconds: float) -> Value | None:
    """Return what the cluster says to this; None if it cannot be reached, or not in time."""
    try:
        async with asyncio.timeout(seconds):
            return await call()
    except (OSError, TimeoutError, AttributeError):  # the client has no scheduler any more once it is closed
        return None


def use_our_log() -> None:
    """Have Dask log as everything else does, and say nothing of large chunks: they are meant."""
    for name, logger in logging.root.manager.loggerDict.items():
        if name.startswith(LIBRARIES) and isinstance(logger, logging.Logger):
            logger.handlers.clear()
            logger.propagate = True
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # losses are logged here
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
