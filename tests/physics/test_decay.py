"""The free-surface decay f, compared with a table, its limits and the equations of the cavity."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp

from solver import ElasticPlastic, MohrCoulomb, NoFreeSurface, Target, decay_factor
from solver.arrays import FloatArray
from solver.free_surface import Decay, FreeSurface, build_decay, decay_at

from .strikes import DECAYS

TABLE_RATIOS = np.array([1.25, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0, 20.0, 50.0])
TABLE: dict[str, tuple[FreeSurface, float, float, list[float]]] = {
    "elastic-plastic, ν 0.5": (
        *(ElasticPlastic(), 0.5, 0.0),
        [0.0927, 0.1684, 0.2879, 0.4563, 0.6685, 0.8636, 0.9302, 0.9913, 0.9994],
    ),
    "elastic-plastic, ν 0.2": (
        *(ElasticPlastic(), 0.2, 0.0),
        [0.0991, 0.1801, 0.3079, 0.4880, 0.7150, 0.9088, 0.9533, 0.9942, 0.9996],
    ),
    "mohr-coulomb": (
        *(MohrCoulomb(), 0.5, 0.0),
        [0.0239, 0.0473, 0.0935, 0.1832, 0.3564, 0.6067, 0.7797, 0.9725, 0.9982],
    ),
    "elastic-plastic, ν 0.2, inertia, 238 m/s": (
        *(ElasticPlastic(inertia=True), 0.2, 238.0),
        [0.0839, 0.1785, 0.3320, 0.5254, 0.7248, 0.8695, 0.9082, 0.9625, 0.9859],
    ),
}
"""Model, Poisson's ratio, velocity and f at `TABLE_RATIOS`, computed by an independent program. [1, m/s, 1]"""

RATIOS = np.concatenate(([1.0], np.geomspace(1.001, 1e4, 60)))
VELOCITIES = (0.0, 40.0, 238.0, 800.0)


def concrete(poissons_ratio: float = 0.5) -> Target:
    return Target(compressive_strength=39e6, density=2250.0, youngs_modulus=29.5e9, poissons_ratio=poissons_ratio)


@pytest.fixture(params=DECAYS)
def model(request: pytest.FixtureRequest) -> FreeSurface:
    return DECAYS[request.param]


