"""Random strikes as the contract has them, and the solver's calls they come to."""

import math
from collections.abc import Iterable
from typing import Any

import orjson

from benchmarks.random_cases import Case, Cases, one_by_one
from service.schemas import CriticalAngleRequest
from solver import ElasticPlastic, MohrCoulomb, Ogive, StrengthPowerLaw


def to_requests(cases: Cases) -> list[dict[str, Any]]:
    """Cases as `/cra` requests."""
    return [to_request(case) for case in one_by_one(cases)]


def to_request(case: Case) -> dict[str, Any]:
    """A case as a `/cra` request."""
    projectile, target, resistance = case["projectile"], case["target"], case["resistance"]
    nose, decay = projectile.nose, resistance.free_surface
    power_law = isinstance(resistance.strength_factor, StrengthPowerLaw)
    free_surface: dict[str, Any] = {"model": decay.name}
    assert isinstance(nose, Ogive)  # noqa: S101
    if isinstance(decay, ElasticPlastic | MohrCoulomb):
        free_surface["inertia"] = decay.inertia
    return {
        "projectile": {
            "nose": {"shape": "ogive", "caliber_radius_head": nose.caliber_radius_head},
            "diameter_m": projectile.diameter,
            "length_m": projectile.length,
            "mass_kg": projectile.mass,
        },
        "target": {
            "compressive_strength_pa": target.compressive_strength,
            "density_kg_m3": target.density,
        },
        "impact": {
            "velocity_m_s": case["velocity"],
            "angle_of_attack_deg": math.degrees(case["angle_of_attack"]),
        },
        "resistance": {
            "strength_factor": {"model": "strength_power_law" if power_law else "obliquity_polynomial"},
            "free_surface": free_surface,
        },
    }


def to_lines(requests: Iterable[dict[str, Any]]) -> bytes:
    """A JSONL body."""
    return b"".join(orjson.dumps(request) + b"\n" for request in requests)


def to_arguments(request: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `solver.critical_angle` that the service makes of a request, so that answers can be compared."""
    arguments, _ = CriticalAngleRequest.model_validate(request).arguments()
    return arguments
