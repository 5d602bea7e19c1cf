"""Search for the angle at which the outcome changes, as one compiled call.

A scan looks at the whole range with wide steps and few points. Every change of outcome between two of its angles is
then narrowed by itself, level by level, and together they must lead from one end of the range to the other. The margin
of a trial varies smoothly with the angle near a change, so secants lead to it. Each finer level finds the change again
from where the one before has placed it; where they do not agree, the last one decides.
"""

import math
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.cancellation import compute
from solver.compilation import compiled, lean, once
from solver.motion import Model
from solver.search.trials import (
    ANGLE,
    FINE,
    LAST,
    MARGIN,
    MIDDLE,
    REQUESTED,
    ROUGH,
    Level,
    Levels,
    SearchState,
    Strength,
    TrialInputs,
    TrialTable,
    attempt,
    failed,
    has_failed,
    has_strength,
    is_finer,
    make_trial_table,
    margin_growth,
    margin_root,
    strength_at,
    turned_away,
    undecided,
)
from solver.surface import Body

MOST_TRIALS = 2000
"""After which nothing is narrowed any further."""
KEEP_OFF = 0.45
"""How far a trial keeps off the ends of a bracket, over the tolerance, so that it can be the last."""
PATIENCE = 3
"""Trials after which a bracket that they did not halve is bisected."""
GROWTH = 4.0
"""Largest ratio of two strides towards a change."""
SHIFTED = 0.12
"""Error of the place of a change, over its distance from where the level before has it. [1]"""
MARGIN_ERROR = 9e-4
"""Error of the margin that both levels may have alike. It moves a change by this over the growth of the margin. [1]"""
NEAR = math.radians(0.1)
"""Distance of the places of two levels up to which one trial of the last may end it. [rad]"""
LEAST_GROWTH = 1e-3
"""Growth of the margin that is taken for none. [1/rad]"""
DOUBT = math.radians(0.008)
"""Estimate of the error of a place above which the last level decides. Of 1,800 usual strikes without that level, all
that were off by more than 0.018° had an estimate above 0.0083°, and so had 45 % of them all. [rad]"""


@once
def _bracket(left: int, right: int, tried: int, level: Level, search: SearchState) -> tuple[int, int]:
    """Find the change between two trials of a rougher level again, in strides that follow the margin.

    Parameters
    ----------
    tried
        Trial of the level where the rougher one puts the change; -1 if there is not one yet.

    Returns
    -------
    tuple of two integers
        The trials on its two sides; the same one if it is not in the range.
    """
    trials, count = search.table.rows, search.table.filled[0]
    # The margin is nearly linear near a change. The first trial is where the rougher level puts the change, the second
    # a stride beyond: most often these two are the bracket.
    rising, longest = turned_away(trials[right]), level.stride
    lowest, highest = math.inf, -math.inf
    for k in range(count):
        lowest, highest = min(lowest, trials[k, ANGLE]), max(highest, trials[k, ANGLE])
    slope = (trials[right, MARGIN] - trials[left, MARGIN]) / (trials[right, ANGLE] - trials[left, ANGLE])
    angle = margin_root(left, right, trials)
    new = attempt(angle, level, search) if tried < 0 else tried
    while new < MOST_TRIALS and lowest < angle < highest and not failed(trials[new]):
        beyond = turned_away(trials[new]) == rising
        stride = min(abs(trials[new, MARGIN] / slope) + KEEP_OFF * level.tolerance, longest)
        angle = max(angle - stride, lowest) if beyond else min(angle + stride, highest)
        last, new = new, attempt(angle, level, search)
        if (turned_away(trials[new]) == rising) != beyond:
            return (new, last) if beyond else (last, new)
        # Two trials on one side correct the slope; one of the wrong sign has met noise, and lengthens the next stride.
        secant = (trials[new, MARGIN] - trials[last, MARGIN]) / (trials[new, ANGLE] - trials[last, ANGLE])
        slope = secant if secant * slope > 0.0 else 0.25 * slope
        longest = GROWTH * stride
    return new, new


@once
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


