"""Compiled integrals of the stress around many rings of the surface at once.

On the ring of the surface at one station, depth, normal velocity and the tilt of the normal are linear in c = cos β,
with the angles α and β of `solver.surface`. So the loaded range of c has a closed form. It consists of at most three
arcs, in order of increasing c: one whose normals point into the target, on which the face does not weaken the
resistance and the integrals have closed forms; one so deep that the plastic zone does not reach the face; and one near
the face. On the last two the integrand is smooth, so a few Gauss-Legendre points in β suffice. This order holds for
axis angles of 0 to 180°; callers mirror other states first.

Rings lie side by side in the rows of one flat array, so that loops over them fill vector registers. No loop has a
branch: an absent arc has zero width. Rings with only the first arc are stored separately, and take a fraction of the
time of other rings.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, arc_cosine, sine
from solver.compilation import VECTOR_WIDTH, exact, lean, vectorised
from solver.free_surface import TINY, Decay, inertial_factor, static_factor
from solver.surface import ARC, BodyMotion

# In a wall each ring is stored twice, so half of this number must hold a stretch with the largest number of stations,
# 256. Half of it must also be a multiple of the vector width, at most 8: loops over whole vectors would otherwise
# overwrite the other half.
ROOM = 528
"""Largest number of rings with up to three arcs in a batch, and of rings with only the first arc."""
FULL = ROOM
"""Index of the first ring that has only the first arc; other rings begin at 0."""
CAPACITY = 2 * ROOM
"""Length of a row: the number of rings of both kinds in a batch."""
# A loop without a remainder compiles to vector instructions only. It may process stale rings, which no sum includes.
VECTOR = np.uint64(VECTOR_WIDTH)
"""Number of 64-bit numbers in a vector register; loops over rings run to a multiple of it."""
# The indices are unsigned, because numba checks at each access whether a signed index is negative.
(
    ALPHA, AXIAL, RADIUS, SIZE, WEIGHT, DEPTH, COSINE, SINE, FORWARD, SIDEWAYS, SPIN,
    INWARD, INWARD_SLOPE, OUTWARD, OUTWARD_SLOPE, SPEED, SPEED_SLOPE, STATIC, ALONG, ACROSS, TURN,
    DEEP_BEGIN, DEEP_SPAN, NEAR_BEGIN, NEAR_SPAN, EVEN, ODD, CAVITY,
) = (np.uint64(row * CAPACITY) for row in range(28))  # fmt: skip
"""Offsets of the rows of ring data in the flat array.

`add_rings` writes α (`ALPHA`), the axial position and radius of the centre of curvature (`AXIAL`, `RADIUS`), the radius
of curvature (`SIZE`), the length of outline that the ring stands for (`WEIGHT`), the motion of the body (`DEPTH` to
`SPIN`), and the bound of the cavity (`CAVITY`). On a straight piece the axial position and radius are those of the ring
itself, and the radius of curvature is zero.

