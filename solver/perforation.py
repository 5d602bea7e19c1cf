"""Perforation of a wall: the least thickness that stops a projectile, and the least velocity that gets through."""

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
from solver.warnings import DEEPER_THAN_WALL, TUMBLING, UNDECIDED, ModelWarning, decided_by_time, undecided

MOST_DIAMETERS = 1000.0
"""Thickest wall that is tried, over the diameter of the projectile: far more than a rigid projectile goes. [1]"""
VELOCITIES = (1.0, 2000.0)
"""Range that is searched: no projectile stays rigid at its upper end. [m/s]"""
GROWTH = 1.5
"""From trial to trial until the outcome changes. [1]"""
TOLERANCE = 1e-4
"""Width of the final bracket over its upper end. [1]"""
RUN_TOLERANCE, RUN_STATIONS = 3e-5, 8
"""Relative tolerance and stations of the runs unless given: what is found is within 5e-5 of its converged value. [1]"""


PreparedStrike: TypeAlias = tuple[PreparedCase, Impact]


class PerforationStatus(StrEnum):
    """How a search for perforation ended."""

    CONVERGED = "converged"
    ALWAYS_PERFORATED = "always_perforated"
    NEVER_PERFORATED = "never_perforated"


@dataclass(frozen=True, slots=True)
class PerforationTrial:
    """One wall or velocity tried."""

    value: float
    """Thickness or velocity. [m or m/s]"""
    outcome: Outcome
    """How the trial ended."""
    exit: Exit | None
    """How the projectile left; None if it did not."""
    protrusion: Protrusion | None
    """How far it stood out of the rear face of a wall that it did not perforate; None if nothing of it did."""

    @property
    def comes_out(self) -> bool:
        """Whether anything of the projectile was ever beyond the rear face."""
        return self.outcome is Outcome.PERFORATED or self.protrusion is not None


