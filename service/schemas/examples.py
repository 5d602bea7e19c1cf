"""The examples of the contract: the paper's strike and others. Each is sent to a running service by a test."""

from typing import Any

from service.schemas.projectile import PROFILE, PROJECTILE, SPHERICAL
from service.schemas.resistance import CONSTANT, MOHR_COULOMB
from service.schemas.strike import STRIKE, TARGET

PAPER: dict[str, Any] = {"projectile": PROJECTILE, "target": TARGET, "impact": STRIKE}
PAPER_AT_45 = PAPER | {"impact": STRIKE | {"oblique_angle_deg": 45.0}}
PAPER_BY_SECANT = PAPER | {"search": {"method": "secant"}, "numerics": {"panels": 3000}}

TRUNCATED_CONE = {
    "projectile": PROJECTILE | {"nose": PROFILE, "center_of_gravity_m": 0.29, "moment_of_inertia_kg_m2": 0.25},
    "target": TARGET | {"youngs_modulus_pa": 29.5e9, "poissons_ratio": 0.2},
    "impact": {"velocity_m_s": 300.0, "oblique_angle_deg": 60.0, "angle_of_attack_deg": -1.0},
    "resistance": {"strength_factor": CONSTANT, "free_surface": MOHR_COULOMB},
    "numerics": {"method": "panels", "panels": 3000, "time_step_s": 2e-5, "termination_time_s": 0.01},
    "output": {"history": True, "sample_interval_s": 1e-4},
}
HEMISPHERE = PAPER | {
    "projectile": PROJECTILE | {"nose": SPHERICAL},
    "resistance": {"strength_factor": {"model": "strength_power_law"}, "free_surface": {"model": "none"}},
    "search": {"lower_deg": 30.0, "upper_deg": 80.0, "tolerance_deg": 0.1},
    "output": {"history": True, "sample_interval_s": 1e-4},
}
