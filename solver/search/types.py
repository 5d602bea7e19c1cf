"""Inputs and results of a search for the critical angle."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np

from solver.checks import require, require_angle, require_between
from solver.display import Axes, Columns, DataFrame, Figure, Row, card, dataframe, line, plot_search
from solver.prepared import Exit, Outcome
from solver.resistance import StrengthPosterior
from solver.warnings import ModelWarning

SearchMethod: TypeAlias = Literal["outcome", "bisection", "secant"]


class SearchStatus(StrEnum):
    """Status of a search: an angle was found, or the reason why none was."""

    CONVERGED = "converged"
    NO_RICOCHET = "no_ricochet"
    ALWAYS_RICOCHET = "always_ricochet"
    NOT_CONVERGED = "not_converged"


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Method, range and tolerances of a search for the critical angle.

    Parameters
    ----------
    method
        ``outcome`` brackets the change of outcome. ``bisection`` and ``secant`` are the paper's searches for the angle
        at which the depth of the nose tip at the termination time is zero (eqs. 7 and 8).
    lower
        Lower end of the range; 5° unless given, or 40° for the paper's searches. [rad]
    upper
        Upper end of the range; 85° unless given, or 60° for the paper's searches. [rad]
    tolerance
        Width of the final bracket of ``outcome``. [rad]
    relative_tolerance
        Relative difference of two consecutive angles at which the paper's searches end. [1]
    scan_interval
        Spacing of the angles that ``outcome`` scans. The scan begins with every sixteenth angle. It skips the angles
        between two at which the projectile is clearly turned away, or clearly not, and angles within four intervals of
        a change. It misses a band of another outcome that lies between two angles tried. By default such a band is
        narrower than 1.25°, than 5° near a change, or than 20° where more than 15 % of the energy is left or the nose
        is deep inside. Above the first critical angle every half degree is tried as long as less than twice the
        retention energy is left. [rad]

    Raises
    ------
    ParameterError
        If the method is unknown, or a value is outside its range.

    Examples
    --------
    >>> import math
    >>> from solver import Search
    >>> fine = Search(lower=math.radians(30.0), upper=math.radians(70.0), tolerance=math.radians(0.001))
    """

    method: SearchMethod = "outcome"
    lower: float | None = None
    upper: float | None = None
    # 0.01° is a tenth of the last digit that a verdict shows for the usual scatter. The relative tolerance of one per
    # cent is the paper's. The default range has 64 intervals of 1.25°, a multiple of the 16 with which the scan begins.
    tolerance: float = math.radians(0.01)
    relative_tolerance: float = 0.01
    scan_interval: float = math.radians(1.25)

    def __post_init__(self) -> None:
        known = self.method in ("outcome", "bisection", "secant")
        require(known, "search.method", "must be 'outcome', 'bisection' or 'secant'")
        lower, upper = self.bounds
        require_angle("search.lower", lower, below=True)
        require_angle("search.upper", upper, below=True)
        require(
            0.0 <= lower < upper,
            "search.lower",
            f"must be at least 0° and below the upper end, got {math.degrees(lower):g}° and {math.degrees(upper):g}°",
        )
        # Finer tolerances are below the error of a trial, and a scan at 0.1° already takes up to 800 trials. The upper
        # bounds are arbitrary: beyond them a search would say little.
        require_between("search.tolerance", self.tolerance, math.radians(1e-6), math.radians(10.0))
        require_between("search.relative_tolerance", self.relative_tolerance, 1e-8, 0.5)
        require_between("search.scan_interval", self.scan_interval, math.radians(0.1), math.pi / 2.0)

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper end of the range. [rad]"""
        # The paper searches from 40° to 60°. Below 5° a projectile moves nearly along the normal, above 85° nearly
        # along the face; both ends are arbitrary.
        lower, upper = (5.0, 85.0) if self.method == "outcome" else (40.0, 60.0)
        return (
            math.radians(lower) if self.lower is None else self.lower,
            math.radians(upper) if self.upper is None else self.upper,
        )


USUAL_SEARCH = Search()
"""Default search, by outcome from 5° to 85°."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Run of a search at one oblique angle."""

    oblique_angle: float
    """Angle tried, from the inward normal of the face to the velocity. [rad]"""
    final_position: float
    """Depth of the nose tip at the end of the trial, or at the termination time in the paper's searches. [m]"""
    outcome: Outcome
    """Outcome of the run."""
    fine: bool = True
    """True for a trial at the final resolution. Other trials only narrow the range: they are less accurate, and may
    have the wrong outcome within a degree of the critical angle."""
    exit: Exit | None = None
    """State of the projectile as it leaves the target; None if it stays."""
    turned: float = 0.0
    """Angle by which the axis has turned by the end of the trial; 0 for a sphere, whose axis has no effect. [rad]"""


@dataclass(frozen=True, slots=True)
class OutcomeInterval:
    """Interval of oblique angles at which a strike has one outcome."""

    outcome: Outcome
    """Outcome of a strike in the interval."""
    lower: float
    """Lower end: a change of outcome, known to the tolerance of the search, or the lower end of its range. [rad]"""
    upper: float
    """Upper end: a change of outcome, known to the tolerance of the search, or the upper end of its range. [rad]"""


