"""Trials of a search by outcome: compiled runs at one oblique angle each, on one of four levels of accuracy."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.compilation import lean
from solver.loads import Quadrature, build_quadrature
from solver.motion import (
    RAMP_FRACTION,
    STEP_WIDTH,
    Model,
    Termination,
    Thresholds,
    Workspace,
    kinetic_energy,
    lasting_energy,
    make_workspace,
    start_state,
    tip_depth,
)
from solver.surface_integration import Law
from solver.time_integration import (
    LARGEST_STEP,
    Accuracy,
    Linearisation,
    integrate_adaptive,
    integrate_fixed,
    make_linearisation,
)

ROUGH, MIDDLE, REQUESTED, LAST = range(4)
"""Indices in `Levels`. `REQUESTED` has the numerical settings of the case; `LAST` is used where the error of the
requested level may be too large, or a trial on it is undecided."""
# Without this level, 7 of 200 random angles were off by more than 0.02°; with it, one was. Fewer stations or points
# saved up to 18 % of the time, but left three to ten times as many angles off.
LAST_TOLERANCE, LAST_STATIONS, LAST_POINTS = 3e-5, 16, 5
"""Relative tolerance, stations and points of the last level, unless the case has finer ones."""


class Level(NamedTuple):
    """Resolution of the trials on one level, and the widths of its brackets."""

    quadrature: Quadrature
    accuracy: Accuracy
    ramp_fraction: float
    """Ramp velocity of the static stress, as a fraction of the impact velocity. [1]"""
    smooth_ramp: bool
    """True for the smooth ramp, see `solver.surface_integration.Law`."""
    stride: float
    """Longest first stride away from the change that the previous level found. [rad]"""
    tolerance: float
    """Width of the final bracket. [rad]"""
    fine: bool
    """True if the resolution is at least that of the case."""


Levels = tuple[Level, Level, Level, Level]
# Usual trials take some tens of steps. A trial that reaches this limit does not resolve the motion, and is repeated on
# the requested level.
MOST_STEPS = 1000
"""Largest number of steps of a trial on the first two levels."""
# Two stations, two points and a tolerance of 0.03 locate a change to a few tenths of a degree at a quarter of the cost
# of the requested level. The ramp is as wide as this tolerance allows, so that long steps do not chatter once the body
# is stuck. This reduced the evaluations of a trial from 1,831 to 499.
ROUGH_LEVEL = Level(
    quadrature=build_quadrature(stations=2, points=2),
    accuracy=Accuracy(relative_tolerance=3e-2, largest_step=1.0, most_steps=MOST_STEPS),
    ramp_fraction=5e-3,
    smooth_ramp=False,
    stride=0.0,
    tolerance=math.radians(1.25),
    fine=False,
)
"""Level of the scan."""
# This level locates a change to a few hundredths of a degree at two thirds of the cost of the requested level. Without
# it, searches were 10 % faster for the paper's strike, but 3 to 6 of 600 random angles were off instead of one.
MIDDLE_LEVEL = Level(
    quadrature=build_quadrature(stations=5, points=3),
    accuracy=Accuracy(relative_tolerance=2e-3, largest_step=LARGEST_STEP, most_steps=MOST_STEPS),
    ramp_fraction=RAMP_FRACTION,
    smooth_ramp=True,
    stride=math.radians(0.5),  # the rough level locates a change to a few tenths of a degree
    tolerance=math.radians(0.3),
    fine=False,
)
"""Level between the rough and the requested level."""


@lru_cache  # the cases of a study share their settings
def search_levels(*, relative_tolerance: float, stations: int, points: int, tolerance: float) -> Levels:
    """Build the four levels from the settings of a case; `tolerance` is the width of the final bracket. [rad]"""
    requested = Level(
        quadrature=build_quadrature(stations=stations, points=points),
        accuracy=Accuracy(float(relative_tolerance), LARGEST_STEP),
        ramp_fraction=RAMP_FRACTION,
        smooth_ramp=True,
        stride=math.radians(0.1),  # the middle level locates a change to a few hundredths of a degree
        tolerance=float(tolerance),
        fine=True,
    )
    last = requested._replace(
        quadrature=build_quadrature(stations=max(stations, LAST_STATIONS), points=max(points, LAST_POINTS)),
        accuracy=Accuracy(float(min(relative_tolerance, LAST_TOLERANCE)), LARGEST_STEP),
    )
    return ROUGH_LEVEL, MIDDLE_LEVEL, requested, last


@lean
def is_finer(level: Level, other: Level) -> bool:
    """Return whether a level has a smaller tolerance, more stations or more points than another."""
    tolerance, stations, points = level.accuracy.relative_tolerance, level.quadrature.stations, level.quadrature.points
    return bool(
        tolerance < other.accuracy.relative_tolerance
        or stations.size > other.quadrature.stations.size
        or points.shape[0] > other.quadrature.points.shape[0]
    )


ANGLE, POSITION, END, MARGIN, FINE, STATE = range(6)
"""Columns of the table of trials.

