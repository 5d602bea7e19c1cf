"""Flight of a projectile after a ricochet or through a wall."""

import math
import random
from typing import Any

import pytest

from solver import (
    Conical,
    Exit,
    Flight,
    FlightConditions,
    ParameterError,
    Projectile,
    Sphere,
    flight,
    flight_after,
    launch_elevation,
    mean_projected_area,
)
from solver.flight import GRAVITY
from solver.strike import PAPER_PROJECTILE

PAPER = {"mass": 13.0, "projected_area": 0.032076}
STEEL_SPHERE = {
    "mass": 7850.0 * math.pi / 6.0 * 0.02**3,
    "projected_area": math.pi * 0.01**2,
    "drag_coefficient": 0.5,
}


# The distances, times and speeds are from an independent program.
@pytest.mark.parametrize(
    ("body", "speed", "elevation_deg", "distance", "seconds", "landing_speed"),
    [
        (PAPER, 101.1, 19.18, 405.8, 5.92, 57.3),
        (PAPER, 150.0, 30.0, 742.0, 11.12, 59.8),
        (STEEL_SPHERE, 300.0, 20.0, 729.3, 9.65, 47.8),
    ],
)
def test_flights_agree_with_an_independent_program(
    body: dict[str, float], speed: float, elevation_deg: float, distance: float, seconds: float, landing_speed: float
) -> None:
    found = flight(speed=speed, elevation=math.radians(elevation_deg), **body)
    assert found.range == pytest.approx(distance, abs=0.1)
    assert found.flight_time == pytest.approx(seconds, abs=0.01)
    assert found.impact_speed == pytest.approx(landing_speed, abs=0.1)


def test_apex_agrees_with_an_independent_program() -> None:
    assert flight(speed=101.1, elevation=math.radians(19.18), **PAPER).apex == pytest.approx(43.3, abs=0.1)


@pytest.mark.parametrize(("speed", "farthest", "elevation_deg"), [(101.1, 514.3, 39.5), (200.0, 949.0, 34.5)])
def test_farthest_flights_agree_with_an_independent_program(
    speed: float, farthest: float, elevation_deg: float
) -> None:
    found = flight(speed=speed, elevation=0.1, **PAPER)
    assert found.farthest_range == pytest.approx(farthest, abs=0.1)
    # Near its maximum the distance hardly changes, and the independent program sampled every half degree.
    assert math.degrees(found.farthest_elevation) == pytest.approx(elevation_deg, abs=0.25)


@pytest.mark.parametrize("height", [0.0, 7.5, 300.0])
@pytest.mark.parametrize("elevation_deg", [-30.0, 0.0, 10.0, 45.0, 80.0])
def test_flight_without_drag_is_a_parabola(elevation_deg: float, height: float) -> None:
    speed, elevation = 100.0, math.radians(elevation_deg)
    found = flight(speed=speed, elevation=elevation, height=height, drag_coefficient=0.0, mass=1.0, projected_area=1.0)
    climb = speed * math.sin(elevation)
    seconds = (climb + math.sqrt(climb**2 + 2.0 * GRAVITY * height)) / GRAVITY if climb > 0.0 or height > 0.0 else 0.0
    assert found.flight_time == pytest.approx(seconds, rel=1e-5)
    assert found.range == pytest.approx(speed * math.cos(elevation) * seconds, rel=1e-5)
    assert found.apex == pytest.approx(height + max(climb, 0.0) ** 2 / (2.0 * GRAVITY), rel=1e-5)
    assert found.impact_speed == pytest.approx(math.sqrt(speed**2 + 2.0 * GRAVITY * height), rel=1e-5)
    assert found.farthest_range == pytest.approx(found.range_without_drag, rel=1e-5)


def random_flight(number: int) -> tuple[dict[str, float], Flight]:
    draw = random.Random(number)  # noqa: S311 (bodies for a test)
    given = {
        "speed": 10.0 ** draw.uniform(0.0, 3.0),
        "mass": 10.0 ** draw.uniform(-3.0, 3.0),
        "projected_area": 10.0 ** draw.uniform(-5.0, 0.0),
        "drag_coefficient": draw.uniform(0.0, 2.0),
        "height": draw.choice((0.0, 10.0 ** draw.uniform(-1.0, 2.0))),
    }
    return given, flight(elevation=math.radians(draw.uniform(-90.0, 90.0)), **given)


@pytest.mark.parametrize("number", range(12))
def test_no_elevation_carries_farther_than_the_farthest_flight(number: int) -> None:
    given, found = random_flight(number)
    ranges = [flight(elevation=math.radians(each), **given).range for each in range(-80, 90, 40)]
    assert max(*ranges, found.range) <= found.farthest_range * (1.0 + 1e-6) + 1e-9
    assert found.farthest_range <= found.range_without_drag * (1.0 + 1e-6)


def test_drag_only_shortens_a_flight_and_slows_the_landing() -> None:
    ranges, speeds = zip(
        *(
            (found.range, found.impact_speed)
            for drag in (0.0, 0.5, 1.0, 2.0)
            for found in [flight(speed=100.0, elevation=0.5, mass=1.0, projected_area=0.01, drag_coefficient=drag)]
        ),
        strict=True,
    )
    assert list(ranges) == sorted(ranges, reverse=True)
    assert list(speeds) == sorted(speeds, reverse=True)


