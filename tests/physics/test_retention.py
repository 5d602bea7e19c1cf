"""Critical angles by the retention energy: against sums over elements, and over a map without cliffs."""

import math
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
    Resistance,
    Target,
    critical_angle,
    critical_angle_many,
    simulate,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY

from .strikes import known

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
"""By an independent program with 96,000 panels and 1 µs: angle beyond which 1 % of the energy is left. [°]"""
TOLERANCE_DEG = 0.02

SPEEDS, STRENGTHS = np.linspace(60.0, 450.0, 60), np.linspace(20e6, 60e6, 60)
LINE = 12
"""One of so many lines of the map is followed, in both directions: a cliff runs across the map and would cut them."""
STEEPEST_DEG = 2.5
"""Difference of neighbours on the map that a smooth dependence on speed and strength stays below. [°]"""


@pytest.mark.parametrize(("expected", "changes"), ANGLES)
def test_defaults_find_the_angles_of_the_independent_program(expected: float, changes: dict[str, Any]) -> None:
    found = critical_angle(**PAPER | changes)
    assert math.degrees(known(found.angle)) == pytest.approx(expected, abs=TOLERANCE_DEG)


@pytest.mark.slow
@pytest.mark.parametrize(("expected", "changes"), ANGLES)
def test_sums_over_elements_put_the_change_of_outcome_there(expected: float, changes: dict[str, Any]) -> None:
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
