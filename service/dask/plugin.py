"""What runs on the workers of a Dask cluster: each has the same process pool as the service.

So a call that hangs or kills its process is dealt with where it happens and as everywhere else, and the worker, whose
interpreter no compiled code holds up, always hears of its scheduler. It passes messages on without looking inside.
"""

import asyncio
import multiprocessing
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from typing import cast

from distributed import Worker, get_worker
from distributed import WorkerPlugin as Plugin
from distributed.worker_state_machine import TaskStateState

from service.cache_key import SCHEMA_VERSION
from service.workers.base import CallResult
from service.workers.process_pool import ProcessPool
from service.workers.worker import answer
from solver import ENGINE_VERSION

PACKAGES = ("ricochet", "h5py", "llvmlite", "numba", "numpy", "orjson", "pydantic", "scipy")
"""What decides the last bit of a result, or how it is encoded."""
MAIN_MODULES = ("distributed.cli.dask_worker",)
"""Main module of a Dask worker: its import takes a second, and is done once for the pool."""
STOP_SECONDS = 1.0


class UnfitWorkerError(Exception):
    """The worker runs other versions than the service, or they are not known yet."""


@cache
def versions() -> dict[str, str]:
    """Return what has to be the same in the service and on every worker."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"engine": ENGINE_VERSION, "schema": SCHEMA_VERSION, "python": python} | {
        name: version(name) for name in PACKAGES
    }


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
        # The nanny makes its worker a daemon, which may have no children lest they outlive it; these end with it.
        multiprocessing.current_process().daemon = False
        self._pool = ProcessPool(workers=worker.state.nthreads, task_seconds=self._task_seconds, preload=MAIN_MODULES)
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
            return await running
        except asyncio.CancelledError:
            return []  # to nobody
        finally:
            del self._running[key]


async def introduce(task_seconds: float, expected: Mapping[str, str], dask_worker: Worker) -> dict[str, str]:
    """Tell the versions of this worker, and set up its pool if they are as expected."""
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
