"""Surface of a projectile for the compiled code: pieces of its outline, and the paper's panels.

A ring is the circle of the surface at one place of the outline. α is the angle from the axis to the outline, and β the
angle around the axis, from the direction in which the nose moves as the axis angle grows. The outward normal thus has
the component sin α along the axis, and cos α cos β in that direction.

A piece of the outline is cut into stretches on which the loaded arcs of the rings change smoothly. The cuts are where
the face, or the separation line beyond which elements recede from the target, crosses the top or the bottom of a ring.
"""

import math
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, arc_cosine, sine
from solver.checks import require
from solver.compilation import compiled, lean
from solver.projectile import Arc, Line, MassProperties, OutlinePiece, Projectile

LINE, ARC = 0.0, 1.0
"""Kinds of outline pieces, as in the first column of `Body.outline`."""
BOUNDED, TAPERED, CENTRED = 1, 2, 4
"""Flags of a body, whose sum is `Body.bounds`.

`BOUNDED`: the radius of some cavity is limited toward both faces. `TAPERED`: the radius of some cavity is limited
toward the rear face only. `CENTRED`: all normals pass through the centre of gravity, as in a sphere, so no load turns
the body. `sections` explains the limit on a cavity."""
# A centre of gravity computed from the shape misses the centre by rounding errors, which are far below this bound.
CENTRED_WITHIN = 1e-9
"""Largest distance from the centre of a sphere to its centre of gravity with which it counts as `CENTRED`, relative
to its radius. [1]"""

# Where the base faces the impact face, the channel that the body has cut is behind it. This is an unbounded cavity,
# whose decay factor is zero to the precision of its polynomials. With the exact cosine, r / cos α would be a division
# by zero.
BEHIND = 1e-100
"""Cosine of α for the base. [1]"""
# This ratio divides the paper's 12,000 panels into 60 by 200.
AROUND_PER_AXIAL = 0.3
"""Number of panels around the axis divided by the number along it. [1]"""

QUARTER_TURN = math.pi / 2.0
"""Right angle. [rad]"""
# A piece has two ends, and the top and the bottom of its rings each cross the face at most twice and the separation
# line at most once.
MAX_CUTS = 8
"""Largest number of stretch ends on one outline piece."""

BodyMotion = tuple[float, float, float, float, float, float]
"""Depth of the centre of gravity [m], cosine and sine of the axis angle, velocities along and across the axis [m/s],
and angular velocity [rad/s]."""
Ring = tuple[float, float, float, float]
"""Sine and cosine of α, axial position and radius of a ring. [1, m]"""


class Body(NamedTuple):
    """Projectile for the compiled code; axial positions are measured forward from the centre of gravity."""

    outline: FloatArray
    """(n, 8) pieces of the outline; the last is the base, with length zero if the body ends in a point. [m, rad]

    The columns of a line are its kind, the axial position and radius of its start, its length, the sine and cosine of
    α, α, and the bound of the cavity as in `Section`. The columns of an arc are its kind, the axial position and radial
    distance of its centre, its radius, the smallest and largest α, an unused zero, and the bound of the cavity."""
    corners: FloatArray
    """(m, 2) axial position and radius of the ends of all pieces, including nose tip and rear edge. [m]"""
    tip: float
    """Axial position of the nose tip. [m]"""
    mass: float
    """Mass of the body. [kg]"""
    moment_of_inertia: float
    """Moment of inertia about a transverse axis through the centre of gravity. [kg m²]"""
    bounds: int
    """Sum of the flags `BOUNDED`, `TAPERED` and `CENTRED` that apply. The base does not count for the first two. One
    number holds all flags, because a body is an argument of every evaluation."""


class Panels(NamedTuple):
    """Surface elements of one half of a projectile; the other half is its mirror image in the plane of incidence.

    All fields but `radius` are (n,) arrays.
    """

    axial: FloatArray
    """Distance ahead of the centre of gravity. [m]"""
    lateral: FloatArray
    """Distance from the axis in the plane of incidence, along u, the direction in which the nose moves as the axis
    angle grows. [m]"""
    normal_axial: FloatArray
    """Component of the outward normal along the axis, sin α. [1]"""
    normal_lateral: FloatArray
    """Component of the outward normal along u, cos α cos β. [1]"""
    cavity: FloatArray
    """Radius of the cavity: r / cos α, at most the radius of the shank unless the normal points backwards. On the base
    it is practically infinite. [m]"""
    area: FloatArray
    """Area of the element plus its mirror image. [m²]"""
    radius: float
    """Radius of the shank, which bounds every cavity toward the rear face of a wall. [m]"""


