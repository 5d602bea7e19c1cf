"""`/thickness` and `/limit-speed`: the same as the solver finds, beside the formulas."""

import math
from dataclasses import replace
from typing import Any

import httpx
import pytest

from service.schemas import LimitSpeedAnswer, ThicknessAnswer
from service.schemas.examples import PAPER
from solver import least_thickness, limit_velocity
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, paper_impact

STRIKE = PAPER | {"impact": PAPER["impact"] | {"oblique_angle_deg": 30.0}}
WALL = PAPER | {"target": PAPER["target"] | {"thickness_m": 0.2}, "impact": {"oblique_angle_deg": 0.0}}


def test_thickness_is_that_of_the_solver_beside_the_formulas(client: httpx.Client) -> None:
    response = client.post("/thickness", json=STRIKE)
    assert response.status_code == 200, response.text
    answer = response.json()
    ThicknessAnswer.model_validate(answer)
    impact = paper_impact(oblique_angle_degrees=30.0)
    found = least_thickness(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact)
    assert answer["status"] == "converged"
    assert answer["least_thickness_m"] == pytest.approx(found.value, rel=1e-6)
    assert answer["bracket_m"][1] == answer["least_thickness_m"]
    assert len(answer["iterations"]) == len(found.iterations)
    thicknesses = {row["formula"]: row["perforation_thickness_m"] for row in answer["formulas"]}
    assert thicknesses["modified_ndrc"] > answer["least_thickness_m"]
    assert "rear_face_unconservative" in {warning["code"] for warning in answer["warnings"]}


def test_answer_is_found_again_by_its_body_and_by_its_key(client: httpx.Client) -> None:
    first = client.post("/limit-speed", json=WALL)
    again = client.post("/limit-speed", json=WALL)
    assert (again.content, again.headers["Cache-Status"]) == (first.content, "ricochet; hit")
    assert client.get(f"/results/{first.json()['key']}").content == first.content


def test_limit_speed_is_that_of_the_solver(client: httpx.Client) -> None:
    answer = client.post("/limit-speed", json=WALL).json()
    LimitSpeedAnswer.model_validate(answer)
    wall = replace(PAPER_TARGET, thickness=0.2)
    found = limit_velocity(projectile=PAPER_PROJECTILE, target=wall, oblique_angle=math.radians(0.0))
    assert answer["limit_speed_m_s"] == pytest.approx(found.value, rel=1e-6)
    perforated = [trial for trial in answer["iterations"] if trial["outcome"] == "perforated"]
    assert perforated
    assert all(trial["exit"]["speed_m_s"] < trial["velocity_m_s"] for trial in perforated)


@pytest.mark.parametrize(
    ("path", "body", "pointer", "detail"),
    [
        ("/thickness", STRIKE | {"target": WALL["target"]}, "/target/thickness_m", "must not be given"),
        ("/thickness", STRIKE | {"impact": {"velocity_m_s": 238.0}}, "/impact/oblique_angle_deg", "Field required"),
        ("/limit-speed", WALL | {"target": PAPER["target"]}, "/target/thickness_m", "must be given"),
        ("/limit-speed", WALL | {"impact": STRIKE["impact"]}, "/impact/velocity_m_s", "Extra inputs"),
        (
            "/limit-speed",
            WALL | {"target": WALL["target"] | {"thickness_m": 0.001}},
            "/target/thickness_m",
            "a tenth of the diameter",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(
    client: httpx.Client, path: str, body: dict[str, Any], pointer: str, detail: str
) -> None:
    response = client.post(path, json=body)
    assert response.status_code == 422
    [error] = response.json()["errors"]
    assert error["pointer"] == pointer
    assert detail in error["detail"]
