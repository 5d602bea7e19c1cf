"""Trials of a search by outcome, compiled: one oblique angle each, in a table, computed more finely level by level."""

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
"""What the numerical settings give is the third; the last decides where the two before do not agree."""
LAST_TOLERANCE, LAST_STATIONS, LAST_POINTS = 3e-5, 16, 5
"""Relative tolerance and Gauss-Legendre points of the last level, unless finer ones are set."""


class Level(NamedTuple):
    """How finely trials are computed, and how far they narrow a change."""

    quadrature: Quadrature
    accuracy: Accuracy
    ramp_fraction: float
    smooth_ramp: bool
    stride: float
    """Longest first stride from where the level before has placed a change. [rad]"""
    tolerance: float
    """Width of the bracket. [rad]"""
    fine: bool
    """As requested, or finer."""


Levels = tuple[Level, Level, Level, Level]
MOST_STEPS = 1000
"""Steps of a rough trial: one that takes more has lost the motion, and is repeated as finely as requested."""
ROUGH_LEVEL = Level(
    quadrature=build_quadrature(stations=2, points=2),
    accuracy=Accuracy(relative_tolerance=3e-2, largest_step=1.0, most_steps=MOST_STEPS),
    ramp_fraction=5e-3,
    smooth_ramp=False,
    stride=0.0,
    tolerance=math.radians(1.25),
    fine=False,
)
"""Where a search first looks: right to a few tenths of a degree, at a quarter of the cost."""
MIDDLE_LEVEL = Level(
    quadrature=build_quadrature(stations=5, points=3),
    accuracy=Accuracy(relative_tolerance=2e-3, largest_step=LARGEST_STEP, most_steps=MOST_STEPS),
    ramp_fraction=RAMP_FRACTION,
    smooth_ramp=True,
    stride=math.radians(0.5),
    tolerance=math.radians(0.3),
    fine=False,
)
"""Right to a few hundredths of a degree, at two thirds of the cost."""


