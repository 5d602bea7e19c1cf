"""Output files: never an input file, never incomplete; an interrupted batch keeps its rows in another file."""

import argparse
import os
import signal
import stat
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from service import cli
from service.cli.parser import Parser
from tests.cli.commands import COMMAND, LIMIT_S, STRIKE_TOML, case_at, environment, run, write_cases
from tests.conftest import until
from tests.physics.strikes import known

COARSE = ("--set", "numerics.relative_tolerance=1e-3")
TESTS_CSV = "velocity_m_s,depth_m\n238.1,0.30\n275.7,0.38\n314.0,0.45\n369.5,0.53\n"
HISTORY_CSV = "time_s,depth_displacement_m\n0,0\n0.0005,0.1\n0.001,0.18\n0.002,0.29\n"
RUNS_CSV = "file,oblique_angle_deg\nhistory.csv,30\n"
SHOTS_CSV = "velocity_m_s,depth_m\n238.1,0.30\n"
FILES = {
    "strike.toml": STRIKE_TOML,
    "tests.csv": TESTS_CSV,
    "history.csv": HISTORY_CSV,
    "runs.csv": RUNS_CSV,
    "shots.csv": SHOTS_CSV,
    "cases.csv": "velocity_m_s\n238\n",
}


class Written(NamedTuple):
    """A command that writes a file: output name, command line up to the flag for it, and input files."""

    name: str
    words: str
    read: tuple[str, ...] = ("strike.toml",)


SWEEP = "sweep strike.toml --axis impact.velocity_m_s=200:300:3"
WRITTEN = (
    Written("out.json", "trajectory strike.toml --angle 45 -o"),
    Written("out.svg", "trajectory strike.toml --angle 45 --plot"),
    Written("out.csv", "cra strike.toml --shots shots.csv -o", ("strike.toml", "shots.csv")),
    Written("out.png", "cra strike.toml --plot"),
    Written("out.json", "uncertainty strike.toml --next-shot --set sampling.max_samples=512 -o"),
    Written("out.pdf", "uncertainty strike.toml --next-shot --set sampling.max_samples=512 --plot"),
    Written("out.csv", "formulas strike.toml --angle 0 -o"),
    Written("out.json", "thickness strike.toml --angle 0 -o"),
    Written("out.csv", "limit-speed strike.toml --angle 0 --thickness 0.2 -o"),
    Written("out.csv", "flight --speed 101.1 --elevation 19.18 --mass 13 --area 0.0321 -o", ()),
    Written("out.html", "report strike.toml -o"),
    Written("out.jsonl", "batch cases.csv --case strike.toml -o", ("cases.csv", "strike.toml")),
    Written("out.csv", f"{SWEEP} -o"),
    Written("out.svg", f"{SWEEP} --plot"),
    Written("out.csv", "calibrate depth tests.csv --case strike.toml --curves", ("tests.csv", "strike.toml")),
    Written(
        "out.csv",
        "calibrate motion history.csv --case strike.toml --oblique-angle 30 --histories",
        ("history.csv", "strike.toml"),
    ),
    Written(
        "out.csv",
        "calibrate motion --runs runs.csv --case strike.toml --histories",
        ("runs.csv", "strike.toml", "history.csv"),
    ),
    Written("out.jsonl", "jobs results 1 -o", ()),
    Written("out.toml", "init", ()),
    Written("out.csv", "init --table", ()),
)
"""Every command that writes a file, once for each flag or argument that names one."""
REPLACED = [each for each in WRITTEN if not each.words.startswith(("init", "jobs"))]
"""Commands that may replace an existing file, and need no service."""
REFUSED = ("--mass", "-1")
"""Arguments that make the input invalid."""


def output_id(each: Written) -> str:
    return each.words.replace("strike.toml ", "")


