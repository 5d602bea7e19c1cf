"""A request with a number at one of its bounds succeeds, or is refused with 422 and a pointer to a field."""

import json
import math
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.schemas import strike
from service.schemas.calibration_depth import TABLE_1
from service.schemas.resistance import MOHR_COULOMB

from .refused import changed, refused_at

CONTRACT = json.loads((Path(__file__).parents[2] / "openapi" / "openapi.json").read_text(encoding="utf-8"))
SCHEMAS = CONTRACT["components"]["schemas"]
TINY = math.ulp(0.0)
"""Smallest float above 0."""

NOSES: dict[str, dict[str, Any]] = {
    str(nose["shape"]): strike.PROJECTILE | {"nose": nose, "boat_tail": strike.BOAT_TAIL}
    for nose in (strike.OGIVE, strike.CONICAL, strike.SPHERICAL, strike.FLAT, strike.PROFILE)
}
BODIES = NOSES | {
    "sphere": strike.PROJECTILE | {"nose": strike.SPHERE, "length_m": 0.08},
    "whole profile": strike.PROJECTILE
    | {"nose": {"shape": "profile", "points": [[0.0, 0.01], [0.1, 0.04], [0.4, 0.04], [0.53, 0.02]]}},
}
MASS_PROPERTIES = {"center_of_gravity_m": 0.03, "moment_of_inertia_kg_m2": 0.25}
TARGET = strike.TARGET | {"youngs_modulus_pa": 29.5e9, "poissons_ratio": 0.2}
SHOT = {"velocity_m_s": 238.1, "depth_m": 0.30, "mass_kg": 12.923, "diameter_m": 0.08}
OWN_TESTS = {"model": "own_tests", "shots": [SHOT]}
LAWS: tuple[dict[str, Any], ...] = (
    {"strength_factor": OWN_TESTS, "crater": {"depth_diameters": 2.0}, "inertia_factor": 1.0},
    {"strength_factor": {"model": "strength_power_law", "coefficient": 82.6, "exponent": -0.544}},
    {"strength_factor": {"model": "constant", "value": 8.5}, "free_surface": MOHR_COULOMB},
)
IMPACT = {"velocity_m_s": 238.0, "angle_of_attack_deg": 1.0, "angular_velocity_rad_s": 3.0}
PANELS = {"method": "panels", "panels": 1000, "time_step_s": 1e-5, "termination_time_s": 1e-3}
SCATTER = [
    {"field": "impact.velocity_m_s", "distribution": {"type": "normal", "mean": 238.0, "standard_deviation": 2.0}},
    {"field": "resistance.strength_residual", "distribution": {"type": "lognormal", "median": 1.0, "dispersion": 0.1}},
]
SEARCHED = {"impact": IMPACT, "search": {"lower_deg": 40.0, "upper_deg": 60.0, "tolerance_deg": 0.1}}
STRUCK = {"impact": IMPACT | {"oblique_angle_deg": 45.0}}
BY_PANELS = {"search": {"method": "secant", "relative_tolerance": 0.01}, "numerics": PANELS}


def requests() -> Iterator[tuple[str, str, dict[str, Any], str]]:
    """Yield name, path and body of each request, and the pointer of the part whose numbers are varied."""
    for name, body in BODIES.items():
        case = {"projectile": body | MASS_PROPERTIES, "target": TARGET}
        yield f"{name} in a trajectory", "/trajectory", case | STRUCK, "/projectile"
        yield f"{name} by panels", "/cra", case | SEARCHED | BY_PANELS, "/projectile"
    case = {"projectile": strike.PROJECTILE, "target": TARGET}
    wall = {"target": TARGET | {"thickness_m": 0.2}}
    yield "target", "/cra", case | wall | SEARCHED, "/target"
    yield "impact", "/trajectory", case | STRUCK, "/impact"
    yield "search", "/cra", case | SEARCHED, "/search"
    yield "numerics", "/trajectory", case | STRUCK | {"numerics": PANELS}, "/numerics"
    for law in LAWS:
        yield law["strength_factor"]["model"], "/cra", case | {"resistance": law} | SEARCHED, "/resistance"
    sampled: dict[str, Any] = {"uncertain": SCATTER, "sampling": {"max_samples": 300}, "sensitivity": True}
    study = case | {"resistance": LAWS[0]} | SEARCHED | sampled
    yield "own tests in a study", "/cra/uncertainty", study, "/resistance"
    yield "target of a study", "/cra/uncertainty", study, "/target"
    yield "distributions", "/cra/uncertainty", study, "/uncertain"
    calibration = case | {"tests": TABLE_1[:2], "compare_strength_factors": [8.5], "confidence_level": 0.9}
    yield "tests of a calibration", "/calibration/depth", calibration, ""
    plug = {"resistance": {"rear_plug": {"cone_angle_deg": 66.1}}}
    yield "thickness", "/thickness", case | STRUCK | plug, ""
    yield "limit speed", "/limit-speed", case | wall | plug | {"impact": {"oblique_angle_deg": 20.0}}, ""


