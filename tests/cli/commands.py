"""Helpers that run the `ricochet` command, in this process or in a separate one, and write its input files."""

import io
import json
import os
import pty
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from service import cli
from service.schemas.strike import PAPER

ROOT = Path(__file__).parents[2]
COMMAND = (sys.executable, "-W", "error", "-m", "service.cli")
LIMIT_S = 120.0
STRIKE_TOML = """
[projectile]
diameter_m = 0.08
length_m = 0.53
mass_kg = 13.0
nose = { shape = "ogive", caliber_radius_head = 3.0 }

[target]
compressive_strength_pa = 39e6
density_kg_m3 = 2250.0

[impact]
velocity_m_s = 238.0
"""
SETTINGS = ("RICOCHET_URL", "RICOCHET_DATA_DIR", "RICOCHET_API_KEY", "NO_COLOR", "FORCE_COLOR", "COLUMNS")
"""Environment variables that are removed unless a test sets them."""


@dataclass(frozen=True)
class Ended:
    """Output and exit status of a command."""

    status: int
    out: str
    err: str


def environment(**settings: str) -> dict[str, str]:
    """Return the environment for a command: without the variables in `SETTINGS`, with the sources in PYTHONPATH."""
    kept = {name: value for name, value in os.environ.items() if name not in SETTINGS}
    return kept | {"PYTHONPATH": str(ROOT), "NO_PROXY": "*"} | settings


def run(folder: Path, *arguments: str, stdin: str = "", encoding: str = "utf-8", **settings: str) -> Ended:
    """Run the command in this folder and this process; its streams are not terminals.

    A separate process would first import the solver, which takes longer than most commands.
    """
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding) for _ in range(2))
    with pytest.MonkeyPatch.context() as changed:
        changed.chdir(folder)
        for name in SETTINGS:
            changed.delenv(name, raising=False)
        for name, value in ({"NO_PROXY": "*"} | settings).items():
            changed.setenv(name, value)
        changed.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode()), "utf-8"))
        changed.setattr(sys, "stdout", out)
        changed.setattr(sys, "stderr", err)
        try:
            status = cli.main(list(arguments))
        except SystemExit as ended:
            status = int(ended.code or 0)
        out.flush()
        err.flush()
    return Ended(status, *(stream.buffer.getvalue().decode(encoding) for stream in (out, err)))


def run_process(folder: Path, *arguments: str, **settings: str) -> Ended:
    """Run the command in this folder in a separate process, with pipes for its streams."""
    done = subprocess.run(
        [*COMMAND, *arguments],
        cwd=folder,
        env=environment(**settings),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def run_on_terminal(folder: Path, *arguments: str, **settings: str) -> Ended:
    """Run the command on a new terminal; `out` is everything that it prints."""
    ours, theirs = pty.openpty()
    settings = {"TERM": "xterm-256color", "COLUMNS": "160"} | settings
    with subprocess.Popen(
        [*COMMAND, *arguments], cwd=folder, env=environment(**settings), stdin=theirs, stdout=theirs, stderr=theirs
    ) as process:
        os.close(theirs)
        shown = b""
        try:
            while piece := os.read(ours, 65536):
                shown += piece
        except OSError:
            pass  # Linux reports in this way that no process has the terminal open.
        finally:
            os.close(ours)
        status = process.wait(LIMIT_S)
    return Ended(status, shown.decode(errors="replace"), "")


def case_at(velocity: float, **more: Any) -> dict[str, Any]:
    """Return the paper's strike at this velocity."""
    return PAPER | {"impact": {"velocity_m_s": velocity}} | more


def write_cases(path: Path, *cases: dict[str, Any]) -> None:
    path.write_text("".join(json.dumps(case) + "\n" for case in cases))
