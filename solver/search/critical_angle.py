"""Search for the critical ricochet angle, the smallest oblique angle at which a projectile is turned away."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from solver import warnings as model_warnings
from solver.arrays import FloatArray
from solver.checks import ParameterError, RicochetError, require_bounds, require_one
from solver.motion import MOST_TURN, REST_FRACTION, Termination, Thresholds
from solver.plausibility import check_energy
from solver.prepared import (
    OUTCOMES,
    Outcome,
    PreparedCase,
    check_end,
    exit_of,
    final_tip_depth,
    integrate,
    prepare,
)
from solver.projectile import Projectile
from solver.resistance import ObliquityPolynomial, Resistance, positive_up_to, usual_unless_given
from solver.search.outcome import HALF_DEGREE, MORE_INERTIA, search_outcome
from solver.search.paper import search_bisection, search_secant
from solver.search.trials import ANGLE, END, ENERGY_FLOOR, Strength, TrialInputs, search_levels
from solver.search.types import USUAL_SEARCH, Change, CriticalAngle, OutcomeInterval, Search, SearchStatus, Trial
from solver.strength_scatter import ScatterSource, known_strength
from solver.strike import (
    SEARCH_STATIONS,
    SEARCH_TOLERANCE,
    USUAL,
    Impact,
    Method,
    Numerics,
    usual_termination_time,
)
from solver.target import Target
from solver.warnings import ModelWarning

# This is the paper's value. Only within about 1.5° of the critical angle does its projectile take longer to stop or to
# leave.
PAPER_TERMINATION_TIME = 5e-3
"""Default time after first contact at which the paper's searches evaluate the depth of the nose tip. [s]"""
# The paper has no retention energy: its runs end at rest, or at the termination time.
PAPER_THRESHOLDS = Thresholds(REST_FRACTION, REST_FRACTION)
"""Thresholds of retention and rest in the paper's searches, relative to the initial kinetic energy. [1]"""
# A projectile that comes to rest in the target is embedded whatever its attitude.
UNSTOPPED = (Outcome.RICOCHET, Outcome.PERFORATED, Outcome.IN_MOTION)
"""Outcomes for which a large turn of the body gives a warning."""


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
    strength_scatter: ScatterSource = "law",
) -> CriticalAngle:
    """Find the smallest oblique angle, from the normal, at which the projectile is turned away.

    Parameters
    ----------
    projectile, target
        Projectile and concrete.
    velocity
        Speed at first contact. [m/s]
    angle_of_attack, angular_velocity
        Angle of attack and rate of the axis angle at first contact, in every trial. [rad, rad/s]
    resistance
        Resistance of the target; by default the strength factor of eq. 9 with elastic-plastic decay.
    numerics
        Integration method and resolution; adaptive unless given, or panels in the paper's searches.
    search
        Method, range and tolerance.
    strength_scatter
        Tests from which the dispersion of the strength factor S is taken, see `known_strength`. The dispersion does not
        affect the angle.

    Returns
    -------
    CriticalAngle
        Result of the search. Its ``angle`` is None if the range has no such angle; ``status`` then gives the reason.

    Raises
    ------
    ParameterError
        If an input is outside its range, or the strength factor is not above zero at the lower end of the range.
    IntegrationError
        If a trial could not be integrated.

    Notes
    -----
    If the strength factor is a polynomial with a covariance, two further searches give the standard error of the angle.
    If the strength factor falls to zero within the range, the search ends there, and the result has the warning
    ``range_clipped``.

    ``bisection`` and ``secant`` follow section 2.3 and eqs. 7-8 of the source paper. As printed, eq. 7 averages the
    last two angles regardless of their outcome; here the bracket with the change of sign is kept.
    """
    search = search or USUAL_SEARCH
    resistance = usual_unless_given(resistance)
    require_one("projectile", projectile, Projectile)
    require_bounds("impact.velocity", velocity)
    numerics, paper = numerics or USUAL, search.method != "outcome"
    method: Method = numerics.method or ("panels" if paper else "adaptive")
    end_time = usual_termination_time(length=projectile.length, velocity=velocity, method=method)
    prepared = prepare(
        projectile=projectile,
        target=target,
        resistance=resistance,
        numerics=numerics.resolved(
            method=method,
            termination_time=PAPER_TERMINATION_TIME if paper else end_time,
            relative_tolerance=SEARCH_TOLERANCE,
            stations=SEARCH_STATIONS,
        ),
    )
    impact = Impact(
        velocity=velocity,
        oblique_angle=search.bounds[0],
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
    )
    change, trials, sought = _search_positive_range(prepared, impact, search)
    standard_error, doubts = _standard_error(prepared, impact, search, change)
    if sought.bounds != search.bounds:
        doubts += (model_warnings.range_clipped(upper=sought.bounds[1], given=search.bounds[1]),)
    scatter, own_tests = known_strength(
        projectile=projectile, target=target, resistance=resistance, strength_scatter=strength_scatter
    )
    if strength_scatter == "paper_table_1":
        doubts += (model_warnings.scatter_of_table_1(projectile, target),)
    return CriticalAngle(
        status=change.status,
        angle=change.angle,
        bracket=change.bracket,
        iterations=trials,
        other_crossings=change.other_crossings,
        warnings=_warnings(prepared, impact, change, trials, by_paper=paper) + doubts,
        standard_error=standard_error,
        strength_factor=None if change.angle is None else prepared.strength_factor_at(change.angle),
        strength_factor_dispersion=None if change.angle is None else scatter.dispersion,
        own_tests=None if change.angle is None else own_tests,
        energy_fraction_below=change.nearby[0] if change.nearby else None,
        energy_fraction_above=change.nearby[1] if change.nearby else None,
        outcomes=change.outcomes,
        exit=next((trial.exit for trial in reversed(trials) if trial.oblique_angle == change.angle), None),
    )


