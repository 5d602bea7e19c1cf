"""Sweeps and batches of uncertainty studies, and distributions whose centre is the value in the case."""

import time
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.schemas.strike import PAPER, PAPER_AT_45
from service.settings import Settings
from solver import concrete_youngs_modulus
from solver.projectile import mass_properties
from solver.strike import PAPER_PROJECTILE
from tests.conftest import until

from .many import ASYNC, LINES, check_results, file_at, finished, items_of, lines, rows_at
from .refused import refused_at

SPEED = {"field": "impact.velocity_m_s", "distribution": {"type": "normal", "coefficient_of_variation": 0.02}}
SAMPLING = {"max_samples": 256, "half_width": 0.05}
BASE: dict[str, Any] = PAPER_AT_45 | {"uncertain": [SPEED], "sampling": SAMPLING}
SPEEDS = {"field": "impact.velocity_m_s", "values": [230.0, 250.0]}
ANGLES = {"field": "impact.oblique_angle_deg", "values": [48.0, 50.0]}
STRIKES = "/trajectory/uncertainty"


def at(velocity: float, angle: float) -> dict[str, Any]:
    """Return the study of one cell of a sweep."""
    return BASE | {"impact": {"velocity_m_s": velocity, "oblique_angle_deg": angle}}


def seeded(base: dict[str, Any], seed: int) -> dict[str, Any]:
    return base | {"sampling": base["sampling"] | {"seed": seed}}


def about(field: str, kind: str, **parameters: float) -> dict[str, Any]:
    """Return an uncertain input with this kind of distribution."""
    return {"field": field, "distribution": {"type": kind, **parameters}}


@pytest.fixture
def other(tmp_path: Path) -> TestClient:
    """Client of a service that has computed nothing yet."""
    return TestClient(create_app(Settings(data_dir=tmp_path / "data", executor="in-process", workers=1)))


def test_cell_of_a_sweep_equals_the_study_of_its_case(client: httpx.Client, other: TestClient) -> None:
    items = items_of(client.post(f"{STRIKES}/sweep", json={"base": BASE, "axes": [SPEEDS, ANGLES]}))
    check_results("trajectory_uncertainty", items)
    points = [(230.0, 48.0), (230.0, 50.0), (250.0, 48.0), (250.0, 50.0)]
    assert [tuple(item["point"].values()) for item in items] == points
    for item, point in zip(items, points, strict=True):
        again = client.post(STRIKES, json=at(*point))
        assert again.headers["Cache-Status"] == "ricochet; hit"
        assert again.json() == item["result"]
    with other:
        assert other.post(STRIKES, json=at(*points[2])).json() == items[2]["result"]


def test_cell_of_a_sweep_of_critical_angles_equals_the_study_of_its_case(
    client: httpx.Client, other: TestClient
) -> None:
    base = PAPER | {"uncertain": [SPEED], "sensitivity": False, "sampling": SAMPLING, "search": {"tolerance_deg": 0.5}}
    [item] = items_of(
        client.post("/cra/uncertainty/sweep", json={"base": base, "axes": [SPEEDS | {"values": [230.0]}]})
    )
    check_results("cra_uncertainty", [item])
    with other:
        alone = other.post("/cra/uncertainty", json=base | {"impact": {"velocity_m_s": 230.0}})
    assert alone.json() == item["result"]


def test_results_of_a_job_are_listed_in_tables_and_files(client: httpx.Client) -> None:
    body = {"base": seeded(BASE, 31), "axes": [SPEEDS]}
    response = client.post(f"{STRIKES}/sweep", json=body, headers=ASYNC)
    assert response.status_code == 202, response.text
    job = finished(client, response.json())
    assert (job["status"], job["counts"]["done"], job["counts"]["failed"]) == ("successful", 2, 0)
    assert (job["axes"], job["request"]) == (["impact.velocity_m_s"], body)
    assert "progress" not in job
    items = client.get(job["links"]["results"]).json()["results"]
    shares = [{each["outcome"]: each["value"] for each in item["result"]["outcomes"]} for item in items]
    rows = rows_at(client, job["links"]["results"])
    assert [float(row["impact.velocity_m_s"]) for row in rows] == SPEEDS["values"]
    assert [float(row["ricochet"]) for row in rows] == [each["ricochet"] for each in shares]
    with file_at(client, job["links"]["results"]) as file:
        assert file["summary"]["ricochet"][()].tolist() == [each["ricochet"] for each in shares]
        assert file["summary"]["samples"][()].tolist() == [256, 256]
        curves = file["residuals"]
        first = {curves["quantity"][row].decode(): curves["value"][row] for row in range(len(shares[0]))}
        assert first == shares[0]
        assert sorted(set(curves["case"][()].tolist())) == [0, 1]


