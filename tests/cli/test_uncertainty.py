"""`ricochet uncertainty`: scatter from flags and from the file, and estimates as text, table, JSON and plot."""

import json
import math
import re
from pathlib import Path

import pytest
from scipy import stats

from service import cli
from service.cli.arguments import CommandError
from service.cli.uncertainty import key_of, uncertain_input
from service.errors import PoolUnavailableError, problem_of
from tests.cli.commands import STRIKE_TOML, run, run_on_terminal

TABLES = """
[[uncertain]]
field = "impact.angle_of_attack_deg"
distribution = { type = "normal", mean = 0.0, standard_deviation = 1.0 }

[sampling]
half_width = 0.05
seed = 3
"""


@pytest.fixture
def strike(folder: Path) -> Path:
    path = folder / "scatter.toml"
    path.write_text(STRIKE_TOML + TABLES)
    return path


def test_uncertain_inputs_of_file_and_flags_are_combined(strike: Path, folder: Path) -> None:
    flag = "resistance.free_surface.model=discrete:elastic_plastic@0.8:mohr_coulomb@0.2"
    done = run(folder, "uncertainty", strike.name, "--uncertain", flag, "--plot", "curve.svg")
    assert (done.status, done.err) == (0, ""), done.err
    assert "50 % quantile" in done.out
    assert "Angle of attack" in done.out
    assert "Free surface" in done.out
    assert "surrogate" in done.out
    assert (folder / "curve.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize("angle", [[], ["--angle", "50"]], ids=["angle", "outcome"])
def test_missing_uncertain_inputs_are_answered_with_the_usual_scatter(
    folder: Path, capsys: pytest.CaptureFixture[str], angle: list[str]
) -> None:
    quick = ["--set", "sampling.half_width=0.1", "--set", "sampling.max_samples=512"]
    assert cli.main(["uncertainty", str(folder / "strike.toml"), *angle, *quick]) == 0
    shown = capsys.readouterr()
    assert shown.err.startswith("no input is given with --uncertain: the usual scatter of ")
    assert "Factor on the strength factor" in shown.err
    assert ("ricochet" if angle else "50 % quantile") in shown.out


def test_value_of_the_next_shot_is_stated_for_unknown_concrete(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["uncertainty", str(folder / "strike.toml"), "--strength-law", "published_tests", "--next-shot"]
    command += ["--set", "sampling.max_samples=512"]
    assert cli.main(command) == 0
    *_, advice = capsys.readouterr().out.splitlines()
    now, after = re.findall(r"The 90 % range .* is (.*); with shots .* expected to be (.*) after one and", advice)[0]
    assert float(after.split("°")[0]) >= float(now.split("°")[0])
    assert cli.main([*command, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    [shots] = [each["after_shots"] for each in answer["sensitivity"] if "after_shots" in each]
    assert [each["shots"] for each in shots] == [1, 3]
    assert f"{shots[0]['lower_deg']:.0f}° to {shots[0]['upper_deg']:.0f}°" == after


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        (["--angle", "50"], "goes without --angle"),
        (["--uncertain", "impact.velocity_m_s=normal:238:2.4"], "add --uncertain resistance.strength_residual"),
    ],
)
def test_value_of_the_next_shot_requires_scatter_of_the_strength_factor(
    folder: Path, capsys: pytest.CaptureFixture[str], flags: list[str], text: str
) -> None:
    assert cli.main(["uncertainty", str(folder / "strike.toml"), "--next-shot", *flags]) == 2
    assert text in capsys.readouterr().err


def test_answer_is_printed_as_json_and_as_a_table(
    strike: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["uncertainty", str(strike), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert cli.main(["uncertainty", str(strike), "--csv", "--digits", "all"]) == 0
    names, *rows = capsys.readouterr().out.splitlines()
    assert names == "oblique_angle_deg,ricochet_probability,lower,upper"
    assert [float(row.split(",")[1]) for row in rows] == answer["probability"]["ricochet_probability"]


def test_strike_at_an_angle_has_probabilities_of_outcomes(strike: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["uncertainty", str(strike), "--angle", "60", "--csv"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "outcome,value,lower,upper"
    assert lines[1].startswith("ricochet,1.0,")


def test_service_gives_the_same_answer(strike: Path, folder: Path, live_url: str) -> None:
    here, there = (run(folder, "uncertainty", strike.name, "--json", *more) for more in ((), ("--url", live_url)))
    assert (there.status, there.err) == (0, ""), there.err
    assert there.out == here.out
    refused = run(
        folder, "uncertainty", strike.name, "--uncertain", "target.density_kg_m3=uniform:-5:9", "--url", live_url
    )
    assert refused.status == 2
    assert "--uncertain target.density_kg_m3=uniform:-5:9: lower: is no value of" in refused.err


def test_calibrated_strength_factor_can_be_an_uncertain_input(folder: Path) -> None:
    (folder / "tests.csv").write_text("velocity_m_s,depth_m\n238.1,0.30\n275.7,0.38\n314.0,0.45\n369.5,0.53\n")
    fit = json.loads(run(folder, "calibrate", "depth", "tests.csv", "--case", "strike.toml", "--json").out)
    tables = run(folder, "calibrate", "depth", "tests.csv", "--case", "strike.toml", "--uncertain")
    assert tables.status == 0, tables.err
    (folder / "fitted.toml").write_text(STRIKE_TOML + tables.out)
    done = run(folder, "uncertainty", "fitted.toml", "--json")
    assert done.status == 0, done.err
    answer = json.loads(done.out)
    [sensitivity] = answer["sensitivity"]
    assert sensitivity["field"] == "resistance.strength_residual"
    low, high = (math.log(each["value"]) for each in sensitivity["swing"])
    posterior = fit["posterior"]
    reach = posterior["scale"] * stats.t(posterior["degrees_of_freedom"]).ppf(0.95)
    assert (-low, high) == pytest.approx((reach, reach), rel=1e-2)
    # Calibration and --shots give the same S.
    shots = run(folder, "cra", "strike.toml", "--shots", "tests.csv", "--json")
    assert shots.status == 0, shots.err
    own = json.loads(shots.out)
    assert own["own_tests"]["median"] == pytest.approx(posterior["median"], rel=1e-6)
    middle = next(each["value"] for each in answer["critical_angle"]["quantiles"] if each["level"] == 0.5)
    assert middle == pytest.approx(own["critical_angle_deg"], abs=0.05)


def test_terminal_shows_the_half_width_reached_and_requested(strike: Path, folder: Path) -> None:
    study = ("--set", "sampling.half_width=0.001", "--set", "sampling.max_samples=520", "--set", "sensitivity=false")
    done = run_on_terminal(folder, "uncertainty", strike.name, *study)
    assert done.status == 0, done.out
    assert re.search(r"sampling half width 0\.0\d+, requested 0\.001 .*\d+/520", done.out)


def test_failed_study_is_reported_with_its_problem() -> None:
    with pytest.raises(CommandError, match=r"the study failed: .*the pool is gone"):
        key_of({"index": 0, "problem": problem_of(PoolUnavailableError("the pool is gone"))})
    assert key_of({"index": 0, "result": {"key": "a1"}}) == "a1"


def test_short_forms_of_distributions_are_parsed() -> None:
    assert uncertain_input("a.b=normal:238:2.4") == {
        "field": "a.b",
        "distribution": {"type": "normal", "mean": 238.0, "standard_deviation": 2.4},
    }
    assert uncertain_input("a=truncated_normal:1:2::3")["distribution"] == {
        "type": "truncated_normal",
        "mean": 1.0,
        "standard_deviation": 2.0,
        "upper": 3.0,
    }
    heavy = {"type": "log_student_t", "median": 1.0, "scale": 0.25, "degrees_of_freedom": 3.0}
    assert uncertain_input("a=log_student_t:1:0.25:3")["distribution"] == heavy
    cut = heavy | {"lower": 0.24, "upper": 7.0}
    assert uncertain_input("a=log_student_t:1:0.25:3:0.24:7")["distribution"] == cut
    assert uncertain_input("a=discrete:1:2")["distribution"] == {"type": "discrete", "values": [1.0, 2.0]}


@pytest.mark.parametrize(
    "text", ["a", "a=", "a=normal", "a=normal:1", "a=cubic:1:2", "a=discrete", "a=discrete:", "a=log_student_t:1:2"]
)
def test_malformed_distributions_are_refused(text: str) -> None:
    with pytest.raises(CommandError, match="--uncertain"):
        uncertain_input(text)


def test_invalid_distribution_is_named(strike: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["uncertainty", str(strike), "--uncertain", "impact.velocity_m_s=normal:238:-1"]) != 0
    assert (
        "--uncertain impact.velocity_m_s=normal:238:-1: standard_deviation: must be greater than 0"
        in capsys.readouterr().err
    )
