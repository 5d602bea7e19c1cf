"""The closed form for the depth in normal impact."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from solver import (
    Conical,
    Flat,
    Ogive,
    Projectile,
    Spherical,
    closed_form_depth,
)
from solver.resistance import nose_factor

from .strikes import LI_CHEN, LI_CHEN_TARGET, NOSES, known, steel


def depth(velocity: float, *, projectile: Projectile = LI_CHEN, strength_factor: float = 12.0) -> float:
    return closed_form_depth(
        projectile=projectile, target=LI_CHEN_TARGET, velocity=velocity, strength_factor=strength_factor
    )


def test_depth_equals_the_worked_example_of_li_and_chen() -> None:
    assert depth(277.0) == pytest.approx(0.1672, abs=0.5e-4)


@pytest.mark.parametrize("crh", [0.5, 1.0, 2.0, 3.0, 10.0])
def test_nose_factor_of_an_ogive_agrees_with_forrestal(crh: float) -> None:
    assert nose_factor(steel(Ogive(caliber_radius_head=crh))) == pytest.approx((8.0 * crh - 1.0) / (24.0 * crh**2))


def test_nose_factors_of_cones_caps_and_flat_faces_have_published_values() -> None:
    """By Chen and Li (2002): 1/(1 + 4ψ²) for a cone of ψ diameters, 1 - 1/(8ψ²) for a cap, and 1 for a flat face."""
    assert nose_factor(steel(Flat())) == pytest.approx(1.0)
    for slenderness in (0.2, 1.5, 5.0):
        cone = nose_factor(steel(Conical(length_to_diameter=slenderness)))
        assert cone == pytest.approx(1.0 / (1.0 + 4.0 * slenderness**2))
    for crh in (0.5, 1.2, 3.0):
        assert nose_factor(steel(Spherical(caliber_radius_head=crh))) == pytest.approx(1.0 - 1.0 / (8.0 * crh**2))


@pytest.mark.parametrize("velocity", [120.0, 200.0, 277.0, 800.0])
@pytest.mark.parametrize("name", ["ogive", "cone", "flat"])
def test_depth_equals_the_integrated_force_law(name: str, velocity: float) -> None:
    """In the crater the force is c z, and beyond it that of eq. 1 on the whole nose; c makes the force continuous."""
    projectile, static = steel(NOSES[name]), 12.0 * LI_CHEN_TARGET.compressive_strength
    inertia, area = nose_factor(projectile) * LI_CHEN_TARGET.density, math.pi * projectile.radius**2
    crater = 2.0 * projectile.diameter
    mass = projectile.mass
    at_end = (mass * velocity**2 - area * crater * static) / (mass + area * crater * inertia)
    stiffness = area * (static + inertia * max(at_end, 0.0)) / crater

    def slope(z: float, energy: np.ndarray) -> list[float]:
        square = 2.0 * float(energy[0]) / mass
        return [-stiffness * z if z < crater else -area * (static + inertia * square)]

    def at_rest(z: float, energy: np.ndarray) -> float:
        return float(energy[0])

    at_rest.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(slope, (0.0, 20.0), [0.5 * mass * velocity**2], events=at_rest, rtol=1e-9, max_step=0.01)
    assert depth(velocity, projectile=projectile) == pytest.approx(known(run.t_events)[0][0], rel=1e-4)


def test_depth_is_continuous_at_the_end_of_the_crater() -> None:
    limit = math.sqrt(4.0 * math.pi * LI_CHEN.radius**3 * 12.0 * LI_CHEN_TARGET.compressive_strength / LI_CHEN.mass)
    crater = 2.0 * LI_CHEN.diameter
    assert depth(limit * (1.0 - 1e-9)) == pytest.approx(crater)
    assert depth(limit * (1.0 + 1e-9)) == pytest.approx(crater)
    assert depth(0.5 * limit) == pytest.approx(0.5 * crater)
