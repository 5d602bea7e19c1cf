"""Interpretation of words, numbers and files on the command line, and the format of an answer."""

import json
from pathlib import Path

import pytest

from service import cli

AXIS = ["--axis", "impact.velocity_m_s=230,240"]
COMMANDS = {
    "cra": ["cra", "strike.toml"],
    "trajectory": ["trajectory", "strike.toml", "--angle", "45"],
    "formulas": ["formulas", "strike.toml"],
    "thickness": ["thickness", "strike.toml", "--angle", "20", "--set", "numerics.relative_tolerance=1e-3"],
    "sweep": ["sweep", "strike.toml", *AXIS],
}


def begins_as(kind: str, content: bytes) -> bool:
    """Return whether the content of a file begins as its format requires."""
    if kind == "parquet":
        return content.startswith(b"PAR1")
    if kind == "xlsx":
        return content.startswith(b"PK")
    first = content.splitlines()[0]
    return isinstance(json.loads(first), dict) if kind == "json" else b"," in first and b"{" not in first


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("name", "flags", "kind"),
    [
        ("out.json", [], "json"),
        ("out.jsonl", [], "json"),
        ("out.csv", [], "csv"),
        ("OUT.CSV", [], "csv"),
        ("out.parquet", [], "parquet"),
        ("out.xlsx", [], "xlsx"),
        ("out", [], None),
        ("out.xlsx", ["--json"], "json"),
        ("out.txt", ["--csv"], "csv"),
    ],
)
def test_format_of_a_file_follows_its_name_or_a_flag(
    here: Path, capsys: pytest.CaptureFixture[str], command: str, name: str, flags: list[str], kind: str | None
) -> None:
    known = (".jsonl", ".ndjson", ".csv", ".parquet", ".xlsx") if command == "sweep" else (".json", ".csv")
    refused = not flags and Path(name).suffix.lower() not in known
    kind = None if refused else kind
    assert cli.main([*COMMANDS[command], "-o", name, *flags]) == (2 if refused else 0)
    printed = capsys.readouterr()
    assert printed.out == ""
    if refused:
        assert printed.err.startswith(f"ricochet {command}: --output {name}: must end in .json")
        assert not (here / name).exists()
        return
    assert kind
    content = (here / name).read_bytes()
    if command == "sweep" and kind == "csv":
        content = content.partition(b"\n")[2]  # The first line is a comment.
    assert begins_as(kind, content)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["report", "strike.toml", "-o", "report.docx"], "--output report.docx: must end in .html or .pdf"),
        (["cra", "strike.toml", "--plot", "a.gif"], "--plot a.gif: must end in .png, .svg or .pdf"),
        (["calibrate", "depth", "t.csv", "--curves", "a.xlsx"], "--curves a.xlsx: must end in .csv"),
        (["calibrate", "motion", "t.csv", "--histories", "a"], "--histories a: must end in .csv"),
        (["init", "strike.yaml"], "FILE strike.yaml: must end in .toml"),
        (["cra", "strike.toml", "-o", "missing/a.json"], "--output missing/a.json: the folder does not exist"),
    ],
)
def test_name_without_a_known_format_is_refused_before_the_computation(
    here: Path, capsys: pytest.CaptureFixture[str], words: list[str], reason: str
) -> None:
    assert cli.main(words) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize("flag", ["--json", "--csv"])
@pytest.mark.parametrize("command", ["cra", "trajectory", "formulas", "thickness"])
def test_file_contains_what_would_be_printed(
    here: Path, capsys: pytest.CaptureFixture[str], command: str, flag: str
) -> None:
    assert cli.main([*COMMANDS[command], flag]) == 0
    printed = capsys.readouterr().out
    assert cli.main([*COMMANDS[command], "-o", f"out.{flag.strip('-')}"]) == 0
    assert (here / f"out.{flag.strip('-')}").read_text() == printed


def test_refused_request_does_not_touch_an_existing_file(here: Path) -> None:
    (here / "out.csv").write_text("earlier")
    for command in ("cra", "sweep"):
        assert cli.main([*COMMANDS[command], "--mass", "-1", "-o", "out.csv"]) == 2
        assert (here / "out.csv").read_text() == "earlier"


