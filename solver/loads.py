"""Force and moment on the projectile at one instant (eqs. 1-5), compiled.

The route of the paper sums over panels. Ours integrates: the outline is cut into stretches on which the loaded arc
changes smoothly, each loaded stretch gets Gauss-Legendre stations, and the rings at the stations are summed together.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled, inlined, lean
from solver.decay import build_decay, decay_at
from solver.meridian import MAX_CUTS, cut, is_full, is_loaded, ring_at
from solver.quadrature import gauss_rule
from solver.resistance import Resistance
from solver.rings import CAPACITY, FULL, ROOM, ROW_COUNT, Law, Load, add_ring, sum_rings
from solver.surface import ARC, Body, Panels
from solver.target import Target

SHORT = 0.1
"""Part of an outline piece below which a stretch gets half of the stations."""


class Quadrature(NamedTuple):
    """Gauss-Legendre nodes and weights on [0, 1]."""

    stations: FloatArray
    """(n, 2) along a stretch of the outline,"""
    few_stations: FloatArray
    """((n+1)/2, 2) along a short one."""
    points: FloatArray
    """(m, 2) around an arc."""


class Scratch(NamedTuple):
    """Room for one evaluation."""

    cuts: FloatArray
    rows: FloatArray


def build_law(*, resistance: Resistance, target: Target, strength_factor: float, ramp_velocity: float) -> Law:
    """Resistance of `target` with the strength factor of one strike."""
    return Law(
        static_stress=strength_factor * target.compressive_strength,
        dynamic_density=resistance.inertia_factor * target.density,
        ramp_velocity=ramp_velocity,
        smooth_ramp=True,
        decay=build_decay(resistance.free_surface, target),
    )


def build_quadrature(*, stations: int, points: int) -> Quadrature:
    """Rules with so many stations a stretch and points an arc."""
    return Quadrature(gauss_rule(stations), gauss_rule((stations + 1) // 2), gauss_rule(points))


@compiled
def make_scratch() -> Scratch:
    """Empty room."""
    return Scratch(np.empty(MAX_CUTS), np.zeros(ROW_COUNT * CAPACITY))


@inlined
def loads(state: FloatArray, body: Body, law: Law, quadrature: Quadrature, scratch: Scratch) -> Load:
    """Force into depth, force along the face, and moment about the centre of gravity.

    Parameters
    ----------
    state
        (6,) depth and lateral position of the centre of gravity, axis angle, and their rates. [m, rad, s]

    Returns
    -------
    tuple of three floats
        All zero only when nothing is loaded. [N, N, N m]
    """
    c, s = math.cos(state[2]), math.sin(state[2])
    mirror = 1.0 if s >= 0.0 else -1.0
    depth, s, lateral_speed, spin = state[0], mirror * s, mirror * state[4], mirror * state[5]
    forward, sideways = state[3] * c + lateral_speed * s, lateral_speed * c - state[3] * s
    motion = (depth, c, s, forward, sideways, spin)
    outline, cuts, rows = body.outline, scratch.cuts, scratch.rows
    along = across = moment = 0.0
    rings = fulls = 0
    for index in range(outline.shape[0]):
        piece = outline[index]
        count = cut(cuts, piece, motion)
        for stretch in range(count):
            begin, end = cuts[stretch], cuts[stretch + 1]
            middle = ring_at(piece, 0.5 * (begin + end))  # tells whether the stretch is loaded
            if not is_loaded(middle, motion):
                continue
            short = end - begin < SHORT * (cuts[count] - cuts[0])
            stations = quadrature.few_stations if short else quadrature.stations
            if max(rings, fulls) + stations.shape[0] + 8 > ROOM:
                f, g, h = sum_rings(rows, rings, fulls, quadrature.points, law, motion)
                along, across, moment, rings, fulls = along + f, across + g, moment + h, 0, 0
            if law.decay.corner == 0.0 or is_full(piece, begin, end, middle, motion):
                _add_rings(rows, FULL + fulls, piece, begin, end, stations)
                fulls += stations.shape[0]
            else:
                _add_rings(rows, rings, piece, begin, end, stations)
                rings += stations.shape[0]
    if rings + fulls > 0:
        f, g, h = sum_rings(rows, rings, fulls, quadrature.points, law, motion)
        along, across, moment = along + f, across + g, moment + h
    return along * c - across * s, mirror * (along * s + across * c), mirror * moment


@lean
def _add_rings(rows: FloatArray, place: int, piece: FloatArray, begin: float, end: float, stations: FloatArray) -> None:
    """Lay out the rings at the stations of a stretch."""
    span, sine, cosine = end - begin, piece[4], piece[5]
    if piece[0] == ARC:
        for i in range(stations.shape[0]):
            alpha, weight = begin + span * stations[i, 0], span * stations[i, 1]
            add_ring(rows, place + i, alpha, piece[1], piece[2], piece[3], piece[3] * weight)
    else:
        for i in range(stations.shape[0]):
            way, weight = begin + span * stations[i, 0], span * stations[i, 1]
            add_ring(rows, place + i, piece[6], piece[1] - way * cosine, piece[2] + way * sine, 0.0, weight)


@lean
def panel_loads(state: FloatArray, panels: Panels, law: Law) -> Load:
    """The same sum over the panels of the paper, whose stress is not ramped."""
    depth, angle, spin = state[0], state[2], state[5]
    c, s = math.cos(angle), math.sin(angle)
    forward, sideways = state[3] * c + state[4] * s, state[4] * c - state[3] * s
    along = across = moment = 0.0
    for i in range(panels.area.size):
        axial, lateral = panels.axial[i], panels.lateral[i]
        inside = depth + axial * c - lateral * s
        if inside <= 0.0:
            continue
        n_axial, n_lateral = panels.normal_axial[i], panels.normal_lateral[i]
        speed = (forward - spin * lateral) * n_axial + (sideways + spin * axial) * n_lateral
        if speed <= 0.0:
            continue
        outward = panels.wall[i] * (n_lateral * s - n_axial * c)
        factor = decay_at(inside, outward, speed, law.decay)
        force = factor * (law.static_stress + law.dynamic_density * speed * speed) * panels.area[i]
        along -= force * n_axial
        across -= force * n_lateral
        moment += force * (lateral * n_axial - axial * n_lateral)
    return along * c - across * s, along * s + across * c, moment
