"""Force and moment on the projectile at one instant (eqs. 1-5), compiled.

The route of the paper sums over panels. Ours integrates: on the ring of the surface at one station, depth, normal
velocity and the tilt of the normal are all linear in c = cos β, so its loaded arc is known in closed form. Meridians
are cut where the face, or the line on which elements start to separate, crosses them, and arcs where the decay
function has a corner; each piece then holds a smooth integrand and a few Gauss-Legendre points do.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled
from solver.free_surface import FreeSurface, NoFreeSurface
from solver.quadrature import gauss_rule
from solver.resistance import Resistance
from solver.surface import ARC, Body, Panels
from solver.target import Target

CELLS = 512
"""Cells of the decay table in 0 ≤ y ≤ 1; the cubics in them follow f to 1e-8, but for the cell with its corner: there
to 3e-6, or to 3e-4 with Mohr-Coulomb, whose slope jumps."""

MAX_CUTS = 8
"""Ends of the stretches of one outline piece: two ends and at most six crossings."""

TINY = 1e-300

Load: TypeAlias = tuple[float, float, float]


class Law(NamedTuple):
    """Resistance of the target for the compiled code."""

    static_stress: float
    """S f'c. [Pa]"""
    dynamic_density: float
    """B ρ. [kg/m³]"""
    inertia_scale: float
    """ρ / P(0), zero for a decay without inertia. [s²/m²]"""
    inertia_endless: float
    """Q(0). [1]"""
    corner: float
    """k at which the plastic zone first reaches the face, where f has a corner; 0 for none. [1]"""
    ramp_velocity: float
    """Normal velocity over which the static stress of a ring builds up. [m/s]

    S f'c acts in full for any v_n > 0, as dry friction does, so a shank at rest sideways in its hole would need forces
    that switch infinitely often. Below this velocity they go to zero smoothly instead, which lets the shank creep at a
    fraction of it."""


class Tables(NamedTuple):
    """Arrays for the compiled code.

    They travel apart from the scalars: taking an array out of a tuple costs a count of references, which in the inner
    loop took a third of the time.
    """

    decay: FloatArray
    """(CELLS, 8) coefficients of the cubics in each cell of y: four of P(y) / P(0), four of Q(y). [1]"""
    stations: FloatArray
    """(n, 2) Gauss-Legendre nodes and weights on [0, 1] for a stretch of the outline."""
    points: FloatArray
    """(m, 2) likewise for an arc."""


def build_tables(*, resistance: Resistance, target: Target, stations: int, points: int) -> Tables:
    """Decay of the target and quadrature with this many stations a stretch and points an arc."""
    model = resistance.free_surface
    static = float(model.static_pressure(np.zeros(1), target)[0])
    cubics = (
        _cubic_cells(lambda y: model.static_pressure(y, target) / static),
        _cubic_cells(lambda y: model.inertia_coefficient(y, target)),
    )
    return Tables(np.hstack(cubics), gauss_rule(stations), gauss_rule(points))


def build_law(*, resistance: Resistance, target: Target, strength_factor: float, ramp_velocity: float) -> Law:
    """Resistance of `target` with the strength factor of one strike."""
    model = resistance.free_surface
    static = float(model.static_pressure(np.zeros(1), target)[0])
    inertia = float(model.inertia_coefficient(np.zeros(1), target)[0])
    return Law(
        static_stress=strength_factor * target.compressive_strength,
        dynamic_density=resistance.inertia_factor * target.density,
        inertia_scale=target.density / static if inertia > 0.0 else 0.0,
        inertia_endless=inertia,
        corner=_corner(model, target),
        ramp_velocity=ramp_velocity,
    )


def _corner(model: FreeSurface, target: Target) -> float:
    return 0.0 if isinstance(model, NoFreeSurface) else model.plastic_ratio(target)


