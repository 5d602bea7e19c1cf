"""Trials of a search by outcome: one oblique angle each, in a table, compiled."""

import math
from typing import NamedTuple

import numpy as np

from solver.adaptive import integrate_adaptive
from solver.arrays import FloatArray
from solver.compilation import compiled, lean
from solver.events import LODGED_ENERGY, Run, Termination, tip_depth
from solver.fixed_step import integrate_fixed
from solver.motion import STEP_WIDTH, Model, Workspace, kinetic_energy, make_workspace, start_state
from solver.rosenbrock import Linearisation, make_linearisation
from solver.search.levels import Level
from solver.surface_integration import Law

ANGLE, POSITION, END, MARGIN, FINE = range(5)
"""Columns of the table of trials: oblique angle, final depth of the nose tip, a value of `Termination`, how clearly the
projectile was turned away (above zero) or not, and whether the trial was as fine as asked for. [rad, m, 1, 1, 1]"""
TIME, EXIT, STEP_LIMIT, NOT_FINITE, NO_STRENGTH = (
    end.value
    for end in (
        Termination.TIME,
        Termination.EXIT,
        Termination.STEP_LIMIT,
        Termination.NOT_FINITE,
        Termination.NO_STRENGTH,
    )
)


class Strike(NamedTuple):
    """What all trials have in common beside projectile and target."""

    velocity: float
    angle_of_attack: float
    angular_velocity: float
    strength: FloatArray
    """S as a polynomial in the oblique angle in degrees, constant first."""
    compressive_strength: float
    end_time: float
    time_step: float
    """Of the route of panels."""


class TrialWorkspace(NamedTuple):
    """TrialWorkspace for one trial, and the table of trials."""

    work: Workspace
    linear: Linearisation
    steps: FloatArray
    trials: FloatArray


@compiled
def make_trial_workspace(trials: int) -> TrialWorkspace:
    """Empty room for so many."""
    return TrialWorkspace(make_workspace(), make_linearisation(), np.empty((1, STEP_WIDTH)), np.zeros((trials, 5)))


@lean
def strength_at(oblique_angle: float, strength: FloatArray) -> float:
    """S at an oblique angle."""
    degrees, value = abs(math.degrees(oblique_angle)), 0.0
    for k in range(strength.size - 1, -1, -1):
        value = value * degrees + strength[k]
    return value


@lean
def has_strength(oblique_angle: float, strength: FloatArray) -> bool:
    """Whether S at an oblique angle is above zero."""
    return 0.0 < strength_at(oblique_angle, strength) < math.inf


@lean
def _margin(run: Run, model: Model, initial_energy: float) -> float:
    """How clearly a projectile was turned away, above zero, or not; near zero at the critical angle.

    Turned away, it is the energy left; lodged or at rest, it grows with the depth of the tip.
    """
    least = 1e-9
    energy = kinetic_energy(run.state, model.body) / initial_energy - LODGED_ENERGY
    if run.end == Termination.EXIT:
        return max(energy, least)
    depth = max(tip_depth(run.state, model.body), 0.0) / model.body.tip
    return min(energy, 0.0) - max(depth * depth, least)


@compiled
def attempt(oblique_angle: float, strike: Strike, model: Model, level: Level, room: TrialWorkspace, count: int) -> int:
    """Run one trial and write it into the table, as number `count`; return the number of the next."""
    row = room.trials[count]
    row[ANGLE], row[FINE] = oblique_angle, 1.0 if level.fine else 0.0
    if not has_strength(oblique_angle, strike.strength):
        row[END] = NO_STRENGTH
        return count + 1
    law = Law(
        strength_at(oblique_angle, strike.strength) * strike.compressive_strength,
        model.law.dynamic_density,
        level.ramp_fraction * strike.velocity,
        level.smooth_ramp,
        model.law.decay,
    )
    present = Model(model.body, law, level.quadrature, model.panels)
    start = start_state(model.body, strike.velocity, oblique_angle, strike.angle_of_attack, strike.angular_velocity)
    if model.panels.area.size > 0:
        run = integrate_fixed(start, present, strike.end_time, strike.time_step, room.steps)
    else:
        run = integrate_adaptive(start, present, strike.end_time, level.accuracy, room.steps, room.work, room.linear)
    row[POSITION], row[END] = tip_depth(run.state, model.body), run.end.value
    if not np.isfinite(run.state).all():
        row[END] = NOT_FINITE
    row[MARGIN] = _margin(run, model, kinetic_energy(start, model.body))
    return count + 1


@lean
def failed(trial: FloatArray) -> bool:
    """Whether a trial could not be integrated, or begun."""
    return bool(trial[END] == STEP_LIMIT or trial[END] == NOT_FINITE or trial[END] == NO_STRENGTH)


@lean
def undecided(trial: FloatArray) -> bool:
    """Whether a trial was still going on at the termination time."""
    return bool(trial[END] == TIME)


@lean
def turned_away(trial: FloatArray) -> bool:
    """Whether a trial left through the face."""
    return bool(trial[END] == EXIT)
