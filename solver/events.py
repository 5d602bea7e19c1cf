"""What ends a run, and the instant at which it does, compiled. Instants are roots on the interpolation of a step."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled
from solver.motion import Model, accelerate, interpolate, kinetic_energy
from solver.surface import Body

REST_ENERGY = 1e-4
"""Kinetic energy, over its initial value, below which a projectile counts as embedded."""
LODGED_ENERGY = 1e-3
"""Kinetic energy, over its initial value, below which a projectile counts as embedded when the load ends with its nose
still inside: at 3 % of its speed, what the model leaves out (friction, rubble) decides, not the model."""


class End(IntEnum):
    """Why an integration stopped."""

    TIME = 0
    REST = 1
    LODGED = 2
    EXIT = 3
    STEP_LIMIT = 4
    NOT_FINITE = 5
    NONE = 6


class Run(NamedTuple):
    """Result of an integration."""

    end: int
    """A value of `End`."""
    time: float
    """Of the event that ended the run. [s]"""
    state: FloatArray
    """(6,) at that time."""
    maximum_tip_depth: float
    """[m]"""
    steps: int
    """Rows of the step table that are filled."""
    evaluations: int
    """Of force and moment."""
    energy_gain: float
    """Largest gain of kinetic energy over one step, relative to the initial energy; a true motion has none."""


@compiled
def tip_depth(state: FloatArray, body: Body) -> float:
    """Depth of the nose tip. [m]"""
    return float(state[0] + body.tip * math.cos(state[2]))


@compiled
def _tip_speed(state: FloatArray, body: Body) -> float:
    return float(state[3] - body.tip * state[5] * math.sin(state[2]))


@compiled
def deepest_tip(step: FloatArray, until: float, body: Body) -> float:
    """Greatest depth of the nose tip within a step, up to a time."""
    low, high = 0.0, min(1.0, (until - step[0]) / step[1])
    state = np.empty(6)
    interpolate(step, high, state)
    deepest = max(tip_depth(step[2:8], body), tip_depth(state, body))
    if _tip_speed(step[2:8], body) > 0.0 > _tip_speed(state, body):
        for _ in range(40):
            middle = 0.5 * (low + high)
            interpolate(step, middle, state)
            if _tip_speed(state, body) > 0.0:
                low = middle
            else:
                high = middle
        deepest = max(deepest, tip_depth(state, body))
    return deepest


@compiled
def _rest_fraction(step: FloatArray, body: Body, threshold: float) -> float:
    """Fraction of the step at which the kinetic energy falls to `threshold`."""
    low, high = 0.0, 1.0
    state = np.empty(6)
    for _ in range(50):
        middle = 0.5 * (low + high)
        interpolate(step, middle, state)
        if kinetic_energy(state, body) > threshold:
            low = middle
        else:
            high = middle
    return high


@compiled
def _release_fraction(step: FloatArray, model: Model) -> float:
    """Fraction of the step at which the last element is unloaded."""
    low, high = 0.0, 1.0
    state, acceleration = np.empty(6), np.empty(3)
    for _ in range(30):
        middle = 0.5 * (low + high)
        interpolate(step, middle, state)
        if accelerate(state, model, acceleration):
            low = middle
        else:
            high = middle
    return high


@compiled
def _is_clear(state: FloatArray, body: Body) -> bool:
    """Whether the body moves out and is too far out to touch the face again, however it turns."""
    reach = 0.0
    for i in range(body.corners.shape[0]):
        reach = max(reach, math.hypot(body.corners[i, 0], body.corners[i, 1]))
    return bool(state[3] < 0.0 and state[0] < -reach)


@compiled
def end_of_step(
    step: FloatArray, model: Model, was_loaded: bool, loaded: bool, initial_energy: float, last: bool, event: FloatArray
) -> int:
    """Whether the run ends with this step, and how.

    Parameters
    ----------
    step
        The step, as stored.
    was_loaded, loaded
        Whether anything was loaded at its start, and at its end.
    last
        Whether the step reaches the termination time.
    event
        (7,) time and state of the event; between steps, of the last release. Its time is -1 while anything is loaded.

    Returns
    -------
    int
        A value of `End`, `End.NONE` to go on.
    """
    body, time, state = model.body, step[0], event[1:]
    if kinetic_energy(step[8:14], body) <= REST_ENERGY * initial_energy:
        fraction = _rest_fraction(step, body, REST_ENERGY * initial_energy)
        event[0] = time + fraction * step[1]
        interpolate(step, fraction, state)
        return End.REST
    if loaded:
        event[0] = -1.0
    elif was_loaded:
        fraction = _release_fraction(step, model)
        event[0] = time + fraction * step[1]
        interpolate(step, fraction, state)
        slow = kinetic_energy(state, body) < LODGED_ENERGY * initial_energy
        if slow and state[3] < 0.0 and tip_depth(state, body) > 0.0:
            return End.LODGED
    if event[0] >= 0.0 and (_is_clear(step[8:14], body) or (last and step[11] < 0.0)):
        return End.EXIT
    if last:
        event[0] = time + step[1]
        state[:] = step[8:14]
        return End.TIME
    return End.NONE
