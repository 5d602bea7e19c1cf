"""Projectiles, decay laws and random strikes that several tests use."""

import math
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import strategies as st

from solver import (
    BoatTail,
    Conical,
    ConstantStrengthFactor,
    ElasticPlastic,
    Flat,
    Impact,
    MohrCoulomb,
    Motion,
    NoFreeSurface,
    Numerics,
    Ogive,
    Profile,
    Projectile,
    Resistance,
    Sphere,
    Spherical,
    Target,
    Trajectory,
    simulate,
    solid_properties,
)
from solver.arrays import FloatArray
from solver.free_surface import FreeSurface
from solver.projectile import NoseShape
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact

CASE: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
"""The paper's projectile and concrete, as arguments of solver functions."""
LI_CHEN = Projectile(nose=Ogive(caliber_radius_head=2.0), diameter=0.0269, length=0.242, mass=0.906)
LI_CHEN_TARGET = Target(compressive_strength=35.2e6, density=2370.0)
"""Target of an experiment by Forrestal et al. (1994), with a depth of 173 mm at 277 m/s. Li and Chen (2003)
calculate with S = 12."""
STEEL = 7850.0
"""Density of steel. [kg/m³]"""
DIAMETER = 0.08
"""Diameter of the paper's projectile. [m]"""

NOSES: dict[str, NoseShape] = {
    "ogive": Ogive(caliber_radius_head=3.0),
    "slender ogive": Ogive(caliber_radius_head=10.0),
    "ogive as hemisphere": Ogive(caliber_radius_head=0.5),
    "cone": Conical(length_to_diameter=1.5),
    "slender cone": Conical(length_to_diameter=5.0),
    "blunt cone": Conical(length_to_diameter=0.2),
    "hemisphere": Spherical(caliber_radius_head=0.5),
    "cap": Spherical(caliber_radius_head=1.2),
    "flat": Flat(),
    "truncated cone": Profile(points=((0.0, 0.016), (0.1, 0.04))),
    "three cones": Profile(points=((0.0, 0.0), (0.03, 0.02), (0.08, 0.034), (0.14, 0.04))),
}
"""Every kind of nose, for a shank with the diameter of the paper's projectile."""

DECAYS: dict[str, FreeSurface] = {
    "elastic-plastic": ElasticPlastic(),
    "elastic-plastic with inertia": ElasticPlastic(inertia=True),
    "mohr-coulomb": MohrCoulomb(),
    "mohr-coulomb with inertia": MohrCoulomb(inertia=True),
    "none": NoFreeSurface(),
}


def mirrored(impact: Impact) -> Impact:
    """Return the impact mirrored in the plane through the normal that is perpendicular to the plane of incidence."""
    return replace(
        impact,
        oblique_angle=-impact.oblique_angle,
        angle_of_attack=-impact.angle_of_attack,
        angular_velocity=-impact.angular_velocity,
    )


def power(motion: Motion[FloatArray]) -> FloatArray:
    """Return the power of the resistance. [W]"""
    translation = motion.depth_force * motion.depth_velocity + motion.lateral_force * motion.lateral_velocity
    return np.asarray(translation + motion.moment * motion.angular_velocity)


def assert_work_is_the_energy_lost(motion: Motion[FloatArray], *, rel: float) -> None:
    """Check that the work of the resistance equals the energy lost, within the relative tolerance `rel`.

    From one sample to the next the energy may rise by 10⁻⁶ of its initial value.
    """
    energy = motion.kinetic_energy
    assert np.trapezoid(power(motion), motion.time) == pytest.approx(energy[-1] - energy[0], rel=rel)
    assert np.diff(energy).max() <= 1e-6 * energy[0]


def assert_panels_follow_the_gauss_points(**strike: Any) -> None:
    """Check that both methods agree within 0.3 mm for the tip and 0.1° for the axis, every tenth of a millisecond."""
    gauss, panels = (
        known(simulate(**strike, numerics=numerics, sample_interval=1e-4).history)
        for numerics in (
            Numerics(stations=24, points=8),
            Numerics(method="panels", panels=12_000, time_step=1e-6, termination_time=0.015),
        )
    )
    count = min(gauss.time.size, panels.time.size) - 1
    assert count > 10
    np.testing.assert_allclose(gauss.nose_tip_depth[:count], panels.nose_tip_depth[:count], rtol=0, atol=3e-4)
    ours, theirs = (np.degrees(each.axis_angle[:count]) for each in (gauss, panels))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=0.1)


