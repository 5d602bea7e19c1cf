"""Stress integrated around many rings of the surface at a time, compiled.

On the ring of the surface at one station depth, normal velocity and the tilt of the normal are all linear in c = cos β.
So the loaded range of c is known in closed form, and it falls into at most three arcs. In the order of rising c: an arc
whose normal points into the target and which is resisted in full, with integrals in closed form; one so deep that the
plastic zone does not reach the face; and one near the face. On the last two the integrand is smooth, and a few
Gauss-Legendre points in β do. (That order holds for an axis angle of 0 to 180°; others are mirrored before.)

Rings lie side by side in rows of one flat array, so that loops over them fill vector registers. No loop has a branch:
an arc that is not there has no width.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import VECTOR_WIDTH, exact, lean, vectorised
from solver.decay import TINY, Decay, Side, polynomial, side_variable, with_inertia
from solver.meridian import Motion
from solver.polynomials import arc_cosine, sine

CAPACITY = 520
"""Rings in a batch: two stretches with the most stations there may be, and what fills it up."""
VECTOR = np.uint64(VECTOR_WIDTH)
"""Batches are filled up to a multiple of this with rings of no weight, so that no loop has a remainder."""
(
    ALPHA, AXIAL, RADIUS, SIZE, WEIGHT,
    INWARD, INWARD_SLOPE, OUTWARD, OUTWARD_SLOPE, SPEED, SPEED_SLOPE, STATIC, ALONG, ACROSS, TURN,
    DEEP_BEGIN, DEEP_SPAN, NEAR_BEGIN, NEAR_SPAN,
) = (np.uint64(row * CAPACITY) for row in range(19))  # fmt: skip
"""Where the rows begin. Unsigned, since an index that might be negative costs a test each time.

What `add_ring` writes: α; axial position and radius of the centre of curvature; radius of curvature; the ring's share
of the outline. On a straight piece the second and third are those of the ring itself, the radius of curvature is zero.
What `load_rings` adds, as values and slopes in c: depth times cos α and outward tilt of the normal times the radius,
which make up k; normal velocity. Then S f'c, ramped; what the integral of the stress adds to the force along the axis,
and that of the stress times c to the force across and the moment; where the two arcs with a decay begin, as β - π/2,
and how far they reach."""
ROW_COUNT = 19
SPAN = np.uint64(CAPACITY)
"""From the row where arcs begin to the one that tells how far they reach."""
HALF_TURN = math.pi / 2.0

Load = tuple[float, float, float]


class Law(NamedTuple):
    """Resistance of the target for the compiled code."""

    static_stress: float
    """S f'c. [Pa]"""
    dynamic_density: float
    """B ρ. [kg/m³]"""
    ramp_velocity: float
    """Normal velocity over which the static stress of a ring builds up. [m/s]

    S f'c acts in full for any v_n > 0, as dry friction does, so a shank at rest sideways in its hole would need forces
    that switch infinitely often. Below this velocity they go to zero smoothly instead, which lets the shank creep at a
    fraction of it."""
    smooth_ramp: bool
    """Whether the ramp begins without a corner. Rough steps do not see one, and take a smooth ramp, which has no
    stiffness at rest, for freedom to move."""
    decay: Decay


@lean
def add_ring(
    rows: FloatArray, place: int, alpha: float, axial: float, radius: float, size: float, weight: float
) -> None:
    """Write what makes up a ring."""
    i = np.uint64(place)
    rows[ALPHA + i], rows[AXIAL + i], rows[RADIUS + i] = alpha, axial, radius
    rows[SIZE + i], rows[WEIGHT + i] = size, weight


@exact
def _clamp(value: float, low: float, high: float) -> float:
    bounded = max(low, value)
    return min(high, bounded)


