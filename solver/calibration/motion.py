"""Strength factor from the motion of one oblique strike, measured or computed by finite elements (section 3.2)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver import warnings as model_warnings
from solver.arrays import FloatArray
from solver.calibration.estimate import (
    Estimate,
    build_estimate,
    coarse_strengths,
    log_slope,
    minimise,
    refine,
    require_confidence_level,
    valleys,
)
from solver.calibration.history import QUANTITIES, MotionHistory, Weights, check_reach
from solver.calibration.strike import Strike
from solver.impact import Impact
from solver.numerics import Numerics
from solver.prepared import PreparedCase
from solver.projectile import Projectile
from solver.resistance import Resistance
from solver.target import Target
from solver.validation import require
from solver.warnings import ModelWarning

FIT_TOLERANCE = 1e-6
"""Relative tolerance of the runs of a fit, unless said otherwise: right to micrometres and thousandths of a degree."""
ROUGH = Numerics(relative_tolerance=1e-3, stations=5, points=3)
"""Of the first look: to a tenth of a millimetre, in a fraction of the time."""
FIRST_LOOK = 41
"""Strength factors tried before the fit, 12 % apart: the outcome can flip with S, and each has its own minimum."""
SMALLEST_SPAN = 1e-3
"""Of a quantity, over the length of the body or a radian: one that hardly changes must not weigh without bound."""
FEWEST_SAMPLES = 2.0
"""Independent samples that a quantity counts at least, however alike neighbours err."""
RIVAL = 1.5
"""Sum of squares of another minimum, over the least, up to which it is told of. [1]"""
POOR = 0.9
"""Share of the variance explained below which a fit is called poor. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFit:
    """Strength factor that fits a motion best."""

    estimate: Estimate
    predicted: MotionHistory
    """At the fitted S and the given times."""
    residuals: MotionHistory
    """Given minus predicted, of the quantities that were given."""
    root_mean_square: Mapping[str, float]
    """Of the residuals, by quantity. [m, m, rad]"""
    r_squared: Mapping[str, float]
    """Share of its variance that the prediction explains, by quantity; absent for one that never changes. [1]"""
    warnings: tuple[ModelWarning, ...]


@dataclass(frozen=True, slots=True)
class _Problem:
    """The quantities to fit, with their weights."""

    strike: Strike
    given: dict[str, FloatArray]
    weights: dict[str, float]
    spans: dict[str, float]

    def residuals(self, strength_factor: float) -> FloatArray:
        """Weighted residuals at a strength factor, the quantities one after another."""
        columns = self.strike.columns(strength_factor)
        return np.concatenate(
            [math.sqrt(self.weights[q]) / self.spans[q] * (self.given[q] - columns[q]) for q in self.given]
        )


def fit_motion(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    history: MotionHistory,
    weights: Weights | None = None,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    confidence_level: float = 0.95,
) -> MotionFit:
    """Strength factor that fits a motion best, by least squares over the quantities that are there.

    Parameters
    ----------
    projectile, target, impact
        What struck, what was struck, and how.
    history
        The motion to fit.
    weights
        Of the quantities; all alike unless given.
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Route and resolution; adaptive unless given.
    confidence_level
        Of the interval. [1]

    Returns
    -------
    MotionFit

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts, or the history does not tell the strength factor.

    Notes
    -----
    Section 3.2, which says no more than "least square". Here each quantity is scaled by its span, so that metres and
    radians can be added and each counts for as much: weighed by the scatter of their residuals, the quantity that the
    model happens to follow best would take over. What lies between a model and a motion is no white noise: neighbours
    err alike. The standard error therefore counts, for each quantity, n (1-r)/(1+r)
    samples, r being the autocorrelation of its residuals at lag one, at least 0 (Bayley and Hammersley 1946; von Storch
    and Zwiers 1999, 6.6). Rows should be about evenly apart for that. An error of the model that all rows share moves
    S itself, and no interval tells of it.
    """
    require_confidence_level(confidence_level)
    check_reach(projectile, impact, history)
    settings = (numerics or Numerics()).resolved(relative_tolerance=FIT_TOLERANCE)
    rough = Strike(projectile, target, impact, resistance, ROUGH.resolved(), history.time)
    strike = Strike(projectile, target, impact, resistance, settings, history.time)
    problem = _problem(strike, history, weights or Weights())
    start, rivals = _first_look(replace(problem, strike=rough))
    best = minimise(problem.residuals, start, "history")
    predicted = strike.columns(best)
    residuals = {q: values - predicted[q] for q, values in history.columns.items()}
    explained = _explained(history, residuals)
    return MotionFit(
        estimate=_estimate(problem, best, confidence_level),
        predicted=MotionHistory(time=history.time, **predicted),
        residuals=MotionHistory(time=history.time, **residuals),
        root_mean_square={q: _root_mean_square(values) for q, values in residuals.items()},
        r_squared=explained,
        warnings=_warnings(strike.prepared, impact, explained, rivals),
    )


