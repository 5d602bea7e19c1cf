"""The surface of a projectile as the compiled code reads it: outline pieces, and the paper's panels.

A piece of outline is cut into stretches on which the loaded arcs change smoothly. Cuts are where the face, or the line
on which elements start to separate, crosses the top or the bottom of a ring.
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
"""First column of an outline row, the kind of the piece."""
BOUNDED, TAPERED, CENTRED = 1, 2, 4
"""Whether the cavity is bounded towards both faces somewhere, whether it is towards the rear face only, and whether all
normals of the body pass through its centre of gravity, so that no load turns it: those of a sphere."""
CENTRED_WITHIN = 1e-9
"""Distance of the centre of a sphere from its centre of gravity, over its radius, that is rounding. [1]"""

BEHIND = 1e-100
"""Cosine of α that stands for that of the base: where the base faces the impact face, the channel that the body has cut
is behind it, which a cavity without bound describes. The decay is then zero to the precision of its polynomials."""
AROUND_PER_AXIAL = 0.3
"""Panels around over panels along the axis: 60 by 200 for the paper's 12,000."""

HALF_TURN = math.pi / 2.0
MAX_CUTS = 8
"""Ends of the stretches of one outline piece: two ends and at most six crossings."""

BodyMotion = tuple[float, float, float, float, float, float]
"""Depth of the centre of gravity, cosine and sine of the axis angle; velocities along and across the axis, and spin."""
Ring = tuple[float, float, float, float]
"""Sine and cosine of α, axial position and radius."""


class Body(NamedTuple):
    """A projectile for the compiled code. The centre of gravity is the origin, positions ahead of it are positive."""

    outline: FloatArray
    """(n, 8), the base last, without length where a body ends in a point. A line: kind, axial position and radius at
    its start, its length, sine and cosine of α, and α. An arc: kind, axial position and radius of its centre, its
    radius, smallest and largest α, and nothing. Last in each row the bound of the cavity, as `Section` has it.
    [m, rad]"""
    corners: FloatArray
    """(m, 2) axial position and radius of the points between pieces, tip and rear edge included. [m]"""
    tip: float
    """Axial position of the nose tip. [m]"""
    mass: float
    """[kg]"""
    moment_of_inertia: float
    """About a transverse axis through the centre of gravity. [kg m²]"""
    bounds: int
    """Whether the cavity is bounded anywhere but on the base, and whether the body is a sphere: the sum of `BOUNDED`,
    `TAPERED` and `CENTRED`. One number for all, since this is handed over at every evaluation."""


class Panels(NamedTuple):
    """Surface elements of one half of a projectile, the other being its mirror image in the plane of incidence.

    All are (n,) arrays.
    """

    axial: FloatArray
    """Ahead of the centre of gravity. [m]"""
    lateral: FloatArray
    """Offset from the axis in the plane of incidence, along u. [m]"""
    normal_axial: FloatArray
    """Component of the outward normal along the axis, sin α. [1]"""
    normal_lateral: FloatArray
    """Component of the outward normal along u, cos α cos β. [1]"""
    cavity: FloatArray
    """Radius of the cavity, r / cos α and at most that of the shank; without bound where the normal points backwards,
    as on the base. [m]"""
    area: FloatArray
    """Area of the element and its mirror image together. [m²]"""
    radius: float
    """Radius of the shank, which no cavity exceeds towards the rear face of a wall. [m]"""


def _panels(columns: Iterable[FloatArray], radius: float) -> Panels:
    axial, lateral, normal_axial, normal_lateral, cavity, area = columns
    return Panels(axial, lateral, normal_axial, normal_lateral, cavity, area, radius)


NO_PANELS = _panels((np.empty(0) for _ in range(6)), 0.0)


class Section(NamedTuple):
    """Piece of an outline on which the radius of the cavity follows one rule."""

    piece: OutlinePiece
    cavity: float
    """0 where the cavity is r / cos α. Where that is larger than the radius of the shank, this radius, the bound; where
    the normal points backwards its negative, as the bound holds towards the rear face of a wall only. [m]"""


