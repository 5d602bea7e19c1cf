"""Stress integrated around many rings of the surface at a time, compiled.

On the ring of the surface at one station depth, normal velocity and the tilt of the normal are all linear in c = cos β.
So the loaded range of c is known in closed form, and it falls into at most three arcs. In the order of rising c: an arc
whose normal points into the target and which is resisted in full, with integrals in closed form; one so deep that the
plastic zone does not reach the face; and one near the face. On the last two the integrand is smooth, and a few
Gauss-Legendre points in β do. (That order holds for an axis angle of 0 to 180°; others are mirrored before.)

Rings lie side by side in rows of one flat array, so that loops over them fill vector registers. No loop has a branch:
an arc that is not there has no width. Rings known to have the first arc only lie apart from the others, and cost a
fraction of them.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, arc_cosine, sine
from solver.compilation import VECTOR_WIDTH, exact, lean, vectorised
from solver.free_surface import TINY, Decay, inertial_factor, static_factor
from solver.surface import ARC, BodyMotion

ROOM = 520
"""Rings of either kind in a batch: two stretches with the most stations there may be, and more."""
FULL = ROOM
"""Place of the first ring that is resisted in full; the others begin at 0."""
CAPACITY = 2 * ROOM
VECTOR = np.uint64(VECTOR_WIDTH)
"""Loops go on to a multiple of this, so that none has a remainder, over rings of before that no sum takes in."""
(
    ALPHA, AXIAL, RADIUS, SIZE, WEIGHT, DEPTH, COSINE, SINE, FORWARD, SIDEWAYS, SPIN,
    INWARD, INWARD_SLOPE, OUTWARD, OUTWARD_SLOPE, SPEED, SPEED_SLOPE, STATIC, ALONG, ACROSS, TURN,
    DEEP_BEGIN, DEEP_SPAN, NEAR_BEGIN, NEAR_SPAN, EVEN, ODD, CAVITY,
) = (np.uint64(row * CAPACITY) for row in range(28))  # fmt: skip
"""Where the rows begin. Unsigned, since an index that might be negative costs a test each time.

