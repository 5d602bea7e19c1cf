"""Properties of random strikes: mirror symmetry, independence of units, energy balance, and effect of strength."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from solver import (
    ConstantStrengthFactor,
    Impact,
    Motion,
    Numerics,
    Profile,
    Projectile,
    Target,
    Trajectory,
    simulate,
)
from solver.arrays import FloatArray, gauss_rule
from solver.motion import sample, sample_loads
from solver.prepared import integrate, prepare

from .strikes import known, mirrored, strikes

few = settings(max_examples=20, deadline=None, derandomize=True, database=None)
"""Hypothesis settings: the same 20 examples in every run; no more, because one that slides to rest takes a second."""


def transit(strike: dict[str, Any]) -> float:
    """Return the time in which the projectile travels its length at impact speed. [s]"""
    return float(strike["projectile"].length / strike["impact"].velocity)


def run(strike: dict[str, Any], *, samples_a_transit: int = 50) -> Trajectory:
    """Simulate a strike for up to twenty times its `transit`."""
    time = transit(strike)
    numerics = Numerics(termination_time=20.0 * time)
    return simulate(**strike, numerics=numerics, sample_interval=time / samples_a_transit)


def history(trajectory: Trajectory) -> Motion[FloatArray]:
    return known(trajectory.history)


@few
@given(strikes())
def test_mirrored_impact_gives_mirrored_path(strike: dict[str, Any]) -> None:
    """Paths agree to 10⁻⁴ of the length and 0.01°; rounding affects the steps when a shank rests in its hole."""
    one, other = run(strike), run({**strike, "impact": mirrored(strike["impact"])})
    a, b = history(one), history(other)
    assert one.outcome is other.outcome
    both = min(a.time.size, b.time.size) - 1
    assert both > 0
    length = strike["projectile"].length
    for left, right, scale in (
        (a.nose_tip_depth, b.nose_tip_depth, length),
        (a.center_of_gravity_lateral, -b.center_of_gravity_lateral, length),
        (a.axis_angle, -b.axis_angle, math.radians(100.0)),
    ):
        np.testing.assert_allclose(left[:both], right[:both], rtol=0, atol=1e-4 * scale)


def in_other_units(strike: dict[str, Any], *, length: float, time: float, mass: float) -> dict[str, Any]:
    """Return the same strike in other units; the arguments are one metre, second and kilogram in these units."""
    projectile, target, impact = strike["projectile"], strike["target"], strike["impact"]
    nose, stress = projectile.nose, mass / (length * time**2)
    if isinstance(nose, Profile):
        nose = Profile(points=tuple((length * x, length * r) for x, r in nose.points))
    return {
        "projectile": Projectile(
            nose=nose,
            diameter=length * projectile.diameter,
            length=length * projectile.length,
            mass=mass * projectile.mass,
        ),
        "target": Target(
            compressive_strength=stress * target.compressive_strength,
            density=mass / length**3 * target.density,
            youngs_modulus=stress * target.youngs_modulus,
            poissons_ratio=target.poissons_ratio,
        ),
        "impact": replace(
            impact, velocity=length / time * impact.velocity, angular_velocity=impact.angular_velocity / time
        ),
        "resistance": strike["resistance"],
    }


@few
@given(strikes(), st.integers(-3, 3), st.integers(-1, 1), st.integers(-1, 1))
def test_motion_does_not_depend_on_units(strike: dict[str, Any], length: int, speed: int, density: int) -> None:
    """A strike scaled in size and mass, or in speed and strength, has the same motion.

    The model has no built-in length, time or mass. Scaling by powers of two keeps all digits, so results agree to
    rounding. Lengths are scaled by 1/8 to 8, speeds and densities by 1/2 to 2, within the bounds of the inputs.
    """
    units = {"length": 2.0**length, "time": 2.0 ** (length - speed), "mass": 2.0 ** (3 * length + density)}
    one, other = run(strike), run(in_other_units(strike, **units))
    assert one.outcome is other.outcome
    a, b = history(one), history(other)
    for found, expected in (
        (b.time / units["time"], a.time),
        (b.nose_tip_depth / units["length"], a.nose_tip_depth),
        (b.axis_angle, a.axis_angle),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@few
@given(strikes())
def test_kinetic_energy_never_increases(strike: dict[str, Any]) -> None:
    """From one output time to the next the energy may grow by 10⁻⁶ of its initial value, the accuracy of a run."""
    energy = history(run(strike, samples_a_transit=200)).kinetic_energy
    assert np.diff(energy).max(initial=0.0) < 1e-6 * energy[0]


@few
@given(strikes())
def test_work_of_the_resistance_equals_the_energy_lost(strike: dict[str, Any]) -> None:
    """The work and the lost energy agree to 10⁻⁶ of the initial energy.

    The power is integrated by Gauss points within each step, because it jumps between steps.
    """
    prepared = prepare(
        projectile=strike["projectile"],
        target=strike["target"],
        resistance=strike["resistance"],
        numerics=Numerics(termination_time=20.0 * transit(strike), relative_tolerance=1e-7).resolved(),
    )
    model = prepared.model._replace(law=prepared.law_at(strike["impact"]))
    run, steps = integrate(prepared, model, strike["impact"], keep_steps=True)
    begin = steps[:, 0]
    span = np.clip(run.time - begin, 0.0, steps[:, 1])
    rule = gauss_rule(12)
    states = sample(steps, (begin[:, None] + span[:, None] * rule[:, 0]).ravel())
    power = (sample_loads(states, model) * states[:, 3:]).sum(axis=1).reshape(span.size, -1)
    work = float(span @ (power @ rule[:, 1]))

    body = model.body
    inertia = 0.5 * np.array([body.mass, body.mass, body.moment_of_inertia])
    initial, final = inertia @ steps[0, 5:8] ** 2, inertia @ run.state[3:] ** 2
    assert abs(final - initial - work) < 1e-6 * initial


@few
@given(strikes(), st.floats(1.01, 3.0))
def test_stronger_concrete_gives_less_normal_depth(strike: dict[str, Any], factor: float) -> None:
    target, resistance = strike["target"], strike["resistance"]
    normal = {**strike, "impact": Impact(velocity=strike["impact"].velocity, oblique_angle=0.0)}
    soft = simulate(**normal, numerics=Numerics(termination_time=1.0), sample_interval=None)
    stronger = replace(target, compressive_strength=factor * target.compressive_strength)
    larger = ConstantStrengthFactor(value=factor * resistance.strength_factor.value)
    for change in ({"target": stronger}, {"resistance": replace(resistance, strength_factor=larger)}):
        hard = simulate(**{**normal, **change}, numerics=Numerics(termination_time=1.0), sample_interval=None)
        assert hard.final.nose_tip_depth < soft.final.nose_tip_depth