def _cubic_cells(function: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Cubic through four evenly spaced values in each cell."""
    inside = np.linspace(0.0, 1.0, 4)
    values = function((np.arange(CELLS)[:, None] + inside) / CELLS)
    return np.ascontiguousarray(np.linalg.solve(np.vander(inside, increasing=True), values.T).T)


@compiled
def decay(y: float, velocity_squared: float, law: Law, table: FloatArray) -> float:
    """f of eq. 2, from the inverse ratio y = 1/k of the distance to the face."""
    place = y * CELLS
    cell = min(int(place), CELLS - 1)
    t = place - cell
    factor = table[cell, 0] + t * (table[cell, 1] + t * (table[cell, 2] + t * table[cell, 3]))
    if law.inertia_scale > 0.0:
        inertia = table[cell, 4] + t * (table[cell, 5] + t * (table[cell, 6] + t * table[cell, 7]))
        pressure = law.inertia_scale * velocity_squared
        factor = (factor + pressure * inertia) / (1.0 + pressure * law.inertia_endless)
    return float(factor)


@compiled
def _insert(cuts: FloatArray, count: int, value: float, upper: float) -> int:
    """Put `value` in its place among the sorted `cuts`, if it lies inside; return how many there are."""
    if not cuts[0] < value < upper:
        return count
    place = count
    while cuts[place - 1] > value:
        cuts[place] = cuts[place - 1]
        place -= 1
    cuts[place] = value
    return count + 1


@compiled
def _keep_positive(value: float, slope: float, low: float, high: float) -> tuple[float, float]:
    """Part of a range of c in which ``value + slope c`` is above zero; empty if its ends are not in order."""
    if slope > 0.0:
        return max(low, -value / slope), high
    if slope < 0.0:
        return low, min(high, -value / slope)
    return low, high if value > 0.0 else low


@compiled
def ring_integrals(
    depth: float,
    depth_slope: float,
    velocity: float,
    velocity_slope: float,
    tilt: float,
    tilt_slope: float,
    radius: float,
    cosine: float,
    law: Law,
    table: FloatArray,
    points: FloatArray,
    bounds: FloatArray,
) -> tuple[float, float]:
    """Integrals over β of the stress on one ring, and of the stress times cos β. [Pa]

    Depth, normal velocity and depth component of the normal are each given as value and slope in c = cos β;
    `cosine` is that of α, and `bounds` is room to work in.
    """
    low, high = _keep_positive(depth, depth_slope, -1.0, 1.0)
    low, high = _keep_positive(velocity, velocity_slope, low, high)
    if low >= high:
        return 0.0, 0.0

    bounds[0] = low
    count = 1
    if law.corner > 0.0 and tilt_slope != 0.0:
        count = _insert(bounds, count, -tilt / tilt_slope, high)
        reach = radius * (law.corner - 1.0)
        slope = reach * tilt_slope + cosine * depth_slope
        if slope != 0.0:
            count = _insert(bounds, count, -(reach * tilt + cosine * depth) / slope, high)
    bounds[count] = high

    ramp = (velocity + abs(velocity_slope)) / law.ramp_velocity
    static = law.static_stress * ramp**2 / math.sqrt(1.0 + ramp**4)
    even = odd = 0.0
    end = math.acos(low)
    for piece in range(count):
        begin = math.acos(bounds[piece + 1])
        span = end - begin
        end = begin
        for j in range(points.shape[0]):
            c = math.cos(begin + span * points[j, 0])
            inward = cosine * (depth + depth_slope * c)
            outward = radius * max(0.0, -(tilt + tilt_slope * c))
            speed = velocity + velocity_slope * c
            factor = decay(outward / (outward + max(inward, TINY)), speed * speed, law, table)
            stress = span * points[j, 1] * factor * (static + law.dynamic_density * speed * speed)
            even += stress
            odd += stress * c
    return 2.0 * even, 2.0 * odd


@compiled
def _cut_arc(
    cuts: FloatArray, piece: FloatArray, depth: float, angle: float, forward: float, sideways: float, spin: float
) -> int:
    """Angles α on a circular piece where the face or the separation line crosses the top or bottom meridian."""
    axial, radius, size, upper = piece[1], piece[2], piece[3], piece[5]
    cuts[0] = piece[4]
    count = 1
    for side in (-1.0, 1.0):
        sine = (side * radius * math.sin(angle) - depth - axial * math.cos(angle)) / size
        if abs(sine) < 1.0:
            root = math.asin(sine)
            for crossing in (side * angle + root, side * angle + math.pi - root):
                count = _insert(cuts, count, (crossing + math.pi) % (2.0 * math.pi) - math.pi, upper)
        separation = math.atan2(-side * (sideways + spin * axial), forward - side * spin * radius)
        count = _insert(cuts, count, separation % math.pi, upper)
    cuts[count] = upper
    return count


@compiled
def _cut_line(
    cuts: FloatArray, piece: FloatArray, depth: float, angle: float, forward: float, sideways: float, spin: float
) -> int:
    """Distances along a straight piece where the face or the separation line crosses the top or bottom meridian."""
    axial, radius, length, sine, cosine = piece[1], piece[2], piece[3], piece[4], piece[5]
    cuts[0] = 0.0
    count = 1
    across = (sideways + spin * axial) * cosine - spin * radius * sine
    for side in (-1.0, 1.0):
        slope = cosine * math.cos(angle) + side * sine * math.sin(angle)
        if slope != 0.0:
            start = depth + axial * math.cos(angle) - side * radius * math.sin(angle)
            count = _insert(cuts, count, start / slope, length)
        if spin != 0.0:
            count = _insert(cuts, count, (side * forward * sine + across) / spin, length)
    cuts[count] = length
    return count


@compiled
def loads(state: FloatArray, body: Body, law: Law, tables: Tables) -> Load:
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
    depth, angle, spin = state[0], state[2], state[5]
    c, s = math.cos(angle), math.sin(angle)
    forward, sideways = state[3] * c + state[4] * s, state[4] * c - state[3] * s
    along = across = moment = 0.0
    cuts, bounds = np.empty(MAX_CUTS), np.empty(4)
    outline, table, stations, points = body.outline, tables.decay, tables.stations, tables.points
    for index in range(outline.shape[0]):
        piece = outline[index]
        curved = piece[0] == ARC
        if curved:
            count = _cut_arc(cuts, piece, depth, angle, forward, sideways, spin)
        else:
            count = _cut_line(cuts, piece, depth, angle, forward, sideways, spin)
        for stretch in range(count):
            begin, span = cuts[stretch], cuts[stretch + 1] - cuts[stretch]
            for i in range(-1, stations.shape[0]):  # first the middle, which tells whether the stretch is loaded
                place = begin + span * (0.5 if i < 0 else stations[i, 0])
                if curved:
                    sine, cosine = math.sin(place), math.cos(place)
                    axial, radius, scale = piece[1] + piece[3] * sine, piece[2] + piece[3] * cosine, piece[3]
                else:
                    sine, cosine = piece[4], piece[5]
                    axial, radius, scale = piece[1] - place * cosine, piece[2] + place * sine, 1.0
                d, d_slope = depth + axial * c, -radius * s
                v, v_slope = forward * sine, (sideways + spin * axial) * cosine - spin * radius * sine
                if i < 0:
                    if d + abs(d_slope) <= 0.0 or v + abs(v_slope) <= 0.0:
                        break
                    continue
                even, odd = ring_integrals(
                    d, d_slope, v, v_slope, sine * c, -cosine * s, radius, cosine, law, table, points, bounds
                )
                weight = stations[i, 1] * span * scale * radius
                along -= weight * sine * even
                across -= weight * cosine * odd
                moment += weight * (radius * sine - axial * cosine) * odd
    return along * c - across * s, along * s + across * c, moment


@compiled
def panel_loads(state: FloatArray, panels: Panels, law: Law, table: FloatArray) -> Load:
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
        outward = panels.wall[i] * max(0.0, n_lateral * s - n_axial * c)
        factor = decay(outward / (outward + inside), speed * speed, law, table)
        force = factor * (law.static_stress + law.dynamic_density * speed * speed) * panels.area[i]
        along -= force * n_axial
        across -= force * n_lateral
        moment += force * (lateral * n_axial - axial * n_lateral)
    return along * c - across * s, along * s + across * c, moment
