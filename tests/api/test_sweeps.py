"""Sweeps over HTTP: results, limits and refusals."""

import itertools

import httpx
import pytest

from service.schemas import CriticalAngleRequest
from service.schemas.strike import PAPER, PAPER_AT_45
from service.schemas.sweeps import Axis, Grid, Outline

from .many import ROUGH, finished

VELOCITY = {"field": "impact.velocity_m_s", "values": [230.0, 240.0]}
STRENGTH = {"field": "target.compressive_strength_pa", "start": 35e6, "stop": 45e6, "count": 3}
BASE = PAPER | {"search": ROUGH}


def test_every_combination_is_answered_with_the_last_axis_varying_fastest(client: httpx.Client) -> None:
    response = client.post("/cra/sweep", json={"base": BASE, "axes": [VELOCITY, STRENGTH]})
    items = response.json()["results"]
    assert [item["index"] for item in items] == list(range(6))
    points = itertools.product([230.0, 240.0], [35e6, 40e6, 45e6])
    for item, (velocity, strength) in zip(items, points, strict=True):
        target = BASE["target"] | {"compressive_strength_pa": strength}
        alone = client.post("/cra", json=BASE | {"impact": {"velocity_m_s": velocity}, "target": target})
        assert alone.headers["Cache-Status"] == "ricochet; hit"
        assert alone.json() == item["result"]


def test_sweep_of_trajectories_has_no_histories(client: httpx.Client) -> None:
    axes = [{"field": "impact.oblique_angle_deg", "values": [45, 55]}]
    items = client.post("/trajectory/sweep", json={"base": PAPER_AT_45, "axes": axes}).json()["results"]
    assert [item["result"]["outcome"] for item in items] == ["embedded", "ricochet"]
    assert "history" not in items[0]["result"]


def test_large_sweep_becomes_a_job(client: httpx.Client) -> None:
    axes = [{"field": "impact.velocity_m_s", "start": 230.0, "stop": 250.0, "count": 120}]
    response = client.post("/cra/sweep", json={"base": BASE, "axes": axes})
    assert response.status_code == 202
    assert finished(client, response.json())["counts"]["total"] == 120


def test_point_refused_only_by_the_solver_is_a_result_with_a_problem(client: httpx.Client) -> None:
    axes = [{"field": "projectile.length_m", "values": [0.53, 0.1]}]
    items = client.post("/cra/sweep", json={"base": BASE, "axes": axes}).json()["results"]
    assert "result" in items[0]
    assert items[1]["problem"]["errors"][0]["pointer"] == "/projectile/length_m"


def test_evenly_spaced_values_end_exactly_at_the_limits() -> None:
    axis = Axis(field="x", start=0.1, stop=0.7, count=7)
    assert axis.numbers() == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7], rel=1e-15)
    assert (axis.numbers()[0], axis.numbers()[-1]) == (0.1, 0.7)
    assert Axis(field="x", start=0.3, stop=0.7, count=1).numbers() == [0.3]


def test_base_is_not_changed_by_its_points() -> None:
    outline = Outline.model_validate({"base": PAPER, "axes": [VELOCITY, STRENGTH]})
    grid = Grid(CriticalAngleRequest, outline)
    made = [grid.request(point) for point in grid.points()]
    assert outline.base == PAPER
    assert len({str(request) for request in made}) == grid.count == 6
