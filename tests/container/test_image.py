"""The steps of the Dockerfile are run in a new root folder, and the resulting image is started.

The tests need root, debootstrap and the package index, and are skipped without them. CLEAN_ROOT names an existing
Debian root folder, which is copied instead of a new one.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.schemas.strike import PAPER
from tests.conftest import STOP_LIMIT_S, Service, free_port, wait_until_ready

from .clean_root import RELEASES, WHEELS, Container, build, skip_unless_possible
from .dockerfile import ROOT, read

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
STAGES = read()
ENTRY_POINT = STAGES[-1].last("ENTRYPOINT").command()


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder with the wheels that the Dockerfile installs, downloaded for the image's Python with the locked hashes."""
    folder = tmp_path_factory.mktemp("wheels")
    _, version = RELEASES[STAGES[0].tag]
    command = ["download", "--quiet", "--require-hashes", "--only-binary", ":all:", "--python-version", version]
    for lock in ("build.txt", "run.txt"):
        words = [sys.executable, "-m", "pip", *command, "--requirement", str(ROOT / "requirements" / lock)]
        done = subprocess.run([*words, "--dest", str(folder)], capture_output=True, text=True, check=False)
        if done.returncode:
            assert "DO NOT MATCH" not in done.stderr
            pytest.skip(f"no index gives the packages: {done.stderr.strip().splitlines()[-1]}")
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Iterator[Container]:
    skip_unless_possible()
    folder = tmp_path_factory.mktemp("image")
    try:
        yield build(STAGES, folder, wheels)
    finally:
        shutil.rmtree(folder)  # It takes some gigabytes.


@contextmanager
def started(image: Container, log: Path) -> Iterator[tuple[str, int]]:
    """Run the command of the image with the image's environment variables on a free port, and stop it afterwards.

    Yields the address of the service and its process id.
    """
    settings = {"RICOCHET_HOST": "127.0.0.1", "RICOCHET_PORT": str(free_port()), "RICOCHET_WORKERS": "2"}
    command, environment = image.entered([*ENTRY_POINT, *STAGES[-1].last("CMD").command()], **settings)
    with log.open("wb") as output, subprocess.Popen(command, env=environment, stderr=output) as process:
        url = f"http://127.0.0.1:{settings['RICOCHET_PORT']}"
        try:
            wait_until_ready(Service(url, process))
            [service] = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
            yield url, int(service)
            os.kill(int(service), signal.SIGTERM)
            assert process.wait(STOP_LIMIT_S) == 0, log.read_text()
        finally:
            process.kill()


def test_image_runs_as_its_own_user_keeps_results_and_stops_cleanly(image: Container, tmp_path: Path) -> None:
    with started(image, tmp_path / "log") as (url, process):
        answer = httpx.post(f"{url}/cra", json=PAPER, timeout=60.0, trust_env=False)
        assert answer.json()["critical_angle_deg"] == pytest.approx(48.63, abs=0.02)
        assert "not_cached" not in answer.text
        [user] = re.findall(r"(?m)^Uid:\t(\d+)", Path(f"/proc/{process}/status").read_text())
        assert user == STAGES[-1].last("USER").text
        check = image.run(STAGES[-1].last("HEALTHCHECK").command(), RICOCHET_PORT=url.rpartition(":")[2])
        assert check == ""
    assert list(image.inside("/data/results/segments").rglob("*.h5"))
    assert "Traceback" not in (tmp_path / "log").read_text()


def test_only_the_service_and_its_locked_packages_are_installed(image: Container) -> None:
    listed = set(re.findall(r"(?m)^([\w.-]+)==(\S+)$", image.run(["python", "-m", "pip", "list", "--format=freeze"])))
    locked = set(re.findall(r"(?m)^([\w.-]+)==(\S+)", (ROOT / "requirements" / "run.txt").read_text()))
    names = {re.sub(r"[-_.]+", "-", name).lower() for name, _ in listed} - {"pip", "concrete-ricochet"}
    assert names <= {name for name, _ in locked}
    assert {(re.sub(r"[-_.]+", "-", name).lower(), version) for name, version in listed} >= {
        (name, version) for name, version in locked if name not in {"colorama", "tzdata", "win32-setctime"}
    }
    for path in ("/src", WHEELS, "/opt/ricochet/bin/pytest", "/opt/ricochet/bin/hatchling"):
        assert not image.inside(path).exists()


def test_solver_was_compiled_when_the_image_was_made(image: Container) -> None:
    assert list(image.inside(image.environment["NUMBA_CACHE_DIR"]).rglob("*.nbc"))
    image.run([*ENTRY_POINT, "python", "-c", "import solver; solver.warm_up()"])
    assert not list(image.inside(image.environment["XDG_CACHE_HOME"]).rglob("*.nbc"))


def test_traces_without_the_extra_are_refused_with_a_hint(image: Container) -> None:
    command, environment = image.entered(["ricochet", "serve"], RICOCHET_TELEMETRY="true")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "the extra telemetry" in done.stderr
