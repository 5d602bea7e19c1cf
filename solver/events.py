"""What ends a run, and the instant at which it does, compiled. Instants are roots on the interpolation of a step."""

import math
from enum import IntEnum
from typing import NamedTuple

from solver.arrays import FloatArray
from solver.compilation import lean
from solver.motion import Model, Workspace, accelerate, interpolate, kinetic_energy
from solver.surface import Body, deepest_offset

REST_FRACTION = 1e-4
"""Kinetic energy at rest, over its initial value."""
HALVINGS = 24
"""Bisections of a step, to find the instant of an event: to 1e-7 of the step."""
RELEASE_HALVINGS = 12
"""Bisections for a release, where each takes an evaluation and hardly any load is left."""


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
    NO_STRENGTH = 6
    """Never begun: the strength factor is not above zero."""
    NONE = 7
    PERFORATED = 8
    """Beyond the rear face, moving on."""


class Thresholds(NamedTuple):
    """Shares of the initial kinetic energy."""

    retention: float
    """A projectile that falls below it is retained, wherever its nose is."""
    rest: float
    """A run ends where it falls to this."""


class Run(NamedTuple):
    """Result of an integration."""

    end: Termination
    time: float
    """Time of the event that ended the run. [s]"""
    state: FloatArray
    """(6,) at that time."""
    maximum_tip_depth: float
    """[m]"""
    steps: int
    """Rows of the step table that are filled."""
    evaluations: int
    """Evaluations of force and moment."""
    energy_gain: float
    """Largest gain of kinetic energy over one step, relative to the initial energy; a true motion has none."""


@lean
def tip_depth(state: FloatArray, body: Body) -> float:
    """Depth of the nose tip. [m]"""
    return float(state[0] + body.tip * math.cos(state[2]))


@lean
def _tip_speed(state: FloatArray, body: Body) -> float:
    return float(state[3] - body.tip * state[5] * math.sin(state[2]))


@lean
def deepest_tip(step: FloatArray, until: float, body: Body, state: FloatArray) -> float:
    """Greatest depth of the nose tip within a step, up to a time; `state` is overwritten."""
    low, high = 0.0, min(1.0, (until - step[0]) / step[1])
    interpolate(step, high, state)
    deepest = max(tip_depth(step[2:8], body), tip_depth(state, body))
    if _tip_speed(step[2:8], body) > 0.0 > _tip_speed(state, body):
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            interpolate(step, middle, state)
            if _tip_speed(state, body) > 0.0:
                low = middle
            else:
                high = middle
        deepest = max(deepest, tip_depth(state, body))
    return deepest


@lean
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


@lean
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


@lean
def end_of_step(
    step: FloatArray,
    model: Model,
    work: Workspace,
    was_loaded: bool,
    loaded: bool,
    thresholds: Thresholds,
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
    if last:
        event[0] = time + step[1]
        interpolate(step, 1.0, state)
        return Termination.RETAINED if kinetic_energy(state, body) < thresholds.retention else Termination.TIME
    return Termination.NONE
