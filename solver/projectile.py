"""The projectile: the shapes of its nose, its outline, its dimensions and its mass properties."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from solver.arrays import FloatArray, gauss_rule
from solver.checks import require, require_finite, require_kind, require_number, require_positive

GAUSS_POINTS = 48  # on one piece of the outline; exact for lines, near machine precision for arcs
MATCH = 1e-6  # relative; how closely a profile must end at the radius of the shank: single precision suffices
DENT = 1e-4
"""How far a point of a profile may lie inside the line between others, over the size of the nose. Points of a straight
line lie off it by what they are rounded to, 1e-16 of its size or, to the micrometre, 1e-5; no nose is made to 1e-4. [1]
"""

Point = tuple[float, float]
"""Distance behind the tip and from the axis. [m]"""


@dataclass(frozen=True, slots=True)
class Line:
    """Straight piece of an outline: a cone, a cylinder or, across the axis, a flat face. [m]"""

    x_start: float
    r_start: float
    x_end: float
    r_end: float

    @property
    def length(self) -> float:
        """Along the outline. [m]"""
        return math.hypot(self.x_end - self.x_start, self.r_end - self.r_start)

    @property
    def tangent_angle(self) -> float:
        """α. [rad]"""
        return math.atan2(self.r_end - self.r_start, self.x_end - self.x_start)

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """x, r, sin α and cos α at the fractions `t` of its length."""
        rise, run = self.r_end - self.r_start, self.x_end - self.x_start
        level = np.ones_like(t)
        return self.x_start + t * run, self.r_start + t * rise, level * rise / self.length, level * run / self.length


@dataclass(frozen=True, slots=True)
class Arc:
    """Circular piece of an outline, ``x = x_center - R sin α``, ``r = r_center + R cos α``. [m, rad]"""

    x_center: float
    r_center: float
    radius: float
    angle_start: float
    angle_end: float

    @property
    def length(self) -> float:
        """Along the outline. [m]"""
        return self.radius * (self.angle_start - self.angle_end)

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """x, r, sin α and cos α at the fractions `t` of its length."""
        angle = self.angle_start + t * (self.angle_end - self.angle_start)
        sine, cosine = np.sin(angle), np.cos(angle)
        return self.x_center - self.radius * sine, self.r_center + self.radius * cosine, sine, cosine


OutlinePiece: TypeAlias = Line | Arc


class Nose(Protocol):
    """What a nose shape provides. `radius` is that of the shank. [m]"""

    @property
    def name(self) -> str:
        """Name of the shape in requests and results."""

    def length(self, radius: float) -> float:
        """From the tip to the shank. [m]"""

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Pieces from the tip to the shank."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ogive:
    """Tangent ogive.

    Parameters
    ----------
    caliber_radius_head
        ψ, ogive radius over shank diameter, at least 0.5 (a hemisphere). [1]
    """

    name: ClassVar[str] = "ogive"
    caliber_radius_head: float

    def __post_init__(self) -> None:
        _require_caliber_radius_head(self.caliber_radius_head)

    def length(self, radius: float) -> float:
        """``a sqrt(4 ψ - 1)``. [m]"""
        return radius * math.sqrt(4.0 * self.caliber_radius_head - 1.0)

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """One arc, tangent to the shank."""
        ogive_radius = 2.0 * radius * self.caliber_radius_head
        tip_angle = math.atan2(self.length(radius), ogive_radius - radius)
        return (Arc(self.length(radius), radius - ogive_radius, ogive_radius, tip_angle, 0.0),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Conical:
    """Cone.

    Parameters
    ----------
    length_to_diameter
        Cone height over shank diameter. [1]
    """

    name: ClassVar[str] = "conical"
    length_to_diameter: float

    def __post_init__(self) -> None:
        require_positive("projectile.nose.length_to_diameter", self.length_to_diameter)

    def length(self, radius: float) -> float:
        """Height of the cone. [m]"""
        return 2.0 * radius * self.length_to_diameter

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """One line."""
        return (Line(0.0, 0.0, self.length(radius), radius),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spherical:
    """Spherical cap.

    Parameters
    ----------
    caliber_radius_head
        Sphere radius over shank diameter, at least 0.5 (a hemisphere). [1]
    """

    name: ClassVar[str] = "spherical"
    caliber_radius_head: float

    def __post_init__(self) -> None:
        _require_caliber_radius_head(self.caliber_radius_head)

    def length(self, radius: float) -> float:
        """Height of the cap. [m]"""
        sphere = 2.0 * radius * self.caliber_radius_head
        return sphere - math.sqrt(sphere**2 - radius**2)

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """One arc, centred on the axis."""
        sphere = 2.0 * radius * self.caliber_radius_head
        return (Arc(sphere, 0.0, sphere, math.pi / 2.0, math.acos(radius / sphere)),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Flat:
    """Flat face: the shank cut square."""

    name: ClassVar[str] = "flat"

    def length(self, radius: float) -> float:
        """Zero. [m]"""
        return 0.0

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """One line, from the axis outwards."""
        return (Line(0.0, 0.0, 0.0, radius),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Convex chain of cones through points; a first radius above zero makes a flat face.

    Parameters
    ----------
    points
        (x, r) pairs from the tip, x from 0, neither decreasing; the last r is the shank's. A list or an array of them
        becomes a tuple. [m]

    Notes
    -----
    The outline goes through the points that span it: those within rounding of the line between others are left out.
    """

    name: ClassVar[str] = "profile"
    points: tuple[Point, ...]

    def __post_init__(self) -> None:
        field = "projectile.nose.points"
        object.__setattr__(self, "points", _points(field, self.points))
        require(self.points[0][0] == 0.0, f"{field}.0", "must start at x = 0")
        require(self.points[0][1] >= 0.0, f"{field}.0", "the radius must be at least 0")
        for index, ((x, r), (x_next, r_next)) in enumerate(pairwise(self.points), start=1):
            grows = x_next >= x and r_next >= r and (x_next, r_next) != (x, r)
            require(grows, f"{field}.{index}", "neither x nor r may decrease, nor a point repeat")
        require(self.points[-1][1] > 0.0, f"{field}.{len(self.points) - 1}", "the radius must be greater than 0")
        rise = _rise(self.points)
        require(rise is None, f"{field}.{rise}", "the profile must be convex, but the line to this point is steeper")

    def length(self, radius: float) -> float:
        """x of the last point. [m]"""
        return self.points[-1][0]

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """The flat face, if any, then a line between each pair of the points that span it."""
        blunt = self.points[0][1]
        face = (Line(0.0, 0.0, 0.0, blunt),) if blunt > 0.0 else ()
        spanning = (self.points[place] for place in _spanning(self.points))
        return face + tuple(Line(*start, *end) for start, end in pairwise(spanning))


