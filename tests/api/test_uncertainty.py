"""`/cra/uncertainty` and `/trajectory/uncertainty`: uncertainty of the critical angle and of the outcome."""

import csv
import io
import json
import math
import re
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from service.schemas import CriticalAngleUncertaintyAnswer, TrajectoryUncertaintyAnswer
from service.schemas.strike import PAPER
from solver import ElasticPlastic, MohrCoulomb, PublishedTests, Resistance
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from solver.uncertainty import RESIDUAL, Discrete, Lognormal, Normal, Sampling, Uncertain, critical_angle_uncertainty
from tests.conftest import RunService, until

from .calibrations import answered
from .many import SPEED, file_at
from .refused import refused_at

ATTACK = {
    "field": "impact.angle_of_attack_deg",
    "distribution": {"type": "normal", "mean": 0.0, "standard_deviation": 1.0},
}
DECAY = {
    "field": "resistance.free_surface.model",
    "distribution": {"type": "discrete", "values": ["elastic_plastic", "mohr_coulomb"], "weights": [0.8, 0.2]},
}
BODY: dict[str, Any] = PAPER | {
    "uncertain": [ATTACK, DECAY],
    "oblique_angles_deg": {"start": 30, "stop": 70, "count": 81},
    "sampling": {"half_width": 0.03, "confidence": 0.95, "max_samples": 4096, "seed": 7},
}
STRIKE: dict[str, Any] = PAPER | {
    "impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 48.7},
    "uncertain": [SPEED],
    "sampling": {"half_width": 0.05, "max_samples": 1024},
}


def discrete(field: str, *values: Any) -> dict[str, Any]:
    return {"field": field, "distribution": {"type": "discrete", "values": list(values)}}


def test_curve_equals_the_curve_of_the_solver(client: httpx.Client) -> None:
    answer = answered(client, "/cra/uncertainty", BODY)
    CriticalAngleUncertaintyAnswer.model_validate(answer)
    models = Discrete(values=[ElasticPlastic(), MohrCoulomb()], weights=[0.8, 0.2])
    same = critical_angle_uncertainty(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=238.0,
        uncertain=[
            Uncertain("impact.angle_of_attack", Normal(mean=0.0, standard_deviation=math.radians(1.0))),
            Uncertain("resistance.free_surface", models),
        ],
        oblique_angles=np.radians(np.linspace(30.0, 70.0, 81)),
        sampling=Sampling(half_width=0.03, max_samples=4096, seed=7),
    )
    np.testing.assert_allclose(answer["probability"]["ricochet_probability"], same.probability, atol=1e-4)
    assert answer["method"] == same.method
    assert answer["samples"] == same.samples
    assert [each["field"] for each in answer["sensitivity"]] == [ATTACK["field"], DECAY["field"]]
    assert answer["sensitivity"][1]["swing"][0]["value"] == "elastic_plastic"
    quantiles = {each["level"]: each["value"] for each in answer["critical_angle"]["quantiles"]}
    assert quantiles[0.5] == pytest.approx(math.degrees(dict(same.quantiles)[0.5].value), abs=0.02)


def test_factor_on_s_states_how_own_shots_would_narrow_the_angle(client: httpx.Client) -> None:
    body = PAPER | {"resistance": {"strength_factor": {"model": "published_tests"}}, "sampling": {"max_samples": 1024}}
    residual = {"type": "lognormal", "median": 1.0, "dispersion": 0.31}
    uncertain = [ATTACK, {"field": "resistance.strength_residual", "distribution": residual}]
    answer = client.post("/cra/uncertainty", json=body | {"uncertain": uncertain}).json()
    attack, factor = answer["sensitivity"]
    assert "after_shots" not in attack
    same = critical_angle_uncertainty(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=238.0,
        resistance=Resistance(strength_factor=PublishedTests()),
        uncertain=[
            Uncertain("impact.angle_of_attack", Normal(mean=0.0, standard_deviation=math.radians(1.0))),
            Uncertain(RESIDUAL, Lognormal(median=1.0, dispersion=0.31)),
        ],
        sampling=Sampling(max_samples=1024),
    )
    for found, each in zip(factor["after_shots"], same.sensitivity[1].after_shots, strict=True):
        assert found["shots"] == each.shots
        assert found["strength_factor_dispersion"] == pytest.approx(each.dispersion)
        angles = math.degrees(each.lower), math.degrees(each.upper)
        assert (found["lower_deg"], found["upper_deg"]) == pytest.approx(angles, abs=0.02)


def test_repeated_study_is_a_cache_hit_and_available_as_table_and_file(client: httpx.Client) -> None:
    first, again = (client.post("/cra/uncertainty", json=BODY) for _ in range(2))
    assert again.headers["Cache-Status"] == "ricochet; hit"
    assert again.content == first.content
    answer = first.json()
    assert client.get(f"/results/{answer['key']}").json() == answer
    text = client.get(f"/results/{answer['key']}", headers={"Accept": "text/csv"}).text
    names, *rows = csv.reader(io.StringIO(text))
    assert names == ["oblique_angle_deg", "ricochet_probability", "lower", "upper"]
    assert [float(row[1]) for row in rows] == answer["probability"]["ricochet_probability"]
    with file_at(client, f"/results/{answer['key']}") as file:
        assert file["residuals"]["upper"][()].tolist() == answer["probability"]["upper"]
        assert file["summary"]["samples"][()].tolist() == [answer["samples"]]


