"""Ctrl-C in a terminal, which signals every process of a command, gives one line and status 130 at any time."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.commands import LIMIT_S, case_at, environment, write_cases
from tests.conftest import until

TESTS_CSV = "velocity_m_s,depth_m\n238.1,0.30\n275.7,0.38\n314.0,0.45\n369.5,0.53\n"
SWEEP = "sweep strike.toml --axis impact.velocity_m_s=200:300:20000"
BATCH = "batch cases.jsonl"
POOLS = (SWEEP, BATCH, f"{SWEEP} --data-dir kept -o out.csv", f"{BATCH} -o out.jsonl")
SINGLE = (
    "trajectory strike.toml --angle 45 --plot out.svg",
    "cra strike.toml -v",
    "uncertainty strike.toml --next-shot",
    "thickness strike.toml --angle 0",
    "limit-speed strike.toml --angle 0 --thickness 0.2",
    "report strike.toml",
    "calibrate depth tests.csv --case strike.toml",
)
LOADED = "_multiarray_umath"
"""Shared library of numpy; a process that has mapped it has begun to import the solver."""


def loads_the_solver(process: int) -> bool:
    return LOADED in Path(f"/proc/{process}/maps").read_text()


def children_of(process: int) -> list[int]:
    tasks = Path(f"/proc/{process}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def has_children(process: int) -> bool:
    return bool(children_of(process))


def has_workers(process: int) -> bool:
    """Return whether a worker pool has started, i.e. a child of the command has children."""
    return any(map(has_children, children_of(process)))


@pytest.fixture
def pressed(folder: Path) -> Iterator[Callable[..., tuple[int, list[str]]]]:
    """Return a function that starts a command as a shell does, and sends SIGINT once a condition holds."""
    write_cases(folder / "cases.jsonl", *(case_at(200.0 + 0.01 * number) for number in range(5000)))
    (folder / "tests.csv").write_text(TESTS_CSV)
    started: list[subprocess.Popen[str]] = []

    def press(words: str, claim: Callable[[int], bool]) -> tuple[int, list[str]]:
        with (folder / "err").open("w") as err:
            process = subprocess.Popen(
                # Warnings are not errors here, so that stderr is what a user sees.
                [sys.executable, "-m", "service.cli", *words.split()],
                cwd=folder,
                env=environment(),
                stdout=subprocess.DEVNULL,
                stderr=err,
                text=True,
                start_new_session=True,
            )
        started.append(process)
        until(lambda: process.poll() is not None or claim(process.pid))
        assert process.poll() is None, (folder / "err").read_text()
        os.killpg(process.pid, signal.SIGINT)
        return process.wait(LIMIT_S), (folder / "err").read_text().splitlines()

    yield press
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="/proc says what a process is at")
@pytest.mark.parametrize(
    ("words", "claim"),
    [
        *((words, loads_the_solver) for words in SINGLE),
        *((words, has_children) for words in POOLS),
        *((words, has_workers) for words in POOLS[:2]),
    ],
)
def test_ctrl_c_prints_one_line(
    folder: Path, pressed: Callable[..., tuple[int, list[str]]], words: str, claim: Callable[[int], bool]
) -> None:
    before = {path.name for path in folder.iterdir()} | {"kept", "err"}
    status, lines = pressed(words, claim)
    assert (status, lines[-1:]) == (130, ["interrupted"]), lines
    assert not {path.name for path in folder.iterdir()} - before
    assert all("Traceback" not in line and "ignored" not in line for line in lines), lines


def test_ctrl_c_with_a_service_prints_one_line_and_how_to_continue(
    live_url: str, pressed: Callable[..., tuple[int, list[str]]], folder: Path
) -> None:
    """A query is abandoned by the service, a job continues, and the command says how to get its results."""

    def answers(process: int) -> bool:
        return "_ssl" in Path(f"/proc/{process}/maps").read_text()

    def has_rows(_: int) -> bool:
        return any(path.stat().st_size for path in folder.glob("out.partial*"))

    status, lines = pressed(f"report strike.toml --url {live_url}", answers)
    assert (status, lines) == (130, ["interrupted"])
    status, lines = pressed(f"{BATCH} --url {live_url} -o out.csv", has_rows)
    assert (status, lines[-1]) == (130, "interrupted")
    [said] = [line for line in lines if line.startswith("the job continues")]
    assert "to stop it: ricochet jobs cancel " in said
    assert "Traceback" not in str(lines)
