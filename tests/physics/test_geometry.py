"""Mass properties, panels and first contact, compared with closed forms and brute force."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from solver import (
    BoatTail,
    Conical,
    Flat,
    Ogive,
    Profile,
    Projectile,
    Sphere,
    Spherical,
    mass_properties,
    solid_properties,
)
from solver.projectile import Line, NoseShape
from solver.surface import build_body, build_panels, deepest_offset

from .strikes import NOSES, TAPERING, steel

A, LENGTH = 0.04, 0.53
"""Radius and length of the paper's projectile. [m]"""


@dataclass(frozen=True)
class Solid:
    """Closed forms for a solid of revolution, x from its front: area, ∫r² dx, ∫x r² dx and ∫(x² r² + r⁴/4) dx."""

    length: float
    area: float
    squares: float
    first: float
    second: float

    def followed_by(self, other: "Solid") -> "Solid":
        x = self.length
        return Solid(
            length=x + other.length,
            area=self.area + other.area,
            squares=self.squares + other.squares,
            first=self.first + other.first + x * other.squares,
            second=self.second + other.second + 2.0 * x * other.first + x**2 * other.squares,
        )


def cylinder(a: float, h: float) -> Solid:
    return Solid(h, 2 * math.pi * a * h, a**2 * h, a**2 * h**2 / 2, a**2 * h**3 / 3 + a**4 * h / 4)


def frustum(b: float, a: float, h: float) -> Solid:
    """Return a cone frustum with radius `b` in front and `a` behind, r = b + t x."""
    t = (a - b) / h
    squares = h * (a * a + a * b + b * b) / 3
    first = b**2 * h**2 / 2 + 2 * b * t * h**3 / 3 + t**2 * h**4 / 4
    fourths = h * (a**4 + a**3 * b + a**2 * b**2 + a * b**3 + b**4) / 5
    second = b**2 * h**3 / 3 + b * t * h**4 / 2 + t**2 * h**5 / 5 + fourths / 4
    return Solid(h, math.pi * (a + b) * math.hypot(h, a - b), squares, first, second)


def disc(a: float) -> Solid:
    """Return a flat face, which has an area but no volume."""
    return Solid(0.0, math.pi * a**2, 0.0, 0.0, 0.0)


def cap(sphere: float, h: float) -> Solid:
    """Return a spherical cap, r² = 2 R x - x²."""
    squares = sphere * h**2 - h**3 / 3
    first = 2 * sphere * h**3 / 3 - h**4 / 4
    fourths = 4 * sphere**2 * h**3 / 3 - sphere * h**4 + h**5 / 5
    second = sphere * h**4 / 2 - h**5 / 5 + fourths / 4
    return Solid(h, 2 * math.pi * sphere * h, squares, first, second)


def ogive(a: float, crh: float) -> Solid:
    """Return an ogive, r = w - c with w² = s² - u², where u is the distance ahead of the shank and c = s - a."""
    s = 2 * a * crh
    c, length = s - a, a * math.sqrt(4 * crh - 1)
    end = math.asin(length / s)
    w1 = (length * c + s**2 * end) / 2  # ∫w du
    w3 = s**4 * (3 * end / 8 + math.sin(2 * end) / 4 + math.sin(4 * end) / 32)  # ∫w³ du
    u2w = s**4 * (end / 8 - math.sin(4 * end) / 32)  # ∫u² w du
    w2 = s**2 * length - length**3 / 3
    w4 = s**4 * length - 2 * s**2 * length**3 / 3 + length**5 / 5
    squares = w2 - 2 * c * w1 + c**2 * length
    ahead = (s**2 + c**2) * length**2 / 2 - length**4 / 4 - 2 * c * (s**3 - c**3) / 3
    ahead2 = (s**2 + c**2) * length**3 / 3 - length**5 / 5 - 2 * c * u2w
    fourths = w4 - 4 * c * w3 + 6 * c**2 * w2 - 4 * c**3 * w1 + c**4 * length
    first = length * squares - ahead
    second = length**2 * squares - 2 * length * ahead + ahead2 + fourths / 4
    return Solid(length, 2 * math.pi * s * (length - c * end), squares, first, second)


