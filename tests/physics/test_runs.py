"""The end, the results and the warnings of a run."""

import math
import re
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from solver import (
    ConstantStrengthFactor,
    Impact,
    Motion,
    Numerics,
    Outcome,
    Resistance,
    Trajectory,
    mass_properties,
)
from solver.arrays import FloatArray
from solver.motion import REST_FRACTION
from solver.projectile import Flat
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
from solver.warnings import body_warnings

from .strikes import NOSES, codes, known, paper_run, power, steel


def history(trajectory: Trajectory) -> Motion[FloatArray]:
    return known(trajectory.history)


@pytest.mark.parametrize("method", ["adaptive", "panels"])
def test_embedded_run_ends_at_a_hundredth_of_the_speed(method: Any) -> None:
    found = paper_run(30.0, numerics=Numerics(method=method))
    assert found.outcome is Outcome.EMBEDDED
    if method == "adaptive":  # With fixed steps a run ends before the step that would go beyond rest.
        assert found.final.kinetic_energy == pytest.approx(REST_FRACTION * history(found).kinetic_energy[0], rel=1e-6)


@pytest.mark.parametrize("method", ["adaptive", "panels"])
def test_ricochet_ends_when_the_last_element_is_unloaded(method: Any) -> None:
    found = paper_run(55.0, numerics=Numerics(method=method))
    assert found.outcome is Outcome.RICOCHET
    assert found.final.depth_velocity < 0.0
    force = np.hypot(history(found).depth_force, history(found).lateral_force)
    assert force[-1] < 1e-4 * force.max()


@pytest.mark.parametrize("degrees", [30.0, 55.0, None])
def test_evaluations_of_a_run_with_fixed_steps_are_four_for_each_step_and_one_at_the_start(
    degrees: float | None,
) -> None:
    """The run that comes to rest also has a step that would go beyond rest, which does not count as a step."""
    numerics = Numerics(method="panels", panels=1000, termination_time=1e-3 if degrees is None else None)
    found = paper_run(degrees or 45.0, numerics=numerics)
    ends = {30.0: Outcome.EMBEDDED, 55.0: Outcome.RICOCHET, None: Outcome.IN_MOTION}
    assert found.outcome is ends[degrees]
    assert found.evaluations == 4 * (found.steps + (degrees == 30.0)) + 1


def test_run_out_of_time_is_in_motion_with_a_warning() -> None:
    found = paper_run(45.0, numerics=Numerics(termination_time=1e-3))
    assert found.outcome is Outcome.IN_MOTION
    assert found.final.time == 1e-3
    assert "undecided" in codes(found)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 55.0])
def test_history_is_sampled_evenly_and_ends_with_the_run(degrees: float) -> None:
    found = paper_run(degrees, sample_interval=3e-5)
    times = history(found).time
    np.testing.assert_allclose(times[:-1], 3e-5 * np.arange(times.size - 1), rtol=0, atol=1e-15)
    assert 0.0 < times[-1] - times[-2] <= 3e-5 * (1.0 + 1e-9)
    for field in fields(found.final):
        assert getattr(history(found), field.name)[-1] == getattr(found.final, field.name)


def test_omitting_the_history_changes_nothing_else() -> None:
    with_history, without = paper_run(45.0), paper_run(45.0, sample_interval=None)
    assert without.history is None
    assert with_history.bending is not None
    assert replace(with_history, history=None, bending=replace(with_history.bending, history=None)) == without


def test_history_starts_with_the_impact() -> None:
    impact = Impact(velocity=238.0, oblique_angle=0.7, angle_of_attack=0.05, angular_velocity=-20.0)
    start = history(paper_run(0.0, impact=impact))
    assert start.time[0] == 0.0
    assert start.nose_tip_depth[0] == pytest.approx(0.0, abs=1e-12)
    assert start.center_of_gravity_lateral[0] == 0.0
    assert start.axis_angle[0] == pytest.approx(0.75)
    assert start.depth_velocity[0] == pytest.approx(238.0 * math.cos(0.7))
    assert start.lateral_velocity[0] == pytest.approx(238.0 * math.sin(0.7))
    assert start.angular_velocity[0] == -20.0


