"""Bending stress of the body by both methods, compared with independent values, closed forms and scaled strikes."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import (
    Bending,
    BoatTail,
    Conical,
    ConstantStrengthFactor,
    Crater,
    Flat,
    Impact,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    Ogive,
    ParameterError,
    Projectile,
    Resistance,
    Sphere,
    Spherical,
    Trajectory,
    mass_properties,
    simulate,
    solid_properties,
)
from solver.bending import bending_of
from solver.prepared import integrate, prepare
from solver.resistance import EQUATION_9
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET

ROUTES = {"adaptive": Numerics(), "panels": Numerics(method="panels", panels=4000)}
INDEPENDENT = [(238.0, 48.6, 1.83e9), (238.0, 45.0, 1.84e9), (150.0, 45.0, 0.81e9), (100.0, 45.0, 0.64e9)]
"""Speed, angle and peak stress of the paper's body, taken as solid, by two independent programs. [m/s, °, Pa]"""
SAME = 0.05
"""Relative tolerance for these stresses: the programs end runs at different times and use different panels. [1]"""
CONVERGED = 0.01
"""Largest relative change of the peak with ten times as many cross-sections and every instant evaluated. [1]"""


def strike(velocity: float, degrees: float) -> Impact:
    return Impact(velocity=velocity, oblique_angle=math.radians(degrees))


def bending(run: Trajectory) -> Bending:
    assert run.bending is not None
    return run.bending