def sections(pieces: tuple[OutlinePiece, ...], radius: float) -> Iterator[Section]:
    """Cut pieces of an outline where the distance to the axis along the normal reaches the radius of the shank.

    The decay law takes that distance for the radius of a cavity. A blunt face would open one without bound, wider than
    the hole that the body makes, and feel a distant rear face as if it were near. So the cavity is no wider than the
    shank. An ogive is nowhere beyond the bound, a cap everywhere: its normals meet in its centre. What looks backwards
    and faces the impact face has the channel that the body has cut behind it: there the distance is not bounded, so
    that the steeper a body tapers, the less its rear is resisted, down to the nothing of the flat base.
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


@lru_cache  # as for `mass_properties`
def build_body(projectile: Projectile, properties: MassProperties) -> Body:
    """Outline and mass properties of `projectile` for the compiled code."""
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
    tip, mass, inertia = map(float, (center, properties.mass, properties.moment_of_inertia))  # 13 is another type
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
    """Depth of the deepest point of the surface ahead of the centre of gravity. [m]"""
    return deepest_point(body, axis_angle)[0]


@lean
def deepest_point(body: Body, axis_angle: float) -> tuple[float, float]:
    """Depth of the deepest point of the surface ahead of the centre of gravity, and its growth with the axis angle.

    In metres, and metres per radian.
    """
    c, s = math.cos(axis_angle), math.sin(axis_angle)
    mirror, s = math.copysign(1.0, s), abs(s)
    facing = math.atan2(c, s)  # α of the element whose normal points into depth
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
                reach, axial, radius = depth, piece[1], piece[2]  # its centre turns as the point on it does
    return reach, mirror * (radius * c - axial * s)


def build_panels(projectile: Projectile, properties: MassProperties, count: int) -> Panels:
    """Midpoint panels, about `count` on nose and shank, half of the rings on the nose; the base has its own beside.

    Parameters
    ----------
    count
        Panels of nose and shank; what does not fill a ring is left out.
    """
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
    """Columns of the panels of one section, `rings` along it and one for each azimuth; the base has no bound."""
    t = (np.arange(rings) + 0.5) / rings
    x, r, sine, cosine = section.piece.at(t)
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
    """Put `value` in its place among the sorted `cuts`, if it lies inside; return how many there are."""
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
    """Angles α at which the face or the separation line crosses the top or bottom of a circular piece."""
    depth, c, s, forward, sideways, spin = motion
    axial, radius, size, upper = piece[1], piece[2], piece[3], piece[5]
    angle = arc_cosine(c)
    cuts[0] = piece[4]
    count = 1
    for side in (-1.0, 1.0):
        height = (side * radius * s - depth - axial * c) / size
        if abs(height) < 1.0:
            root = HALF_TURN - arc_cosine(height)
            for crossing in (side * angle + root, side * angle + math.pi - root):
                count = insert(cuts, count, crossing if crossing <= math.pi else crossing - 2.0 * math.pi, upper)
        separation = math.atan(-side * (sideways + spin * axial) / (forward - side * spin * radius))
        count = insert(cuts, count, separation, upper)
    cuts[count] = upper
    return count


@lean
def _cut_line(cuts: FloatArray, piece: FloatArray, motion: BodyMotion) -> int:
    """Distances along a straight piece at which they do."""
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
    """The ring at a place on a piece."""
    if piece[0] == ARC:
        sine_, half = sine(place), sine(0.5 * place)
        cosine = 1.0 - 2.0 * half * half
        return sine_, cosine, piece[1] + piece[3] * sine_, piece[2] + piece[3] * cosine
    return piece[4], piece[5], piece[1] - place * piece[5], piece[2] + place * piece[4]


@lean
def cut(cuts: FloatArray, piece: FloatArray, motion: BodyMotion) -> int:
    """Write the sorted ends of the stretches of a piece; return how many stretches there are."""
    return _cut_arc(cuts, piece, motion) if piece[0] == ARC else _cut_line(cuts, piece, motion)


@lean
def is_loaded(ring: Ring, motion: BodyMotion) -> bool:
    """Whether any of a ring is below the face, and any of it moves into the target."""
    sine, _, axial, radius = ring
    depth, c, s, forward, _, _ = motion
    return depth + axial * c + radius * s > 0.0 and forward * sine + abs(_turning(ring, motion)) > 0.0


@lean
def _turning(ring: Ring, motion: BodyMotion) -> float:
    """How the normal velocity grows with cos β."""
    sine, cosine, axial, radius = ring
    _, _, _, _, sideways, spin = motion
    return (sideways + spin * axial) * cosine - spin * radius * sine


@lean
def _faces_in(ring: Ring, motion: BodyMotion) -> bool:
    """Whether all of its normals point into the target."""
    return ring[0] * motion[1] >= ring[1] * motion[2]


@lean
def _dips_in(ring: Ring, motion: BodyMotion) -> bool:
    """Whether those below the face do, as its own meets the axis above the face."""
    sine, cosine, axial, radius = ring
    depth, c, _, _, _, _ = motion
    return radius * sine * c >= (depth + axial * c) * cosine


@lean
def is_full(piece: FloatArray, begin: float, end: float, middle: Ring, motion: BodyMotion) -> bool:
    """Whether a stretch, of which the ring in its middle is known, is resisted in full wherever it is loaded.

    The shank is where it moves sideways into the target. Elsewhere what holds at both ends of a stretch holds within:
    α and where the normals meet the axis change in one direction only.
    """
    if middle[0] == 0.0 and _turning(middle, motion) < 0.0:
        return True
    if not (_faces_in(middle, motion) or _dips_in(middle, motion)):
        return False
    nearest, farthest = (begin, end) if motion[1] >= 0.0 else (end, begin)  # of an arc, by how its α faces in
    first = ring_at(piece, nearest)
    return _faces_in(first, motion) or (_dips_in(first, motion) and _dips_in(ring_at(piece, farthest), motion))
