"""The disk becomes full during a batch: no answer is lost, and the service recovers once there is space again."""

import random
from pathlib import Path
from typing import Any

import pytest

from .cases import LONG, jsonl, searches
from .disk import Disk, small_disk
from .server import JSONL, RestartableServer

CASES = 200
RECOVERIES = ("killed while full", "started while full", "stopped once there is room", "not restarted")
STORAGE_FULL = "urn:ricochet:problem:storage-full"


@pytest.mark.parametrize("rounds", [len(RECOVERIES), LONG])
def test_full_disk_loses_no_answer_and_leaves_no_partial_file(rounds: int, tmp_path: Path) -> None:
    instants = random.Random(0)  # noqa: S311
    with (
        small_disk(tmp_path) as disk,
        RestartableServer(tmp_path / "undisturbed") as undisturbed,
        RestartableServer(tmp_path / "filled", data=disk.data) as server,
    ):
        undisturbed.start()
        server.start()
        for number in range(rounds):
            body = jsonl(searches(CASES, first=number * CASES))
            job = server.until_done(server.submit(body), instants.randrange(CASES // 2))
            disk.fill(server.pid)
            job = server.finished(job)
            check_job_on_full_disk(server, job)
            check_service_on_full_disk(server, job, number)
            recover(server, disk, RECOVERIES[number % len(RECOVERIES)])
            job = server.finished(server.job(job))
            expected = undisturbed.results(undisturbed.finished(undisturbed.submit(body)))
            results = server.results(job)
            assert len(results) == job["counts"]["done"]
            if job["status"] == "successful":
                assert results == expected
            else:
                assert job["status"] == "failed"
                assert set(results) <= set(expected)
            again = server.finished(server.submit(body))
            assert server.results(again) == expected
            assert server.folder_faults() == []
        server.stop()


def check_job_on_full_disk(server: RestartableServer, job: dict[str, Any]) -> None:
    """Check that the job ends, with a reason if it failed, and that its finished cases can be read."""
    assert job["status"] in {"successful", "failed"}
    if job["status"] == "failed":
        assert job["problem"]["type"] == STORAGE_FULL
        assert str(server.data) not in job["problem"]["detail"]
    results = server.results(job)
    assert len(results) == job["counts"]["done"]
    assert all(b'"result":' in line for line in results)


def check_service_on_full_disk(server: RestartableServer, job: dict[str, Any], number: int) -> None:
    """Check that a query, /livez and CSV are answered, and that a new job is refused with 507.

    HDF5, which is written to a file first, may be answered or refused.
    """
    client = server.client
    refused = client.post("/cra/batch", content=jsonl(searches(CASES, first=500_000)), headers={"Content-Type": JSONL})
    assert refused.status_code == 507
    [case] = searches(1, first=600_000 + number)
    assert client.post("/cra", json=case).status_code == 200
    assert client.get("/livez").status_code == 200
    assert client.get(job["links"]["results"], headers={"Accept": "text/csv"}).status_code == 200
    hdf5 = client.get(job["links"]["results"], headers={"Accept": "application/x-hdf5"})
    assert hdf5.status_code in {200, 507}


def recover(server: RestartableServer, disk: Disk, how: str) -> None:
    """Free the disk, and restart the service in the way that `how` names, if at all."""
    if how == "not restarted":
        disk.free(server.pid)
    elif how == "stopped once there is room":
        disk.free(server.pid)
        server.stop()
        server.start()
    elif how == "started while full" and disk.mounted:
        server.kill()
        server.spawn()
        server.wait_until("/livez")
        assert server.client.get("/readyz").status_code == 503
        disk.free(server.pid)
        server.wait_until("/readyz")
    else:
        server.kill()
        disk.free(0)
        server.start()