def _search_positive_range(
    prepared: PreparedCase, impact: Impact, search: Search
) -> tuple[Change, tuple[Trial, ...], Search]:
    """Run a search over the part of its range in which the strength factor is above zero.

    Returns
    -------
    tuple
        The change of outcome, all trials, and the search with the range used.
    """
    by_method = _search_outcome if search.method == "outcome" else _search_paper
    try:
        return *by_method(prepared, impact, search), search
    except ParameterError:
        lower, upper = search.bounds
        coefficients = prepared.resistance.strength_polynomial(target=prepared.target, projectile=prepared.projectile)
        positive = positive_up_to(coefficients, prepared.resistance.held_from, lower, upper)
        if not lower < positive < upper:
            raise
    clipped = replace(search, upper=positive)
    return *by_method(prepared, impact, clipped), clipped


def _standard_error(
    prepared: PreparedCase, impact: Impact, search: Search, change: Change
) -> tuple[float | None, tuple[ModelWarning, ...]]:
    """Return the standard error of the critical angle [rad], or None if unknown, and its warnings.

    If the strength factor has a covariance, two more searches are run, with S one standard error lower and higher.
    """
    # A central difference over one standard error to either side is accurate even if the angle is not linear in S. Only
    # trials near the critical angle affect the result, so it is enough to shift the constant of the polynomial, by the
    # standard error of S at that angle.
    model = prepared.resistance.strength_factor
    if not isinstance(model, ObliquityPolynomial) or model.covariance is None:
        return None, ()
    if change.status is not SearchStatus.CONVERGED or change.angle is None:
        return None, ()
    shift = model.standard_error(change.angle)
    if shift == 0.0:
        return 0.0, ()
    lower, upper = (_shifted_angle(prepared, impact, search, by) for by in (-shift, shift))
    if lower is None or upper is None:
        return None, (model_warnings.STANDARD_ERROR_UNKNOWN,)
    return 0.5 * abs(upper - lower), ()


def _shifted_angle(prepared: PreparedCase, impact: Impact, search: Search, shift: float) -> float | None:
    """Return the critical angle with the strength factor shifted by a constant; None if there is none. [rad]"""
    constant, *rest = prepared.resistance.strength_polynomial(target=prepared.target, projectile=prepared.projectile)
    held = prepared.resistance.held_from
    shifted = ObliquityPolynomial(coefficients=(constant + shift, *rest), held_from=held)
    present = replace(prepared, resistance=replace(prepared.resistance, strength_factor=shifted))
    try:
        change, _, _ = _search_positive_range(present, impact, search)
    except RicochetError:  # the angle remains valid without a standard error
        return None
    return change.angle if change.status is SearchStatus.CONVERGED else None


