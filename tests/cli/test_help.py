"""`--help` of the commands in `LIGHT` avoids slow imports, and the examples of most commands work."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from service import cli
from service.cache.cache import ResultCache
from service.cli.arguments import MANY
from service.operations import OPERATIONS
from solver import ENGINE_VERSION
from tests.cli.commands import ROOT, case_at, run, write_cases

ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
HEAVY = {
    "numpy",
    "scipy",
    "numba",
    "h5py",
    "pydantic",
    "fastapi",
    "starlette",
    "uvicorn",
    "httpx",
    "rich",
    "matplotlib",
}
LIGHT = [command.name for command in cli.COMMANDS if command.name not in {"uncertainty", "mcp", "calibrate"}]
"""Commands whose help must not import any of the libraries in `HEAVY`."""
ACTIONS = {
    "cache": ("stat", "verify", "rebuild", "evict"),
    "keys": ("add", "list", "revoke"),
    "jobs": ("list", "show", "results", "cancel", "delete"),
    "calibrate": ("depth", "motion", "obliquity"),
}
ALL = [(command.name,) for command in cli.COMMANDS] + [
    (name, action) for name, actions in ACTIONS.items() for action in actions
]
SINGLE = {"trajectory", "cra", "formulas", "thickness", "limit-speed", "flight"}
LOCAL = [
    words for words in ALL if words[0] in SINGLE | {"calibrate", "cache", "completion", "init", "openapi", "version"}
]
SERVED = [words for words in ALL if words[0] in {"batch", "sweep", "jobs"}]
"""Command words whose examples are run with a service."""
NOT_RUN = {
    "report": "takes long; tests/reports runs it",
    "uncertainty": "takes long; tests/cli/test_uncertainty.py runs other examples",
    "serve": "runs until it is stopped; a fixture starts it",
    "mcp": "runs until it is stopped; tests/api/test_mcp.py starts it",
    "keys": "needs a data folder with a key; tests/api/test_auth.py runs it",
    "help": "ends the process, as --help does",
}
"""Commands whose examples are not run here, with the reason."""
TESTS_CSV = "velocity_m_s,depth_m\n238.1,0.30\n275.7,0.38\n314.0,0.45\n369.5,0.53\n"
POINTS_CSV = "oblique_angle_deg,strength_factor\n0,8.52\n15,8.25\n30,7.91\n45,6.48\n"


def test_operations_of_batches_are_those_with_routes_for_them() -> None:
    """The list `MANY` is written out, because the table of operations is slow to import."""
    assert set(MANY) == {name for name, operation in OPERATIONS.items() if operation.many is not None}


def help_of(*words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        cli.main([*words, "--help"])
    assert ended.value.code == 0
    return ESCAPES.sub("", capsys.readouterr().out)


def examples_of(text: str) -> list[list[str]]:
    """Return the examples in a help text as words, without `ricochet` and without shell syntax."""
    _, _, end = text.rpartition("example")
    lines = [line for line in end.splitlines() if "ricochet " in line]
    return [shlex.split(line.partition(" > ")[0])[1:] for line in lines if line.startswith("  ricochet ")]


def test_help_does_not_import_the_libraries_of_the_solver() -> None:
    """One process prints each help and, after it, the heavy libraries that are loaded by then."""
    program = f"""
import sys
from service.cli import main
for words in {[[], *([name] for name in LIGHT)]}:
    try:
        main([*words, "--help"])
    except SystemExit:
        print(*words, *({HEAVY} & sys.modules.keys()), file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.count("usage: ricochet") == 1 + len(LIGHT)
    assert done.stderr.splitlines() == ["", *LIGHT]


@pytest.mark.parametrize("words", ALL, ids=" ".join)
def test_help_ends_with_an_example_of_the_command(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    text = help_of(*words, capsys=capsys)
    assert f"ricochet {' '.join(words)}" in text[text.rindex("example") :]


def test_examples_of_every_command_are_run_or_listed_as_not_run() -> None:
    run_here = {words[0] for words in (*LOCAL, *SERVED)}
    assert run_here | NOT_RUN.keys() == {command.name for command in cli.COMMANDS}
    assert not run_here & NOT_RUN.keys()


@pytest.mark.parametrize("words", LOCAL, ids=" ".join)
def test_examples_of_the_help_work(words: tuple[str, ...], here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "tests.csv").write_text(TESTS_CSV)
    (here / "points.csv").write_text(POINTS_CSV)
    with ResultCache(here / "data", memory_bytes=0, disk_bytes=10**9):
        pass  # This makes the data folder of a service without results.
    if words == ("calibrate", "motion"):
        assert cli.main(["trajectory", "strike.toml", "--angle", "30", "--csv"]) == 0
        (here / "history.csv").write_text(motion_since_contact(capsys.readouterr().out))
        (here / "runs.csv").write_text("file,oblique_angle_deg\nhistory.csv,30\n")
    if words == ("init",):
        (here / "strike.toml").unlink()
    examples = examples_of(help_of(*words, capsys=capsys))
    assert examples
    for example in examples:
        assert cli.main(example) == 0, example
        assert capsys.readouterr().out or (here / "openapi" / "openapi.json").exists()


@pytest.mark.parametrize("words", SERVED, ids=" ".join)
def test_examples_of_the_help_work_with_a_service(
    words: tuple[str, ...], served: Path, live_url: str, client: httpx.Client, capsys: pytest.CaptureFixture[str]
) -> None:
    write_cases(served / "cases.jsonl", case_at(238.0), case_at(240.0, custom_id="faster"))
    (served / "cases.csv").write_text("velocity_m_s\n238\n240\n")
    examples = examples_of(help_of(*words, capsys=capsys))
    assert examples
    for example in examples:
        body, prefer = {"cases": [case_at(238.0)]}, {"Prefer": "respond-async"}
        job = client.post("/cra/batch", json=body, headers=prefer).json()
        given = {"ID": job["id"], "http://127.0.0.1:8000": live_url}
        assert cli.main([given.get(word, word) for word in example]) == 0, example
        assert capsys.readouterr().err == "" or "-o" in example


def motion_since_contact(table: str) -> str:
    """Convert the CSV of a trajectory into a history for calibration."""
    _, *rows = (line.split(",") for line in table.splitlines())
    first = float(rows[0][1])
    lines = [f"{row[0]},{float(row[1]) - first},{row[2]}\n" for row in rows[::20]]
    return "time_s,depth_displacement_m,lateral_displacement_m\n" + "".join(lines)


def test_exit_statuses_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    text = help_of(capsys=capsys)
    assert re.findall(r"^  (\d+)  ", text, re.MULTILINE) == ["0", "1", "2", "3", "130"]


def test_version_names_the_engine_in_one_line(folder: Path) -> None:
    done = run(folder, "version")
    assert (done.status, done.out.count("\n"), done.err) == (0, 1, "")
    assert f"engine {ENGINE_VERSION}" in done.out


def test_every_command_is_listed_in_the_manual() -> None:
    text = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?`) \| .* \| `.*?ricochet ([\w-]+)", text, re.MULTILINE)
    named = {name for names, _ in rows for name in re.findall(r"`([\w-]+)`", names)}
    assert {command.name for command in cli.COMMANDS} == named
    assert all(example in names for names, example in rows)