@pytest.fixture
def files(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def arguments_of(parser: Parser, words: tuple[str, ...]) -> Iterator[tuple[str, argparse.Action]]:
    """Yield every flag and argument of a command and of its subcommands, each with the command that it belongs to."""
    for action in parser._actions:
        yield " ".join(words), action
    for name, subparser in parser.subcommands.items():
        yield from arguments_of(subparser, (*words, name))


def test_list_of_written_files_is_complete() -> None:
    from service.cli.arguments import InputFile  # noqa: PLC0415 (the other tests run on versions without it)
    from service.cli.outputs import OutputFile  # noqa: PLC0415

    for command in cli.COMMANDS:
        parser = Parser(prog=command.name)
        cli.define(command, parser)
        for words, action in arguments_of(parser, (command.name,)):
            kind = getattr(action.type, "func", action.type)
            if kind is OutputFile:
                flags = action.option_strings or [command.name]
                written = [each.words.split() for each in WRITTEN if each.words.startswith(words)]
                assert {each[-1] for each in written} & set(flags), (words, flags)
            elif kind is not InputFile and not action.choices:
                metavar = str(action.metavar)
                assert not metavar.startswith(("FILE", "CASE", "TESTS", "RUNS", "POINTS", "HISTORY")) or (
                    metavar == "FILE.csv"
                ), (words, action)
                assert kind is not Path or metavar == "FOLDER", (words, action)


@pytest.mark.parametrize("way", ["itself", "symbolic", "hard"])
@pytest.mark.parametrize(
    ("each", "source"), [(each, source) for each in WRITTEN for source in each.read], ids=lambda value: str(value)[:60]
)
def test_input_file_is_never_overwritten(files: Path, each: Written, source: str, way: str) -> None:
    """The command is refused before it reads or computes anything, so the contents of the files do not matter."""
    target = files / each.name
    words = each.words
    if way == "itself":
        (files / source).rename(target)
        words = words.replace(source, each.name)
        if source == "history.csv" and "runs.csv" in each.read:
            (files / "runs.csv").write_text(RUNS_CSV.replace(source, each.name))
    elif way == "symbolic":
        target.symlink_to(files / source)
    else:
        target.hardlink_to(files / source)
    before = contents(files)
    done = run(files, *words.split(), each.name)
    assert done.status == 2, done.err
    assert f"{each.name}: is the file " in done.err
    assert "which is read too; name another file" in done.err
    assert contents(files) == before


def test_file_read_as_standard_input_is_never_overwritten(files: Path) -> None:
    write_cases(files / "cases.jsonl", case_at(238.0))
    before = contents(files)
    for words in (("batch", "-", "-o", "cases.jsonl"), ("cra", "-", "-o", "cases.jsonl", "--json")):
        with (files / "cases.jsonl").open() as stdin:
            done = subprocess.run(
                [*COMMAND, *words],
                cwd=files,
                env=environment(),
                stdin=stdin,
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                check=False,
            )
        assert done.returncode == 2, done.stderr
        assert contents(files) == before


def test_two_outputs_must_not_be_the_same_file(files: Path) -> None:
    before = contents(files)
    done = run(files, "cra", "strike.toml", "--json", "-o", "a.svg", "--plot", "./a.svg")
    assert (done.status, contents(files)) == (2, before)
    assert "which is written by --output too" in done.err


@pytest.mark.parametrize("each", REPLACED, ids=output_id)
def test_failed_command_leaves_the_folder_unchanged(files: Path, each: Written) -> None:
    (files / each.name).write_text("earlier")
    (files / each.name).chmod(0o640)
    before = contents(files)
    *words, flag = each.words.split()
    done = run(files, *words, *REFUSED, flag, each.name)
    assert (done.status, "--mass" in done.err) == (2, True), done.err
    assert contents(files) == before


@pytest.mark.parametrize("each", REPLACED, ids=output_id)
def test_output_follows_links_and_keeps_the_file_mode(
    files: Path, tmp_path_factory: pytest.TempPathFactory, each: Written
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    real = elsewhere / each.name
    real.write_text("earlier")
    real.chmod(0o640)
    number = real.stat().st_ino
    (files / each.name).symlink_to(real)
    done = run(files, *each.words.split(), each.name)
    assert done.status == 0, done.err
    assert (files / each.name).is_symlink()
    assert real.read_bytes() not in {b"earlier", b""}
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    assert [path.name for path in elsewhere.iterdir()] == [each.name]
    # A new inode: programs that have the earlier file open can still read all of it.
    assert real.stat().st_ino != number


@pytest.mark.parametrize("each", [each for each in REPLACED if not each.words.startswith("report")], ids=output_id)
def test_pipes_are_written_and_not_replaced(files: Path, each: Written) -> None:
    os.mkfifo(files / each.name)
    received: list[bytes] = []
    reader = threading.Thread(target=lambda: received.append((files / each.name).read_bytes()), daemon=True)
    reader.start()
    done = run(files, *each.words.split(), each.name)
    reader.join(LIMIT_S)
    assert done.status == 0, done.err
    assert received[0]
    assert stat.S_ISFIFO((files / each.name).stat().st_mode)


@pytest.mark.parametrize("words", ["-o /dev/null", "-o /dev/stdout", "-o -", "-o /dev/fd/1"])
@pytest.mark.parametrize("command", ["formulas strike.toml --angle 0 --csv", f"{SWEEP} --csv"])
def test_devices_and_streams_are_written_and_not_replaced(files: Path, command: str, words: str) -> None:
    """Devices are not replaced by a file, and output follows what the log already contains."""
    expected = run(files, *command.split()).out if "null" not in words else ""
    with (files / "log").open("w") as log:
        log.write("before\n")
        log.flush()
        done = subprocess.run(
            [*COMMAND, *command.split(), *words.split()],
            cwd=files,
            env=environment(),
            stdout=log,
            timeout=LIMIT_S,
            check=False,
        )
    assert done.returncode == 0
    assert (files / "log").read_text() == f"before\n{expected}"
    assert Path(os.devnull).is_char_device()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into any folder")
def test_writable_file_in_a_read_only_folder_is_written(files: Path) -> None:
    (files / "out.csv").write_text("earlier")
    files.chmod(0o500)
    try:
        assert run(files, "formulas", "strike.toml", "--angle", "0", "-o", "out.csv").status == 0
        assert (files / "out.csv").read_text() != "earlier"
    finally:
        files.chmod(0o700)


def test_init_overwrites_no_file(files: Path) -> None:
    (files / "link.toml").symlink_to(files / "missing.toml")
    before = sorted(path.name for path in files.iterdir())
    for name in ("strike.toml", "link.toml"):
        assert run(files, "init", name).status == 2
    assert sorted(path.name for path in files.iterdir()) == before
    assert (files / "strike.toml").read_text() == STRIKE_TOML


def test_replaced_contract_keeps_its_file_mode(files: Path) -> None:
    path = files / "openapi" / "openapi.json"
    path.parent.mkdir()
    path.write_text("earlier")
    path.chmod(0o640)
    number = path.stat().st_ino
    assert run(files, "openapi").status == 0
    assert (stat.S_IMODE(path.stat().st_mode), path.stat().st_ino == number) == (0o640, False)
    assert run(files, "openapi", "--check").status == 0


@pytest.mark.parametrize(("name", "ending"), [("out.csv", "signal"), ("out.jsonl", "terminated")])
def test_interrupted_batch_keeps_its_rows_in_another_file(files: Path, name: str, ending: str) -> None:
    """Neither an existing output file nor the rows kept from an earlier interruption are overwritten."""
    write_cases(files / "cases.jsonl", *(case_at(200.0 + 0.02 * number) for number in range(4000)))
    earlier = {name: "earlier", f"out.partial{Path(name).suffix}": "rows"}
    for each, text in earlier.items():
        (files / each).write_text(text)
    kept = files / f"out.partial-2{Path(name).suffix}"
    with (files / "err").open("w") as err:
        process = subprocess.Popen(
            [*COMMAND, "batch", "cases.jsonl", "-o", name],
            cwd=files,
            env=environment(),
            stderr=err,
            start_new_session=True,
        )
    try:
        until(lambda: process.poll() is not None or (kept.exists() and kept.stat().st_size > 0))
        assert process.poll() is None, (files / "err").read_text()
        if ending == "signal":
            os.killpg(process.pid, signal.SIGINT)
        else:
            process.terminate()
        assert process.wait(LIMIT_S) == (130 if ending == "signal" else 143)
    finally:
        process.kill()
        process.wait()
    lines = (files / "err").read_text().splitlines()
    assert "Traceback" not in str(lines)
    said = known(next((line for line in lines if line.endswith(f" rows in {kept.name}")), None))
    rows = len(kept.read_text().splitlines()) - (name == "out.csv")
    assert said.startswith(f"{rows} of 4000 rows in ")
    assert 0 < rows < 4000
    for each, text in earlier.items():
        assert (files / each).read_text() == text