def test_rates_in_the_history_are_derivatives_of_its_positions() -> None:
    """Rates are compared with central differences at 10 µs, up to the end of the load."""
    found = history(paper_run(48.0, sample_interval=1e-5))
    for position, rate, scale in (
        (found.center_of_gravity_depth, found.depth_velocity, 238.0),
        (found.center_of_gravity_lateral, found.lateral_velocity, 238.0),
        (found.axis_angle, found.angular_velocity, 200.0),
        (found.kinetic_energy, power(found), float(np.abs(power(found)).max())),
    ):
        slope = (position[2:-1] - position[:-3]) / 2e-5
        np.testing.assert_allclose(slope, rate[1:-2], rtol=0, atol=5e-3 * scale)


@pytest.mark.parametrize(("degrees", "tolerance"), [(0.0, 1e-5), (30.0, 1e-5), (55.0, 1e-5)])
def test_accelerations_integrate_to_the_change_of_velocity(degrees: float, tolerance: float) -> None:
    """This includes 30°, where the body finally slides straight and a transverse speed of mm/s determines the force."""
    found = history(paper_run(degrees, sample_interval=2e-6))
    sine, cosine = np.sin(found.axis_angle), np.cos(found.axis_angle)
    axial, transverse = found.axial_acceleration, found.transverse_acceleration
    for rate, velocity in (
        (axial * cosine - transverse * sine, found.depth_velocity),
        (axial * sine + transverse * cosine, found.lateral_velocity),
    ):
        gained = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(found.time))))
        np.testing.assert_allclose(gained, velocity - velocity[0], rtol=0, atol=tolerance * 238.0)


def test_body_that_moves_straight_is_slowed_only_along_its_axis() -> None:
    found = history(paper_run(0.0))
    assert (found.axial_acceleration <= 0.0).all()
    assert found.axial_acceleration.min() == pytest.approx(found.depth_force.min() / 13.0, rel=1e-12)
    np.testing.assert_allclose(found.transverse_acceleration, 0.0, atol=1e-9 * abs(found.axial_acceleration.min()))


def test_body_that_slides_straight_has_little_transverse_acceleration() -> None:
    """At 320 m/s the body no longer turns after 1.6 ms, so its transverse acceleration must be small."""
    impact = Impact(velocity=320.0, oblique_angle=math.radians(45.0))
    found = history(paper_run(45.0, impact=impact, sample_interval=2e-5))
    slides = (found.time > 1.6e-3) & (found.time < found.time[-1])
    assert np.ptp(found.axis_angle[slides]) < 1e-3
    assert np.abs(found.transverse_acceleration[slides]).max() < 0.01 * np.abs(found.axial_acceleration[slides]).max()


def test_nose_pushed_towards_the_face_accelerates_the_body_that_way() -> None:
    found = history(paper_run(55.0))
    push = found.transverse_acceleration
    assert push[np.abs(push).argmax()] > 0.0
    assert found.axis_angle[-1] > found.axis_angle[0]


@pytest.mark.parametrize(("degrees", "until"), [(30.0, 1.2e-3), (55.0, math.inf)])
def test_accelerations_of_both_routes_agree(degrees: float, until: float) -> None:
    """The methods agree to 5 % in the root mean square and 1 % in the maximum, at 30° only while the body turns."""
    found, other = (
        history(paper_run(degrees, numerics=Numerics(method=method), sample_interval=1e-5))
        for method in ("adaptive", "panels")
    )
    shared = found.time[: min(found.time.size, other.time.size) - 1] < until
    for name in ("axial_acceleration", "transverse_acceleration"):
        values, expected = (getattr(each, name)[: shared.size][shared] for each in (found, other))
        assert np.linalg.norm(values - expected) < 0.05 * np.linalg.norm(expected)
        assert np.abs(values).max() == pytest.approx(np.abs(expected).max(), rel=0.01)


def test_energy_follows_from_the_velocities_and_falls_in_embedded_runs() -> None:
    found = history(paper_run(30.0))
    body = mass_properties(PAPER_PROJECTILE)
    moving = body.mass * (found.depth_velocity**2 + found.lateral_velocity**2)
    turning = body.moment_of_inertia * found.angular_velocity**2
    np.testing.assert_allclose(found.kinetic_energy, 0.5 * (moving + turning), rtol=1e-12)
    assert found.kinetic_energy[-1] < 0.01 * found.kinetic_energy[0]


