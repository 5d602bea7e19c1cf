"""Compiled motion under resistance (eq. 6): right-hand side, dense output, and events that end a run.

The state is depth and lateral position of the centre of gravity, axis angle, and their three rates. [m, rad, s] A step
is stored as a row: its start time and its length, then four groups of six numbers, which give the state at a fraction x
of the step as ``(1-x) start + x (end + (1-x) (bend + x twist))``. Event times are roots of this interpolant.
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

# A narrower ramp makes the equations stiffer; with a wider one the body creeps faster where it should rest. With
# this width the depth of the paper's body in normal impact is larger by 2e-7 of its value than with a width of 1e-5.
RAMP_FRACTION = 1e-4
"""Normal velocity over which the static stress builds up, as a fraction of the impact velocity. [1]"""
# With the ramp, the load at the end of a contact fades gradually instead of vanishing at an instant, so a small load
# has to count as none. The value is arbitrary.
NEGLIGIBLE_LOAD = 1e-6
"""Load below which a body counts as unloaded, relative to static stress × (distance from centre of gravity to
tip)². [1]"""
STEP_WIDTH = 26
"""Number of columns in a table of steps: time, length, and four groups of six."""
# GRK4T, the method in `solver.time_integration`, has four stages. The error estimate from the end of a step is stored
# as a fifth.
MOST_STAGES = 5
"""Number of rows of `Workspace.stages`."""
# The static stress vanishes with the velocity, so the energy never reaches zero. This threshold is a hundredth of the
# default retention energy, and equal to the smallest one accepted, so it decides no outcome.
REST_FRACTION = 1e-4
"""Kinetic energy at which a body counts as at rest, relative to its initial value. [1]"""
# Bisection on the stored cubic needs no evaluation of the load and cannot fail; 24 halvings resolve 6e-8 of a step.
HALVINGS = 24
"""Number of bisections that locate an event within a step."""
# A body that tumbles end over end meets concrete that it has already broken, but that the model treats as intact. Its
# further motion means nothing, so the run ends.
MOST_TURN = 2.0 * math.pi
"""Turn of the axis in a target above which a run ends as `Termination.TUMBLED`. [rad]"""
# Each of these halvings evaluates the load. They resolve 2e-4 of a step, which is enough because hardly any load is
# left at a release.
RELEASE_HALVINGS = 12
"""Number of bisections that locate the release of a body within a step."""


class Model(NamedTuple):
    """Parameters of the right-hand side, which uses `quadrature` if `panels` is empty."""

    body: Body
    law: Law
    quadrature: Quadrature
    panels: Panels


class Workspace(NamedTuple):
    """Scratch arrays of a step."""

    start: FloatArray
    """(3,) accelerations at the start of the step."""
    end: FloatArray
    """(3,) accelerations at the end of the step."""
    stage: FloatArray
    """(3,) accelerations at a stage."""
    trial: FloatArray
    """(6,) state at the end of the step."""
    point: FloatArray
    """(6,) state within the step."""
    points: FloatArray
    """(6 `MOST_STATES`,) states near the start, concatenated, for finite differences."""
    slopes: FloatArray
    """(3 `MOST_STATES`,) accelerations at `points`."""
    stages: FloatArray
    """(`MOST_STAGES`, 6) increments or rates of the stages."""
    scale: FloatArray
    """(6,) scales of the components of a state, by which their errors are divided."""
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
    """Copy `values` to `out`.

    Assignment to a slice would also compile numba's error message for unequal shapes.
    """
    for n in range(out.size):
        out[n] = values[n]


def make_workspace() -> Workspace:
    """Allocate the scratch arrays of a run."""
    start, end, stage = np.zeros(3), np.zeros(3), np.zeros(3)
    trial, point = np.zeros(6), np.zeros(6)
    points, slopes = np.zeros(6 * MOST_STATES), np.zeros(3 * MOST_STATES)
    stages, scale, event = np.zeros((MOST_STAGES, 6)), np.zeros(6), np.zeros(7)
    return Workspace(start, end, stage, trial, point, points, slopes, stages, scale, event, make_scratch())


@lean
def accelerate(states: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> bool:
    """Write the accelerations of eq. 6 in each state, and return whether the body is loaded in the last one.

    Parameters
    ----------
    states
        (6 n,) states, concatenated; with panels n must be 1. [m, rad, s]
    out
        (3 n,) output: accelerations. [m/s², rad/s²]
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
    """Write the force and the moment on the body in one state to `out`. [N, N m]"""
    accelerate(state, model, scratch, out)
    out[0] *= model.body.mass
    out[1] *= model.body.mass
    out[2] *= model.body.moment_of_inertia