def _points(field: str, given: object) -> tuple[Point, ...]:
    """Return points as pairs of numbers, which can be compared and hashed.

    Raises
    ------
    ParameterError
        If they are not from 2 to 1,000 pairs of finite numbers; it names the point.
    """
    rows = _members(given)
    require(rows is not None, field, f"must be (x, r) pairs, got {type(given).__name__}")
    rows = rows or ()
    require(2 <= len(rows) <= 1000, field, f"must hold 2 to 1000 points, got {len(rows)}")
    points = []
    for index, row in enumerate(rows):
        place, pair = f"{field}.{index}", _members(row) or ()
        require(len(pair) == 2, place, f"must be a pair (x, r), got {row!r}")
        for value in pair:
            require_finite(place, value)
        points.append((float(pair[0]), float(pair[1])))
    return tuple(points)


def _members(given: Any) -> tuple[Any, ...] | None:
    """Return what a list, a tuple or an array holds; None if it is nothing of the kind."""
    try:
        return None if isinstance(given, str) else tuple(given)
    except TypeError:
        return None


def _inside(start: Point, middle: Point, end: Point) -> float:
    """Return how far a point lies inside the line between two others, below 0 where it lies outside. [m]"""
    x, r = end[0] - start[0], end[1] - start[1]
    return ((middle[0] - start[0]) * r - (middle[1] - start[1]) * x) / math.hypot(x, r)


def _spanning(points: Sequence[Point]) -> list[int]:
    """Return the places of the points that span the convex chain around all of them, by Andrew's monotone chain."""
    kept: list[int] = []
    for place, point in enumerate(points):
        while len(kept) > 1 and _inside(points[kept[-2]], points[kept[-1]], point) >= 0.0:
            kept.pop()
        kept.append(place)
    return kept


def _rise(points: Sequence[Point]) -> int | None:
    """Return the place of the first point to which the slope rises in a dent of a profile; None if it has none."""
    size = math.hypot(*points[-1])
    for first, last in pairwise(_spanning(points)):
        if any(_inside(points[first], each, points[last]) > DENT * size for each in points[first + 1 : last]):
            return next(i for i in range(first + 2, last + 1) if _inside(*points[i - 2 : i + 1]) > 0.0)
    return None


NoseShape: TypeAlias = Ogive | Conical | Spherical | Flat | Profile