def _search_paper(prepared: PreparedCase, impact: Impact, search: Search) -> tuple[Change, tuple[Trial, ...]]:
    """Run one of the paper's searches, by bisection or secants on the position at the termination time."""
    trials: list[Trial] = []

    def attempt(oblique_angle: float) -> Trial:
        strike = replace(impact, oblique_angle=oblique_angle)
        model = prepared.model._replace(law=prepared.law_at(strike))
        run, _ = integrate(prepared, model, strike, keep_steps=False, thresholds=PAPER_THRESHOLDS)
        position = final_tip_depth(run, model.body, prepared.numerics.termination_time)
        outcome = OUTCOMES[run.end]
        left = exit_of(outcome, run.state.tolist(), model.body)
        turned = 0.0 if prepared.is_centred else abs(float(run.state[2]) - strike.axis_angle)
        trials.append(Trial(oblique_angle, position, outcome, exit=left, turned=turned))
        return trials[-1]

    change = (search_bisection if search.method == "bisection" else search_secant)(attempt, search)
    return change, tuple(trials)


@lru_cache  # the cases of a study share one search
def _scan(search: Search) -> FloatArray:
    """Return the evenly spaced angles that a search by outcome scans. [rad]"""
    lower, upper = search.bounds
    # Without the factor, rounding could add an angle to a range that is a whole number of intervals.
    count = math.ceil((upper - lower) / search.scan_interval * (1.0 - 1e-12)) + 1
    begin, width = math.degrees(lower), math.degrees(upper - lower) / max(count - 1, 1)
    between = (math.radians(round(begin + i * width, 9)) for i in range(1, count - 1))  # with few digits in degrees
    return np.array([lower, *between, upper])


def _search_outcome(prepared: PreparedCase, impact: Impact, search: Search) -> tuple[Change, tuple[Trial, ...]]:
    """Find where ricochet begins and ends and, for a wall, where perforation begins and ends."""
    brackets, trials, nearby = _find_changes(prepared, impact, search, Termination.EXIT)
    change = _first_onset(brackets, trials)
    if change.angle is not None:
        change = replace(change, nearby=nearby)
    if prepared.target.thickness is None:
        return change, trials
    perforating, more, _ = _find_changes(prepared, impact, search, Termination.PERFORATED)
    begins = (perforating[0][0] if perforating else more[-1]).outcome is Outcome.PERFORATED
    intervals = _intervals(search, change.starts_turned_away, brackets, begins, perforating)
    deciding = change.deciding + tuple(trial for bracket in perforating for trial in bracket)
    near = tuple(_near_perforation(prepared, impact, bracket) for bracket in perforating)
    return replace(change, outcomes=intervals, deciding=deciding, perforations=near), trials + more


def _near_perforation(
    prepared: PreparedCase, impact: Impact, bracket: tuple[Trial, Trial]
) -> tuple[float, float, float]:
    """Return the angle of a change to or from perforation, and the energy left half a degree to either side of it.

    If the angle half a degree below the change would be negative, normal impact is used instead.

    Returns
    -------
    tuple
        The angle, and the fractions of the energy left on the side without and on the side with perforation. [rad, 1,
        1]
    """
    left, right = bracket
    outside = 1.0 if left.outcome is Outcome.PERFORATED else -1.0
    angle = right.oblique_angle
    beyond, within = (
        _energy_behind(prepared, impact, max(angle + side * HALF_DEGREE, 0.0)) for side in (outside, -outside)
    )
    return angle, beyond, within


def _energy_behind(prepared: PreparedCase, impact: Impact, oblique_angle: float) -> float:
    """Return the fraction of the energy left behind the wall; 0 if it is not perforated or the run fails. [1]"""
    if oblique_angle >= math.pi / 2.0:
        return 0.0
    strike, model = replace(impact, oblique_angle=oblique_angle), prepared.model
    floor = ENERGY_FLOOR * prepared.numerics.retention_energy_fraction
    try:
        present = model._replace(law=prepared.law_at(strike))
        run, _ = integrate(prepared, present, strike, keep_steps=False, thresholds=Thresholds(floor, floor))
    except RicochetError:  # the result is needed for a warning only
        return 0.0
    left = exit_of(OUTCOMES[run.end], run.state.tolist(), model.body)
    if left is None or run.end != Termination.PERFORATED:
        return 0.0
    body, spin = model.body, impact.angular_velocity
    translation, rotation = 0.5 * body.mass * impact.velocity**2, 0.5 * body.moment_of_inertia * spin * spin
    if prepared.is_centred:
        return (left.kinetic_energy - rotation) / translation
    return left.kinetic_energy / (translation + rotation)


Brackets: TypeAlias = list[tuple[Trial, Trial]]
"""Pairs of trials, just below and just above each change of outcome, in increasing order of the angle."""


