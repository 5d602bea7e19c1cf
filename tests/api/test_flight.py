"""Flights over HTTP: by a separate route, and as part of the answer to a ricochet."""

import math
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER_AT_45
from solver import FlightConditions, Impact
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from solver.uncertainty import Sampling, Uncertain, Uniform, trajectory_uncertainty

STEEP = PAPER_AT_45 | {"impact": PAPER_AT_45["impact"] | {"oblique_angle_deg": 55.0}, "output": {"history": False}}

STRAY = {name: value for name, value in STEEP.items() if name != "output"} | {
    "uncertain": [
        {"field": "impact.oblique_angle_deg", "distribution": {"type": "uniform", "lower": 45.0, "upper": 60.0}}
    ],
    "sampling": {"max_samples": 256, "half_width": 0.2},
}


def run(client: httpx.Client, body: dict[str, Any]) -> dict[str, Any]:
    response = client.post("/trajectory", json=body)
    assert response.status_code == 200, response.text
    answer: dict[str, Any] = response.json()
    return answer


def test_flight_after_a_ricochet_follows_from_exit_speed_and_elevation(client: httpx.Client) -> None:
    left = run(client, STEEP | {"flight": {}})["exit"]
    alone = client.post(
        "/flight",
        json={
            "speed_m_s": left["speed_m_s"],
            "elevation_deg": left["elevation_deg"],
            "mass_kg": STEEP["projectile"]["mass_kg"],
            "projected_area_m2": left["flight"]["projected_area_m2"],
        },
    ).json()
    for name, value in left["flight"].items():
        assert alone[name] == pytest.approx(value, rel=1e-6)


def test_direction_of_the_face_decides_where_the_body_flies(client: httpx.Client) -> None:
    def distance(**face: Any) -> float:
        found: float = run(client, STEEP | {"flight": face})["exit"]["flight"]["range_m"]
        return found

    level = distance()
    assert distance(face_tilt_deg=90.0, incidence_plane="down", height_m=5.0) < 10.0
    assert distance(height_m=50.0) > level
    assert distance(drag_coefficient=0.0) > level
    assert distance(incidence_plane="down") == level  # The plane of incidence matters only if the face is tilted.


def test_embedded_body_has_no_flight(client: httpx.Client) -> None:
    answer = run(client, PAPER_AT_45 | {"flight": {}, "output": {"history": False}})
    assert "exit" not in answer


def test_flight_is_given_only_on_request(client: httpx.Client) -> None:
    assert "flight" not in run(client, STEEP)["exit"]


def test_body_through_a_slab_falls_to_the_floor_below(client: httpx.Client) -> None:
    body = STEEP | {
        "target": STEEP["target"] | {"thickness_m": 0.15},
        "impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 0.0},
        "flight": {"height_m": 3.0},
    }
    answer = run(client, body)
    assert answer["outcome"] == "perforated"
    assert answer["exit"]["flight"]["range_m"] == pytest.approx(0.0, abs=1e-6)
    assert answer["exit"]["flight"]["apex_m"] == pytest.approx(3.0)


def test_study_has_quantiles_of_the_distances(client: httpx.Client) -> None:
    answer = client.post("/trajectory/uncertainty", json=STRAY | {"flight": {}}).raise_for_status().json()
    flight = answer["ricochet_exit"]["flight"]
    assert list(flight) == ["range_m", "farthest_range_m"]
    for near, far in zip(*flight.values(), strict=True):
        assert 0.0 < near["value"] <= far["value"]
    plain = client.post("/trajectory/uncertainty", json=STRAY).raise_for_status().json()
    assert "flight" not in plain["ricochet_exit"]
    table = client.get(f"/results/{answer['key']}", headers={"Accept": "text/csv"}).text
    assert "ricochet_exit_flight_farthest_range_m,0.95," in table


def test_study_in_python_gives_the_distances_of_the_http_answer(client: httpx.Client) -> None:
    answer = (
        client.post("/trajectory/uncertainty", json=STRAY | {"flight": {"height_m": 5.0}}).raise_for_status().json()
    )
    angle = Uncertain("impact.oblique_angle", Uniform(lower=math.radians(45.0), upper=math.radians(60.0)))
    found = trajectory_uncertainty(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        impact=Impact(velocity=238.0, oblique_angle=math.radians(55.0)),
        uncertain=[angle],
        flight=FlightConditions(height=5.0),
        sampling=Sampling(max_samples=256, half_width=0.2),
    )
    for name, quantiles in answer["ricochet_exit"]["flight"].items():
        expected = [estimate.value for _, estimate in found.ricochet_flight[name.removesuffix("_m")]]
        assert [each["value"] for each in quantiles] == pytest.approx(expected, rel=1e-6)
