"""File systems that reject new files, shared memory maps or changes of permissions although they have free space."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import httpx
import pytest

from service.schemas.strike import PAPER
from tests.conftest import ROOT, free_port, until

pytestmark = [pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD"), pytest.mark.timeout(300)]

CASES = [PAPER | {"impact": {"velocity_m_s": 200.0 + number, "oblique_angle_deg": 55.0}} for number in range(120)]
Start = Callable[[str], AbstractContextManager[httpx.Client]]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("library") / "refusals.so"
    source = Path(__file__).with_name("refusals.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(made), str(source), "-ldl"], check=True)  # noqa: S607
    return made


@pytest.fixture
def environment(library: Path, tmp_path: Path) -> dict[str, str]:
    """Environment that preloads a library in which calls fail; the variable `REFUSED` selects the calls."""
    return os.environ | {
        "LD_PRELOAD": str(library),
        "REFUSED_BELOW": str(tmp_path / "data"),
        "REFUSED_WHEN": str(tmp_path / "full"),
        "RICOCHET_DATA_DIR": str(tmp_path / "data"),
        "RICOCHET_EXECUTOR": "in-process",
        "RICOCHET_ACCESS": "open",
    }


@pytest.fixture
def start(environment: dict[str, str], tmp_path: Path) -> Start:
    """Function that runs a service for which calls of a kind fail; its log is the file `log`."""

    @contextmanager
    def run(refused: str) -> Iterator[httpx.Client]:
        port = free_port()
        variables = environment | {"REFUSED": refused, "RICOCHET_PORT": str(port)}
        command = [sys.executable, "-m", "service.cli", "serve"]
        with (
            (tmp_path / "log").open("ab") as log,
            subprocess.Popen(command, cwd=ROOT, env=variables, stdout=log, stderr=log) as process,
            httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as client,
        ):
            try:
                until(lambda: is_up(client))
                yield client
            finally:
                process.terminate()
                process.wait(30.0)

    return run


def is_up(client: httpx.Client) -> bool:
    try:
        return client.get("/livez").is_success
    except httpx.TransportError:
        return False


def test_job_whose_results_cannot_be_stored_fails(start: Start, tmp_path: Path) -> None:
    """Without free inodes the existing database of jobs can be written, but no file of results can be created."""
    with start("inodes") as client:
        (tmp_path / "full").touch()
        job = client.post("/trajectory/batch", json={"cases": CASES}).raise_for_status().json()
        until(lambda: client.get(job["links"]["self"]).json()["status"] not in {"accepted", "running"})
        ended = client.get(job["links"]["self"]).json()
        assert ended["status"] == "failed", ended
        assert ended["problem"]["status"] == 507
        assert "No space left on device" in ended["problem"]["detail"]
        (tmp_path / "full").unlink()
        again = client.post("/trajectory/batch", json={"cases": CASES}).raise_for_status().json()
        until(lambda: client.get(again["links"]["self"]).json()["status"] == "successful")


def test_file_system_without_shared_maps_is_not_reported_as_a_full_disk(start: Start, tmp_path: Path) -> None:
    with start("maps") as client:
        assert client.post("/trajectory", json=CASES[0]).is_success
        refused = client.post("/trajectory/batch", json={"cases": CASES})
        assert (refused.status_code, refused.json()["type"]) == (507, "urn:ricochet:problem:unsuitable-folder")
        ready = client.get("/readyz")
        assert ready.status_code == 503
        for text in (refused.json()["detail"], ready.json()["detail"], (tmp_path / "log").read_text()):
            assert "cannot share files in memory" in text
            assert "full" not in text


def test_keys_that_stay_readable_by_others_are_reported(
    environment: dict[str, str], start: Start, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "service.cli", "keys", "add", "--owner", "anna"]
    subprocess.run(command, check=True, cwd=ROOT, env=environment | {"REFUSED": "permissions"}, capture_output=True)
    with start("permissions"):
        log = (tmp_path / "log").read_text()
    assert "auth.sqlite can be read by other users" in log
