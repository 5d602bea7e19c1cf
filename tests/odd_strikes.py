"""Random request bodies for `/verdict`, of every kind that verdicts distinguish; equal seeds give equal bodies."""

from typing import Any

import numpy as np

from service.schemas import ReportRequest
from solver import closed_form_depth

KINDS = ("half_space", "wall", "sphere", "own_shots", "chosen_law", "no_angle", "always_ricochet")
OWN_LAWS: tuple[dict[str, Any], ...] = (
    {"free_surface": {"model": "none"}},
    {"free_surface": {"model": "mohr_coulomb"}},
    {"strength_factor": {"model": "constant", "value": 7.0}},
    {"strength_factor": {"model": "obliquity_polynomial", "coefficients": [9.0, 0.0, -0.0005]}},
    {"strength_factor": {"model": "strength_power_law"}, "free_surface": {"model": "mohr_coulomb", "inertia": True}},
)
LAWS: tuple[dict[str, Any], ...] = (
    {},
    {"strength_factor": {"model": "published_tests"}},
    {"strength_factor": {"model": "strength_power_law"}},
)


def odd_strikes(count: int, seed: int) -> list[dict[str, Any]]:
    """Return `count` random strikes, taking the kinds in turn.

    The velocity is 40 to 900 m/s, the strength 15 to 90 MPa, and the diameter 15 to 250 mm. The angle of attack is 0
    in two of three strikes, otherwise -4 to 4°. Bodies are spheres, or have an ogival, conical, spherical or flat nose.
    """
    random = np.random.default_rng(seed)
    return [_strike(random, KINDS[index % len(KINDS)]) for index in range(count)]


def _strike(random: np.random.Generator, kind: str) -> dict[str, Any]:
    diameter = float(np.exp(random.uniform(np.log(0.015), np.log(0.25))))
    nose, length = _nose(random, kind)
    volume = 0.785 * diameter**2 * length * diameter * (0.667 if kind == "sphere" else 0.9)
    projectile: dict[str, Any] = {
        "nose": nose,
        "diameter_m": diameter,
        "mass_kg": random.uniform(4000.0, 9000.0) * volume,
    }
    projectile["length_m"] = length * diameter
    target: dict[str, Any] = {
        "compressive_strength_pa": random.uniform(15e6, 90e6),
        "density_kg_m3": random.uniform(2000.0, 2600.0),
    }
    impact: dict[str, Any] = {"velocity_m_s": float(np.exp(random.uniform(np.log(40.0), np.log(900.0))))}
    impact["angle_of_attack_deg"] = float(random.choice([0.0, 0.0, random.uniform(-4.0, 4.0)]))
    if kind != "no_angle":
        impact["oblique_angle_deg"] = round(random.uniform(0.0, 85.0), 1)
    resistance = dict(LAWS[random.integers(len(LAWS))])
    strike: dict[str, Any] = {"projectile": projectile, "target": target, "impact": impact, "resistance": resistance}
    if kind == "wall" or (kind == "no_angle" and random.random() < 0.5):
        target["thickness_m"] = diameter * random.uniform(0.5, 12.0)
    elif kind == "own_shots":
        strike["resistance"] = {"strength_factor": {"model": "own_tests", "shots": _shots(random, strike)}}
    elif kind == "chosen_law":
        strike["resistance"] = dict(OWN_LAWS[random.integers(len(OWN_LAWS))])
    elif kind == "always_ricochet":
        strike["search"] = {"lower_deg": 60.0}
    return strike


def _nose(random: np.random.Generator, kind: str) -> tuple[dict[str, Any], float]:
    """Return a random nose, and the ratio of the body's length to its diameter."""
    if kind == "sphere":
        return {"shape": "sphere"}, 1.0
    length = random.uniform(3.0, 9.0)
    noses: list[dict[str, Any]] = [
        {"shape": "ogive", "caliber_radius_head": random.uniform(1.5, 6.0)},
        {"shape": "conical", "length_to_diameter": random.uniform(0.3, 2.0)},
        {"shape": "spherical", "caliber_radius_head": random.uniform(0.5, 2.0)},
        {"shape": "flat"},
    ]
    return noses[random.integers(len(noses))], length


def _shots(random: np.random.Generator, strike: dict[str, Any]) -> list[dict[str, float]]:
    """Return one to four shots with depths that the closed form gives for a random strength factor."""
    request = ReportRequest.model_validate(strike)
    body, concrete = request.projectile.to_solver(), request.target.to_solver()
    shots = []
    for _ in range(random.integers(1, 5)):
        velocity = random.uniform(200.0, 600.0)
        factor = 7.0 * float(np.exp(random.normal(0.0, 0.25)))
        depth = closed_form_depth(projectile=body, target=concrete, velocity=velocity, strength_factor=factor)
        shots.append({"velocity_m_s": velocity, "depth_m": depth})
    return shots