def _panels(columns: Iterable[FloatArray], radius: float) -> Panels:
    axial, lateral, normal_axial, normal_lateral, cavity, area = columns
    return Panels(axial, lateral, normal_axial, normal_lateral, cavity, area, radius)


NO_PANELS = _panels((np.empty(0) for _ in range(6)), 0.0)


class Section(NamedTuple):
    """Piece of an outline on which one rule gives the radius of the cavity."""

    piece: OutlinePiece
    cavity: float
    """Limit on the radius of the cavity. [m]

    0 means no limit: the radius is r / cos α. The radius a of the shank limits it toward both faces; -a, where the
    normal points backwards, limits it toward the rear face of a wall only. For panels, infinity marks the base."""


def sections(pieces: tuple[OutlinePiece, ...], radius: float) -> Iterator[Section]:
    """Cut pieces of an outline where the distance to the axis along the normal equals the radius of the shank.

    The decay law uses that distance as the radius of a cavity. On a blunt face the distance is unbounded: the cavity
    would be wider than the hole that the body makes, and a distant rear face would weaken the resistance as if it were
    near. So the cavity is at most as wide as the shank. An ogive never reaches this bound; a cap flatter than a
    hemisphere exceeds it everywhere, because its normals meet at its centre. Elements whose normals point backwards,
    toward the impact face, have the channel of the body behind them, and the bound does not apply to them: the steeper
    a body tapers, the smaller is the resistance on its rear, down to zero on a flat base.
    """
    for piece in pieces:
        if isinstance(piece, Arc):
            yield Section(piece, radius if piece.r_center == 0.0 and piece.radius > radius else 0.0)
            continue
        reach = radius * (piece.x_end - piece.x_start) / piece.length
        falls = piece.r_end < piece.r_start
        bound = -radius if falls else radius
        if not min(piece.r_start, piece.r_end) < reach < max(piece.r_start, piece.r_end):
            yield Section(piece, 0.0 if max(piece.r_start, piece.r_end) <= reach else bound)
            continue
        share = (reach - piece.r_start) / (piece.r_end - piece.r_start)
        x = piece.x_start + share * (piece.x_end - piece.x_start)
        yield Section(Line(piece.x_start, piece.r_start, x, reach), bound if falls else 0.0)
        yield Section(Line(x, reach, piece.x_end, piece.r_end), 0.0 if falls else bound)


@lru_cache  # the cases of a study share few projectiles
def build_body(projectile: Projectile, properties: MassProperties) -> Body:
    """Convert a projectile and its mass properties to the arrays of the compiled code."""
    center = properties.center_of_gravity
    rows, corners = [], []
    outline = tuple(sections(projectile.outline(), projectile.radius))
    for piece, cavity in (*outline, Section(projectile.base, projectile.radius)):
        if isinstance(piece, Line):
            size = piece.length or 1.0
            sine, cosine = (piece.r_end - piece.r_start) / size, (piece.x_end - piece.x_start) / size
            alpha = math.atan2(sine, cosine)
            rows.append((LINE, center - piece.x_start, piece.r_start, piece.length, sine, cosine, alpha, cavity))
            corners += [(center - piece.x_start, piece.r_start), (center - piece.x_end, piece.r_end)]
        else:
            ends = (piece.angle_end, piece.angle_start, 0.0)
            rows.append((ARC, center - piece.x_center, piece.r_center, piece.radius, *ends, cavity))
            for angle in (piece.angle_start, piece.angle_end):
                x, r = piece.x_center - piece.radius * math.sin(angle), piece.r_center + piece.radius * math.cos(angle)
                corners.append((center - x, r))
    # Compiled code accepts floats only, and a mass may be given as an int.
    tip, mass, inertia = map(float, (center, properties.mass, properties.moment_of_inertia))
    bounded, tapered = (any(sign * cavity > 0.0 for _, cavity in outline) for sign in (1.0, -1.0))
    centred = all(
        isinstance(piece, Arc)
        and math.hypot(piece.x_center - center, piece.r_center) <= CENTRED_WITHIN * piece.radius
        and projectile.base.length == 0.0
        for piece, _ in outline
    )
    bounds = BOUNDED * bounded + TAPERED * tapered + CENTRED * centred
    return Body(np.array(rows, float), np.array(corners, float), tip, mass, inertia, bounds)


@compiled
def deepest_offset(body: Body, axis_angle: float) -> float:
    """Return the depth of the deepest point of the surface relative to the centre of gravity. [m]"""
    return deepest_point(body, axis_angle)[0]


