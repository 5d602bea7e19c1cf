"""Compiled force and moment on the projectile at an instant (eqs. 1-5), and its accelerations (eq. 6).

The paper's method sums over panels. The adaptive method integrates: it cuts the outline into stretches on which the
loaded arc changes smoothly, places Gauss-Legendre stations on each loaded stretch, and sums the rings at all stations,
of several states at a time, in one loop.

In a wall, the rear face weakens the resistance to elements whose normals point toward it, and the impact face weakens
the resistance to all others, both by the same decay function of the distance to the face along the normal. Elements
beyond the rear face, or in a plug that shears out, carry no load. A ring then has up to four arcs, in order of
increasing cos β, where β is the angle around the axis: near the rear face, far from it, far from the impact face, and
near the impact face. Each ring is stored twice: once with its arcs toward the impact face, once with its arcs toward
the rear face.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray, arc_cosine, gauss_rule
from solver.compilation import VECTOR_WIDTH, inlined, lean, vectorised
from solver.free_surface import TINY, build_decay, decay_at
from solver.projectile import Projectile
from solver.resistance import Resistance, plug_height
from solver.surface import (
    BOUNDED,
    MAX_CUTS,
    TAPERED,
    Body,
    BodyMotion,
    Panels,
    cut,
    deepest_offset,
    insert,
    is_full,
    is_loaded,
    ring_at,
)
from solver.surface_integration import (
    ACROSS,
    ALONG,
    CAPACITY,
    CAVITY,
    DEEP_BEGIN,
    DEEP_SPAN,
    EVEN,
    FULL,
    INWARD,
    INWARD_SLOPE,
    NEAR_BEGIN,
    NEAR_SPAN,
    ODD,
    OUTWARD,
    OUTWARD_SLOPE,
    QUARTER_TURN,
    ROOM,
    ROW_COUNT,
    SPEED,
    SPEED_SLOPE,
    STATIC,
    TURN,
    WEIGHT,
    Law,
    Load,
    add_arcs,
    add_rings,
    cavity_scales,
    clamp,
    integrate_full,
    integrate_rings,
    loaded_range,
    place_ring,
    ramped,
    ring_motion,
    sum_rings,
    whole,
)
from solver.target import Target

# A Jacobian needs five evaluations: one for each of depth, axis angle and three velocities.
MOST_STATES = 5
"""Largest number of states evaluated in one call; together their rings fill whole vectors."""
# The integrand changes little along a short stretch. With half the stations there, a search was 6 % faster and found
# the same angles.
SHORT = 0.1
"""Length of a stretch relative to the length of its outline piece, below which it gets half the stations. [1]"""
REAR = np.uint64(ROOM // 2)
"""Index of the first ring with arcs toward the rear face; rings with arcs toward the impact face begin at 0."""


class Rule(NamedTuple):
    """Gauss-Legendre rule on [0, 1], padded for loops over whole vectors."""

    size: int
    """Number of stations."""
    table: FloatArray
    """(2, n) nodes and weights, padded with zeros to a multiple of the SIMD width."""


class Quadrature(NamedTuple):
    """Gauss-Legendre rules for the integrals over the surface."""

    stations: Rule
    """Rule for the stations along a stretch of the outline."""
    few_stations: Rule
    """Rule for the stations along a short stretch, half as many."""
    points: FloatArray
    """(m, 2) nodes and weights of the rule around an arc."""


class Scratch(NamedTuple):
    """Scratch arrays of one evaluation."""

    cuts: FloatArray
    """(3 `MAX_CUTS`,) ends of the stretches of one outline piece. In a wall the first two thirds hold the cuts by both
    faces, and the last third the cuts by the rear face before they are merged."""
    rows: FloatArray
    """(`ROW_COUNT` × `CAPACITY`,) rows of ring data, see `solver.surface_integration`."""
    attitudes: FloatArray
    """(`MOST_STATES`, 3) cosine of the axis angle, and absolute value and sign of its sine."""
    ends: IntArray
    """(`MOST_STATES`, 2) index after the last ring of each state, among the rings below `FULL` and among those from
    `FULL` on."""


def build_law(
    *, resistance: Resistance, target: Target, projectile: Projectile, strength_factor: float, ramp_velocity: float
) -> Law:
    """Build the resistance law of a target for the strength factor of one strike."""
    thickness, crater = math.inf if target.thickness is None else float(target.thickness), resistance.crater
    return Law(
        static_stress=float(strength_factor * target.compressive_strength),
        dynamic_density=float(resistance.inertia_factor * target.density),
        ramp_velocity=float(ramp_velocity),
        smooth_ramp=True,
        decay=build_decay(resistance.free_surface, target),
        thickness=thickness,
        loaded_thickness=thickness - plug_height(resistance=resistance, target=target, projectile=projectile),
        crater_depth=0.0 if crater is None else float(crater.depth_diameters * projectile.diameter),
    )


def build_quadrature(*, stations: int, points: int) -> Quadrature:
    """Build the rules for a number of stations on each stretch and a number of points on each arc."""
    return Quadrature(_rule(stations), _rule((stations + 1) // 2), gauss_rule(points))


@cache
def _rule(count: int) -> Rule:
    table = np.zeros((2, math.ceil(count / VECTOR_WIDTH) * VECTOR_WIDTH))
    table[:, :count] = gauss_rule(count).T
    return Rule(count, table)


def make_scratch() -> Scratch:
    """Allocate the scratch arrays of an evaluation."""
    attitudes, ends = np.zeros((MOST_STATES, 3)), np.zeros((MOST_STATES, 2), np.int64)
    return Scratch(np.empty(3 * MAX_CUTS), np.empty(ROW_COUNT * CAPACITY), attitudes, ends)


@inlined
def accelerate_by_gauss(
    states: FloatArray, body: Body, law: Law, quadrature: Quadrature, scratch: Scratch, out: FloatArray
) -> None:
    """Write the accelerations of depth, lateral position and axis angle in up to `MOST_STATES` states.

    Parameters
    ----------
    states
        (6 n,) states, concatenated: depth and lateral position of the centre of gravity, axis angle, and their rates.
        [m, rad, s]
    out
        (3 n,) output: accelerations, all zero where nothing is loaded. [m/s², rad/s²]
    """
    outline, cuts, rows = body.outline, scratch.cuts, scratch.rows
    rings = fulls = first = 0
    c = s = 0.0
    for k in range(out.size // 3):
        at = 6 * k
        if k == 0 or states[at + 2] != states[at - 4]:
            c, s = math.cos(states[at + 2]), math.sin(states[at + 2])
        # The order of the arcs on a ring holds for axis angles of 0 to 180° only. Other states are mirrored about the
        # normal of the face, and their accelerations are mirrored back.
        mirror = math.copysign(1.0, s)
        depth, lateral_speed, spin = states[at], mirror * states[at + 4], mirror * states[at + 5]
        forward, sideways = states[at + 3] * c + lateral_speed * abs(s), lateral_speed * c - states[at + 3] * abs(s)
        motion = (depth, c, abs(s), forward, sideways, spin)
        scratch.attitudes[k, 0], scratch.attitudes[k, 1], scratch.attitudes[k, 2] = c, abs(s), mirror
        out[3 * k], out[3 * k + 1], out[3 * k + 2] = 0.0, 0.0, 0.0
        hidden = c >= 0.0 and law.decay.corner > 0.0  # the decay factor of a base that faces out is zero
        for index in range(outline.shape[0] - (1 if hidden else 0)):
            piece = outline[index]
            # Stretches end where the loaded arc has a kink, so that each integrand is smooth and Gauss-Legendre
            # quadrature converges fast.
            count = cut(cuts, piece, motion)
            for stretch in range(count):
                begin, end = cuts[stretch], cuts[stretch + 1]
                middle = ring_at(piece, 0.5 * (begin + end))  # either all rings of a stretch are loaded or none is
                if not is_loaded(middle, motion):
                    continue
                short = end - begin < SHORT * (cuts[count] - cuts[0])
                rule = quadrature.few_stations if short else quadrature.stations
                # Full rows are integrated and reused, so the number of stretches is not limited.
                if max(rings, fulls) + rule.table.shape[1] > ROOM:
                    scratch.ends[k, 0], scratch.ends[k, 1] = rings, FULL + fulls
                    integrate_rings(rows, rings, fulls, quadrature.points, law, body.bounds & BOUNDED > 0)
                    _add_up(first, k, body, scratch, out)
                    first, rings, fulls = k, 0, 0
                # Integrals over rings without a decay have a closed form. Keeping these rings in a loop of their own
                # made searches 5 to 8 % faster.
                if law.decay.corner == 0.0 or is_full(piece, begin, end, middle, motion):
                    add_rings(rows, FULL + fulls, piece, begin, end, rule.table, motion)
                    fulls += rule.size
                else:
                    add_rings(rows, rings, piece, begin, end, rule.table, motion)
                    rings += rule.size
        scratch.ends[k, 0], scratch.ends[k, 1] = rings, FULL + fulls
    integrate_rings(rows, rings, fulls, quadrature.points, law, body.bounds & BOUNDED > 0)
    _add_up(first, out.size // 3 - 1, body, scratch, out)


@lean
def _add_up(first: int, last: int, body: Body, scratch: Scratch, out: FloatArray) -> None:
    """Add the loads of the stored rings to the accelerations of the states from `first` to `last`."""
    begin, begin_full, mobility, agility = 0, FULL, 1.0 / body.mass, 1.0 / body.moment_of_inertia
    for k in range(first, last + 1):
        end, end_full = scratch.ends[k, 0], scratch.ends[k, 1]
        f, g, h = sum_rings(scratch.rows, begin, end)
        along, across, moment = sum_rings(scratch.rows, begin_full, end_full)
        along, across, moment = along + f, across + g, moment + h
        c, s, mirror = scratch.attitudes[k, 0], scratch.attitudes[k, 1], scratch.attitudes[k, 2]
        out[3 * k] += (along * c - across * s) * mobility
        out[3 * k + 1] += mirror * (along * s + across * c) * mobility
        out[3 * k + 2] += mirror * moment * agility
        begin, begin_full = end, end_full


@lean
def weaken_in_crater(states: FloatArray, body: Body, crater_depth: float, out: FloatArray) -> None:
    """Scale the accelerations in each state by the ratio of the largest depth to the crater depth, from 0 to 1."""
    for k in range(out.size // 3):
        depth = states[6 * k] + deepest_offset(body, states[6 * k + 2])
        share = min(max(depth / crater_depth, 0.0), 1.0)
        for n in range(3 * k, 3 * k + 3):
            out[n] *= share


@lean
def panel_loads(state: FloatArray, panels: Panels, law: Law) -> Load:
    """Return the force along the depth, the lateral force and the moment as sums over the paper's panels. [N, N m]

    As in the paper, the static stress has no ramp.
    """
    depth, angle, spin = state[0], state[2], state[5]
    c, s = math.cos(angle), math.sin(angle)
    forward, sideways = state[3] * c + state[4] * s, state[4] * c - state[3] * s
    along = across = moment = 0.0
    loaded = law.loaded_thickness
    for i in range(panels.area.size):
        axial, lateral = panels.axial[i], panels.lateral[i]
        inside = depth + axial * c - lateral * s
        if inside <= 0.0 or inside >= loaded:
            continue
        n_axial, n_lateral = panels.normal_axial[i], panels.normal_lateral[i]
        speed = (forward - spin * lateral) * n_axial + (sideways + spin * axial) * n_lateral
        if speed <= 0.0:
            continue
        tilt, cavity = n_lateral * s - n_axial * c, panels.cavity[i]
        # The face that the normal of an element meets weakens its resistance: the rear face if the normal points
        # inward.
        if tilt < 0.0 and law.thickness < math.inf:
            factor = decay_at(law.thickness - inside, -tilt * min(cavity, panels.radius), speed, law.decay)
        else:
            factor = decay_at(inside, cavity * tilt, speed, law.decay)
        force = factor * (law.static_stress + law.dynamic_density * speed * speed) * panels.area[i]
        along -= force * n_axial
        across -= force * n_lateral
        moment += force * (lateral * n_axial - axial * n_lateral)
    return along * c - across * s, along * s + across * c, moment


@lean
def accelerate_in_wall(
    states: FloatArray, body: Body, law: Law, quadrature: Quadrature, scratch: Scratch, out: FloatArray
) -> None:
    """Write the accelerations of states in a wall; arguments are those of `accelerate_by_gauss`."""
    loaded = law.loaded_thickness
    for k in range(out.size // 3):
        at = 6 * k
        c, s = math.cos(states[at + 2]), math.sin(states[at + 2])
        mirror = math.copysign(1.0, s)
        lateral_speed, spin, s = mirror * states[at + 4], mirror * states[at + 5], abs(s)
        forward, sideways = states[at + 3] * c + lateral_speed * s, lateral_speed * c - states[at + 3] * s
        motion = (states[at], c, s, forward, sideways, spin)
        along = across = moment = 0.0
        count = 0
        hidden = c >= 0.0 and law.decay.corner > 0.0  # the decay factor of a base that faces out is zero
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
                    f, g, h = _integrate(scratch.rows, count, quadrature.points, law, body.bounds & TAPERED > 0)
                    along, across, moment, count = along + f, across + g, moment + h, 0
                add_rings(scratch.rows, count, piece, begin, end, rule.table, motion)
                count += rule.size
        if count > 0:
            f, g, h = _integrate(scratch.rows, count, quadrature.points, law, body.bounds & TAPERED > 0)
            along, across, moment = along + f, across + g, moment + h
        out[3 * k] = (along * c - across * s) / body.mass
        out[3 * k + 1] = mirror * (along * s + across * c) / body.mass
        out[3 * k + 2] = mirror * moment / body.moment_of_inertia


@lean
def _cut(piece: FloatArray, motion: BodyMotion, loaded: float, cuts: FloatArray) -> int:
    """Write the sorted ends of the stretches of a piece in a wall, cut by both faces; return the number of stretches.

    The rear cut is at the rear face or, with a plug, where the plug begins.
    """
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
def _integrate(rows: FloatArray, count: int, points: FloatArray, law: Law, tapers: bool) -> Load:
    """Return the force along and across the axis and the moment of the first `count` rings in a wall. [N, N m]"""
    integrate_in_wall(rows, count, points, law, tapers)
    f, g, h = sum_rings(rows, 0, count)
    along, across, moment = sum_rings(rows[REAR:], 0, count)
    return along + f, across + g, moment + h


@lean
def integrate_in_wall(rows: FloatArray, count: int, points: FloatArray, law: Law, tapers: bool) -> None:
    """Integrate the stress around the first `count` rings in a wall.

    In `rows`, the arcs toward the impact face start at row 0, and those toward the rear face at row `REAR`.
    """
    end, at_rear = whole(count), rows[REAR:]
    if tapers:
        _load_tapering_rings(rows, end, law)
    else:
        _load_rings(rows, end, law)
    add_arcs(rows, end, points, law)
    add_arcs(at_rear, end, points, law)


def _ring_loader(name: str, *, tapers: bool) -> Callable[[FloatArray, np.uint64, Law], None]:
    """Return a function that finds the arcs of rings in a wall, for bodies with or without a tapering part.

    The cavity of a tapering part is unbounded toward the impact face and bounded toward the rear face. Bodies without
    such a part save the second evaluation. The cache of compiled code distinguishes the two functions by `name`.
    """

    def load_rings(rows: FloatArray, last: np.uint64, law: Law) -> None:
        """Find the arcs of the rings up to `last`, and integrate the stress on the arcs without decay."""
        beyond, endless, loaded = law.decay.corner - 1.0, law.decay.corner == 0.0, law.loaded_thickness
        for i in range(last):
            j = i + REAR
            depth, c, s, forward, sideways, spin = ring_motion(rows, i)
            sine_, cosine, axial, radius = place_ring(rows, i)
            inside, inside_slope = depth + axial * c, -radius * s
            speed = forward * sine_
            speed_slope = (sideways + spin * axial) * cosine - spin * radius * sine_
            depth_scale, tilt_scale = cavity_scales(rows[CAVITY + i], cosine, radius)
            outward, outward_slope = -tilt_scale * sine_ * c, tilt_scale * cosine * s
            inward, inward_slope = depth_scale * inside, depth_scale * inside_slope
            rear_tilt, rear_tilt_slope = outward, outward_slope  # outward tilt scaled by the cavity toward the rear
            if tapers:
                depth_scale, tilt_scale = cavity_scales(abs(rows[CAVITY + i]), cosine, radius)
                rear_tilt, rear_tilt_slope = -tilt_scale * sine_ * c, tilt_scale * cosine * s
            ahead, ahead_slope = depth_scale * (law.thickness - inside), -depth_scale * inside_slope

            # Each clamp keeps an end between its neighbours, so the arcs stay in order and an absent arc has no width.
            # `TINY` avoids 0/0 where a ring has no slope, and is lost in the rounding of any other denominator.
            low, high = loaded_range(inside, inside_slope, speed, speed_slope)
            low = clamp((inside - loaded) / (TINY - inside_slope), low, high)
            start = clamp(-outward / (outward_slope + TINY), low, high)
            start = high if endless else start
            full = start if endless else low  # end of the arc without decay
            rear = -(ahead + beyond * rear_tilt) / (ahead_slope + beyond * rear_tilt_slope + TINY)
            rear = clamp(rear, full, start)
            front = (inward - beyond * outward) / (beyond * outward_slope - inward_slope + TINY)
            front = clamp(front, start, high)
            at_front, at_rear = high > start, start > full  # an absent arc gets a tilt of 1, which keeps k finite

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
            rows[OUTWARD + i], rows[OUTWARD_SLOPE + i] = (outward, outward_slope) if at_front else (1.0, 0.0)
            rows[OUTWARD + j], rows[OUTWARD_SLOPE + j] = (-rear_tilt, -rear_tilt_slope) if at_rear else (1.0, 0.0)
            rows[SPEED + i], rows[SPEED_SLOPE + i], rows[STATIC + i] = speed, speed_slope, static
            rows[SPEED + j], rows[SPEED_SLOPE + j], rows[STATIC + j] = speed, speed_slope, static
            rows[DEEP_BEGIN + i], rows[DEEP_SPAN + i] = angle_front - QUARTER_TURN, angle_start - angle_front
            rows[NEAR_BEGIN + i], rows[NEAR_SPAN + i] = angle_high - QUARTER_TURN, angle_front - angle_high
            rows[DEEP_BEGIN + j], rows[DEEP_SPAN + j] = angle_start - QUARTER_TURN, angle_rear - angle_start
            rows[NEAR_BEGIN + j], rows[NEAR_SPAN + j] = angle_rear - QUARTER_TURN, angle_full - angle_rear

    load_rings.__name__ = load_rings.__qualname__ = name
    return vectorised(load_rings)


_load_rings = _ring_loader("_load_rings", tapers=False)
_load_tapering_rings = _ring_loader("_load_tapering_rings", tapers=True)