NOSE_SOLIDS: dict[str, tuple[NoseShape, Solid]] = {
    "flat": (Flat(), disc(A)),
    "cone": (Conical(length_to_diameter=1.5), frustum(0.0, A, 0.12)),
    "slender cone": (Conical(length_to_diameter=6.0), frustum(0.0, A, 0.48)),
    "hemisphere": (Spherical(caliber_radius_head=0.5), cap(A, A)),
    "cap": (Spherical(caliber_radius_head=1.2), cap(0.096, 0.096 - math.sqrt(0.096**2 - A**2))),
    "shallow cap": (Spherical(caliber_radius_head=20.0), cap(1.6, 1.6 - math.sqrt(1.6**2 - A**2))),
    "ogive as hemisphere": (Ogive(caliber_radius_head=0.5), cap(A, A)),
    "ogive 0.8": (Ogive(caliber_radius_head=0.8), ogive(A, 0.8)),
    "ogive 3": (Ogive(caliber_radius_head=3.0), ogive(A, 3.0)),
    "ogive 10": (Ogive(caliber_radius_head=10.0), ogive(A, 10.0)),
    "truncated cone": (Profile(points=((0.0, 0.01), (0.1, A))), disc(0.01).followed_by(frustum(0.01, A, 0.1))),
    "two cones": (
        Profile(points=((0.0, 0.0), (0.05, 0.03), (0.1, A))),
        frustum(0.0, 0.03, 0.05).followed_by(frustum(0.03, A, 0.05)),
    ),
}


@pytest.fixture(params=NOSE_SOLIDS)
def nose(request: pytest.FixtureRequest) -> tuple[NoseShape, Solid]:
    return NOSE_SOLIDS[request.param]


def assert_properties_equal(projectile: Projectile, solid: Solid) -> None:
    found = solid_properties(projectile)
    centroid = solid.first / solid.squares
    assert found.surface_area == pytest.approx(solid.area, rel=1e-8)
    assert found.volume == pytest.approx(math.pi * solid.squares, rel=1e-8)
    assert found.centroid == pytest.approx(centroid, rel=1e-8)
    assert found.inertia_per_mass == pytest.approx(solid.second / solid.squares - centroid**2, rel=1e-8)


def test_nose_and_shank_equal_their_closed_forms(nose: tuple[NoseShape, Solid]) -> None:
    shape, solid = nose
    projectile = Projectile(nose=shape, diameter=2 * A, length=LENGTH, mass=1.0)
    assert projectile.nose_length == pytest.approx(solid.length, rel=1e-12, abs=1e-15)
    assert_properties_equal(projectile, solid.followed_by(cylinder(A, LENGTH - solid.length)))


def test_nose_without_a_shank_equals_its_closed_form(nose: tuple[NoseShape, Solid]) -> None:
    shape, solid = nose
    if solid.length >= 1e-3:  # Shorter bodies are refused.
        assert_properties_equal(Projectile(nose=shape, diameter=2 * A, length=shape.length(A), mass=1.0), solid)


BODY_SOLIDS: dict[str, tuple[Projectile, Solid]] = {
    "sphere": (TAPERING["sphere"], cap(A, 2 * A)),
    "fragment": (Projectile(nose=Sphere(), diameter=0.0206, length=0.0206, mass=0.0359), cap(0.0103, 0.0206)),
    "boat-tail": (
        TAPERING["boat-tail"],
        ogive(A, 3.0).followed_by(cylinder(A, 0.43 - A * math.sqrt(11.0))).followed_by(frustum(A, 0.025, 0.1)),
    ),
    "boat-tail to a point, right behind the nose": (
        Projectile(
            nose=Conical(length_to_diameter=1.0),
            diameter=2 * A,
            length=0.2,
            mass=1.0,
            boat_tail=BoatTail(length=0.2 - 2 * A, base_diameter=0.0),
        ),
        frustum(0.0, A, 2 * A).followed_by(frustum(A, 0.0, 0.2 - 2 * A)),
    ),
    "double cone": (TAPERING["double cone"], frustum(0.0, A, 0.1).followed_by(frustum(A, 0.0, 0.03))),
    "barrel": (
        TAPERING["barrel"],
        disc(0.02)
        .followed_by(frustum(0.02, A, 0.03))
        .followed_by(cylinder(A, 0.07))
        .followed_by(frustum(A, 0.02, 0.05)),
    ),
}