@once
def refine(left: int, right: int, first: int, search: SearchState) -> tuple[int, int]:
    """Narrow a change that the first of these levels has found, level by level; return as above.

    The last level is for a change whose place may be off by more than `DOUBT`, by the distance of the two before and by
    the growth of the margin, and for one beside a trial that was in motion at the termination time. Its first trial, at
    that place, ends it where the margin there moves the change by no more than `DOUBT`.
    """
    trials, levels, place, shift, tried = search.table.rows, search.levels, math.nan, math.nan, -1
    begun = count = search.table.filled[0]
    for k in range(first, LAST + 1):
        if k == LAST:
            # Levels that err alike agree on a wrong place. An error of the margin moves a change the further, the less
            # the margin grows with the angle, so a slow growth is a doubt even where they agree. Both cost no trial.
            decided_by_time = undecided(trials[left]) or undecided(trials[right])
            growth = max(margin_growth(left, right, trials[:count]), LEAST_GROWTH)
            sure = SHIFTED * shift + MARGIN_ERROR / growth <= DOUBT  # false if one level has no place
            if (sure and not decided_by_time) or not is_finer(levels[LAST], levels[REQUESTED]):
                break
            # The margin of one finer trial at the place says how far off it is. Not so where the margin wavers about
            # zero: there the levels before are far apart.
            tried = attempt(place, levels[LAST], search)
            # Between the ends of the bracket the margin may grow more slowly than further off.
            local = (trials[right, MARGIN] - trials[left, MARGIN]) / (trials[right, ANGLE] - trials[left, ANGLE])
            close = shift <= NEAR and abs(trials[tried, MARGIN]) <= DOUBT * min(growth, abs(local))
            if close and not decided_by_time and not failed(trials[tried]):
                trials[tried, FINE] = 0.0
                break
            for i in range(begun, count):
                trials[i, FINE] = 0.0  # these only showed where to look
        begun = count
        # The bracket of a rougher level need not hold the change of a finer one, which is bracketed anew.
        if k > first:
            left, right = _bracket(left, right, tried, levels[k], search)
        if left == right:
            break
        left, right = _narrow(left, right, levels[k], search)
        count = search.table.filled[0]
        if failed(trials[count - 1]) or search.model.panels.area.size > 0:
            break
        earlier, place = place, margin_root(left, right, trials)
        shift = abs(place - earlier) if k > MIDDLE else math.nan
    return left, right


@lean
def is_same_change(bracket: IntArray, right: int, trials: FloatArray, level: Level) -> bool:
    """Whether a change is the one found before: rough trials may waver about it, and so lead there twice."""
    shift = trials[right, ANGLE] - trials[bracket[1], ANGLE]
    return bool(abs(shift) <= 2.0 * level.tolerance and turned_away(trials[right]) == turned_away(trials[bracket[1]]))


CLEAR = 0.15
"""Margin above which, on both sides, a scan does not look in between."""
UNSURE = 0.95
"""Margin of a rough trial, over the retention energy, below which it is run again as finely as set."""
HALF_DEGREE = math.radians(0.5)
MORE_INERTIA = 1.02
"""Ratio of moments of inertia of which the effect is computed."""
SMOOTH = 0.1
"""Bend of the strength factor between two trials, over its mean, up to which a scan does not look in between."""
KEEPS = 0.5
"""Ratio of the strength factors at two trials that retain the projectile, down to which a scan does not look in
between."""


class Found(NamedTuple):
    """Result of a search."""

    trials: FloatArray
    """(n, 11) in order, columns as in `solver.search.trials`."""
    brackets: IntArray
    """(m, 2) for each change of outcome, in order: the numbers of the trials on its two sides."""
    nearby: FloatArray
    """(3,) share of the energy left half a degree below the critical angle, half a degree above it, and there with
    `MORE_INERTIA`; 0 where less than a tenth of the retention energy is left, NaN where it was not computed."""


