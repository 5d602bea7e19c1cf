"""Commands do not depend on the folder they are started in, nor on the path of the folder for temporary files."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.schemas.strike import PAPER, PAPER_AT_45
from tests.cli.commands import LIMIT_S, STRIKE_TOML
from tests.conftest import STOP_LIMIT_S, Service, free_port, wait_until_ready
from tests.faults.processes import workers_of

RICOCHET = Path(sys.executable).with_name("ricochet")
MODULES = ("http", "json", "numpy", "secrets", "service", "socket", "solver", "struct")
CASES = 10
"""Computed by workers, as the results are kept in a data folder."""


@pytest.fixture
def folder_with_modules(tmp_path: Path) -> Path:
    """A folder with modules of a user, which show that they have been imported, and raise."""
    folder = tmp_path / "work"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / f'{name} has run')!r}, 'w')\nraise RuntimeError\n")
    return folder


def imported(folder: Path) -> list[str]:
    """Modules of the user that have been imported."""
    return [path.name for path in folder.parent.glob("* has run")]


def environment(**settings: str) -> dict[str, str]:
    """The environment without what would lead Python to other modules, or keep it from those of the working folder."""
    kept = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "PYTHONSAFEPATH"}}
    return kept | {"NO_PROXY": "*"} | settings


def sweep(folder: Path, **settings: str) -> list[float]:
    """Run a sweep there; return the velocities that have been computed."""
    (folder / "strike.toml").write_text(STRIKE_TOML)
    axis = f"impact.velocity_m_s=200:240:{CASES}"
    done = subprocess.run(
        [RICOCHET, "sweep", "strike.toml", "--axis", axis, "--data-dir", "data"],
        cwd=folder,
        env=environment(**settings),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert all(line["result"]["status"] == "converged" for line in lines)
    return [line["point"]["impact.velocity_m_s"] for line in lines]


@contextmanager
def serving(folder: Path, data: Path) -> Iterator[Service]:
    """`ricochet serve`, started there."""
    port = free_port()
    settings = environment(RICOCHET_PORT=str(port), RICOCHET_DATA_DIR=str(data), RICOCHET_WORKERS="2")
    with (
        (data.parent / "log").open("wb") as log,
        subprocess.Popen([RICOCHET, "serve"], cwd=folder, env=settings, stdout=log, stderr=log) as process,
    ):
        service = Service(f"http://127.0.0.1:{port}", process)
        try:
            wait_until_ready(service)
            yield service
        finally:
            process.terminate()
            status = process.wait(STOP_LIMIT_S)
    assert status == 0
    assert "Traceback" not in (data.parent / "log").read_text()


def test_sweep_runs_no_module_of_the_working_folder_and_takes_a_long_path_for_temporary_files(
    folder_with_modules: Path, tmp_path: Path
) -> None:
    temporary = tmp_path / ("long" * 40)
    temporary.mkdir()
    assert len(sweep(folder_with_modules, TMPDIR=str(temporary))) == CASES
    assert imported(folder_with_modules) == []


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
def test_service_runs_no_module_of_its_working_folder_and_replaces_workers_after_that_was_deleted(
    folder_with_modules: Path, tmp_path: Path
) -> None:
    data = tmp_path / "data"
    with serving(folder_with_modules, data) as service:
        assert httpx.post(f"{service.url}/formulas", json=PAPER_AT_45, timeout=60.0, trust_env=False).is_success
        assert imported(folder_with_modules) == []
        shutil.rmtree(folder_with_modules)
        before = workers_of(data, service.process.pid)
        assert len(before) == 2
        for worker in before:
            os.kill(worker, signal.SIGKILL)
        assert httpx.post(f"{service.url}/cra", json=PAPER, timeout=60.0, trust_env=False).is_success
        assert not set(before) & set(workers_of(data, service.process.pid))