def test_cases_of_a_batch_are_studies_with_their_names(client: httpx.Client) -> None:
    cases = [at(231.0, 48.0) | {"custom_id": "slow"}, at(251.0, 48.0) | {"custom_id": "fast"}]
    items = items_of(client.post(f"{STRIKES}/batch", json={"cases": cases}))
    assert [item["custom_id"] for item in items] == ["slow", "fast"]
    assert items_of(client.post(f"{STRIKES}/batch", content=lines(cases), headers=LINES)) == items
    wrong = cases[0] | {"uncertain": [SPEED, SPEED]}
    refused_at(client.post(f"{STRIKES}/batch", json={"cases": [cases[1], wrong]}), "/cases/1/uncertain/1/field")
    [good, bad] = items_of(client.post(f"{STRIKES}/batch", content=lines([cases[1], wrong]), headers=LINES))
    assert good["result"] == items[1]["result"]
    assert bad["problem"]["errors"][0]["pointer"] == "/uncertain/1/field"


def test_batch_of_one_study_becomes_a_job_with_its_id_or_problem(client: httpx.Client) -> None:
    good = seeded(at(231.0, 48.0), 36) | {"custom_id": "alone"}
    for case, outcome in ((good, "result"), (good | {"uncertain": [SPEED, SPEED]}, "problem")):
        response = client.post(f"{STRIKES}/batch", content=lines([case]), headers=LINES | ASYNC)
        job = finished(client, response.json())
        assert job["status"] == "successful"
        [item] = client.get(job["links"]["results"]).json()["results"]
        assert item["custom_id"] == "alone"
        assert outcome in item


def test_sweep_with_too_many_samples_for_an_immediate_answer_becomes_a_job(client: httpx.Client) -> None:
    axis = {"field": "impact.velocity_m_s", "start": 230.0, "stop": 240.0, "count": 65}
    response = client.post(f"{STRIKES}/sweep", json={"base": seeded(BASE, 32), "axes": [axis]})
    assert response.status_code == 202
    assert response.json()["queue"]["remaining_s"] > 10  # As ordinary cases, the 65 studies would take a second.
    client.post(response.json()["links"]["cancel"])


def test_cells_of_a_cancelled_sweep_are_not_computed_again(client: httpx.Client) -> None:
    body = {"base": seeded(BASE, 33), "axes": [SPEEDS | {"values": [230.0 + number for number in range(12)]}]}
    job = client.post(f"{STRIKES}/sweep", json=body, headers=ASYNC).json()
    while not (job := client.get(job["links"]["self"]).json())["counts"]["done"]:
        time.sleep(0.02)
    ended = client.post(job["links"]["cancel"]).json()
    assert ended["status"] == "dismissed"
    kept = client.get(job["links"]["results"]).json()["results"]
    assert 1 <= len(kept) == ended["counts"]["done"] < 12
    body["axes"] = [SPEEDS | {"values": [item["point"]["impact.velocity_m_s"] for item in kept] + [260.0]}]
    again = finished(client, client.post(f"{STRIKES}/sweep", json=body, headers=ASYNC).json())
    assert again["counts"] == {"total": len(kept) + 1, "done": len(kept) + 1, "cached": len(kept), "failed": 0}
    found = client.get(again["links"]["results"]).json()["results"]
    assert [item["result"] for item in found[: len(kept)]] == [item["result"] for item in kept]


def test_sweep_of_studies_resumes_after_a_restart(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, executor="in-process", workers=1)
    body = {"base": seeded(BASE, 34), "axes": [SPEEDS | {"values": [230.0, 240.0, 250.0]}]}
    with TestClient(create_app(settings)) as session:
        job = session.post(f"{STRIKES}/sweep", json=body, headers=ASYNC).json()
        while not session.get(job["links"]["self"]).json()["counts"]["done"]:
            time.sleep(0.02)
    with TestClient(create_app(settings)) as session:
        until(lambda: session.get(job["links"]["self"]).json()["status"] not in {"accepted", "running"})
        job = session.get(job["links"]["self"]).json()
        assert (job["status"], job["counts"]["done"], job["counts"]["failed"]) == ("successful", 3, 0)
        assert len(session.get(job["links"]["results"]).json()["results"]) == 3


def test_sweep_with_an_invalid_axis_value_is_refused(client: httpx.Client) -> None:
    before = client.get("/jobs").json()
    body = {"base": BASE, "axes": [SPEEDS | {"values": [230.0, -5.0]}]}
    refused_at(client.post(f"{STRIKES}/sweep", json=body, headers=ASYNC), "/axes/0/values/1")
    nowhere = BASE | {"uncertain": [about("target.hardness", "normal", mean=1.0, standard_deviation=1.0)]}
    response = client.post(f"{STRIKES}/sweep", json={"base": nowhere, "axes": [SPEEDS]}, headers=ASYNC)
    refused_at(response, "/base/uncertain/0/field")
    assert client.get("/jobs").json() == before


