"""The surface of a projectile as the compiled code reads it: outline pieces, and the paper's panels."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled
from solver.nose import Line, OutlinePiece
from solver.projectile import MassProperties, Projectile
from solver.validation import require

LINE, ARC = 0.0, 1.0
"""First column of an outline row, the kind of the piece."""

FLAT = 1e-100
"""Cosine of α on a face across the axis, whose normal meets the axis nowhere: small enough for an infinite distance."""
FAR = 1e50
"""Distance from the axis beyond which a normal meets it nowhere. [m]"""
AROUND_PER_AXIAL = 0.3
"""Panels around over panels along the axis: 60 by 200 for the paper's 12,000."""


class Body(NamedTuple):
    """A projectile for the compiled code. The centre of gravity is the origin, positions ahead of it are positive."""

    outline: FloatArray
    """(n, 7), the base last. A line: kind, axial position and radius at its start, its length, sine and cosine of α,
    and α. An arc: kind, axial position and radius of its centre, its radius, smallest and largest α, and nothing.
    [m, rad]"""
    corners: FloatArray
    """(m, 2) axial position and radius of the points between pieces, tip and rear edge included. [m]"""
    tip: float
    """Axial position of the nose tip. [m]"""
    mass: float
    """[kg]"""
    moment_of_inertia: float
    """About a transverse axis through the centre of gravity. [kg m²]"""


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
    wall: FloatArray
    """Distance from the axis along the normal, r / cos α. [m]"""
    area: FloatArray
    """Area of the element and its mirror image together. [m²]"""


NO_PANELS = Panels(*(np.empty(0) for _ in Panels._fields))


@lru_cache  # as for `mass_properties`
def build_body(projectile: Projectile, properties: MassProperties) -> Body:
    """Outline and mass properties of `projectile` for the compiled code."""
    center = properties.center_of_gravity
    rows, corners = [], []
    for piece in (*projectile.outline(), projectile.base):
        if isinstance(piece, Line):
            sine, cosine = (piece.r_end - piece.r_start) / piece.length, (piece.x_end - piece.x_start) / piece.length
            alpha = math.atan2(sine, cosine)
            rows.append((LINE, center - piece.x_start, piece.r_start, piece.length, sine, cosine, alpha))
            corners += [(center - piece.x_start, piece.r_start), (center - piece.x_end, piece.r_end)]
        else:
            rows.append(
                (ARC, center - piece.x_center, piece.r_center, piece.radius, piece.angle_end, piece.angle_start, 0.0)
            )
            for angle in (piece.angle_start, piece.angle_end):
                x, r = piece.x_center - piece.radius * math.sin(angle), piece.r_center + piece.radius * math.cos(angle)
                corners.append((center - x, r))
    numbers = (center, properties.mass, properties.moment_of_inertia)
    return Body(np.array(rows, float), np.array(corners, float), *map(float, numbers))  # 13 would be another type


@compiled
def deepest_offset(body: Body, axis_angle: float) -> float:
    """Depth of the deepest point of the surface ahead of the centre of gravity. [m]"""
    c, s = math.cos(axis_angle), abs(math.sin(axis_angle))
    facing = math.atan2(c, s)  # α of the element whose normal points into depth
    reach = -math.inf
    for i in range(body.corners.shape[0]):
        reach = max(reach, body.corners[i, 0] * c + body.corners[i, 1] * s)
    for i in range(body.outline.shape[0]):
        piece = body.outline[i]
        if piece[0] == ARC and piece[4] < facing < piece[5]:
            reach = max(reach, piece[1] * c + piece[2] * s + piece[3])
    return reach


def build_panels(projectile: Projectile, properties: MassProperties, count: int) -> Panels:
    """Midpoint panels, about `count` on nose and shank, half of the rings on the nose; the base has its own beside.

    Parameters
    ----------
    count
        Panels of nose and shank; what does not fill a ring is left out.
    """
    around = max(4, 2 * round(math.sqrt(AROUND_PER_AXIAL * count) / 2.0))
    rings = count // around
    outline = projectile.outline()
    nose = len(projectile.nose.outline(projectile.radius))
    lengths = np.array([piece.length for piece in outline])
    share = np.where(np.arange(len(outline)) < nose, lengths / lengths[:nose].sum(), 1.0)
    if nose < len(outline):
        share /= 2.0
    require(rings >= len(outline), "numerics.panels", f"too few for {len(outline)} pieces of outline, got {count}")
    azimuth = (np.arange(around // 2) + 0.5) * 2.0 * math.pi / around
    pieces = (*outline, projectile.base)
    shares = (*share, projectile.base.length / lengths.sum())
    strips = [
        _strip(piece, max(1, round(rings * part)), properties.center_of_gravity, azimuth)
        for piece, part in zip(pieces, shares, strict=True)
    ]
    return Panels(*(np.concatenate(columns) for columns in zip(*strips, strict=True)))


def _strip(piece: OutlinePiece, rings: int, center: float, azimuth: FloatArray) -> Panels:
    """Panels of one outline piece, `rings` along it and one for each azimuth."""
    t = (np.arange(rings) + 0.5) / rings
    x, r, sine, cosine = piece.at(t)
    area = 2.0 * 2.0 * math.pi * r * (piece.length / rings) / (2 * azimuth.size)

    def spread(along: FloatArray) -> FloatArray:
        return np.repeat(along, azimuth.size)

    around = np.tile(np.cos(azimuth), rings)
    wall = r / np.maximum(cosine, FLAT)
    return Panels(
        axial=spread(center - x),
        lateral=spread(r) * around,
        normal_axial=spread(sine),
        normal_lateral=spread(cosine) * around,
        wall=spread(wall),
        area=spread(area),
    )
