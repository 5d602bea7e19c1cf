"""Force and moment on a projectile in a wall with a rear face, compiled.

An element that faces the rear of the wall is weakened by it as one that faces out is by the impact face: with the same
decay function, on the distance along its normal to the rear face. What is beyond the rear face is not loaded, nor is
what is in the plug that shears out, if there is one. On a ring that gives up to four arcs, in the order of rising
cos β: near the rear face, deep before it, deep behind the impact face, and near that. So every ring is laid out twice:
once with the arcs that face the impact face, once with those that face the rear. A face across the axis, whose normal
meets the axis nowhere, is resisted in full up to the rear.
"""

import math

import numpy as np

from solver.arrays import FloatArray, arc_cosine
from solver.compilation import lean, vectorised
from solver.decay import TINY
from solver.loads import SHORT, Quadrature, Scratch
from solver.outline_intervals import MAX_CUTS, Motion, cut, insert, is_loaded, ring_at
from solver.surface import FLAT, Body
from solver.surface_integration import (
    ACROSS,
    ALONG,
    DEEP_BEGIN,
    DEEP_SPAN,
    EVEN,
    HALF_TURN,
    INWARD,
    INWARD_SLOPE,
    NEAR_BEGIN,
    NEAR_SPAN,
    ODD,
    OUTWARD,
    OUTWARD_SLOPE,
    ROOM,
    SPEED,
    SPEED_SLOPE,
    STATIC,
    TURN,
    WEIGHT,
    Law,
    add_arcs,
    add_rings,
    clamp,
    integrate_full,
    loaded_range,
    loaded_thickness,
    place_ring,
    ramped,
    ring_motion,
    sum_rings,
    whole,
)