@pytest.mark.parametrize("name", BODY_SOLIDS)
def test_tapering_bodies_equal_their_closed_forms(name: str) -> None:
    projectile, solid = BODY_SOLIDS[name]
    assert_properties_equal(projectile, solid)
    base = math.pi * projectile.base.r_start**2
    panels = build_panels(projectile, mass_properties(projectile), 20_000)
    assert panels.area.sum() == pytest.approx(solid.area + base, rel=1e-3)


def test_sphere_has_the_properties_of_a_sphere() -> None:
    """A = 4πR², V = 4πR³/3, centroid R and I = 2mR²/5, for the spheres of Erkander and Pettersson."""
    (sphere, _), radius = BODY_SOLIDS["fragment"], 0.0103
    found, properties = solid_properties(sphere), mass_properties(sphere)
    assert found.surface_area == pytest.approx(4.0 * math.pi * radius**2, rel=1e-12)
    assert found.volume == pytest.approx(4.0 / 3.0 * math.pi * radius**3, rel=1e-12)
    assert properties.center_of_gravity == pytest.approx(radius, rel=1e-12)
    assert properties.moment_of_inertia == pytest.approx(0.4 * 0.0359 * radius**2, rel=1e-12)


def test_closed_forms_reproduce_textbook_solids() -> None:
    """Cone: V = πa²h/3, centroid 3h/4, I/m = 3a²/20 + 3h²/80. Hemisphere: 5a/8 and 83a²/320. Cylinder: a²/4 + h²/12."""
    for solid, volume, centroid, inertia in (
        (frustum(0.0, 2.0, 3.0), 4 * math.pi, 9 / 4, 3 * 4 / 20 + 3 * 9 / 80),
        (cap(2.0, 2.0), 16 * math.pi / 3, 5 / 4, 83 * 4 / 320),
        (cylinder(2.0, 3.0), 12 * math.pi, 3 / 2, 1 + 9 / 12),
    ):
        assert math.pi * solid.squares == pytest.approx(volume, rel=1e-14)
        assert solid.first / solid.squares == pytest.approx(centroid, rel=1e-14)
        assert solid.second / solid.squares - (solid.first / solid.squares) ** 2 == pytest.approx(inertia, rel=1e-13)


def test_given_mass_properties_are_used_as_they_are() -> None:
    projectile = Projectile(
        nose=Flat(), diameter=0.08, length=0.5, mass=13.0, center_of_gravity=0.2, moment_of_inertia=0.3
    )
    properties = mass_properties(projectile)
    assert (properties.mass, properties.center_of_gravity, properties.moment_of_inertia) == (13.0, 0.2, 0.3)


def test_panel_areas_converge_to_the_surface_area_with_the_square_of_their_size(nose: tuple[NoseShape, Solid]) -> None:
    """The midpoint rule for the rings is exact on straight pieces and of second order on arcs."""
    shape, _ = nose
    projectile = Projectile(nose=shape, diameter=2 * A, length=LENGTH, mass=1.0)
    area, properties = solid_properties(projectile).surface_area + math.pi * A**2, mass_properties(projectile)
    errors = [abs(build_panels(projectile, properties, n).area.sum() / area - 1.0) for n in (1_200, 4_800, 19_200)]
    assert errors[-1] < 1e-4
    for coarse, fine in pairwise(errors):
        assert fine < 1e-12 or 3.0 < coarse / fine < 5.0


def brute_force_reach(projectile: Projectile, center: float, axis_angle: float) -> float:
    """Return how far the deepest of many points on both meridians lies below the centre of gravity. [m]"""
    t = np.linspace(0.0, 1.0, 20_001)
    reach = -math.inf
    for piece in projectile.outline():
        x, r, _, _ = piece.at(t)
        for side in (-1.0, 1.0):
            depth = (center - x) * math.cos(axis_angle) - side * r * math.sin(axis_angle)
            reach = max(reach, float(depth.max()))
    return reach


