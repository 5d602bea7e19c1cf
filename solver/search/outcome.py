"""Search for the angles at which the outcome changes, in one compiled call.

A scan tries angles over the whole range on the coarsest of four levels of accuracy (`solver.search.trials`). Each
change of outcome between two of them is then narrowed on its own, level by level. The margin of a trial, its remaining
energy minus the retention energy, varies smoothly with the angle near a change, so regula falsi converges. Each finer
level brackets the change anew, starting at the root of the previous level. The last level is used only where the error
of a root may be too large, or where a trial beside the change is undecided. The scan is repeated on the requested level
if there are no changes, or if they do not connect the outcomes at both ends of the range.
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

# A usual search takes about twenty trials. The limit bounds the size of the table, and ends searches in which the
# outcome alternates from one angle to the next; its value is arbitrary.
MOST_TRIALS = 2000
"""Number of trials after which no bracket is narrowed any further."""
# If the root is closer to an end of the bracket than this, a trial at this distance leaves a bracket within the
# tolerance, and is the last one. The value is just under one half, so two trials, one on each side of a root, also
# leave a bracket within the tolerance.
KEEP_OFF = 0.45
"""Distance that a trial keeps from the ends of the bracket, as a fraction of the tolerance; a quarter of the bracket if
that is less. [1]"""
# Where the margin is not smooth, regula falsi may shrink a bracket slowly; bisection then bounds the number of trials.
# Three is arbitrary.
PATIENCE = 3
"""Number of trials after which a bracket is bisected if they have not halved it."""
# If the slope of the margin is estimated much too small, a stride computed from it passes over the change. The value is
# arbitrary.
GROWTH = 4.0
"""Largest ratio of two consecutive strides toward a change. [1]"""
# The error of a root is estimated by SHIFT_ERROR × (shift between two levels) + MARGIN_ERROR / (growth of the margin).
# In the strikes described at `DOUBT`, the estimate with these coefficients exceeded `DOUBT` for every strike that needs
# the last level.
SHIFT_ERROR = 0.12
"""Estimated error of a root, as a fraction of its shift between the last two levels. [1]"""
# Two levels with the same error agree on a wrong root. An error of the margin shifts a root by the error divided by the
# slope of the margin.
MARGIN_ERROR = 9e-4
"""Error of the margin that two levels may have in common. [1]"""
# Where the margin oscillates about zero, the roots of two levels are far apart, and a single trial proves nothing.
# Without this limit one unusual strike was 0.75° off.
NEAR = math.radians(0.1)
"""Largest shift of a root between two levels at which a single trial on the last level may suffice. [rad]"""
# `margin_growth` returns 0 for an unknown growth, by which the estimate would divide. With this value instead, the last
# level is always used.
LEAST_GROWTH = 1e-3
"""Smallest growth of the margin used in the error estimate. [1/rad]"""
# In 1,800 usual strikes computed without the last level, the estimate was above 0.0083° for every angle that was wrong
# by more than 0.018°, and for 45 % of all strikes.
DOUBT = math.radians(0.008)
"""Estimated error of a root above which the last level decides. [rad]"""


@once
def _bracket(left: int, right: int, tried: int, level: Level, search: SearchState) -> tuple[int, int]:
    """Bracket a change that was found on a coarser level, in strides that follow from the slope of the margin.

    Parameters
    ----------
    left, right
        Trials of the coarser level on either side of the change.
    tried
        Trial of this level at the root of the coarser one; -1 if it has not been computed.

    Returns
    -------
    tuple of two integers
        Trials on either side of the change; the same trial twice if no change was found in the range.
    """
    trials, count = search.table.rows, search.table.filled[0]
    # The margin is nearly linear near a change. The first trial is at the root of the coarser level, the second a
    # stride beyond it; most often these two form the bracket.
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
        # Two trials on the same side give a better slope. If its sign is wrong, the margin is noisy; a quarter of the
        # previous slope then makes the next stride longer.
        secant = (trials[new, MARGIN] - trials[last, MARGIN]) / (trials[new, ANGLE] - trials[last, ANGLE])
        slope = secant if secant * slope > 0.0 else 0.25 * slope
        longest = GROWTH * stride
    return new, new


@once
def _narrow(left: int, right: int, level: Level, search: SearchState) -> tuple[int, int]:
    """Narrow a change between two trials to the tolerance of the level; return the trials on either side.

    The method is regula falsi on the margin with the Illinois rule (Dowell and Jarratt 1971): the margin at an end that
    is kept is halved. Each trial keeps a distance from both ends, and a bracket that `PATIENCE` trials have not halved
    is bisected.
    """
    # The result must be a bracket, which Newton's method and the secant method do not maintain. Brent's method does,
    # but it does not place its last trial so that the bracket is within the tolerance.
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
    """Narrow a change that was found on level `first`, level by level; return the trials on either side.

    The last level is used if it is finer than the requested one, and either the estimated error of the root is above
    `DOUBT` or a trial beside the change is undecided. Its first trial is at the root of the requested level. That trial
    is the only one if no trial beside the change is undecided, the root has moved by at most `NEAR` between the last
    two levels, and the margin of that trial shifts the root by at most `DOUBT`.
    """
    trials, levels, place, shift, tried = search.table.rows, search.levels, math.nan, math.nan, -1
    begun = count = search.table.filled[0]
    for k in range(first, LAST + 1):
        if k == LAST:
            # The shift alone is not enough, because both levels may have the same error. Neither term of the estimate
            # costs a trial, and the estimate saves the last level in half of all strikes.
            decided_by_time = undecided(trials[left]) or undecided(trials[right])
            growth = max(margin_growth(left, right, trials[:count]), LEAST_GROWTH)
            sure = SHIFT_ERROR * shift + MARGIN_ERROR / growth <= DOUBT  # false if a level has no root (NaN)
            if (sure and not decided_by_time) or not is_finer(levels[LAST], levels[REQUESTED]):
                break
            # The margin of one finer trial at the root gives the error of the root, unless the margin oscillates about
            # zero, which the shift between two levels shows.
            tried = attempt(place, levels[LAST], search)
            # Within the bracket the margin may grow more slowly than farther off.
            local = (trials[right, MARGIN] - trials[left, MARGIN]) / (trials[right, ANGLE] - trials[left, ANGLE])
            close = shift <= NEAR and abs(trials[tried, MARGIN]) <= DOUBT * min(growth, abs(local))
            if close and not decided_by_time and not failed(trials[tried]):
                trials[tried, FINE] = 0.0
                break
            for i in range(begun, count):
                trials[i, FINE] = 0.0  # the last level replaces these trials
        begun = count
        # The bracket of a coarser level need not contain the change on a finer one, so it is bracketed anew.
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
    """Return whether the change just below trial `right` is the one in `bracket`, the previous bracket.

    A change is found twice where outcomes alternate on a coarse level.
    """
    shift = trials[right, ANGLE] - trials[bracket[1], ANGLE]
    return bool(abs(shift) <= 2.0 * level.tolerance and turned_away(trials[right]) == turned_away(trials[bracket[1]]))


# The margin is small near a change, so a scan tries the angles between two trials only where a margin is small. The
# search for the paper's strike then takes 14 trials; with 0.2 it takes 20, and 69 if no angles are skipped. In 400
# random strikes, 0.15 missed no change that 0.25 had found.
CLEAR = 0.15
"""Absolute margin of two adjacent trials with the same outcome, above which a scan skips the angles between. [1]"""
# A coarse trial with a smaller margin may have the wrong outcome, which could hide a change, or place it between the
# wrong angles. The ratio is at most 0.9 for a trial that ends as sought with less than the retention energy
# (`ENERGY_FLOOR`), and at least 1 for one that does not end as sought.
UNSURE = 0.95
"""Ratio of the absolute margin to the retention energy, below which a coarse trial is repeated. [1]"""
HALF_DEGREE = math.radians(0.5)
# The increase should be small enough for a linear effect, and the effect larger than the error of a trial. Two per cent
# is arbitrary.
MORE_INERTIA = 1.02
"""Factor on the moment of inertia in the trial that measures its effect. [1]"""
# If S varies strongly between two trials, they may hide a band of another outcome; the value is arbitrary.
MOST_STRENGTH_BEND = 0.1
"""Largest relative deviation of S midway between two trials from the mean of its values at both, up to which the angles
between are skipped. [1]"""
# Where S falls steeply with the angle, a projectile may be embedded at small angles because it strikes nearly along the
# normal, and at large angles because S is too small to turn it. A critical angle between two such trials was once
# missed, and the result was 19° too large.
LEAST_STRENGTH_RATIO = 0.5
"""Least ratio of the smaller to the larger S of two embedded trials at which the angles between are skipped. [1]"""


class Found(NamedTuple):
    """Result of a compiled search."""

    trials: FloatArray
    """(n, 11) trials in the order of computation, with the columns of `solver.search.trials`."""
    brackets: IntArray
    """(m, 2) rows of the trials on either side of each change of outcome, in order of the angle."""
    nearby: FloatArray
    """(3,) fractions of the initial energy left half a degree below the critical angle, half a degree above it, and
    half a degree above it with `MORE_INERTIA`; 0 if less than a tenth of the retention energy is left, NaN if not
    computed."""


@lean
def _is_smooth(left: FloatArray, right: FloatArray, strength: Strength) -> bool:
    """Return whether a scan may skip the angles between two trials.

    Both trials must have the same outcome by a clear margin, and S must vary little between them; apart from S, a trial
    depends on the angle only through its sine and cosine.
    """
    if turned_away(left) != turned_away(right) or min(abs(left[MARGIN]), abs(right[MARGIN])) <= CLEAR:
        return False
    first, last = strength_at(left[ANGLE], strength), strength_at(right[ANGLE], strength)
    if not turned_away(left) and min(first, last) < LEAST_STRENGTH_RATIO * max(first, last):
        return False
    mean = 0.5 * (first + last)
    return abs(strength_at(0.5 * (left[ANGLE] + right[ANGLE]), strength) - mean) <= MOST_STRENGTH_BEND * mean


@once
def _scan(angles: FloatArray, level: Level, search: SearchState) -> int:
    """Try every sixteenth angle, then every eighth, and so on, except between trials with a clear outcome.

    The row numbers of the trials are written to ``table.numbers``, in order of the angle.

    Returns
    -------
    int
        Number of these trials; 0 if one has failed.
    """
    trials, numbers, last = search.table.rows, search.table.numbers, angles.size - 1
    for i in range(angles.size):
        numbers[i] = -1
    # A few angles far apart are enough for most strikes; only the doubtful gaps between them are filled. A gap with a
    # change of outcome will be narrowed anyway, so it is not divided below four intervals.
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
def _connects_ends(lowest: FloatArray, highest: FloatArray, trials: FloatArray, brackets: IntArray) -> bool:
    """Return whether the changes lead from the outcome at one end of the range to that at the other.

    Otherwise a change is missing.
    """
    last = lowest
    for i in range(brackets.shape[0]):
        left, right = trials[brackets[i, 0]], trials[brackets[i, 1]]
        if turned_away(left) != turned_away(last) or left[ANGLE] < last[ANGLE]:
            return False
        last = right
    return turned_away(last) == turned_away(highest)


@once
def _energy_left(angle: float, level: Level, search: SearchState) -> float:
    """Return the fraction of the energy left at an angle. [1]

    It is 0 unless the trial ends as sought with at least a tenth of the retention energy.
    """
    trial = search.table.rows[attempt(angle, level, search)]
    search.table.filled[0] -= 1  # the next trial overwrites this one, which is not part of the search
    left = trial[MARGIN] + search.inputs.retention
    return 0.0 if failed(trial) or undecided(trial) or left < 0.0 else left


@once
def _look_nearby(angle: float, level: Level, search: SearchState, nearby: FloatArray) -> None:
    """Write the fractions of the energy left near a critical angle, see `Found.nearby`."""
    # The slope of the energy left decreases with the angle. If twice the retention energy is left half a degree above
    # the change, nothing is left half a degree below it, and no trial is needed there.
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
    """Try every half degree above an onset of ricochet while less than twice the retention energy is left.

    The trials end at the first angle with more energy left, at the next change, or at the end of the range. Changes
    found among them are narrowed and inserted into `brackets`.

    Returns
    -------
    int
        Number of brackets, including the inserted ones.
    """
    # With so little energy left, a small loss changes the outcome, and the projectile may be embedded again within a
    # degree or several degrees above. The scan alone missed such bands in 5 of 300 unusual strikes, the scan with these
    # trials in 2.
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
    """Scan the increasing `angles`, then narrow every change of outcome level by level.

    If a trial could not be integrated, or the strength factor is not above zero at one of the angles, that trial is the
    last of the table, and brackets may be missing.
    """

    def search(control: IntArray) -> Found:
        # `MOST_TRIALS` is checked only while brackets are found and narrowed, so a scan and single trials may exceed
        # it. Two scans try each angle at most twice, which takes half of the additional rows.
        table = make_trial_table(MOST_TRIALS + 8 * angles.size, control)
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
    """Run the compiled part of `search_outcome`, which fills the arrays; return the number of brackets."""
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
    """Write the brackets of the changes of outcome and return their number; 0 if a trial has failed."""
    inputs, levels, trials, numbers = search.inputs, search.levels, search.table.rows, search.table.numbers
    for i in range(angles.size):
        if not has_strength(angles[i], inputs.strength):
            attempt(angles[i], levels[ROUGH], search)
            return 0
    panels = search.model.panels.area.size > 0  # panels have a single resolution, so the first levels are skipped
    first, changes, earlier = REQUESTED if panels else ROUGH, 0, 0
    # If the changes do not connect both ends of the range, a coarse trial with a wrong outcome has hidden one, and the
    # scan is repeated on the requested level. It is also repeated if there is no change at all. This costs 3 % of the
    # time, and corrected one of 2,400 random angles from 47.6° to 18.1°.
    for scan in range(2):
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
        if panels or scan == 1 or (changes > 0 and _connects_ends(lowest, highest, trials, brackets[:changes])):
            break
        earlier, changes, first = changes, 0, REQUESTED
    return changes if changes > 0 else earlier
