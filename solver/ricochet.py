"""Critical ricochet angle: the smallest oblique angle at which a projectile is turned away."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np

from solver import advice
from solver.advice import ModelWarning
from solver.impact import Impact
from solver.numerics import SEARCH_TOLERANCE, TERMINATION_TIME, Numerics
from solver.projectile import Projectile
from solver.resistance import Resistance
from solver.shot import Outcome, Shot, final_tip_depth, integrate, outcome_of, prepare
from solver.target import Target
from solver.validation import require, require_between, require_positive

SearchMethod: TypeAlias = Literal["outcome", "bisection", "secant"]

PAPER_TERMINATION_TIME = 5e-3
"""When the paper reads the final position. [s]"""
MOST_TRIALS = 100


class SearchStatus(StrEnum):
    """How a search ended."""

    CONVERGED = "converged"
    NO_RICOCHET = "no_ricochet"
    ALWAYS_RICOCHET = "always_ricochet"
    NOT_CONVERGED = "not_converged"


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """How the critical angle is sought.

    Parameters
    ----------
    method
        ``"outcome"`` brackets the change of outcome. ``"bisection"`` and ``"secant"`` are the paper's, on the depth
        of the nose tip at the termination time (eqs. 7 and 8).
    lower, upper
        Ends of the range; left open, 5° and 85°, or 40° and 60° for the searches of the paper. [rad]
    tolerance
        Width of the final bracket of ``"outcome"``. [rad]
    relative_tolerance
        The searches of the paper end when two angles in a row differ by less than this fraction. [1]
    scan_interval
        Largest distance of the angles at which ``"outcome"`` first looks; a change and change back that both fall
        between two of them go unseen. [rad]
    """

    method: SearchMethod = "outcome"
    lower: float | None = None
    upper: float | None = None
    tolerance: float = math.radians(0.01)
    relative_tolerance: float = 0.01
    scan_interval: float = math.radians(5.0)

    def __post_init__(self) -> None:
        known = self.method in ("outcome", "bisection", "secant")
        require(known, "search.method", "must be 'outcome', 'bisection' or 'secant'")
        lower, upper = self.bounds
        require(
            0.0 <= lower < upper < math.pi / 2.0,
            "search.lower",
            f"must be at least 0° and below the upper end of less than 90°, "
            f"got {math.degrees(lower):g}° and {math.degrees(upper):g}°",
        )
        require_between("search.tolerance", self.tolerance, math.radians(1e-6), math.radians(10.0))
        require_between("search.relative_tolerance", self.relative_tolerance, 1e-8, 0.5)
        require_between("search.scan_interval", self.scan_interval, math.radians(0.1), math.pi / 2.0)

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper end of the range. [rad]"""
        lower, upper = (5.0, 85.0) if self.method == "outcome" else (40.0, 60.0)
        return (
            math.radians(lower) if self.lower is None else self.lower,
            math.radians(upper) if self.upper is None else self.upper,
        )


@dataclass(frozen=True, slots=True)
class Trial:
    """One angle tried."""

    oblique_angle: float
    """[rad]"""
    final_position: float
    """Depth of the nose tip at the end of the run, or at the termination time in the searches of the paper. [m]"""
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class CriticalAngle:
    """Answer of a search."""

    status: SearchStatus
    angle: float | None
    """The critical angle; with ``"outcome"`` the upper end of the final bracket, which was seen to ricochet. [rad]"""
    bracket: tuple[float, float] | None
    """Angles between which the change was last pinned down. [rad]"""
    iterations: tuple[Trial, ...]
    """Every trial, in order."""
    other_crossings: tuple[float, ...]
    """Other angles in the range at which the outcome changes, either way. [rad]"""
    warnings: tuple[ModelWarning, ...]


Try: TypeAlias = Callable[[float], Trial]


def critical_angle(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    search: Search | None = None,
) -> CriticalAngle:
    """Smallest oblique angle, from the normal, at which the projectile is turned away.

    Parameters
    ----------
    projectile, target
        What strikes and what is struck.
    velocity
        At first contact. [m/s]
    angle_of_attack, angular_velocity
        At first contact, the same for every trial. [rad, rad/s]
    resistance
        Resistance of the target; eq. 9 and elastic-plastic decay unless given.
    numerics
        Route and resolution.
    search
        Method, range and tolerance.

    Returns
    -------
    CriticalAngle
        Also when there is no such angle in the range, which its status then tells.

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts, among them a strength factor not above zero within the range.
    IntegrationError
        If a trial could not be integrated.

    Notes
    -----
    Section 2.3 and eqs. 7-8. As printed, eq. 7 averages the last two angles whatever their outcome; here the bracket
    with the change of sign is kept.
    """
    search = search or Search()
    require_positive("impact.velocity", velocity)
    paper = search.method != "outcome"
    numerics = numerics or Numerics()
    shot = prepare(
        projectile=projectile,
        target=target,
        resistance=resistance or Resistance(),
        numerics=numerics.resolved(
            method="panels" if paper else "adaptive",
            termination_time=PAPER_TERMINATION_TIME if paper else TERMINATION_TIME,
            relative_tolerance=SEARCH_TOLERANCE,
        ),
    )
    trials: list[Trial] = []

    def attempt(oblique_angle: float) -> Trial:
        impact = Impact(
            velocity=velocity,
            oblique_angle=oblique_angle,
            angle_of_attack=angle_of_attack,
            angular_velocity=angular_velocity,
        )
        trials.append(_run_trial(shot, impact, at_termination=paper))
        return trials[-1]

    find = {"outcome": _search_outcome, "bisection": _search_bisection, "secant": _search_secant}[search.method]
    found = find(attempt, search)
    return CriticalAngle(
        status=found.status,
        angle=found.angle,
        bracket=found.bracket,
        iterations=tuple(trials),
        other_crossings=found.other_crossings,
        warnings=_warnings(shot, velocity, angle_of_attack, found, trials),
    )


