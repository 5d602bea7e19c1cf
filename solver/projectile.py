"""Projectile: nose shapes, outline, dimensions and mass properties."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from solver.arrays import FloatArray, gauss_rule
from solver.checks import (
    ParameterError,
    plain,
    require,
    require_bounds,
    require_finite,
    require_kind,
    require_one,
)
from solver.units import Amount

# Integrands over lines are polynomials, which this rule integrates exactly; integrals over arcs are accurate to
# nearly machine precision.
GAUSS_POINTS = 48
"""Number of Gauss-Legendre points on one piece of the outline."""
# The tolerance accepts dimensions that were stored in single precision.
MATCH = 1e-6
"""Relative tolerance of dimensions that must agree, such as the radii of a profile and the shank. [1]"""
MATCH_DIGITS = 9
"""Significant digits of dimensions in the error about a mismatch, enough to show a difference of `MATCH`. [1]"""
# Rounding moves points off a straight line: by 1e-16 of the size of the nose or, if they are given to the micrometre,
# by about 1e-5. No nose is manufactured to 1e-4 of its size.
DENT = 1e-4
"""Largest distance by which a point of a profile may lie inside the line between two others, relative to the size of
the profile. [1]"""

Point = tuple[float, float]
"""Distance behind the tip, and distance from the axis. [m]"""


@dataclass(frozen=True, slots=True)
class Line:
    """Straight piece of an outline: a cone, a cylinder or, across the axis, a flat face. [m]

    α is the angle from the axis to the outline, positive where the radius grows.
    """

    x_start: float
    r_start: float
    x_end: float
    r_end: float

    @property
    def length(self) -> float:
        """Length along the outline. [m]"""
        return math.hypot(self.x_end - self.x_start, self.r_end - self.r_start)

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x, r, sin α and cos α at the fractions `t` of the length. [m, m, 1, 1]"""
        rise, run = self.r_end - self.r_start, self.x_end - self.x_start
        level = np.ones_like(t)
        return self.x_start + t * run, self.r_start + t * rise, level * rise / self.length, level * run / self.length