@lean
def deepest_point(body: Body, axis_angle: float) -> tuple[float, float]:
    """Return the depth of the deepest point relative to the centre of gravity, and its derivative. [m, m/rad]

    The derivative is with respect to the axis angle.
    """
    c, s = math.cos(axis_angle), math.sin(axis_angle)
    mirror, s = math.copysign(1.0, s), abs(s)
    facing = math.atan2(c, s)  # α of the element whose normal is that of the face
    # The deepest point of a convex body is a corner of its outline, or a point on an arc where the normal is that of
    # the face.
    reach, axial, radius = -math.inf, 0.0, 0.0
    for i in range(body.corners.shape[0]):
        depth = body.corners[i, 0] * c + body.corners[i, 1] * s
        if depth > reach:
            reach, axial, radius = depth, body.corners[i, 0], body.corners[i, 1]
    for i in range(body.outline.shape[0]):
        piece = body.outline[i]
        if piece[0] == ARC and piece[4] < facing < piece[5]:
            depth = piece[1] * c + piece[2] * s + piece[3]
            if depth > reach:
                reach, axial, radius = depth, piece[1], piece[2]  # the depth below the arc centre is constant
    return reach, mirror * (radius * c - axial * s)


def build_panels(projectile: Projectile, properties: MassProperties, count: int) -> Panels:
    """Build the paper's midpoint panels: half of the rings on the nose, half behind it, and some more on the base.

    Parameters
    ----------
    count
        Number of panels on the whole surface except the base, rounded to whole rings on each piece of the outline.

    Raises
    ------
    ParameterError
        If there are fewer rings than pieces of the outline.
    """
    # The number of panels around the axis is even, because one half of the body mirrors the other.
    around = max(4, 2 * round(math.sqrt(AROUND_PER_AXIAL * count) / 2.0))
    rings = count // around
    outline = tuple(sections(projectile.outline(), projectile.radius))
    nose = len(tuple(sections(projectile.nose.outline(projectile.radius), projectile.radius)))
    lengths = np.array([piece.length for piece, _ in outline])
    groups = [part for part in (lengths[:nose], lengths[nose:]) if part.size]
    share = np.concatenate([part / part.sum() for part in groups]) / len(groups)
    require(rings >= len(outline), "numerics.panels", f"too few for {len(outline)} pieces of outline, got {count}")
    azimuth = (np.arange(around // 2) + 0.5) * 2.0 * math.pi / around
    parts = [*zip(outline, share, strict=True)]
    if projectile.base.length > 0.0:
        parts.append((Section(projectile.base, math.inf), projectile.base.length / lengths.sum()))
    strips = [
        _strip(section, max(1, round(rings * part)), properties.center_of_gravity, azimuth) for section, part in parts
    ]
    return _panels((np.concatenate(columns) for columns in zip(*strips, strict=True)), projectile.radius)


def _strip(section: Section, rings: int, center: float, azimuth: FloatArray) -> tuple[FloatArray, ...]:
    """Return the columns of `Panels` for one section, with `rings` along it and one panel for each azimuth.

    An infinite bound of the cavity marks the base.
    """
    t = (np.arange(rings) + 0.5) / rings
    x, r, sine, cosine = section.piece.at(t)
    # With n azimuths, a panel and its mirror image are two of the 2 n equal parts of a ring.
    area = 2.0 * 2.0 * math.pi * r * (section.piece.length / rings) / (2 * azimuth.size)

    def spread(along: FloatArray) -> FloatArray:
        return np.repeat(along, azimuth.size)

    around = np.tile(np.cos(azimuth), rings)
    bound = section.cavity
    cavity = np.full_like(r, bound) if 0.0 < bound < math.inf else r / (BEHIND if bound > 0.0 else cosine)
    return (
        spread(center - x),
        spread(r) * around,
        spread(sine),
        spread(cosine) * around,
        spread(cavity),
        spread(area),
    )


@lean
def insert(cuts: FloatArray, count: int, value: float, upper: float) -> int:
    """Insert `value` into the sorted `cuts` if it lies between the first one and `upper`; return the new count."""
    if not cuts[0] < value < upper:
        return count
    place = count
    while cuts[place - 1] > value:
        cuts[place] = cuts[place - 1]
        place -= 1
    cuts[place] = value
    return count + 1


@lean
def _cut_arc(cuts: FloatArray, piece: FloatArray, motion: BodyMotion) -> int:
    """Cut an arc at the angles α where the face or the separation line crosses the top or bottom of a ring."""
    depth, c, s, forward, sideways, spin = motion
    axial, radius, size, upper = piece[1], piece[2], piece[3], piece[5]
    # The error of `arc_cosine`, 1e-8 rad, moves a cut by as much. This changes the sum of the smooth integrals on its
    # two sides by far less.
    angle = arc_cosine(c)
    cuts[0] = piece[4]
    count = 1
    for side in (-1.0, 1.0):
        height = (side * radius * s - depth - axial * c) / size
        if abs(height) < 1.0:
            root = QUARTER_TURN - arc_cosine(height)
            for crossing in (side * angle + root, side * angle + math.pi - root):
                count = insert(cuts, count, crossing if crossing <= math.pi else crossing - 2.0 * math.pi, upper)
        separation = math.atan(-side * (sideways + spin * axial) / (forward - side * spin * radius))
        count = insert(cuts, count, separation, upper)
    cuts[count] = upper
    return count


@lean
def _cut_line(cuts: FloatArray, piece: FloatArray, motion: BodyMotion) -> int:
    """Cut a line at the distances where the face or the separation line crosses the top or bottom of a ring."""
    depth, c, s, forward, sideways, spin = motion
    axial, radius, length, sine_, cosine = piece[1], piece[2], piece[3], piece[4], piece[5]
    cuts[0] = 0.0
    count = 1
    across = (sideways + spin * axial) * cosine - spin * radius * sine_
    for side in (-1.0, 1.0):
        slope = cosine * c + side * sine_ * s
        if slope != 0.0:
            count = insert(cuts, count, (depth + axial * c - side * radius * s) / slope, length)
        if spin != 0.0:
            count = insert(cuts, count, (side * forward * sine_ + across) / spin, length)
    cuts[count] = length
    return count


@lean
def ring_at(piece: FloatArray, place: float) -> Ring:
    """Return the ring at a place on a piece: an angle α on an arc, a distance from the start on a line."""
    if piece[0] == ARC:
        sine_, half = sine(place), sine(0.5 * place)
        cosine = 1.0 - 2.0 * half * half
        return sine_, cosine, piece[1] + piece[3] * sine_, piece[2] + piece[3] * cosine
    return piece[4], piece[5], piece[1] - place * piece[5], piece[2] + place * piece[4]


@lean
def cut(cuts: FloatArray, piece: FloatArray, motion: BodyMotion) -> int:
    """Write the sorted ends of the stretches of a piece; return the number of stretches."""
    return _cut_arc(cuts, piece, motion) if piece[0] == ARC else _cut_line(cuts, piece, motion)


@lean
def is_loaded(ring: Ring, motion: BodyMotion) -> bool:
    """Return whether a ring has a point below the face, and a point that moves into the target."""
    sine, _, axial, radius = ring
    depth, c, s, forward, _, _ = motion
    return depth + axial * c + radius * s > 0.0 and forward * sine + abs(_turning(ring, motion)) > 0.0


@lean
def _turning(ring: Ring, motion: BodyMotion) -> float:
    """Return the derivative of the normal velocity with respect to cos β. [m/s]"""
    sine, cosine, axial, radius = ring
    _, _, _, _, sideways, spin = motion
    return (sideways + spin * axial) * cosine - spin * radius * sine


@lean
def _faces_in(ring: Ring, motion: BodyMotion) -> bool:
    """Return whether all normals of a ring point into the target."""
    return ring[0] * motion[1] >= ring[1] * motion[2]


@lean
def _dips_in(ring: Ring, motion: BodyMotion) -> bool:
    """Return whether the normals at all points of a ring below the face point into the target.

    This is the case if the normals of the ring meet the axis above the face.
    """
    sine, cosine, axial, radius = ring
    depth, c, _, _, _, _ = motion
    return radius * sine * c >= (depth + axial * c) * cosine


@lean
def is_full(piece: FloatArray, begin: float, end: float, middle: Ring, motion: BodyMotion) -> bool:
    """Return whether the face weakens the stress at no loaded point of a stretch; `middle` is its middle ring."""
    # A shank (sin α = 0) that moves sideways into the target is loaded on the side whose normals point into it.
    if middle[0] == 0.0 and _turning(middle, motion) < 0.0:
        return True
    if not (_faces_in(middle, motion) or _dips_in(middle, motion)):
        return False
    # Along a stretch, α and the point where the normals meet the axis are monotonic, so a condition that holds at both
    # ends holds in between. `nearest` is the end whose normals point least into the target.
    nearest, farthest = (begin, end) if motion[1] >= 0.0 else (end, begin)
    first = ring_at(piece, nearest)
    return _faces_in(first, motion) or (_dips_in(first, motion) and _dips_in(ring_at(piece, farthest), motion))