@pytest.mark.parametrize("name", TABLE)
def test_decay_equals_the_printed_table(name: str) -> None:
    model, poissons_ratio, velocity, expected = TABLE[name]
    factor = decay_factor(
        model=model, target=concrete(poissons_ratio), radius_ratio=TABLE_RATIOS, normal_velocity=velocity
    )
    np.testing.assert_allclose(factor, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize("velocity", VELOCITIES)
def test_decay_grows_from_zero_at_the_face_to_one_deep_inside(model: FreeSurface, velocity: float) -> None:
    ratios = np.concatenate((np.geomspace(1.0, 1e6, 2_000), [math.inf]))
    factor = decay_factor(model=model, target=concrete(), radius_ratio=ratios, normal_velocity=velocity)
    if isinstance(model, NoFreeSurface):
        np.testing.assert_array_equal(factor, 1.0)
        return
    assert abs(factor[0]) < 1e-12
    assert factor[-1] == 1.0
    assert np.all(np.diff(factor) >= -1e-14)
    assert np.all(np.diff(factor[ratios < 1e3]) > 0.0)


def wall_pressure(
    model: ElasticPlastic | MohrCoulomb, target: Target, radius_ratio: float, velocity: float, plastic_ratio: float
) -> float:
    """Radial stress at the wall of a cavity that grows at a constant speed v, integrated from the outer radius.

    With the cavity radius as unit, an incompressible solid moves at u = v/r², so Du/Dt = 2 v² (1/r² - 1/r⁵), and

        dσr/dr + (2/r) (σr - σθ) = -ρ Du/Dt,   σr = 0 at the outer radius.

    With y = 1/r an infinite solid can be integrated too. The elastic shell has σr - σθ = Y (c/r)³ (Lamé) around a
    plastic zone of radius c. Inside, σr - σθ is Y, or 3 (λ σr + τ) / (3 + 2λ) from λ p + τ with
    p = σr - 2 (σr - σθ) / 3.
    """
    dynamic = target.density * velocity**2 if model.inertia else 0.0
    if isinstance(model, MohrCoulomb):
        hardening = model.pressure_hardening
        yield_strength = (3.0 - hardening) * target.compressive_strength / 3.0
    else:
        hardening = 0.0
        yield_strength = target.compressive_strength
    interface = 1.0 / plastic_ratio

    def slope(y: float, stress: FloatArray, *, elastic: bool) -> FloatArray:
        difference_over_y: float | FloatArray
        if elastic:
            difference_over_y = yield_strength * y**2 / interface**3
        else:
            difference_over_y = 3.0 * (hardening * stress + yield_strength) / (3.0 + 2.0 * hardening) / y
        return np.asarray(2.0 * difference_over_y + 2.0 * dynamic * (1.0 - y**3))

    stress, place = np.zeros(1), 1.0 / radius_ratio
    for end, elastic in ((interface, True), (1.0, False)):
        if place < end:
            zone = partial(slope, elastic=elastic)
            stress = np.asarray(solve_ivp(zone, (place, end), stress, method="DOP853", rtol=1e-10, atol=1e-3).y[:, -1])
            place = end
    return float(stress[0])


@pytest.mark.parametrize("velocity", VELOCITIES)
@pytest.mark.parametrize("name", [name for name in DECAYS if name != "none"])
def test_closed_form_equals_the_integrated_momentum_equation(name: str, velocity: float) -> None:
    model = DECAYS[name]
    assert isinstance(model, ElasticPlastic | MohrCoulomb)
    for poissons_ratio in (0.5, 0.2):
        target = concrete(poissons_ratio)
        plastic_ratio = model.plastic_ratio(target)
        ratios = np.array([1.01, 1.25, 2.0, 5.0, 0.999 * plastic_ratio, plastic_ratio, 12.0, 50.0, 1e3])
        endless = wall_pressure(model, target, math.inf, velocity, plastic_ratio)
        expected = [wall_pressure(model, target, ratio, velocity, plastic_ratio) / endless for ratio in ratios]
        factor = decay_factor(model=model, target=target, radius_ratio=ratios, normal_velocity=velocity)
        np.testing.assert_allclose(factor, expected, rtol=0, atol=1e-6)


def test_plastic_zone_ends_where_the_elastic_shell_yields() -> None:
    """An incompressible solid around a cavity of radius 1 has 2E u/r = Y at r = c, with u = 1/(3c²)."""
    target = concrete()
    for model, strength in ((ElasticPlastic(), 39e6), (MohrCoulomb(), (3.0 - 2.0 / 3.0) * 39e6 / 3.0)):
        c = model.plastic_ratio(target)
        displacement = 1.0 / (3.0 * c**2)
        assert 2.0 * 29.5e9 * displacement / c == pytest.approx(strength, rel=1e-12)


def factors_at(inverse: FloatArray, velocity: float, decay: Decay) -> FloatArray:
    """Return f for reciprocals of the radius ratio."""
    factors = np.empty_like(inverse)
    for i in range(inverse.size):
        factors[i] = decay_at(1.0 - inverse[i], inverse[i], velocity, decay)
    return factors


compiled_factors: Any = njit(factors_at)
"""Compiled wrapper; Python cannot call `decay_at` itself, which only compiled code calls."""


@pytest.mark.parametrize("poissons_ratio", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("velocity", VELOCITIES)
def test_compiled_polynomials_follow_the_closed_form(
    model: FreeSurface, velocity: float, poissons_ratio: float
) -> None:
    """The points include the corner of f, and lie on both sides of it."""
    target = concrete(poissons_ratio)
    decay = build_decay(model, target)
    inverse = np.random.default_rng(1).uniform(0.0, 1.0, 20_000)
    inverse = np.concatenate((inverse, [0.0, 1.0], 1.0 / RATIOS))
    compiled = compiled_factors(inverse, velocity, decay)
    with np.errstate(divide="ignore"):
        exact = decay_factor(model=model, target=target, radius_ratio=1.0 / inverse, normal_velocity=velocity)
    assert np.abs(compiled - exact).max() < (5e-6 if decay.inertia_scale > 0.0 else 1e-7)