`_load_rings` writes the value at c = 0 and the slope in c of the distance to the face and the outward tilt, scaled by
the factors of `cavity_scales` (`INWARD`, `OUTWARD`), and of the normal velocity (`SPEED`). It also writes the ramped S
f'c (`STATIC`); the factors by which the integral of the stress gives the force along the axis (`ALONG`), and the
integral of the stress times c gives the force across the axis and the moment (`ACROSS`, `TURN`); the beginning, as β -
π/2, and the width of the two arcs with a decay (`DEEP_BEGIN` to `NEAR_SPAN`); and the two integrals (`EVEN`, `ODD`)."""
ROW_COUNT = 28
"""Number of rows of ring data in the flat array."""
SPAN = np.uint64(CAPACITY)
"""Offset from the row with the beginning of an arc to the row with its width."""
QUARTER_TURN = math.pi / 2.0
"""Right angle. [rad]"""

Load = tuple[float, float, float]
"""Two components of the force, and the moment. [N, N m]"""


class Law(NamedTuple):
    """Resistance of the target for the compiled code."""

    static_stress: float
    """Static stress S f'c. [Pa]"""
    dynamic_density: float
    """Inertia factor times density, B ρ. [kg/m³]"""
    ramp_velocity: float
    """Normal velocity over which the static stress of a ring builds up. [m/s]

    By eq. 1, S f'c acts in full at any v_n > 0, like dry friction, so a shank that does not move sideways in its hole
    would need forces that switch infinitely often. Below this velocity the static stress goes to zero smoothly instead,
    and the shank creeps sideways at a fraction of this velocity."""
    smooth_ramp: bool
    """True for a ramp with zero slope at zero velocity. Steps with a coarse tolerance need the other ramp, which begins
    linearly: without a slope at rest the body would seem free to move."""
    decay: Decay
    thickness: float
    """Depth of the rear face; infinite for a half-space. [m]"""
    loaded_thickness: float
    """Depth beyond which no element is loaded: the depth of the rear face or, with a plug, where the plug begins.
    [m]"""
    crater_depth: float
    """Depth of the deepest point from which on the resistance acts in full; 0 without a crater. [m]"""


@vectorised
def clamp(value: float, low: float, high: float) -> float:
    """Limit a value to the range from `low` to `high`."""
    bounded = max(low, value)
    return min(high, bounded)


@vectorised
def loaded_range(depth: float, depth_slope: float, speed: float, speed_slope: float) -> tuple[float, float]:
    """Return the range of c that is below the face and moves into the target; the ends of an empty range are equal."""
    # The slope of the depth is never positive, so the denominator is not zero. With zero slope the quotient is huge,
    # and its sign says whether all or none of the ring is below the face.
    face = depth / (TINY - depth_slope)
    # The quotient may be infinite or NaN; the comparisons below then do not use it.
    separation = -speed / speed_slope
    high = min(1.0, face)
    high = separation if speed_slope < 0.0 and separation < high else high
    low = separation if speed_slope > 0.0 and separation > -1.0 else -1.0
    low = min(1.0, low)
    return low, high if speed + abs(speed_slope) > 0.0 and high > low else low


@vectorised
def ramped(fastest: float, static_stress: float, ramp_velocity: float, smooth: bool) -> float:
    """Return the ramped static stress on a ring whose fastest point has the normal velocity `fastest`. [Pa]"""
    # The ramp r² / √(1 + r⁴) takes only a root; a hyperbolic tangent would be a library call in each pass of the loop.
    # For large r it differs from 1 by r⁻⁴ / 2. An earlier ramp, r² / (1 + r²), differed by r⁻², and made the depth in
    # normal impact 5e-6 larger than the closed form.
    ramp = fastest / ramp_velocity
    ramp *= ramp if smooth else 1.0
    return static_stress * ramp / math.sqrt(1.0 + ramp * ramp)


@vectorised
def integrate_full(
    low: float, high: float, turn: float, static: float, density: float, speed: float, speed_slope: float
) -> tuple[float, float]:
    """Return the integrals over β of the full stress, and of that stress times c, between two values of c.

    The argument `turn` is the difference of β between `low` and `high`, which callers have already computed.
    """
    # The stress is a polynomial of degree 2 in c; c1, c2 and c3 are the integrals of the powers of cos β.
    sine_low, sine_high = math.sqrt(1.0 - low * low), math.sqrt(1.0 - high * high)
    c1 = sine_low - sine_high
    c2 = 0.5 * (turn + sine_low * low - sine_high * high)
    c3 = c1 - (sine_low * sine_low * sine_low - sine_high * sine_high * sine_high) / 3.0
    constant = static + density * speed * speed
    linear, square = 2.0 * density * speed * speed_slope, density * speed_slope * speed_slope
    return constant * turn + linear * c1 + square * c2, constant * c1 + linear * c2 + square * c3


