"""Motion under resistance (eq. 6): the right-hand side, steps and states inside them, and what ends a run, compiled.

The state is depth and lateral position of the centre of gravity, axis angle, and their three rates. [m, rad, s]
A step is stored as a row: its start time and length, then four rows of six that give the state inside it, for a
fraction x of the step, as ``(1-x) start + x (end + (1-x) (bend + x twist))``. The instants of events are roots on this
interpolation.
"""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled, lean, once
from solver.loads import (
    MOST_STATES,
    Quadrature,
    Scratch,
    accelerate_by_gauss,
    accelerate_in_wall,
    make_scratch,
    panel_loads,
    weaken_in_crater,
)
from solver.surface import CENTRED, Body, Panels, deepest_offset, deepest_point
from solver.surface_integration import Law

RAMP_FRACTION = 1e-4
"""Ramp velocity of the static stress over the impact velocity."""
NEGLIGIBLE_LOAD = 1e-6
"""Load below which nothing counts as loaded, over the static stress on the square of the distance to the tip: the ramp
lets a contact that ends die away instead of stopping at an instant."""
STEP_WIDTH = 26
MOST_STAGES = 5
REST_FRACTION = 1e-4
"""Kinetic energy at rest, over its initial value."""
HALVINGS = 24
"""Bisections of a step, to find the instant of an event: to 1e-7 of the step."""
MOST_TURN = 2.0 * math.pi
"""How far the axis turns at most in a target: one that turns on end over end meets concrete that it has broken before,
which the model takes for intact, so that its motion says nothing any more. [rad]"""
RELEASE_HALVINGS = 12
"""Bisections for a release, where each takes an evaluation and hardly any load is left."""


class Model(NamedTuple):
    """All that the right-hand side needs. Panels are used if there are any, else Gauss points."""

    body: Body
    law: Law
    quadrature: Quadrature
    panels: Panels


class Workspace(NamedTuple):
    """Arrays to try a step in."""

    start: FloatArray
    """(3,) accelerations at its start,"""
    end: FloatArray
    """at its end,"""
    stage: FloatArray
    """and at a stage."""
    trial: FloatArray
    """(6,) the state it leads to,"""
    point: FloatArray
    """and one in between."""
    points: FloatArray
    """(6 `MOST_STATES`,) states near its start, one after the other,"""
    slopes: FloatArray
    """(3 `MOST_STATES`,) and the accelerations there."""
    stages: FloatArray
    """(`MOST_STAGES`, 6) increments or rates of the stages."""
    scale: FloatArray
    """(6,) size of the six numbers of a state, over which errors count."""
    event: FloatArray
    """(7,) time and state of an event, see `end_of_step`."""
    scratch: Scratch


@compiled
def start_state(
    body: Body, velocity: float, oblique_angle: float, angle_of_attack: float, angular_velocity: float, out: FloatArray
) -> None:
    """Write the state at first contact, when the deepest point of the surface touches the face."""
    axis_angle = oblique_angle + angle_of_attack
    out[0], out[1], out[2] = -deepest_offset(body, axis_angle), 0.0, axis_angle
    out[3], out[4] = velocity * math.cos(oblique_angle), velocity * math.sin(oblique_angle)
    out[5] = angular_velocity


@lean
def assign(values: FloatArray, out: FloatArray) -> None:
    """Copy values. An assignment to a slice would compile the formatting of an error of shapes into its function."""
    for n in range(out.size):
        out[n] = values[n]


def make_workspace() -> Workspace:
    """Return arrays to work in."""
    start, end, stage = np.zeros(3), np.zeros(3), np.zeros(3)
    trial, point = np.zeros(6), np.zeros(6)
    points, slopes = np.zeros(6 * MOST_STATES), np.zeros(3 * MOST_STATES)
    stages, scale, event = np.zeros((MOST_STAGES, 6)), np.zeros(6), np.zeros(7)
    return Workspace(start, end, stage, trial, point, points, slopes, stages, scale, event, make_scratch())