def _intervals(
    search: Search, turned_away: bool, changes: Brackets, perforated: bool, perforating: Brackets
) -> tuple[OutcomeInterval, ...]:
    """Combine changes to and from ricochet with changes to and from perforation into intervals of one outcome each.

    Parameters
    ----------
    turned_away, perforated
        Whether the projectile is turned away, and whether it perforates, at the lower end of the range.
    changes, perforating
        Changes to and from ricochet, and to and from perforation.
    """
    # The searches for ricochet and for perforation both find a change from perforation to ricochet, each to within the
    # tolerance. A gap between their angles that is no wider than the tolerance is not an interval.
    lower, upper = search.bounds
    ricochets = [(right.oblique_angle, Outcome.RICOCHET) for _, right in changes]
    crossings = sorted(ricochets + [(right.oblique_angle, Outcome.PERFORATED) for _, right in perforating])
    holds = {Outcome.RICOCHET: turned_away, Outcome.PERFORATED: perforated}
    found: list[OutcomeInterval] = []
    begin = lower
    for end, kind in [*crossings, (upper, None)]:
        outcome = next((kind for kind, is_so in holds.items() if is_so), Outcome.EMBEDDED)
        if end - begin > search.tolerance or (not found and kind is None):
            if found and found[-1].outcome is outcome:
                begin = found.pop().lower
            found.append(OutcomeInterval(outcome, begin, end))
            begin = end
        if kind is not None:
            holds[kind] = not holds[kind]
    if begin < upper and found:
        found[-1] = replace(found[-1], upper=upper)
    return tuple(found)


def _find_changes(
    prepared: PreparedCase, impact: Impact, search: Search, sought: Termination
) -> tuple[Brackets, tuple[Trial, ...], tuple[float, float, float]]:
    """Run the compiled search for changes to and from the termination `sought`.

    Returns
    -------
    tuple
        The brackets of the changes, all trials, and the fractions of the energy left near the smallest angle from which
        runs end as `sought`, see `Found.nearby`.
    """
    numerics, target = prepared.numerics, prepared.target
    polynomial = prepared.resistance.strength_polynomial(target=target, projectile=prepared.projectile)
    inputs = TrialInputs(
        velocity=float(impact.velocity),
        angle_of_attack=float(impact.angle_of_attack),
        angular_velocity=float(impact.angular_velocity),
        strength=Strength(np.array(polynomial, float), math.degrees(prepared.resistance.held_from)),
        compressive_strength=float(target.compressive_strength),
        end_time=float(numerics.termination_time),
        time_step=float(numerics.time_step),
        retention=float(numerics.retention_energy_fraction),
        sought=sought.value,
        vary_inertia=prepared.projectile.moment_of_inertia is None,
    )
    levels = search_levels(
        relative_tolerance=numerics.relative_tolerance,
        stations=numerics.stations,
        points=numerics.points,
        tolerance=search.tolerance,
    )
    found = search_outcome(_scan(search), inputs, prepared.model, levels)
    rows, body = found.trials.tolist(), prepared.model.body
    if rows[-1][END] == Termination.NO_STRENGTH:  # raises an error that states S
        prepared.strength_factor_at(rows[-1][ANGLE])
    check_end(rows[-1][END], numerics.termination_time)
    trials = tuple(
        Trial(
            angle,
            position,
            outcome := OUTCOMES[end],
            fine > 0.0,
            exit_of(outcome, state, body),
            0.0 if prepared.is_centred else abs(state[2] - angle - impact.angle_of_attack),
        )
        for angle, position, end, _, fine, *state in rows
    )
    below, above, with_inertia = found.nearby.tolist()
    return [(trials[left], trials[right]) for left, right in found.brackets], trials, (below, above, with_inertia)


def _turned_away(trial: Trial) -> bool:
    return trial.outcome is Outcome.RICOCHET


def _first_onset(brackets: list[tuple[Trial, Trial]], trials: tuple[Trial, ...]) -> Change:
    """Return the first change to ricochet, or the reason why there is none; `brackets` are in order of the angle."""
    starts = _turned_away(brackets[0][0] if brackets else trials[-1])
    deciding = tuple(trial for bracket in brackets for trial in bracket)
    onsets = [index for index, (_, right) in enumerate(brackets) if _turned_away(right)]
    # If the range begins with ricochet, the critical angle lies below it. A change from embedded to ricochet at a
    # larger angle then counts only as one of `other_crossings`.
    if starts or not onsets:
        others = tuple(right.oblique_angle for _, right in brackets)
        status = SearchStatus.ALWAYS_RICOCHET if starts else SearchStatus.NO_RICOCHET
        return Change(status, other_crossings=others, starts_turned_away=starts, deciding=deciding)
    first = onsets[0]
    left, right = brackets[first]
    return Change(
        SearchStatus.CONVERGED,
        angle=right.oblique_angle,
        bracket=(left.oblique_angle, right.oblique_angle),
        other_crossings=tuple(right.oblique_angle for i, (_, right) in enumerate(brackets) if i != first),
        starts_turned_away=starts,
        deciding=deciding,
    )