@pytest.mark.parametrize(
    ("words", "command", "wrong"),
    [
        ("crra", "ricochet", "crra: unknown command; expected init, trajectory, ... did you mean cra?"),
        ("cra strike.toml --velocty 3", "ricochet cra", "--velocty: unknown flag; did you mean --velocity?"),
        ("cra strike.toml --velocty=3", "ricochet cra", "--velocty: unknown flag; did you mean --velocity?"),
        ("cra strike.toml --speed 3", "ricochet cra", "--speed: unknown flag; did you mean --velocity?"),
        (
            "cra --strength 3",
            "ricochet cra",
            "--strength: unknown flag; did you mean --compressive-strength?",
        ),
        ("cra strike.toml --calibre 3", "ricochet cra", "--calibre: unknown flag; did you mean --diameter?"),
        ("formulas --crh 3", "ricochet formulas", "--crh: unknown flag; did you mean --caliber-radius-head?"),
        (
            "cra --nose ogiv",
            "ricochet cra",
            "--nose: unknown value 'ogiv'; expected ogive, ... did you mean ogive?",
        ),
        ("cra --out x", "ricochet cra", "--out: unknown flag; did you mean --output?"),
        ("cra --unit mm", "ricochet cra", "--unit: unknown flag"),
        ("serve --prt 3", "ricochet serve", "--prt: unknown flag; did you mean --port?"),
        ("calibrate dept", "ricochet calibrate", "dept: unknown kind; expected depth, ... did you mean depth?"),
        (
            "calibrate motion --vlocity 3",
            "ricochet calibrate motion",
            "--vlocity: unknown ... mean --velocity?",
        ),
        ("jobs lst", "ricochet jobs", "lst: unknown action; expected list, ... did you mean list?"),
        ("jobs list --jsn", "ricochet jobs list", "--jsn: unknown flag; did you mean --json?"),
        ("keys add --ower a", "ricochet keys add", "--owner: is missing"),
        ("cra a.toml b.toml", "ricochet cra", "b.toml: is an unexpected argument"),
        ("", "ricochet", "COMMAND: is missing"),
        ("sweep", "ricochet sweep", "--axis: is missing"),
        ("trajectory --ang 3", "ricochet trajectory", "--ang: unknown flag; did you mean --angle?"),
        ("cra --velocity", "ricochet cra", "--velocity: needs a value"),
        ("cra --velocity x", "ricochet cra", "--velocity: must be a number, got 'x'"),
        ("cra --angle x", "ricochet cra", "--oblique-angle/--angle: must be a number, got 'x'"),
        ("cra --profile 3", "ricochet cra", "--profile: must be points X,R:X,R:..., got '3'"),
        (
            "cra --strength-coefficients a",
            "ricochet cra",
            "--strength-coefficients: must be numbers ... got 'a'",
        ),
        ("cra --json --csv", "ricochet cra", "--csv: cannot go with --json"),
        (
            "calibrate obliquity p.csv --order x",
            "ricochet calibrate obliquity",
            "--order: must be a whole ... got 'x'",
        ),
    ],
)
def test_usage_error_is_one_line_with_flag_value_and_suggestion(
    capsys: pytest.CaptureFixture[str], words: str, command: str, wrong: str
) -> None:
    assert cli.main(words.split()) == 2
    first, second = capsys.readouterr().err.splitlines()
    begin, _, end = wrong.partition("...")
    assert first.startswith(f"{command}: {begin.rstrip()}")
    assert first.endswith(end)
    assert second == f"{command} --help lists what it takes"


@pytest.mark.parametrize("words", ["help cra", "help jobs results", "help"])
def test_help_is_also_a_command(capsys: pytest.CaptureFixture[str], words: str) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(words.split())
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {words.replace('help', 'ricochet', 1)} [")


@pytest.mark.parametrize("number", ["-1e-1", "-.1", "-0.1", "-1E-1", "-10.e-2", "-0.1e0"])
def test_negative_number_is_a_value_and_not_a_flag(here: Path, capsys: pytest.CaptureFixture[str], number: str) -> None:
    def printed(*words: str) -> str:
        assert cli.main([*COMMANDS["cra"], "--json", *words]) == 0
        return capsys.readouterr().out

    assert printed("--angle-of-attack", number) == printed("--set", "impact.angle_of_attack_deg=-0.1")


def test_negative_numbers_in_a_list_are_values(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*COMMANDS["cra"], "--strength-coefficients", "-8,0.01"]) == 2
    assert "the model gives -7.95" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("thickness --angle 20", ["Design value against scabbing 636 mm", "Not perforated from 470 mm on by Hughes"]),
        ("limit-speed --angle 20 --thickness 0.2", ["Perforated from "]),
    ],
)
def test_answer_comes_first_and_trials_only_on_request(
    here: Path, capsys: pytest.CaptureFixture[str], words: str, answer: list[str]
) -> None:
    command, *flags = words.split()
    args = [command, "strike.toml", *flags, "--set", "numerics.relative_tolerance=1e-3"]
    assert cli.main(args) == 0
    short = capsys.readouterr().out
    *said, blank = short.splitlines()[: len(answer) + 1]
    assert [line.startswith(begin) for line, begin in zip(said, answer, strict=True)] == [True] * len(answer)
    assert blank == ""
    assert "outcome" not in short
    assert cli.main([*args, "-v"]) == 0
    long = capsys.readouterr().out
    assert long.startswith(short)
    assert "outcome" in long.removeprefix(short)