@vectorised
def add_rings(
    rows: FloatArray, place: int, piece: FloatArray, begin: float, end: float, stations: FloatArray, motion: BodyMotion
) -> None:
    """Write the data of the rings at the stations of a stretch. Rings that pad the last vector have zero weight."""
    # On an arc α varies along the stretch, on a straight piece the position does. One loop without a branch serves
    # both.
    span, first = end - begin, np.uint64(place)
    depth, c, s, forward, sideways, spin = motion
    axial, radius, cavity = piece[1], piece[2], piece[7]
    if piece[0] == ARC:
        alpha, turn, size, share, sine_, cosine = 0.0, 1.0, piece[3], piece[3] * span, 0.0, 0.0
    else:
        alpha, turn, size, share, sine_, cosine = piece[6], 0.0, 0.0, span, piece[4], piece[5]
    for n in range(np.uint64(stations.shape[1])):
        i, way = first + n, begin + span * stations[0, n]
        rows[ALPHA + i] = alpha + turn * way
        rows[AXIAL + i], rows[RADIUS + i] = axial - way * cosine, radius + way * sine_
        rows[SIZE + i], rows[WEIGHT + i] = size, share * stations[1, n]
        rows[DEPTH + i], rows[COSINE + i], rows[SINE + i] = depth, c, s
        rows[FORWARD + i], rows[SIDEWAYS + i], rows[SPIN + i] = forward, sideways, spin
        rows[CAVITY + i] = cavity


@exact
def place_ring(rows: FloatArray, i: int) -> tuple[float, float, float, float]:
    """Return sine and cosine of α, axial position and radius of a ring."""
    # The half-angle formula computes the cosine with the polynomial of the sine, over the same range of angles.
    sine_, half = sine(rows[ALPHA + i]), sine(0.5 * rows[ALPHA + i])
    cosine = 1.0 - 2.0 * half * half
    return sine_, cosine, rows[AXIAL + i] + rows[SIZE + i] * sine_, rows[RADIUS + i] + rows[SIZE + i] * cosine


@exact
def cavity_scales(bound: float, cosine: float, radius: float) -> tuple[float, float]:
    """Return the factors of depth and outward tilt of a ring; the ratio of the two products is k - 1.

    For a cavity of radius r / cos α the factors are cos α and r, which avoids a division by zero at the axis. For a
    bounded cavity they are 1 and the bound.
    """
    return (1.0, bound) if bound > 0.0 else (cosine, radius)


@exact
def ring_motion(rows: FloatArray, i: int) -> BodyMotion:
    """Return the motion of the body in the state to which a ring belongs."""
    return (
        rows[DEPTH + i], rows[COSINE + i], rows[SINE + i], rows[FORWARD + i], rows[SIDEWAYS + i], rows[SPIN + i],
    )  # fmt: skip


@vectorised
def _load_full_rings(rows: FloatArray, end: np.uint64, law: Law) -> None:
    """Integrate the stress around the rings from `FULL` up to `end`, which have only the first arc."""
    for i in range(np.uint64(FULL), end):
        depth, c, s, forward, sideways, spin = ring_motion(rows, i)
        sine_, cosine, axial, radius = place_ring(rows, i)
        # The normal velocity is speed + speed_slope c, and the depth is linear in c too: their zeros bound the loaded
        # range.
        speed = forward * sine_
        speed_slope = (sideways + spin * axial) * cosine - spin * radius * sine_
        low, high = loaded_range(depth + axial * c, -radius * s, speed, speed_slope)
        # With one static stress for the whole ring, that of its fastest point, the stress is a polynomial in c, whose
        # integral has a closed form.
        static = ramped(speed + abs(speed_slope), law.static_stress, law.ramp_velocity, law.smooth_ramp)
        turn = arc_cosine(low) - arc_cosine(high)
        even, odd = integrate_full(low, high, turn, static, law.dynamic_density, speed, speed_slope)
        # The two halves of a ring, on either side of the plane of motion, are loaded alike.
        weight = 2.0 * rows[WEIGHT + i] * radius
        rows[EVEN + i], rows[ODD + i] = even, odd
        rows[ALONG + i], rows[ACROSS + i] = -weight * sine_, -weight * cosine
        rows[TURN + i] = weight * (radius * sine_ - axial * cosine)