@dataclass(frozen=True, slots=True, repr=False)
class CriticalAngle:
    """Critical angle of a strike, or the reason why there is none, with all trials of the search."""

    status: SearchStatus
    """Result of the search: an angle, or the reason why there is none."""
    angle: float | None
    """Smallest oblique angle, from the normal, at which the projectile is turned away, if there is one. In a search by
    outcome it is the upper end of the final bracket, at which a trial ended in ricochet. [rad]"""
    bracket: tuple[float, float] | None
    """Angles on either side of the change of outcome at the end of the search; with ``secant``, the last two angles.
    [rad]"""
    iterations: tuple[Trial, ...]
    """All trials, in the order of computation."""
    other_crossings: tuple[float, ...]
    """Other angles in the range at which ricochet begins or ends. [rad]"""
    warnings: tuple[ModelWarning, ...]
    standard_error: float | None = None
    """Standard error of the critical angle, from the covariance of the strength factor, if one was given. [rad]"""
    energy_fraction_below: float | None = None
    """Share of the initial kinetic energy left half a degree below the critical angle; 0 if it is less than a tenth of
    the retention energy. None without an angle, and in the paper's searches. [1]"""
    energy_fraction_above: float | None = None
    """Share of the initial kinetic energy left half a degree above the critical angle. The smaller it is, the more the
    angle depends on the retention energy. [1]"""
    strength_factor: float | None = None
    """Strength factor used at the critical angle, if there is one. [1]"""
    strength_factor_dispersion: float | None = None
    """Standard deviation of ln S for the next shot into the same concrete, from shots into it, or else from the
    published tests; None without an angle. [ln]"""
    own_tests: StrengthPosterior | None = None
    """Posterior of S from shots into the same concrete; None without such shots, or without an angle."""
    exit: Exit | None = None
    """State of the projectile as it leaves the target at the critical angle. None without an angle, or if the trial at
    the angle stays in the target, as it may in the paper's searches."""
    outcomes: tuple[OutcomeInterval, ...] = ()
    """Intervals of one outcome each over the whole range, in order; empty unless the target has a thickness and the
    search is by outcome."""

    def row(self) -> Row:
        """Return status, angle, standard error, bracket and strength factor by column name, with angles in radians."""
        low, high = self.bracket or (None, None)
        return {
            "status": self.status.value,
            "angle": self.angle,
            "standard_error": self.standard_error,
            "bracket_low": low,
            "bracket_high": high,
            "strength_factor": self.strength_factor,
        }

    def columns(self) -> Columns:
        """Return the trials as arrays by name, in the order of computation: angles in radians, positions in metres."""
        trials = self.iterations
        return {
            "oblique_angle": np.array([trial.oblique_angle for trial in trials], float),
            "final_position": np.array([trial.final_position for trial in trials], float),
            "outcome": np.array([trial.outcome.value for trial in trials], str),
            "fine": np.array([trial.fine for trial in trials], bool),
        }

    def to_dataframe(self) -> DataFrame:
        """Return the trials as a ``pandas.DataFrame``; requires pandas."""
        return dataframe(self.columns(), Trial)

    def plot(self, *, ax: "Axes | None" = None) -> Figure:
        """Plot the trials and the angle, in a new pyplot figure unless axes are given; return the figure."""
        return plot_search(self.columns(), self._summary(), self.angle, ax)

    def _summary(self) -> str:
        if self.angle is None:
            return self._why_none()
        error = "" if self.standard_error is None else f" ± {math.degrees(self.standard_error):.2f}°"
        return f"critical angle {math.degrees(self.angle):.2f}°{error}"

    def _why_none(self) -> str:
        trials = sorted(self.iterations, key=lambda trial: trial.oblique_angle)
        if self.status is SearchStatus.ALWAYS_RICOCHET:
            return f"no critical angle: turned away at {math.degrees(trials[0].oblique_angle):.0f}° already"
        if self.status is SearchStatus.NO_RICOCHET:
            return f"no critical angle: {trials[-1].outcome} at {math.degrees(trials[-1].oblique_angle):.0f}° too"
        return f"no critical angle: {self.status.replace('_', ' ')}"

    def __repr__(self) -> str:
        found = "" if self.angle is None else self.status.replace("_", " ")
        factor = "" if self.strength_factor is None else f"strength factor {self.strength_factor:.3g}"
        return line(self, self._summary(), found, factor, f"{len(self.iterations)} trials")

    def _repr_html_(self) -> str:
        rows = {
            "status": self.status.replace("_", " "),
            "bracket": "" if self.bracket is None else " to ".join(map(_degrees, self.bracket)),
            "outcome changes too at": ", ".join(map(_degrees, self.other_crossings)),
            "leaves at": "" if self.exit is None else f"{self.exit.speed:.1f} m/s at the angle",
            "strength factor": "" if self.strength_factor is None else f"{self.strength_factor:.4g}",
            "trials": str(len(self.iterations)),
        }
        return card(self._summary(), rows, self.warnings)


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.3f}°"


@dataclass(frozen=True, slots=True)
class Change:
    """Changes of outcome that a search has found, before warnings are added."""

    status: SearchStatus
    angle: float | None = None
    """Smallest angle of a change to ricochet. [rad]"""
    bracket: tuple[float, float] | None = None
    """Angles on either side of the change to ricochet at `angle`. [rad]"""
    other_crossings: tuple[float, ...] = ()
    """Other angles at which ricochet begins or ends. [rad]"""
    starts_turned_away: bool = False
    """True if the projectile is turned away at the lower end of the range."""
    deciding: tuple[Trial, ...] = ()
    """Trials on either side of each change of outcome, if the result depends on these alone; empty if it depends on
    all trials."""
    nearby: tuple[float, float, float] | None = None
    """Fractions of the energy left half a degree below the angle, half a degree above it, and half a degree above it
    with more inertia. [1]"""
    outcomes: tuple[OutcomeInterval, ...] = ()
    perforations: tuple[tuple[float, float, float], ...] = ()
    """Angle of each change to or from perforation, and fractions of the energy left half a degree outside and inside
    the perforated range. [rad, 1, 1]"""