What `add_rings` writes: α; axial position and radius of the centre of curvature; radius of curvature; the ring's share
of the outline; the motion of its body; the bound of its cavity. On a straight piece the second and
third are those of the ring itself, and the radius of curvature is zero. What `_load_rings` adds, as values and slopes
in c: depth times cos α and outward tilt of the normal times the radius, which make up k, where the cavity is bounded
depth and outward tilt times the bound; normal velocity. Then S f'c, ramped; what the integral of the stress adds
to the force along the axis, and that of the stress times c to the force across and the moment; where the two arcs with
a decay begin, as β - π/2, and how far they reach; and the two integrals, to which the sums over the arcs add."""
ROW_COUNT = 28
SPAN = np.uint64(CAPACITY)
"""From the row where arcs begin to the one with their ends."""
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
    thickness: float
    """Depth of the rear face; infinite for a half-space. [m]"""
    loaded_thickness: float
    """Depth from which nothing is loaded: the rear face, or where the plug begins. [m]"""
    crater_depth: float
    """From which the target resists in full; 0 for no crater. [m]"""


@vectorised
def clamp(value: float, low: float, high: float) -> float:
    """The value, or the end of the range that it is beyond."""
    bounded = max(low, value)
    return min(high, bounded)


@vectorised
def loaded_range(depth: float, depth_slope: float, speed: float, speed_slope: float) -> tuple[float, float]:
    """Lowest and highest c that is below the face and moves into the target; the same if none does."""
    face = depth / (TINY - depth_slope)
    separation = -speed / speed_slope
    high = min(1.0, face)
    high = separation if speed_slope < 0.0 and separation < high else high
    low = separation if speed_slope > 0.0 and separation > -1.0 else -1.0
    low = min(1.0, low)
    return low, high if speed + abs(speed_slope) > 0.0 and high > low else low


@vectorised
def ramped(fastest: float, static_stress: float, ramp_velocity: float, smooth: bool) -> float:
    """Static stress on a ring with this largest normal velocity. [Pa]"""
    ramp = fastest / ramp_velocity
    ramp *= ramp if smooth else 1.0
    return static_stress * ramp / math.sqrt(1.0 + ramp * ramp)


@vectorised
def integrate_full(
    low: float, high: float, turn: float, static: float, density: float, speed: float, speed_slope: float
) -> tuple[float, float]:
    """Integrals over β of the full stress, and of it times c, from low to high c, which lie `turn` apart in β."""
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
    """Write what makes up the rings at the stations of a stretch. What fills the last vector has no weight."""
    # On an arc of the outline α runs along it, on a straight piece the position: the same loop does both.
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
    """Sine and cosine of α, axial position and radius of a ring."""
    sine_, half = sine(rows[ALPHA + i]), sine(0.5 * rows[ALPHA + i])
    cosine = 1.0 - 2.0 * half * half
    return sine_, cosine, rows[AXIAL + i] + rows[SIZE + i] * sine_, rows[RADIUS + i] + rows[SIZE + i] * cosine


@exact
def cavity_scales(bound: float, cosine: float, radius: float) -> tuple[float, float]:
    """Factors of the depth and of the outward tilt of a ring, of which the ratio, plus one, is k.

    With a cavity of radius r / cos α they are cos α and r, so that a ring near the axis needs no division by zero; with
    a bounded one, 1 and the bound.
    """
    return (1.0, bound) if bound > 0.0 else (cosine, radius)


@exact
def ring_motion(rows: FloatArray, i: int) -> BodyMotion:
    """Motion of the body that a ring is part of."""
    return (
        rows[DEPTH + i], rows[COSINE + i], rows[SINE + i], rows[FORWARD + i], rows[SIDEWAYS + i], rows[SPIN + i],
    )  # fmt: skip


@vectorised
def _load_full_rings(rows: FloatArray, end: np.uint64, law: Law) -> None:
    """Integrate around rings that are resisted in full wherever they are loaded, up to a place."""
    for i in range(np.uint64(FULL), end):
        depth, c, s, forward, sideways, spin = ring_motion(rows, i)
        sine_, cosine, axial, radius = place_ring(rows, i)
        # The normal velocity is speed + speed_slope c, and the depth is linear too: their zeros bound what is loaded.
        speed = forward * sine_
        speed_slope = (sideways + spin * axial) * cosine - spin * radius * sine_
        low, high = loaded_range(depth + axial * c, -radius * s, speed, speed_slope)
        # One static stress for the ring, by its fastest point, leaves a polynomial in c, which has a closed integral.
        static = ramped(speed + abs(speed_slope), law.static_stress, law.ramp_velocity, law.smooth_ramp)
        turn = arc_cosine(low) - arc_cosine(high)
        even, odd = integrate_full(low, high, turn, static, law.dynamic_density, speed, speed_slope)
        # Both halves of the ring, to either side of the plane of motion, are loaded alike.
        weight = 2.0 * rows[WEIGHT + i] * radius
        rows[EVEN + i], rows[ODD + i] = even, odd
        rows[ALONG + i], rows[ACROSS + i] = -weight * sine_, -weight * cosine
        rows[TURN + i] = weight * (radius * sine_ - axial * cosine)


def _ring_loader(name: str, *, bounded: bool) -> Callable[[FloatArray, np.uint64, Law], None]:
    """Function for bodies with or without a bounded cavity: those without, as ogives are, save the choice of it.

    Compiled code is kept by the name.
    """

    def load_rings(rows: FloatArray, end: np.uint64, law: Law) -> None:
        """Find the arcs of every ring, and integrate around those that are resisted in full, up to a place."""
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

            # Above `tilted` the normal leans out of the target; above `plastic` k lies below the corner of the decay.
            # Clamped one by one they leave arcs in order, and an arc that is not there has equal ends, for no branch.
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
            # From -π/2 on, the sine of the angle is -c: one polynomial, for the sine, serves all points of the arcs.
            rows[DEEP_BEGIN + i], rows[DEEP_SPAN + i] = angle_middle - HALF_TURN, angle_start - angle_middle
            rows[NEAR_BEGIN + i], rows[NEAR_SPAN + i] = angle_high - HALF_TURN, angle_middle - angle_high

    load_rings.__name__ = load_rings.__qualname__ = name
    return vectorised(load_rings)


_load_rings = _ring_loader("_load_rings", bounded=False)
_load_bounded_rings = _ring_loader("_load_bounded_rings", bounded=True)


@exact
def _point(rows: FloatArray, ring: int, begin: np.uint64, node: float) -> tuple[float, float, float, float]:
    """The point at a fraction of an arc: c, distance to the face, distance to the axis, normal velocity."""
    c = -sine(rows[begin + ring] + rows[begin + SPAN + ring] * node)
    inward = rows[INWARD + ring] + rows[INWARD_SLOPE + ring] * c
    outward = rows[OUTWARD + ring] + rows[OUTWARD_SLOPE + ring] * c
    speed = rows[SPEED + ring] + rows[SPEED_SLOPE + ring] * c
    return c, max(0.0, inward), outward, speed


@vectorised
def _sum_arcs(rows: FloatArray, end: np.uint64, deep: bool, points: FloatArray, law: Law) -> None:
    """Load of the arcs on one side of the corner, of rings up to a place and a decay without inertia."""
    begin = DEEP_BEGIN if deep else NEAR_BEGIN
    # Points outside, rings inside: an arc has a few points only, and the rings fill the vectors. The decay has its
    # corner between the two sides, so each takes one smooth formula, and few points do.
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
    """The same for a decay with inertia: a separate loop, since the other takes half its time without."""
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
    """Add the arcs with a decay to the integrals of the rings up to a place."""
    if law.decay.inertia_scale > 0.0:
        _sum_inertial_arcs(rows, end, True, points, law)
        _sum_inertial_arcs(rows, end, False, points, law)
    else:
        _sum_arcs(rows, end, True, points, law)
        _sum_arcs(rows, end, False, points, law)


@lean
def whole(count: int) -> np.uint64:
    """So many rings and what it takes to fill vectors."""
    return (np.uint64(count) + VECTOR - np.uint64(1)) // VECTOR * VECTOR


@lean
def integrate_rings(rows: FloatArray, count: int, full: int, points: FloatArray, law: Law, bounded: bool) -> None:
    """Integrate around the first `count` rings, and around so many that are resisted in full."""
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
    """Force along and across the axis, and moment, of the rings between two places."""
    along = across = moment = 0.0
    for i in range(np.uint64(begin), np.uint64(end)):
        along += rows[ALONG + i] * rows[EVEN + i]
        across += rows[ACROSS + i] * rows[ODD + i]
        moment += rows[TURN + i] * rows[ODD + i]
    return along, across, moment
