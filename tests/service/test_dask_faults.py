"""Batches on a Dask cluster whose processes are killed."""

import asyncio
import json
import logging
import operator
import os
import signal
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from distributed import Client
from pydantic import ValidationError

from service.errors import WorkerCrashedError
from service.schemas.strike import PAPER
from service.settings import Settings
from service.workers import Call
from service.workers.dask_cluster import UnfitWorkerError, differences, run_chunk, versions
from service.workers.dask_executor import DaskExecutor
from tests.service.dask_cluster import DaskCluster, dask_cluster
from tests.service.squares import accepted, all_results, cases, ended, running, squares, until, until_done

pytestmark = [pytest.mark.system, pytest.mark.anyio, pytest.mark.timeout(240)]

WAIT_SECONDS = 120.0
KILL_WORKER: Call = (
    exec,
    (
        f"""
import os, signal, time
worker = int(open(f'/proc/{{os.getppid()}}/stat').read().rpartition(')')[2].split()[1])
assert worker != {os.getpid()}, 'this is no worker of Dask'
os.kill(worker, signal.SIGKILL)
time.sleep(30)
""",
    ),
)
"""Call that kills the Dask worker in whose process pool it runs, as if the machine failed."""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    folder = tmp_path_factory.mktemp("dask")
    with dask_cluster(folder, workers=2, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as running_cluster:
        yield running_cluster


@pytest.fixture
async def executor(cluster: DaskCluster) -> AsyncIterator[DaskExecutor]:
    async with started(cluster) as ready:
        await until(lambda: ready.cluster.capacity == 2)
        yield ready


@asynccontextmanager
async def started(cluster: DaskCluster) -> AsyncIterator[DaskExecutor]:
    executor = DaskExecutor(address=cluster.address, workers=1, task_seconds=60.0)
    await executor.start()
    try:
        yield executor
    finally:
        await executor.stop(2.0)


async def workers_of(executor: DaskExecutor) -> dict[str, int]:
    """Return the process ids of the Dask workers."""
    assert executor.cluster.client is not None
    return dict(await executor.cluster.client.run(os.getpid))


async def grandparents(executor: DaskExecutor, count: int) -> set[int]:
    """Return the ids of the processes whose pools compute chunks: Dask workers or this process."""
    code = "__import__('time').sleep(0.1) or int(open('/proc/%d/stat' % __import__('os').getppid()).read().split()[3])"
    call: Call = (eval, (code,))
    finished = await asyncio.gather(*(executor.run([call]) for _ in range(count)))
    return {outcome.value for (outcome,) in finished}


async def test_batch_survives_a_killed_worker(executor: DaskExecutor, tmp_path: Path) -> None:
    async with running(tmp_path, executor) as manager:
        job = await accepted(manager, cases(range(300), seconds=0.02))
        await until_done(manager, job, 40)
        victim, *_ = (await workers_of(executor)).values()
        os.kill(victim, signal.SIGKILL)
        state = await ended(manager, job)
        assert (state.status, state.done, state.failed) == ("successful", 300, 0)
        assert squares(await all_results(manager, job)) == [number**2 for number in range(300)]
    await until(lambda: executor.cluster.capacity == 2)
    assert victim not in (await workers_of(executor)).values()


async def test_batch_survives_a_frozen_worker(executor: DaskExecutor, tmp_path: Path) -> None:
    """Dask itself would notice only after minutes, because the connection stays open."""
    async with running(tmp_path, executor) as manager:
        job = await accepted(manager, cases(range(300), seconds=0.02))
        await until_done(manager, job, 40)
        victim, *_ = (await workers_of(executor)).values()
        os.kill(victim, signal.SIGSTOP)
        try:
            async with asyncio.timeout(WAIT_SECONDS):
                state = await ended(manager, job)
        finally:
            os.kill(victim, signal.SIGCONT)
        assert (state.status, state.done, state.failed) == ("successful", 300, 0)
        assert squares(await all_results(manager, job)) == [number**2 for number in range(300)]
    await until(lambda: executor.cluster.capacity == 2)


async def test_batch_survives_a_restart_of_the_scheduler(
    executor: DaskExecutor, cluster: DaskCluster, tmp_path: Path
) -> None:
    async with running(tmp_path, executor) as manager:
        job = await accepted(manager, cases(range(300), seconds=0.02))
        await until_done(manager, job, 40)
        cluster.kill_scheduler()
        await asyncio.sleep(0.5)
        state = await manager.job(job.id)
        assert state is not None
        assert state.status == "running"
        await asyncio.to_thread(cluster.start_scheduler)
        state = await ended(manager, job)
        assert (state.status, state.done, state.failed) == ("successful", 300, 0)
        assert squares(await all_results(manager, job)) == [number**2 for number in range(300)]
    await until(lambda: executor.cluster.capacity == 2)
    assert await executor.probe(10.0)
    assert await grandparents(executor, 8) <= set((await workers_of(executor)).values())


async def test_call_that_kills_dask_workers_fails_alone(
    executor: DaskExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Both workers restart meanwhile, and the executor has to wait for them.
    monkeypatch.setattr("service.workers.dask_executor.PATIENCE_SECONDS", WAIT_SECONDS)
    first, deadly, last = await executor.run([(operator.add, (1, 2)), KILL_WORKER, (operator.add, (3, 4))])
    assert (first.value, last.value) == (3, 7)
    assert isinstance(deadly.error, WorkerCrashedError)
    await until(lambda: executor.cluster.capacity == 2)


async def test_worker_of_another_version_is_not_used_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with dask_cluster(tmp_path, workers=0) as odd_cluster, caplog.at_level(logging.ERROR):
        odd_cluster.start_odd_worker()
        async with started(odd_cluster) as executor:
            await until(lambda: "is not used" in caplog.text)
            assert f"engine odd instead of {versions()['engine']}" in caplog.text
            assert executor.cluster.capacity == 0
            # The pool of this process computes while the cluster is down.
            assert await grandparents(executor, 2) == {os.getpid()}
            assert not await executor.probe(5.0)
            assert "cluster unreachable" in executor.last_error


async def test_chunk_of_another_version_is_refused_by_the_worker(executor: DaskExecutor) -> None:
    client = executor.cluster.client
    assert isinstance(client, Client)
    with pytest.raises(UnfitWorkerError, match="instead of odd"):
        await client.submit(run_chunk, "key", 60.0, versions() | {"engine": "odd"}, [], pure=False)


def test_differences_of_versions_are_named() -> None:
    assert differences({"engine": "2", "numpy": "2.4"}, {"engine": "2", "numpy": "2.4"}) == ""
    assert differences({"engine": "2", "numpy": "2.4"}, {"engine": "1"}) == (
        "engine 1 instead of 2, numpy none instead of 2.4"
    )


@pytest.mark.parametrize("address", ["", "scheduler:8786", "http://scheduler:8786"])
def test_scheduler_setting_without_a_usable_address_is_refused(address: str) -> None:
    with pytest.raises(ValidationError, match=r"tcp|RICOCHET_DASK_SCHEDULER"):
        Settings(executor="dask", dask_scheduler=address)


def test_service_answers_with_and_without_its_cluster(
    cluster: DaskCluster,
    service_on: Callable[..., AbstractContextManager[Any]],
    tmp_path: Path,
) -> None:
    """A batch runs on the cluster; after the scheduler is killed, queries and batches are still answered."""
    settings = {"executor": "dask", "dask_scheduler": cluster.address, "workers": "1", "probe_seconds": "10"}
    with service_on(tmp_path, **settings) as service, httpx.Client(base_url=service.url, trust_env=False) as client:
        assert 'ricochet_chunk_width{place="cluster"} 2.0' in client.get("/metrics").text
        assert client.get("/readyz").json()["chunks_on"] == "cluster"

        def batch(first: float) -> list[float]:
            strikes = [PAPER | {"impact": {"velocity_m_s": first + number}} for number in range(12)]
            answer = client.post("/cra/batch", json={"cases": strikes}, timeout=60.0).raise_for_status()
            return [result["result"]["critical_angle_deg"] for result in json.loads(answer.content)["results"]]

        assert len(batch(220.0)) == 12
        cluster.kill_scheduler()
        try:
            deadline = time.monotonic() + 30.0
            while (ready := client.get("/readyz", timeout=30.0)).is_success:
                assert time.monotonic() < deadline
                time.sleep(0.2)
            assert ready.status_code == 503
            assert "cluster unreachable" in ready.text
            assert client.get("/livez").is_success
            assert client.post("/cra", json=PAPER, timeout=60.0).is_success
            assert len(batch(240.5)) == 12
        finally:
            cluster.start_scheduler()
