"""Dask workers are ended in various ways: every case is answered once, with the same bytes as without a cluster."""

import os
import random
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from distributed import Client

from tests.service.dask_cluster import DaskCluster, dask_cluster

from .cases import jsonl, searches
from .server import UNFINISHED, RestartableServer

SIGNALS = {"SIGTERM": signal.SIGTERM, "SIGKILL": signal.SIGKILL, "closed nanny": signal.SIGTERM}
"""Ways to end a worker, with the signal for each. `closed nanny` sends it to the nanny, which then ends its worker; the
other two send it to the worker itself. Workers that receive SIGTERM run without a nanny."""
POOL_WORKERS = "3"
"""Number of worker processes of the service, more than Dask workers, so that metrics show which of them are used."""
WAIT_SECONDS = 60.0
"""Time limit for the restart of a Dask worker and of its process pool on a busy machine. [s]"""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RestartableServer]:
    """A service without a cluster, which gives the expected answers."""
    with RestartableServer(tmp_path_factory.mktemp("undisturbed")) as server:
        server.start()
        yield server


@pytest.mark.parametrize(
    ("how", "workers", "kills", "cases"),
    [
        ("SIGTERM", 2, 1, 400),
        ("SIGKILL", 1, 1, 400),
        ("closed nanny", 1, 1, 400),
        *(
            pytest.param(how, workers, 20, 2000, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])
            for how in SIGNALS
            for workers in (1, 2)
        ),
    ],
)
def test_jobs_survive_the_end_of_dask_workers(
    how: str, workers: int, kills: int, cases: int, undisturbed: RestartableServer, tmp_path: Path
) -> None:
    instants, ended, jobs = random.Random(0), set[int](), 0  # noqa: S311
    with (
        workers_alone(tmp_path, workers, nanny=how != "SIGTERM") as cluster,
        RestartableServer(
            tmp_path / "killed", executor="dask", dask_scheduler=cluster.address, workers=POOL_WORKERS
        ) as server,
        Client(cluster.address, set_as_default=False) as client,  # type: ignore[no-untyped-call]
    ):
        server.start()
        while len(ended) < kills:
            until_width(server, workers)
            body = jsonl(searches(cases, first=jobs * cases))
            job = server.submit(body)
            jobs += 1
            while job["status"] in UNFINISHED and len(ended) < kills:
                job = server.until_done(job, job["counts"]["done"] + instants.randrange(cases // 4))
                if job["status"] in UNFINISHED and width(server) == workers:
                    ended |= end_one(client, how, ended, instants)
            job = server.finished(server.until_done(job, cases))
            assert job["status"] == "successful", job
            assert [job["counts"][name] for name in ("total", "done", "failed")] == [cases, cases, 0]
            expected = undisturbed.finished(undisturbed.until_done(undisturbed.submit(body), cases))
            assert server.results(job) == undisturbed.results(expected)
            assert server.computed() == jobs * cases
        assert server.folder_faults() == []
        server.stop()
        assert server.logged_errors() == []


@contextmanager
def workers_alone(folder: Path, workers: int, *, nanny: bool) -> Iterator[DaskCluster]:
    """Run a cluster in which every worker has its own supervisor, so that workers can be ended one by one."""
    with dask_cluster(folder, workers=0) as cluster:
        for _ in range(workers):
            cluster.start_workers(1, nanny=nanny)
        yield cluster


def width(server: RestartableServer) -> int:
    """Return the number of chunks computed at the same time, by Dask workers or, without any, by pool workers."""
    lines = server.client.get("/metrics").raise_for_status().text.splitlines()
    return sum(int(float(line.split()[1])) for line in lines if line.startswith("ricochet_chunk_width{"))


def until_width(server: RestartableServer, workers: int) -> None:
    """Wait until the service uses this many Dask workers."""
    deadline = time.monotonic() + WAIT_SECONDS
    while width(server) != workers:
        assert time.monotonic() < deadline
        time.sleep(0.1)


def end_one(client: Client, how: str, before: set[int], instants: random.Random) -> set[int]:
    """End a random worker that is not in `before`; return its process id as a set, which is empty if none is left."""
    parents = client.run(lambda: (os.getpid(), os.getppid()), on_error="ignore")
    victims = {worker: nanny for worker, nanny in parents.values() if worker not in before}
    if not victims:
        return set()
    worker = instants.choice(sorted(victims))
    with suppress(ProcessLookupError):
        os.kill(victims[worker] if how == "closed nanny" else worker, SIGNALS[how])
    return {worker}
