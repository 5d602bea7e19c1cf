"""One change of outcome, narrowed level by level between two trials, compiled.

A root search on how clearly a trial was turned away, or not, narrows the bracket. Each finer level finds the change
again near where the one before has found it, and where they do not agree, a last one decides: their difference is the
only sign of the error there is.
"""

import math

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.compilation import compiled, lean
from solver.motion import Model
from solver.search.levels import ASKED, LAST, MIDDLE, ROUGH, STRIDE, TIMED, Level, Levels, is_finer
from solver.search.trials import ANGLE, FINE, MARGIN, Strike, TrialWorkspace, attempt, failed, turned_away, undecided

MOST_TRIALS = 2000
"""After which nothing is narrowed any further."""
KEEP_OFF = 0.45
"""How far a trial keeps off the ends of a bracket, over the tolerance, so that it can be the last."""
PATIENCE = 3
"""After so many trials that together did not halve a bracket the next one does."""
DOUBT = math.radians(0.015)
"""Distance of the places that two levels find for a change above which a finer one decides. [rad]"""
STEEP, STEEP_IF_FAR = 3.0, 8.0
"""Growth of the margin with the angle below which it always does: small errors of a motion then move the change far,
and two levels may err alike. The second is for a change that the rough level had placed far off. [1/rad]"""
FAR = math.radians(0.2)
"""That far. [rad]"""
CLOSE = math.radians(0.3)
"""Distance from a change within which trials tell too little of that growth, if its bracket is not wider. [rad]"""


@lean
def _growth(left: int, right: int, trials: FloatArray) -> float:
    """How fast the margin grows from a change to the nearest trial, not too close, that was turned away; 0 without."""
    side = 1.0 if turned_away(trials[right]) else -1.0
    change, nearest, growth = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), math.inf, 0.0
    close = max(CLOSE, trials[right, ANGLE] - trials[left, ANGLE])
    for k in range(trials.shape[0]):
        distance = side * (trials[k, ANGLE] - change)
        if close < distance < nearest and turned_away(trials[k]):
            nearest, growth = distance, trials[k, MARGIN] / distance
    return growth


@compiled
def _bracket(
    left: int, right: int, strike: Strike, model: Model, level: Level, room: TrialWorkspace, count: int
) -> tuple[int, int, int]:
    """Find the change again, from where a rougher level has found it, in growing strides.

    The first one leads beyond where the margin, if it grows as before, says that the change is.

    Returns
    -------
    tuple of three integers
        The trials on its two sides, and the number of the next trial. The sides are the same if it is not in the range.
    """
    trials, rising = room.trials, turned_away(room.trials[right])
    lowest, highest = trials[:count, ANGLE].min(), trials[:count, ANGLE].max()
    angle, stride = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), level.stride
    growth = _growth(left, right, trials[:count])
    new, count = count, attempt(angle, strike, model, level, room, count)
    beyond = turned_away(trials[new]) == rising
    if turned_away(trials[new]) and growth > 0.0:
        beyond_it = trials[new, MARGIN] / growth + KEEP_OFF * level.tolerance
        stride = max(STRIDE * level.tolerance, min(beyond_it, 4.0 * stride))
    while count < MOST_TRIALS and lowest < angle < highest and not failed(trials[new]):
        angle = max(angle - stride, lowest) if beyond else min(angle + stride, highest)
        last, new, count = new, count, attempt(angle, strike, model, level, room, count)
        if (turned_away(trials[new]) == rising) != beyond:
            return (new, last, count) if beyond else (last, new, count)
        stride *= 4.0
    return new, new, count


@compiled
def _narrow(
    left: int, right: int, strike: Strike, model: Model, level: Level, room: TrialWorkspace, count: int, patience: int
) -> tuple[int, int, int]:
    """Narrow the change between two trials to the tolerance of the level; return as above.

    A `patience` of 0 halves the bracket every time.

    Notes
    -----
    Regula falsi on the margin. The margin of an end that stays is halved (the Illinois rule), each trial keeps off the
    ends, and after as many trials as there is patience for, which together did not halve the bracket, the next does.
    """
    trials, rising, tolerance = room.trials, turned_away(room.trials[right]), level.tolerance
    margin_left, margin_right = trials[left, MARGIN], trials[right, MARGIN]
    goal, more = math.inf, patience
    while count < MOST_TRIALS and not failed(trials[count - 1]):
        a, b = trials[left, ANGLE], trials[right, ANGLE]
        width = b - a
        if width <= tolerance:
            break
        if width <= goal:
            goal, more = 0.5 * width, patience
        if more == 0:
            angle, goal = 0.5 * (a + b), math.inf
        else:
            more -= 1
            keep_off = min(KEEP_OFF * tolerance, 0.25 * width)
            angle = (a * margin_right - b * margin_left) / (margin_right - margin_left)
            angle = min(max(angle, a + keep_off), b - keep_off)
        new, count = count, attempt(angle, strike, model, level, room, count)
        if turned_away(trials[new]) == rising:
            right, margin_right, margin_left = new, trials[new, MARGIN], 0.5 * margin_left
        else:
            left, margin_left, margin_right = new, trials[new, MARGIN], 0.5 * margin_right
    return left, right, count


@compiled
def refine(
    left: int, right: int, first: int, strike: Strike, model: Model, levels: Levels, room: TrialWorkspace, count: int
) -> tuple[int, int, int]:
    """Narrow a change that the first of these levels has found, level by level; return as above.

    The last level is for a change that the two before do not place alike, or may have placed alike but wrong. It and a
    finer one are for a change beside a trial that did not leave by the termination time: no margin tells how clearly.
    """
    trials, found, begun = room.trials, np.full(len(levels), np.nan), count
    for k in range(first, len(levels)):
        timed = undecided(trials[left]) or undecided(trials[right])
        if k == TIMED and not (timed and is_finer(levels[TIMED], levels[LAST])):
            break
        if k == LAST:
            if model.panels.area.size > 0 or not is_finer(levels[LAST], levels[ASKED]):
                break
            agree = abs(found[ASKED] - found[MIDDLE]) <= max(DOUBT, levels[LAST].tolerance)  # false if one has none
            steep = STEEP_IF_FAR if abs(found[MIDDLE] - found[ROUGH]) > FAR else STEEP
            if agree and not timed and _growth(left, right, trials[:count]) >= steep:
                break
        if k >= LAST:
            trials[begun:count, FINE] = 0.0  # these only showed where to look
        begun = count
        if k > first:
            left, right, count = _bracket(left, right, strike, model, levels[k], room, count)
        if left == right:
            break
        patience = PATIENCE if k < LAST else 0  # where the last levels are needed, margins tell little
        left, right, count = _narrow(left, right, strike, model, levels[k], room, count, patience)
        if failed(trials[count - 1]):
            break
        found[k] = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE])
    return left, right, count


@lean
def is_same_change(bracket: IntArray, right: int, trials: FloatArray, level: Level) -> bool:
    """Whether a change is the one found before: rough trials may waver about it, and so lead there twice."""
    shift = trials[right, ANGLE] - trials[bracket[1], ANGLE]
    return bool(abs(shift) <= 2.0 * level.tolerance and turned_away(trials[right]) == turned_away(trials[bracket[1]]))