def _ring_loader(name: str, *, bounded: bool) -> Callable[[FloatArray, np.uint64, Law], None]:
    """Return a function that finds the arcs of rings, for bodies with or without a bounded cavity.

    The function for bodies without a bounded cavity, such as ogives, omits a selection in its loop. The cache of
    compiled code distinguishes the two functions by `name`.
    """

    def load_rings(rows: FloatArray, end: np.uint64, law: Law) -> None:
        """Find the arcs of the rings up to `end`, and integrate the stress on their first arcs."""
        beyond = law.decay.corner - 1.0
        for i in range(end):
            depth, c, s, forward, sideways, spin = ring_motion(rows, i)
            sine_, cosine, axial, radius = place_ring(rows, i)
            inside, inside_slope = depth + axial * c, -radius * s
            speed = forward * sine_
            speed_slope = (sideways + spin * axial) * cosine - spin * radius * sine_
            depth_scale, tilt_scale = cosine, radius
            if bounded:
                depth_scale, tilt_scale = cavity_scales(rows[CAVITY + i], cosine, radius)
            inward, inward_slope = depth_scale * inside, depth_scale * inside_slope
            outward, outward_slope = -tilt_scale * sine_ * c, tilt_scale * cosine * s

            # For c above `tilted` the normal points out of the target; above `plastic` k is below the corner of the
            # decay. Clamping one after the other keeps the arcs in order, and gives an absent arc equal ends, without a
            # branch.
            low, high = loaded_range(inside, inside_slope, speed, speed_slope)
            tilted = -outward / (outward_slope + TINY)
            plastic = (inward - beyond * outward) / (beyond * outward_slope - inward_slope + TINY)
            start = clamp(tilted, low, high)
            middle = clamp(plastic, start, high)

            static = ramped(speed + abs(speed_slope), law.static_stress, law.ramp_velocity, law.smooth_ramp)
            angle_low, angle_start = arc_cosine(low), arc_cosine(start)
            angle_middle, angle_high = arc_cosine(middle), arc_cosine(high)
            turn = angle_low - angle_start
            even, odd = integrate_full(low, start, turn, static, law.dynamic_density, speed, speed_slope)

            weight = 2.0 * rows[WEIGHT + i] * radius
            rows[EVEN + i], rows[ODD + i] = even, odd
            rows[ALONG + i], rows[ACROSS + i] = -weight * sine_, -weight * cosine
            rows[TURN + i] = weight * (radius * sine_ - axial * cosine)
            rows[INWARD + i], rows[INWARD_SLOPE + i] = inward, inward_slope
            rows[OUTWARD + i], rows[OUTWARD_SLOPE + i] = outward, outward_slope
            rows[SPEED + i], rows[SPEED_SLOPE + i], rows[STATIC + i] = speed, speed_slope, static
            # The sine of β - π/2 is -c, so the polynomial of the sine gives c at all points of the arcs.
            rows[DEEP_BEGIN + i], rows[DEEP_SPAN + i] = angle_middle - QUARTER_TURN, angle_start - angle_middle
            rows[NEAR_BEGIN + i], rows[NEAR_SPAN + i] = angle_high - QUARTER_TURN, angle_middle - angle_high

    load_rings.__name__ = load_rings.__qualname__ = name
    return vectorised(load_rings)


_load_rings = _ring_loader("_load_rings", bounded=False)
_load_bounded_rings = _ring_loader("_load_bounded_rings", bounded=True)