REAR = np.uint64(ROOM // 2)
"""Place of the first ring with the arcs that face the rear; those that face the impact face begin at 0."""


@lean
def accelerate_in_wall(
    states: FloatArray, body: Body, law: Law, quadrature: Quadrature, scratch: Scratch, out: FloatArray
) -> None:
    """Write the accelerations of depth, lateral position and axis angle, as `accelerate_by_gauss` does."""
    loaded = loaded_thickness(law)
    for k in range(out.size // 3):
        at = 6 * k
        c, s = math.cos(states[at + 2]), math.sin(states[at + 2])
        mirror = math.copysign(1.0, s)
        lateral_speed, spin, s = mirror * states[at + 4], mirror * states[at + 5], abs(s)
        forward, sideways = states[at + 3] * c + lateral_speed * s, lateral_speed * c - states[at + 3] * s
        motion = (states[at], c, s, forward, sideways, spin)
        along = across = moment = 0.0
        count = 0
        hidden = c >= 0.0 and law.decay.corner > 0.0  # a base that faces out is weakened to nothing
        for index in range(body.outline.shape[0] - (1 if hidden else 0)):
            piece = body.outline[index]
            stretches = _cut(piece, motion, loaded, scratch.cuts)
            for stretch in range(stretches):
                begin, end = scratch.cuts[stretch], scratch.cuts[stretch + 1]
                middle = ring_at(piece, 0.5 * (begin + end))
                if not is_loaded(middle, motion) or motion[0] + middle[2] * c - middle[3] * s >= loaded:
                    continue
                short = end - begin < SHORT * (scratch.cuts[stretches] - scratch.cuts[0])
                rule = quadrature.few_stations if short else quadrature.stations
                if count + rule.table.shape[1] > ROOM // 2:
                    f, g, h = _integrate(scratch.rows, count, quadrature.points, law)
                    along, across, moment, count = along + f, across + g, moment + h, 0
                add_rings(scratch.rows, count, piece, begin, end, rule.table, motion)
                count += rule.size
        if count > 0:
            f, g, h = _integrate(scratch.rows, count, quadrature.points, law)
            along, across, moment = along + f, across + g, moment + h
        out[3 * k] = (along * c - across * s) / body.mass
        out[3 * k + 1] = mirror * (along * s + across * c) / body.mass
        out[3 * k + 2] = mirror * moment / body.moment_of_inertia


@lean
def _cut(piece: FloatArray, motion: Motion, loaded: float, cuts: FloatArray) -> int:
    """Write the sorted ends of the stretches of a piece, cut at both ends of what is loaded; return their number."""
    depth, c, s, forward, sideways, spin = motion
    behind = cuts[2 * MAX_CUTS :]
    count = cut(cuts, piece, motion)
    more = cut(behind, piece, (depth - loaded, c, s, forward, sideways, spin))
    upper = cuts[count]
    for k in range(1, more):
        count = insert(cuts, count, behind[k], upper)
    cuts[count] = upper
    return count


@lean
def _integrate(rows: FloatArray, count: int, points: FloatArray, law: Law) -> tuple[float, float, float]:
    """Force along and across the axis, and moment, of the first `count` rings."""
    end, at_rear = whole(count), rows[REAR:]
    _load_rings(rows, end, law)
    add_arcs(rows, end, points, law)
    add_arcs(at_rear, end, points, law)
    f, g, h = sum_rings(rows, 0, count)
    along, across, moment = sum_rings(at_rear, 0, count)
    return along + f, across + g, moment + h


@vectorised
def _load_rings(rows: FloatArray, last: np.uint64, law: Law) -> None:
    """Find the arcs of every ring up to a place, those that face the rear at `REAR`, and integrate those in full."""
    beyond, endless = law.decay.corner - 1.0, law.decay.corner == 0.0
    loaded = loaded_thickness(law)
    for i in range(last):
        j = i + REAR
        depth, c, s, forward, sideways, spin = ring_motion(rows, i)
        sine_, cosine, axial, radius = place_ring(rows, i)
        inside, inside_slope = depth + axial * c, -radius * s
        speed = forward * sine_
        speed_slope = (sideways + spin * axial) * cosine - spin * radius * sine_
        outward, outward_slope = -radius * sine_ * c, radius * cosine * s
        ahead, ahead_slope = cosine * (law.thickness - inside), -cosine * inside_slope
        inward, inward_slope = cosine * inside, cosine * inside_slope

        low, high = loaded_range(inside, inside_slope, speed, speed_slope)
        low = clamp((inside - loaded) / (TINY - inside_slope), low, high)
        start = clamp(-outward / (outward_slope + TINY), low, high)
        start = high if endless else start
        full = start if endless or cosine <= FLAT else low  # up to here in full
        rear = -(ahead + beyond * outward) / (ahead_slope + beyond * outward_slope + TINY)
        rear = clamp(rear, full, start)
        front = (inward - beyond * outward) / (beyond * outward_slope - inward_slope + TINY)
        front = clamp(front, start, high)
        at_front, at_rear = high > start, start > full  # elsewhere any finite decay, without weight

        static = ramped(speed + abs(speed_slope), law.static_stress, law.ramp_velocity, law.smooth_ramp)
        angle_low, angle_full, angle_rear = arc_cosine(low), arc_cosine(full), arc_cosine(rear)
        angle_start, angle_front, angle_high = arc_cosine(start), arc_cosine(front), arc_cosine(high)
        turn = angle_low - angle_full
        even, odd = integrate_full(low, full, turn, static, law.dynamic_density, speed, speed_slope)

        weight = 2.0 * rows[WEIGHT + i] * radius
        along, across, turning = -weight * sine_, -weight * cosine, weight * (radius * sine_ - axial * cosine)
        rows[ALONG + i], rows[ACROSS + i], rows[TURN + i] = along, across, turning
        rows[ALONG + j], rows[ACROSS + j], rows[TURN + j] = along, across, turning
        rows[EVEN + i], rows[ODD + i] = even, odd
        rows[EVEN + j], rows[ODD + j] = 0.0, 0.0
        rows[INWARD + i], rows[INWARD_SLOPE + i] = inward, inward_slope
        rows[INWARD + j], rows[INWARD_SLOPE + j] = ahead, ahead_slope
        rows[OUTWARD + i] = outward if at_front else 1.0
        rows[OUTWARD + j] = -outward if at_rear else 1.0
        rows[OUTWARD_SLOPE + i] = outward_slope if at_front else 0.0
        rows[OUTWARD_SLOPE + j] = -outward_slope if at_rear else 0.0
        rows[SPEED + i], rows[SPEED_SLOPE + i], rows[STATIC + i] = speed, speed_slope, static
        rows[SPEED + j], rows[SPEED_SLOPE + j], rows[STATIC + j] = speed, speed_slope, static
        rows[DEEP_BEGIN + i], rows[DEEP_SPAN + i] = angle_front - HALF_TURN, angle_start - angle_front
        rows[NEAR_BEGIN + i], rows[NEAR_SPAN + i] = angle_high - HALF_TURN, angle_front - angle_high
        rows[DEEP_BEGIN + j], rows[DEEP_SPAN + j] = angle_start - HALF_TURN, angle_rear - angle_start
        rows[NEAR_BEGIN + j], rows[NEAR_SPAN + j] = angle_rear - HALF_TURN, angle_full - angle_rear
