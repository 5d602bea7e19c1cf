"""Motion under resistance (eq. 6): the right-hand side, steps and states inside them, compiled.

The state is depth and lateral position of the centre of gravity, axis angle, and their three rates. [m, rad, s]
A step is stored as a row: its start time and length, then four rows of six that give the state inside it, for a
fraction x of the step, as ``(1-x) start + x (end + (1-x) (bend + x twist))``.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import address_of, call_address, compiled, lean
from solver.loads import MOST_STATES, Quadrature, Scratch, accelerate_by_gauss, make_scratch, panel_loads
from solver.surface import Body, Panels, deepest_offset
from solver.surface_integration import Law
from solver.wall_loads import accelerate_in_wall

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
    right_hand_side: int
    """Address of the function, see `with_right_hand_side`."""


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
    scratch: Scratch


@compiled
def start_state(
    body: Body, velocity: float, oblique_angle: float, angle_of_attack: float, angular_velocity: float
) -> FloatArray:
    """State at first contact, when the deepest point of the surface touches the face."""
    axis_angle = oblique_angle + angle_of_attack
    forward, lateral = velocity * math.cos(oblique_angle), velocity * math.sin(oblique_angle)
    return np.array([-deepest_offset(body, axis_angle), 0.0, axis_angle, forward, lateral, angular_velocity])


@lean
def assign(values: FloatArray, out: FloatArray) -> None:
    """Copy values. An assignment to a slice would compile the formatting of an error of shapes into its function."""
    for n in range(out.size):
        out[n] = values[n]


@compiled
def make_workspace() -> Workspace:
    """Return arrays to work in."""
    start, end, stage = np.zeros(3), np.zeros(3), np.zeros(3)
    points, slopes = np.zeros(6 * MOST_STATES), np.zeros(3 * MOST_STATES)
    return Workspace(
        start, end, stage, np.zeros(6), np.zeros(6), points, slopes, np.zeros((MOST_STAGES, 6)), make_scratch()
    )


@lean
def accelerate(states: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> bool:
    """Write the three accelerations of eq. 6 for each of the states; return whether anything is loaded in the last.

    Both are flat, one state after the other. With panels there is only one. The call goes by the address of the
    function: otherwise it would be compiled again into each of its callers.
    """
    return bool(call_address(model.right_hand_side, (states, model, scratch, out), True))


@lean
def _accelerate(states: FloatArray, model: Model, scratch: Scratch, out: FloatArray) -> bool:
    body, last = model.body, out.size - 3
    if model.panels.area.size > 0:
        f, g, h = panel_loads(states, model.panels, model.law)
        out[0], out[1], out[2] = f / body.mass, g / body.mass, h / body.moment_of_inertia
    elif model.law.thickness < math.inf:
        accelerate_in_wall(states, body, model.law, model.quadrature, scratch, out)
    else:
        accelerate_by_gauss(states, body, model.law, model.quadrature, scratch, out)
    if model.law.crater_depth > 0.0:
        _weaken_in_crater(states, body, model.law.crater_depth, out)
    size = body.mass * (abs(out[last]) + abs(out[last + 1])) + body.moment_of_inertia * abs(out[last + 2]) / body.tip
    return bool(size > NEGLIGIBLE_LOAD * model.law.static_stress * body.tip**2)


_addresses: list[int] = []
"""Address of `_accelerate`, from the first model on."""


def with_right_hand_side(model: Model) -> Model:
    """Return the model with the address of the right-hand side in this process, compiled or loaded if need be."""
    if not _addresses:
        workspace = make_workspace()
        _addresses.append(address_of(_accelerate, workspace.points, model, workspace.scratch, workspace.slopes))
    return model._replace(right_hand_side=_addresses[0])


@lean
def _weaken_in_crater(states: FloatArray, body: Body, crater_depth: float, out: FloatArray) -> None:
    """Multiply the accelerations by the depth of each state over that of the crater, up to 1."""
    for k in range(out.size // 3):
        depth = states[6 * k] + deepest_offset(body, states[6 * k + 2])
        share = min(max(depth / crater_depth, 0.0), 1.0)
        for n in range(3 * k, 3 * k + 3):
            out[n] *= share


@lean
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
        load(states[i], model, scratch, values[i])
    return values