@exact
def _point(rows: FloatArray, ring: int, begin: np.uint64, node: float) -> tuple[float, float, float, float]:
    """Return c, the scaled distances to the face and to the axis, and the normal velocity at a fraction of an arc."""
    c = -sine(rows[begin + ring] + rows[begin + SPAN + ring] * node)
    inward = rows[INWARD + ring] + rows[INWARD_SLOPE + ring] * c
    outward = rows[OUTWARD + ring] + rows[OUTWARD_SLOPE + ring] * c
    speed = rows[SPEED + ring] + rows[SPEED_SLOPE + ring] * c
    return c, max(0.0, inward), outward, speed  # at the face itself rounding can put a point outside


@vectorised
def _sum_arcs(rows: FloatArray, end: np.uint64, deep: bool, points: FloatArray, law: Law) -> None:
    """Add the integrals over arcs on one side of the corner to the rings up to `end`, for a decay without inertia."""
    begin = DEEP_BEGIN if deep else NEAR_BEGIN
    # The inner loop runs over rings, because an arc has too few points to fill a vector. On each side of the corner the
    # decay is one smooth formula, so a few Gauss-Legendre points suffice.
    for j in range(points.shape[0]):
        node, weight = points[j, 0], points[j, 1]
        for i in range(end):
            c, inward, outward, speed = _point(rows, i, begin, node)
            factor = static_factor(inward, outward, law.decay, deep)
            stress = factor * (rows[STATIC + i] + law.dynamic_density * speed * speed)
            stress *= rows[begin + SPAN + i] * weight
            rows[EVEN + i] += stress
            rows[ODD + i] += stress * c


@vectorised
def _sum_inertial_arcs(rows: FloatArray, end: np.uint64, deep: bool, points: FloatArray, law: Law) -> None:
    """Add the integrals over arcs on one side of the corner to the rings up to `end`, for a decay with inertia."""
    # This loop takes twice the time of the one without inertia, which is the default, so they are separate.
    begin = DEEP_BEGIN if deep else NEAR_BEGIN
    for j in range(points.shape[0]):
        node, weight = points[j, 0], points[j, 1]
        for i in range(end):
            c, inward, outward, speed = _point(rows, i, begin, node)
            factor = inertial_factor(inward, outward, speed, law.decay, deep)
            stress = factor * (rows[STATIC + i] + law.dynamic_density * speed * speed)
            stress *= rows[begin + SPAN + i] * weight
            rows[EVEN + i] += stress
            rows[ODD + i] += stress * c


@lean
def add_arcs(rows: FloatArray, end: np.uint64, points: FloatArray, law: Law) -> None:
    """Add the integrals over the arcs with a decay to the rings up to `end`."""
    if law.decay.inertia_scale > 0.0:
        _sum_inertial_arcs(rows, end, True, points, law)
        _sum_inertial_arcs(rows, end, False, points, law)
    else:
        _sum_arcs(rows, end, True, points, law)
        _sum_arcs(rows, end, False, points, law)


@lean
def whole(count: int) -> np.uint64:
    """Round a number of rings up to whole vectors."""
    return (np.uint64(count) + VECTOR - np.uint64(1)) // VECTOR * VECTOR


@lean
def integrate_rings(rows: FloatArray, count: int, full: int, points: FloatArray, law: Law, bounded: bool) -> None:
    """Integrate the stress around the first `count` rings, and the first `full` rings from `FULL` on."""
    if count > 0:
        end = whole(count)
        if bounded:
            _load_bounded_rings(rows, end, law)
        else:
            _load_rings(rows, end, law)
        add_arcs(rows, end, points, law)
    if full > 0:
        _load_full_rings(rows, np.uint64(FULL) + whole(full), law)


@lean
def sum_rings(rows: FloatArray, begin: int, end: int) -> Load:
    """Return the force along and across the axis and the moment on the rings from `begin` to `end`. [N, N m]"""
    along = across = moment = 0.0
    for i in range(np.uint64(begin), np.uint64(end)):
        along += rows[ALONG + i] * rows[EVEN + i]
        across += rows[ACROSS + i] * rows[ODD + i]
        moment += rows[TURN + i] * rows[ODD + i]
    return along, across, moment
