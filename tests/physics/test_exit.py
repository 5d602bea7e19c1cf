"""The state of a projectile that leaves through the impact face or the rear face, and of one at the critical angle."""

import math
from dataclasses import replace

import pytest

from solver import Outcome, critical_angle
from solver.strike import PAPER_TARGET

from .strikes import CASE, known, paper_run

WALL = replace(PAPER_TARGET, thickness=0.2)
ENERGY = 0.5 * 13.0 * 238.0**2


@pytest.mark.parametrize(("oblique_angle", "outward"), [(0.0, 1.0), (20.0, 1.0), (52.0, -1.0)])
def test_exit_is_the_final_motion_relative_to_the_exit_face(oblique_angle: float, outward: float) -> None:
    run = paper_run(oblique_angle, target=WALL, sample_interval=None)
    left, final = run.exit, run.final
    assert left is not None
    assert left.speed * math.sin(left.elevation) == pytest.approx(outward * final.depth_velocity)
    assert left.speed * math.sin(left.direction) == pytest.approx(final.lateral_velocity, abs=1e-6)
    assert left.kinetic_energy == pytest.approx(final.kinetic_energy)
    assert left.axis_angle == final.axis_angle
    assert left.angular_velocity == final.angular_velocity
    assert left.lateral == final.center_of_gravity_lateral


def test_embedded_projectile_has_no_exit() -> None:
    run = paper_run(46.0, target=WALL)
    assert run.outcome is Outcome.EMBEDDED
    assert run.exit is None


def test_exit_at_the_critical_angle_has_the_retention_energy() -> None:
    found = critical_angle(**CASE, velocity=238.0)
    assert found.exit is not None
    assert found.exit.kinetic_energy / ENERGY == pytest.approx(0.01, abs=0.001)
    assert 0.0 < found.exit.direction < math.pi / 2.0
    assert found.exit.elevation == pytest.approx(math.pi / 2.0 - found.exit.direction)
    for trial in found.iterations:
        assert (trial.exit is not None) is (trial.outcome is Outcome.RICOCHET)


def test_exit_of_a_mirrored_strike_is_mirrored() -> None:
    first, second = (known(paper_run(degrees, sample_interval=None).exit) for degrees in (60.0, -60.0))
    assert second.direction == pytest.approx(-first.direction)
    assert second.axis_angle == pytest.approx(-first.axis_angle)
    assert (second.speed, second.elevation) == pytest.approx((first.speed, first.elevation))