def _require_caliber_radius_head(value: float) -> None:
    field = "projectile.nose.caliber_radius_head"
    require_number(field, value)
    require(
        math.isfinite(value) and value >= 0.5,
        field,
        f"must be at least 0.5, got {value:g}",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Projectile:
    """A rigid body of revolution.

    Parameters
    ----------
    nose
        Shape of the nose.
    diameter, length
        Diameter of the shank, and distance from the tip to the flat base. [m]
    mass
        [kg]
    center_of_gravity
        Distance behind the nose tip; that of the homogeneous solid when not given. [m]
    moment_of_inertia
        About a transverse axis through the centre of gravity; that of the homogeneous solid when not given. [kg m²]

    Raises
    ------
    ParameterError
        If a value is not finite or outside its range, or the nose does not fit the body.
    """

    nose: NoseShape
    diameter: float
    length: float
    mass: float
    center_of_gravity: float | None = None
    moment_of_inertia: float | None = None

    def __post_init__(self) -> None:
        require_kind("projectile.nose", self.nose, NoseShape)
        require_positive("projectile.diameter", self.diameter)
        require_positive("projectile.length", self.length)
        require_positive("projectile.mass", self.mass)
        if isinstance(self.nose, Profile):
            end = self.nose.points[-1][1]
            require(
                math.isclose(end, self.radius, rel_tol=MATCH),
                "projectile.nose.points",
                f"must end at the radius of the shank, {self.radius:.9g} m, got {end:.9g} m",
            )
        require(
            self.length >= self.nose_length,
            "projectile.length",
            f"must be at least the length of the nose, {self.nose_length:.6g} m, got {self.length:g} m",
        )
        if self.center_of_gravity is not None:
            require_number("projectile.center_of_gravity", self.center_of_gravity)
            inside = math.isfinite(self.center_of_gravity) and 0.0 < self.center_of_gravity < self.length
            require(
                inside,
                "projectile.center_of_gravity",
                f"must be between the tip and the base, 0 and {self.length:g} m, got {self.center_of_gravity:g} m",
            )
        if self.moment_of_inertia is not None:
            require_positive("projectile.moment_of_inertia", self.moment_of_inertia)

    @property
    def radius(self) -> float:
        """Radius of the shank. [m]"""
        return self.diameter / 2.0

    @property
    def nose_length(self) -> float:
        """From the tip to the shank. [m]"""
        return self.nose.length(self.radius)

    def outline(self) -> tuple[OutlinePiece, ...]:
        """Pieces from the tip to the rear edge; the flat base is not part of it."""
        nose = self.nose.outline(self.radius)
        if self.length <= self.nose_length:
            return nose
        return (*nose, Line(self.nose_length, self.radius, self.length, self.radius))

    @property
    def base(self) -> Line:
        """The flat base, from the rear edge to the axis."""
        return Line(self.length, self.radius, self.length, 0.0)


@dataclass(frozen=True, slots=True)
class SolidProperties:
    """Geometry of the outer shape and of the homogeneous solid that fills it."""

    surface_area: float
    """Nose and shank, without the base. [m²]"""
    volume: float
    """[m³]"""
    centroid: float
    """Distance behind the tip. [m]"""
    inertia_per_mass: float
    """About a transverse axis through the centroid, for each unit of mass. [m²]"""


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Mass properties in use for one run."""

    mass: float
    """[kg]"""
    center_of_gravity: float
    """Distance behind the tip. [m]"""
    moment_of_inertia: float
    """About a transverse axis through the centre of gravity. [kg m²]"""


@lru_cache  # as for `mass_properties`
def solid_properties(projectile: Projectile) -> SolidProperties:
    """Geometry of the homogeneous solid of the outer shape, by Gauss quadrature on each piece."""
    t, w = gauss_rule(GAUSS_POINTS).T
    area = volume = first = second = 0.0
    for piece in projectile.outline():
        x, r, _, cosine = piece.at(t)
        along = w * piece.length
        dx = along * cosine
        disc = math.pi * r * r
        area += 2.0 * math.pi * float(r @ along)
        volume += float(disc @ dx)
        first += float((disc * x) @ dx)
        second += float((disc * (x * x + r * r / 4.0)) @ dx)
    centroid = first / volume
    return SolidProperties(area, volume, centroid, second / volume - centroid**2)


@lru_cache  # the cases of a study share few projectiles
def mass_properties(projectile: Projectile) -> MassProperties:
    """Mass properties in use: those given, the homogeneous solid's for the rest.

    Notes
    -----
    A moment of inertia that is not given is the homogeneous solid's about its own centroid, also when the centre
    of gravity is given: the two differ in the warnings of a run.
    """
    solid = solid_properties(projectile)
    center, inertia = projectile.center_of_gravity, projectile.moment_of_inertia
    return MassProperties(
        mass=projectile.mass,
        center_of_gravity=solid.centroid if center is None else center,
        moment_of_inertia=projectile.mass * solid.inertia_per_mass if inertia is None else inertia,
    )
