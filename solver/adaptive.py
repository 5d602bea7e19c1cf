"""The route of this package: error-controlled steps of the stiffly stable pair RODAS, compiled."""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled
from solver.events import End, Run, deepest_tip, end_of_step, tip_depth
from solver.motion import Model, Work, accelerate, kinetic_energy, make_work, store_step
from solver.rosenbrock import STAGES, error_norm, newton_inverse, solve_stage, stage_state

STEP_LIMIT = 100_000
"""Reached only in a stiff phase at tolerances of 1e-8 and below."""
FIRST_STEP, LARGEST_STEP, SMALLEST_STEP = 1e-3, 0.25, 1e-15
"""Over the time to travel the distance from centre of gravity to tip."""
DIFFERENCE = 1e-7
"""Relative step of the difference quotients in position; the velocities' is 1e-3 of the ramp velocity."""
DIFFERENCES = 8
"""Evaluations for one Jacobian."""


class Linearisation(NamedTuple):
    """Derivatives of the accelerations by position and velocity, the inverse that the stages share, and the stages."""

    stiffness: FloatArray
    damping: FloatArray
    inverse: FloatArray
    stages: FloatArray


@compiled
def _make_linearisation() -> Linearisation:
    return Linearisation(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((STAGES, 6)))


@compiled
def _linearise(state: FloatArray, acceleration: FloatArray, model: Model, work: Work, linear: Linearisation) -> None:
    """Difference quotients of the accelerations, central in velocity. Nothing depends on the lateral position.

    Around rest sideways the accelerations have a kink in velocity: one-sided quotients there cost the pair its order
    and made the number of steps depend on the side.
    """
    length = model.body.tip
    speed = 1e-3 * model.law.ramp_velocity
    increments = (DIFFERENCE * length, 0.0, DIFFERENCE, speed, speed, speed / length)
    moved = state.copy()
    for n in range(6):
        if n == 1:
            continue
        moved[n] = state[n] + increments[n]
        accelerate(moved, model, work.stage)
        if n < 3:
            for i in range(3):
                linear.stiffness[i, n] = (work.stage[i] - acceleration[i]) / increments[n]
        else:
            moved[n] = state[n] - increments[n]
            accelerate(moved, model, work.end)
            for i in range(3):
                linear.damping[i, n - 3] = (work.stage[i] - work.end[i]) / (2.0 * increments[n])
        moved[n] = state[n]


@compiled
def _attempt_step(state: FloatArray, step: float, model: Model, work: Work, linear: Linearisation) -> None:
    """Try a step; the new state is in ``work.trial``, the estimate of its error in the last stage."""
    newton_inverse(linear.stiffness, linear.damping, step, linear.inverse)
    solve_stage(state[3:], work.start, step, linear.stiffness, linear.inverse, linear.stages, 0)
    for index in range(1, STAGES):
        stage_state(state, linear.stages, index, work.trial)
        accelerate(work.trial, model, work.stage)
        solve_stage(work.trial[3:], work.stage, step, linear.stiffness, linear.inverse, linear.stages, index)
    for n in range(6):
        work.trial[n] += linear.stages[STAGES - 1, n]


@compiled
def integrate_adaptive(
    start: FloatArray, model: Model, end_time: float, relative_tolerance: float, steps: FloatArray
) -> Run:
    """Integrate with error control until an event or `end_time`.

    Parameters
    ----------
    start
        (6,) state at first contact.
    steps
        (n, `STEP_WIDTH`) table to fill: `STEP_LIMIT` rows to keep every step, one row to keep none.
    """
    body, initial_energy = model.body, kinetic_energy(start, model.body)
    impact = math.hypot(start[3], start[4])
    scale = np.array([body.tip, body.tip, 1.0, impact, impact, impact / body.tip])
    work, linear, event = make_work(), _make_linearisation(), np.full(7, -1.0)
    state, time, step = start.copy(), 0.0, FIRST_STEP * body.tip / impact
    deepest = tip_depth(state, body)
    loaded, fresh = accelerate(state, model, work.start), False
    evaluations, count = 1, 0
    for _ in range(STEP_LIMIT):
        pace = math.hypot(state[3], state[4]) + abs(state[5]) * body.tip
        step = min(step, LARGEST_STEP * body.tip / pace, end_time - time)
        if not fresh:
            _linearise(state, work.start, model, work, linear)
            evaluations += DIFFERENCES
            fresh = True
        _attempt_step(state, step, model, work, linear)
        evaluations += STAGES - 1
        error = error_norm(linear.stages, scale, relative_tolerance)
        if not error <= 1.0:
            step *= max(0.2, 0.9 * error**-0.25) if math.isfinite(error) else 0.2
            if step < SMALLEST_STEP * body.tip / impact:
                return Run(End.NOT_FINITE, time, state, deepest, count, evaluations, 0.0)
            continue
        was_loaded, loaded = loaded, accelerate(work.trial, model, work.end)
        evaluations += 1
        row = steps[count if steps.shape[0] > 1 else 0]
        store_step(row, time, step, state, work)
        count += 1
        last = time + step >= end_time * (1.0 - 1e-12)
        end = end_of_step(row, model, was_loaded, loaded, initial_energy, last, event)
        until = time + step if end == End.NONE else event[0]
        if until > time:
            deepest = max(deepest, deepest_tip(row, until, body))
        if end != End.NONE:
            return Run(end, event[0], event[1:], deepest, count, evaluations, 0.0)
        time += step
        state[:], work.start[:] = work.trial, work.end
        fresh = False
        step *= min(5.0, 0.9 * max(error, 1e-10) ** -0.25)
    return Run(End.STEP_LIMIT, time, state, deepest, count, evaluations, 0.0)