@vectorised
def load_rings(
    rows: FloatArray,
    rings: np.uint64,
    depth: float,
    c: float,
    s: float,
    forward: float,
    sideways: float,
    spin: float,
    static_stress: float,
    density: float,
    ramp_velocity: float,
    smooth: bool,
    corner: float,
) -> Load:
    """Find the arcs of every ring; return the load of those that are resisted in full.

    Parameters
    ----------
    depth, c, s
        Of the centre of gravity; cosine and sine, at least 0, of the axis angle.
    forward, sideways, spin
        Velocities of the body along and across its axis, and of rotation.
    """
    along = across = moment = 0.0
    for i in range(rings):
        sine_, half = sine(rows[ALPHA + i]), sine(0.5 * rows[ALPHA + i])
        cosine = 1.0 - 2.0 * half * half
        axial, radius = rows[AXIAL + i] + rows[SIZE + i] * sine_, rows[RADIUS + i] + rows[SIZE + i] * cosine
        inside, inside_slope = depth + axial * c, -radius * s
        speed = forward * sine_
        speed_slope = (sideways + spin * axial) * cosine - spin * radius * sine_
        inward, inward_slope = cosine * inside, cosine * inside_slope
        outward, outward_slope = -radius * sine_ * c, radius * cosine * s

        face = inside / (radius * s + TINY)
        separation = -speed / speed_slope
        high = min(1.0, face)
        high = separation if speed_slope < 0.0 and separation < high else high
        low = separation if speed_slope > 0.0 and separation > -1.0 else -1.0
        low = min(1.0, low)
        fastest = speed + abs(speed_slope)
        high = high if fastest > 0.0 and high > low else low
        tilted = -outward / (outward_slope + TINY)
        plastic = (inward - (corner - 1.0) * outward) / ((corner - 1.0) * outward_slope - inward_slope + TINY)
        start = _clamp(tilted, low, high) if corner > 0.0 else high
        middle = _clamp(plastic, start, high)

        ramp = fastest / ramp_velocity
        ramp *= ramp if smooth else 1.0
        static = static_stress * ramp / math.sqrt(1.0 + ramp * ramp)
        angle_low, angle_start = arc_cosine(low), arc_cosine(start)
        angle_middle, angle_high = arc_cosine(middle), arc_cosine(high)
        sine_low, sine_start = math.sqrt(1.0 - low * low), math.sqrt(1.0 - start * start)
        c0 = angle_low - angle_start
        c1 = sine_low - sine_start
        c2 = 0.5 * (c0 + sine_low * low - sine_start * start)
        c3 = c1 - (sine_low * sine_low * sine_low - sine_start * sine_start * sine_start) / 3.0
        constant = static + density * speed * speed
        linear, square = 2.0 * density * speed * speed_slope, density * speed_slope * speed_slope
        even = constant * c0 + linear * c1 + square * c2
        odd = constant * c1 + linear * c2 + square * c3

        weight = 2.0 * rows[WEIGHT + i] * radius
        to_along, to_across = -weight * sine_, -weight * cosine
        to_moment = weight * (radius * sine_ - axial * cosine)
        along += to_along * even
        across += to_across * odd
        moment += to_moment * odd
        rows[INWARD + i], rows[INWARD_SLOPE + i] = inward, inward_slope
        rows[OUTWARD + i], rows[OUTWARD_SLOPE + i] = outward, outward_slope
        rows[SPEED + i], rows[SPEED_SLOPE + i], rows[STATIC + i] = speed, speed_slope, static
        rows[ALONG + i], rows[ACROSS + i], rows[TURN + i] = to_along, to_across, to_moment
        rows[DEEP_BEGIN + i], rows[DEEP_SPAN + i] = angle_middle - HALF_TURN, angle_start - angle_middle
        rows[NEAR_BEGIN + i], rows[NEAR_SPAN + i] = angle_high - HALF_TURN, angle_middle - angle_high
    return along, across, moment


