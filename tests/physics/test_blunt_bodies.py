"""Blunt bodies on walls: comparison with an independent integration, limits, and properties of any body."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from solver import (
    Conical,
    Flat,
    Impact,
    Numerics,
    Ogive,
    Outcome,
    PerforationStatus,
    Projectile,
    Spherical,
    Target,
    Trajectory,
    critical_angle,
    least_thickness,
    limit_velocity,
    simulate,
    solid_properties,
)
from solver.projectile import NoseShape
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from validation.routes import BODIES, random_projectile

from .strikes import known

HEAD_ON = Impact(velocity=238.0, oblique_angle=0.0)
WALL = replace(PAPER_TARGET, thickness=0.2)
STEEL = 7850.0
"""Density of steel. [kg/m³]"""


def body(nose: NoseShape) -> Projectile:
    """Return the paper's projectile with this nose."""
    return replace(PAPER_PROJECTILE, nose=nose)


FLAT = body(Flat())
TABLE = [
    # nose, least thickness, depth in a half-space, exit speed behind a wall of 0.2 m
    pytest.param(Ogive(caliber_radius_head=3.0), 0.2402, None, 104.4, id="ogive"),
    pytest.param(Conical(length_to_diameter=1.66), 0.2441, 0.3068, None, id="cone 1.66"),
    pytest.param(Conical(length_to_diameter=0.5), 0.2781, 0.2294, None, id="cone 0.5"),
    pytest.param(Spherical(caliber_radius_head=0.5), 0.2864, 0.2153, None, id="hemisphere"),
    pytest.param(Flat(), 0.3085, 0.1875, 159.6, id="flat"),
]
"""Results of an independent one-dimensional integration with 600 rings and steps of 0.2 to 2 µs, for normal impact at
238 m/s with eq. 9 and elastic-plastic decay. [m, m, m/s]"""
PANELS = Numerics(method="panels", panels=3000, time_step=5e-6, termination_time=0.05)


@pytest.mark.parametrize("numerics", [None, PANELS], ids=["adaptive", "panels"])
@pytest.mark.parametrize(("nose", "thickness", "depth", "speed"), TABLE)
def test_walls_agree_with_an_independent_integration(
    nose: NoseShape, thickness: float, depth: float | None, speed: float | None, numerics: Numerics | None
) -> None:
    def run(wall: float | None) -> Trajectory:
        target = replace(PAPER_TARGET, thickness=wall)
        return simulate(projectile=body(nose), target=target, impact=HEAD_ON, numerics=numerics, sample_interval=None)

    assert run(thickness - 1e-3).outcome is Outcome.PERFORATED
    assert run(thickness + 1e-3).outcome is Outcome.EMBEDDED
    if depth is not None:
        assert run(None).maximum_depth == pytest.approx(depth, abs=1e-3)
    if speed is not None:
        left = run(0.2).exit
        assert known(left).speed == pytest.approx(speed, abs=0.5)


@cache
def figures(nose: NoseShape) -> tuple[float, float, float]:
    """Return depth in a half-space, exit speed from a wall of 0.2 m, and least thickness. [m, m/s, m]"""
    projectile = body(nose)
    left = simulate(projectile=projectile, target=WALL, impact=HEAD_ON, sample_interval=None).exit
    wall = least_thickness(projectile=projectile, target=PAPER_TARGET, impact=HEAD_ON).value
    run = simulate(projectile=projectile, target=PAPER_TARGET, impact=HEAD_ON, sample_interval=None)
    return known(run.maximum_depth), known(left).speed, known(wall)


@pytest.mark.parametrize(
    "nose",
    [Conical(length_to_diameter=0.02), Conical(length_to_diameter=1e-4), Spherical(caliber_radius_head=30.0)],
    ids=["blunt cone", "blunter cone", "shallow cap"],
)
def test_flat_face_is_the_limit_of_cones_and_caps(nose: NoseShape) -> None:
    assert figures(nose) == pytest.approx(figures(Flat()), rel=0.01)


@pytest.mark.parametrize("angle", [20.0, 45.0, 60.0])
def test_flat_face_is_the_limit_of_cones_at_an_oblique_angle(angle: float) -> None:
    impact = replace(HEAD_ON, oblique_angle=math.radians(angle))
    flat, cone = (
        simulate(projectile=body(nose), target=replace(WALL, thickness=0.1), impact=impact, sample_interval=None)
        for nose in (Flat(), Conical(length_to_diameter=1e-3))
    )
    assert flat.outcome is cone.outcome is Outcome.PERFORATED
    assert known(cone.exit).speed == pytest.approx(known(flat.exit).speed, rel=0.01)