@lean
def _is_smooth(left: FloatArray, right: FloatArray, strength: Strength) -> bool:
    """Whether there is no need to look between two trials.

    Both are clear and end alike, and nothing that depends on the angle beside its sine and cosine varies much: the
    strength factor half way is close to the mean of theirs. Where it falls far, a projectile may be retained at small
    angles since they are small, and at large ones since nothing resists it there.
    """
    if turned_away(left) != turned_away(right) or min(abs(left[MARGIN]), abs(right[MARGIN])) <= CLEAR:
        return False
    first, last = strength_at(left[ANGLE], strength), strength_at(right[ANGLE], strength)
    if not turned_away(left) and min(first, last) < KEEPS * max(first, last):
        return False
    mean = 0.5 * (first + last)
    return abs(strength_at(0.5 * (left[ANGLE] + right[ANGLE]), strength) - mean) <= SMOOTH * mean


@once
def _scan(angles: FloatArray, level: Level, search: SearchState) -> int:
    """Try every sixteenth angle, then every eighth and so on, but not where there is no need to look.

    The first of the numbers of the table become those of the trials in the order of their angles.

    Returns
    -------
    int
        How many there are; 0 if one could not be integrated.
    """
    trials, numbers, last = search.table.rows, search.table.numbers, angles.size - 1
    for i in range(angles.size):
        numbers[i] = -1
    # From wide to narrow: a few angles far apart settle most strikes, and only gaps that leave a doubt are filled.
    for stride in (16, 8, 4, 2, 1):
        for i in range(angles.size):
            if numbers[i] >= 0 or (i % stride != 0 and i != last):
                continue
            if stride < 16:
                before, after = numbers[i - stride], numbers[min(i + stride, last)]
                if before < 0 or after < 0:
                    continue
                left, right = trials[before], trials[after]
                if stride < 4 and turned_away(left) != turned_away(right):
                    continue
                if _is_smooth(left, right, search.inputs.strength):
                    continue
            numbers[i] = attempt(angles[i], level, search)
            # A rough trial that ends near the retention energy may err in its outcome, which says where to look next.
            if not level.fine and abs(trials[numbers[i], MARGIN]) < UNSURE * search.inputs.retention:
                numbers[i] = attempt(angles[i], search.levels[REQUESTED], search)
            if has_failed(search):
                return 0
    count = 0
    for i in range(angles.size):
        if numbers[i] >= 0:
            numbers[count] = numbers[i]
            count += 1
    return count


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


@once
def _energy_left(angle: float, level: Level, search: SearchState) -> float:
    """Share of the energy left at an angle; 0 where less than a tenth of the retention energy is left."""
    trial = search.table.rows[attempt(angle, level, search)]
    search.table.filled[0] -= 1  # not a trial of the search
    left = trial[MARGIN] + search.inputs.retention
    return 0.0 if failed(trial) or undecided(trial) or left < 0.0 else left


@once
def _look_nearby(angle: float, level: Level, search: SearchState, nearby: FloatArray) -> None:
    """Write the shares of the energy left near a critical angle; see `Found`.

    The energy left grows ever more slowly with the angle. So where it is twice the retention energy half a degree
    above, nothing is left half a degree below, and no trial is needed.
    """
    inputs, model, below, above = search.inputs, search.model, angle - HALF_DEGREE, angle + HALF_DEGREE
    nearby[0], nearby[1] = 0.0, _energy_left(above, level, search)
    if nearby[1] < 2.0 * inputs.retention and below >= 0.0:
        nearby[0] = _energy_left(below, level, search)
    if inputs.vary_inertia:
        body, inertia = model.body, MORE_INERTIA * model.body.moment_of_inertia
        heavier = Body(body.outline, body.corners, body.tip, body.mass, inertia, body.bounds)
        varied = Model(heavier, model.law, model.quadrature, model.panels)
        nearby[2] = _energy_left(above, level, SearchState(inputs, varied, search.levels, search.table))


