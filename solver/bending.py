"""Bending stress of a projectile during a run, by D'Alembert: the loads of the model against the inertia of the body.

The body is taken for a beam along its axis and cut across into slices. The part of it ahead of a cross-section moves
with the whole; what the loads on that part lack to move it so, the cross-section carries: a bending moment, and a
normal force along the axis. The motion stays that of a rigid body. The stress says whether a real body could follow it.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from solver.arrays import ComparedByFields, FloatArray, IntArray, gauss_rule
from solver.compilation import compiled, lean
from solver.loads import MOST_STATES, Scratch, build_quadrature, make_scratch, weaken_in_crater
from solver.motion import Model, accelerate
from solver.projectile import Arc, MassProperties, Projectile, mass_properties
from solver.surface import LINE, Body, Panels, build_body

SLICES = 16
"""Slices of a body. Between two cross-sections the peak is that of a parabola: for the paper's body within 0.5 % of the
peak with 200 slices. [1]"""
INSTANTS = 20
"""Instants at which the stress is computed first, at most. [1]"""
INSTANTS_NEAR_PEAK = 10
"""Instants between the neighbours of the largest of these, at most: the peak of the paper's strikes is within 0.5 % of
that over all steps of the integration, and both take a tenth of the time of a run. [1]"""
STATIONS = 4
"""Gauss points along what one slice has of a stretch of the outline."""
GAUSS_POINTS = 8
"""Points for the inertia of a slice: exact for lines, to 1e-10 for arcs."""
ENERGY_LEFT = 0.05
"""Share of the initial kinetic energy at which the stress is no longer followed. Near rest the resistance is nearly all
static and follows the direction of creeping speeds, so that stresses of independent programs differ there. [1]"""
FREE = 1e-6
"""Acceleration over the greatest so far, below which the projectile has come free. What strikes the target after that,
mostly the tail, meets concrete that the nose has broken, which the model takes for intact. [1]"""
CENTER_WITHIN, INERTIA_WITHIN = 0.005, 0.02
"""Difference of a given centre of gravity from that of the shape, over the length, and of a moment of inertia over that
of the shape, up to which the shape stands for the body: values of a drawing, rounded to two or three digits. [1]"""


@dataclass(frozen=True, slots=True, eq=False)
class BendingHistory(ComparedByFields):
    """Largest bending stress in the body over time, at the instants at which it was computed."""

    time: FloatArray
    """Since first contact. [s]"""
    stress: FloatArray
    """In the outermost fibre of the cross-section with the largest. [Pa]"""


@dataclass(frozen=True, slots=True)
class Bending:
    """Largest bending stress over a run, until the projectile first comes free or has lost 95 % of its energy.

    With panels the stress of a body that slides straight scatters upward, as its resistance changes sides from step to
    step. A flat body of the paper's size at 40° bends at 0.23 GPa by the adaptive route, with panels at 0.9, and at 0.4
    in steps of 1 µs.
    """

    peak_stress: float
    """Largest bending stress, the moment over the section modulus in the outermost fibre. [Pa]"""
    time: float
    """Time of the largest bending stress, since first contact. [s]"""
    distance_behind_tip: float
    """Distance behind the tip of the cross-section with the largest bending stress. [m]"""
    normal_force: float
    """Force along the axis in that cross-section at that time, positive for tension; its stress is not in the largest
    bending stress. [N]"""
    history: BendingHistory | None
    """None if the run has no history."""

    def __str__(self) -> str:
        place, time = 1e3 * self.distance_behind_tip, 1e3 * self.time
        return f"{self.peak_stress / 1e6:.4g} MPa, {place:.0f} mm behind the tip, after {time:.2f} ms"


class _Beam(NamedTuple):
    """A body cut into slices of equal length, from the tip to the base."""

    outline: FloatArray
    """(m, 8) rows of `Body.outline` of the slices, one slice after the other."""
    ends: IntArray
    """(n + 1,) where the rows of each slice begin, and the end."""
    places: FloatArray
    """(n - 1,) cross-sections between the slices, ahead of the centre of gravity. [m]"""
    moments: FloatArray
    """(3, n) mass, first and second moment about the centre of gravity of all up to the end of each slice, the second
    about the transverse axis. [kg, kg m, kg m²]"""
    moduli: FloatArray
    """(n - 1,) section moduli. [m³]"""


def has_inertia_of_shape(projectile: Projectile) -> bool:
    """Whether the mass properties in use are those of the homogeneous solid of the shape, which a beam needs."""
    if projectile.center_of_gravity is None and projectile.moment_of_inertia is None:
        return True
    used, shape = mass_properties(projectile), _shape_properties(projectile)
    center = abs(used.center_of_gravity - shape.center_of_gravity)
    inertia = abs(used.moment_of_inertia - shape.moment_of_inertia)
    return center <= CENTER_WITHIN * projectile.length and inertia <= INERTIA_WITHIN * shape.moment_of_inertia


def _shape_properties(projectile: Projectile) -> MassProperties:
    return mass_properties(replace(projectile, center_of_gravity=None, moment_of_inertia=None))


def bending_of(
    projectile: Projectile,
    model: Model,
    steps: FloatArray,
    *,
    with_history: bool,
    slices: int = SLICES,
    instants: int = INSTANTS,
) -> Bending | None:
    """Bending stress over a run.

    Parameters
    ----------
    model
        With the law of the strike.
    steps
        Table of the steps of the run.
    with_history
        Whether to keep the stress over time.
    slices, instants
        Resolution along the axis, and in time.

    Returns
    -------
    Bending | None
        None if the body does not have the inertia of its shape, or nothing was integrated.
    """
    if len(steps) == 0 or not has_inertia_of_shape(projectile):
        return None
    beam, change = _beam(projectile, slices), _speed_change(steps, model.body)
    rows = np.unique(np.searchsorted(change, np.linspace(0.0, change[-1], instants)))
    stress, force = _stress(steps[rows], beam, model)
    peak = int(stress.max(axis=1).argmax())
    before, after = rows[max(peak - 1, 0)], rows[min(peak + 1, rows.size - 1)]
    apart = max(1, math.ceil((after - before) / (INSTANTS_NEAR_PEAK + 1)))
    near = np.arange(before + 1, after, apart)
    near = near[near != rows[peak]]
    if near.size:
        more_stress, more_force = _stress(steps[near], beam, model)
        rows = np.concatenate((rows, near))
        order = rows.argsort()
        rows = rows[order]
        stress, force = (np.concatenate(parts)[order] for parts in ((stress, more_stress), (force, more_force)))
    times, over_time = steps[rows, 0], stress.max(axis=1)
    when = int(over_time.argmax())
    where = int(stress[when].argmax())
    shift, greatest = _vertex(stress[when], where)
    distance = projectile.length * (where + 1 + shift) / slices
    history = BendingHistory(times, over_time) if with_history else None
    return Bending(greatest, float(times[when]), distance, float(force[when, where]), history)


def _stress(steps: FloatArray, beam: _Beam, model: Model) -> tuple[FloatArray, FloatArray]:
    """(steps, sections) bending stresses and normal forces at the beginning of steps. [Pa, N]"""
    moment, force = _section_loads(steps[:, 2:8], beam, _slice_loads(steps, beam, model))
    return np.abs(moment) / beam.moduli, force


def _vertex(values: FloatArray, place: int) -> tuple[float, float]:
    """Place of the vertex of the parabola through the largest of some values and its neighbours, and the value there.

    The place is from that of the largest, in intervals.
    """
    if not 0 < place < values.size - 1:
        return 0.0, float(values[place])
    before, at, after = values[place - 1 : place + 2].tolist()
    bend = before - 2.0 * at + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return shift, at - 0.25 * (before - after) * shift


def _speed_change(steps: FloatArray, body: Body) -> FloatArray:
    """Sum of the changes of velocity up to the beginning of each step, for the steps at which the stress is followed.

    Instants that are even on it lie close where the loads are large. The stress is computed at the ends of steps only:
    states inside are interpolated, and their loads scatter where the body slides straight.
    """
    velocity, spin = steps[:, 5:7], steps[:, 7]
    energy = body.mass * (velocity**2).sum(axis=1) + body.moment_of_inertia * spin**2
    change = np.hypot(*np.diff(velocity, axis=0).T)
    rate = change / steps[:-1, 1]
    ended = energy <= ENERGY_LEFT * energy[0]
    ended[:-1] |= rate <= FREE * np.maximum.accumulate(rate)
    count = int(ended.argmax()) + 1 if ended.any() else len(steps)
    return np.concatenate(([0.0], np.cumsum(change[: count - 1])))


@lru_cache  # as for `mass_properties`
def _beam(projectile: Projectile, slices: int) -> _Beam:
    """Cut a projectile into slices."""
    used = mass_properties(projectile)
    body, length, center = build_body(projectile, used), projectile.length, used.center_of_gravity
    edges = center - length * np.arange(slices + 1) / slices
    parts = _cut_outline(body, edges)
    # A body whose base faces out is evaluated without its last row: the base, or a row without length in its place.
    base = body.outline[-1]
    nothing = base.copy()
    nothing[3] = 0.0
    rows = [row for part in parts[:-1] for row in (*part, nothing)] + [*parts[-1], base]
    ends = np.concatenate(([0], np.cumsum([len(part) + 1 for part in parts])))
    moments = np.cumsum([_inertia(projectile, center, *pair) for pair in pairwise(edges)], axis=0).T
    radius = _radii(projectile, center - edges[1:-1])
    bore = np.where(_is_hollow(projectile, center - edges[1:-1]), (projectile.inner_diameter or 0.0) / 2.0, 0.0)
    moduli = math.pi / 4.0 * (radius**4 - bore**4) / radius
    return _Beam(np.array(rows), ends, edges[1:-1], moments * (projectile.mass / moments[0, -1]), moduli)


def _is_hollow(projectile: Projectile, x: FloatArray) -> FloatArray:
    """Whether there may be a bore at these distances behind the tip."""
    return np.asarray((projectile.nose_length < x) & (x < projectile.shank_end))


def _cut_outline(body: Body, edges: FloatArray) -> list[list[FloatArray]]:
    """Rows of the outline of each slice, without the base."""
    parts: list[list[FloatArray]] = [[] for _ in range(edges.size - 1)]
    for piece in body.outline[:-1]:
        if piece[0] == LINE:
            begin, end = 0.0, piece[3]
            places = (piece[1] - edges) / piece[5] if piece[5] != 0.0 else edges[:0]
        else:
            begin, end = piece[4:6]
            sines = (edges - piece[1]) / piece[3]
            places = np.arcsin(sines[np.abs(sines) < 1.0])
        inside = np.sort(places[(begin < places) & (places < end)]).tolist()
        for first, last in pairwise((float(begin), *inside, float(end))):
            row, middle = piece.copy(), 0.5 * (first + last)
            if piece[0] == LINE:
                axial = piece[1] - middle * piece[5]
                row[1:4] = piece[1] - first * piece[5], piece[2] + first * piece[4], last - first
            else:
                axial = piece[1] + piece[3] * math.sin(middle)
                row[4:6] = first, last
            share = (edges[0] - axial) / (edges[0] - edges[-1])
            parts[min(int(share * len(parts)), len(parts) - 1)].append(row)
    return parts


def _radii(projectile: Projectile, x: FloatArray) -> FloatArray:
    """Outer radius at distances behind the tip."""
    radius = np.zeros_like(x)
    for piece in projectile.outline():
        if isinstance(piece, Arc):
            start = piece.x_center - piece.radius * math.sin(piece.angle_start)
            end = piece.x_center - piece.radius * math.sin(piece.angle_end)
            here = (start <= x) & (x <= end)
            radius[here] = piece.r_center + np.sqrt(piece.radius**2 - (x[here] - piece.x_center) ** 2)
        elif piece.x_end > piece.x_start:
            here = (piece.x_start <= x) & (x <= piece.x_end)
            share = (x[here] - piece.x_start) / (piece.x_end - piece.x_start)
            radius[here] = piece.r_start + share * (piece.r_end - piece.r_start)
    return radius


def _inertia(projectile: Projectile, center: float, front: float, rear: float) -> tuple[float, float, float]:
    """Volume of a slice, and its first and second moment about the centre of gravity. [m³, m⁴, m⁵]"""
    begin, end = center - front, center - rear
    kinks = [piece.x_end if not isinstance(piece, Arc) else piece.x_center for piece in projectile.outline()]
    t, w = gauss_rule(GAUSS_POINTS).T
    total = np.zeros(3)
    for first, last in pairwise(sorted({begin, end, *(kink for kink in kinks if begin < kink < end)})):
        x = first + (last - first) * t
        squared = _radii(projectile, x) ** 2
        bore = np.where(_is_hollow(projectile, x), ((projectile.inner_diameter or 0.0) / 2.0) ** 2, 0.0)
        weight, p = math.pi * (squared - bore) * w * (last - first), center - x
        total += weight.sum(), weight @ p, weight @ (p * p + (squared + bore) / 4.0)
    return float(total[0]), float(total[1]), float(total[2])


def _slice_loads(steps: FloatArray, beam: _Beam, model: Model) -> FloatArray:
    """(steps, slices, 3) forces on slices along depth and face, and moments about the centre of gravity. [N, N m]"""
    loads = np.zeros((len(steps), beam.ends.size - 1, 3))
    edges = np.concatenate(([math.inf], beam.places, [-math.inf]))
    first_panels = np.searchsorted(-model.panels.axial, -edges, side="right")
    quadrature = build_quadrature(stations=STATIONS, points=model.quadrature.points.shape[0])
    part = model._replace(law=model.law._replace(crater_depth=0.0), quadrature=quadrature)
    slices = _Slices(beam.outline, beam.ends, first_panels, model.law.crater_depth)
    states = np.ascontiguousarray(steps[:, 2:8])
    if model.panels.area.size > 0:
        _fill_mean_loads(states, steps[:, 1].copy(), part, slices, make_scratch(), loads)
    else:
        _fill_loads(states, part, slices, make_scratch(), loads)
    return loads


class _Slices(NamedTuple):
    """Slices of a body for the compiled code."""

    outline: FloatArray
    """As in `_Beam`."""
    ends: IntArray
    first_panels: IntArray
    """(n + 1,) first panel of each slice, and the number of panels."""
    crater_depth: float
    """Depth at which the law is evaluated: that of the deepest point of the whole body. [m]"""


@lean
def _add_loads(
    states: FloatArray,
    weight: float,
    model: Model,
    slices: _Slices,
    scratch: Scratch,
    accelerations: FloatArray,
    loads: FloatArray,
) -> None:
    """Add the loads on the slices in some states, with a weight; write the accelerations by one slice after the other.

    Parameters
    ----------
    states
        (6 n,) one after the other.
    accelerations
        (3 n,) to work in.
    loads
        (n, slices, 3) to add to.
    """
    body, panels, ends = model.body, model.panels, slices.ends
    for k in range(ends.size - 1):
        first, last = slices.first_panels[k], slices.first_panels[k + 1]
        if panels.area.size > 0 and first == last:
            continue
        part = Body(
            slices.outline[ends[k] : ends[k + 1]],
            body.corners,
            body.tip,
            body.mass,
            body.moment_of_inertia,
            body.bounds,
        )
        strip = Panels(
            panels.axial[first:last],
            panels.lateral[first:last],
            panels.normal_axial[first:last],
            panels.normal_lateral[first:last],
            panels.cavity[first:last],
            panels.area[first:last],
            panels.radius,
        )
        accelerate(states, Model(part, model.law, model.quadrature, strip), scratch, accelerations)
        if slices.crater_depth > 0.0:
            weaken_in_crater(states, body, slices.crater_depth, accelerations)
        for n in range(loads.shape[0]):
            loads[n, k, 0] += weight * accelerations[3 * n] * body.mass
            loads[n, k, 1] += weight * accelerations[3 * n + 1] * body.mass
            loads[n, k, 2] += weight * accelerations[3 * n + 2] * body.moment_of_inertia


@compiled
def _fill_loads(states: FloatArray, model: Model, slices: _Slices, scratch: Scratch, loads: FloatArray) -> None:
    """Write the loads on the slices in each state."""
    flat, accelerations = states.ravel(), np.zeros(3 * MOST_STATES)
    for begin in range(0, states.shape[0], MOST_STATES):
        end = min(begin + MOST_STATES, states.shape[0])
        some, out = flat[6 * begin : 6 * end], accelerations[: 3 * (end - begin)]
        _add_loads(some, 1.0, model, slices, scratch, out, loads[begin:end])


@compiled
def _fill_mean_loads(
    states: FloatArray, lengths: FloatArray, model: Model, slices: _Slices, scratch: Scratch, loads: FloatArray
) -> None:
    """Write the mean loads on the slices over the steps that begin in each state.

    The stress of panels is not ramped: where the body slides straight, all the static load is now on one side of it,
    now on the other. What moves it, and bends it, is the mean over the stages of the Runge-Kutta step.
    """
    body, stage, accelerations = model.body, np.empty(6), np.zeros(3)
    total, before, rates = np.zeros(3), np.zeros(3), np.zeros(6)
    for i in range(states.shape[0]):
        rates[:] = 0.0
        before[:] = 0.0
        for k in range(4):
            share = lengths[i] * (0.0 if k == 0 else 1.0 if k == 3 else 0.5)
            for n in range(6):
                stage[n] = states[i, n] + share * rates[n]
            weight = 1.0 / 3.0 if 0 < k < 3 else 1.0 / 6.0
            _add_loads(stage, weight, model, slices, scratch, accelerations, loads[i : i + 1])
            for n in range(3):
                total[n] = 0.0
                for j in range(loads.shape[1]):
                    total[n] += loads[i, j, n]
                inertia = body.moment_of_inertia if n == 2 else body.mass
                rates[n], rates[n + 3] = stage[n + 3], (total[n] - before[n]) / (weight * inertia)
                before[n] = total[n]


def _section_loads(states: FloatArray, beam: _Beam, loads: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(states, sections) bending moments and normal forces in the cross-sections. [N m, N]"""
    mass, first, second = beam.moments
    cosine, sine, spin = np.cos(states[:, 2:3]), np.sin(states[:, 2:3]), states[:, 5:6]
    ahead = np.cumsum(loads, axis=1)
    along = ahead[:, :, 0] * cosine + ahead[:, :, 1] * sine
    across = ahead[:, :, 1] * cosine - ahead[:, :, 0] * sine
    turning = ahead[:, :, 2]
    # The acceleration of the whole, from balances of force and moment about a point that rounding of a given centre of
    # gravity may put beside that of the shape: so moment and shear vanish at the base exactly.
    size = mass[-1] * second[-1] - first[-1] ** 2
    sideways = ((across[:, -1] * second[-1] - turning[:, -1] * first[-1]) / size)[:, None]
    turn = ((turning[:, -1] * mass[-1] - across[:, -1] * first[-1]) / size)[:, None]
    forward = (along[:, -1:] + spin**2 * first[-1]) / mass[-1]
    mass, first, second, x = mass[:-1], first[:-1], second[:-1], beam.places
    moment = sideways * (first - x * mass) + turn * (second - x * first) - (turning[:, :-1] - x * across[:, :-1])
    force = along[:, :-1] - forward * mass + spin**2 * first
    return moment, force
