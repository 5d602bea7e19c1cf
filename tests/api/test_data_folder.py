"""The data folder: who may read it, what is refused, and what is counted."""

import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.cache.maintenance import stat as statistics
from service.clock import Clock
from service.errors import FolderLayoutError
from service.schemas.strike import PAPER
from service.settings import Settings

from .many import ASYNC, finished
from .owners import bearer, key_in

pytestmark = pytest.mark.timeout(180)

ROOT = Path(__file__).parents[2]
HDF5 = {"Accept": "application/x-hdf5"}
CASES = {
    "cases": [PAPER | {"impact": {"velocity_m_s": 200.0 + number, "oblique_angle_deg": 55.0}} for number in range(5)]
}


@contextmanager
def service_in(folder: Path, clock: Clock | None = None, **settings: Any) -> Iterator[httpx.Client]:
    """A service in this process."""
    configured = Settings(**({"data_dir": folder, "executor": "in-process", "access": "open"} | settings))
    app = create_app(configured) if clock is None else create_app(configured, clock)
    with TestClient(app) as client:
        yield client


def job_in(client: httpx.Client, body: dict[str, Any] = CASES, **headers: str) -> dict[str, Any]:
    """A job at its end."""
    answer = client.post("/trajectory/batch", json=body, headers=ASYNC | headers)
    return finished(client, answer.raise_for_status().json())


USE = """
import os, sys
os.umask(0)
import httpx
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
def test_folder_of_another_layout_is_refused_and_left_as_it_is(name: str, layout: int, tmp_path: Path) -> None:
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
def test_jobs_that_are_gone_while_there_are_results_are_named(
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


def test_downloads_that_slow_clients_hold_count_though_their_files_are_gone(tmp_path: Path) -> None:
    """Clients that read nothing hold files of jobs: no more than the bound and what is being written."""
    settings = {"cache_bytes": "4000000", "executor": "in-process", "access": "open"}  # a tenth is for downloads
    histories = [case | {"output": {"history": True, "sample_interval_s": 1e-5}} for case in CASES["cases"][:2]]
    environment = os.environ | {f"RICOCHET_{name.upper()}": value for name, value in settings.items()}
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment |= {"RICOCHET_PORT": str(port), "RICOCHET_DATA_DIR": str(tmp_path / "data")}
    command = [sys.executable, "-m", "service.cli", "serve"]
    with subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL) as process:
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as client:
                wait_for(client)
                jobs = []
                for number in range(6):
                    body = {"cases": [case | {"custom_id": f"{number}"} for case in histories]}
                    jobs.append(job_in(client, body))
                held, refused = [], 0
                for job in jobs:
                    connection = socket.create_connection(("127.0.0.1", port))
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                    path = job["links"]["results"]
                    connection.sendall(
                        f"GET {path} HTTP/1.1\r\nHost: localhost\r\nAccept: application/x-hdf5\r\n\r\n".encode()
                    )
                    refused += b" 503 " in connection.recv(12)
                    held.append(connection)
                largest = 400_000 + max_file(process.pid)
                assert open_bytes(process.pid, tmp_path / "data" / "downloads") <= largest
                assert refused
                for connection in held:
                    connection.close()
                deadline = time.monotonic() + 30.0
                while (answer := client.get(jobs[-1]["links"]["results"], headers=HDF5)).status_code == 503:
                    assert answer.json()["type"] == "urn:ricochet:problem:downloads-full"
                    assert int(answer.headers["Retry-After"]) > 0
                    assert time.monotonic() < deadline
                    time.sleep(0.2)
                assert answer.status_code == 200
        finally:
            process.terminate()
            process.wait(30.0)


def wait_for(client: httpx.Client) -> None:
    deadline = time.monotonic() + 120.0
    while True:
        try:
            client.get("/readyz").raise_for_status()
        except httpx.HTTPError:
            assert time.monotonic() < deadline
            time.sleep(0.2)
        else:
            return


def files_of(pid: int) -> dict[int, tuple[str, int]]:
    """Files that a process has open, by their numbers: path and size."""
    found = {}
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            status = link.stat()
            found[status.st_ino] = (str(link.readlink()), status.st_size)
        except OSError:
            continue
    return found


def open_bytes(pid: int, folder: Path) -> int:
    return sum(size for path, size in files_of(pid).values() if path.startswith(str(folder)))


def max_file(pid: int) -> int:
    return max((size for path, size in files_of(pid).values() if "/downloads/" in path), default=0)


def test_results_that_were_evicted_count_as_work_of_who_reads_them(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    key_in(folder, "anna")
    token = key_in(folder, "bert", cases_per_hour=5)
    with service_in(folder, access="keys") as client:
        client.headers = httpx.Headers(bearer(token))
        job = job_in(client)
    shutil.rmtree(folder / "results" / "segments")
    assert statistics(folder).cases
    results = job["links"]["results"]
    with service_in(folder, access="keys") as client:
        client.headers = httpx.Headers(bearer(token))
        for form in ("application/x-hdf5", "application/vnd.apache.parquet"):
            answer = client.get(results, headers={"Accept": form})
            assert (answer.status_code, answer.json()["type"]) == (429, "urn:ricochet:problem:quota")
        lines = client.get(results, headers={"Accept": "application/jsonl"}).text.splitlines()
        assert len(lines) == 5
        assert all("urn:ricochet:problem:quota" in line for line in lines)
    with service_in(folder) as client:
        lines = client.get(results, headers={"Accept": "application/jsonl"}).text.splitlines()
        assert all('"result"' in line for line in lines)


def test_jobs_are_kept_by_the_date_and_not_by_what_has_passed(tmp_path: Path) -> None:
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
