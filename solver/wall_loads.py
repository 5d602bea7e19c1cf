"""Force and moment on a projectile in a wall with a rear face, compiled.

An element that faces the rear of the wall is weakened by it as one that faces out is by the impact face: with the same
decay function, on the distance along its normal to the rear face. What is beyond the rear face is not loaded. On a
ring that gives up to four arcs, in the order of rising cos β: near the rear face, deep before it, deep behind the
impact face, and near that. A face across the axis, whose normal meets the axis nowhere, is resisted in full up to
the rear.
"""

import math

from solver.arrays import FloatArray
from solver.compilation import lean
from solver.decay import TINY, decay_at
from solver.loads import SHORT, Quadrature, Scratch
from solver.outline_intervals import MAX_CUTS, Motion, Ring, cut, insert, is_loaded, ring_at
from solver.polynomials import arc_cosine
from solver.surface import ARC, FLAT, Body
from solver.surface_integration import Law, Load, clamp, integrate_full, loaded_range, ramped


@lean
def accelerate_in_wall(
    states: FloatArray, body: Body, law: Law, quadrature: Quadrature, scratch: Scratch, out: FloatArray
) -> None:
    """Write the accelerations of depth, lateral position and axis angle, as `accelerate_by_gauss` does."""
    for k in range(out.size // 3):
        at = 6 * k
        c, s = math.cos(states[at + 2]), math.sin(states[at + 2])
        mirror = math.copysign(1.0, s)
        lateral_speed, spin, s = mirror * states[at + 4], mirror * states[at + 5], abs(s)
        forward, sideways = states[at + 3] * c + lateral_speed * s, lateral_speed * c - states[at + 3] * s
        motion = (states[at], c, s, forward, sideways, spin)
        along = across = moment = 0.0
        for index in range(body.outline.shape[0]):
            f, g, h = _piece_loads(body.outline[index], motion, law, quadrature, scratch.cuts)
            along, across, moment = along + f, across + g, moment + h
        out[3 * k] = (along * c - across * s) / body.mass
        out[3 * k + 1] = mirror * (along * s + across * c) / body.mass
        out[3 * k + 2] = mirror * moment / body.moment_of_inertia


@lean
def _piece_loads(piece: FloatArray, motion: Motion, law: Law, quadrature: Quadrature, cuts: FloatArray) -> Load:
    """Force along and across the axis, and moment, of one outline piece."""
    depth, c, s, forward, sideways, spin = motion
    behind = cuts[2 * MAX_CUTS :]
    count = cut(cuts, piece, motion)
    more = cut(behind, piece, (depth - law.thickness, c, s, forward, sideways, spin))
    upper = cuts[count]
    for k in range(1, more):
        count = insert(cuts, count, behind[k], upper)
    cuts[count] = upper
    along = across = moment = 0.0
    for stretch in range(count):
        begin, end = cuts[stretch], cuts[stretch + 1]
        middle = ring_at(piece, 0.5 * (begin + end))
        if not is_loaded(middle, motion) or depth + middle[2] * c - middle[3] * s >= law.thickness:
            continue
        short = end - begin < SHORT * (cuts[count] - cuts[0])
        rule = quadrature.few_stations if short else quadrature.stations
        share = (end - begin) * (piece[3] if piece[0] == ARC else 1.0)
        for n in range(rule.size):
            ring = ring_at(piece, begin + (end - begin) * rule.table[0, n])
            sine, cosine, axial, radius = ring
            even, odd = _ring_integrals(ring, motion, law, quadrature.points)
            weight = 2.0 * share * rule.table[1, n] * radius
            along -= weight * sine * even
            across -= weight * cosine * odd
            moment += weight * (radius * sine - axial * cosine) * odd
    return along, across, moment


@lean
def _ring_integrals(ring: Ring, motion: Motion, law: Law, points: FloatArray) -> tuple[float, float]:
    """Integrals over β of the stress on a ring, and of it times cos β."""
    sine, cosine, axial, radius = ring
    depth, c, s, forward, sideways, spin = motion
    inside, inside_slope = depth + axial * c, -radius * s
    speed, speed_slope = forward * sine, (sideways + spin * axial) * cosine - spin * radius * sine
    low, high = loaded_range(inside, inside_slope, speed, speed_slope)
    low = clamp((inside - law.thickness) / (TINY - inside_slope), low, high)
    static = ramped(speed + abs(speed_slope), law.static_stress, law.ramp_velocity, law.smooth_ramp)
    if high <= low:
        return 0.0, 0.0
    if law.decay.corner == 0.0:
        turn = arc_cosine(low) - arc_cosine(high)
        return integrate_full(low, high, turn, static, law.dynamic_density, speed, speed_slope)
    outward, outward_slope, beyond = -radius * sine * c, radius * cosine * s, law.decay.corner - 1.0
    start = clamp(-outward / (outward_slope + TINY), low, high)
    ahead, ahead_slope = cosine * (law.thickness - inside), -cosine * inside_slope
    behind, behind_slope = cosine * inside, cosine * inside_slope
    even = odd = 0.0
    if cosine <= FLAT:
        turn = arc_cosine(low) - arc_cosine(start)
        even, odd = integrate_full(low, start, turn, static, law.dynamic_density, speed, speed_slope)
    else:
        plastic = -(ahead + beyond * outward) / (ahead_slope + beyond * outward_slope + TINY)
        plastic = clamp(plastic, low, start)
        for begin, end in ((low, plastic), (plastic, start)):
            lines = (ahead, ahead_slope, -outward, -outward_slope, speed, speed_slope)
            e, o = _arc_integrals(begin, end, lines, static, law, points)
            even, odd = even + e, odd + o
    plastic = (behind - beyond * outward) / (beyond * outward_slope - behind_slope + TINY)
    plastic = clamp(plastic, start, high)
    for begin, end in ((start, plastic), (plastic, high)):
        lines = (behind, behind_slope, outward, outward_slope, speed, speed_slope)
        e, o = _arc_integrals(begin, end, lines, static, law, points)
        even, odd = even + e, odd + o
    return even, odd


@lean
def _arc_integrals(
    low: float,
    high: float,
    lines: tuple[float, float, float, float, float, float],
    static: float,
    law: Law,
    points: FloatArray,
) -> tuple[float, float]:
    """The same over one arc; distance to the face, that to the axis and normal velocity as values and slopes in c."""
    if high <= low:
        return 0.0, 0.0
    inward, inward_slope, outward, outward_slope, speed, speed_slope = lines
    first, even, odd = arc_cosine(high), 0.0, 0.0
    span = arc_cosine(low) - first
    for j in range(points.shape[0]):
        c = math.cos(first + span * points[j, 0])
        normal_speed = speed + speed_slope * c
        factor = decay_at(max(0.0, inward + inward_slope * c), outward + outward_slope * c, normal_speed, law.decay)
        stress = factor * (static + law.dynamic_density * normal_speed * normal_speed) * span * points[j, 1]
        even += stress
        odd += stress * c
    return even, odd