def run_paper(impact: Impact, **changes: Any) -> Trajectory:
    return simulate(**{"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET, "impact": impact, **changes})


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize(("velocity", "degrees", "expected"), INDEPENDENT)
def test_peak_stress_agrees_with_independent_programs(
    velocity: float, degrees: float, expected: float, route: str
) -> None:
    found = bending(run_paper(strike(velocity, degrees), numerics=ROUTES[route]))
    assert found.peak_stress == pytest.approx(expected, rel=SAME)


def test_place_and_time_of_the_peak_agree_with_independent_programs() -> None:
    found = bending(run_paper(strike(238.0, 48.6)))
    assert found.time == pytest.approx(1.6e-3, abs=0.1e-3)
    assert found.distance_behind_tip == pytest.approx(0.30, abs=0.02)


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize(("velocity", "degrees"), [row[:2] for row in INDEPENDENT])
def test_peak_has_converged_in_cross_sections_and_instants(velocity: float, degrees: float, route: str) -> None:
    impact = strike(velocity, degrees)
    numerics = ROUTES[route].resolved(termination_time=0.005)
    prepared = prepare(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, resistance=EQUATION_9, numerics=numerics)
    model = prepared.model._replace(law=prepared.law_at(impact))
    _, steps = integrate(prepared, model, impact, keep_steps=True)
    usual = bending_of(PAPER_PROJECTILE, model, steps, with_history=False)
    fine = bending_of(PAPER_PROJECTILE, model, steps, with_history=False, slices=160, instants=10_000)
    assert usual is not None
    assert fine is not None
    # On panels the static stress acts in full at any velocity, so the bending stress scatters between steps.
    assert usual.peak_stress == pytest.approx(fine.peak_stress, rel=CONVERGED if route == "adaptive" else 0.03)


NEEDLE = Projectile(nose=Conical(length_to_diameter=0.5), diameter=0.02, length=1.0, mass=2.4)
"""A body that is nearly a uniform beam: its nose is a hundredth of its length."""


@pytest.mark.parametrize("route", ROUTES)
def test_moment_in_a_beam_struck_at_its_end_equals_the_closed_form(route: str) -> None:
    """A force F and a couple C at the end cause the moment F x (1 - x/L)² + C (1 - 3 (x/L)² + 2 (x/L)³)."""
    impact = Impact(velocity=100.0, oblique_angle=math.radians(20.0))
    nose_only = replace(ROUTES[route], termination_time=1e-4)
    run = simulate(
        projectile=NEEDLE,
        target=PAPER_TARGET,
        impact=impact,
        numerics=nose_only,
        sample_interval=1e-6,
        resistance=Resistance(strength_factor=ConstantStrengthFactor(value=8.0)),
    )
    found = bending(run)
    assert run.history is not None
    history = run.history
    force = NEEDLE.mass * float(np.interp(found.time, history.time, history.transverse_acceleration))
    # A cone has a third of the volume of its cylinder, so the uniform beam of equal mass begins behind the tip.
    length = solid_properties(NEEDLE).volume / (math.pi * (NEEDLE.diameter / 2.0) ** 2)
    lever = mass_properties(NEEDLE).center_of_gravity - (NEEDLE.length - length)
    couple = float(np.interp(found.time, history.time, history.moment)) - force * lever
    x = np.linspace(0.0, 1.0, 1001)
    moment = force * length * x * (1.0 - x) ** 2 + couple * (1.0 - 3.0 * x**2 + 2.0 * x**3)
    expected = float(np.abs(moment).max()) / (math.pi / 4.0 * (NEEDLE.diameter / 2.0) ** 3)
    assert found.peak_stress == pytest.approx(expected, rel=0.02)
    assert found.distance_behind_tip == pytest.approx(length / 3.0, abs=0.03)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_stress_scales_with_strength_and_the_square_of_the_speed(factor: float) -> None:
    """The path does not change when strength, modulus and the square of the speed are multiplied by the same factor."""
    resistance = Resistance(strength_factor=ConstantStrengthFactor(value=8.5))
    target = replace(PAPER_TARGET, youngs_modulus=30e9)
    scaled = replace(
        target,
        compressive_strength=factor * target.compressive_strength,
        youngs_modulus=factor * 30e9,
    )
    one = bending(run_paper(strike(238.0, 45.0), target=target, resistance=resistance))
    other = bending(run_paper(strike(238.0 * math.sqrt(factor), 45.0), target=scaled, resistance=resistance))
    assert other.peak_stress == pytest.approx(factor * one.peak_stress, rel=5e-3)
    assert other.distance_behind_tip == pytest.approx(one.distance_behind_tip, abs=0.01)
    assert other.normal_force == pytest.approx(factor * one.normal_force, rel=0.05)


CASES: dict[str, dict[str, Any]] = {
    "wall": {"target": replace(PAPER_TARGET, thickness=0.3)},
    "no decay": {"resistance": replace(EQUATION_9, free_surface=NoFreeSurface())},
    "Mohr-Coulomb": {"resistance": replace(EQUATION_9, free_surface=MohrCoulomb())},
    "crater": {"resistance": replace(EQUATION_9, crater=Crater(depth_diameters=1.0))},
    "cone": {"projectile": replace(PAPER_PROJECTILE, nose=Conical(length_to_diameter=1.0))},
    "boat-tail": {"projectile": replace(PAPER_PROJECTILE, boat_tail=BoatTail(length=0.1, base_diameter=0.05))},
    "hollow": {"projectile": replace(PAPER_PROJECTILE, inner_diameter=0.05)},
}


@pytest.mark.parametrize("case", CASES)
def test_both_routes_agree(case: str) -> None:
    peaks = [
        bending(run_paper(strike(238.0, 40.0), numerics=numerics, **CASES[case])).peak_stress
        for numerics in ROUTES.values()
    ]
    assert peaks[1] == pytest.approx(peaks[0], rel=SAME)


def test_body_in_normal_impact_does_not_bend() -> None:
    found = bending(run_paper(strike(238.0, 0.0)))
    assert found.peak_stress < 1e3


def test_nose_is_compressed_and_the_force_falls_to_zero_at_the_base() -> None:
    """In normal impact the force in a section decelerates the part of the body behind it."""
    found = bending(run_paper(strike(238.0, 0.0)))
    assert found.normal_force <= 0.0


@pytest.mark.parametrize("caliber_radius_head", [0.6, 0.8, 1.0])
def test_force_in_a_section_behind_a_flat_cap_is_the_share_of_the_mass_behind_it(caliber_radius_head: float) -> None:
    """The front half has the corner between cap and shank; its volume follows from the formula for a segment."""
    length, shank = 0.2, 0.04
    body = Projectile(
        nose=Spherical(caliber_radius_head=caliber_radius_head), diameter=2.0 * shank, length=length, mass=7.0
    )
    impact, numerics = strike(238.0, 5.0), Numerics(termination_time=2e-4)
    resistance = Resistance(strength_factor=ConstantStrengthFactor(value=8.0))
    case: dict[str, Any] = {"projectile": body, "target": PAPER_TARGET, "resistance": resistance}
    prepared = prepare(**case, numerics=numerics.resolved())
    model = prepared.model._replace(law=prepared.law_at(impact))
    _, steps = integrate(prepared, model, impact, keep_steps=True)
    found = bending_of(body, model, steps, with_history=False, slices=2)
    history = simulate(**case, impact=impact, numerics=numerics, sample_interval=1e-6).history
    assert found is not None
    assert history is not None
    sphere = 2.0 * shank * caliber_radius_head
    height = sphere - math.sqrt(sphere**2 - shank**2)
    cap, disc = math.pi * height**2 * (sphere - height / 3.0), math.pi * shank**2
    behind = disc * length / 2.0 / (cap + disc * (length - height))
    force = body.mass * float(np.interp(found.time, history.time, history.axial_acceleration))
    assert found.normal_force == pytest.approx(behind * force, rel=3e-5)


def test_bore_raises_the_stress() -> None:
    solid = bending(run_paper(strike(238.0, 45.0)))
    hollow = bending(run_paper(strike(238.0, 45.0), projectile=replace(PAPER_PROJECTILE, inner_diameter=0.06)))
    assert hollow.peak_stress > solid.peak_stress


def test_bore_moves_the_centre_of_gravity_as_in_the_closed_form() -> None:
    body = Projectile(nose=Flat(), diameter=0.08, length=0.4, mass=5.0, inner_diameter=0.06)
    found = mass_properties(body)
    assert found.center_of_gravity == pytest.approx(0.2, rel=1e-12)
    inertia = 5.0 * ((0.04**2 + 0.03**2) / 4.0 + 0.4**2 / 12.0)
    assert found.moment_of_inertia == pytest.approx(inertia, rel=1e-12)
    ogive = replace(PAPER_PROJECTILE, inner_diameter=0.06)
    assert mass_properties(ogive).center_of_gravity < mass_properties(PAPER_PROJECTILE).center_of_gravity


def test_history_of_the_stress_contains_the_peak() -> None:
    found = bending(run_paper(strike(238.0, 45.0)))
    assert found.history is not None
    assert np.all(np.diff(found.history.time) > 0.0)
    assert found.history.stress.max() == pytest.approx(found.peak_stress, rel=0.01)
    assert bending(run_paper(strike(238.0, 45.0), sample_interval=None)).history is None


def test_stress_after_leaving_the_target_does_not_count() -> None:
    """At 100 m/s the tail would strike the broken face 5 ms after the nose has left the target."""
    assert bending(run_paper(strike(100.0, 45.0))).time < 1e-3


@pytest.mark.parametrize("given", [{"center_of_gravity": 0.25}, {"moment_of_inertia": 0.3}])
def test_body_with_other_mass_properties_has_a_note_instead_of_a_stress(given: dict[str, Any]) -> None:
    run = run_paper(strike(238.0, 45.0), projectile=replace(PAPER_PROJECTILE, **given))
    assert run.bending is None
    assert [each.standing for each in run.warnings if each.code == "bending_unknown"] == [True]


def test_explicit_mass_properties_of_the_shape_change_nothing() -> None:
    properties = mass_properties(PAPER_PROJECTILE)
    same = replace(
        PAPER_PROJECTILE,
        center_of_gravity=round(properties.center_of_gravity, 3),
        moment_of_inertia=round(properties.moment_of_inertia, 3),
    )
    found, usual = bending(run_paper(strike(238.0, 45.0), projectile=same)), bending(run_paper(strike(238.0, 45.0)))
    assert found.peak_stress == pytest.approx(usual.peak_stress, rel=0.01)


@pytest.mark.parametrize(("yield_strength", "warns"), [(None, True), (1.9e9, False), (1.7e9, True)])
def test_warning_compares_with_the_given_yield_strength_or_with_steel(
    yield_strength: float | None, warns: bool
) -> None:
    run = run_paper(strike(238.0, 45.0), projectile=replace(PAPER_PROJECTILE, yield_strength=yield_strength))
    details = [each.detail for each in run.warnings if each.code == "bends"]
    assert len(details) == warns
    if warns:
        assert "its surface yields in bending" in details[0]
        assert ("as none is given" in details[0]) == (yield_strength is None)


def test_slow_strike_has_no_warning_about_bending() -> None:
    assert "bends" not in {each.code for each in run_paper(strike(100.0, 45.0)).warnings}


@pytest.mark.parametrize(
    "body",
    [
        Projectile(nose=Sphere(), diameter=0.05, length=0.05, mass=0.5),
        Projectile(nose=Ogive(caliber_radius_head=0.5), diameter=0.05, length=0.025, mass=0.2),
    ],
)
def test_body_without_a_shank_has_a_finite_stress(body: Projectile) -> None:
    assert math.isfinite(bending(run_paper(strike(200.0, 30.0), projectile=body)).peak_stress)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"inner_diameter": 0.09}, "projectile.inner_diameter"),
        ({"inner_diameter": 0.08}, "projectile.inner_diameter"),
        ({"inner_diameter": 0.0}, "projectile.inner_diameter"),
        ({"yield_strength": 0.0}, "projectile.yield_strength"),
        ({"yield_strength": 1200.0}, "projectile.yield_strength"),
    ],
)
def test_bore_and_yield_strength_are_checked(given: dict[str, Any], field: str) -> None:
    with pytest.raises(ParameterError) as error:
        replace(PAPER_PROJECTILE, **given)
    assert error.value.field == field


def test_body_without_a_shank_has_no_bore() -> None:
    with pytest.raises(ParameterError, match="no shank"):
        Projectile(nose=Sphere(), diameter=0.05, length=0.05, mass=0.5, inner_diameter=0.02)
