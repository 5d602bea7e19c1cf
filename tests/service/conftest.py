from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from service.workers.in_thread import InThreadExecutor
from service.workers.process_pool import ProcessPool
from tests.service.dask_cluster import DaskCluster, dask_cluster


@asynccontextmanager
async def warm_pool(workers: int) -> AsyncIterator[ProcessPool]:
    """A pool with warm workers, and a time limit that healthy calls do not approach."""
    executor = ProcessPool(workers=workers, task_seconds=60.0)
    await executor.start()
    yield executor
    await executor.stop(2.0)


@pytest.fixture
async def pool() -> AsyncIterator[ProcessPool]:
    """A pool of two workers."""
    async with warm_pool(2) as executor:
        yield executor


@pytest.fixture
async def lone() -> AsyncIterator[ProcessPool]:
    """A pool of one worker."""
    async with warm_pool(1) as executor:
        yield executor


@pytest.fixture
async def thread() -> AsyncIterator[InThreadExecutor]:
    """An executor in this process, so that monkeypatching affects its calls."""
    executor = InThreadExecutor(task_seconds=60.0)
    await executor.start()
    yield executor
    await executor.stop(2.0)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Folder in which each run of a case leaves a file."""
    folder = tmp_path / "log"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """A Dask cluster with two workers, for the tests of one file."""
    with dask_cluster(tmp_path_factory.mktemp("dask"), workers=2) as running:
        yield running
