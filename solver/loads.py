"""Force and moment on the projectile at an instant (eqs. 1-5), and what they do to its motion (eq. 6), compiled.

The route of the paper sums over panels. Ours integrates: the outline is cut into stretches on which the loaded arc
changes smoothly, each loaded stretch gets Gauss-Legendre stations, and the rings at the stations are summed together,
those of several states at a time.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray, gauss_rule
from solver.compilation import VECTOR_WIDTH, compiled, inlined, lean
from solver.decay import build_decay, decay_at
from solver.outline_intervals import MAX_CUTS, cut, is_full, is_loaded, ring_at
from solver.resistance import Resistance
from solver.surface import FAR, Body, Panels
from solver.surface_integration import (
    CAPACITY,
    FULL,
    ROOM,
    ROW_COUNT,
    Law,
    Load,
    add_rings,
    integrate_rings,
    loaded_thickness,
    sum_rings,
)
from solver.target import Target

MOST_STATES = 5
"""That are evaluated together: their rings fill the same vectors, and none waits for another."""
SHORT = 0.1
"""Part of an outline piece below which a stretch gets half of the stations."""


class Rule(NamedTuple):
    """A Gauss-Legendre rule on [0, 1] for loops over vectors."""

    size: int
    """Stations."""
    table: FloatArray
    """(2, n) nodes and weights, filled up with zeros to whole vectors."""


class Quadrature(NamedTuple):
    """Gauss-Legendre nodes and weights on [0, 1]."""

    stations: Rule
    """Along a stretch of the outline,"""
    few_stations: Rule
    """along a short one, half as many."""
    points: FloatArray
    """(m, 2) around an arc."""


class Scratch(NamedTuple):
    """Arrays to work in during one evaluation."""

    cuts: FloatArray
    """(3 `MAX_CUTS`,) of one outline piece: by the face, and in a wall by either face, then by its rear face."""
    rows: FloatArray
    attitudes: FloatArray
    """(`MOST_STATES`, 3) cosine of the axis angle, its sine without sign, and the sign."""
    ends: IntArray
    """(`MOST_STATES`, 2) places in the rows where the rings of a state end, and those resisted in full."""


def build_law(
    *, resistance: Resistance, target: Target, diameter: float, strength_factor: float, ramp_velocity: float
) -> Law:
    """Resistance of `target` with the strength factor of one strike, to a projectile of this diameter."""
    plug, crater = resistance.rear_plug, resistance.crater
    return Law(
        static_stress=float(strength_factor * target.compressive_strength),
        dynamic_density=float(resistance.inertia_factor * target.density),
        ramp_velocity=float(ramp_velocity),
        smooth_ramp=True,
        decay=build_decay(resistance.free_surface, target),
        thickness=math.inf if target.thickness is None else float(target.thickness),
        plug_scale=0.0 if plug is None else 0.5 * diameter / math.tan(plug.cone_angle),
        plug_stress=1.0 if plug is None else target.compressive_strength / (math.sqrt(3.0) * math.tan(plug.cone_angle)),
        crater_depth=0.0 if crater is None else float(crater.depth_diameters * diameter),
    )


def build_quadrature(*, stations: int, points: int) -> Quadrature:
    """Rules with so many stations a stretch and points an arc."""
    return Quadrature(_rule(stations), _rule((stations + 1) // 2), gauss_rule(points))


@cache
def _rule(count: int) -> Rule:
    table = np.zeros((2, math.ceil(count / VECTOR_WIDTH) * VECTOR_WIDTH))
    table[:, :count] = gauss_rule(count).T
    return Rule(count, table)


@compiled
def make_scratch() -> Scratch:
    """Return arrays to work in."""
    attitudes, ends = np.zeros((MOST_STATES, 3)), np.zeros((MOST_STATES, 2), np.int64)
    return Scratch(np.empty(3 * MAX_CUTS), np.empty(ROW_COUNT * CAPACITY), attitudes, ends)


@inlined
def accelerate_by_gauss(
    states: FloatArray, body: Body, law: Law, quadrature: Quadrature, scratch: Scratch, out: FloatArray
) -> None:
    """Write the accelerations of depth, lateral position and axis angle, of up to `MOST_STATES` states.

    Parameters
    ----------
    states
        (6 n,) one after the other: depth and lateral position of the centre of gravity, axis angle, and their rates.
        [m, rad, s]
    out
        (3 n,) All zero only where nothing is loaded. [m/s², rad/s²]
    """
    outline, cuts, rows = body.outline, scratch.cuts, scratch.rows
    rings = fulls = first = 0
    c = s = 0.0
    for k in range(out.size // 3):
        at = 6 * k
        if k == 0 or states[at + 2] != states[at - 4]:
            c, s = math.cos(states[at + 2]), math.sin(states[at + 2])
        mirror = math.copysign(1.0, s)
        depth, lateral_speed, spin = states[at], mirror * states[at + 4], mirror * states[at + 5]
        forward, sideways = states[at + 3] * c + lateral_speed * abs(s), lateral_speed * c - states[at + 3] * abs(s)
        motion = (depth, c, abs(s), forward, sideways, spin)
        scratch.attitudes[k, 0], scratch.attitudes[k, 1], scratch.attitudes[k, 2] = c, abs(s), mirror
        out[3 * k], out[3 * k + 1], out[3 * k + 2] = 0.0, 0.0, 0.0
        hidden = c >= 0.0 and law.decay.corner > 0.0  # a base that faces out is weakened to nothing
        for index in range(outline.shape[0] - (1 if hidden else 0)):
            piece = outline[index]
            count = cut(cuts, piece, motion)
            for stretch in range(count):
                begin, end = cuts[stretch], cuts[stretch + 1]
                middle = ring_at(piece, 0.5 * (begin + end))  # loaded if the stretch is
                if not is_loaded(middle, motion):
                    continue
                short = end - begin < SHORT * (cuts[count] - cuts[0])
                rule = quadrature.few_stations if short else quadrature.stations
                if max(rings, fulls) + rule.table.shape[1] > ROOM:
                    scratch.ends[k, 0], scratch.ends[k, 1] = rings, FULL + fulls
                    integrate_rings(rows, rings, fulls, quadrature.points, law)
                    _add_up(first, k, body, scratch, out)
                    first, rings, fulls = k, 0, 0
                if law.decay.corner == 0.0 or is_full(piece, begin, end, middle, motion):
                    add_rings(rows, FULL + fulls, piece, begin, end, rule.table, motion)
                    fulls += rule.size
                else:
                    add_rings(rows, rings, piece, begin, end, rule.table, motion)
                    rings += rule.size
        scratch.ends[k, 0], scratch.ends[k, 1] = rings, FULL + fulls
    integrate_rings(rows, rings, fulls, quadrature.points, law)
    _add_up(first, out.size // 3 - 1, body, scratch, out)


@lean
def _add_up(first: int, last: int, body: Body, scratch: Scratch, out: FloatArray) -> None:
    """Add what the rings laid out do to the accelerations of the states from `first` to `last`."""
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
def panel_loads(state: FloatArray, panels: Panels, law: Law) -> Load:
    """The same sum over the panels of the paper, whose stress is not ramped."""
    depth, angle, spin = state[0], state[2], state[5]
    c, s = math.cos(angle), math.sin(angle)
    forward, sideways = state[3] * c + state[4] * s, state[4] * c - state[3] * s
    along = across = moment = 0.0
    loaded = loaded_thickness(law)
    for i in range(panels.area.size):
        axial, lateral = panels.axial[i], panels.lateral[i]
        inside = depth + axial * c - lateral * s
        if inside <= 0.0 or inside >= loaded:
            continue
        n_axial, n_lateral = panels.normal_axial[i], panels.normal_lateral[i]
        speed = (forward - spin * lateral) * n_axial + (sideways + spin * axial) * n_lateral
        if speed <= 0.0:
            continue
        outward = panels.wall[i] * (n_lateral * s - n_axial * c)
        if outward < 0.0 and law.thickness < math.inf and panels.wall[i] < FAR:  # its normal meets the rear face
            factor = decay_at(law.thickness - inside, -outward, speed, law.decay)
        else:
            factor = decay_at(inside, outward, speed, law.decay)
        force = factor * (law.static_stress + law.dynamic_density * speed * speed) * panels.area[i]
        along -= force * n_axial
        across -= force * n_lateral
        moment += force * (lateral * n_axial - axial * n_lateral)
    return along * c - across * s, along * s + across * c, moment
