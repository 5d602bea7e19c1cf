from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from service.workers.in_thread import InThreadExecutor
from service.workers.process_pool import ProcessPool
from tests.service import opened
from tests.service.dask_cluster import DaskCluster, dask_cluster


@pytest.fixture(autouse=True)
def closed_stores() -> Iterator[None]:
    yield
    opened.close_all()


@asynccontextmanager
async def warm_pool(workers: int) -> AsyncIterator[ProcessPool]:
    """Run a process pool whose workers have started, with a time limit far above the time of any call."""
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
    """An executor that computes in this process, so that monkeypatching affects its calls."""
    executor = InThreadExecutor(task_seconds=60.0)
    await executor.start()
    yield executor
    await executor.stop(2.0)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Folder in which each run of a case creates a file."""
    folder = tmp_path / "log"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """A Dask cluster with two workers, shared by the tests of a file."""
    with dask_cluster(tmp_path_factory.mktemp("dask"), workers=2) as running:
        yield running