Value = TypeVar("Value")


def known(value: Value | None) -> Value:
    """Return a value after checking that it is not None."""
    assert value is not None
    return value


def codes(answer: Any) -> set[str]:
    return {warning.code for warning in answer.warnings}


def steel(
    nose: NoseShape, *, diameter: float = DIAMETER, length: float = 0.53, boat_tail: BoatTail | None = None
) -> Projectile:
    """Return a solid steel projectile of this shape."""
    shape = Projectile(nose=nose, diameter=diameter, length=length, mass=1.0, boat_tail=boat_tail)
    return replace(shape, mass=STEEL * solid_properties(shape).volume)


def paper_run(degrees: float, **changes: Any) -> Trajectory:
    """Simulate the paper's strike at this oblique angle. [°]"""
    return simulate(**CASE | {"impact": paper_impact(oblique_angle_degrees=degrees)} | changes)


TAPERING: dict[str, Projectile] = {
    "sphere": steel(Sphere(), length=DIAMETER),
    "boat-tail": steel(NOSES["ogive"], boat_tail=BoatTail(length=0.1, base_diameter=0.05)),
    "stubby boat-tail": steel(Flat(), length=0.12, boat_tail=BoatTail(length=0.02, base_diameter=0.01)),
    "double cone": steel(Profile(points=((0.0, 0.0), (0.1, 0.04), (0.13, 0.0))), length=0.13),
    "barrel": steel(Profile(points=((0.0, 0.02), (0.03, 0.04), (0.1, 0.04), (0.15, 0.02))), length=0.15),
}
"""Bodies that taper behind their widest point."""


@st.composite
def noses(draw: st.DrawFn, *, radius: float) -> NoseShape:
    """Draw a nose for a shank of this radius. [m]"""
    kind = draw(st.sampled_from(["ogive", "conical", "spherical", "flat", "profile"]))
    if kind == "ogive":
        return Ogive(caliber_radius_head=draw(st.floats(0.5, 10.0)))
    if kind == "conical":
        return Conical(length_to_diameter=draw(st.floats(0.2, 5.0)))
    if kind == "spherical":
        return Spherical(caliber_radius_head=draw(st.floats(0.5, 5.0)))
    if kind == "flat":
        return Flat()
    steps = draw(st.lists(st.floats(0.1, 1.0), min_size=2, max_size=6))
    slopes = np.cumsum(draw(st.lists(st.floats(0.05, 0.6), min_size=len(steps), max_size=len(steps))))[::-1]
    heights = np.concatenate(([draw(st.sampled_from([0.0, 0.3]))], np.array(steps) * slopes)).cumsum()
    x = np.concatenate(([0.0], np.cumsum(steps))) / heights[-1]
    r = heights / heights[-1]
    points = [(radius * float(a), radius * float(b)) for a, b in zip(x, r, strict=True)]
    return Profile(points=(*points[:-1], (points[-1][0], radius)))


@st.composite
def strikes(draw: st.DrawFn) -> dict[str, Any]:
    """Draw arguments of `solver.simulate` for a steel projectile that strikes concrete nose first."""
    diameter = draw(st.floats(0.01, 0.3))
    nose = draw(noses(radius=diameter / 2.0))
    length = nose.length(diameter / 2.0) + diameter * draw(st.floats(1.0, 8.0))
    resistance = Resistance(
        strength_factor=ConstantStrengthFactor(value=draw(st.floats(4.0, 12.0))),
        inertia_factor=draw(st.sampled_from([0.0, 0.5, 1.0])),
        free_surface=draw(st.sampled_from(list(DECAYS.values()))),
    )
    target = Target(
        compressive_strength=draw(st.floats(15e6, 100e6)),
        density=draw(st.floats(1900.0, 2600.0)),
        youngs_modulus=draw(st.floats(10e9, 50e9)),
        poissons_ratio=draw(st.floats(0.1, 0.5)),
    )
    velocity = draw(st.floats(50.0, 800.0))
    impact = Impact(
        velocity=velocity,
        oblique_angle=math.radians(draw(st.floats(0.0, 80.0))),
        angle_of_attack=math.radians(draw(st.floats(-8.0, 8.0))),
        angular_velocity=draw(st.floats(-0.1, 0.1)) * velocity / length,
    )
    return {
        "projectile": steel(nose, diameter=diameter, length=length),
        "target": target,
        "impact": impact,
        "resistance": resistance,
    }