@pytest.mark.parametrize("name", [*NOSES, *TAPERING])
def test_first_contact_is_the_deepest_point_of_the_surface(name: str) -> None:
    """The deepest point may be the tip, the flank or the rear edge. Brute force is accurate to 10⁻⁸ of the length."""
    projectile = TAPERING[name] if name in TAPERING else steel(NOSES[name])
    properties = mass_properties(projectile)
    body = build_body(projectile, properties)
    for degrees in (0, 1e-6, 3, 20, 45, 60, 75, 80.4, 85, 89.9, 90, 90.1, 100, 135, 170, 179, 180):
        for angle in (math.radians(degrees), -math.radians(degrees)):
            expected = brute_force_reach(projectile, properties.center_of_gravity, angle)
            assert deepest_offset(body, angle) == pytest.approx(expected, abs=1e-8 * LENGTH)


def test_pointed_nose_touches_with_its_tip_up_to_the_angle_of_its_flank() -> None:
    """The flank touches first beyond 90° less the half-angle of the tip, 90° - 33.56° for ψ = 3."""
    projectile = steel(NOSES["ogive"])
    properties = mass_properties(projectile)
    body = build_body(projectile, properties)
    flank = math.pi / 2 - math.atan2(math.sqrt(11.0), 5.0)
    for degrees in (-1.0, 1.0):
        angle = flank + math.radians(degrees)
        tip = properties.center_of_gravity * math.cos(angle)
        assert (deepest_offset(body, angle) > tip + 1e-9) == (degrees > 0.0)


@pytest.mark.parametrize("digits", [None, 6, "single precision"])
def test_rounded_points_on_a_straight_line_are_a_cone(digits: int | str | None) -> None:
    rng = np.random.default_rng(32)
    for _ in range(200):
        length, radius = rng.uniform(0.05, 0.5), rng.uniform(0.02, 0.1)
        radius = round(float(radius), 6)
        share = np.concatenate([[0.0], np.sort(rng.uniform(0.01, 0.99, rng.integers(1, 60))), [1.0]])
        points = np.outer(share, (length, radius))
        if isinstance(digits, int):
            points = np.unique(points.round(digits), axis=0)
        elif digits:
            points = points.astype(np.float32)
        nose = Profile(points=points)  # type: ignore[arg-type]
        body = Projectile(nose=nose, diameter=2.0 * radius, length=1.0, mass=10.0)
        cone = Projectile(
            nose=Conical(length_to_diameter=0.5 * length / radius), diameter=2.0 * radius, length=1.0, mass=10.0
        )
        assert solid_properties(body).surface_area == pytest.approx(solid_properties(cone).surface_area, rel=1e-4)
        assert solid_properties(body).volume == pytest.approx(solid_properties(cone).volume, rel=1e-4)
        lines = [piece for piece in nose.outline(radius) if isinstance(piece, Line)]
        slopes = [math.atan2(line.r_end - line.r_start, line.x_end - line.x_start) for line in lines]
        assert all(later <= earlier + 1e-12 for earlier, later in pairwise(slopes))


def test_finely_sampled_arc_in_single_precision_counts_as_convex() -> None:
    nose = Ogive(caliber_radius_head=3.0)
    (arc,) = nose.outline(A)
    x, r, _, _ = arc.at(np.linspace(0.0, 1.0, 1000))
    points = np.column_stack([x - x[0], r]).astype(np.float32)
    points[0] = 0.0
    sampled = Projectile(nose=Profile(points=points), diameter=2.0 * A, length=LENGTH, mass=13.0)  # type: ignore[arg-type]
    exact = Projectile(nose=nose, diameter=2.0 * A, length=LENGTH, mass=13.0)
    assert solid_properties(sampled).volume == pytest.approx(solid_properties(exact).volume, rel=1e-5)


def test_lists_and_arrays_of_points_give_the_same_profile() -> None:
    points = ((0.0, 0.01), (0.06, 0.03), (0.12, 0.04))
    expected = Profile(points=points)
    for given in ([list(point) for point in points], np.array(points), [*map(np.array, points)]):
        nose = Profile(points=given)  # type: ignore[arg-type]
        assert nose == expected
        assert hash(nose) == hash(expected)
        assert all(type(value) is float for point in nose.points for value in point)
        body = Projectile(nose=nose, diameter=2.0 * A, length=LENGTH, mass=13.0)
        assert mass_properties(body).center_of_gravity > 0.0
