"""The route of the paper: the classical Runge-Kutta method of order 4 with a fixed step, compiled."""

import math

import numpy as np

from solver.arrays import FloatArray
from solver.compilation import compiled, lean
from solver.events import Run, Termination, Thresholds, deepest_tip, end_of_step, tip_depth
from solver.motion import Model, Workspace, accelerate, assign, kinetic_energy, make_workspace, store_step
from solver.surface import Body

UNRESOLVED_ENERGY = 1e-2
"""Kinetic energy, over its initial value, below which a fixed step may be unable to tell motion from rest."""


@lean
def _attempt_step(state: FloatArray, step: float, model: Model, work: Workspace) -> None:
    """One step; the new state is in ``work.trial``."""
    rate, point = work.stages, work.point
    for n in range(6):
        point[n] = state[n]
    for index in range(4):
        if index > 0:
            reach = step if index == 3 else 0.5 * step
            for n in range(6):
                point[n] = state[n] + reach * rate[index - 1, n]
            accelerate(point, model, work.scratch, work.stage)
        for n in range(3):
            rate[index, n] = point[n + 3]
            rate[index, n + 3] = work.start[n] if index == 0 else work.stage[n]
    for n in range(6):
        work.trial[n] = state[n] + step / 6.0 * (rate[0, n] + 2.0 * (rate[1, n] + rate[2, n]) + rate[3, n])


@lean
def _impulse_energy(acceleration: FloatArray, step: float, body: Body) -> float:
    """Kinetic energy that the present load gives or takes within one step, from rest or to rest. [J]"""
    translation = body.mass * (acceleration[0] ** 2 + acceleration[1] ** 2)
    return 0.5 * float(translation + body.moment_of_inertia * acceleration[2] ** 2) * step**2


@compiled
def integrate_fixed(
    start: FloatArray, model: Model, end_time: float, thresholds: Thresholds, time_step: float, steps: FloatArray
) -> Run:
    """Integrate with the fixed step of the paper until an event or `end_time`.

    A fixed step cannot follow the end of the motion: it overshoots rest and then gains energy, which no true motion
    does. A step that gains energy while the load could stop the projectile within one step is taken for rest, if little
    energy is left; with more, the step is too long for the strike, which the reported gain shows.

    Parameters
    ----------
    start
        (6,) state at first contact.
    steps
        (n, `STEP_WIDTH`) table to fill: a row for each step, or one row to keep none.
    """
    body, initial_energy = model.body, kinetic_energy(start, model.body)
    energies = Thresholds(thresholds.retention * initial_energy, thresholds.rest * initial_energy)
    work, event, state = make_workspace(), np.full(7, -1.0), start.copy()
    deepest, gain, energy = tip_depth(state, body), 0.0, initial_energy
    loaded = accelerate(state, model, work.scratch, work.start)
    count = math.ceil(end_time / time_step * (1.0 - 1e-12))
    for index in range(count):
        time = index * time_step
        step = min(time_step, end_time - time)
        _attempt_step(state, step, model, work)
        was_loaded, loaded = loaded, accelerate(work.trial, model, work.scratch, work.end)
        before, energy = energy, kinetic_energy(work.trial, body)
        enough = min(_impulse_energy(work.end, step, body), UNRESOLVED_ENERGY * initial_energy)
        if before < energy < enough:
            return Run(Termination.REST, time, state, deepest, index, 4 * index, gain)
        gain = max(gain, (energy - before) / initial_energy)
        row = steps[index if steps.shape[0] > 1 else 0]
        store_step(row, time, step, state, work)
        end = end_of_step(row, model, work, was_loaded, loaded, energies, index == count - 1, event)
        until = time + step if end == Termination.NONE else event[0]
        if until > time:
            deepest = max(deepest, deepest_tip(row, until, body, work.point))
        if end != Termination.NONE:
            return Run(end, event[0], event[1:], deepest, index + 1, 4 * index + 4, gain)
        assign(work.trial, state)
        assign(work.end, work.start)
    return Run(Termination.TIME, end_time, state, deepest, count, 4 * count, gain)
