"""The data folder: permissions, folders that are refused, and disk space for downloads."""

import os
import shutil
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

import pytest
from anyio.to_thread import run_sync
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.api.downloads import Downloads
from service.cache.maintenance import stat as statistics
from service.clock import Clock
from service.errors import FolderLayoutError, ServiceError
from service.schemas.strike import PAPER
from service.settings import Settings

from .many import ASYNC
from .owners import bearer, key_in

pytestmark = pytest.mark.timeout(180)

ROOT = Path(__file__).parents[2]
CASES = {
    "cases": [PAPER | {"impact": {"velocity_m_s": 200.0 + number, "oblique_angle_deg": 55.0}} for number in range(5)]
}


@contextmanager
def service_in(folder: Path, clock: Clock | None = None, **settings: Any) -> Iterator[TestClient]:
    """Run a service with this data folder in this process; yield a client."""
    values: dict[str, Any] = {"data_dir": folder, "executor": "in-process", "access": "open"} | settings
    configured = Settings(**values)
    app = create_app(configured) if clock is None else create_app(configured, clock)
    with TestClient(app) as client:
        yield client


def job_in(client: TestClient, body: dict[str, Any] = CASES, **headers: str) -> dict[str, Any]:
    """Submit a job and wait until it has ended; return the job."""
    job: dict[str, Any] = client.post("/trajectory/batch", json=body, headers=ASYNC | headers).raise_for_status().json()
    while job["status"] in {"accepted", "running"}:
        time.sleep(0.05)
        job = client.get(job["links"]["self"]).raise_for_status().json()
    return job


USE = """
import os, sys
os.umask(0)
from fastapi.testclient import TestClient
from pathlib import Path
from service.api.app import create_app
from service.auth.api_keys import add_key, make_key
from service.cache.maintenance import verify
from service.settings import Settings
from tests.api.test_data_folder import job_in

folder = Path(sys.argv[1])
key, token = make_key("anna", frozenset({"read", "run"}), cases_per_hour=1000)
add_key(folder, key)
settings = Settings(data_dir=folder, executor="in-process", access="keys", audit_log=folder / "audit.log")
with TestClient(create_app(settings), headers={"Authorization": f"Bearer {token}"}) as client:
    job = job_in(client)
    for form in ("application/x-hdf5", "application/vnd.apache.parquet"):
        client.get(job["links"]["results"], headers={"Accept": form}).raise_for_status()
    segment = next((folder / "results" / "segments").rglob("*.h5"))
    segment.write_bytes(b"damaged")
    client.get(job["links"]["results"], headers={"Accept": "application/jsonl"}).raise_for_status()
    modes = {path: path.stat().st_mode for path in (folder, *folder.rglob("*"))}
for path, mode in sorted(modes.items()):
    print(oct(mode & 0o777), path.is_dir(), path.relative_to(folder.parent))
"""


def test_files_are_private_whatever_the_umask(tmp_path: Path) -> None:
    command = [sys.executable, "-c", USE, str(tmp_path / "data")]
    done = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = [line.split(maxsplit=2) for line in done.stdout.splitlines()]
    found = {name: mode for mode, _, name in lines}
    kinds = {Path(name).suffix or Path(name).name for name in found}
    assert {".sqlite", ".sqlite-wal", ".sqlite-shm", ".h5", ".parquet", ".log", ".lock", "lock", "damaged"} <= kinds
    assert {name: mode for name, mode in found.items() if int(mode, 8) & 0o077} == {}


