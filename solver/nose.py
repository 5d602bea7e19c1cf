"""Nose shapes, and the pieces that an outline is made of.

An outline in a meridian plane is a chain of straight lines and circular arcs; x is the distance behind the nose tip, r
the distance from the axis. α is the angle between the axis and the tangent, so the outward normal is (sin α towards the
nose, cos α away from the axis).
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeAlias

import numpy as np

from solver.arrays import FloatArray
from solver.validation import require, require_finite, require_number, require_positive


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
        (x, r) pairs from the tip, x from 0, neither decreasing; the last r is the shank's. [m]
    """

    name: ClassVar[str] = "profile"
    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        field = "projectile.nose.points"
        require(2 <= len(self.points) <= 1000, field, f"must hold 2 to 1000 points, got {len(self.points)}")
        for index, point in enumerate(self.points):
            for value in point:
                require_finite(f"{field}.{index}", value)
        require(self.points[0][0] == 0.0, f"{field}.0", "must start at x = 0")
        require(self.points[0][1] >= 0.0, f"{field}.0", "the radius must be at least 0")
        angle = math.pi / 2.0
        for index, piece in enumerate(self._lines(), start=1):
            rises = piece.x_end >= piece.x_start and piece.r_end >= piece.r_start
            grows = rises and piece.length > 0.0
            require(grows, f"{field}.{index}", "neither x nor r may decrease, nor a point repeat")
            require(piece.tangent_angle <= angle, f"{field}.{index}", "the profile must be convex")
            angle = piece.tangent_angle
        require(self.points[-1][1] > 0.0, f"{field}.{len(self.points) - 1}", "the radius must be greater than 0")

    def length(self, radius: float) -> float:
        """x of the last point. [m]"""
        return self.points[-1][0]

    def outline(self, radius: float) -> tuple[OutlinePiece, ...]:
        """The flat face, if any, then a line between each pair of points."""
        blunt = self.points[0][1]
        face = (Line(0.0, 0.0, 0.0, blunt),) if blunt > 0.0 else ()
        return face + self._lines()

    def _lines(self) -> tuple[Line, ...]:
        return tuple(Line(*start, *end) for start, end in zip(self.points, self.points[1:], strict=False))


NoseShape: TypeAlias = Ogive | Conical | Spherical | Flat | Profile


def _require_caliber_radius_head(value: float) -> None:
    field = "projectile.nose.caliber_radius_head"
    require_number(field, value)
    require(
        math.isfinite(value) and value >= 0.5,
        field,
        f"must be at least 0.5, got {value:g}",
    )
