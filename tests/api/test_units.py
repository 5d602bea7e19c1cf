"""Texts of answers in the units of the request; fields stay in SI."""

import json
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER
from tests.quantities_in_texts import check_converted

COARSE = {"lower_deg": 42.0, "upper_deg": 58.0, "tolerance_deg": 0.5}
CONCRETE: dict[str, Any] = PAPER["target"] | {"compressive_strength_pa": 60e6}
CASE: dict[str, Any] = {"projectile": PAPER["projectile"], "target": CONCRETE}
STRIKE = CASE | {"impact": {"velocity_m_s": 820.0, "oblique_angle_deg": 50.0}}
WALL = STRIKE | {"target": CONCRETE | {"thickness_m": 1.1}}
SEARCH = WALL | {"impact": {"velocity_m_s": 820.0}, "search": COARSE, "output": {"history": True}}
HEAVY = STRIKE | {"projectile": CASE["projectile"] | {"mass_kg": 60.0}}
DISTRIBUTION = {"type": "normal", "mean": 820.0, "standard_deviation": 9.0}
SAMPLED = {
    "uncertain": [{"field": "impact.velocity_m_s", "distribution": DISTRIBUTION}],
    "sampling": {"max_samples": 256},
}
BODIES: dict[str, dict[str, Any]] = {
    "/trajectory": WALL,
    "/cra": SEARCH,
    "/wall": WALL,
    "/thickness": STRIKE,
    "/limit-speed": WALL | {"impact": {"oblique_angle_deg": 20.0}},
    "/formulas": STRIKE,
    "/trajectory/uncertainty": HEAVY | SAMPLED,
    "/verdict": WALL | {"search": COARSE, "flight": {}},
}
TEXTS = ("sentence", "detail", "note", "fitted_to")


def compare(si: Any, us: Any, name: str = "") -> int:
    """Compare the leaves of two answers, and return how many texts differ."""
    if isinstance(si, dict):
        assert si.keys() == us.keys()
        return sum(compare(si[each], us[each], each) for each in si if each not in ("key", "keys"))
    if isinstance(si, list):
        assert len(si) == len(us)
        return sum(compare(*each, name) for each in zip(si, us, strict=True))
    if name in TEXTS:
        check_converted(si, us)
        return int(si != us)
    assert si == us, name
    return 0


@pytest.mark.parametrize("path", BODIES)
def test_texts_use_the_units_of_the_request_and_fields_stay_in_si(client: httpx.Client, path: str) -> None:
    answers = []
    for units in ({}, {"units": "si"}, {"units": "us"}):
        response = client.post(path, json=BODIES[path] | units)
        assert response.status_code == 200, response.text
        answers.append(response.json())
    assert answers[0] == answers[1], "SI is the default, with the same key"
    assert answers[0].get("key", answers[0].get("keys")) != answers[2].get("key", answers[2].get("keys"))
    assert compare(answers[0], answers[2]) > 0


@pytest.mark.parametrize("path", [*BODIES, "/report"])
def test_unknown_system_of_units_is_refused_with_the_choices(client: httpx.Client, path: str) -> None:
    body = BODIES.get(path, BODIES["/verdict"])
    response = client.post(path, json=body | {"units": "imperial"})
    assert response.status_code == 422
    assert response.json()["errors"] == [{"pointer": "/units", "detail": "must be 'si' or 'us', got 'imperial'"}]


