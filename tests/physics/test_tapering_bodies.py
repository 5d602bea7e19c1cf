"""Bodies that taper behind their widest point: symmetry of a sphere, and limiting cases of a taper."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import (
    BoatTail,
    Flat,
    Impact,
    NoFreeSurface,
    Numerics,
    Ogive,
    Outcome,
    Profile,
    Projectile,
    Resistance,
    Sphere,
    Spherical,
    Trajectory,
    critical_angle,
    simulate,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET

from .strikes import DECAYS, DIAMETER, TAPERING, known, steel

BALL = TAPERING["sphere"]
PANELS = Numerics(method="panels", panels=8_000, time_step=2e-6, termination_time=0.01)
ROUTES = pytest.mark.parametrize("numerics", [None, PANELS], ids=["adaptive", "panels"])


def run(projectile: Projectile, degrees: float, *, thickness: float | None = None, **given: Any) -> Trajectory:
    """Simulate a strike at 400 m/s on the paper's concrete."""
    impact = {name: given.pop(name) for name in ("angle_of_attack", "angular_velocity") if name in given}
    return simulate(
        projectile=projectile,
        target=replace(PAPER_TARGET, thickness=thickness),
        impact=Impact(velocity=400.0, oblique_angle=math.radians(degrees), **impact),
        sample_interval=None,
        **given,
    )


def center_depth(found: Trajectory) -> float:
    """Return the depth of the centre of gravity at the end. [m]"""
    return found.final.center_of_gravity_depth


@ROUTES
@pytest.mark.parametrize("thickness", [None, 0.05])
@pytest.mark.parametrize("decay", DECAYS)
def test_motion_of_a_sphere_does_not_depend_on_its_axis(
    decay: str, thickness: float | None, numerics: Numerics | None
) -> None:
    """A sphere has no front, and normal stress cannot change its spin, so neither attitude nor spin matters."""
    resistance = Resistance(free_surface=DECAYS[decay])
    turned: dict[str, float] = {"angle_of_attack": math.radians(-70.0)}
    spun = {"angle_of_attack": math.radians(40.0), "angular_velocity": 100.0}
    for degrees in (25.0, 50.0, 78.0):
        given: dict[str, Any] = {"thickness": thickness, "resistance": resistance, "numerics": numerics}
        plain = run(BALL, degrees, **given)
        for impact in (turned, spun):
            other = run(BALL, degrees, **given, **impact)
            assert other.outcome is plain.outcome
            assert other.final.angular_velocity == pytest.approx(impact.get("angular_velocity", 0.0), abs=1.0)
            if plain.exit is None or other.exit is None:
                assert center_depth(other) == pytest.approx(center_depth(plain), abs=5e-3 * DIAMETER)
            else:
                assert other.exit.speed == pytest.approx(plain.exit.speed, abs=2e-3 * 400.0)
                assert other.exit.direction == pytest.approx(plain.exit.direction, abs=math.radians(0.6))


@ROUTES
@pytest.mark.parametrize("thickness", [None, 0.05])
def test_rear_of_a_body_in_straight_motion_is_not_loaded(thickness: float | None, numerics: Numerics | None) -> None:
    """Surfaces that face backwards move away from the concrete, so only nose and mass matter."""
    long = replace(BALL, nose=Spherical(caliber_radius_head=0.5), length=0.3)
    boat = TAPERING["boat-tail"]
    for tapering, plain in ((BALL, long), (boat, replace(boat, boat_tail=None))):
        found, other = (run(body, 0.0, thickness=thickness, numerics=numerics) for body in (tapering, plain))
        assert other.outcome is found.outcome
        if found.exit is None or other.exit is None:
            assert found.maximum_depth == pytest.approx(other.maximum_depth, rel=1e-4)
        else:
            assert found.exit.speed == pytest.approx(other.exit.speed, rel=1e-4)


def angle(projectile: Projectile, **given: Any) -> float:
    """Return the critical angle of the paper's strike with this projectile. [°]"""
    found = critical_angle(projectile=projectile, target=PAPER_TARGET, velocity=238.0, **given).angle
    return math.degrees(known(found))


PLAIN = replace(PAPER_PROJECTILE, center_of_gravity=0.29413, moment_of_inertia=0.24981)


def with_tail(length: float, base: float) -> Projectile:
    """Return the paper's body with a boat-tail, but with the mass properties of the body without one."""
    return replace(PLAIN, boat_tail=BoatTail(length=length, base_diameter=base))