def test_files_restored_from_a_backup_are_private_again(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    with service_in(folder) as client:
        job_in(client)
    for path in folder.rglob("*.sqlite"):
        path.chmod(0o644)
    with service_in(folder):
        assert {path.name: path.stat().st_mode & 0o077 for path in folder.rglob("*.sqlite*")} == dict.fromkeys(
            (path.name for path in folder.rglob("*.sqlite*")), 0
        )


def content_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ["jobs.sqlite", "results/index.sqlite", "results/journal.sqlite"])
@pytest.mark.parametrize("layout", [1, 2, 99])
def test_folder_with_an_unknown_layout_is_refused_unchanged(name: str, layout: int, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    with service_in(folder) as client:
        job_in(client)
        client.post("/trajectory", json=CASES["cases"][0]).raise_for_status()
    with closing(sqlite3.connect(folder / name)) as database:
        database.execute(f"PRAGMA user_version = {layout}")
    before = content_of(folder)
    with (
        pytest.raises(FolderLayoutError, match=rf"layout {layout}, of another version.*RICOCHET_DATA_DIR"),
        service_in(folder),
    ):
        pass
    after = content_of(folder)
    assert {path: after[path] for path in before if not path.endswith(("-shm", "-wal"))} == before
    environment = os.environ | {"RICOCHET_DATA_DIR": str(folder), "RICOCHET_PORT": "0"}
    command = [sys.executable, "-m", "service.cli", "serve"]
    started = subprocess.run(command, check=False, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert started.returncode == 3
    assert f"has layout {layout}" in started.stderr
    assert "Traceback" not in started.stderr


@pytest.mark.parametrize("how", ["gone", "empty", "whole"])
def test_loss_of_the_job_database_is_a_warning_if_results_remain(
    how: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "data"
    with service_in(folder) as client:
        assert "warnings" not in client.get("/readyz").json()
        job_in(client)
    if how == "gone":
        (folder / "jobs.sqlite").unlink()
    if how == "empty":
        (folder / "jobs.sqlite").write_bytes(b"")
    with service_in(folder) as client:
        warnings = client.get("/readyz").raise_for_status().json().get("warnings", [])
    assert len(warnings) == (how != "whole")
    assert all("jobs.sqlite was missing or empty" in text for text in warnings)


@pytest.mark.anyio
@pytest.mark.parametrize("keep", [True, False], ids=["of ended jobs", "of running jobs"])
async def test_downloads_held_by_slow_clients_count_against_the_limit(keep: bool, tmp_path: Path) -> None:
    """Ten clients open downloads of 61 kB without reading them to the end; the limit for all of them is 100 kB."""
    downloads = Downloads(tmp_path / "downloads", 100_000, lambda: None)

    async def write(path: Path) -> None:
        await run_sync(path.write_bytes, bytes(61_000))

    held: list[BufferedReader] = []
    refused: list[ServiceError] = []
    for number in range(10):
        try:
            held.append(await downloads.open(f"job{number}.h5", write, keep=keep))
        except ServiceError as error:
            refused.append(error)
    taken = {os.fstat(file.fileno()).st_ino: 61_000 for file in held}
    assert sum(taken.values()) <= 100_000 + 61_000
    assert len(held) + len(refused) == 10
    assert {(error.status, error.type) for error in refused} == {(503, "urn:ricochet:problem:downloads-full")}
    for file in held:
        file.close()
    with await downloads.open("job99.h5", write, keep=keep) as file:
        assert len(file.read()) == 61_000


def test_recomputing_evicted_results_counts_in_the_quota_of_the_reader(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    key_in(folder, "anna")
    token = key_in(folder, "bert", cases_per_hour=5)
    with service_in(folder, access="keys") as client:
        client.headers.update(bearer(token))
        job = job_in(client)
    shutil.rmtree(folder / "results" / "segments")
    assert statistics(folder).cases
    results = job["links"]["results"]
    with service_in(folder, access="keys") as client:
        client.headers.update(bearer(token))
        for form in ("application/x-hdf5", "application/vnd.apache.parquet"):
            answer = client.get(results, headers={"Accept": form})
            assert (answer.status_code, answer.json()["type"]) == (429, "urn:ricochet:problem:quota")
        lines = client.get(results, headers={"Accept": "application/jsonl"}).text.splitlines()
        assert len(lines) == 5
        assert all("urn:ricochet:problem:quota" in line for line in lines)
    with service_in(folder) as client:
        lines = client.get(results, headers={"Accept": "application/jsonl"}).text.splitlines()
        assert all('"result"' in line for line in lines)


def test_job_expires_by_the_date_and_not_by_elapsed_time(tmp_path: Path) -> None:
    date, passed = 1.8e9, 1000.0
    clock = Clock(now=lambda: date, monotonic=lambda: passed)
    folder = tmp_path / "data"
    with service_in(folder, clock) as client:
        job_in(client)
    passed += 1e9
    with service_in(folder, clock) as client:
        assert len(client.get("/jobs").json()["jobs"]) == 1
    date += 8 * 86_400.0
    with service_in(folder, clock) as client:
        assert client.get("/jobs").json()["jobs"] == []