@once
def _walk_up(change: int, changes: int, level: Level, search: SearchState, brackets: IntArray) -> int:
    """Look every half degree above an onset while less than twice the retention energy is left.

    There a small loss turns the outcome: the projectile may stay in again within a degree, or several degrees above.
    Where more is left, at the next change or at the end of the range, the walk ends. Changes on the way are narrowed.

    Returns
    -------
    int
        How many brackets there are, with those that were found, in order.
    """
    trials, filled = search.table.rows, search.table.filled
    last, at, end = brackets[change, 1], change + 1, 0
    if change + 1 < changes:
        end = brackets[change + 1, 0]
    else:
        for i in range(filled[0]):
            end = i if trials[i, ANGLE] > trials[end, ANGLE] else end
    while last != end and filled[0] < MOST_TRIALS and changes < brackets.shape[0]:
        angle = trials[last, ANGLE] + HALF_DEGREE
        new = attempt(angle, level, search) if angle < trials[end, ANGLE] else end
        if has_failed(search):
            break
        if turned_away(trials[new]) != turned_away(trials[last]):
            left, right = refine(last, new, REQUESTED, search)
            if has_failed(search):
                break
            if left != right:
                for i in range(changes, at, -1):
                    brackets[i, 0], brackets[i, 1] = brackets[i - 1, 0], brackets[i - 1, 1]
                brackets[at, 0], brackets[at, 1] = left, right
                at, changes = at + 1, changes + 1
        if turned_away(trials[new]) and trials[new, MARGIN] >= search.inputs.retention:
            break
        last = new
    return changes


def search_outcome(angles: FloatArray, inputs: TrialInputs, model: Model, levels: Levels) -> Found:
    """Scan `angles`, which rise, then narrow every change of outcome level by level.

    If a trial could not be integrated, or the strength factor is not above zero at one of the angles, that trial is the
    last of the table, and there are no brackets.
    """

    def search(control: IntArray) -> Found:
        table = make_trial_table(MOST_TRIALS + 8 * angles.size, control)  # with what a scan and its changes may add
        brackets, nearby = np.empty((angles.size, 2), np.int64), np.full(3, np.nan)
        changes = _search(angles, inputs, model, levels, table, brackets, nearby)
        return Found(table.rows[: table.filled[0]], brackets[:changes], nearby)

    return compute(search, model.panels.area.size)


@compiled
def _search(
    angles: FloatArray,
    inputs: TrialInputs,
    model: Model,
    levels: Levels,
    table: TrialTable,
    brackets: IntArray,
    nearby: FloatArray,
) -> int:
    """Do the work of `search_outcome`: fill the arrays, and return how many brackets there are."""
    search = SearchState(inputs, model, levels, table)
    changes = _find_changes(angles, search, brackets)
    panels = model.panels.area.size > 0
    for i in range(changes):
        if turned_away(table.rows[brackets[i, 1]]):
            _look_nearby(table.rows[brackets[i, 1], ANGLE], levels[REQUESTED if panels else MIDDLE], search, nearby)
            if nearby[1] < 2.0 * inputs.retention:
                changes = _walk_up(i, changes, levels[REQUESTED], search, brackets)
            break
    return changes


@once
def _find_changes(angles: FloatArray, search: SearchState, brackets: IntArray) -> int:
    """Write the brackets of the changes of outcome, see `Found`; return how many there are, 0 if a trial has failed."""
    inputs, levels, trials, numbers = search.inputs, search.levels, search.table.rows, search.table.numbers
    for i in range(angles.size):
        if not has_strength(angles[i], inputs.strength):
            attempt(angles[i], levels[ROUGH], search)
            return 0
    panels = search.model.panels.area.size > 0  # as many at every level
    first, changes, earlier = REQUESTED if panels else ROUGH, 0, 0
    # Every change is narrowed by itself. If together they do not lead from one end of the range to the other, a rough
    # trial has hidden one.
    for scan in range(2):  # without a change, or if one is missing, the scan is repeated, more finely
        count = _scan(angles, levels[first], search)
        for i in range(count - 1):
            if turned_away(trials[numbers[i]]) == turned_away(trials[numbers[i + 1]]):
                continue
            left, right = refine(numbers[i], numbers[i + 1], first, search)
            if has_failed(search):
                break
            known = changes > 0 and is_same_change(brackets[changes - 1], right, trials, levels[REQUESTED])
            if left != right and not known:
                brackets[changes, 0], brackets[changes, 1] = left, right
                changes += 1
        if has_failed(search):
            return 0
        lowest, highest = trials[numbers[0]], trials[numbers[count - 1]]
        if panels or scan == 1 or (changes > 0 and _lead(lowest, highest, trials, brackets[:changes])):
            break
        earlier, changes, first = changes, 0, REQUESTED
    return changes if changes > 0 else earlier