def test_flights_of_extreme_bodies_end() -> None:
    found = flight(speed=1e4, elevation=1.5, mass=1e-6, projected_area=20.0, drag_coefficient=10.0, height=1e4)
    terminal = math.sqrt(2.0 * 1e-6 * GRAVITY / (1.225 * 10.0 * 20.0))
    assert found.impact_speed == pytest.approx(terminal, rel=1e-3)


def test_mean_projected_area_is_a_quarter_of_the_surface() -> None:
    ball = Projectile(nose=Sphere(), diameter=0.02, length=0.02, mass=0.03)
    assert mean_projected_area(ball) == pytest.approx(math.pi * 0.01**2, rel=1e-9)
    cone = Projectile(nose=Conical(length_to_diameter=2.0), diameter=0.1, length=0.2, mass=1.0)
    slant = math.hypot(0.05, 0.2)
    assert mean_projected_area(cone) == pytest.approx(math.pi * 0.05 * (slant + 0.05) / 4.0, rel=1e-9)
    assert mean_projected_area(PAPER_PROJECTILE) == pytest.approx(0.032076, abs=1e-6)


@pytest.mark.parametrize(
    ("direction_deg", "tilt_deg", "plane", "rear", "elevation_deg"),
    [
        (70.82, 0.0, "up", False, 19.18),  # On a level face the elevation is the angle to the face.
        (70.82, 0.0, "down", False, 19.18),
        (70.0, 90.0, "up", False, 70.0),  # On a vertical wall, motion along the face is upwards, level or downwards.
        (70.0, 90.0, "level", False, 0.0),
        (70.0, 90.0, "down", False, -70.0),
        (0.0, 30.0, "up", False, 60.0),  # exit along the normal
        (20.0, 30.0, "up", False, 80.0),
        (20.0, 30.0, "down", False, 40.0),
        (30.0, 90.0, "up", True, 30.0),  # upwards, through the rear face of a wall
        (0.0, 0.0, "up", True, -90.0),  # downwards, through a slab
    ],
)
def test_elevation_follows_the_tilt_of_the_face(
    direction_deg: float, tilt_deg: float, plane: str, rear: bool, elevation_deg: float
) -> None:
    found = launch_elevation(
        direction=math.radians(direction_deg),
        face_tilt=math.radians(tilt_deg),
        incidence_plane=plane,  # type: ignore[arg-type]
        rear=rear,
    )
    assert math.degrees(found) == pytest.approx(elevation_deg, abs=1e-9)


GIVEN = {"speed": 100.0, "elevation": 0.5, "mass": 1.0, "projected_area": 0.01}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"speed": 0.0}, "flight.speed: must be more than 0 to 10,000 m/s"),
        ({"speed": math.nan}, "flight.speed: must be"),
        ({"elevation": 2.0}, "elevation: must be between -1.5708 and 1.5708"),
        ({"mass": 0.0}, "projectile.mass: must be 1e-6 to 1e7 kg"),
        ({"projected_area": 0.0}, "flight.projected_area: must be"),
        ({"drag_coefficient": -1.0}, "flight.drag_coefficient: must be 0 to 10"),
        ({"height": -1.0}, "flight.height: must be 0 to 10,000 m, got -1 m"),
    ],
)
def test_invalid_values_of_a_flight_are_refused(changed: dict[str, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        flight(**(GIVEN | changed))


def test_faces_tilted_beyond_vertical_are_refused() -> None:
    with pytest.raises(ParameterError, match=r"face_tilt: must be between 0 and 1\.5708"):
        launch_elevation(direction=0.1, face_tilt=math.radians(91.0))


def test_distances_in_sentences_are_rounded_up() -> None:
    found = flight(speed=101.1, elevation=math.radians(19.18), **PAPER)
    assert str(found) == (
        "Lands about 410 m away if it tumbles as computed, up to 520 m at any elevation, at most 1050 m without drag."
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"face_tilt": math.radians(91.0)}, r"face_tilt: must be between 0 and 1\.5708"),
        ({"face_tilt": -0.1}, "face_tilt: must be between"),
        ({"incidence_plane": "sideways"}, "incidence_plane: must be one of up, level, down"),
        ({"drag_coefficient": -0.5}, "flight.drag_coefficient: must be 0 to 10"),
        ({"height": -0.1}, r"flight.height: must be 0 to 10,000 m, got -0\.1 m"),
    ],
)
def test_invalid_conditions_of_a_flight_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        FlightConditions(**given)


def test_flight_after_an_exit_follows_from_its_speed_and_direction() -> None:
    left = Exit(101.1, math.radians(70.82), math.radians(19.18), 1.8, 40.0, 7e4, 0.6)
    level = flight_after(left, projectile=PAPER_PROJECTILE)
    assert level.range == pytest.approx(405.8, abs=0.1)
    wall = FlightConditions(face_tilt=math.radians(90.0), incidence_plane="down", height=5.0)
    assert flight_after(left, projectile=PAPER_PROJECTILE, conditions=wall).range < 2.0
    assert flight_after(left, projectile=PAPER_PROJECTILE, rear=True).range == 0.0  # through a slab, into the ground
