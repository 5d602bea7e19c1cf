"""Search for the angle at which the outcome changes, as one compiled call.

A scan looks at the whole range with wide steps and few points. Where the outcome changes between two of its angles, a
root search on how clearly a trial was turned away, or not, narrows the bracket. Two finer levels find the change again
near there, and where they do not agree, a last one: its difference is the only sign of the error there is.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from solver.adaptive import Accuracy, integrate_adaptive
from solver.arrays import FloatArray
from solver.compilation import compiled, lean
from solver.events import LODGED_ENERGY, End, Run, tip_depth
from solver.fixed_step import integrate_fixed
from solver.loads import Quadrature
from solver.motion import STEP_WIDTH, Model, Work, kinetic_energy, make_work, start_state
from solver.rings import Law
from solver.rosenbrock import Linearisation, make_linearisation

ANGLE, POSITION, END, MARGIN, FINE = range(5)
"""Columns of the table of trials: oblique angle, final depth of the nose tip, a value of `End`, how clearly the
projectile was turned away (above zero) or not, and whether the trial was as fine as asked for. [rad, m, 1, 1, 1]"""
MOST_TRIALS = 2000
"""After which nothing is narrowed any further. The table has room for what a scan and its changes may add to them."""
STRIDE, KEEP_OFF = 0.85, 0.45
"""Over the tolerance: the first stride, so that two trials confirm what a level before has found; and how far a trial
keeps off the ends of a bracket, so that it can be the last."""
DOUBT = math.radians(0.015)
"""Distance of the places that two levels find for a change above which a finer one decides. [rad]"""
STEEP = 4.0
"""Growth of the margin with the angle below which it always does: small errors of a motion then move the change far,
and two levels may err alike. [1/rad]"""
CLOSE = math.radians(0.3)
"""Distance from a change within which trials tell too little of that growth, if its bracket is not wider. [rad]"""
ROUGH, MIDDLE, ASKED, LAST = range(4)
"""Levels, by how finely they compute; what was asked for is the third."""
CLEAR = 0.15
"""Margin above which, on both sides, a scan does not look in between."""
TAME = 0.1
"""Bend of the strength factor between two trials, over its mean, up to which likewise."""
EXIT, STEP_LIMIT, NOT_FINITE = End.EXIT.value, End.STEP_LIMIT.value, End.NOT_FINITE.value


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


class Level(NamedTuple):
    """How finely trials are computed, and how far they narrow a change."""

    quadrature: Quadrature
    accuracy: Accuracy
    ramp_fraction: float
    smooth_ramp: bool
    stride: float
    """How far the change may lie from where the level before has found it; a first guess. [rad]"""
    tolerance: float
    """Width of the bracket. [rad]"""
    fine: bool
    """As asked for, or finer."""


Levels = tuple[Level, Level, Level, Level]


class Room(NamedTuple):
    """Room for one trial, and the table of trials."""

    work: Work
    linear: Linearisation
    steps: FloatArray
    trials: FloatArray


class Found(NamedTuple):
    """Result of a search."""

    trials: FloatArray
    """(n, 5) in order, columns as above."""
    brackets: npt.NDArray[np.int64]
    """(m, 2) for each change of outcome, in order: the numbers of the trials on its two sides."""


@lean
def strength_at(oblique_angle: float, strength: FloatArray) -> float:
    """S at an oblique angle."""
    degrees, value = abs(math.degrees(oblique_angle)), 0.0
    for k in range(strength.size - 1, -1, -1):
        value = value * degrees + strength[k]
    return value


@lean
def _margin(run: Run, model: Model, initial_energy: float) -> float:
    """How clearly a projectile was turned away, above zero, or not; near zero at the critical angle.

    Turned away, it is the energy left; lodged or at rest, it grows with the depth of the tip.
    """
    least = 1e-9
    energy = kinetic_energy(run.state, model.body) / initial_energy - LODGED_ENERGY
    if run.end == End.EXIT:
        return max(energy, least)
    depth = max(tip_depth(run.state, model.body), 0.0) / model.body.tip
    return min(energy, 0.0) - max(depth * depth, least)


@compiled
def _try(oblique_angle: float, strike: Strike, model: Model, level: Level, room: Room, count: int) -> int:
    """Run one trial and write it into the table, as number `count`; return the number of the next."""
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
    row = room.trials[count]
    row[ANGLE], row[POSITION], row[END] = oblique_angle, tip_depth(run.state, model.body), run.end.value
    if not np.isfinite(run.state).all():
        row[END] = NOT_FINITE
    row[FINE] = 1.0 if level.fine else 0.0
    row[MARGIN] = _margin(run, model, kinetic_energy(start, model.body))
    return count + 1


@lean
def _failed(trial: FloatArray) -> bool:
    return bool(trial[END] == STEP_LIMIT or trial[END] == NOT_FINITE)


@lean
def _turned_away(trial: FloatArray) -> bool:
    return bool(trial[END] == EXIT)


@lean
def _growth(left: int, right: int, trials: FloatArray) -> float:
    """How fast the margin grows from a change to the nearest trial, not too close, that was turned away; 0 without."""
    side = 1.0 if _turned_away(trials[right]) else -1.0
    change, nearest, growth = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), math.inf, 0.0
    close = max(CLOSE, trials[right, ANGLE] - trials[left, ANGLE])
    for k in range(trials.shape[0]):
        distance = side * (trials[k, ANGLE] - change)
        if close < distance < nearest and _turned_away(trials[k]):
            nearest, growth = distance, trials[k, MARGIN] / distance
    return growth


@compiled
def _bracket(
    left: int, right: int, strike: Strike, model: Model, level: Level, room: Room, count: int
) -> tuple[int, int, int]:
    """Find the change again, from where a rougher level has found it, in growing strides.

    The first one leads beyond where the margin, if it grows as before, says that the change is.

    Returns
    -------
    tuple of three integers
        The trials on its two sides, and the number of the next trial. The sides are the same if it is not in the range.
    """
    trials, rising = room.trials, _turned_away(room.trials[right])
    lowest, highest = trials[:count, ANGLE].min(), trials[:count, ANGLE].max()
    angle, stride = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), level.stride
    growth = _growth(left, right, trials[:count])
    new, count = count, _try(angle, strike, model, level, room, count)
    beyond = _turned_away(trials[new]) == rising
    if _turned_away(trials[new]) and growth > 0.0:
        beyond_it = trials[new, MARGIN] / growth + KEEP_OFF * level.tolerance
        stride = max(STRIDE * level.tolerance, min(beyond_it, 4.0 * stride))
    while count < MOST_TRIALS and lowest < angle < highest and not _failed(trials[new]):
        angle = max(angle - stride, lowest) if beyond else min(angle + stride, highest)
        last, new, count = new, count, _try(angle, strike, model, level, room, count)
        if (_turned_away(trials[new]) == rising) != beyond:
            return (new, last, count) if beyond else (last, new, count)
        stride *= 4.0
    return new, new, count


@compiled
def _narrow(
    left: int, right: int, strike: Strike, model: Model, level: Level, room: Room, count: int
) -> tuple[int, int, int]:
    """Narrow the change between two trials to the tolerance of the level; return as above.

    Notes
    -----
    Regula falsi on the margin. The margin of an end that stays is halved (the Illinois rule), each trial keeps off the
    ends, and after three trials that together did not halve the bracket the next one does.
    """
    trials, rising, tolerance = room.trials, _turned_away(room.trials[right]), level.tolerance
    margin_left, margin_right = trials[left, MARGIN], trials[right, MARGIN]
    goal, patience = math.inf, 3
    while count < MOST_TRIALS and not _failed(trials[count - 1]):
        a, b = trials[left, ANGLE], trials[right, ANGLE]
        width = b - a
        if width <= tolerance:
            break
        if width <= goal:
            goal, patience = 0.5 * width, 3
        if patience == 0:
            angle, goal = 0.5 * (a + b), math.inf
        else:
            patience -= 1
            keep_off = min(KEEP_OFF * tolerance, 0.25 * width)
            angle = (a * margin_right - b * margin_left) / (margin_right - margin_left)
            angle = min(max(angle, a + keep_off), b - keep_off)
        new, count = count, _try(angle, strike, model, level, room, count)
        if _turned_away(trials[new]) == rising:
            right, margin_right, margin_left = new, trials[new, MARGIN], 0.5 * margin_left
        else:
            left, margin_left, margin_right = new, trials[new, MARGIN], 0.5 * margin_right
    return left, right, count


@lean
def _is_tame(left: FloatArray, right: FloatArray, strength: FloatArray) -> bool:
    """Whether there is no need to look between two trials.

    Both are clear and end alike, and nothing that depends on the angle beside its sine and cosine varies much: the
    strength factor half way is close to the mean of theirs.
    """
    if _turned_away(left) != _turned_away(right) or min(abs(left[MARGIN]), abs(right[MARGIN])) <= CLEAR:
        return False
    mean = 0.5 * (strength_at(left[ANGLE], strength) + strength_at(right[ANGLE], strength))
    return abs(strength_at(0.5 * (left[ANGLE] + right[ANGLE]), strength) - mean) <= TAME * mean


@compiled
def _scan(
    angles: FloatArray, strike: Strike, model: Model, level: Level, room: Room, count: int
) -> tuple[npt.NDArray[np.int64], int]:
    """Try every fourth angle, then every second and every one, but not where there is no need to look.

    Returns
    -------
    tuple
        The numbers of the trials in the order of their angles, and the number of the next. If one could not be
        integrated, it is the last.
    """
    trials, numbers, last = room.trials, np.full(angles.size, -1), angles.size - 1
    for stride in (4, 2, 1):
        for i in range(angles.size):
            if numbers[i] >= 0 or (i % stride != 0 and i != last):
                continue
            if stride < 4:
                before = i - stride
                after = min(i + stride, last)
                if numbers[before] < 0 or numbers[after] < 0:
                    continue
                if _is_tame(trials[numbers[before]], trials[numbers[after]], strike.strength):
                    continue
            numbers[i] = count
            count = _try(angles[i], strike, model, level, room, count)
            if _failed(trials[count - 1]):
                return numbers[:0], count
    return numbers[numbers >= 0], count


@lean
def _same(bracket: npt.NDArray[np.int64], right: int, trials: FloatArray, level: Level) -> bool:
    """Whether a change is the one found before: rough trials may waver about it, and so lead there twice."""
    shift = trials[right, ANGLE] - trials[bracket[1], ANGLE]
    return bool(abs(shift) <= 2.0 * level.tolerance and _turned_away(trials[right]) == _turned_away(trials[bracket[1]]))


@lean
def _is_finer(level: Level, other: Level) -> bool:
    tolerance, stations, points = level.accuracy.relative_tolerance, level.quadrature.stations, level.quadrature.points
    return bool(
        tolerance < other.accuracy.relative_tolerance
        or stations.shape[0] > other.quadrature.stations.shape[0]
        or points.shape[0] > other.quadrature.points.shape[0]
    )


@compiled
def _settle(
    left: int, right: int, first: int, strike: Strike, model: Model, levels: Levels, room: Room, count: int
) -> tuple[int, int, int]:
    """Narrow a change that the first of these levels has found, level by level; return as above.

    The last level is for a change that the two before do not place alike, or may have placed alike but wrong.
    """
    trials, found, begun = room.trials, np.full(len(levels), np.nan), count
    for k in range(first, len(levels)):
        if k == LAST:
            if model.panels.area.size > 0 or not _is_finer(levels[LAST], levels[ASKED]):
                break
            apart = abs(found[ASKED] - found[MIDDLE])  # not a number where nothing but the scan came before
            if _growth(left, right, trials[:count]) >= STEEP and apart <= max(DOUBT, levels[LAST].tolerance):
                break
            trials[begun:count, FINE] = 0.0  # these only showed where to look
        begun = count
        if k > first:
            left, right, count = _bracket(left, right, strike, model, levels[k], room, count)
        if left == right:
            break
        left, right, count = _narrow(left, right, strike, model, levels[k], room, count)
        if _failed(trials[count - 1]):
            break
        found[k] = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE])
    return left, right, count


@lean
def _lead(lowest: FloatArray, highest: FloatArray, trials: FloatArray, brackets: npt.NDArray[np.int64]) -> bool:
    """Whether these changes lead from one end of the range to the other, so that none is missing between them."""
    turned_away = _turned_away(lowest)
    for i in range(brackets.shape[0]):
        if _turned_away(trials[brackets[i, 0]]) != turned_away:
            return False
        turned_away = _turned_away(trials[brackets[i, 1]])
    return bool(turned_away == _turned_away(highest))


@compiled
def search_outcome(angles: FloatArray, strike: Strike, model: Model, levels: Levels) -> Found:
    """Scan `angles`, which rise, then narrow every change of outcome level by level.

    If a trial could not be integrated, it is the last of the table, and there are no brackets.
    """
    room = Room(
        make_work(), make_linearisation(), np.empty((1, STEP_WIDTH)), np.zeros((MOST_TRIALS + 8 * angles.size, 5))
    )
    trials, brackets = room.trials, np.zeros((angles.size, 2), np.int64)
    count = changes = earlier = 0
    panels = model.panels.area.size > 0  # as many at every level
    fallback, first = ASKED, ASKED if panels else ROUGH
    for scan in range(2):  # without a change, or if one is missing, the scan is repeated, more finely
        numbers, count = _scan(angles, strike, model, levels[first], room, count)
        for i in range(numbers.size - 1):
            if _turned_away(trials[numbers[i]]) == _turned_away(trials[numbers[i + 1]]):
                continue
            if _is_finer(levels[LAST], levels[ASKED]):
                fallback = LAST  # for changes that come and go
            left, right, count = _settle(numbers[i], numbers[i + 1], first, strike, model, levels, room, count)
            if _failed(trials[count - 1]):
                break
            if left != right and not (changes > 0 and _same(brackets[changes - 1], right, trials, levels[ASKED])):
                brackets[changes, 0], brackets[changes, 1] = left, right
                changes += 1
        if _failed(trials[count - 1]):
            return Found(trials[:count], brackets[:0])
        lowest, highest = trials[numbers[0]], trials[numbers[numbers.size - 1]]
        if panels or scan == 1 or (changes > 0 and _lead(lowest, highest, trials, brackets[:changes])):
            break
        earlier, changes, first = changes, 0, fallback
    return Found(trials[:count], brackets[: changes if changes > 0 else earlier])
