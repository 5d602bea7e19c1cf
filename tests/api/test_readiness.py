"""`/readyz` and answers while the data folder or workers are missing, or no process can be started."""

import asyncio
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from service.api.app import create_app
from service.cache.cache import ResultCache
from service.schemas import CriticalAngleAnswer
from service.schemas.problems import Problem
from service.schemas.strike import PAPER
from service.settings import Settings
from tests.faults.processes import processor_seconds
from tests.service.squares import until

pytestmark = pytest.mark.anyio


@pytest.fixture
async def app(tmp_path: Path) -> AsyncIterator[FastAPI]:
    """Application whose data folder cannot be made, because a file has its name."""
    (tmp_path / "data").write_text("a file")
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1, task_seconds=2.0))
    async with app.router.lifespan_context(app):
        yield app


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://service") as client:
        yield client


def assert_unavailable(response: httpx.Response) -> Problem:
    assert response.status_code == 503
    assert int(response.headers["Retry-After"]) > 0
    return Problem.model_validate_json(response.content)


async def test_service_without_a_data_folder_answers_with_a_warning_but_is_not_ready(client: httpx.AsyncClient) -> None:
    assert "cannot be written" in assert_unavailable(await client.get("/readyz")).detail
    assert (await client.get("/livez")).is_success
    answer = CriticalAngleAnswer.model_validate_json((await client.post("/cra", json=PAPER)).content)
    assert answer.status == "converged"
    assert "result_not_cached" in {warning.code for warning in answer.warnings}


async def test_service_without_workers_is_alive_and_not_ready(app: FastAPI, client: httpx.AsyncClient) -> None:
    await app.state.services.executor.stop(1.0)
    assert "worker" in assert_unavailable(await client.get("/readyz")).detail
    assert assert_unavailable(await client.post("/cra", json=PAPER)).type == "urn:ricochet:problem:unavailable"
    assert (await client.get("/livez")).is_success


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
async def test_stopped_idle_worker_is_replaced(app: FastAPI, client: httpx.AsyncClient) -> None:
    executor = app.state.services.executor
    [pid] = executor.worker_pids
    os.kill(pid, signal.SIGSTOP)
    await until(lambda: executor.worker_pids not in ([], [pid]))
    assert (await client.post("/cra", json=PAPER)).is_success


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
async def test_query_whose_worker_is_stopped_is_refused_as_unavailable(app: FastAPI, client: httpx.AsyncClient) -> None:
    [pid] = app.state.services.executor.worker_pids
    long = {"method": "panels", "panels": 96_000, "time_step_s": 1e-6, "termination_time_s": 0.05}
    query = asyncio.ensure_future(client.post("/cra", json=PAPER | {"numerics": long}))
    used = processor_seconds(pid)
    await until(lambda: processor_seconds(pid) > used + 0.05)
    os.kill(pid, signal.SIGSTOP)
    refused = assert_unavailable(await query)
    assert refused.type == "urn:ricochet:problem:unavailable"
    assert "stopped" in refused.detail
    assert (await client.post("/cra", json=PAPER)).is_success


@pytest.fixture
async def on_disk(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    """Client of an application with the data folder `data`."""
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1))
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://service") as client,
    ):
        yield client


def remove(data: Path) -> None:
    """Move the data folder away."""
    data.rename(data.with_name("elsewhere"))


def replace(data: Path) -> None:
    """Replace the data folder by a copy, as when a backup is restored."""
    remove(data)
    shutil.copytree(data.with_name("elsewhere"), data)


def replace_lock(data: Path) -> None:
    """Replace only the lock file, as another service would after the file was deleted."""
    (data / "lock").rename(data.with_name("lock"))
    (data / "lock").touch()


def replace_jobs(data: Path) -> None:
    """Replace only the database of jobs, by a copy."""
    (data / "jobs.sqlite").rename(data.with_name("jobs.sqlite"))
    shutil.copy(data.with_name("jobs.sqlite"), data)


def files_in(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_size for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("change", [remove, replace, replace_lock, replace_jobs])
async def test_service_whose_folder_is_replaced_accepts_no_jobs(
    change: Callable[[Path], None], on_disk: httpx.AsyncClient, tmp_path: Path
) -> None:
    data, headers = tmp_path / "data", {"Prefer": "respond-async, wait=30"}
    job = (await on_disk.post("/cra/batch", json={"cases": [PAPER]}, headers=headers)).raise_for_status()
    assert (await on_disk.get("/readyz")).is_success
    change(data)
    before = files_in(data)
    assert "removed or replaced" in assert_unavailable(await on_disk.get("/readyz")).detail
    refused = await on_disk.post("/cra/batch", json={"cases": [PAPER]}, headers=headers)
    assert refused.status_code == 507
    assert "removed or replaced" in refused.json()["detail"]
    assert (await on_disk.get("/jobs")).json()["jobs"]
    if change is not replace_jobs:
        file = await on_disk.get(job.headers["Content-Location"], headers={"Accept": "application/x-hdf5"})
        assert file.status_code == 507
        other = PAPER | {"impact": {"velocity_m_s": 251.0}}
        answer = CriticalAngleAnswer.model_validate_json((await on_disk.post("/cra", json=other)).content)
        assert "result_not_cached" in {warning.code for warning in answer.warnings}
        assert files_in(data) == before
        # The lock has been released, so another service can use the folder.
        with ResultCache(data, memory_bytes=0, disk_bytes=10**9):
            assert (await on_disk.get("/readyz")).status_code == 503


async def test_restored_folder_is_used_again(on_disk: httpx.AsyncClient, tmp_path: Path) -> None:
    remove(tmp_path / "data")
    assert_unavailable(await on_disk.get("/readyz"))
    (tmp_path / "elsewhere").rename(tmp_path / "data")
    assert (await on_disk.get("/readyz")).is_success
    job = await on_disk.post("/cra/batch", json={"cases": [PAPER]}, headers={"Prefer": "respond-async"})
    assert job.status_code == 202


PIDS = Path("/sys/fs/cgroup/pids")
"""Control groups (version 1) that limit the number of processes and threads, as containers do."""


@pytest.fixture
def group() -> Iterator[Path]:
    """A new control group for processes; the test is skipped if none can be made."""
    folder = PIDS / f"ricochet-{os.getpid()}"
    try:
        folder.mkdir()
    except OSError as error:
        pytest.skip(f"no control group can be made: {error}")
    yield folder
    folder.rmdir()


@pytest.mark.timeout(240)
@pytest.mark.parametrize("most", [2, 8])
def test_limit_on_processes_is_reported_without_a_traceback(most: int, group: Path, tmp_path: Path) -> None:
    """The limits allow the service to begin, but not to start eight workers."""
    (group / "pids.max").write_text(str(most))
    settings = {"RICOCHET_WORKERS": "8", "RICOCHET_PORT": "0", "RICOCHET_DATA_DIR": str(tmp_path / "data")}
    program = f"""
import os, sys
open({str(group / "cgroup.procs")!r}, "w").write(str(os.getpid()))
os.execv(sys.executable, [sys.executable, "-m", "service.cli", "serve"])
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, env=os.environ | settings, capture_output=True, text=True, timeout=200.0, check=False
    )
    assert done.returncode == 3
    assert "pids.max" in done.stderr
    assert "Traceback" not in done.stderr
