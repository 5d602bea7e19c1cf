"""One change of outcome, narrowed level by level between two trials, compiled.

The margin of a trial varies smoothly with the angle near a change, so secants lead to it. Each finer level finds the
change again from where the one before has placed it; where they do not agree, the last one decides.
"""

import math

from solver.arrays import FloatArray, IntArray
from solver.compilation import lean
from solver.search.levels import LAST, MIDDLE, REQUESTED, Level, is_finer
from solver.search.trials import (
    ANGLE,
    FINE,
    MARGIN,
    SearchState,
    attempt,
    failed,
    has_failed,
    turned_away,
    undecided,
)

MOST_TRIALS = 2000
"""After which nothing is narrowed any further."""
KEEP_OFF = 0.45
"""How far a trial keeps off the ends of a bracket, over the tolerance, so that it can be the last."""
PATIENCE = 3
"""Trials after which a bracket that they did not halve is bisected."""
GROWTH = 4.0
"""Largest ratio of two strides towards a change."""
STEEP = 7.0
"""Growth of the margin below which the last level decides: small errors then move a change far. [1/rad]"""
DOUBT = math.radians(0.006)
"""Distance of the places that two levels find for a change above which it does, too. [rad]"""
CLOSE = math.radians(0.3)
"""Distance from a change within which trials say too little of that growth. [rad]"""


@lean
def _place(left: int, right: int, trials: FloatArray) -> float:
    """Angle between two trials at which the margin, if it is linear, is zero."""
    share = trials[left, MARGIN] / (trials[left, MARGIN] - trials[right, MARGIN])
    return float(trials[left, ANGLE] + share * (trials[right, ANGLE] - trials[left, ANGLE]))


@lean
def _growth(left: int, right: int, trials: FloatArray) -> float:
    """Growth of the margin to the nearest trial, not too close, that was turned away; 0 without one. [1/rad]"""
    side = 1.0 if turned_away(trials[right]) else -1.0
    change, nearest, growth = 0.5 * (trials[left, ANGLE] + trials[right, ANGLE]), math.inf, 0.0
    for k in range(trials.shape[0]):
        distance = side * (trials[k, ANGLE] - change)
        if CLOSE < distance < nearest and turned_away(trials[k]):
            nearest, growth = distance, trials[k, MARGIN] / distance
    return growth


@lean
def _bracket(left: int, right: int, level: Level, search: SearchState) -> tuple[int, int]:
    """Find the change between two trials of a rougher level again, in strides that follow the margin.

    Returns
    -------
    tuple of two integers
        The trials on its two sides; the same one if it is not in the range.
    """
    trials, count = search.table.rows, search.table.filled[0]
    rising, longest = turned_away(trials[right]), level.stride
    lowest, highest = math.inf, -math.inf
    for k in range(count):
        lowest, highest = min(lowest, trials[k, ANGLE]), max(highest, trials[k, ANGLE])
    slope = (trials[right, MARGIN] - trials[left, MARGIN]) / (trials[right, ANGLE] - trials[left, ANGLE])
    angle = _place(left, right, trials)
    new = attempt(angle, level, search)
    while new < MOST_TRIALS and lowest < angle < highest and not failed(trials[new]):
        beyond = turned_away(trials[new]) == rising
        stride = min(abs(trials[new, MARGIN] / slope) + KEEP_OFF * level.tolerance, longest)
        angle = max(angle - stride, lowest) if beyond else min(angle + stride, highest)
        last, new = new, attempt(angle, level, search)
        if (turned_away(trials[new]) == rising) != beyond:
            return (new, last) if beyond else (last, new)
        secant = (trials[new, MARGIN] - trials[last, MARGIN]) / (trials[new, ANGLE] - trials[last, ANGLE])
        slope = secant if secant * slope > 0.0 else 0.25 * slope
        longest = GROWTH * stride
    return new, new


@lean
def _narrow(left: int, right: int, level: Level, search: SearchState) -> tuple[int, int]:
    """Narrow the change between two trials to the tolerance of the level; return as above.

    Notes
    -----
    Regula falsi on the margin. The margin of an end that stays is halved (the Illinois rule), each trial keeps off the
    ends, and where `PATIENCE` trials together did not halve the bracket, the next does.
    """
    trials, tolerance = search.table.rows, level.tolerance
    rising = turned_away(trials[right])
    margin_left, margin_right = trials[left, MARGIN], trials[right, MARGIN]
    goal, more = math.inf, PATIENCE
    while search.table.filled[0] < MOST_TRIALS and not has_failed(search):
        a, b = trials[left, ANGLE], trials[right, ANGLE]
        width = b - a
        if width <= tolerance:
            break
        if width <= goal:
            goal, more = 0.5 * width, PATIENCE
        if more == 0:
            angle, goal = 0.5 * (a + b), math.inf
        else:
            more -= 1
            keep_off = min(KEEP_OFF * tolerance, 0.25 * width)
            angle = (a * margin_right - b * margin_left) / (margin_right - margin_left)
            angle = min(max(angle, a + keep_off), b - keep_off)
        new = attempt(angle, level, search)
        if turned_away(trials[new]) == rising:
            right, margin_right, margin_left = new, trials[new, MARGIN], 0.5 * margin_left
        else:
            left, margin_left, margin_right = new, trials[new, MARGIN], 0.5 * margin_right
    return left, right


@lean
def refine(left: int, right: int, first: int, search: SearchState) -> tuple[int, int]:
    """Narrow a change that the first of these levels has found, level by level; return as above.

    The last level is for a change that the two before do not place alike, or where the margin grows slowly, and for one
    beside a trial that was in motion at the termination time.
    """
    trials, levels, place, shift = search.table.rows, search.levels, math.nan, math.nan
    begun = count = search.table.filled[0]
    for k in range(first, LAST + 1):
        if k == LAST:
            decided_by_time = undecided(trials[left]) or undecided(trials[right])
            sure = shift <= DOUBT and _growth(left, right, trials[:count]) >= STEEP  # false if one level has none
            if (sure and not decided_by_time) or not is_finer(levels[LAST], levels[REQUESTED]):
                break
            for i in range(begun, count):
                trials[i, FINE] = 0.0  # these only showed where to look
        begun = count
        if k > first:
            left, right = _bracket(left, right, levels[k], search)
        if left == right:
            break
        left, right = _narrow(left, right, levels[k], search)
        count = search.table.filled[0]
        if failed(trials[count - 1]) or search.model.panels.area.size > 0:
            break
        earlier, place = place, _place(left, right, trials)
        shift = abs(place - earlier) if k > MIDDLE else math.nan
    return left, right


@lean
def is_same_change(bracket: IntArray, right: int, trials: FloatArray, level: Level) -> bool:
    """Whether a change is the one found before: rough trials may waver about it, and so lead there twice."""
    shift = trials[right, ANGLE] - trials[bracket[1], ANGLE]
    return bool(abs(shift) <= 2.0 * level.tolerance and turned_away(trials[right]) == turned_away(trials[bracket[1]]))