@lru_cache  # the cases of a study share one
def search_levels(*, relative_tolerance: float, stations: int, points: int, tolerance: float) -> Levels:
    """All of them, for the requested settings and width of the bracket. [rad]"""
    requested = Level(
        quadrature=build_quadrature(stations=stations, points=points),
        accuracy=Accuracy(float(relative_tolerance), LARGEST_STEP),
        ramp_fraction=RAMP_FRACTION,
        smooth_ramp=True,
        stride=math.radians(0.1),
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
    """Whether a level computes its trials more finely than another."""
    tolerance, stations, points = level.accuracy.relative_tolerance, level.quadrature.stations, level.quadrature.points
    return bool(
        tolerance < other.accuracy.relative_tolerance
        or stations.size > other.quadrature.stations.size
        or points.shape[0] > other.quadrature.points.shape[0]
    )


ANGLE, POSITION, END, MARGIN, FINE, STATE = range(6)
"""Columns of the table of trials: oblique angle, final depth of the nose tip, a value of `Termination`, how clearly the
projectile ended as sought (above zero) or not, and whether the trial was as fine as requested; then the six of the
final state. [rad, m, 1, 1, 1, and m, m, rad, m/s, m/s, rad/s]"""
COLUMNS = STATE + 6
TIME, RETAINED, EXIT = Termination.TIME.value, Termination.RETAINED.value, Termination.EXIT.value
STEP_LIMIT, NOT_FINITE = Termination.STEP_LIMIT.value, Termination.NOT_FINITE.value
PERFORATED, TUMBLED = Termination.PERFORATED.value, Termination.TUMBLED.value
NO_STRENGTH, CANCELLED = Termination.NO_STRENGTH.value, Termination.CANCELLED.value
ENERGY_FLOOR = 0.1
"""Energy at which a trial ends, over the retention energy: the energy left varies smoothly with the angle that far."""
LEAST = 1e-9
"""Smallest margin, so that none is zero."""
CLOSE = math.radians(0.3)
"""Distance from a change within which trials say too little of that growth. [rad]"""


class Strength(NamedTuple):
    """S over the oblique angle."""

    coefficients: FloatArray
    """Of a polynomial in the angle in degrees, constant first."""
    held_from: float
    """Angle from which S stays what it is there. [°]"""


class TrialInputs(NamedTuple):
    """What all trials have in common beside projectile and target."""

    velocity: float
    angle_of_attack: float
    angular_velocity: float
    strength: Strength
    compressive_strength: float
    end_time: float
    time_step: float
    """Time step of the route of panels. [s]"""
    retention: float
    """Share of the initial kinetic energy with which a projectile must leave."""
    sought: int
    """End of the trials on one side of each change: `Termination.EXIT`, or `Termination.PERFORATED`."""
    vary_inertia: bool
    """Whether to compute what a moment of inertia that was not given does to the angle."""


class TrialTable(NamedTuple):
    """All trials of a search, and the arrays to compute one more in."""

    rows: FloatArray
    """(n, `COLUMNS`), as above; those after the last trial are empty."""
    filled: IntArray
    """(1,) number of trials."""
    numbers: IntArray
    """(n,) numbers of the trials of a scan."""
    start: FloatArray
    """(6,) state at first contact."""
    work: Workspace
    linear: Linearisation
    steps: FloatArray
    control: IntArray
    """See `solver.cancellation`."""


class SearchState(NamedTuple):
    """What the parts of a search share."""

    inputs: TrialInputs
    model: Model
    levels: Levels
    table: TrialTable


def make_trial_table(size: int, control: IntArray) -> TrialTable:
    """Return an empty table for at most so many trials."""
    rows, filled, numbers = np.zeros((size, COLUMNS)), np.zeros(1, np.int64), np.empty(size, np.int64)
    work, linear, steps = make_workspace(), make_linearisation(), np.empty((1, STEP_WIDTH))
    return TrialTable(rows, filled, numbers, np.empty(6), work, linear, steps, control)


@lean
def strength_at(oblique_angle: float, strength: Strength) -> float:
    """S at an oblique angle."""
    degrees, value = min(abs(math.degrees(oblique_angle)), strength.held_from), 0.0
    for k in range(strength.coefficients.size - 1, -1, -1):
        value = value * degrees + strength.coefficients[k]
    return value


@lean
def has_strength(oblique_angle: float, strength: Strength) -> bool:
    """Whether S at an oblique angle is above zero."""
    return 0.0 < strength_at(oblique_angle, strength) < math.inf


@lean
def _margin(end: int, state: FloatArray, model: Model, energy: float, retention: float, sought: int) -> float:
    """How clearly a projectile ended as sought, above zero, or not.

    The energy left beyond the retention energy, which varies smoothly with the angle on both sides of zero; where a
    trial ended before the projectile left, it falls with the distance of the nose tip from the face sought.
    """
    if end == sought:
        margin = energy - retention
        return margin if abs(margin) > LEAST else math.copysign(LEAST, margin)
    depth = tip_depth(state, model.body)
    depth = max(model.law.thickness - depth if sought == PERFORATED else depth, 0.0) / model.body.tip
    return -retention - depth * depth


@lean
def attempt(oblique_angle: float, level: Level, search: SearchState) -> int:
    """Run one trial and append it to the table; return its number.

    If rough steps let the projectile gain energy, it is run again as finely as requested.
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
    """Whether a trial could not be integrated, or begun, or was given up."""
    return bool(trial[END] in (STEP_LIMIT, NOT_FINITE, NO_STRENGTH, CANCELLED))


@lean
def undecided(trial: FloatArray) -> bool:
    """Whether a trial was still going on at the termination time, or ended since the projectile tumbled."""
    return bool(trial[END] == TIME or trial[END] == TUMBLED)


@lean
def turned_away(trial: FloatArray) -> bool:
    """Whether a trial left as sought: through the impact face, or in a search for perforation through the rear."""
    return bool(trial[MARGIN] > 0.0)


@lean
def has_failed(search: SearchState) -> bool:
    """Whether the last trial has failed."""
    return failed(search.table.rows[search.table.filled[0] - 1])


@lean
def margin_root(left: int, right: int, trials: FloatArray) -> float:
    """Angle between two trials at which the margin, if it is linear, is zero."""
    share = trials[left, MARGIN] / (trials[left, MARGIN] - trials[right, MARGIN])
    return float(trials[left, ANGLE] + share * (trials[right, ANGLE] - trials[left, ANGLE]))


@lean
def margin_growth(left: int, right: int, trials: FloatArray) -> float:
    """Growth of the margin to the nearest trial, not too close, that was turned away; 0 without one. [1/rad]"""
    side = 1.0 if turned_away(trials[right]) else -1.0
    change, nearest, growth = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), math.inf, 0.0
    for k in range(trials.shape[0]):
        distance = side * (trials[k, ANGLE] - change)
        if CLOSE < distance < nearest and turned_away(trials[k]):
            nearest, growth = distance, trials[k, MARGIN] / distance
    return growth
