"""The projectile, a rigid body of revolution, and its mass properties."""

import math
from dataclasses import dataclass
from functools import lru_cache

from solver.arrays import gauss_rule
from solver.nose import Line, NoseShape, OutlinePiece, Profile
from solver.validation import require, require_kind, require_number, require_positive

GAUSS_POINTS = 48  # on one piece of the outline; exact for lines, near machine precision for arcs
MATCH = 1e-9  # relative; how closely a profile must end at the radius of the shank


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
                f"must end at the radius of the shank, {self.radius:g} m, got {end:g} m",
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