def test_walls_of_a_flat_body_are_finite_and_monotone() -> None:
    """Least thickness rises with speed, limit speed with thickness; no thicker wall is perforated at more angles."""
    speeds = [60.0, 100.0, 150.0, 238.0, 350.0, 500.0]
    walls, beyond = [], []
    for speed in speeds:
        impact = Impact(velocity=speed, oblique_angle=0.0)
        found = least_thickness(projectile=FLAT, target=PAPER_TARGET, impact=impact, tolerance=1e-3)
        assert found.status is PerforationStatus.CONVERGED
        assert found.value is not None
        walls.append(found.value)
        run = simulate(projectile=FLAT, target=PAPER_TARGET, impact=impact, sample_interval=None)
        depth = known(run.maximum_depth)
        beyond.append((found.value - depth) / FLAT.diameter)
    assert np.all(np.diff(walls) > 0.0)
    assert 0.5 < min(beyond) < max(beyond) < 1.7
    limits, perforated = [], []
    for thickness in (0.1, 0.2, 0.3, 0.4, 0.6):
        target = replace(PAPER_TARGET, thickness=thickness)
        limit = limit_velocity(projectile=FLAT, target=target, oblique_angle=0.0, tolerance=1e-3)
        assert limit.status is PerforationStatus.CONVERGED
        limits.append(limit.value or math.nan)
        outcomes = critical_angle(projectile=FLAT, target=target, velocity=238.0).outcomes
        assert {each.outcome for each in outcomes} <= {Outcome.PERFORATED, Outcome.EMBEDDED}
        first = outcomes[0]
        perforated.append(first.upper if first.outcome is Outcome.PERFORATED else 0.0)
    assert np.all(np.diff(limits) > 0.0)
    assert np.all(np.diff(perforated) <= 0.0)
    assert perforated[0] > perforated[2] > perforated[3] == 0.0


def test_flat_body_needs_a_thicker_wall_than_a_short_cone() -> None:
    flat, cone = figures(Flat())[2], figures(Conical(length_to_diameter=0.5))[2]
    assert cone < flat < 1.3 * cone


def steel_strikes(count: int, seed: int) -> Iterator[tuple[Projectile, Target, Impact]]:
    """Yield random strikes of steel bodies of every shape at 30 to 900 m/s, every second one head-on."""
    random = np.random.default_rng(seed)
    for number in range(count):
        shape = random_projectile(BODIES[number % len(BODIES)], random)
        projectile = replace(shape, mass=STEEL * solid_properties(shape).volume)
        target = Target(compressive_strength=random.uniform(10e6, 150e6), density=random.uniform(1900.0, 2600.0))
        oblique = math.radians(random.uniform(0.0, 60.0)) if number % 2 else 0.0
        yield projectile, target, Impact(velocity=30.0 * 30.0 ** random.uniform(), oblique_angle=oblique)


def test_least_thickness_slightly_exceeds_the_depth() -> None:
    """The least thickness is at most 2.5 diameters more than the depth in a half-space, within 1 %."""
    for projectile, target, impact in steel_strikes(300, 11):
        strike: dict[str, Any] = {"projectile": projectile, "target": target, "impact": impact}
        wall = least_thickness(**strike, tolerance=1e-2)
        depth = known(simulate(**strike, sample_interval=None).maximum_depth)
        assert wall.status is not PerforationStatus.ALWAYS_PERFORATED
        assert (wall.value or 0.0) < 1.01 * (depth + 2.5 * projectile.diameter), strike
        assert "implausible" not in {warning.code for warning in wall.warnings}


def test_walls_take_energy_and_thicker_walls_take_more() -> None:
    """Exit speed never rises with thickness by more than 0.1 % of the impact speed.

    Walls of half a diameter or more take at least 0.1 % of the energy of bodies up to eight diameters long.
    """
    perforated = 0
    for projectile, target, impact in steel_strikes(120, 12):
        before, initial = math.inf, 0.5 * projectile.mass * impact.velocity**2
        for diameters in (0.5, 0.7, 1.0, 1.5, 2.5):
            wall = replace(target, thickness=diameters * projectile.diameter)
            run = simulate(projectile=projectile, target=wall, impact=impact, sample_interval=None)
            speed = run.exit.speed if run.exit is not None and run.outcome is Outcome.PERFORATED else 0.0
            perforated += speed > 0.0
            assert speed <= before + 1e-3 * impact.velocity
            if projectile.length <= 8.0 * projectile.diameter and speed > 0.0:
                assert run.final.kinetic_energy < 0.999 * initial
            assert "implausible" not in {warning.code for warning in run.warnings}
            before = speed
    assert perforated > 100


def test_critical_angle_does_not_jump() -> None:
    """From 100 to 800 m/s the angle changes by less than 2.5° if speed, strength or mass changes by 3.5 %.

    Angles with a warning about the retention energy or about tumbling are not compared.
    """
    random, found = np.random.default_rng(13), 0
    for projectile, target, _ in steel_strikes(300, 13):
        velocity = random.uniform(100.0, 800.0)
        strike: dict[str, Any] = {"projectile": projectile, "target": target, "velocity": velocity}
        changed = [
            strike | {"velocity": 1.035 * velocity},
            strike | {"target": replace(target, compressive_strength=1.035 * target.compressive_strength)},
            strike | {"projectile": replace(projectile, mass=1.035 * projectile.mass)},
        ]
        answer = critical_angle(**strike)
        if answer.angle is None:
            continue
        doubtful = {"retention_decides", "tumbling"} & {warning.code for warning in answer.warnings}
        if doubtful:
            continue
        found += 1
        for other in (critical_angle(**each) for each in changed):
            assert abs(known(other.angle) - answer.angle) < math.radians(2.5), strike
    assert found > 50