@lean
def kinetic_energy(state: FloatArray, body: Body) -> float:
    """Return the kinetic energy of translation and rotation. [J]"""
    translation = body.mass * (state[3] ** 2 + state[4] ** 2)
    return 0.5 * float(translation + body.moment_of_inertia * state[5] ** 2)


@lean
def lasting_energy(start: FloatArray, body: Body) -> float:
    """Return the rotational energy of a sphere, which no load can remove without friction; 0 for other bodies. [J]

    Fractions of the initial energy do not include this part.
    """
    return 0.5 * body.moment_of_inertia * float(start[5] ** 2) if body.bounds & CENTRED > 0 else 0.0


@lean
def store_step(row: FloatArray, time: float, step: float, state: FloatArray, work: Workspace) -> None:
    """Store a step as the cubic Hermite interpolant of the states and rates at both ends."""
    # The rates at both ends are known, so the interpolant needs no further evaluation. It is of order 3, one less than
    # the steps, and its first derivative is continuous from step to step.
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
    """Write the state at a fraction of a stored step."""
    # This form reproduces the stored states exactly at both ends, without cancellation between the terms of a cubic.
    rest = 1.0 - fraction
    for n in range(6):
        inner = step[14 + n] + fraction * step[20 + n]
        out[n] = rest * step[2 + n] + fraction * (step[8 + n] + rest * inner)


def sample(steps: FloatArray, times: FloatArray) -> FloatArray:
    """Return the (n, 6) states at sorted `times`, interpolated in a table of steps."""
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
    """Return the (n, 3) accelerations at sorted `times`, as derivatives of the velocities that `sample` returns."""
    # A body that moves along its axis still has a speed of some mm/s across it, which determines the load. The
    # interpolant is less accurate than that, so loads computed from interpolated states scatter by as much as their
    # largest value. The derivative of the interpolant is exact at both ends of a step and smooth between them.
    rows = np.minimum(np.searchsorted(steps[:, 0] + steps[:, 1], times), steps.shape[0] - 1)
    step = steps[rows]
    fraction = np.minimum(1.0, (times - step[:, 0]) / step[:, 1])[:, None]
    before, after, inner, change = step[:, 5:8], step[:, 11:14], step[:, 17:20], step[:, 23:26]
    bend = (1.0 - 2.0 * fraction) * (inner + fraction * change) + fraction * (1.0 - fraction) * change
    rates: FloatArray = (after - before + bend) / step[:, 1:2]
    return rates


def sample_loads(states: FloatArray, model: Model) -> FloatArray:
    """Return the (n, 3) forces and moments at the given states. [N, N m]"""
    values = np.empty((states.shape[0], 3))
    _fill_loads(states, model, make_scratch(), values)
    return values


@compiled
def _fill_loads(states: FloatArray, model: Model, scratch: Scratch, values: FloatArray) -> None:
    for i in range(states.shape[0]):
        load(states[i], model, scratch, values[i])


class Termination(IntEnum):
    """Reason why an integration stopped."""

    TIME = 0
    """Termination time reached."""
    REST = 1
    """Kinetic energy at or below the rest threshold or, with fixed steps, too small for a step to resolve."""
    RETAINED = 2
    """Less than the retention energy left, and either unloaded and not moving inward, beyond the rear face, tumbling,
    or at the termination time."""
    EXIT = 3
    """Released with at least the retention energy, and clear of the impact face or, at the termination time, moving
    outward."""
    STEP_LIMIT = 4
    """Limit on the number of steps reached."""
    NOT_FINITE = 5
    """Diverged: state not finite, more than twice the initial energy, or steps near the rounding error of time."""
    NO_STRENGTH = 6
    """Not started: the strength factor is not above zero."""
    NONE = 7
    """No end yet: the integration continues."""
    PERFORATED = 8
    """Clear of the rear face with at least the retention energy."""
    TUMBLED = 9
    """Loaded after the axis has turned by more than `MOST_TURN` since first contact."""
    CANCELLED = 10
    """Cancelled by the caller, see `solver.cancellation`."""


class Thresholds(NamedTuple):
    """Kinetic energies that decide how a run ends, relative to the initial energy. [1]

    The initial energy does not include the rotation of a sphere, which no load can remove.
    """

    retention: float
    """Energy below which a projectile counts as retained when the run ends."""
    rest: float
    """Energy at which a projectile counts as at rest."""