def _warnings(
    prepared: PreparedCase, impact: Impact, change: Change, trials: tuple[Trial, ...], *, by_paper: bool
) -> tuple[ModelWarning, ...]:
    warnings = list(
        model_warnings.input_warnings(
            projectile=prepared.projectile,
            target=prepared.target,
            velocity=impact.velocity,
            angle_of_attack=impact.angle_of_attack,
            angle_shift=_inertia_shift(prepared, change),
        )
    )
    warnings += _retention_warnings(prepared, change)
    turned, at = _most_turned(trials)
    warnings += model_warnings.tumbling(turned=turned, oblique_angle=at)
    reach = change.angle if change.angle is not None else max(trial.oblique_angle for trial in trials)
    warnings += model_warnings.law_warnings(
        projectile=prepared.projectile,
        target=prepared.target,
        resistance=prepared.resistance,
        impact=replace(impact, oblique_angle=reach),
    )
    if change.starts_turned_away:
        warnings.append(model_warnings.RICOCHET_AT_LOWER_BOUND)
    for trial in trials:
        if trial.fine:
            strike = replace(impact, oblique_angle=trial.oblique_angle)
            if broken := check_energy(prepared, strike, trial.outcome, trial.exit):
                warnings += broken
                break
    end_time = prepared.numerics.termination_time
    if any(trial.outcome is Outcome.IN_MOTION and trial.turned <= MOST_TURN for trial in change.deciding or trials):
        by_time = change.deciding and not by_paper
        warnings.append(
            (model_warnings.decided_by_time if by_time else model_warnings.undecided)(termination_time=end_time)
        )
    warnings.append(model_warnings.NO_MEASURED_ANGLE)
    return tuple(warnings)


def _most_turned(trials: tuple[Trial, ...]) -> tuple[float, float]:
    """Return the largest turn of the axis in a fine trial with an outcome in `UNSTOPPED`, and its oblique angle. [rad]

    Both are 0 if there is no such trial.
    """
    turns = ((trial.turned, trial.oblique_angle) for trial in trials if trial.fine and trial.outcome in UNSTOPPED)
    return max(turns, default=(0.0, 0.0))


def _retention_warnings(prepared: PreparedCase, change: Change) -> list[ModelWarning]:
    """Return warnings if the critical angle, or a change to or from perforation, depends on the retention energy."""
    retention = prepared.numerics.retention_energy_fraction
    warnings = []
    if change.nearby is not None and _depends_on_retention(change.nearby[0], change.nearby[1], retention):
        below, above, _ = change.nearby
        warnings.append(model_warnings.retention_decides(retention=retention, below=below, above=above))
    for angle, outside, inside in change.perforations:
        if _depends_on_retention(outside, inside, retention):
            warnings.append(
                model_warnings.retention_decides_perforation(
                    angle=angle, retention=retention, outside=outside, inside=inside
                )
            )
    return warnings


def _depends_on_retention(without: float, having: float, retention: float) -> bool:
    """Return whether the angle of a change moves by more than half a degree if the retention energy varies.

    The retention energy varies over `RETENTION_RANGE`, 0.1 to 10 times the one in use. The shift is an estimate that
    takes the energy left to be linear in the angle.

    Parameters
    ----------
    without, having
        Fractions of the initial energy that the projectile has left half a degree to either side of that angle:
        `without` on the side where it stays in the target, `having` on the side where it leaves. [1]
    """
    least, most = model_warnings.RETENTION_RANGE
    return without != 0.0 or having - retention < (most - least) * retention


def _inertia_shift(prepared: PreparedCase, change: Change) -> float | None:
    """Return the shift of the angle for a moment of inertia 10 % larger, to first order; None if unknown. [rad]"""
    # The energy left decreases with the inertia and increases with the angle. The ratio of the two slopes gives the
    # shift of the angle at which the energy left equals the retention energy, without another search.
    if change.nearby is None:
        return None
    _, above, with_more = change.nearby
    rise = above - prepared.numerics.retention_energy_fraction
    if not with_more > 0.0 or rise <= 0.0:
        return None
    return (above - with_more) / rise * HALF_DEGREE * 0.1 / (MORE_INERTIA - 1.0)