def test_probabilities_of_the_outcomes_of_a_strike_add_up_to_one(client: httpx.Client) -> None:
    answer = answered(client, "/trajectory/uncertainty", STRIKE)
    TrajectoryUncertaintyAnswer.model_validate(answer)
    shares = {each["outcome"]: each["value"] for each in answer["outcomes"]}
    assert 0.1 < shares["ricochet"] < 0.9
    assert sum(shares.values()) == pytest.approx(1.0)
    text = client.get(f"/results/{answer['key']}", headers={"Accept": "text/csv"}).text
    assert text.splitlines()[0] == "quantity,level,value,lower,upper"
    assert "ricochet_exit_kinetic_energy_j,0.5," in text
    assert answer["ricochet_exit"]["direction_deg"] == answer["exit_angle_deg"]
    assert "perforation_exit" not in answer


def test_study_of_a_perforation_has_quantiles_of_its_exit(client: httpx.Client) -> None:
    target = PAPER["target"] | {"thickness_m": 0.2}
    body = STRIKE | {"target": target, "impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 10.0}}
    answer = client.post("/trajectory/uncertainty", json=body).json()
    TrajectoryUncertaintyAnswer.model_validate(answer)
    alone = client.post("/trajectory", json={name: body[name] for name in (*PAPER, "impact")}).json()
    assert alone["outcome"] == "perforated"
    quantiles = answer["perforation_exit"]
    assert list(quantiles) == list(alone["exit"])
    for name, exact in alone["exit"].items():
        middle = {each["level"]: each["value"] for each in quantiles[name]}[0.5]
        assert middle == pytest.approx(exact, rel=0.05, abs=0.1), name
    assert quantiles["speed_m_s"] == answer["residual_speed_m_s"]


def test_samples_outside_the_contract_are_counted(client: httpx.Client) -> None:
    density = {
        "field": "target.density_kg_m3",
        "distribution": {"type": "normal", "mean": 2250.0, "standard_deviation": 1500.0},
    }
    body = BODY | {"uncertain": [density], "sensitivity": False, "sampling": {"max_samples": 256}}
    answer = client.post("/cra/uncertainty", json=body).json()
    assert 10 < answer["samples_outside"] < 40
    assert answer["warnings"][0]["code"] == "samples_outside"
    assert not answer["converged"]


def test_budget_below_the_fewest_samples_is_refused_with_the_least_budget(client: httpx.Client) -> None:
    for headers in ({}, {"Prefer": "respond-async"}):
        response = client.post("/cra/uncertainty", json=BODY | {"sampling": {"max_samples": 256}}, headers=headers)
        assert "must be at least 260" in refused_at(response, "/sampling/max_samples").errors[0].detail
    answer = client.post("/cra/uncertainty", json=BODY | {"sampling": {"max_samples": 260, "half_width": 1e-4}}).json()
    assert answer["samples"] == 260


LAW, COEFFICIENT = "resistance.strength_factor.model", "resistance.strength_factor.coefficient"


@pytest.mark.parametrize(
    ("part", "given", "other"),
    [
        ("free_surface", {"model": "elastic_plastic", "inertia": True}, {"model": "mohr_coulomb", "inertia": True}),
        (
            "strength_factor",
            {"model": "strength_power_law", "obliquity_shape": "equation_9"},
            {"model": "published_tests", "obliquity_shape": "equation_9"},
        ),
        ("strength_factor", {"model": "published_tests"}, {"model": "strength_power_law"}),
    ],
)
def test_alternative_model_keeps_the_options_it_shares(
    client: httpx.Client, part: str, given: dict[str, Any], other: dict[str, Any]
) -> None:
    models = discrete(f"resistance.{part}.model", given["model"], other["model"])
    body = BODY | {"resistance": {part: given}, "uncertain": [models], "sampling": {"max_samples": 258}}
    answer = client.post("/cra/uncertainty", json=body).json()
    swing = {each["value"]: each["critical_angle_deg"] for each in answer["sensitivity"][0]["swing"]}
    for model in (given, other):
        alone = client.post("/cra", json=PAPER | {"resistance": {part: model}}).json()
        assert swing[model["model"]] == pytest.approx(alone["critical_angle_deg"], rel=1e-14)


def test_threshold_and_strength_law_can_be_discrete_inputs(client: httpx.Client) -> None:
    threshold = discrete("numerics.retention_energy_fraction", 0.005, 0.02)
    law = discrete(LAW, "obliquity_polynomial", "published_tests")
    answer = client.post("/cra/uncertainty", json=BODY | {"uncertain": [ATTACK, threshold, law]}).json()
    by_threshold, by_law = (
        {each["value"]: each["critical_angle_deg"] for each in one["swing"]} for one in answer["sensitivity"][1:]
    )
    for fraction, angle in by_threshold.items():
        alone = client.post("/cra", json=PAPER | {"numerics": {"retention_energy_fraction": fraction}}).json()
        assert angle == pytest.approx(alone["critical_angle_deg"], rel=1e-9)
    published = client.post("/cra", json=PAPER | {"resistance": {"strength_factor": {"model": "published_tests"}}})
    # The weights are equal, so the first value, a threshold of 0.005, counts as the most likely one.
    assert by_law["published_tests"] == pytest.approx(published.json()["critical_angle_deg"], abs=0.2)
    assert abs(by_law["published_tests"] - by_law["obliquity_polynomial"]) > 0.1


LONG_STUDY: dict[str, Any] = BODY | {
    "sampling": {"half_width": 0.0005, "max_samples": 16_384, "seed": 3, "method": "direct"}
}


def test_study_stops_when_its_client_disconnects_and_is_refused_at_shutdown(
    tmp_path: Path, service_on: RunService
) -> None:
    with (
        service_on(tmp_path, grace_seconds="3") as service,
        ThreadPoolExecutor(1) as threads,
        httpx.Client(base_url=service.url, timeout=60.0, trust_env=False) as client,
    ):
        connection = HTTPConnection(service.url.removeprefix("http://"), timeout=60.0)
        connection.request("POST", "/cra/uncertainty", json.dumps(LONG_STUDY), {"Content-Type": "application/json"})
        until(lambda: samples_computed(client) > 0)
        connection.close()
        until(lambda: "\nricochet_queued_cases 0.0\n" in client.get("/metrics").text)
        known = samples_computed(client)
        assert known < 0.9 * LONG_STUDY["sampling"]["max_samples"]
        other = LONG_STUDY | {"sampling": LONG_STUDY["sampling"] | {"seed": 4}}
        study = threads.submit(client.post, "/cra/uncertainty", json=other)
        until(lambda: study.done() or samples_computed(client) > known)
        service.process.terminate()
        answer = study.result()
    assert answer.status_code == 503
    assert "stopping" in answer.json()["detail"]


def samples_computed(client: httpx.Client) -> float:
    """Return the number of critical angles that the service has computed since its start."""
    lines = client.get("/metrics").text.splitlines()
    return sum(
        float(line.split()[-1])
        for line in lines
        if re.match(r'ricochet_cases_total\{cache="miss",operation="cra"', line)
    )


def test_every_sample_has_an_answer_although_the_strength_factor_has_heavy_tails(client: httpx.Client) -> None:
    residual = {"type": "log_student_t", "median": 1.0, "scale": 0.25, "degrees_of_freedom": 3.0}
    cut = residual | {"lower": 0.24, "upper": 7.0}
    body = PAPER | {"uncertain": [{"field": "resistance.strength_residual", "distribution": cut}]}
    answers = [
        answered(client, "/cra/uncertainty", body | {"sampling": {"max_samples": 1024, "method": method}})
        for method in ("auto", "direct")
    ]
    surrogate, direct = (
        {each["level"]: each["value"] for each in answer["critical_angle"]["quantiles"]} for answer in answers
    )
    assert [answer["samples_outside"] + answer["samples_failed"] for answer in answers] == [0, 0]
    for level, value in direct.items():
        assert surrogate[level] == pytest.approx(value, abs=0.4)


def test_theory_combines_a_decay_law_with_its_own_obliquity_shape(client: httpx.Client) -> None:
    theory = {"field": "resistance.theory", "distribution": {"type": "discrete", "values": ["mohr_coulomb"]}}
    study = answered(
        client, "/cra/uncertainty", PAPER | {"uncertain": [ATTACK, theory], "sampling": {"max_samples": 300}}
    )
    own = {"model": "strength_power_law", "coefficient": 8.469, "exponent": 0, "obliquity_shape": "finite_elements"}
    resistance = {"strength_factor": own, "free_surface": {"model": "mohr_coulomb"}}
    alone = answered(client, "/cra", PAPER | {"resistance": resistance})["critical_angle_deg"]
    (swing,) = study["sensitivity"][1]["swing"]
    assert swing == {"value": "mohr_coulomb", "critical_angle_deg": pytest.approx(alone, abs=1e-9)}


@pytest.mark.parametrize(
    "distribution",
    [
        {"type": "discrete", "values": ["elastic_plastic", "none"]},
        {"type": "discrete", "values": [1.0, 2.0]},
        {"type": "normal", "mean": 1.0, "standard_deviation": 0.1},
    ],
)
def test_unknown_theory_is_refused(client: httpx.Client, distribution: dict[str, Any]) -> None:
    body = PAPER | {"uncertain": [{"field": "resistance.theory", "distribution": distribution}]}
    response = client.post("/cra/uncertainty", json=body)
    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"].startswith("/uncertain/0/distribution")
