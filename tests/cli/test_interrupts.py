"""Ctrl-C during a command that computes on this machine, and settings of numba that it cannot compute with."""

import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.cli.commands import COMMAND, LIMIT_S, environment, run_process

LONG = '\n[numerics]\nmethod = "panels"\npanels = 90000\ntime_step_s = 1e-7\ntermination_time_s = 0.019\n'
"""Takes many minutes for each trajectory."""


@pytest.mark.parametrize("command", ["cra", "trajectory", "thickness", "uncertainty"])
def test_command_that_computes_for_long_can_be_interrupted(folder: Path, command: str) -> None:
    strike = folder / "strike.toml"
    strike.write_text(
        strike.read_text() + "oblique_angle_deg = 45.0\n" * (command in {"trajectory", "thickness"}) + LONG
    )
    process = subprocess.Popen(
        [*COMMAND, command, "strike.toml"], cwd=folder, env=environment(), stderr=subprocess.PIPE, text=True
    )
    time.sleep(8.0)
    assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, errors.splitlines()[-1]) == (130, "interrupted")
    assert "Traceback" not in errors


def test_settings_that_numba_cannot_work_with_are_named_in_one_sentence(folder: Path) -> None:
    (folder / ".numba_config.yaml").write_text("opt: [")
    ended = run_process(folder, "cra", "strike.toml")
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith("ricochet cra: numba cannot be used with the settings found (.numba_config.yaml in")
    assert len(ended.err.splitlines()) == 1