@lean
def accelerate(states: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> bool:
    """Write the three accelerations of eq. 6 for each of the states; return whether anything is loaded in the last.

    Both are flat, one state after the other. With panels there is only one.
    """
    body, last = model.body, out.size - 3
    if model.panels.area.size > 0:
        f, g, h = panel_loads(states, model.panels, model.law)
        out[0], out[1], out[2] = f / body.mass, g / body.mass, h / body.moment_of_inertia
    elif model.law.thickness < math.inf:
        accelerate_in_wall(states, body, model.law, model.quadrature, scratch, out)
    else:
        accelerate_by_gauss(states, body, model.law, model.quadrature, scratch, out)
    if model.law.crater_depth > 0.0:
        weaken_in_crater(states, body, model.law.crater_depth, out)
    size = body.mass * (abs(out[last]) + abs(out[last + 1])) + body.moment_of_inertia * abs(out[last + 2]) / body.tip
    return bool(size > NEGLIGIBLE_LOAD * model.law.static_stress * body.tip**2)


@once
def load(state: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> None:
    """Write force and moment in one state."""
    accelerate(state, model, scratch, out)
    out[0] *= model.body.mass
    out[1] *= model.body.mass
    out[2] *= model.body.moment_of_inertia


@lean
def kinetic_energy(state: FloatArray, body: Body) -> float:
    """Energy of translation and rotation. [J]"""
    translation = body.mass * (state[3] ** 2 + state[4] ** 2)
    return 0.5 * float(translation + body.moment_of_inertia * state[5] ** 2)


@lean
def lasting_energy(start: FloatArray, body: Body) -> float:
    """Part of the initial kinetic energy that no load can remove: that of the spin of a sphere. [J]

    Shares of the energy are of the rest. A sphere at rest in the target still spins there, as nothing rubs it.
    """
    return 0.5 * body.moment_of_inertia * float(start[5] ** 2) if body.bounds & CENTRED > 0 else 0.0


@lean
def store_step(row: FloatArray, time: float, step: float, state: FloatArray, work: Workspace) -> None:
    """Cubic Hermite interpolation through the rates at both ends of a step."""
    row[0], row[1] = time, step
    for n in range(6):
        change = work.trial[n] - state[n]
        leaving = step * (state[n + 3] if n < 3 else work.start[n - 3])
        arriving = step * (work.trial[n + 3] if n < 3 else work.end[n - 3])
        row[2 + n], row[8 + n] = state[n], work.trial[n]
        row[14 + n] = leaving - change
        row[20 + n] = 2.0 * change - leaving - arriving


@lean
def interpolate(step: FloatArray, fraction: float, out: FloatArray) -> None:
    """State inside a step."""
    rest = 1.0 - fraction
    for n in range(6):
        inner = step[14 + n] + fraction * step[20 + n]
        out[n] = rest * step[2 + n] + fraction * (step[8 + n] + rest * inner)


def sample(steps: FloatArray, times: FloatArray) -> FloatArray:
    """States at sorted `times` from a table of steps."""
    states = np.empty((times.size, 6))
    _fill_states(steps, times, states)
    return states


@compiled
def _fill_states(steps: FloatArray, times: FloatArray, states: FloatArray) -> None:
    row = 0
    for i in range(times.size):
        while row < steps.shape[0] - 1 and times[i] > steps[row, 0] + steps[row, 1]:
            row += 1
        fraction = min(1.0, (times[i] - steps[row, 0]) / steps[row, 1])
        interpolate(steps[row], fraction, states[i])


def sample_accelerations(steps: FloatArray, times: FloatArray) -> FloatArray:
    """(n, 3) rates of the velocities that `sample` gives at these times.

    Where the body slides straight, its speed across the axis is some mm/s and decides the load, and the interpolated
    speed misses it by more: loads of interpolated states then scatter by the greatest load there is. The slope of the
    interpolation is exact at both ends of a step and smooth between them.
    """
    rows = np.minimum(np.searchsorted(steps[:, 0] + steps[:, 1], times), steps.shape[0] - 1)
    step = steps[rows]
    fraction = np.minimum(1.0, (times - step[:, 0]) / step[:, 1])[:, None]
    before, after, inner, change = step[:, 5:8], step[:, 11:14], step[:, 17:20], step[:, 23:26]
    bend = (1.0 - 2.0 * fraction) * (inner + fraction * change) + fraction * (1.0 - fraction) * change
    rates: FloatArray = (after - before + bend) / step[:, 1:2]
    return rates


def sample_loads(states: FloatArray, model: Model) -> FloatArray:
    """(n, 3) forces and moments at the given states."""
    values = np.empty((states.shape[0], 3))
    _fill_loads(states, model, make_scratch(), values)
    return values


@compiled
def _fill_loads(states: FloatArray, model: Model, scratch: Scratch, values: FloatArray) -> None:
    for i in range(states.shape[0]):
        load(states[i], model, scratch, values[i])


class Termination(IntEnum):
    """Why an integration stopped."""

    TIME = 0
    REST = 1
    RETAINED = 2
    """With less than the retention energy: no longer loaded and not moving in, beyond the rear face, or at the
    termination time."""
    EXIT = 3
    STEP_LIMIT = 4
    NOT_FINITE = 5
    """Diverged: not finite, or with far more energy than at first contact."""
    NO_STRENGTH = 6
    """Never begun: the strength factor is not above zero."""
    NONE = 7
    PERFORATED = 8
    """Beyond the rear face, moving on."""
    TUMBLED = 9
    """Loaded after the axis has turned by more than `MOST_TURN` since first contact."""
    CANCELLED = 10
    """Given up on the way, see `solver.cancellation`."""


class Thresholds(NamedTuple):
    """Shares of the initial kinetic energy, without that of a spin that nothing can remove."""

    retention: float
    """A projectile that falls below it is retained, wherever its nose is."""
    rest: float
    """A run ends where it falls to this."""


class Run(NamedTuple):
    """Result of an integration."""

    end: int
    """A value of `Termination`."""
    time: float
    """Time of the event that ended the run. [s]"""
    state: FloatArray
    """(6,) at that time."""
    maximum_depth: float
    """Greatest depth of the deepest point of the body. [m]"""
    steps: int
    """Rows of the step table that are filled."""
    evaluations: int
    """Evaluations of force and moment."""
    energy_gain: float
    """Largest gain of kinetic energy over one step, relative to the initial energy; a true motion has none."""


RunValues = tuple[int, float, float, int, int, float]
"""The values of a `Run` but the state, which an integrator writes to an array.

What compiled code returns to Python is a number or a plain tuple of numbers. For arrays, named tuples and members of an
enumeration numba runs Python code, and goes on as if that could not fail: should a signal handler raise in there, the
process would crash."""


@lean
def tip_depth(state: FloatArray, body: Body) -> float:
    """Depth of the nose tip. [m]"""
    return float(state[0] + body.tip * math.cos(state[2]))


@lean
def _deepest(state: FloatArray, body: Body) -> tuple[float, float]:
    """Depth of the deepest point of the body, and the speed at which it grows. [m, m/s]"""
    offset, growth = deepest_point(body, state[2])
    return state[0] + offset, state[3] + state[5] * growth


@lean
def greatest_depth(step: FloatArray, until: float, body: Body, state: FloatArray) -> float:
    """Greatest depth of the deepest point of the body behind the start of a step, up to a time.

    `state` is overwritten.
    """
    low, high = 0.0, min(1.0, (until - step[0]) / step[1])
    interpolate(step, high, state)
    greatest, speed = _deepest(state, body)
    if speed < 0.0 < _deepest(step[2:8], body)[1]:
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            interpolate(step, middle, state)
            if _deepest(state, body)[1] > 0.0:
                low = middle
            else:
                high = middle
        greatest = max(greatest, _deepest(state, body)[0])
    return greatest


@once
def _rest_fraction(step: FloatArray, body: Body, threshold: float, state: FloatArray) -> float:
    """Fraction of the step at which the kinetic energy falls to `threshold`."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        interpolate(step, middle, state)
        if kinetic_energy(state, body) > threshold:
            low = middle
        else:
            high = middle
    return high


@once
def _release_fraction(step: FloatArray, model: Model, work: Workspace, state: FloatArray) -> float:
    """Fraction of the step at which the last element is unloaded."""
    low, high = 0.0, 1.0
    for _ in range(RELEASE_HALVINGS):
        middle = 0.5 * (low + high)
        interpolate(step, middle, state)
        if accelerate(state, model, work.scratch, work.stage):
            low = middle
        else:
            high = middle
    return high


@lean
def _is_clear(state: FloatArray, body: Body) -> bool:
    """Whether the body will not touch the face again.

    It moves out, and either it is too far out to touch the face however it turns, or all of it is outside and no point
    of it can turn inwards as fast as the body leaves.
    """
    reach = 0.0
    for i in range(body.corners.shape[0]):
        reach = max(reach, math.hypot(body.corners[i, 0], body.corners[i, 1]))
    leaving = -state[3]
    if leaving > reach * abs(state[5]):
        return bool(state[0] + deepest_offset(body, state[2]) < 0.0)
    return bool(leaving > 0.0 and state[0] < -reach)


@lean
def _is_through(state: FloatArray, body: Body, thickness: float) -> bool:
    """Whether the body has left through the rear face and will not touch it again; see `_is_clear`."""
    if state[0] <= thickness:
        return False
    reach = 0.0
    for i in range(body.corners.shape[0]):
        reach = max(reach, math.hypot(body.corners[i, 0], body.corners[i, 1]))
    if state[3] > reach * abs(state[5]):
        return bool(state[0] - deepest_offset(body, state[2] + math.pi) > thickness)
    return bool(state[3] > 0.0 and state[0] - thickness > reach)


@once
def end_of_step(
    step: FloatArray,
    model: Model,
    work: Workspace,
    was_loaded: bool,
    loaded: bool,
    thresholds: Thresholds,
    begin_angle: float,
    last: bool,
    event: FloatArray,
) -> Termination:
    """Whether the run ends with this step, and how.

    Parameters
    ----------
    step
        The step, as stored.
    was_loaded, loaded
        Whether anything was loaded at its start, and at its end.
    thresholds
        As energies. [J]
    begin_angle
        Axis angle at first contact. [rad]
    last
        Whether the step reaches the termination time.
    event
        (7,) time and state of the event; between steps, of the last release. Its time is -1 while anything is loaded.

    Returns
    -------
    Termination
        `Termination.NONE` to go on.
    """
    body, time, state = model.body, step[0], event[1:]
    if kinetic_energy(step[8:14], body) <= thresholds.rest:
        fraction = _rest_fraction(step, body, thresholds.rest, state)
        event[0] = time + fraction * step[1]
        interpolate(step, fraction, state)
        return Termination.REST
    if loaded:
        event[0] = -1.0
    elif was_loaded:
        fraction = _release_fraction(step, model, work, state)
        event[0] = time + fraction * step[1]
        interpolate(step, fraction, state)
    elif event[0] < 0.0 and _is_through(step[8:14], body, model.law.thickness):  # nothing was ever loaded
        event[0] = time + step[1]
        interpolate(step, 1.0, state)
    if event[0] >= 0.0:
        retained = kinetic_energy(state, body) < thresholds.retention
        if retained and state[3] <= 0.0:
            return Termination.RETAINED
        if _is_through(step[8:14], body, model.law.thickness):
            return Termination.RETAINED if retained else Termination.PERFORATED
        if not retained and (_is_clear(step[8:14], body) or (last and step[11] < 0.0)):
            return Termination.EXIT
    tumbled = loaded and body.bounds & CENTRED == 0 and abs(step[10] - begin_angle) > MOST_TURN
    if last or tumbled:
        event[0] = time + step[1]
        interpolate(step, 1.0, state)
        end = Termination.TUMBLED if tumbled else Termination.TIME
        return Termination.RETAINED if kinetic_energy(state, body) < thresholds.retention else end
    return Termination.NONE