@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_maximum_depth_is_the_greatest_tip_depth_up_to_the_end(degrees: float) -> None:
    """The tolerance is the change of depth within half a sample interval near the maximum.

    Runs in which the flank is deeper than the tip are in `test_protrusion.py`.
    """
    found = paper_run(degrees, sample_interval=1e-6)
    assert found.maximum_depth == pytest.approx(history(found).nose_tip_depth.max(), abs=5e-8)


STEEP_FIT = {"impact": paper_impact(oblique_angle_degrees=50.0)}
PLAIN = replace(PAPER_PROJECTILE, center_of_gravity=0.294, moment_of_inertia=0.25)
FIXED = {"resistance": Resistance(strength_factor=ConstantStrengthFactor(value=8.0))}


def test_strike_within_all_ranges_has_no_warning() -> None:
    assert paper_run(30.0, projectile=replace(PLAIN, yield_strength=2e9)).warnings == ()


@pytest.mark.parametrize(
    ("code", "changes"),
    [
        ("strength_fit_extrapolated", {"impact": paper_impact(oblique_angle_degrees=45.1)}),
        ("velocity_beyond_rigid", {"impact": Impact(velocity=801.0, oblique_angle=0.5)}),
        ("strength_beyond_tests", {"target": replace(PAPER_TARGET, compressive_strength=12.9e6)}),
        ("strength_beyond_tests", {"target": replace(PAPER_TARGET, compressive_strength=97.1e6)}),
        ("large_angle_of_attack", {"impact": Impact(velocity=238.0, oblique_angle=0.5, angle_of_attack=-0.088)}),
        ("mass_properties_assumed", {"projectile": replace(PLAIN, moment_of_inertia=None)}),
        ("mass_properties_assumed", {"projectile": replace(PLAIN, center_of_gravity=None)}),
        ("mean_density_unusual", {"projectile": replace(PLAIN, mass=2.0)}),
        ("mean_density_unusual", {"projectile": replace(PLAIN, mass=1e6)}),
        ("undecided", {"numerics": Numerics(termination_time=1e-3)}),
        ("shallow_penetration", {"impact": Impact(velocity=60.0, oblique_angle=0.0)}),
        ("base_strikes_first", {**FIXED, "impact": Impact(velocity=238.0, oblique_angle=1.0, angle_of_attack=1.0)}),
    ],
)
def test_result_contains_the_warnings_an_assessor_needs(code: str, changes: dict[str, Any]) -> None:
    found = paper_run(30.0, **{"projectile": PLAIN, **changes})
    assert code in codes(found)
    assert all(warning.detail for warning in found.warnings)
    # Negative angles have a minus sign, not a hyphen.
    assert not any(re.search(r"-\d[\d.]*°", each.detail) for each in found.warnings)


def test_mean_density_is_the_mass_over_the_volume_of_the_outline() -> None:
    """A cylinder of 80 mm by 530 mm has a volume of 2.664 litres."""
    volume = math.pi * 0.04**2 * 0.53
    for density, warned in ((990.0, True), (1_010.0, False), (19_900.0, False), (20_100.0, True)):
        cylinder = replace(PLAIN, nose=Flat(), mass=density * volume)
        details = [each.detail for each in body_warnings(cylinder)]
        assert bool(details) is warned
        assert all(f"{density:,.0f} kg/m³" in detail for detail in details)


@pytest.mark.parametrize("name", NOSES)
@pytest.mark.parametrize("degrees", [0.0, 1e-7, 89.0, 89.99])
def test_strikes_at_the_limits_of_the_angle_are_computed(name: str, degrees: float) -> None:
    found = paper_run(degrees, projectile=steel(NOSES[name]), **FIXED)
    for field in fields(found.final):
        assert np.isfinite(getattr(history(found), field.name)).all()
    assert found.outcome is (Outcome.EMBEDDED if degrees < 1.0 else Outcome.RICOCHET)
    assert found.steps < 2_000
