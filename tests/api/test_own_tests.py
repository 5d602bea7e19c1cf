"""The strength law from a user's shots, over HTTP and on the command line, and warnings about implausible shots."""

import json
import math
from pathlib import Path
from typing import Any

import httpx
import pytest

from service import cli
from service.schemas.strike import PAPER, PAPER_AT_45
from solver import OwnTests, PublishedTests, Resistance, Shot, critical_angle
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

from .calibrations import answered

SHOT = {"velocity_m_s": 238.1, "depth_m": 0.30, "mass_kg": 12.923}
COARSE_SEARCH = {"search": {"lower_deg": 40.0, "tolerance_deg": 0.1}}
WIDER = {"velocity_m_s": 275.7, "depth_m": 0.38, "mass_kg": 11.0, "diameter_m": 0.0762}
LAW = OwnTests(
    shots=(Shot(velocity=238.1, depth=0.30, mass=12.923), Shot(velocity=275.7, depth=0.38, mass=11.0, diameter=0.0762))
)


def with_shots(*shots: Any, case: dict[str, Any] = PAPER) -> dict[str, Any]:
    return case | {"resistance": {"strength_factor": {"model": "own_tests", "shots": list(shots)}}}


def test_answer_equals_python_and_states_the_effect_of_the_shots(client: httpx.Client) -> None:
    found = client.post("/cra", json=with_shots(SHOT, WIDER)).json()
    case: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
    same = critical_angle(**case, velocity=PAPER_VELOCITY, resistance=Resistance(strength_factor=LAW))
    posterior = LAW.posterior(**case)
    assert same.angle is not None
    assert found["critical_angle_deg"] == pytest.approx(math.degrees(same.angle), abs=1e-9)
    assert found["strength_factor_dispersion"] == pytest.approx(posterior.dispersion)
    prior = PublishedTests().polynomial(target=PAPER_TARGET, projectile=PAPER_PROJECTILE)[0]
    expected = {
        "shots": 2,
        "median": posterior.median,
        "dispersion": posterior.dispersion,
        "spread": list(posterior.spread),
        "prior_median": prior,
        "prior_dispersion": posterior.prior_dispersion,
        "prior_spread": list(posterior.prior_spread),
    }
    assert {name: pytest.approx(value) for name, value in expected.items()} == found["own_tests"]
    run = client.post("/trajectory", json=with_shots(SHOT, WIDER, case=PAPER_AT_45)).json()
    assert run["own_tests"] == found["own_tests"]


def test_every_shot_changes_the_key(client: httpx.Client) -> None:
    bodies = [
        with_shots(SHOT),
        with_shots(SHOT, SHOT),
        with_shots(SHOT | {"depth_m": 0.31}),
        with_shots(SHOT | {"diameter_m": 0.08}),
        with_shots(SHOT | {"mass_kg": 13.0}),
    ]
    assert len({client.post("/cra", json=body).json()["key"] for body in bodies}) == len(bodies)


@pytest.mark.parametrize(
    ("shot", "target", "code"),
    [(SHOT, {"thickness_m": 0.25}, "own_tests_deeper_than_wall"), (SHOT | {"depth_m": 0.9}, {}, "own_tests_apart")],
)
def test_implausible_shots_cause_a_warning(
    client: httpx.Client, shot: dict[str, float], target: dict[str, float], code: str
) -> None:
    body = with_shots(shot, case=PAPER_AT_45 | {"target": PAPER["target"] | target})
    assert code in [each["code"] for each in client.post("/trajectory", json=body).json()["warnings"]]


@pytest.mark.parametrize(("depth", "warned"), [(0.45, True), (0.30, False)])
def test_verdicts_warn_of_shots_deeper_than_every_formula(client: httpx.Client, depth: float, warned: bool) -> None:
    """The largest depth by a formula is 0.36 m. The verdict on a strike repeats the warning about its wall once."""
    walled = PAPER_AT_45 | {"target": PAPER["target"] | {"thickness_m": 0.8}}
    body = with_shots(SHOT | {"depth_m": depth}, case=walled)
    found = [client.post("/wall", json=body).json(), client.post("/verdict", json=body | COARSE_SEARCH).json()]
    found.append(client.post("/wall", json=with_shots(SHOT | {"depth_m": depth}, case=PAPER_AT_45)).json())
    details = [
        [each["detail"] for each in answer["warnings"] if each["code"] == "own_tests_deeper_than_formulas"]
        for answer in found
    ]
    assert [len(each) for each in details] == [warned] * 3
    if warned:
        assert details[0] == details[1]
        assert details[0][0].startswith("shots deeper than every formula within its range gives for them: 1; shot 1 ")


def test_search_for_a_thickness_does_not_compare_shots_with_trial_walls(client: httpx.Client) -> None:
    shot = SHOT | {"depth_m": 0.5}
    found = client.post("/thickness", json=with_shots(shot, case=PAPER_AT_45)).json()
    assert found["least_thickness_m"] < shot["depth_m"]
    assert "own_tests_deeper_than_wall" not in [each["code"] for each in found["warnings"]]


@pytest.mark.parametrize("count", [12, 1000])
def test_many_equal_shots_reduce_the_usual_scatter_within_a_series(client: httpx.Client, count: int) -> None:
    found = client.post("/cra", json=with_shots(*[SHOT] * count)).json()
    assert found["strength_factor_dispersion"] < PublishedTests.within_series


def test_study_with_many_shots_has_the_median_of_the_single_angle(client: httpx.Client) -> None:
    scatter = {
        "field": "resistance.strength_residual",
        "distribution": {"type": "lognormal", "median": 1, "dispersion": 0.1},
    }
    study = {"uncertain": [scatter], "sampling": {"max_samples": 300}}
    many = answered(client, "/cra/uncertainty", with_shots(*[SHOT] * 500) | study)
    angle = client.post("/cra", json=with_shots(*[SHOT] * 500)).json()["critical_angle_deg"]
    median = next(each["value"] for each in many["critical_angle"]["quantiles"] if each["level"] == 0.5)
    assert median == pytest.approx(angle, abs=0.05)


def test_calibration_by_depth_has_the_same_posterior(client: httpx.Client) -> None:
    tests = [SHOT, {"velocity_m_s": 275.7, "depth_m": 0.38, "mass_kg": 12.9}]
    body = {name: PAPER[name] for name in ("projectile", "target")} | {"tests": tests}
    posterior = client.post("/calibration/depth", json=body).json()["posterior"]
    own = client.post("/cra", json=with_shots(*tests)).json()["own_tests"]
    assert (posterior["type"], posterior["degrees_of_freedom"]) == ("log_student_t", 5.0)
    assert posterior["median"] == pytest.approx(own["median"])
    assert posterior["scale"] * math.sqrt(5.0 / 3.0) == pytest.approx(own["dispersion"])


def test_command_line_reads_shots_from_a_file(
    client: httpx.Client, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "strike.json").write_text(json.dumps(PAPER), encoding="utf-8")
    shots = tmp_path / "shots.csv"
    shots.write_text("velocity [m/s],depth [mm],mass [g]\n238.1,300,12923\n", encoding="utf-8")
    assert cli.main(["cra", str(tmp_path / "strike.json"), "--shots", str(shots), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["key"] == client.post("/cra", json=with_shots(SHOT)).json()["key"]
    shots.write_text("velocity [m/s],depth [mm]\n238.1,0\n", encoding="utf-8")
    assert cli.main(["cra", str(tmp_path / "strike.json"), "--shots", str(shots)]) == 2
    assert "must be greater than 0" in capsys.readouterr().err