@pytest.mark.parametrize(
    ("tail", "agreement"),
    [((0.1, DIAMETER), 0.001), ((0.1, 0.9999 * DIAMETER), 0.01), ((1e-6, 0.02), 0.01), ((1e-6, 0.0), 0.01)],
    ids=["no taper", "hardly any", "a short one", "a short one to a point"],
)
def test_vanishing_taper_approaches_the_plain_body(tail: tuple[float, float], agreement: float) -> None:
    assert angle(with_tail(*tail)) == pytest.approx(angle(PLAIN), abs=agreement)


@pytest.mark.parametrize("thickness", [None, 0.15])
def test_steep_taper_approaches_a_flat_base(thickness: float | None) -> None:
    """This holds for bodies that strike or leave tail first, too."""
    for degrees, attack in ((0.0, 90.0), (30.0, 90.0), (60.0, 88.0), (80.0, -60.0)):
        given = {"thickness": thickness, "angle_of_attack": math.radians(attack), "angular_velocity": 300.0}
        plain, steep = run(PLAIN, degrees, **given), run(with_tail(1e-6, 0.0), degrees, **given)
        assert steep.outcome is plain.outcome
        if plain.exit is not None and steep.exit is not None:
            assert steep.exit.speed == pytest.approx(plain.exit.speed, abs=1.0)
        assert steep.maximum_depth == pytest.approx(plain.maximum_depth, abs=2e-3)


def test_boat_tail_reduces_the_effect_of_the_rear_of_the_shank() -> None:
    """The rear half of the shank raises the critical angle from 48.1° to 48.6°; a taper removes part of that effect."""
    angles = [angle(PLAIN), *(angle(with_tail(*tail)) for tail in ((0.1, 0.072), (0.1, 0.048), (0.25, 0.02)))]
    assert np.all(np.diff(angles) < 0.0)
    assert 48.1 < angles[-1] < angles[0] - 0.3


@pytest.mark.parametrize("degrees", [0.0, 40.0])
def test_profile_through_points_of_a_sphere_converges_to_it(degrees: float) -> None:
    """The difference is inversely proportional to the square of the number of cones."""
    radius = DIAMETER / 2.0

    def inscribed(cones: int) -> Projectile:
        turns = np.linspace(0.0, math.pi, cones + 1)[1:-1]
        ring = np.column_stack((radius * (1.0 - np.cos(turns)), radius * np.sin(turns)))
        ring[cones // 2 - 1] = radius, radius
        points = ((0.0, 0.0), *map(tuple, ring.tolist()), (DIAMETER, 0.0))
        return replace(BALL, nose=Profile(points=points), center_of_gravity=radius, moment_of_inertia=1e-3)

    exact = run(BALL, degrees)
    counts = np.array([8, 16, 32])
    errors = np.array([abs(center_depth(run(inscribed(int(n)), degrees)) - center_depth(exact)) for n in counts])
    assert float(np.polyfit(np.log(1.0 / counts), np.log(errors), 1)[0]) == pytest.approx(2.0, abs=0.7)
    assert errors[-1] < 2e-4


def test_body_without_a_base_is_loaded_everywhere_without_decay() -> None:
    """Spheres and pointed tails have no base. Without decay the rear of any body is loaded like its nose."""
    resistance = Resistance(free_surface=NoFreeSurface())
    for projectile in (BALL, TAPERING["double cone"], steel(Flat(), length=0.1)):
        found = run(projectile, 30.0, resistance=resistance)
        assert found.final.kinetic_energy < 0.01 * 0.5 * projectile.mass * 400.0**2


def test_nose_and_boat_tail_may_leave_no_shank() -> None:
    nose = Ogive(caliber_radius_head=2.0)
    length = nose.length(DIAMETER / 2.0) + 0.1
    body = steel(nose, length=length, boat_tail=BoatTail(length=0.1, base_diameter=0.05))
    assert len(body.outline()) == 2
    assert body.outline()[-1].length == pytest.approx(math.hypot(0.1, 0.015), rel=1e-12)
    assert run(body, 20.0).outcome is Outcome.EMBEDDED


def test_sphere_must_be_as_wide_as_long() -> None:
    assert BALL.base.length == 0.0
    assert Projectile(nose=Sphere(), diameter=0.0206, length=0.0206, mass=0.0359).nose_length == 0.0103
