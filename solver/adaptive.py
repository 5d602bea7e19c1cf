"""The route of this package: error-controlled steps of the pair GRK4T for stiff equations, compiled."""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled
from solver.events import Run, Termination, Thresholds, deepest_tip, end_of_step, tip_depth
from solver.motion import Model, Workspace, accelerate, assign, kinetic_energy, store_step
from solver.rosenbrock import DIFFERENCES, EVALUATIONS, Linearisation, attempt_step, end_error, linearise

STEP_LIMIT = 100_000
"""Reached only in a stiff phase at tolerances of 1e-8 and below."""
FIRST_STEP, LARGEST_STEP, SMALLEST_STEP = 1e-2, 0.25, 1e-15
"""Over the time to travel the distance from centre of gravity to tip."""


class Accuracy(NamedTuple):
    """What limits a step."""

    relative_tolerance: float
    """Error of one step over the scale of the motion."""
    largest_step: float
    """Over the time to travel, at the present speed, the distance from centre of gravity to tip."""


@compiled
def integrate_adaptive(
    start: FloatArray,
    model: Model,
    end_time: float,
    thresholds: Thresholds,
    accuracy: Accuracy,
    steps: FloatArray,
    work: Workspace,
    linear: Linearisation,
) -> Run:
    """Integrate with error control until an event or `end_time`.

    Parameters
    ----------
    start
        (6,) state at first contact.
    steps
        (n, `STEP_WIDTH`) table to fill: `STEP_LIMIT` rows to keep every step, one row to keep none.
    work, linear
        Arrays to work in.
    """
    body, initial_energy = model.body, kinetic_energy(start, model.body)
    energies = Thresholds(thresholds.retention * initial_energy, thresholds.rest * initial_energy)
    impact = math.hypot(start[3], start[4])
    scale = np.array([body.tip, body.tip, 1.0, impact, impact, impact / body.tip])
    event, state, time, step = np.full(7, -1.0), start.copy(), 0.0, FIRST_STEP * body.tip / impact
    deepest = tip_depth(state, body)
    loaded, fresh = accelerate(state, model, work.scratch, work.start), False
    end_loaded = loaded
    evaluations, count = 1, 0
    for _ in range(STEP_LIMIT):
        pace = math.hypot(state[3], state[4]) + abs(state[5]) * body.tip
        step = min(step, accuracy.largest_step * body.tip / pace, end_time - time)
        if not fresh:
            linearise(state, model, work, linear)
            evaluations += DIFFERENCES
            fresh = True
        error = attempt_step(state, step, model, work, linear, scale) / accuracy.relative_tolerance
        evaluations += EVALUATIONS
        if error <= 1.0:
            end_loaded = accelerate(work.trial, model, work.scratch, work.end)
            evaluations += 1
            error = max(error, end_error(state, step, work, linear, scale) / accuracy.relative_tolerance)
        if not error <= 1.0:
            step *= max(0.2, 0.9 / math.sqrt(math.sqrt(error))) if math.isfinite(error) else 0.2
            if step < SMALLEST_STEP * body.tip / impact:
                return Run(Termination.NOT_FINITE, time, state, deepest, count, evaluations, 0.0)
            continue
        was_loaded, loaded = loaded, end_loaded
        row = steps[count if steps.shape[0] > 1 else 0]
        store_step(row, time, step, state, work)
        count += 1
        last = time + step >= end_time * (1.0 - 1e-12)
        end = end_of_step(row, model, work, was_loaded, loaded, energies, last, event)
        until = time + step if end == Termination.NONE else event[0]
        if until > time:
            deepest = max(deepest, deepest_tip(row, until, body, work.point))
        if end != Termination.NONE:
            return Run(end, event[0], event[1:], deepest, count, evaluations, 0.0)
        time += step
        assign(work.trial, state)
        assign(work.end, work.start)
        fresh = False
        step *= min(5.0, 0.9 / math.sqrt(math.sqrt(max(error, 1e-10))))
    return Run(Termination.STEP_LIMIT, time, state, deepest, count, evaluations, 0.0)
