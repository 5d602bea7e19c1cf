"""During jobs all kinds of processes are killed or stopped, and the temporary folder is emptied: no case is lost."""

import os
import random
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from distributed import Client

from tests.service.dask_cluster import DaskCluster, dask_cluster

from .cases import jsonl, searches
from .processes import children_of, kill
from .server import UNFINISHED, RestartableServer

STOPPED_SECONDS = {"pool": 1.0, "dask": 15.0}
"""Time for which a worker is stopped; the service gives up a Dask worker after 10 s. [s]"""


@pytest.mark.parametrize(
    ("executor", "cases"),
    [
        ("pool", 800),
        ("dask", 800),
        *(
            pytest.param(executor, 5000, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])
            for executor in ("pool", "dask")
        ),
    ],
)
def test_job_survives_kills_of_every_kind_of_process(executor: str, cases: int, tmp_path: Path) -> None:
    instants = random.Random(0)  # noqa: S311
    body = jsonl(searches(cases))
    with RestartableServer(tmp_path / "undisturbed") as undisturbed:
        undisturbed.start()
        expected = undisturbed.results(undisturbed.until_done(undisturbed.submit(body), cases))
        undisturbed.stop()
    with workers_and_settings(executor, tmp_path) as (cluster, settings), disturbed(tmp_path, settings) as server:
        faults = faults_of(server, cluster, instants)
        job = server.submit(body)
        rounds = max(1, cases // 1000)
        for number, fault in enumerate(list(faults.values()) * rounds):
            job = server.until_done(job, number * cases // (len(faults) * rounds))
            assert job["status"] in UNFINISHED, "the job has ended before everything was tried"
            time.sleep(instants.uniform(0.0, 0.2))
            fault()
        job = server.until_done(server.job(job), cases)
        assert job["status"] == "successful"
        assert [job["counts"][name] for name in ("total", "done", "failed")] == [cases, cases, 0]
        assert server.results(job) == expected
        assert server.folder_faults() == []


@contextmanager
def workers_and_settings(executor: str, folder: Path) -> Iterator[tuple[DaskCluster | None, dict[str, str]]]:
    """Yield a cluster with two Dask workers, or none for "pool", and the environment variables to use it."""
    if executor == "pool":
        yield None, {}
        return
    with dask_cluster(folder, workers=0) as cluster:
        for _ in range(2):
            cluster.start_workers(1, nanny=False)
        yield cluster, {"RICOCHET_EXECUTOR": "dask", "RICOCHET_DASK_SCHEDULER": cluster.address}


@contextmanager
def disturbed(folder: Path, settings: dict[str, str]) -> Iterator[RestartableServer]:
    """Run a service with its own temporary folder."""
    with RestartableServer(folder / "disturbed") as server:
        temporary = folder / "temporary"
        temporary.mkdir()
        server.environment |= {"TMPDIR": str(temporary)} | settings
        server.start()
        yield server


def faults_of(
    server: RestartableServer, cluster: DaskCluster | None, instants: random.Random
) -> dict[str, Callable[[], object]]:
    """Return functions that each cause a fault of the service or its workers, by name."""

    def kill_server() -> None:
        server.kill()
        assert not server.orphans(10.0)
        server.start()

    def worker() -> int:
        if cluster is None:
            while not (workers := server.workers()):
                time.sleep(0.05)
        else:
            with Client(cluster.address, set_as_default=False) as client:  # type: ignore[no-untyped-call]
                while not (workers := list(client.run(os.getpid, on_error="ignore").values())):
                    time.sleep(0.05)
        return instants.choice(sorted(workers))

    def stop_worker() -> None:
        stopped = worker()
        os.kill(stopped, signal.SIGSTOP)
        seconds = STOPPED_SECONDS["pool" if cluster is None else "dask"]
        threading.Timer(seconds, resume, [stopped]).start()

    def empty_temporary_folder() -> None:
        for path in Path(server.environment["TMPDIR"]).iterdir():
            shutil.rmtree(path, ignore_errors=True)
            path.unlink(missing_ok=True)
        kill_worker()

    def kill_worker() -> None:
        kill(worker())

    def kill_template() -> None:
        for child in children_of(server.data, server.pid):
            kill(child)

    return {
        "killed worker": kill_worker,
        "emptied temporary folder": empty_temporary_folder,
        "killed template process": kill_template,
        "stopped worker": stop_worker,
        "killed server": kill_server,
        "second killed worker": kill_worker,
    }


def resume(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGCONT)