Oblique angle [rad]; final depth of the nose tip [m]; a value of `Termination`; the margin, see `_margin` [1]; 1 for a
trial at the final resolution, else 0; and the six numbers of the final state [m, rad, s]."""
COLUMNS = STATE + 6
"""Number of columns of the table of trials."""
TIME, RETAINED, EXIT = Termination.TIME.value, Termination.RETAINED.value, Termination.EXIT.value
STEP_LIMIT, NOT_FINITE = Termination.STEP_LIMIT.value, Termination.NOT_FINITE.value
PERFORATED, TUMBLED = Termination.PERFORATED.value, Termination.TUMBLED.value
NO_STRENGTH, CANCELLED = Termination.NO_STRENGTH.value, Termination.CANCELLED.value
# A trial continues below the retention energy: secants need values on both sides of a change, and the energy left
# varies smoothly with the angle there too. A tenth is arbitrary.
ENERGY_FLOOR = 0.1
"""Kinetic energy at which a trial ends, as a fraction of the retention energy. [1]"""
# A margin of zero has no sign, and two of them would make the denominator of a secant zero. The value is far below the
# error of a margin.
LEAST = 1e-9
"""Smallest absolute value of a margin. [1]"""
# Closer to a change, the error of a margin is a large part of the margin; the value is arbitrary.
CLOSE = math.radians(0.3)
"""Least distance from a change at which a trial serves to estimate the growth of the margin. [rad]"""


class Strength(NamedTuple):
    """Strength factor S as a polynomial in the oblique angle."""

    coefficients: FloatArray
    """Coefficients of the powers of the angle in degrees, constant first. [1, 1/°, ...]"""
    held_from: float
    """Angle from which S is held constant. [°]"""


class TrialInputs(NamedTuple):
    """Parameters that all trials of a search share, in addition to the `Model`."""

    velocity: float
    """Speed at first contact. [m/s]"""
    angle_of_attack: float
    """Angle of attack at first contact. [rad]"""
    angular_velocity: float
    """Rate of the axis angle at first contact. [rad/s]"""
    strength: Strength
    compressive_strength: float
    """Unconfined compressive strength of the target. [Pa]"""
    end_time: float
    """Termination time. [s]"""
    time_step: float
    """Time step of the panel method. [s]"""
    retention: float
    """Retention energy: the fraction of the initial kinetic energy with which a projectile must leave to count as
    turned away. [1]"""
    sought: int
    """Termination of interest, `Termination.EXIT` or `Termination.PERFORATED`: the search finds where it begins and
    ends."""
    vary_inertia: bool
    """True if a trial with a larger moment of inertia is run, to find the effect on the angle."""


class TrialTable(NamedTuple):
    """All trials of a search, with scratch arrays for the next one."""

    rows: FloatArray
    """(n, `COLUMNS`) trials in the order of computation; only the first `filled` rows are valid."""
    filled: IntArray
    """(1,) number of trials."""
    numbers: IntArray
    """(n,) row numbers of the trials of a scan, in order of the angle."""
    start: FloatArray
    """(6,) state at first contact."""
    work: Workspace
    linear: Linearisation
    steps: FloatArray
    """(1, `STEP_WIDTH`) last step of a trial."""
    control: IntArray
    """Shared array that cancels the search, see `solver.cancellation`."""


class SearchState(NamedTuple):
    """Arguments shared by the functions of a compiled search."""

    inputs: TrialInputs
    model: Model
    levels: Levels
    table: TrialTable


def make_trial_table(size: int, control: IntArray) -> TrialTable:
    """Allocate an empty table for at most `size` trials."""
    rows, filled, numbers = np.zeros((size, COLUMNS)), np.zeros(1, np.int64), np.empty(size, np.int64)
    work, linear, steps = make_workspace(), make_linearisation(), np.empty((1, STEP_WIDTH))
    return TrialTable(rows, filled, numbers, np.empty(6), work, linear, steps, control)


@lean
def strength_at(oblique_angle: float, strength: Strength) -> float:
    """Evaluate S at an oblique angle [rad] by Horner's scheme. [1]"""
    degrees, value = min(abs(math.degrees(oblique_angle)), strength.held_from), 0.0
    for k in range(strength.coefficients.size - 1, -1, -1):
        value = value * degrees + strength.coefficients[k]
    return value


@lean
def has_strength(oblique_angle: float, strength: Strength) -> bool:
    """Return whether S at an oblique angle is finite and above zero."""
    return 0.0 < strength_at(oblique_angle, strength) < math.inf