SHORT: dict[str, Any] = STRIKE | {"projectile": CASE["projectile"] | {"length_m": 0.1}}
LOWER = {"type": "truncated_normal", "mean": 820.0, "standard_deviation": 9.0, "lower": 900.0}
REFUSED: dict[str, tuple[str, dict[str, Any], list[str]]] = {
    "found by the solver": (
        "/trajectory",
        SHORT,
        [
            "must be at least the length of the nose, 0.132665 m, got 0.1 m",
            "must be at least the length of the nose, 132.665 mm, got 100 mm",
            "must be at least the length of the nose, 5.22303 in, got 3.93701 in",
        ],
    ),
    "outside its bounds, and the body is wrong elsewhere too": (
        "/wall",
        WALL | {"target": CONCRETE | {"youngs_modulus_pa": 2e12}, "impact": "fast"},
        [
            "must be 1,000,000 to 1e12 Pa, got 2e12 Pa",
            "must be 0.001 to 1000 GPa, got 2000 GPa",
            "must be 0.145038 to 145,038 ksi, got 290,075 ksi",
        ],
    ),
    "in a list": (
        "/formulas",
        STRIKE
        | {"projectile": CASE["projectile"] | {"nose": {"shape": "profile", "points": [[0.0, 0.0], [25.0, 0.04]]}}},
        [
            "must be less than or equal to 20 m, got 25 m",
            "must be less than or equal to 20,000 mm, got 25,000 mm",
            "must be less than or equal to 787.402 in, got 984.252 in",
        ],
    ),
    "parameter of a distribution": (
        "/trajectory/uncertainty",
        STRIKE | {"uncertain": [{"field": "impact.velocity_m_s", "distribution": LOWER}]},
        ["must be below the mean, 820 m/s", "must be below the mean, 820 m/s", "must be below the mean, 2690.29 ft/s"],
    ),
    "parameter that is no value of the field": (
        "/trajectory/uncertainty",
        STRIKE | {"uncertain": [{"field": "target.compressive_strength_pa", "distribution": LOWER | {"lower": 5.0}}]},
        [
            f"is no value of 'target.compressive_strength_pa': must be greater than or equal to {bound}"
            for bound in ("100,000 Pa, got 5 Pa", "0.1 MPa, got 5e-6 MPa", "14.5038 psi, got 0.000725189 psi")
        ],
    ),
}
"""Path and body of refused requests, and their first message without `units`, with `si` and with `us`."""


@pytest.mark.parametrize("kind", REFUSED)
def test_refusals_are_in_the_units_that_the_request_names(client: httpx.Client, kind: str) -> None:
    """Without `units`, quantities are in the units of the fields; with `units`, in the units of all other texts."""
    path, body, messages = REFUSED[kind]
    for units, message in zip(({}, {"units": "si"}, {"units": "us"}), messages, strict=True):
        refused = client.post(path, json=body | units)
        assert refused.status_code == 422
        problem = refused.json()
        assert problem["errors"][0]["detail"] == message
        assert message in problem["detail"]


@pytest.mark.parametrize("place", ["/cases/0", "/0", "/base"])
def test_refusals_of_many_cases_are_in_the_units_of_each(client: httpx.Client, place: str) -> None:
    """In batches and sweeps, only studies may name a system of units. Each refusal is in the units of its study."""
    axis = {"field": "projectile.mass_kg", "values": [13.0, 14.0]}
    study = STRIKE | {"uncertain": SAMPLED["uncertain"], "impact": {"velocity_m_s": 2e4, "oblique_angle_deg": 50.0}}
    in_si, in_us = "must be 0.1 to 10,000 m/s, got 20,000 m/s", "must be 0.328084 to 32,808.4 ft/s, got 65,616.8 ft/s"
    for units, message in (({}, in_si), ({"units": "si"}, in_si), ({"units": "us"}, in_us)):
        case = study | units
        sent: dict[str, tuple[str, dict[str, Any]]] = {
            "/cases/0": ("batch", {"json": {"cases": [case]}}),
            "/0": ("batch", {"content": json.dumps(case), "headers": {"Content-Type": "application/jsonl"}}),
            "/base": ("sweep", {"json": {"base": case, "axes": [axis]}}),
        }
        path, content = sent[place]
        [error] = client.post(f"/trajectory/uncertainty/{path}", **content).json()["errors"]
        assert error == {"pointer": f"{place}/impact/velocity_m_s", "detail": message}


def test_checks_of_workers_are_in_the_units_of_each_case(client: httpx.Client) -> None:
    path, body, messages = REFUSED["parameter of a distribution"]
    cases = [body | units for units in ({}, {"units": "si"}, {"units": "us"})]
    errors = client.post(f"{path}/batch", json={"cases": cases}).json()["errors"]
    assert [each["detail"] for each in errors] == messages


def test_units_that_are_no_system_leave_refusals_in_those_of_the_fields(client: httpx.Client) -> None:
    body = STRIKE | {"impact": {"velocity_m_s": 2e4, "oblique_angle_deg": 5.0}}
    for units in ("imperial", 3, None, ["us"]):
        errors = client.post("/trajectory", json=body | {"units": units}).json()["errors"]
        assert errors[0]["detail"] == "must be 0.1 to 10,000 m/s, got 20,000 m/s"


def test_alternatives_are_shared_by_requests_in_all_units(client: httpx.Client) -> None:
    body = SEARCH | {"alternatives": True, "output": {}}
    si, us = (client.post("/cra", json=body | units).json() for units in ({}, {"units": "us"}))
    assert compare(si["alternatives"], us["alternatives"]) > 0
    assert [each.get("key") for each in si["alternatives"]] == [each.get("key") for each in us["alternatives"]]