def numbers(schema: Mapping[str, Any], value: Any, pointer: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the pointer of each number in a value, with its schema."""
    if "$ref" in schema:
        yield from numbers(SCHEMAS[schema["$ref"].rpartition("/")[2]], value, pointer)
    elif "discriminator" in schema:
        kind = schema["discriminator"]
        yield from numbers({"$ref": kind["mapping"][value[kind["propertyName"]]]}, value, pointer)
    elif "allOf" in schema:
        yield from numbers(schema["allOf"][0], value, pointer)
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from numbers(schema["properties"][name], part, f"{pointer}/{name}")
    elif isinstance(value, list):
        for place, part in enumerate(value):
            yield from numbers(schema["items"], part, f"{pointer}/{place}")
    elif schema.get("type") in {"number", "integer"}:
        yield pointer, schema


def edges(schema: Mapping[str, Any]) -> list[float]:
    """Return the bounds of a schema; for floats also 0, and the floats next to 0 and just inside the bounds."""
    least = schema.get("minimum", math.nextafter(schema.get("exclusiveMinimum", -math.inf), math.inf))
    most = schema.get("maximum", math.nextafter(schema.get("exclusiveMaximum", math.inf), -math.inf))
    if schema["type"] == "integer":
        return [least, most]
    near = {least, math.nextafter(least, math.inf), -TINY, 0.0, TINY, math.nextafter(most, -math.inf), most}
    return sorted(each for each in near if least <= each <= most)


@pytest.mark.system
@pytest.mark.parametrize(("path", "body", "part"), [pytest.param(*each, id=name) for name, *each in requests()])
def test_number_at_an_edge_is_answered_or_refused_with_its_name(
    path: str, body: dict[str, Any], part: str, client: httpx.Client
) -> None:
    schema = CONTRACT["paths"][path]["post"]["requestBody"]["content"]["application/json"]["schema"]
    places = [(pointer, rule) for pointer, rule in numbers(schema, body) if pointer.startswith(part)]
    cases = [(pointer, edge) for pointer, rule in places for edge in edges(rule)]
    assert len(cases) > 2

    def fault_of(case: tuple[str, float]) -> str:
        response = client.post(path, json=changed(body, *case))
        if response.is_success:
            return ""
        named = all(each["pointer"] for each in response.json()["errors"])
        return "" if response.status_code == 422 and named else f"{case}: {response.text}"

    with ThreadPoolExecutor(2) as clients:
        assert [fault for fault in clients.map(fault_of, cases) if fault] == []


@pytest.mark.parametrize("path", ["/cra", "/cra/uncertainty", "/trajectory/uncertainty"])
def test_shot_whose_strength_factor_is_impossible_for_concrete_is_refused(path: str, client: httpx.Client) -> None:
    shot = {"velocity_m_s": 0.1, "depth_m": 1e-6}
    law = {"strength_factor": {"model": "own_tests", "shots": [SHOT, shot]}}
    body = {"projectile": strike.PROJECTILE, "target": TARGET, "resistance": law, "impact": {"velocity_m_s": 238.0}}
    if path != "/cra":
        body["uncertain"] = SCATTER
    if path.startswith("/trajectory"):
        body["impact"] = STRUCK["impact"]
    found = refused_at(client.post(path, json=body), "/resistance/strength_factor/shots/1/depth_m")
    assert "must be between 2 and 60" in found.errors[0].detail
