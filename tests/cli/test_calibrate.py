"""`ricochet calibrate`: output on a terminal and in a pipe, formats, and input files."""

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service import cli
from service.schemas.strike import PAPER_AT_45
from solver import Crater, Impact, Numerics, ShearPlug, critical_angle
from solver.calibration import DepthTest, MotionHistory, fit_depth, predict_motion
from solver.resistance import ObliquityPolynomial, Resistance
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from tests.cli.commands import run_process
from tests.readers.dyna_files import write_binout, write_nodout, write_rbdout

TABLE_1 = "mass_kg,velocity_m_s,depth_m,group\n12.923,238.1,0.30,slow\n12.900,275.7,0.38,slow\n"
TABLE_1 += "12.910,314.0,0.45,fast\n12.914,369.5,0.53,fast\n"
TABLE_2 = "oblique_angle_deg,strength_factor\n0,8.52\n15,8.25\n30,7.91\n45,6.48\n"
PROJECTILE = ["--diameter", "0.08", "--length", "0.53", "--mass", "13", "--caliber-radius-head", "3"]
CASE = [*PROJECTILE, "--compressive-strength", "39e6", "--density", "2250"]
STRIKE = [*CASE, "--velocity", "238", "--oblique-angle", "30"]
STRENGTH_FACTOR = 7.5

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Function that runs `ricochet calibrate`, and returns its status, standard output and standard error."""

    def run(*arguments: str | Path) -> tuple[int, str, str]:
        try:
            status = cli.main(["calibrate", *map(str, arguments)])
        except SystemExit as ended:
            status = int(ended.code or 0)
        return (status, *capsys.readouterr())

    return run


@pytest.fixture
def tests_file(tmp_path: Path) -> Path:
    path = tmp_path / "tests.csv"
    path.write_text(TABLE_1)
    return path


def motion_of(angle_deg: float = 30.0, velocity: float = 238.0, factor: float = STRENGTH_FACTOR) -> MotionHistory:
    return predict_motion(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=Impact(velocity=velocity, oblique_angle=math.radians(angle_deg)),
        strength_factor=factor,
        times=np.linspace(0.0, 3e-3, 31),
    )


def write_history(path: Path) -> None:
    motion = motion_of()
    columns = motion.columns
    rows = zip(
        motion.time, columns["depth_displacement"], columns["lateral_displacement"], columns["rotation"], strict=True
    )
    with path.open("w") as file:
        file.write("T(ms);DX;DZ;RY\n")
        for time, depth, lateral, rotation in rows:
            file.write(f"{1e3 * time};{1e3 * lateral};{-1e3 * depth};{math.degrees(rotation)}\n")


def answer_of(done: tuple[int, str, str]) -> dict[str, Any]:
    status, out, err = done
    assert status == 0, err
    answer: dict[str, Any] = json.loads(out)
    return answer


def test_table_1_gives_the_published_strength_factor(run: Run, tests_file: Path) -> None:
    answer = answer_of(run("depth", tests_file, *CASE, "--json"))
    assert answer["strength_factor"] == pytest.approx(8.38, abs=0.02)
    shared = answer_of(run("depth", tests_file, *CASE, "--column", "mass=", "--json"))
    assert shared["strength_factor"] == pytest.approx(8.44, abs=0.02)
    low, high = answer["confidence_interval"]
    assert low < answer["strength_factor"] < high
    measured = [0.30, 0.38, 0.45, 0.53]
    assert np.allclose(np.add(answer["predicted_depth_m"], answer["residuals"]), measured)


def test_groups_and_curves_are_printed_on_request(run: Run, tests_file: Path, tmp_path: Path) -> None:
    curves = tmp_path / "curves.csv"
    args = ["depth", tests_file, *CASE, "--group", "--strength-factors", "7", "9", "--curves", curves]
    answer = answer_of(run(*args, "--json"))
    assert [group["group"] for group in answer["groups"]] == ["slow", "fast"]
    assert [curve["strength_factor"] for curve in answer["curves"]] == [7.0, answer["strength_factor"], 9.0]
    rows = list(csv.DictReader(curves.read_text().splitlines()))
    assert len(rows) == sum(len(curve["depth_m"]) for curve in answer["curves"])
    assert float(rows[0]["depth_m"]) == pytest.approx(answer["curves"][0]["depth_m"][0], rel=1e-6)


def test_terminal_shows_the_calibration_as_a_table(run: Run, tests_file: Path) -> None:
    status, out, err = run("depth", tests_file, *CASE, "--group")
    assert (status, "Traceback" in err) == (0, False)
    for expected in ("velocity m/s", "369.5", "slow", "strength factor 8.3", "95% interval", "root mean square 28."):
        assert expected in out
    assert out.isascii()  # Output to a pipe has no box-drawing characters.


def test_case_can_be_read_from_a_request_body(run: Run, tests_file: Path, tmp_path: Path) -> None:
    case = tmp_path / "case.json"
    case.write_text(json.dumps(PAPER_AT_45))
    flags = answer_of(run("depth", tests_file, *CASE, "--json"))
    assert answer_of(run("depth", tests_file, "--case", case, "--json")) == flags
    denser = answer_of(run("depth", tests_file, "--case", case, "--density", "2400", "--json"))
    assert denser["strength_factor"] < flags["strength_factor"]


def test_strength_factor_of_a_computed_history_is_recovered(run: Run, tmp_path: Path) -> None:
    history, written = tmp_path / "history.csv", tmp_path / "histories.csv"
    write_history(history)
    columns = ["time=T(ms)", "depth=-DZ", "lateral=DX", "rotation=RY"]
    units = ["displacement=mm", "rotation=deg"]
    flags = [part for column in columns for part in ("--column", column)]
    flags += [part for unit in units for part in ("--unit", unit)]
    args = ["motion", history, *STRIKE, *flags, "--until", "2.5e-3", "--json", "--histories", written]
    answer = answer_of(run(*args, "--strength-factors", "6"))
    assert answer["strength_factor"] == pytest.approx(STRENGTH_FACTOR, rel=1e-3)
    assert answer["oblique_angle_deg"] == 30.0
    assert answer["predicted"]["time_s"][-1] == pytest.approx(2.5e-3)
    assert answer["root_mean_square"].keys() == {"depth_displacement_m", "lateral_displacement_m", "rotation_deg"}
    assert [each["strength_factor"] for each in answer["compared"]] == [6.0, answer["strength_factor"]]
    rows = list(csv.DictReader(written.read_text().splitlines()))
    assert float(rows[-1]["rotation_deg"]) == pytest.approx(answer["predicted"]["rotation_deg"][-1], rel=1e-6)


SI_COLUMNS = {"depth_displacement": "depth_displacement_m", "lateral_displacement": "lateral_displacement_m"}


def write_runs(folder: Path, factors: dict[float, float], velocities: dict[float, float]) -> Path:
    """Write a table of runs, and a history for each, computed with the given strength factor at each angle."""
    lines = ["file,oblique_angle_deg,velocity_m_s,until_ms"]
    for angle, factor in factors.items():
        motion = motion_of(angle, velocities[angle], factor)
        rows = zip(motion.time, *(motion.columns[name] for name in SI_COLUMNS), strict=True)
        text = "".join(f"{','.join(f'{value:.9g}' for value in row)}\n" for row in rows)
        (folder / f"at-{angle:g}.csv").write_text(f"time_s,{','.join(SI_COLUMNS.values())}\n{text}")
        lines.append(f"at-{angle:g}.csv,{angle:g},{velocities[angle]:g},2.5")
    (folder / "runs.csv").write_text("\n".join(lines) + "\n")
    return folder / "runs.csv"


def test_strength_factor_of_several_runs_is_recovered(run: Run, tmp_path: Path) -> None:
    factors, velocities = {15.0: 7.5, 30.0: 7.5, 45.0: 7.5}, {15.0: 238.0, 30.0: 300.0, 45.0: 200.0}
    runs, written = write_runs(tmp_path, factors, velocities), tmp_path / "histories.csv"
    answer = answer_of(run("motion", "--runs", runs, *CASE, "--json", "--histories", written))
    assert answer["strength_factor"] == pytest.approx(7.5, rel=1e-3)
    assert [each["file"] for each in answer["runs"]] == ["at-15.csv", "at-30.csv", "at-45.csv"]
    assert {each["oblique_angle_deg"]: each["velocity_m_s"] for each in answer["runs"]} == velocities
    assert [each["predicted"]["time_s"][-1] for each in answer["runs"]] == [0.0025] * 3
    assert answer["best_decay_law"] == "elastic_plastic"
    alone = answer["decay_laws"][0]["runs"]
    assert [each["alone"]["strength_factor"] for each in alone] == pytest.approx([7.5] * 3, rel=1e-3)
    rows = list(csv.DictReader(written.read_text().splitlines()))
    assert {row["run"] for row in rows} == {"0", "1", "2"}
    assert len(rows) == 3 * 26


def test_fields_without_a_column_come_from_the_flags(run: Run, tmp_path: Path) -> None:
    runs = write_runs(tmp_path, {30.0: 7.5}, {30.0: 238.0})
    full = answer_of(run("motion", "--runs", runs, *CASE, "--json"))
    runs.write_text("file\nat-30.csv\n")
    flags = ["--velocity", "238", "--oblique-angle", "30", "--until", "2.5e-3"]
    assert answer_of(run("motion", "--runs", runs, *CASE, *flags, "--json")) == full
    assert answer_of(run("motion", tmp_path / "at-30.csv", *CASE, *flags, "--json"))[
        "strength_factor"
    ] == pytest.approx(full["strength_factor"])


@pytest.mark.parametrize("kind", ["depth", "motion", "runs", "obliquity"])
@pytest.mark.parametrize("form", ["--json", "--uncertain", "people"])
def test_service_gives_the_same_answer(run: Run, tmp_path: Path, live_url: str, kind: str, form: str) -> None:
    (tmp_path / "tests.csv").write_text(TABLE_1)
    (tmp_path / "points.csv").write_text(TABLE_2)
    runs = write_runs(tmp_path, {30.0: 7.5, 45.0: 7.0}, {30.0: 238.0, 45.0: 238.0})
    args: dict[str, list[str | Path]] = {
        "depth": ["depth", tmp_path / "tests.csv", *CASE, "--group", "--strength-factors", "7", "9"],
        "motion": ["motion", tmp_path / "at-30.csv", *STRIKE, "--strength-factors", "6"],
        "runs": ["motion", "--runs", runs, *CASE],
        "obliquity": ["obliquity", tmp_path / "points.csv"],
    }
    if (kind, form) == ("obliquity", "--uncertain"):
        form = "people"
    flags = [] if form == "people" else [form]
    local, remote = run(*args[kind], *flags), run(*args[kind], *flags, "--url", live_url)
    assert local == remote
    assert local[0] == 0, local[2]


def test_unreachable_service_ends_the_calibration_with_status_1(run: Run, tests_file: Path) -> None:
    status, out, err = run("depth", tests_file, *CASE, "--url", "http://127.0.0.1:1")
    assert (status, out) == (1, "")
    assert "no service answers at http://127.0.0.1:1" in err


@pytest.mark.parametrize(
    ("part", "resistance", "numerics"),
    [
        ({"resistance": {"crater": {"depth_diameters": 2.0}}}, {"crater": Crater(depth_diameters=2.0)}, {}),
        (
            {
                "target": PAPER_AT_45["target"] | {"thickness_m": 0.8},
                "resistance": {"rear_plug": {"cone_angle_deg": 70}},
            },
            {"rear_plug": ShearPlug(cone_angle=math.radians(70.0))},
            {},
        ),
        ({"numerics": {"termination_time_s": 0.002}}, {}, {"termination_time": 0.002}),
        ({"numerics": {"method": "panels", "panels": 500}}, {}, {"method": "panels", "panels": 500}),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else None,
)
def test_fit_uses_the_crater_plug_and_numerics_of_the_case(
    run: Run, tests_file: Path, tmp_path: Path, part: Any, resistance: Any, numerics: Any
) -> None:
    case = tmp_path / "case.json"
    case.write_text(json.dumps(PAPER_AT_45 | part))
    thickness = part.get("target", {}).get("thickness_m")
    fitted = fit_depth(
        projectile=PAPER_PROJECTILE,
        target=replace(PAPER_TARGET, thickness=thickness),
        resistance=Resistance(**resistance),
        numerics=Numerics(**numerics),
        tests=[DepthTest(velocity=v, depth=d) for v, d in ((238.1, 0.30), (275.7, 0.38), (314.0, 0.45), (369.5, 0.53))],
    )
    answer = answer_of(run("depth", tests_file, "--case", case, "--column", "mass=", "--json"))
    assert answer["strength_factor"] == pytest.approx(fitted.estimate.strength_factor, rel=1e-9)
    plain = answer_of(run("depth", tests_file, *CASE, "--column", "mass=", "--json"))
    assert answer["strength_factor"] != plain["strength_factor"]


def test_fit_of_a_motion_uses_the_numerics_of_the_case(run: Run, tmp_path: Path) -> None:
    case = tmp_path / "case.json"
    runs = write_runs(tmp_path, {30.0: 7.5}, {30.0: 238.0})
    found = []
    for tolerance in (1e-3, 1e-9):
        case.write_text(json.dumps(PAPER_AT_45 | {"numerics": {"relative_tolerance": tolerance}}))
        found.append(answer_of(run("motion", "--runs", runs, "--case", case, "--json"))["strength_factor"])
    assert found == pytest.approx([7.5, 7.5], rel=1e-2)
    assert found[0] != found[1]


def test_terminal_shows_every_run_and_every_law(run: Run, tmp_path: Path) -> None:
    runs = write_runs(tmp_path, {15.0: 8.0, 45.0: 6.5}, {15.0: 238.0, 45.0: 238.0})
    status, out, err = run("motion", "--runs", runs, *CASE)
    assert (status, "Traceback" in err) == (0, False)
    for expected in ("at-15.csv", "8.000 ±", "6.500 ±", "best decay law: elastic-plastic", "Mohr-Coulomb", "2 runs"):
        assert expected in out


def test_invalid_table_of_runs_ends_with_status_2(run: Run, tmp_path: Path) -> None:
    runs = write_runs(tmp_path, {30.0: 7.5}, {30.0: 238.0})
    history = tmp_path / "at-30.csv"
    tables = {
        "file,oblique_angle_deg\nat-30.csv,95\n": "runs.csv:2: oblique_angle",
        "file,oblique_angle_deg\nat-30.csv,30\n": "runs.csv:2: --velocity is missing",
        "file,velocity_m_s\nat-30.csv,-3\n": "runs.csv:2: velocity",
        "velocity_m_s\n238\n": "no column of file",
        "file,oblique_angle_deg,velocity_m_s\nnone.csv,30,238\n": "none.csv: No such file",
    }
    for table, reason in tables.items():
        runs.write_text(table)
        status, out, err = run("motion", "--runs", runs, *CASE)
        assert (status, out) == (2, "")
        assert reason in err
    for flags in ([], [history, "--runs", runs]):
        status, _, err = run("motion", *flags, *STRIKE)
        assert status == 2
        assert "either HISTORY or --runs RUNS.csv must be given" in err


@pytest.mark.parametrize("write", [write_rbdout, write_nodout, write_binout])
def test_strength_factor_is_recovered_from_ls_dyna_files(run: Run, tmp_path: Path, write: Callable[..., None]) -> None:
    """The finite element model uses millimetres and milliseconds, and its third axis points out of the target."""
    motion = motion_of()
    depth, lateral, rotation = motion.columns.values()
    zero = np.zeros_like(depth)
    bodies = {2: np.column_stack([1e3 * lateral, zero, -1e3 * depth, zero, -rotation, zero])}
    write(tmp_path / "file", 1e3 * motion.time, bodies)
    axes = ["--axis", "depth=-z", "--axis", "lateral=x", "--axis", "rotation=-y"]
    units = ["--unit", "time=ms", "--unit", "displacement=mm"]
    answer = answer_of(run("motion", tmp_path / "file", *STRIKE, *axes, *units, "--weight", "rotation=0.5", "--json"))
    assert answer["strength_factor"] == pytest.approx(STRENGTH_FACTOR, rel=1e-3)


def test_table_2_gives_equation_9_as_a_model_for_requests(run: Run, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(TABLE_2)
    model = answer_of(run("obliquity", tmp_path / "points.csv", "--json"))["strength_factor_model"]
    assert [round(value, digits) for value, digits in zip(model["coefficients"], (3, 4, 4), strict=True)] == [
        8.469,
        0.0149,
        -0.0013,
    ]
    found = critical_angle(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=238.0,
        resistance=Resistance(strength_factor=ObliquityPolynomial(coefficients=tuple(model["coefficients"]))),
    )
    assert found.angle is not None
    assert math.degrees(found.angle) == pytest.approx(48.6, abs=0.1)
    _, out, _ = run("obliquity", tmp_path / "points.csv")
    assert json.loads(out.splitlines()[-1]) == model


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["depth", "tests.csv"], "--diameter is missing"),
        (["depth", "tests.csv", *CASE, "--diameter", "nan"], "--diameter: must be a finite number, got nan"),
        (
            ["depth", "tests.csv", *CASE, "--caliber-radius-head", "0.1"],
            "--caliber-radius-head: must be 0.5 to 100, got 0.1",
        ),
        (["depth", "tests.csv", *CASE, "--length", "0.05"], "--length: must be at least the length of the nose"),
        (
            ["depth", "tests.csv", *CASE, "--confidence", "1"],
            "--confidence: must be less than or equal to 0.9999",
        ),
        (
            ["depth", "tests.csv", *CASE, "--strength-factors", "7", "0"],
            "--strength-factors: must be greater",
        ),
        (["depth", "tests.csv", *CASE, "--unit", "depth=m", "--unit", "depth=m"], "depth is given twice"),
        (["depth", "tests.csv", *CASE, "--unit", "speed=m/s"], "unknown quantity, known are velocity, depth, mass"),
        (["depth", "tests.csv", *CASE, "--unit", "depth"], "must be NAME=VALUE"),
        (["depth", "tests.csv", *CASE, "--unit", "depth=mm"], "tests.csv:1: depth is in m by the header"),
        (["depth", "tests.csv", *CASE, "--curves", "/no/folder/c.csv"], "the folder does not exist"),
        (["depth", "nothing.csv", *CASE], "ricochet calibrate depth: nothing.csv: No such file or directory\n"),
        (["depth", "tests.csv", "--case", "nothing.json"], "nothing.json: No such file"),
        (["motion", "tests.csv", *CASE], "--velocity is missing"),
        (["motion", "tests.csv", *STRIKE, "--oblique-angle", "95"], "--oblique-angle: must be less than 90"),
        (["motion", "tests.csv", *STRIKE], "tests.csv:1: no column of time"),
        (["motion", "tests.csv", *STRIKE, "--axis", "depth=up"], "--axis: must be x, y or z"),
        (["motion", "tests.csv", *STRIKE, "--until", "never"], "must be greatest-depth or a time in seconds"),
        (["motion", "tests.csv", *STRIKE, "--weight", "depth=much"], "must be a number"),
        (["obliquity", "tests.csv"], "tests.csv:1: no column of oblique_angle"),
        (["obliquity", "points.csv", "--order", "4"], "points.csv: points: must be at 5 or more different angles"),
    ],
)
def test_invalid_files_and_flags_end_with_status_2(
    run: Run, tests_file: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], reason: str
) -> None:
    monkeypatch.chdir(tests_file.parent)
    Path("points.csv").write_text(TABLE_2)
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert reason in err


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ('{"projectile": {"diameter_m": "wide"}}', "case.json: /projectile/diameter_m: must be a number, got 'wide'"),
        ('{"target": {"density_kg_m3": 2250, "wet": true}}', "case.json: /target/wet: unknown field"),
        ('{"projectile": []}', "case.json: /projectile: "),
        ('{"projectile":\n oops}', "case.json:2: not JSON"),
        ("[]", "case.json: must be a JSON object"),
    ],
)
def test_error_in_a_case_is_named_by_its_pointer(
    run: Run, tests_file: Path, tmp_path: Path, content: str, reason: str
) -> None:
    case = tmp_path / "case.json"
    case.write_text(content)
    status, _, err = run("depth", tests_file, "--case", case)
    assert status == 2
    assert reason in err


def test_tests_without_a_fit_end_with_status_1(run: Run, tests_file: Path) -> None:
    tests_file.write_text("velocity_m_s,depth_m\n200,0.001\n300,0.001\n")
    status, out, err = run("depth", tests_file, *CASE)
    assert (status, out) == (1, "")
    assert "tests.csv: tests: must determine the strength factor" in err


def test_calibration_in_a_pipe_prints_one_line_of_json(tests_file: Path) -> None:
    done = run_process(tests_file.parent, "calibrate", "depth", tests_file.name, *CASE, "--json")
    assert (done.status, done.out.count("\n")) == (0, 1), done.err
    assert json.loads(done.out)["strength_factor"] == pytest.approx(8.38, abs=0.02)
