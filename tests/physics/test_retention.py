"""Critical angles by retained energy agree with an independent program, and do not jump on a map."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import (
    ConstantStrengthFactor,
    CriticalAngle,
    Impact,
    MohrCoulomb,
    Numerics,
    Outcome,
    Projectile,
    Resistance,
    Sphere,
    Target,
    Trajectory,
    critical_angle,
    critical_angle_many,
    limit_velocity,
    simulate,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, Method

from .strikes import codes, known

PAPER: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET, "velocity": PAPER_VELOCITY}
MOHR_COULOMB = Resistance(free_surface=MohrCoulomb())
MOHR_COULOMB_6 = Resistance(free_surface=MohrCoulomb(), strength_factor=ConstantStrengthFactor(value=6.0))
STRONG = Target(compressive_strength=50e6, density=PAPER_TARGET.density)
ANGLES = [
    pytest.param(48.64, {}, id="paper"),
    pytest.param(43.57, {"resistance": MOHR_COULOMB}, id="mohr-coulomb"),
    pytest.param(43.33, {"velocity": 80.0}, id="80 m/s"),
    pytest.param(44.00, {"velocity": 100.0}, id="100 m/s"),
    pytest.param(44.10, {"velocity": 150.0, "target": STRONG}, id="150 m/s on 50 MPa"),
    pytest.param(47.87, {"velocity": 300.0, "resistance": MOHR_COULOMB_6}, id="300 m/s, mohr-coulomb, S 6"),
]
"""Angle above which more than 1 % of the energy is left, as computed by an independent program with 96,000 panels and
steps of 1 µs. [°]"""
TOLERANCE_DEG = 0.02

SPEEDS, STRENGTHS = np.linspace(60.0, 450.0, 60), np.linspace(20e6, 60e6, 60)
LINE = 12
"""Spacing of the tested rows and columns of the map [cells]. Any line along which the angle jumps would cross some."""
STEEPEST_DEG = 2.5
"""Largest difference allowed between the angles of adjacent cells; a jump would be larger. [°]"""


@pytest.mark.parametrize(("expected", "changes"), ANGLES)
def test_default_search_agrees_with_the_independent_program(expected: float, changes: dict[str, Any]) -> None:
    found = critical_angle(**PAPER | changes)
    assert math.degrees(known(found.angle)) == pytest.approx(expected, abs=TOLERANCE_DEG)


@pytest.mark.slow
@pytest.mark.parametrize(("expected", "changes"), ANGLES)
def test_sums_over_elements_give_the_same_change_of_outcome(expected: float, changes: dict[str, Any]) -> None:
    case = PAPER | changes
    panels = Numerics(method="panels", panels=24_000, time_step=2e-6 if case["velocity"] < 200.0 else 1e-6)

    def turned_away(angle: float) -> bool:
        impact = Impact(velocity=case["velocity"], oblique_angle=math.radians(angle))
        strike = {name: value for name, value in case.items() if name != "velocity"}
        return simulate(**strike, impact=impact, numerics=panels, sample_interval=None).outcome is Outcome.RICOCHET

    low, high = expected - 0.04, expected + 0.04
    assert not turned_away(low)
    assert turned_away(high)
    while high - low > 0.006:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if turned_away(middle) else (middle, high)
    assert 0.5 * (low + high) == pytest.approx(expected, abs=TOLERANCE_DEG)


def test_angle_changes_gradually_with_speed_and_strength() -> None:
    along = [(speed, strength) for strength in STRENGTHS[::LINE] for speed in SPEEDS]
    across = [(speed, strength) for speed in SPEEDS[::LINE] for strength in STRENGTHS]
    speeds, strengths = zip(*along, *across, strict=True)
    targets = [Target(compressive_strength=value, density=PAPER_TARGET.density) for value in strengths]
    answers = critical_angle_many(projectile=PAPER_PROJECTILE, target=targets, velocity=speeds, threads=2)
    angles = np.array([_degrees(answer) for answer in answers]).reshape(-1, SPEEDS.size)
    assert np.isfinite(angles).all()
    assert np.abs(np.diff(angles)).max() < STEEPEST_DEG


def _degrees(answer: object) -> float:
    assert isinstance(answer, CriticalAngle)
    return math.nan if answer.angle is None else math.degrees(answer.angle)


SPHERE = Projectile(nose=Sphere(), diameter=0.02, length=0.02, mass=0.0329)


@pytest.mark.parametrize("method", ["adaptive", "panels"])
@pytest.mark.parametrize("spin", [3e3, -2e4, 9e4])
def test_spin_of_a_sphere_is_not_retained_energy(method: Method, spin: float) -> None:
    """No load turns a sphere, so the energy of its spin does not count.

    A sphere of 20 mm that came to rest at 0° used to "ricochet" with that energy.
    """
    numerics = Numerics(method=method, time_step=2e-7, termination_time=1e-3)

    def run(spin: float) -> Trajectory:
        impact = Impact(velocity=300.0, oblique_angle=0.0, angular_velocity=spin)
        return simulate(projectile=SPHERE, target=PAPER_TARGET, impact=impact, numerics=numerics)

    still, spun = run(0.0), run(spin)
    assert (still.outcome, spun.outcome) == (Outcome.EMBEDDED, Outcome.EMBEDDED)
    assert spun.maximum_depth == pytest.approx(known(still.maximum_depth), rel=1e-3)
    assert spun.final.angular_velocity == pytest.approx(spin)
    assert spun.final.time == pytest.approx(still.final.time, rel=0.02)
    assert "tumbling" not in codes(spun)


def test_spin_of_a_sphere_does_not_change_critical_angle_and_limits() -> None:
    wall = replace(PAPER_TARGET, thickness=0.02)
    angles, speeds = [], []
    for spin in (0.0, 2e4):
        found = critical_angle(projectile=SPHERE, target=PAPER_TARGET, velocity=300.0, angular_velocity=spin)
        angles.append(found)
        speeds.append(limit_velocity(projectile=SPHERE, target=wall, oblique_angle=0.3, angular_velocity=spin))
    assert known(angles[1].angle) == pytest.approx(known(angles[0].angle), abs=math.radians(0.02))
    assert angles[1].energy_fraction_above == pytest.approx(known(angles[0].energy_fraction_above), rel=0.02)
    assert known(speeds[1].value) == pytest.approx(known(speeds[0].value), rel=3e-4)
    assert "tumbling" not in codes(angles[1])


def test_spin_is_retained_energy_if_loads_can_turn_the_body() -> None:
    """Loads slow the spin of a sphere with an eccentric centre of gravity, and of the paper's body."""
    for body in (replace(SPHERE, center_of_gravity=0.009), PAPER_PROJECTILE):
        impact = Impact(velocity=200.0, oblique_angle=0.1, angular_velocity=300.0)
        run = simulate(projectile=body, target=PAPER_TARGET, impact=impact)
        assert abs(run.final.angular_velocity) < 290.0