@dataclass(frozen=True, slots=True)
class _Found:
    status: SearchStatus
    angle: float | None = None
    bracket: tuple[float, float] | None = None
    other_crossings: tuple[float, ...] = ()
    starts_turned_away: bool = False
    deciding: tuple[Trial, ...] = ()
    """Trials on either side of the changes of outcome; empty if all trials decide."""


def _run_trial(shot: Shot, impact: Impact, *, at_termination: bool) -> Trial:
    model = shot.model._replace(law=shot.law_at(impact))
    run, _ = integrate(shot, model, impact, keep_steps=False)
    time = shot.numerics.termination_time if at_termination else None
    position = final_tip_depth(run, model.body, run.time if time is None else time)
    return Trial(impact.oblique_angle, position, outcome_of(run))


def _turned_away(trial: Trial) -> bool:
    return trial.outcome is Outcome.RICOCHET


def _search_outcome(attempt: Try, search: Search) -> _Found:
    """Scan the range, then bisect every change of outcome."""
    lower, upper = search.bounds
    count = math.ceil((upper - lower) / search.scan_interval * (1.0 - 1e-12)) + 1
    between = np.linspace(math.degrees(lower), math.degrees(upper), max(count, 2))[1:-1]  # round numbers to read
    scan = [attempt(angle) for angle in (lower, *map(math.radians, between), upper)]
    changes = [pair for pair in pairwise(scan) if _turned_away(pair[0]) != _turned_away(pair[1])]
    brackets = [_bisect_outcome(attempt, *pair, search.tolerance) for pair in changes]
    starts = _turned_away(scan[0])
    deciding = tuple(trial for bracket in brackets for trial in bracket)
    onsets = [index for index, (_, right) in enumerate(changes) if _turned_away(right)]
    if not onsets:
        others = tuple(right.oblique_angle for _, right in brackets)
        status = SearchStatus.ALWAYS_RICOCHET if starts else SearchStatus.NO_RICOCHET
        return _Found(status, other_crossings=others, starts_turned_away=starts, deciding=deciding)
    first = onsets[0]
    left, right = brackets[first]
    return _Found(
        SearchStatus.CONVERGED,
        angle=right.oblique_angle,
        bracket=(left.oblique_angle, right.oblique_angle),
        other_crossings=tuple(right.oblique_angle for i, (_, right) in enumerate(brackets) if i != first),
        starts_turned_away=starts,
        deciding=deciding,
    )


def _bisect_outcome(attempt: Try, left: Trial, right: Trial, tolerance: float) -> tuple[Trial, Trial]:
    while right.oblique_angle - left.oblique_angle > tolerance:
        middle = attempt(0.5 * (left.oblique_angle + right.oblique_angle))
        if _turned_away(middle) == _turned_away(left):
            left = middle
        else:
            right = middle
    return left, right


def _ends_of_paper_search(attempt: Try, search: Search) -> tuple[Trial, Trial, _Found | None]:
    """Both ends of the range, and the answer if the final position has the same sign at both."""
    first, second = (attempt(angle) for angle in search.bounds)
    if first.final_position > 0.0 and second.final_position > 0.0:
        return first, second, _Found(SearchStatus.NO_RICOCHET)
    if first.final_position <= 0.0 and second.final_position <= 0.0:
        return first, second, _Found(SearchStatus.ALWAYS_RICOCHET, starts_turned_away=True)
    return first, second, None


def _search_bisection(attempt: Try, search: Search) -> _Found:
    """Halve the bracket on the sign of the final position (eq. 7 with the bracket kept)."""
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
            return _Found(
                SearchStatus.CONVERGED,
                angle=middle.oblique_angle,
                bracket=(left.oblique_angle, right.oblique_angle),
                deciding=(left, right),
            )
        last = middle.oblique_angle
    return _Found(SearchStatus.NOT_CONVERGED, bracket=(left.oblique_angle, right.oblique_angle))


def _search_secant(attempt: Try, search: Search) -> _Found:
    """Secant steps on the final position (eq. 8)."""
    old, new, answer = _ends_of_paper_search(attempt, search)
    if answer is not None:
        return answer
    for _ in range(MOST_TRIALS):
        rise = new.final_position - old.final_position
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
            return _Found(
                SearchStatus.CONVERGED,
                angle=new.oblique_angle,
                bracket=(bracket[0], bracket[1]),
                deciding=(old, new),
            )
    return _Found(SearchStatus.NOT_CONVERGED)


def _warnings(
    shot: Shot, velocity: float, angle_of_attack: float, found: _Found, trials: list[Trial]
) -> tuple[ModelWarning, ...]:
    warnings = list(
        advice.input_warnings(
            projectile=shot.projectile, target=shot.target, velocity=velocity, angle_of_attack=angle_of_attack
        )
    )
    reach = found.angle if found.angle is not None else max(trial.oblique_angle for trial in trials)
    warnings += advice.strength_fit_warning(resistance=shot.resistance, oblique_angle=reach)
    if found.starts_turned_away:
        warnings.append(advice.RICOCHET_AT_LOWER_BOUND)
    if any(trial.outcome is Outcome.IN_MOTION for trial in found.deciding or trials):
        warnings.append(advice.undecided(termination_time=shot.numerics.termination_time))
    warnings.append(advice.NO_MEASURED_ANGLE)
    return tuple(warnings)