@dataclass(frozen=True, slots=True)
class Arc:
    """Circular piece of an outline, ``x = x_center - R sin α``, ``r = r_center + R cos α``. [m, rad]

    α is the angle from the axis to the outline, as for a `Line`.
    """

    x_center: float
    r_center: float
    radius: float
    angle_start: float
    angle_end: float

    @property
    def length(self) -> float:
        """Length along the outline. [m]"""
        return self.radius * (self.angle_start - self.angle_end)

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x, r, sin α and cos α at the fractions `t` of the length. [m, m, 1, 1]"""
        angle = self.angle_start + t * (self.angle_end - self.angle_start)
        sine, cosine = np.sin(angle), np.cos(angle)
        return self.x_center - self.radius * sine, self.r_center + self.radius * cosine, sine, cosine


OutlinePiece: TypeAlias = Line | Arc


class Nose(Protocol):
    """Interface of nose shapes; `radius` is always the radius of the shank. [m]"""

    @property
    def name(self) -> str:
        """Name of the shape in requests and results."""

    def length(self, radius: float) -> float:
        """Return the length from the tip to the shank. [m]"""

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return the pieces of the outline from the tip to the shank."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ogive:
    """Tangent ogive: a circular arc that meets the shank without a corner.

    Parameters
    ----------
    caliber_radius_head
        Radius ψ of the nose arc divided by the shank diameter; 0.5 is a hemisphere, and 100 a nose ten times as long as
        the shank is wide. [1]
    """

    name: ClassVar[str] = "ogive"
    caliber_radius_head: float

    def __post_init__(self) -> None:
        require_bounds("projectile.nose.caliber_radius_head", self.caliber_radius_head)

    def length(self, radius: float) -> float:
        """Return the length ``a sqrt(4 ψ - 1)`` for the radius a of the shank. [m]"""
        return radius * math.sqrt(4.0 * self.caliber_radius_head - 1.0)

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return one arc, tangent to the shank."""
        ogive_radius = 2.0 * radius * self.caliber_radius_head
        tip_angle = math.atan2(self.length(radius), ogive_radius - radius)
        return (Arc(self.length(radius), radius - ogive_radius, ogive_radius, tip_angle, 0.0),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Conical:
    """Conical nose.

    Parameters
    ----------
    length_to_diameter
        Height of the cone divided by the shank diameter. [1]
    """

    name: ClassVar[str] = "conical"
    length_to_diameter: float

    def __post_init__(self) -> None:
        require_bounds("projectile.nose.length_to_diameter", self.length_to_diameter)

    def length(self, radius: float) -> float:
        """Return the height of the cone. [m]"""
        return 2.0 * radius * self.length_to_diameter

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return one line, from the tip to the shank."""
        return (Line(0.0, 0.0, self.length(radius), radius),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spherical:
    """Spherical cap.

    Parameters
    ----------
    caliber_radius_head
        Radius of the sphere divided by the shank diameter; 0.5, a hemisphere, when not given. [1]
    """

    name: ClassVar[str] = "spherical"
    caliber_radius_head: float = 0.5

    def __post_init__(self) -> None:
        require_bounds("projectile.nose.caliber_radius_head", self.caliber_radius_head)

    def length(self, radius: float) -> float:
        """Return the height of the cap. [m]"""
        sphere = 2.0 * radius * self.caliber_radius_head
        return sphere - math.sqrt(sphere**2 - radius**2)

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return one arc, centred on the axis."""
        sphere = 2.0 * radius * self.caliber_radius_head
        return (Arc(sphere, 0.0, sphere, math.pi / 2.0, math.acos(radius / sphere)),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Flat:
    """Flat face: the shank cut square."""

    name: ClassVar[str] = "flat"

    def length(self, radius: float) -> float:
        """Return zero: a flat face has no length. [m]"""
        return 0.0

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return one line, from the axis outwards."""
        return (Line(0.0, 0.0, 0.0, radius),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Convex chain of cones through given points, with a flat face if the first radius is above zero.

    Parameters
    ----------
    points
        (x, r) pairs from the tip on, where x starts at 0 and does not decrease. If r does not decrease either, its last
        value is the radius of the shank. If r decreases behind the widest point, the profile is that of the whole body,
        which ends in a flat base or in a point. A list or an array of pairs becomes a tuple. [m]

    Raises
    ------
    ParameterError
        If the points are not such pairs, or the profile is not convex. The error names the offending point.

    Notes
    -----
    The outline leaves out points that lie on the line between two others, or inside it by at most 1e-4 of the size.
    """

    name: ClassVar[str] = "profile"
    points: tuple[Point, ...]

    def __post_init__(self) -> None:
        field = "projectile.nose.points"
        object.__setattr__(self, "points", _points(field, self.points))
        require(self.points[0][0] == 0.0, f"{field}.0", "must start at x = 0")
        require(self.points[0][1] >= 0.0, f"{field}.0", "the radius must be at least 0")
        for index, ((x, r), (x_next, r_next)) in enumerate(pairwise(self.points), start=1):
            place = f"{field}.{index}"
            require(x_next >= x and (x_next, r_next) != (x, r), place, "x may not decrease, nor a point repeat")
            require(r_next >= 0.0, place, "the radius must be at least 0")
            open_behind = x_next > x or r_next > r
            require(open_behind, place, "the flat base closes the body behind: leave out points across it")
        require(self.widest > 0.0, f"{field}.{len(self.points) - 1}", "the radius must be greater than 0")
        dent = _first_dent(self.points)
        if dent is not None:
            slope = "steeper" if self.points[dent][1] > self.points[dent - 1][1] else "less steep"
            text = f"the profile must be convex, but the line to this point is {slope}"
            raise ParameterError(f"{field}.{dent}", text)

    @property
    def widest(self) -> float:
        """Largest radius. [m]"""
        return max(r for _, r in self.points)

    @property
    def falls(self) -> bool:
        """True if the radius falls behind the widest point: the profile is then that of the whole body."""
        return self.end_radius < self.widest

    @property
    def end_radius(self) -> float:
        """Radius of the last point. [m]"""
        return self.points[-1][1]

    def length(self, radius: float) -> float:
        """Return x at the end of the nose: at the last point, or at the first widest point of a whole body. [m]"""
        widest = self.widest
        return next(x for x, r in self.points if r == widest) if self.falls else self.points[-1][0]

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return the flat face, if any, and the lines that span the nose."""
        blunt = self.points[0][1]
        face = (Line(0.0, 0.0, 0.0, blunt),) if blunt > 0.0 else ()
        end = self.length(radius)
        return face + tuple(line for line in self._lines() if line.x_end <= end)

    def tail(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return the lines behind the widest point; there are none unless the profile is a whole body."""
        end = self.length(radius)
        return tuple(line for line in self._lines() if line.x_end > end)

    def _lines(self) -> tuple[Line, ...]:
        spanning = (self.points[place] for place in _spanning(self.points))
        return tuple(Line(*start, *end) for start, end in pairwise(spanning))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """Sphere: a whole body without a shank."""

    name: ClassVar[str] = "sphere"
    falls: ClassVar[bool] = True
    end_radius: ClassVar[float] = 0.0

    def length(self, radius: float) -> float:
        """Return the length of the half ahead of the widest point. [m]"""
        return radius

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return the front half, as one arc."""
        return (Arc(radius, 0.0, radius, math.pi / 2.0, 0.0),)

    def tail(self, radius: float) -> tuple[OutlinePiece, ...]:
        """Return the rear half, as one arc."""
        return (Arc(radius, 0.0, radius, 0.0, -math.pi / 2.0),)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoatTail:
    """Cone behind the shank, narrower toward the base.

    Parameters
    ----------
    length
        Length of the tapering part, at most the length behind the nose. [m]
    base_diameter
        Diameter of the flat base, at most that of the shank. [m]
    """

    length: float
    base_diameter: float

    def __post_init__(self) -> None:
        require_bounds("projectile.boat_tail.length", self.length)
        require_bounds("projectile.boat_tail.base_diameter", self.base_diameter)


def _points(field: str, given: object) -> tuple[Point, ...]:
    """Convert points to a tuple of pairs of floats, which can be compared and hashed.

    Raises
    ------
    ParameterError
        Unless there are 2 to 1,000 pairs of finite numbers. The error names the offending point.
    """
    rows = _members(plain(given))
    require(rows is not None, field, f"must be (x, r) pairs, got {type(given).__name__}")
    rows = rows or ()
    # A thousand points resolve a nose to a thousandth of its length, and each adds a piece of the outline to integrate.
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
    """Return the items of an iterable as a tuple; None for a string or an object that is not iterable."""
    try:
        return None if isinstance(given, str) else tuple(given)
    except TypeError:
        return None


def _inside(start: Point, middle: Point, end: Point) -> float:
    """Return the signed distance of a point from the line through two others, positive on the inner side. [m]"""
    x, r = end[0] - start[0], end[1] - start[1]
    return ((middle[0] - start[0]) * r - (middle[1] - start[1]) * x) / math.hypot(x, r)


def _spanning(points: Sequence[Point]) -> list[int]:
    """Return the indices of the points on the convex chain around all points, by Andrew's monotone chain (1979)."""
    kept: list[int] = []
    for place, point in enumerate(points):
        while len(kept) > 1 and _inside(points[kept[-2]], points[kept[-1]], point) >= 0.0:
            kept.pop()
        kept.append(place)
    return kept


def _first_dent(points: Sequence[Point]) -> int | None:
    """Return the index of the end of the first line in a dent whose slope exceeds that of the line before it.

    The result is None without a dent.
    """
    size = math.hypot(*points[-1])
    for first, last in pairwise(_spanning(points)):
        if any(_inside(points[first], each, points[last]) > DENT * size for each in points[first + 1 : last]):
            return next(i for i in range(first + 2, last + 1) if _inside(*points[i - 2 : i + 1]) > 0.0)
    return None


NoseShape: TypeAlias = Ogive | Conical | Spherical | Flat | Profile | Sphere


@dataclass(frozen=True, slots=True, kw_only=True)
class Projectile:
    """Rigid body of revolution.

    Parameters
    ----------
    nose
        Shape of the nose, or of the whole body: a sphere, or a profile that falls behind its widest point.
    diameter
        Diameter of the shank, or the largest diameter of a body without a shank. The bounds, 1 mm and 5 m, include
        pellets and the largest bombs. [m]
    length
        Distance from the nose tip to the flat base, at least the length of the nose. For a body without a shank it is
        the whole length. [m]
    mass
        Mass. The upper bound is about the mass of a uranium cylinder 5 m wide and 20 m long. [kg]
    center_of_gravity
        Distance of the centre of gravity behind the nose tip, less than the length; that of a homogeneous body when
        not given. [m]
    moment_of_inertia
        Moment of inertia about a transverse axis through the centre of gravity; that of a homogeneous body when not
        given. [kg m²]
    boat_tail
        Taper behind the shank; a cylinder up to the base when not given.
    inner_diameter
        Diameter of a bore along the whole cylindrical shank, less than the diameter of the shank. When not given, the
        shank is solid, as nose and boat-tail always are. [m]
    yield_strength
        Yield strength of the body, 1.2 GPa when not given. The bending stress is compared with it; the motion does not
        depend on it. [Pa]

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
    boat_tail: BoatTail | None = None
    inner_diameter: float | None = None
    yield_strength: float | None = None

    def __post_init__(self) -> None:
        require_kind("projectile.nose", self.nose, NoseShape)
        for name in ("diameter", "length", "mass"):
            require_bounds(f"projectile.{name}", getattr(self, name))
        if isinstance(self.nose, Profile):
            self._check_profile(self.nose)
        if isinstance(self.nose, Sphere):
            require(
                math.isclose(self.length, self.diameter, rel_tol=MATCH),
                "projectile.length",
                "must be the diameter of the sphere, {}, got {}",
                *(Amount(each, "mm", MATCH_DIGITS) for each in (self.diameter, self.length)),
            )
        require(
            self.length >= self.nose_length,
            "projectile.length",
            "must be at least the length of the nose, {}, got {}",
            Amount(self.nose_length, "mm"),
            Amount(self.length, "mm"),
        )
        if self.boat_tail is not None:
            self._check_boat_tail(self.boat_tail)
        if self.center_of_gravity is not None:
            require_bounds("projectile.center_of_gravity", self.center_of_gravity)
            inside = 0.0 < self.center_of_gravity < self.length
            require(
                inside,
                "projectile.center_of_gravity",
                "must be between the tip and the base, 0 and {}, got {}",
                Amount(self.length, "mm"),
                Amount(self.center_of_gravity, "mm"),
            )
        if self.moment_of_inertia is not None:
            require_bounds("projectile.moment_of_inertia", self.moment_of_inertia)
        if self.inner_diameter is not None:
            field = "projectile.inner_diameter"
            require_bounds(field, self.inner_diameter)
            require(
                self.inner_diameter < self.diameter,
                field,
                "must be less than the diameter, {}, got {}",
                Amount(self.diameter, "mm"),
                Amount(self.inner_diameter, "mm"),
            )
            require(self._whole is None, field, f"must be left out: the {self.nose.name} has no shank to be hollow")
        if self.yield_strength is not None:
            require_bounds("projectile.yield_strength", self.yield_strength)

    def _check_profile(self, nose: Profile) -> None:
        """Raise `ParameterError` if a profile does not fit the diameter or, for a whole body, the length."""
        field = "projectile.nose.points"
        require(
            math.isclose(nose.widest, self.radius, rel_tol=MATCH),
            field,
            f"must {'be as wide as' if nose.falls else 'end at the radius of'} the shank, {{}}, got {{}}",
            *(Amount(each, "mm", MATCH_DIGITS) for each in (self.radius, nose.widest)),
        )
        end = nose.points[-1][0]
        require(
            not nose.falls or math.isclose(end, self.length, rel_tol=MATCH),
            field,
            "must reach to the base, {} behind the tip, as the radius falls behind its widest point, but end at {}",
            *(Amount(each, "mm", MATCH_DIGITS) for each in (self.length, end)),
        )

    def _check_boat_tail(self, boat_tail: BoatTail) -> None:
        """Raise `ParameterError` if a boat-tail is too long or too wide, or the body has no shank."""
        require_one("projectile.boat_tail", boat_tail, BoatTail)
        field, room = "projectile.boat_tail", self.length - self.nose_length
        require(self._whole is None, field, f"must be left out: the {self.nose.name} is the whole body")
        require(
            boat_tail.length <= room * (1.0 + MATCH),
            f"{field}.length",
            "must be at most the length behind the nose, {}, got {}",
            Amount(room, "mm"),
            Amount(boat_tail.length, "mm"),
        )
        require(
            boat_tail.base_diameter <= self.diameter,
            f"{field}.base_diameter",
            "must be at most the diameter of the shank, {}, got {}",
            Amount(self.diameter, "mm"),
            Amount(boat_tail.base_diameter, "mm"),
        )

    @property
    def _whole(self) -> Sphere | Profile | None:
        """Nose that is the whole body, without a shank; None for other noses."""
        return self.nose if isinstance(self.nose, Sphere | Profile) and self.nose.falls else None

    @property
    def radius(self) -> float:
        """Radius of the shank. [m]"""
        return self.diameter / 2.0

    @property
    def nose_length(self) -> float:
        """Length from the tip to the shank. [m]"""
        return self.nose.length(self.radius)

    @property
    def shank_end(self) -> float:
        """Distance from the tip to the boat-tail or, without one, to the base. [m]"""
        if self.boat_tail is None:
            return self.length
        room = self.length - self.nose_length
        return self.length - self.boat_tail.length if self.boat_tail.length < room else self.nose_length

    def outline(self) -> tuple[OutlinePiece, ...]:
        """Return the pieces of the outline from the tip to the rear edge, without the flat base."""
        pieces, whole, end = self.nose.outline(self.radius), self._whole, self.shank_end
        if whole is not None:
            return (*pieces, *whole.tail(self.radius))
        if end > self.nose_length:
            pieces = (*pieces, Line(self.nose_length, self.radius, end, self.radius))
        if self.boat_tail is not None:
            pieces = (*pieces, Line(end, self.radius, self.length, self.boat_tail.base_diameter / 2.0))
        return pieces

    @property
    def base(self) -> Line:
        """Flat base, from the rear edge to the axis; its length is zero if the body ends in a point."""
        radius = self.radius
        if self._whole is not None:
            radius = self._whole.end_radius
        elif self.boat_tail is not None:
            radius = self.boat_tail.base_diameter / 2.0
        return Line(self.length, radius, self.length, 0.0)


@dataclass(frozen=True, slots=True)
class SolidProperties:
    """Geometry of the outer surface, and of the homogeneous solid within it, less the bore."""

    surface_area: float
    """Area of the outer surface without the flat base. [m²]"""
    volume: float
    """Volume of the solid. [m³]"""
    centroid: float
    """Distance of the centroid behind the tip. [m]"""
    inertia_per_mass: float
    """Moment of inertia divided by the mass, about a transverse axis through the centroid. [m²]"""


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Mass properties used in a run."""

    mass: float
    """Mass of the projectile. [kg]"""
    center_of_gravity: float
    """Distance of the centre of gravity behind the tip. [m]"""
    moment_of_inertia: float
    """Moment of inertia about a transverse axis through the centre of gravity. [kg m²]"""


@lru_cache  # the cases of a study share few projectiles
def solid_properties(projectile: Projectile) -> SolidProperties:
    """Compute the geometry of the homogeneous solid of the outer shape, less the bore, by Gauss quadrature."""
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
    if projectile.inner_diameter is not None:
        begin, end, bore = projectile.nose_length, projectile.shank_end, projectile.inner_diameter / 2.0
        hole = math.pi * bore**2
        volume -= hole * (end - begin)
        first -= hole * (end**2 - begin**2) / 2.0
        second -= hole * ((end**3 - begin**3) / 3.0 + bore**2 / 4.0 * (end - begin))
    centroid = first / volume
    return SolidProperties(area, volume, centroid, second / volume - centroid**2)


@lru_cache  # the cases of a study share few projectiles
def mass_properties(projectile: Projectile) -> MassProperties:
    """Return the mass properties in use: as given, or else those of the homogeneous solid.

    Notes
    -----
    A moment of inertia that is not given is that of the homogeneous solid about its own centroid, even if another
    centre of gravity is given. The warnings of a run name those that were not given.
    """
    solid = solid_properties(projectile)
    center, inertia = projectile.center_of_gravity, projectile.moment_of_inertia
    return MassProperties(
        mass=projectile.mass,
        center_of_gravity=solid.centroid if center is None else center,
        moment_of_inertia=projectile.mass * solid.inertia_per_mass if inertia is None else inertia,
    )
