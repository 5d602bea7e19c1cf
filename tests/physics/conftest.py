"""Histories of an independent brute-force program (tests/reference), and the strikes that they belong to."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver import (
    ConstantStrengthFactor,
    ElasticPlastic,
    Impact,
    MohrCoulomb,
    NoFreeSurface,
    Ogive,
    Projectile,
    Resistance,
    Target,
)
from solver.arrays import FloatArray
from solver.free_surface import FreeSurface

REFERENCE = Path(__file__).parents[1] / "reference"
HISTORIES = json.loads((REFERENCE / "trajectories.json").read_text())


@dataclass(frozen=True)
class Reference:
    """A history of the brute-force program, with the arguments of `solver.simulate` for the same strike."""

    name: str
    strike: dict[str, Any]
    time: FloatArray
    nose_tip_depth: FloatArray
    axis_angle_degrees: FloatArray
    center_of_gravity: float
    moment_of_inertia: float


def read(history: dict[str, Any]) -> Reference:
    inputs = history["inputs"]
    inertia = inputs["free_surface_inertia"]
    decays: dict[str, FreeSurface] = {
        "elastic_plastic": ElasticPlastic(inertia=inertia),
        "mohr_coulomb": MohrCoulomb(inertia=inertia),
        "none": NoFreeSurface(),
    }
    strike = {
        "projectile": Projectile(
            nose=Ogive(caliber_radius_head=inputs["caliber_radius_head"]),
            diameter=inputs["diameter_m"],
            length=inputs["length_m"],
            mass=inputs["mass_kg"],
        ),
        "target": Target(
            compressive_strength=inputs["compressive_strength_pa"],
            density=inputs["density_kg_m3"],
            youngs_modulus=inputs["youngs_modulus_pa"],
            poissons_ratio=inputs["poissons_ratio"],
        ),
        "impact": Impact(
            velocity=inputs["velocity_m_s"],
            oblique_angle=math.radians(inputs["oblique_angle_deg"]),
            angle_of_attack=math.radians(inputs["angle_of_attack_deg"]),
        ),
        "resistance": Resistance(
            strength_factor=ConstantStrengthFactor(value=inputs["S"]),
            inertia_factor=inputs["B"],
            free_surface=decays[inputs["free_surface"]],
        ),
    }
    return Reference(
        name=history["name"],
        strike=strike,
        time=np.array(history["time_s"]),
        nose_tip_depth=np.array(history["nose_tip_depth_m"]),
        axis_angle_degrees=np.array(history["axis_angle_deg"]),
        center_of_gravity=history["derived"]["center_of_gravity_m"],
        moment_of_inertia=history["derived"]["moment_of_inertia_kg_m2"],
    )


@pytest.fixture(params=HISTORIES, ids=lambda history: history["name"])
def reference(request: pytest.FixtureRequest) -> Reference:
    return read(request.param)