def _problem(strike: Strike, history: MotionHistory, weights: Weights) -> _Problem:
    given = {q: values for q, values in history.columns.items() if weights.of(q) > 0.0}
    require(bool(given), "weights", "must be greater than 0 for a quantity of the history")
    length = strike.prepared.projectile.length
    units = {"depth_displacement": length, "lateral_displacement": length, "rotation": 1.0}
    spans = {q: max(float(np.ptp(values)), SMALLEST_SPAN * units[q]) for q, values in given.items()}
    return _Problem(strike, given, {q: weights.of(q) for q in given}, spans)


def _first_look(problem: _Problem) -> tuple[float, tuple[float, ...]]:
    """Where the sum of squares is least, and where else it is nearly as small."""
    residuals = problem.residuals
    strengths = coarse_strengths(FIRST_LOOK)
    costs = np.array([float(np.sum(residuals(float(value)) ** 2)) for value in strengths])
    found = sorted(
        (refine(residuals, low, high) for low, _, high in valleys(strengths, costs)), key=lambda valley: valley[1]
    )
    (best, least), others = found[0], found[1:]
    return best, tuple(value for value, cost in others if cost < RIVAL * least)


def _root_mean_square(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _independent(residuals: FloatArray) -> float:
    """Samples that count as independent among residuals of which neighbours err alike."""
    square = float(residuals @ residuals)
    if square == 0.0:
        return float(residuals.size)
    alike = max(0.0, float(residuals[:-1] @ residuals[1:]) / square)
    return max(FEWEST_SAMPLES, residuals.size * (1.0 - alike) / (1.0 + alike))


def _estimate(problem: _Problem, best: float, confidence_level: float) -> Estimate:
    """Standard error by the sandwich, with the scatter and the independent samples of each quantity.

    The degrees of freedom are those of Welch and Satterthwaite for a sum of such parts.
    """
    columns = problem.strike.columns(best)
    slope = log_slope(lambda factor: np.concatenate(list(problem.strike.columns(factor).values())), best)
    slopes = dict(zip(QUANTITIES, np.split(slope, len(QUANTITIES)), strict=True))
    bread = {q: problem.weights[q] / problem.spans[q] ** 2 * float(slopes[q] @ slopes[q]) for q in problem.given}
    total = sum(bread.values())
    variance, spread = 0.0, 0.0
    for q, given in problem.given.items():
        error = given - columns[q]
        count = _independent(error)
        freedom = count - bread[q] / total
        # Mean square over the share of independent samples that the fit has not used up, times n / count.
        part = problem.weights[q] / problem.spans[q] ** 2 * bread[q] * float(error @ error) / freedom
        variance += part
        spread += part**2 / freedom
    return build_estimate(
        strength_factor=best,
        standard_error=best * math.sqrt(variance) / total,
        degrees_of_freedom=variance**2 / spread if spread > 0.0 else float(sum(map(len, problem.given.values())) - 1),
        confidence_level=confidence_level,
    )


def _explained(history: MotionHistory, residuals: dict[str, FloatArray]) -> dict[str, float]:
    """Share of the variance of each quantity that the fit explains."""
    found = {}
    for q, values in history.columns.items():
        square = float(np.sum((values - values.mean()) ** 2))
        if square > 0.0:
            found[q] = 1.0 - float(np.sum(residuals[q] ** 2)) / square
    return found


def _warnings(
    prepared: PreparedCase, impact: Impact, explained: Mapping[str, float], rivals: Sequence[float]
) -> tuple[ModelWarning, ...]:
    found = list(
        model_warnings.input_warnings(
            projectile=prepared.projectile,
            target=prepared.target,
            velocity=impact.velocity,
            angle_of_attack=impact.angle_of_attack,
        )
    )
    for q, share in explained.items():
        if share < POOR:
            detail = f"the fit explains {max(share, 0.0):.0%} of the variance of {q}"
            found.append(ModelWarning("poor_fit", detail))
    for rival in rivals:
        detail = f"a strength factor near {rival:.3g} fits nearly as well: the interval knows of one minimum only"
        found.append(ModelWarning("second_minimum", detail))
    return tuple(found)