@dataclass(frozen=True, slots=True, repr=False)
class PerforationLimit:
    """Answer of `least_thickness` or `limit_velocity`."""

    quantity: Literal["thickness", "velocity"]
    """What was sought."""
    status: PerforationStatus
    """How the search ended."""
    value: float | None
    """Least thickness that was seen to stop the projectile, or least velocity that was seen to perforate; None if the
    outcome does not change in the range. [m or m/s]"""
    bracket: tuple[float, float] | None
    """Values between which the outcome was last pinned down. [m or m/s]"""
    iterations: tuple[PerforationTrial, ...]
    """Every trial, in order."""
    without_protrusion: float | None
    """Least thickness with which nothing of the projectile was seen to come out of the rear face, or greatest velocity;
    None if something does over all of the range, or nothing. [m or m/s]"""
    warnings: tuple[ModelWarning, ...]
    """Those of the trial at the value found, of the last trial if there is none, and ``undecided`` if a trial on either
    side of the change, or any trial if there is none, was still in motion at its termination time; so too beside the
    value without protrusion."""

    def row(self) -> Row:
        """Return what was found, by the names of the columns of `solver.columns`."""
        low, high = self.bracket or (None, None)
        return {
            "status": self.status.value,
            "value": self.value,
            "value_low": low,
            "value_high": high,
            "without_protrusion": self.without_protrusion,
        }

    def columns(self) -> Columns:
        """Return the trials as arrays by name, in order."""
        trials = self.iterations
        return {
            "value": np.array([trial.value for trial in trials], float),
            "outcome": np.array([trial.outcome.value for trial in trials], str),
        }

    def to_dataframe(self) -> DataFrame:
        """Return the trials as a ``pandas.DataFrame``, which has to be installed."""
        return dataframe(self.columns(), PerforationTrial)

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Return the speed behind the wall of each trial as a ``matplotlib.figure.Figure``.

        It is one of pyplot unless axes are given.
        """
        behind = [trial.exit if trial.outcome is Outcome.PERFORATED else None for trial in self.iterations]
        trials = self.columns() | {"speed": np.array([0.0 if each is None else each.speed for each in behind])}
        label = "thickness of the wall [m]" if self.quantity == "thickness" else "velocity at first contact [m/s]"
        return plot_perforation(trials, self._summary(), label, self.bracket, ax)

    def _summary(self) -> str:
        name, unit = ("least thickness", "m") if self.quantity == "thickness" else ("limit velocity", "m/s")
        status = self.status.replace("_", " ")
        return f"no {name}, {status}" if self.value is None else f"{name} {self.value:.4g} {unit}"

    def __repr__(self) -> str:
        return line(self, self._summary(), f"{len(self.iterations)} trials")

    def _repr_html_(self) -> str:
        unit = "m" if self.quantity == "thickness" else "m/s"
        rows = {
            "status": self.status.replace("_", " "),
            "bracket": "" if self.bracket is None else " to ".join(f"{value:.5g} {unit}" for value in self.bracket),
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
    """Least thickness of a wall that a strike does not perforate: it is embedded or turned away.

    Parameters
    ----------
    projectile
        What strikes.
    impact
        How it strikes.
    velocity, oblique_angle, angle_of_attack, angular_velocity
        The same as numbers, in place of `impact`. [m/s, rad, rad, rad/s]
    target
        The concrete, without a thickness.
    resistance
        Resistance of the target; eq. 9 and elastic-plastic decay unless given.
    numerics
        Route and resolution; adaptive with a relative tolerance of 3e-5 and 8 stations unless given.
    tolerance
        Width of the final bracket over the thickness. [1]

    Returns
    -------
    PerforationLimit
        ``never_perforated`` if not even the thinnest wall is that the model takes, a tenth of the diameter.

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts, or the target has a thickness.
    IntegrationError
        If a run could not be integrated.

    Notes
    -----
    Each wall is half as thick again as the one before until one holds; bisection follows. Then the same for the least
    wall out of whose rear face nothing of the projectile comes. A wall that is not perforated
    by the termination time, or before the projectile has turned by more than 360°, counts as one that holds, with a
    warning if it is next to the change. Without a plug that
    shears out and a crater, see `Resistance`, real walls have to be thicker: compare with `solver.formulas`.

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
    """Least velocity at which a projectile perforates a wall, its ballistic limit in this model.

    Parameters
    ----------
    projectile
        What strikes.
    target
        The wall, with its thickness.
    impact
        How it strikes; its velocity is not used.
    oblique_angle, angle_of_attack, angular_velocity
        The same as numbers, in place of `impact`. [rad, rad, rad/s]
    resistance
        Resistance of the target; eq. 9 and elastic-plastic decay unless given.
    numerics
        Route and resolution; adaptive with a relative tolerance of 3e-5 and 8 stations unless given.
    tolerance
        Width of the final bracket over the velocity. [1]

    Returns
    -------
    PerforationLimit
        ``never_perforated`` if the wall holds at 2,000 m/s.

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts, or the target has no thickness.
    IntegrationError
        If a run could not be integrated.

    Notes
    -----
    Each velocity is half as high again as the one before, from 1 m/s, until one perforates; bisection follows. Then the
    same for the greatest velocity at which nothing of the projectile comes out of the rear face. A wall
    that is not perforated by the termination time counts as one that holds, with a warning if it is next to the change.

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
    """Return what was given as an object or as numbers.

    Raises
    ------
    ParameterError
        If it was given as both, or as neither.
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
    """Least value from the lower bound on at which the wall is perforated, or is not, unlike at that bound."""
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
    # The nose comes out of walls somewhat thicker than those that are perforated, at speeds somewhat lower.
    beside = _first_change(comes_out, bounds, tolerance) if comes_out(bounds[0]) is perforated_at_first else None

    # The wall of a trial thickness is not the target of one's own shots.
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
        # On the side on which nothing comes out: that of thicker walls, and of lower speeds.
        without_protrusion=None if beside is None else beside[1 if perforated_at_first else 0],
        warnings=tuple(found),
    )


def _first_change(
    holds: Callable[[float], bool], bounds: tuple[float, float], tolerance: float
) -> tuple[float, float] | None:
    """Values between which a condition changes first from the lower bound on; None if it does not change.

    Each value is `GROWTH` times the one before, up to the upper bound; bisection to the tolerance follows.
    """
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
