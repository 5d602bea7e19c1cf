"""Projectiles in every operation: profiles of points, tapered bodies, and mean densities that suggest a wrong unit."""

from typing import Any

import httpx
import pytest

from service.schemas.calibration_depth import TABLE_1
from service.schemas.strike import PAPER

from .calibrations import answered, history_at, strike_at
from .many import ROUGH

LIGHT = PAPER["projectile"] | {"mass_kg": 2.0}
"""Projectile with a mean density of about 860 kg/m³, less than water."""
AT_20 = {"velocity_m_s": 100.0, "oblique_angle_deg": 20.0}
WALL = PAPER["target"] | {"thickness_m": 0.2}
SPEED = {"field": "impact.velocity_m_s", "distribution": {"type": "normal", "mean": 100.0, "standard_deviation": 1.0}}
STUDY = {"uncertain": [SPEED], "sampling": {"half_width": 0.2, "max_samples": 512}}
OPERATIONS: dict[str, dict[str, Any]] = {
    "/trajectory": {"impact": AT_20},
    "/cra": {"search": ROUGH},
    "/thickness": {"impact": AT_20},
    "/limit-speed": {"target": WALL, "impact": {"oblique_angle_deg": 20.0}},
    "/formulas": {"impact": AT_20},
    "/cra/uncertainty": STUDY | {"search": ROUGH, "sensitivity": False},
    "/trajectory/uncertainty": STUDY | {"impact": AT_20},
}
ON_A_LINE = [[0.12 * i / 7, 0.04 * i / 7] for i in range(8)]
"""Points of a cone. Because of rounding, one slope exceeds the slope before it by one unit in the last place."""


def densities(answer: dict[str, Any]) -> list[str]:
    return [each["detail"] for each in answer["warnings"] if each["code"] == "mean_density_unusual"]


@pytest.mark.parametrize("path", OPERATIONS)
def test_implausible_mean_density_is_named(client: httpx.Client, path: str) -> None:
    usual = {name: part for name, part in PAPER.items() if name != "impact"} | {"impact": {"velocity_m_s": 100.0}}
    body = usual | OPERATIONS[path]
    (detail,) = densities(answered(client, path, body | {"projectile": LIGHT}))
    assert "kg/m³, outside 1000 to 20,000 kg/m³" in detail
    assert densities(answered(client, path, body)) == []


def test_calibrations_name_an_implausible_mean_density(client: httpx.Client) -> None:
    motion = strike_at(30.0, history_at(client, 30.0, 8.0))
    assert densities(answered(client, "/calibration/motion", motion)) == []
    (_,) = densities(answered(client, "/calibration/motion", motion | {"projectile": LIGHT}))
    tests = [{name: test[name] for name in ("velocity_m_s", "depth_m")} for test in TABLE_1]
    body = {"projectile": PAPER["projectile"], "target": PAPER["target"], "tests": tests}
    assert densities(answered(client, "/calibration/depth", body)) == []
    # With a mass of 2 kg the original depths would need an S below its bound.
    shallow = [test | {"depth_m": test["depth_m"] / 3.0} for test in tests]
    (_,) = densities(answered(client, "/calibration/depth", body | {"projectile": LIGHT, "tests": shallow}))
    light = [shallow[0] | {"mass_kg": 2.0}, *tests[1:]]
    (_,) = densities(answered(client, "/calibration/depth", body | {"tests": light}))


def test_profile_with_points_on_a_line_is_answered_like_a_cone(client: httpx.Client) -> None:
    noses = [{"shape": "profile", "points": ON_A_LINE}, {"shape": "profile", "points": [[0.0, 0.0], [0.12, 0.04]]}]
    bases = [PAPER | {"search": ROUGH, "projectile": PAPER["projectile"] | {"nose": nose}} for nose in noses]
    axes = [{"field": "impact.velocity_m_s", "values": [200.0, 238.0]}]
    first, second = (client.post("/cra/sweep", json={"base": base, "axes": axes}).json()["results"] for base in bases)
    angles = [[item["result"]["critical_angle_deg"] for item in items] for items in (first, second)]
    assert angles[0] == pytest.approx(angles[1], abs=1e-9)
    study = answered(client, "/cra/uncertainty", bases[0] | STUDY | {"sensitivity": False})
    assert (study["samples_failed"], study["samples_outside"]) == (0, 0)


SPHERE = {"nose": {"shape": "sphere"}, "diameter_m": 0.08, "length_m": 0.08, "mass_kg": 2.1}
BOAT_TAIL = {"length_m": 0.1, "base_diameter_m": 0.06}


def test_tapering_bodies_are_accepted_and_distinguished(client: httpx.Client) -> None:
    """Searches, trajectories and sweeps accept tapered bodies, and the search finds a different angle for each."""
    plain = PAPER["projectile"]
    closed = {"shape": "profile", "points": [[0.0, 0.0], [0.2, 0.04], [0.53, 0.0]]}
    bodies = [plain, SPHERE, plain | {"boat_tail": BOAT_TAIL}, plain | {"nose": closed}]
    angles = [answered(client, "/cra", PAPER | {"projectile": body})["critical_angle_deg"] for body in bodies]
    assert len(set(angles)) == 4
    sweep = {
        "base": PAPER | {"projectile": bodies[2], "search": ROUGH},
        "axes": [{"field": "projectile.boat_tail.base_diameter_m", "values": [0.02, 0.08]}],
    }
    _, level = (item["result"] for item in answered(client, "/cra/sweep", sweep)["results"])
    whole = answered(client, "/cra", PAPER | {"search": ROUGH})
    assert level["critical_angle_deg"] == pytest.approx(whole["critical_angle_deg"], abs=0.01)
    for body in bodies[1:]:
        strike = {
            "projectile": body,
            "target": PAPER["target"],
            "impact": PAPER["impact"] | {"oblique_angle_deg": 30.0},
        }
        assert answered(client, "/trajectory", strike)["outcome"] == "embedded"