@exact
def _point(rows: FloatArray, ring: int, begin: np.uint64, node: float) -> tuple[float, float, float, float]:
    """The point at a fraction of an arc: c, distance to the face, distance to the axis, normal velocity."""
    c = -sine(rows[begin + ring] + rows[begin + SPAN + ring] * node)
    inward = rows[INWARD + ring] + rows[INWARD_SLOPE + ring] * c
    outward = rows[OUTWARD + ring] + rows[OUTWARD_SLOPE + ring] * c
    speed = rows[SPEED + ring] + rows[SPEED_SLOPE + ring] * c
    return c, max(0.0, inward), outward, speed


@vectorised
def _sum_arcs(
    rows: FloatArray,
    rings: np.uint64,
    begin: np.uint64,
    points: FloatArray,
    density: float,
    side: Side,
    pivot: float,
) -> Load:
    """Load of the arcs on one side of the corner, which begin in row `begin`, of a decay without inertia."""
    along = across = moment = 0.0
    for j in range(points.shape[0]):
        node, weight = points[j, 0], points[j, 1]
        for i in range(rings):
            c, inward, outward, speed = _point(rows, i, begin, node)
            t = side_variable(inward, outward, pivot, side.scale, side.shift)
            factor = polynomial(side.static, t)
            stress = rows[begin + SPAN + i] * weight * factor * (rows[STATIC + i] + density * speed * speed)
            along += rows[ALONG + i] * stress
            across += rows[ACROSS + i] * stress * c
            moment += rows[TURN + i] * stress * c
    return along, across, moment


@vectorised
def _sum_inertial_arcs(
    rows: FloatArray,
    rings: np.uint64,
    begin: np.uint64,
    points: FloatArray,
    density: float,
    side: Side,
    pivot: float,
    inertia_scale: float,
    inertia_endless: float,
) -> Load:
    """The same for a decay with inertia: a loop of its own, since the other takes half its time without."""
    along = across = moment = 0.0
    for j in range(points.shape[0]):
        node, weight = points[j, 0], points[j, 1]
        for i in range(rings):
            c, inward, outward, speed = _point(rows, i, begin, node)
            t = side_variable(inward, outward, pivot, side.scale, side.shift)
            pressure = inertia_scale * speed * speed
            factor = with_inertia(polynomial(side.static, t), polynomial(side.inertia, t), pressure, inertia_endless)
            stress = rows[begin + SPAN + i] * weight * factor * (rows[STATIC + i] + density * speed * speed)
            along += rows[ALONG + i] * stress
            across += rows[ACROSS + i] * stress * c
            moment += rows[TURN + i] * stress * c
    return along, across, moment


@lean
def _sum_side(
    rows: FloatArray, rings: np.uint64, begin: np.uint64, points: FloatArray, density: float, side: Side, decay: Decay
) -> Load:
    if decay.inertia_scale > 0.0:
        return _sum_inertial_arcs(
            rows, rings, begin, points, density, side, decay.pivot, decay.inertia_scale, decay.inertia_endless
        )
    return _sum_arcs(rows, rings, begin, points, density, side, decay.pivot)


@lean
def sum_rings(rows: FloatArray, count: int, points: FloatArray, law: Law, motion: Motion) -> Load:
    """Force along and across the axis, and moment, of the first `count` rings."""
    rings, decay, density = np.uint64(count), law.decay, law.dynamic_density
    while rings % VECTOR:
        for row in (ALPHA, AXIAL, RADIUS, SIZE):
            rows[row + rings] = rows[row + rings - np.uint64(1)]
        rows[WEIGHT + rings] = 0.0
        rings += np.uint64(1)
    depth, c, s, forward, sideways, spin = motion
    along, across, moment = load_rings(
        rows, rings, depth, c, s, forward, sideways, spin,
        law.static_stress, density, law.ramp_velocity, law.smooth_ramp, decay.corner,
    )  # fmt: skip
    if decay.corner > 0.0:
        f, g, h = _sum_side(rows, rings, DEEP_BEGIN, points, density, decay.deep, decay)
        along, across, moment = along + f, across + g, moment + h
        f, g, h = _sum_side(rows, rings, NEAR_BEGIN, points, density, decay.near, decay)
        along, across, moment = along + f, across + g, moment + h
    return along, across, moment
