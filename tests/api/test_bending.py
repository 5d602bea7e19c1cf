"""Bending stress in answers: fields, columns, and the note in answers without it."""

import csv
import io
from typing import Any

import httpx
import pytest

from service.schemas import TrajectoryAnswer
from service.schemas.strike import PAPER_AT_45
from solver import simulate
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact

from .calibrations import answered
from .many import LINES, lines

OTHER_CENTER = PAPER_AT_45 | {"projectile": PAPER_AT_45["projectile"] | {"center_of_gravity_m": 0.25}}


def with_projectile(**fields: float) -> dict[str, Any]:
    return PAPER_AT_45 | {"projectile": PAPER_AT_45["projectile"] | fields}


def test_bending_is_the_one_the_solver_computes(client: httpx.Client) -> None:
    answer = answered(client, "/trajectory", PAPER_AT_45)
    TrajectoryAnswer.model_validate(answer)
    impact = paper_impact(oblique_angle_degrees=45.0)
    found = simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact).bending
    assert found is not None
    bending = answer["bending"]
    assert bending["peak_stress_pa"] == pytest.approx(found.peak_stress, rel=1e-9)
    assert len(bending["history"]["time_s"]) == len(bending["history"]["stress_pa"]) > 10
    assert "bends" in {each["code"] for each in answer["warnings"]}
    plain = answered(client, "/trajectory", PAPER_AT_45 | {"output": {"history": False}})
    assert plain["bending"] == {name: value for name, value in bending.items() if name != "history"}


def test_column_of_bending_is_empty_for_another_center_of_gravity(client: httpx.Client) -> None:
    cases = [case | {"output": {"history": False}} for case in (PAPER_AT_45, OTHER_CENTER)]
    answer = client.post("/trajectory/batch", content=lines(cases), headers=LINES | {"Accept": "text/csv"})
    usual, other = csv.DictReader(io.StringIO(answer.text))
    assert float(usual["bending_peak_stress_pa"]) == pytest.approx(1.84e9, rel=0.05)
    assert other["bending_peak_stress_pa"] == ""
    assert "bends" in usual["warnings"].split()
    assert "bending_unknown" in other["warnings"].split()


def test_given_yield_strength_decides_about_the_warning(client: httpx.Client) -> None:
    answer = answered(client, "/trajectory", with_projectile(yield_strength_pa=1.9e9))
    assert "bends" not in {each["code"] for each in answer["warnings"]}


@pytest.mark.parametrize(
    ("field", "value"), [("inner_diameter_m", 0.09), ("yield_strength_pa", 0.0), ("inner_diameter_m", 0.0)]
)
def test_bore_wider_than_the_body_and_zero_strength_are_refused(client: httpx.Client, field: str, value: float) -> None:
    answer = client.post("/trajectory", json=with_projectile(**{field: value}))
    assert answer.status_code == 422
    assert [each["pointer"] for each in answer.json()["errors"]] == [f"/projectile/{field}"]
