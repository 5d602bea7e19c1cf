"""`/formulas`: results of the empirical formulas, and whether a strike is in their range."""

import math
from typing import Any

import httpx
import pytest

from service.schemas import FormulasAnswer
from service.schemas.strike import PAPER
from solver import Impact, formulas
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET

from .calibrations import answered
from .many import file_at, rows_at
from .refused import refused_at

BODY: dict[str, Any] = {name: PAPER[name] for name in ("projectile", "target")} | {"impact": {"velocity_m_s": 238.0}}
FORRESTAL: dict[str, Any] = {
    "projectile": {
        "nose": {"shape": "ogive", "caliber_radius_head": 2.0},
        "diameter_m": 0.0269,
        "length_m": 0.2427,
        "mass_kg": 0.906,
    },
    "target": {"compressive_strength_pa": 35.2e6, "density_kg_m3": 2370.0},
    "impact": {"velocity_m_s": 277.0},
}
"""A shot by Forrestal, Altman, Cargile and Hanchak (1994)."""


def rows_of(answer: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["formula"]: row for row in answer["formulas"]}


def test_rows_are_the_ones_of_the_solver(client: httpx.Client) -> None:
    answer = answered(client, "/formulas", BODY)
    FormulasAnswer.model_validate(answer)
    rows = rows_of(answer)
    impact = Impact(velocity=238.0, oblique_angle=0.0)
    for result in formulas(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact):
        row = rows.pop(result.formula)
        for name in ("penetration_depth", "scabbing_thickness", "perforation_thickness"):
            assert row.get(f"{name}_m") == getattr(result, name)
        assert (row["in_range"], row["range_known"]) == (result.in_range, result.range_known)
        assert (row["verified"], row["source"]) == (result.verified, result.source)
        assert row.get("note", "") == result.note
    assert not rows


def test_ndrc_depth_is_the_worked_value(client: httpx.Client) -> None:
    rows = rows_of(client.post("/formulas", json=FORRESTAL).json())
    assert rows["modified_ndrc"]["penetration_depth_m"] / 0.0269 == pytest.approx(5.11, abs=0.01)


def test_value_out_of_range_is_answered_and_names_the_field(client: httpx.Client) -> None:
    row = rows_of(client.post("/formulas", json=BODY).json())["cea_edf"]
    assert row["perforation_thickness_m"] > 0.0
    assert not row["in_range"]
    assert row["out_of_range"] == [
        {"pointer": "/impact/velocity_m_s", "detail": "fitted from 20 m/s to 200 m/s along the normal, here 238 m/s"},
        {"pointer": "/projectile/nose", "detail": "fitted to flat noses, here sharp"},
    ]


def test_formula_without_a_known_range_is_flagged(client: httpx.Client) -> None:
    rows = rows_of(client.post("/formulas", json=BODY).json())
    assert {name for name, row in rows.items() if not row["range_known"]} == {"brl"}
    assert not rows["brl"]["in_range"]
    assert rows["brl"]["out_of_range"] == []


def test_answer_states_doubts_and_assumptions(client: httpx.Client) -> None:
    rows = rows_of(client.post("/formulas", json=BODY).json())
    assert {name for name, row in rows.items() if "note" in row} == {"brl", "whiffen"}
    assert rows["brl"]["note"].startswith("in doubt")
    assert "aggregate taken as 20 mm" in rows["whiffen"]["note"]
    sphere = {"nose": {"shape": "spherical", "caliber_radius_head": 0.5}}
    answer = client.post("/formulas", json=BODY | {"projectile": BODY["projectile"] | sphere}).json()
    assert answer["nose_class"] == "hemispherical"
    assert "1.0, on the safe side" in rows_of(answer)["modified_ndrc"]["note"]


def test_spread_covers_the_formulas_in_range(client: httpx.Client) -> None:
    answer = client.post("/formulas", json=BODY).json()
    found = {
        row["perforation_thickness_m"]
        for row in answer["formulas"]
        if row["in_range"] and "perforation_thickness_m" in row
    }
    assert answer["perforation_thickness_spread"] == {
        "lowest": min(found),
        "highest": max(found),
        "formulas": len(found),
    }
    assert len(found) < sum("perforation_thickness_m" in row for row in answer["formulas"])


def test_oblique_strike_enters_with_its_normal_component_and_a_warning(client: httpx.Client) -> None:
    oblique = BODY | {"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 60.0}}
    half = BODY | {"impact": {"velocity_m_s": 119.0}}
    answers = [client.post("/formulas", json=body).json() for body in (oblique, half)]
    assert [[each["code"] for each in answer["warnings"]] for answer in answers] == [["normal_component_only"], []]
    assert "common practice" in answers[0]["warnings"][0]["detail"]
    first, second = map(rows_of, answers)
    for name, row in first.items():
        assert row.get("perforation_thickness_m", 0.0) == pytest.approx(
            second[name].get("perforation_thickness_m", 0.0)
        )


def test_result_is_returned_as_json_csv_and_hdf5(client: httpx.Client) -> None:
    answer = client.post("/formulas", json=BODY).json()
    assert client.post("/formulas", json=BODY).headers["Cache-Status"] == "ricochet; hit"
    address = f"/results/{answer['key']}"
    assert client.get(address).json() == answer
    table = rows_at(client, address)
    assert [row["formula"] for row in table] == [row["formula"] for row in answer["formulas"]]
    assert math.isnan(float(table[1]["scabbing_thickness_m"]))
    assert table[0]["note"] == ""
    assert {row["formula"]: row["note"] for row in table}["brl"].startswith("in doubt")
    in_range = {row["formula"]: row["in_range"] for row in table}
    assert [in_range[name] for name in ("cea_edf", "brl", "modified_ndrc")] == ["no", "unknown", "yes"]
    with file_at(client, address) as content:
        assert any("residuals" in name for name in content)


def test_reinforcement_without_effect_is_a_warning(client: httpx.Client) -> None:
    plain, zero, reinforced = (
        answered(client, "/formulas", BODY | {"target": BODY["target"] | extra})
        for extra in ({}, {"reinforcement_ratio_percent": 0.0}, {"reinforcement_ratio_percent": 10.0})
    )
    assert plain["formulas"] == zero["formulas"] == reinforced["formulas"]
    codes = [[each["code"] for each in answer["warnings"]] for answer in (plain, zero, reinforced)]
    assert codes == [[], [], ["reinforcement_not_counted"]]
    too_much = BODY | {"target": BODY["target"] | {"reinforcement_ratio_percent": 10.5}}
    refused_at(client.post("/formulas", json=too_much), "/target/reinforcement_ratio_percent")
