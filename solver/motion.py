"""Motion under resistance (eq. 6): the right-hand side, steps and states inside them, compiled.

The state is depth and lateral position of the centre of gravity, axis angle, and their three rates. [m, rad, s]
A step is stored as a row: its start time and length, then four rows of six that give the state inside it, for a
fraction x of the step, as ``(1-x) start + x (end + (1-x) (bend + x twist))``.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled, lean
from solver.loads import Quadrature, Scratch, loads, make_scratch, panel_loads
from solver.rings import Law, Load
from solver.surface import Body, Panels, deepest_offset

RAMP_FRACTION = 1e-4
"""Ramp velocity of the static stress over the impact velocity."""
NEGLIGIBLE_LOAD = 1e-6
"""Load below which nothing counts as loaded, over the static stress on the square of the distance to the tip: the ramp
lets a contact that ends die away instead of stopping at an instant."""
STEP_WIDTH = 26
MOST_STAGES = 5


class Model(NamedTuple):
    """All that the right-hand side needs. Panels are used if there are any, else Gauss points."""

    body: Body
    law: Law
    quadrature: Quadrature
    panels: Panels


class Work(NamedTuple):
    """Room to try a step."""

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
    stages: FloatArray
    """(`MOST_STAGES`, 6) increments or rates of the stages."""
    scratch: Scratch


@compiled
def start_state(
    body: Body, velocity: float, oblique_angle: float, angle_of_attack: float, angular_velocity: float
) -> FloatArray:
    """State at first contact, when the deepest point of the surface touches the face."""
    axis_angle = oblique_angle + angle_of_attack
    forward, lateral = velocity * math.cos(oblique_angle), velocity * math.sin(oblique_angle)
    return np.array([-deepest_offset(body, axis_angle), 0.0, axis_angle, forward, lateral, angular_velocity])


@compiled
def make_work() -> Work:
    """Empty room."""
    return Work(
        np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(6), np.zeros(6), np.zeros((MOST_STAGES, 6)), make_scratch()
    )


@lean
def load(state: FloatArray, model: Model, scratch: Scratch) -> Load:
    """Force and moment by the route of the model."""
    if model.panels.area.size > 0:
        return panel_loads(state, model.panels, model.law)
    return loads(state, model.body, model.law, model.quadrature, scratch)


@lean
def accelerate(state: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> bool:
    """Write the three accelerations of eq. 6; tell whether anything is loaded."""
    depth_force, lateral_force, moment = load(state, model, scratch)
    out[0] = depth_force / model.body.mass
    out[1] = lateral_force / model.body.mass
    out[2] = moment / model.body.moment_of_inertia
    size = abs(depth_force) + abs(lateral_force) + abs(moment) / model.body.tip
    return size > NEGLIGIBLE_LOAD * model.law.static_stress * model.body.tip**2


@lean
def kinetic_energy(state: FloatArray, body: Body) -> float:
    """Of translation and rotation. [J]"""
    translation = body.mass * (state[3] ** 2 + state[4] ** 2)
    return 0.5 * float(translation + body.moment_of_inertia * state[5] ** 2)


@lean
def store_step(row: FloatArray, time: float, step: float, state: FloatArray, work: Work) -> None:
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


@compiled
def sample(steps: FloatArray, times: FloatArray) -> FloatArray:
    """States at sorted `times` from a table of steps."""
    states = np.empty((times.size, 6))
    row = 0
    for i in range(times.size):
        while row < steps.shape[0] - 1 and times[i] > steps[row, 0] + steps[row, 1]:
            row += 1
        fraction = min(1.0, (times[i] - steps[row, 0]) / steps[row, 1])
        interpolate(steps[row], fraction, states[i])
    return states


@compiled
def sample_loads(states: FloatArray, model: Model) -> FloatArray:
    """(n, 3) forces and moments at the given states."""
    values, scratch = np.empty((states.shape[0], 3)), make_scratch()
    for i in range(states.shape[0]):
        values[i, 0], values[i, 1], values[i, 2] = load(states[i], model, scratch)
    return values
