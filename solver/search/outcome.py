"""Search for the angle at which the outcome changes, as one compiled call.

A scan looks at the whole range with wide steps and few points. Every change of outcome between two of its angles is
then narrowed by itself, and together they must lead from one end of the range to the other.
"""

from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.compilation import compiled, lean
from solver.motion import Model
from solver.search.levels import ASKED, LAST, ROUGH, Level, Levels, is_finer
from solver.search.refine import MOST_TRIALS, is_same_change, refine
from solver.search.trials import (
    ANGLE,
    MARGIN,
    Strike,
    TrialWorkspace,
    attempt,
    failed,
    has_strength,
    make_trial_workspace,
    strength_at,
    turned_away,
)

CLEAR = 0.15
"""Margin above which, on both sides, a scan does not look in between."""
SMOOTH = 0.1
"""Bend of the strength factor between two trials, over its mean, up to which likewise."""


class Found(NamedTuple):
    """Result of a search."""

    trials: FloatArray
    """(n, 5) in order, columns as in `outcome_trials`."""
    brackets: IntArray
    """(m, 2) for each change of outcome, in order: the numbers of the trials on its two sides."""


@lean
def _is_smooth(left: FloatArray, right: FloatArray, strength: FloatArray) -> bool:
    """Whether there is no need to look between two trials.

    Both are clear and end alike, and nothing that depends on the angle beside its sine and cosine varies much: the
    strength factor half way is close to the mean of theirs.
    """
    if turned_away(left) != turned_away(right) or min(abs(left[MARGIN]), abs(right[MARGIN])) <= CLEAR:
        return False
    mean = 0.5 * (strength_at(left[ANGLE], strength) + strength_at(right[ANGLE], strength))
    return abs(strength_at(0.5 * (left[ANGLE] + right[ANGLE]), strength) - mean) <= SMOOTH * mean


@compiled
def _scan(
    angles: FloatArray, strike: Strike, model: Model, level: Level, room: TrialWorkspace, count: int
) -> tuple[IntArray, int]:
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
                if _is_smooth(trials[numbers[before]], trials[numbers[after]], strike.strength):
                    continue
            numbers[i] = count
            count = attempt(angles[i], strike, model, level, room, count)
            if failed(trials[count - 1]):
                return numbers[:0], count
    return numbers[numbers >= 0], count


@lean
def _lead(lowest: FloatArray, highest: FloatArray, trials: FloatArray, brackets: IntArray) -> bool:
    """Whether these changes lead from one end of the range to the other, so that none is missing between them."""
    last = lowest
    for i in range(brackets.shape[0]):
        left, right = trials[brackets[i, 0]], trials[brackets[i, 1]]
        if turned_away(left) != turned_away(last) or left[ANGLE] < last[ANGLE]:
            return False
        last = right
    return turned_away(last) == turned_away(highest)


@compiled
def search_outcome(angles: FloatArray, strike: Strike, model: Model, levels: Levels) -> Found:
    """Scan `angles`, which rise, then narrow every change of outcome level by level.

    If a trial could not be integrated, or the strength factor is not above zero at one of the angles, that trial is the
    last of the table, and there are no brackets.
    """
    room = make_trial_workspace(MOST_TRIALS + 8 * angles.size)  # with what a scan and its changes may add
    trials, brackets = room.trials, np.zeros((angles.size, 2), np.int64)
    count = changes = earlier = 0
    for angle in angles:
        if not has_strength(angle, strike.strength):
            count = attempt(angle, strike, model, levels[ROUGH], room, count)
            return Found(trials[:count], brackets[:0])
    panels = model.panels.area.size > 0  # as many at every level
    fallback, first = ASKED, ASKED if panels else ROUGH
    for scan in range(2):  # without a change, or if one is missing, the scan is repeated, more finely
        numbers, count = _scan(angles, strike, model, levels[first], room, count)
        for i in range(numbers.size - 1):
            if turned_away(trials[numbers[i]]) == turned_away(trials[numbers[i + 1]]):
                continue
            if is_finer(levels[LAST], levels[ASKED]):
                fallback = LAST  # for changes that come and go
            left, right, count = refine(numbers[i], numbers[i + 1], first, strike, model, levels, room, count)
            if failed(trials[count - 1]):
                break
            known = changes > 0 and is_same_change(brackets[changes - 1], right, trials, levels[ASKED])
            if left != right and not known:
                brackets[changes, 0], brackets[changes, 1] = left, right
                changes += 1
        if failed(trials[count - 1]):
            return Found(trials[:count], brackets[:0])
        lowest, highest = trials[numbers[0]], trials[numbers[numbers.size - 1]]
        if panels or scan == 1 or (changes > 0 and _lead(lowest, highest, trials, brackets[:changes])):
            break
        earlier, changes, first = changes, 0, fallback
    return Found(trials[:count], brackets[: changes if changes > 0 else earlier])