def test_distribution_invalid_at_a_point_is_a_problem_of_that_point(client: httpx.Client) -> None:
    cut = about("impact.velocity_m_s", "truncated_normal", standard_deviation=5.0, lower=240.0)
    response = client.post(f"{STRIKES}/sweep", json={"base": BASE | {"uncertain": [cut]}, "axes": [SPEEDS]})
    [slow, fast] = items_of(response)
    assert slow["problem"]["errors"][0]["pointer"] == "/uncertain/0/distribution/lower"
    assert "result" in fast


DENSITY = "target.density_kg_m3"
"""A field whose value in the case is 2250 kg/m³."""


@pytest.mark.parametrize(
    ("centre", "distribution"),
    [
        ("mean", {"type": "normal", "standard_deviation": 45.0}),
        ("mean", {"type": "normal", "coefficient_of_variation": 0.02}),
        ("mean", {"type": "truncated_normal", "standard_deviation": 45.0, "lower": 2200.0}),
        ("median", {"type": "lognormal", "dispersion": 0.02}),
        ("mean", {"type": "lognormal", "coefficient_of_variation": 0.02}),
        ("median", {"type": "log_student_t", "scale": 0.02, "degrees_of_freedom": 5.0, "lower": 2e3, "upper": 2.5e3}),
        ("mode", {"type": "triangular", "lower": 2200.0, "upper": 2300.0}),
    ],
    ids=lambda each: each["type"] if isinstance(each, dict) else each,
)
def test_omitted_centre_is_the_value_of_the_case(
    client: httpx.Client, centre: str, distribution: dict[str, Any]
) -> None:
    omitted, written = (
        client.post(STRIKES, json=BASE | {"uncertain": [{"field": DENSITY, "distribution": each}]})
        for each in (distribution, {**distribution, centre: 2250.0})
    )
    assert omitted.status_code == 200, omitted.text
    assert written.headers["Cache-Status"] == "ricochet; hit"
    assert written.json() == omitted.json()
    assert {each["outcome"]: each["value"] for each in omitted.json()["outcomes"]}["embedded"] > 0.0


BODY = mass_properties(PAPER_PROJECTILE)
SMALL = {"type": "normal", "coefficient_of_variation": 0.01}


@pytest.mark.parametrize(
    ("field", "distribution", "value"),
    [
        ("impact.angle_of_attack_deg", {"type": "normal", "standard_deviation": 1.0}, 0.0),
        ("resistance.strength_residual", {"type": "lognormal", "dispersion": 0.1}, 1.0),
        ("resistance.inertia_factor", SMALL, 1.0),
        ("projectile.center_of_gravity_m", SMALL, BODY.center_of_gravity),
        ("projectile.moment_of_inertia_kg_m2", SMALL, BODY.moment_of_inertia),
        ("target.youngs_modulus_pa", SMALL, concrete_youngs_modulus(compressive_strength=39e6)),
    ],
)
def test_centre_of_an_omitted_field_is_its_default(
    client: httpx.Client, field: str, distribution: dict[str, Any], value: float
) -> None:
    name = "median" if distribution["type"] == "lognormal" else "mean"
    body = BASE | {"uncertain": [{"field": field, "distribution": distribution}]}
    omitted = client.post(STRIKES, json=body)
    assert omitted.status_code == 200, omitted.text
    body["uncertain"] = [{"field": field, "distribution": {**distribution, name: value}}]
    assert client.post(STRIKES, json=body).json() == omitted.json()


def test_job_of_one_study_states_the_centre(client: httpx.Client) -> None:
    job = finished(client, client.post(STRIKES, json=seeded(BASE, 35), headers=ASYNC).json())
    assert job["request"]["uncertain"][0]["distribution"]["mean"] == 238.0
    assert job["progress"]["samples"] == 256


@pytest.mark.parametrize(
    ("field", "pointer", "words"),
    [
        ("target.thickness_m", "/uncertain/0/distribution/mean", "'target.thickness_m'"),
        ("resistance.crater.depth_diameters", "/uncertain/0/distribution/mean", "'resistance.crater.depth_diameters'"),
        ("target.hardness", "/uncertain/0/field", "is no field of the request"),
        ("resistance.theory", "/uncertain/0/distribution", "must be discrete"),
    ],
)
def test_centre_without_a_value_in_the_case_is_refused(
    client: httpx.Client, field: str, pointer: str, words: str
) -> None:
    body = BASE | {"uncertain": [about(field, "normal", standard_deviation=0.01)]}
    problem = refused_at(client.post(STRIKES, json=body), pointer)
    assert words in problem.detail