class Run(NamedTuple):
    """Result of an integration."""

    end: int
    """Reason for the end, a value of `Termination`."""
    time: float
    """Time of the event that ended the run. [s]"""
    state: FloatArray
    """(6,) state at the end of the run."""
    maximum_depth: float
    """Greatest depth of the deepest point of the body. [m]"""
    steps: int
    """Number of accepted steps; also of filled rows, unless the step table has a single row."""
    evaluations: int
    """Number of evaluations of force and moment."""
    energy_gain: float
    """Largest gain of kinetic energy in one fixed step, relative to the initial energy. An exact solution has none; the
    adaptive integration always reports 0. [1]"""


# Compiled code returns only numbers and plain tuples of numbers to Python. To return arrays, named tuples or
# enumerations, numba runs Python code that it assumes cannot fail: if a signal handler raises there, the process
# crashes.
RunValues = tuple[int, float, float, int, int, float]
"""Fields of a `Run` in order, except for the state, which the integrators write to an array."""


@lean
def tip_depth(state: FloatArray, body: Body) -> float:
    """Return the depth of the nose tip. [m]"""
    return float(state[0] + body.tip * math.cos(state[2]))


@lean
def _deepest(state: FloatArray, body: Body) -> tuple[float, float]:
    """Return the depth of the deepest point of the body, and its rate. [m, m/s]"""
    offset, growth = deepest_point(body, state[2])
    return state[0] + offset, state[3] + state[5] * growth


@lean
def greatest_depth(step: FloatArray, until: float, body: Body, state: FloatArray) -> float:
    """Return the greatest depth of the deepest point of the body during a step, up to the time `until`. [m]

    `state` is scratch space.
    """
    low, high = 0.0, min(1.0, (until - step[0]) / step[1])
    interpolate(step, high, state)
    greatest, speed = _deepest(state, body)
    # The greatest depth lies within the step only if the rate of the depth changes sign there; otherwise it is at an
    # end.
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
    """Return the fraction of the step at which the kinetic energy falls to `threshold` [J], by bisection."""
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
    """Return the fraction of the step at which the last element is unloaded, by bisection."""
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
    """Return whether the body has left through the impact face and cannot touch it again."""
    # In free flight the velocity and the spin are constant. Either the whole body is outside and leaves faster than any
    # of its points can turn inward, or it is too far out to touch the face in any attitude. The first condition reduced
    # a run at 80° from 59 steps to 25.
    reach = 0.0
    for i in range(body.corners.shape[0]):
        reach = max(reach, math.hypot(body.corners[i, 0], body.corners[i, 1]))
    leaving = -state[3]
    if leaving > reach * abs(state[5]):
        return bool(state[0] + deepest_offset(body, state[2]) < 0.0)
    return bool(leaving > 0.0 and state[0] < -reach)


@lean
def _is_through(state: FloatArray, body: Body, thickness: float) -> bool:
    """Return whether the body has left through the rear face and cannot touch it again, as in `_is_clear`."""
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
    """Return why the run ends within a step, if it does, and write the time and state of the event.

    Parameters
    ----------
    step
        Row of the step, as `store_step` writes it.
    was_loaded, loaded
        Load on the body at the start and at the end of the step, as `accelerate` returns it.
    thresholds
        Energies of retention and rest. [J]
    begin_angle
        Axis angle at first contact. [rad]
    last
        True if the step reaches the termination time.
    event
        (7,) input and output: time and state of the event. Between steps it holds the last release; its time is -1
        while the body is loaded, and before the first release.

    Returns
    -------
    Termination
        `Termination.NONE` if the run continues.
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
    elif event[0] < 0.0 and _is_through(step[8:14], body, model.law.thickness):  # the body was never loaded
        event[0] = time + step[1]
        interpolate(step, 1.0, state)
    if event[0] >= 0.0:
        # The energy at the release decides the outcome, since it is constant in free flight.
        retained = kinetic_energy(state, body) < thresholds.retention
        if retained and state[3] <= 0.0:
            return Termination.RETAINED
        if _is_through(step[8:14], body, model.law.thickness):
            return Termination.RETAINED if retained else Termination.PERFORATED
        if not retained and (_is_clear(step[8:14], body) or (last and step[11] < 0.0)):
            return Termination.EXIT
    # The axis of a sphere may turn without limit, since its rotation loads no element.
    tumbled = loaded and body.bounds & CENTRED == 0 and abs(step[10] - begin_angle) > MOST_TURN
    if last or tumbled:
        event[0] = time + step[1]
        interpolate(step, 1.0, state)
        end = Termination.TUMBLED if tumbled else Termination.TIME
        return Termination.RETAINED if kinetic_energy(state, body) < thresholds.retention else end
    return Termination.NONE
