"""Commands do not depend on the working folder, nor on the path of the temporary folder."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from service.schemas.strike import PAPER, PAPER_AT_45
from tests.cli.commands import LIMIT_S, STRIKE_TOML
from tests.faults.server import RICOCHET, RestartableServer

MODULES = ("http", "json", "numpy", "secrets", "service", "socket", "solver", "struct")
CASES = 10
"""Number of cases of a sweep; they are computed by workers, because a data folder is set."""


@pytest.fixture
def folder_with_modules(tmp_path: Path) -> Path:
    """Folder with modules named like modules of Python and of this project; each creates a file when it is imported."""
    folder = tmp_path / "work"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / f'{name} has run')!r}, 'w')\nraise RuntimeError\n")
    return folder


def imported(folder: Path) -> list[str]:
    """Return the names of the files that imported modules have created."""
    return [path.name for path in folder.parent.glob("* has run")]


def environment(**settings: str) -> dict[str, str]:
    """Return the environment without variables that change where Python finds modules."""
    given = os.environ | {"NO_PROXY": "*"} | settings
    return {name: value for name, value in given.items() if name not in {"PYTHONPATH", "PYTHONSAFEPATH"}}


def sweep(folder: Path, **settings: str) -> list[float]:
    """Run a sweep in this folder; return the velocities that were computed."""
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


def test_sweep_runs_no_module_of_the_working_folder_and_accepts_a_long_temporary_path(
    folder_with_modules: Path, tmp_path: Path
) -> None:
    temporary = tmp_path / ("long" * 40)
    temporary.mkdir()
    assert len(sweep(folder_with_modules, TMPDIR=str(temporary))) == CASES
    assert imported(folder_with_modules) == []


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
def test_service_runs_no_module_of_its_working_folder_and_survives_its_deletion(
    folder_with_modules: Path, tmp_path: Path
) -> None:
    with RestartableServer(tmp_path, cwd=folder_with_modules) as server:
        server.environment = environment(**server.environment)
        server.start()
        assert server.client.post("/formulas", json=PAPER_AT_45).is_success
        assert imported(folder_with_modules) == []
        shutil.rmtree(folder_with_modules)
        before = server.workers()
        assert len(before) == 2
        for worker in before:
            os.kill(worker, signal.SIGKILL)
        assert server.client.post("/cra", json=PAPER).is_success
        assert not set(before) & set(server.workers())
        server.stop()
        assert server.logged_errors() == []
