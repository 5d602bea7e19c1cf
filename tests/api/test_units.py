"""Texts of answers in the units of the request; fields stay in SI."""

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


def test_alternatives_are_shared_by_requests_in_all_units(client: httpx.Client) -> None:
    body = SEARCH | {"alternatives": True, "output": {}}
    si, us = (client.post("/cra", json=body | units).json() for units in ({}, {"units": "us"}))
    assert compare(si["alternatives"], us["alternatives"]) > 0
    assert [each.get("key") for each in si["alternatives"]] == [each.get("key") for each in us["alternatives"]]
