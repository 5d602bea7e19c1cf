"""Perforation of walls: least thickness that stops a projectile, and least velocity at which it perforates a wall."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np

from solver.checks import ParameterError, require, require_between
from solver.display import Axes, Columns, DataFrame, Figure, Row, card, dataframe, line, plot_perforation
from solver.motion import Termination
from solver.plausibility import check_walls
from solver.prepared import (
    LEAST_THICKNESS,
    OUTCOMES,
    Exit,
    Outcome,
    PreparedCase,
    Protrusion,
    exit_of,
    integrate,
    prepare,
    protrusion_of,
)
from solver.projectile import Projectile
from solver.resistance import Resistance, usual_unless_given
from solver.strike import USUAL, Impact, Numerics, usual_termination_time
from solver.target import Target
from solver.trajectory import run_warnings
from solver.units import quantity
from solver.warnings import DEEPER_THAN_WALL, TUMBLING, UNDECIDED, ModelWarning, decided_by_time, undecided

# Real projectiles penetrate far less deep. If not even this wall stops a body, the status is ``always_perforated``.
MOST_DIAMETERS = 1000.0
"""Thickness of the thickest wall tried, relative to the diameter of the projectile. [1]"""
# No projectile stays rigid at the upper end.
VELOCITIES = (1.0, 2000.0)
"""Range of velocities searched. [m/s]"""
# The outcome need not be monotonic, and the first change counts: larger ratios could pass over it, and smaller ones
# take more trials. The factor is arbitrary.
GROWTH = 1.5
"""Ratio of consecutive values tried until the outcome changes. [1]"""
# A bracket of this width is far narrower than the effect of the scatter of S, and takes about twelve bisections.
TOLERANCE = 1e-4
"""Default width of the final bracket, relative to its upper end. [1]"""
# With this tolerance and these stations a limit is within 5e-5 of its converged value, half the width of the bracket.
RUN_TOLERANCE, RUN_STATIONS = 3e-5, 8
"""Default relative tolerance and number of stations of the runs."""


PreparedStrike: TypeAlias = tuple[PreparedCase, Impact]
"""Prepared case and impact of a trial."""


class PerforationStatus(StrEnum):
    """Result of a search for perforation: a limit, or the outcome over the whole range."""

    CONVERGED = "converged"
    ALWAYS_PERFORATED = "always_perforated"
    NEVER_PERFORATED = "never_perforated"


@dataclass(frozen=True, slots=True)
class PerforationTrial:
    """Run of a search at one thickness or velocity."""

    value: float
    """Thickness or velocity. [m or m/s]"""
    outcome: Outcome
    """Outcome of the trial."""
    exit: Exit | None
    """State of the projectile as it leaves the wall; None if it stays."""
    protrusion: Protrusion | None
    """Protrusion from the rear face of a wall that was not perforated; None if nothing protruded."""

    @property
    def comes_out(self) -> bool:
        """True if some part of the projectile was ever beyond the rear face."""
        return self.outcome is Outcome.PERFORATED or self.protrusion is not None


@dataclass(frozen=True, slots=True, repr=False)
class PerforationLimit:
    """Result of `least_thickness` or `limit_velocity`, with all trials of the search."""

    quantity: Literal["thickness", "velocity"]
    """Quantity that the search varied."""
    status: PerforationStatus
    """Result of the search: a limit, or the outcome over the whole range."""
    value: float | None
    """Least thickness found to stop the projectile, or least velocity found to perforate; None if the outcome does not
    change in the range. [m or m/s]"""
    bracket: tuple[float, float] | None
    """Values on either side of the change of outcome at the end of the search; None without a change. [m or m/s]"""
    iterations: tuple[PerforationTrial, ...]
    """All trials, in the order of computation."""
    without_protrusion: float | None
    """Least thickness, or greatest velocity, at which no part of the projectile was found to come out of the rear face;
    None if this holds over the whole range, or nowhere in it. [m or m/s]"""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the trial at the value found, or about the last trial if none was found. ``undecided`` is added if
    a trial beside the change or beside the value without protrusion, or any trial if there is no change, was still in
    motion at its termination time."""

    def row(self) -> Row:
        """Return the row of a table: status, value, bracket, and the value without protrusion. [m or m/s]"""
        low, high = self.bracket or (None, None)
        return {
            "status": self.status.value,
            "value": self.value,
            "value_low": low,
            "value_high": high,
            "without_protrusion": self.without_protrusion,
        }

    def columns(self) -> Columns:
        """Return the values and outcomes of the trials as arrays by name, in the order of computation."""
        trials = self.iterations
        return {
            "value": np.array([trial.value for trial in trials], float),
            "outcome": np.array([trial.outcome.value for trial in trials], str),
        }

    def to_dataframe(self) -> DataFrame:
        """Return the trials as a ``pandas.DataFrame``; requires pandas."""
        return dataframe(self.columns(), PerforationTrial)

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Plot the residual speed of each trial, in a new pyplot figure unless axes are given; return the figure."""
        behind = [trial.exit if trial.outcome is Outcome.PERFORATED else None for trial in self.iterations]
        trials = self.columns() | {"speed": np.array([0.0 if each is None else each.speed for each in behind])}
        label = "thickness of the wall [m]" if self.quantity == "thickness" else "velocity at first contact [m/s]"
        return plot_perforation(trials, self._summary(), label, self.bracket, ax)

    def _summary(self) -> str:
        name, unit = ("least thickness", "m") if self.quantity == "thickness" else ("limit velocity", "m/s")
        status = self.status.replace("_", " ")
        return f"no {name}, {status}" if self.value is None else f"{name} {quantity(self.value, unit)}"

    def __repr__(self) -> str:
        return line(self, self._summary(), f"{len(self.iterations)} trials")

    def _repr_html_(self) -> str:
        unit = "m" if self.quantity == "thickness" else "m/s"
        rows = {
            "status": self.status.replace("_", " "),
            "bracket": "" if self.bracket is None else " to ".join(quantity(value, unit, 5) for value in self.bracket),
            "trials": str(len(self.iterations)),
        }
        return card(self._summary(), rows, self.warnings)


def least_thickness(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact | None = None,
    velocity: float | None = None,
    oblique_angle: float | None = None,
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    tolerance: float = TOLERANCE,
) -> PerforationLimit:
    """Find the least thickness of a wall that a strike does not perforate.

    Parameters
    ----------
    projectile
        Projectile that strikes the wall.
    target
        Concrete, without a thickness.
    impact
        Motion of the projectile at first contact.
    velocity, oblique_angle, angle_of_attack, angular_velocity
        Fields of the impact, in place of `impact`. [m/s, rad, rad, rad/s]
    resistance
        Resistance of the target; by default the strength factor of eq. 9 with elastic-plastic decay.
    numerics
        Integration method and resolution; adaptive with a relative tolerance of 3e-5 and 8 stations unless given.
    tolerance
        Width of the final bracket, relative to the thickness. [1]

    Returns
    -------
    PerforationLimit
        Result of the search. Its status is ``never_perforated`` if the strike does not even perforate the thinnest wall
        accepted, a tenth of the diameter.

    Raises
    ------
    ParameterError
        If an input is outside its range, or the target has a thickness.
    IntegrationError
        If a run could not be integrated.

    Notes
    -----
    Each wall tried is 1.5 times as thick as the one before until a wall holds; bisection follows. A second search finds
    the least thickness with which no part of the projectile comes out of the rear face. A wall also counts as holding
    if the projectile is still in motion at the termination time, or has turned by more than 360°; a warning appears if
    such a wall is next to the change. Without a plug and a crater (see `Resistance`) the result is thinner than real
    walls have to be: compare it with `solver.formulas`.

    Examples
    --------
    >>> from solver import least_thickness
    >>> from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
    >>> impact = paper_impact(oblique_angle_degrees=30.0)
    >>> found = least_thickness(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact)
    >>> f"{found.value:.3f} m"
    '0.223 m'
    """
    require(target.thickness is None, "target.thickness", "must not be given to a search for it")
    require(impact is not None or velocity is not None, "velocity", "must be given, or impact in its place")
    given = _impact(impact, velocity, oblique_angle, angle_of_attack, angular_velocity)

    def strike(thickness: float) -> PreparedStrike:
        wall = replace(target, thickness=thickness)
        return _prepare(projectile, wall, given.velocity, resistance, numerics), given

    bounds = (LEAST_THICKNESS * projectile.diameter, MOST_DIAMETERS * projectile.diameter)
    return _search(strike, bounds, tolerance, perforated_at_first=True)


def limit_velocity(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact | None = None,
    oblique_angle: float | None = None,
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    tolerance: float = TOLERANCE,
) -> PerforationLimit:
    """Find the least velocity at which a projectile perforates a wall, its ballistic limit in this model.

    Parameters
    ----------
    projectile
        Projectile that strikes the wall.
    target
        Wall, with its thickness.
    impact
        Motion of the projectile at first contact; its velocity is not used.
    oblique_angle, angle_of_attack, angular_velocity
        Fields of the impact, in place of `impact`. [rad, rad, rad/s]
    resistance
        Resistance of the target; by default the strength factor of eq. 9 with elastic-plastic decay.
    numerics
        Integration method and resolution; adaptive with a relative tolerance of 3e-5 and 8 stations unless given.
    tolerance
        Width of the final bracket, relative to the velocity. [1]

    Returns
    -------
    PerforationLimit
        Result of the search. Its status is ``never_perforated`` if the wall holds at 2,000 m/s.

    Raises
    ------
    ParameterError
        If an input is outside its range, or the target has no thickness.
    IntegrationError
        If a run could not be integrated.

    Notes
    -----
    Each velocity tried is 1.5 times the one before, from 1 m/s, until a velocity perforates; bisection follows. A
    second search finds the greatest velocity at which no part of the projectile comes out of the rear face. The wall
    also counts as holding if the projectile is still in motion at the termination time, or has turned by more than
    360°; a warning appears if such a trial is next to the change.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from solver import limit_velocity
    >>> from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
    >>> wall = replace(PAPER_TARGET, thickness=0.2)
    >>> found = limit_velocity(projectile=PAPER_PROJECTILE, target=wall, oblique_angle=0.0)
    >>> f"{found.value:.0f} m/s"
    '214 m/s'
    """
    require(target.thickness is not None, "target.thickness", "must be given: a half-space is not perforated")

    given = _impact(impact, None, oblique_angle, angle_of_attack, angular_velocity)

    def strike(velocity: float) -> PreparedStrike:
        return _prepare(projectile, target, velocity, resistance, numerics), replace(given, velocity=velocity)

    return _search(strike, VELOCITIES, tolerance, perforated_at_first=False)


def _impact(
    impact: Impact | None,
    velocity: float | None,
    oblique_angle: float | None,
    angle_of_attack: float,
    angular_velocity: float,
) -> Impact:
    """Return the impact, given either as an object or as numbers.

    Raises
    ------
    ParameterError
        If both forms are given, or neither.
    """
    numbers = {
        "velocity": velocity,
        "oblique_angle": oblique_angle,
        "angle_of_attack": angle_of_attack or None,
        "angular_velocity": angular_velocity or None,
    }
    if impact is not None:
        for name, number in numbers.items():
            require(number is None, name, "must not be given beside impact")
        return impact
    if oblique_angle is None:
        raise ParameterError("oblique_angle", "must be given, or impact in its place")
    return Impact(
        velocity=VELOCITIES[0] if velocity is None else velocity,
        oblique_angle=oblique_angle,
        angle_of_attack=angle_of_attack,
        angular_velocity=angular_velocity,
    )


def _prepare(
    projectile: Projectile, target: Target, velocity: float, resistance: Resistance | None, numerics: Numerics | None
) -> PreparedCase:
    given = numerics or USUAL
    method = given.method or "adaptive"
    return prepare(
        projectile=projectile,
        target=target,
        resistance=usual_unless_given(resistance),
        numerics=given.resolved(
            method=method,
            termination_time=usual_termination_time(length=projectile.length, velocity=velocity, method=method),
            relative_tolerance=RUN_TOLERANCE,
            stations=RUN_STATIONS,
        ),
    )


def _search(
    strike: Callable[[float], PreparedStrike],
    bounds: tuple[float, float],
    tolerance: float,
    *,
    perforated_at_first: bool,
) -> PerforationLimit:
    """Search upward for the first change to or from perforation, and for the limit without protrusion.

    Parameters
    ----------
    strike
        Function from a thickness or velocity to the prepared strike.
    perforated_at_first
        Whether the projectile perforates at the lower bound if there is a limit: True for a thickness, False for a
        velocity.
    """
    # A finer tolerance is far below the error of a run, and a wider bracket says little; both bounds are arbitrary.
    require_between("tolerance", tolerance, 1e-8, 0.1)
    always, never = PerforationStatus.ALWAYS_PERFORATED, PerforationStatus.NEVER_PERFORATED
    trials: dict[float, PerforationTrial] = {}
    warnings: dict[float, tuple[ModelWarning, ...]] = {}
    end_times: dict[float, float] = {}

    def trial_at(value: float) -> PerforationTrial:
        if value in trials:
            return trials[value]
        prepared, impact = strike(value)
        model = prepared.model._replace(law=prepared.law_at(impact))
        run, _ = integrate(prepared, model, impact, keep_steps=False)
        outcome = OUTCOMES[run.end]
        left = exit_of(outcome, run.state.tolist(), model.body)
        trials[value] = PerforationTrial(
            value, outcome, left, protrusion_of(outcome, run, model.body, prepared.target.thickness)
        )
        warnings[value] = run_warnings(prepared, impact, run, outcome)
        if run.end == Termination.TIME:
            end_times[value] = run.time
        return trials[value]

    def perforated(value: float) -> bool:
        return trial_at(value).outcome is Outcome.PERFORATED

    def comes_out(value: float) -> bool:
        return trial_at(value).comes_out

    bracket, status = None, never if perforated_at_first else always
    if perforated(bounds[0]) is perforated_at_first:
        bracket = _first_change(perforated, bounds, tolerance)
        if bracket is None:
            status = always if perforated_at_first else never
    value, last = None if bracket is None else bracket[1], next(reversed(trials))
    # The nose comes out of walls somewhat thicker than those that the body perforates, and at velocities somewhat below
    # the limit, so a second search is needed.
    beside = _first_change(comes_out, bounds, tolerance) if comes_out(bounds[0]) is perforated_at_first else None

    # The shots of `OwnTests` were not fired at walls of the trial thickness, so a warning that they went deeper would
    # be wrong.
    others = {UNDECIDED, DEEPER_THAN_WALL} if perforated_at_first else {UNDECIDED}
    found = [each for each in warnings[value or last] if each.code not in others]
    tumbled = [each for each in warnings[bracket[0]] if each.code == TUMBLING] if bracket else []
    found += tumbled if TUMBLING not in {each.code for each in found} else []
    if perforated_at_first and status is not never:
        perforating = [each for each in trials.values() if each.outcome is Outcome.PERFORATED]
        passed = [(each.value, each.exit) for each in perforating if each.exit]
        found += check_walls(*strike(last), passed)
    if unfinished := [end_times[each] for each in (*(bracket or trials), *(beside or ())) if each in end_times]:
        found.append((undecided if bracket is None else decided_by_time)(termination_time=max(unfinished)))
    return PerforationLimit(
        quantity="thickness" if perforated_at_first else "velocity",
        status=PerforationStatus.CONVERGED if bracket else status,
        value=value,
        bracket=bracket,
        iterations=tuple(trials.values()),
        # The end of the bracket without protrusion is the limit: the thicker wall, or the lower velocity.
        without_protrusion=None if beside is None else beside[1 if perforated_at_first else 0],
        warnings=tuple(found),
    )


def _first_change(
    holds: Callable[[float], bool], bounds: tuple[float, float], tolerance: float
) -> tuple[float, float] | None:
    """Return the values between which a condition first changes above the lower bound; None if it never does.

    Each value tried is `GROWTH` times the one before, up to the upper bound; bisection to the tolerance follows.
    """
    # The condition is true or false, without a magnitude that a method faster than bisection could use.
    value, upper = bounds
    before, at_first = value, holds(value)
    while holds(value) is at_first:
        if value == upper:
            return None
        before, value = value, min(GROWTH * value, upper)
    while value - before > tolerance * value:
        middle = 0.5 * (before + value)
        before, value = (middle, value) if holds(middle) is at_first else (before, middle)
    return before, value