@lean
def _margin(end: int, state: FloatArray, model: Model, energy: float, retention: float, sought: int) -> float:
    """Return the margin of a trial: above zero if it ended as sought with the retention energy or more. [1]

    If the trial ended as sought, the margin is the energy left minus the retention energy, both divided by the initial
    energy. It varies smoothly with the angle on both sides of zero, so secants converge. Otherwise it is negative, and
    decreases with the square of the distance from the nose tip to the face through which the projectile should leave.
    """
    if end == sought:
        margin = energy - retention
        return margin if abs(margin) > LEAST else math.copysign(LEAST, margin)
    depth = tip_depth(state, model.body)
    depth = max(model.law.thickness - depth if sought == PERFORATED else depth, 0.0) / model.body.tip
    return -retention - depth * depth


@lean
def attempt(oblique_angle: float, level: Level, search: SearchState) -> int:
    """Run one trial, append it to the table and return its row number.

    If a trial on a coarse level loses no energy, diverges or takes too many steps, it is repeated on the requested
    level.
    """
    inputs, model, table = search.inputs, search.model, search.table
    number = int(table.filled[0])
    row, table.filled[0] = table.rows[number], number + 1
    row[ANGLE], row[FINE] = oblique_angle, 1.0 if level.fine else 0.0
    if not has_strength(oblique_angle, inputs.strength):
        row[END] = NO_STRENGTH
        return number
    start, state = table.start, row[STATE:]
    start_state(model.body, inputs.velocity, oblique_angle, inputs.angle_of_attack, inputs.angular_velocity, start)
    floor = ENERGY_FLOOR * inputs.retention
    thresholds = Thresholds(floor, floor)
    while True:
        law = Law(
            strength_at(oblique_angle, inputs.strength) * inputs.compressive_strength,
            model.law.dynamic_density,
            level.ramp_fraction * inputs.velocity,
            level.smooth_ramp,
            model.law.decay,
            model.law.thickness,
            model.law.loaded_thickness,
            model.law.crater_depth,
        )
        present = Model(model.body, law, level.quadrature, model.panels)
        if model.panels.area.size > 0:
            values = integrate_fixed(
                start,
                present,
                inputs.end_time,
                thresholds,
                inputs.time_step,
                table.steps,
                state,
                table.control,
                table.work,
            )
        else:
            values = integrate_adaptive(
                start,
                present,
                inputs.end_time,
                thresholds,
                level.accuracy,
                table.steps,
                state,
                table.control,
                table.work,
                table.linear,
            )
        end = values[0]
        lasting = lasting_energy(start, model.body)
        energy = (kinetic_energy(state, model.body) - lasting) / (kinetic_energy(start, model.body) - lasting)
        if level.fine or (energy < 1.0 and end not in (STEP_LIMIT, NOT_FINITE)):
            break
        level = search.levels[REQUESTED]
    row[FINE] = 1.0 if level.fine else 0.0
    row[POSITION], row[END] = tip_depth(state, model.body), end
    finite = True
    for n in range(state.size):
        finite = finite and math.isfinite(state[n])
    if energy < inputs.retention and end in (EXIT, TIME, PERFORATED, TUMBLED):
        row[END] = RETAINED
    if not finite:
        row[END] = NOT_FINITE
    row[MARGIN] = _margin(end, state, model, energy, inputs.retention, inputs.sought)
    return number


@lean
def failed(trial: FloatArray) -> bool:
    """Return whether a trial could not be integrated, had no strength factor above zero, or was cancelled."""
    return bool(trial[END] in (STEP_LIMIT, NOT_FINITE, NO_STRENGTH, CANCELLED))


@lean
def undecided(trial: FloatArray) -> bool:
    """Return whether a trial was still in motion at the termination time, or ended because the projectile tumbled."""
    return bool(trial[END] == TIME or trial[END] == TUMBLED)


@lean
def turned_away(trial: FloatArray) -> bool:
    """Return whether a trial ended as sought: in ricochet or, in a search for perforation, beyond the rear face."""
    return bool(trial[MARGIN] > 0.0)


@lean
def has_failed(search: SearchState) -> bool:
    """Return whether the most recent trial of a search has failed."""
    return failed(search.table.rows[search.table.filled[0] - 1])


@lean
def margin_root(left: int, right: int, trials: FloatArray) -> float:
    """Return the root of the margin between two trials by linear interpolation. [rad]"""
    share = trials[left, MARGIN] / (trials[left, MARGIN] - trials[right, MARGIN])
    return float(trials[left, ANGLE] + share * (trials[right, ANGLE] - trials[left, ANGLE]))


@lean
def margin_growth(left: int, right: int, trials: FloatArray) -> float:
    """Return the mean slope of the margin from a change to the nearest trial that ended as sought. [1/rad]

    Trials closer to the change than `CLOSE` do not count. If there is no other trial, the slope is 0.
    """
    side = 1.0 if turned_away(trials[right]) else -1.0
    change, nearest, growth = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), math.inf, 0.0
    for k in range(trials.shape[0]):
        distance = side * (trials[k, ANGLE] - change)
        if CLOSE < distance < nearest and turned_away(trials[k]):
            nearest, growth = distance, trials[k, MARGIN] / distance
    return growth
