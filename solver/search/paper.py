"""Searches of the source paper for a zero of the depth of the nose tip at the termination time (eqs. 7 and 8)."""

import math
from collections.abc import Callable
from typing import TypeAlias

from solver.search.types import Change, Search, SearchStatus, Trial

# At the finest tolerance, 1e-8, bisection of the paper's range takes 26 trials. Secant steps need not converge.
MOST_TRIALS = 100
"""Largest number of trials, apart from those at both ends of the range."""

Try: TypeAlias = Callable[[float], Trial]
"""Function that runs the trial at an oblique angle [rad]."""


def _ends_of_paper_search(attempt: Try, search: Search) -> tuple[Trial, Trial, Change | None]:
    """Run the trials at both ends of the range; return them, and the result of the search if they decide it."""
    first, second = (attempt(angle) for angle in search.bounds)
    if first.final_position > 0.0 and second.final_position > 0.0:
        return first, second, Change(SearchStatus.NO_RICOCHET)
    if first.final_position <= 0.0:
        return first, second, Change(SearchStatus.ALWAYS_RICOCHET, starts_turned_away=True)
    return first, second, None


def search_bisection(attempt: Try, search: Search) -> Change:
    """Find the critical angle by bisection on the sign of the final position (eq. 7)."""
    # As printed, eq. 7 averages the last two angles regardless of their outcome, and may lose the change of sign. Here
    # the bracket with the change of sign is kept.
    left, right, answer = _ends_of_paper_search(attempt, search)
    if answer is not None:
        return answer
    last = right.oblique_angle
    for _ in range(MOST_TRIALS):
        middle = attempt(0.5 * (left.oblique_angle + right.oblique_angle))
        if (middle.final_position > 0.0) == (left.final_position > 0.0):
            left = middle
        else:
            right = middle
        if abs(middle.oblique_angle - last) < search.relative_tolerance * last:
            return Change(
                SearchStatus.CONVERGED,
                angle=middle.oblique_angle,
                bracket=(left.oblique_angle, right.oblique_angle),
                deciding=(left, right),
            )
        last = middle.oblique_angle
    return Change(SearchStatus.NOT_CONVERGED, bracket=(left.oblique_angle, right.oblique_angle))


def search_secant(attempt: Try, search: Search) -> Change:
    """Find the critical angle by secant steps on the final position (eq. 8)."""
    old, new, answer = _ends_of_paper_search(attempt, search)
    if answer is not None:
        return answer
    for _ in range(MOST_TRIALS):
        rise = new.final_position - old.final_position
        # Two equal positions give no secant. NaN fails the check of the range below, and the search ends.
        angle = (
            math.nan
            if rise == 0.0
            else (new.oblique_angle - new.final_position * (new.oblique_angle - old.oblique_angle) / rise)
        )
        if not 0.0 <= angle < math.pi / 2.0:
            break
        old, new = new, attempt(angle)
        if abs(new.oblique_angle - old.oblique_angle) < search.relative_tolerance * old.oblique_angle:
            bracket = sorted((old.oblique_angle, new.oblique_angle))
            return Change(
                SearchStatus.CONVERGED,
                angle=new.oblique_angle,
                bracket=(bracket[0], bracket[1]),
                deciding=(old, new),
            )
    return Change(SearchStatus.NOT_CONVERGED)
