"""Strength factor fitted to motions of oblique strikes, measured or computed by finite elements (section 3.2)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from solver import warnings as model_warnings
from solver.arrays import FloatArray
from solver.calibration.history import QUANTITIES, FittedStrike, MotionHistory, MotionRun, Weights, check_reach
from solver.calibration.strength_factor import (
    Estimate,
    UndeterminedError,
    build_estimate,
    coarse_strengths,
    log_slope,
    minimise,
    refine,
    require_confidence_level,
    valleys,
)
from solver.checks import ParameterError, require
from solver.free_surface import FreeSurface
from solver.projectile import Projectile
from solver.resistance import Resistance, usual_unless_given
from solver.strike import Impact, Numerics
from solver.target import Target
from solver.warnings import ModelWarning

# With this tolerance motions are accurate to less than a tenth of a millimetre and to some thousandths of a degree, and
# their derivatives with respect to S to 1 %.
FIT_TOLERANCE = 1e-6
"""Default relative tolerance of the runs of a fit. [1]"""
# With these settings motions are accurate to 0.2 mm and 0.1°. This is enough to find the local minima, and takes a
# fraction of the time.
ROUGH = Numerics(relative_tolerance=1e-3, stations=5, points=3)
"""Numerical settings of the runs that find local minima before the fit."""
# The outcome may change with S, and each outcome may have its own minimum of the sum of squares. With 41 values,
# neighbouring factors differ by 12 %.
FIRST_LOOK = 41
"""Number of strength factors on the coarse grid."""
# Residuals are divided by the span of their quantity, so a quantity that hardly changes would have an unlimited weight.
SMALLEST_SPAN = 1e-3
"""Least span by which the residuals of a quantity are divided, relative to the body length or one radian. [1]"""
# A variance needs more than one sample, however strong the autocorrelation of the residuals.
FEWEST_SAMPLES = 2.0
"""Least number of independent samples of a quantity."""
# If the sum of squares at another minimum is less than 1.5 times the least, either minimum may be the true one; the
# value is arbitrary.
RIVAL = 1.5
"""Ratio of the sum of squares at another minimum to the least one, below which a warning names that minimum. [1]"""
# A good fit of a smooth motion explains more than 99 % of the variance. The value is arbitrary.
POOR = 0.9
"""Fraction of the variance explained, below which a warning calls a fit poor. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFit:
    """Strength factor fitted to a motion by least squares."""

    estimate: Estimate
    """Fitted strength factor with its interval."""
    predicted: MotionHistory
    """Motion at the given times with the fitted S."""
    residuals: MotionHistory
    """Given minus predicted motion, for the given quantities."""
    root_mean_square: Mapping[str, float]
    """Root mean square of the residuals, by quantity. [m, m, rad]"""
    normalized_root_mean_square: float
    """Weighted root mean square of the residuals, each relative to the span of its quantity. [1]"""
    r_squared: Mapping[str, float]
    """Fraction of the variance that the prediction explains, by quantity; constant quantities are left out. [1]"""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the inputs and the fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionsFit:
    """Strength factor fitted to the motions of several runs by least squares, with one decay law."""

    free_surface: FreeSurface
    """Decay law of the fit."""
    estimate: Estimate
    """Common strength factor with its interval."""
    normalized_root_mean_square: float
    """Root mean square of the normalised root mean squares of all runs, at the common S. [1]"""
    runs: tuple[MotionFit, ...]
    """Fit of each run at the common S, in the given order."""
    alone: tuple[MotionFit | None, ...]
    """Fit of each run at the S that fits it best; None for a run that does not determine S."""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the inputs and the common fit."""


class _Run:
    """Run that is prepared for any strength factor, with the scales of the fitted quantities."""

    def __init__(
        self,
        run: MotionRun,
        projectile: Projectile,
        target: Target,
        resistance: Resistance | None,
        numerics: Numerics | None,
    ) -> None:
        check_reach(projectile, run.impact, run.history)
        settings = (numerics or Numerics()).resolved(relative_tolerance=FIT_TOLERANCE)
        self.given, self.impact = run.history, run.impact
        self.strike = FittedStrike(projectile, target, run.impact, resistance, settings, run.history.time)
        self.rough = FittedStrike(projectile, target, run.impact, resistance, ROUGH.resolved(), run.history.time)
        self.scales = _scales(run, projectile.length)

    def residuals(self, strength_factor: float, *, rough: bool = False) -> FloatArray:
        """Return the scaled residuals of all quantities; the sum of their squares is the normalised mean square."""
        columns = (self.rough if rough else self.strike).columns(strength_factor)
        return np.concatenate([scale * (self.given.columns[q] - columns[q]) for q, scale in self.scales.items()])

    def slopes(self, strength_factor: float) -> dict[str, FloatArray]:
        """Return the derivatives of the predicted quantities with respect to ln S."""
        slope = log_slope(lambda factor: np.concatenate(list(self.strike.columns(factor).values())), strength_factor)
        return dict(zip(QUANTITIES, np.split(slope, len(QUANTITIES)), strict=True))

    def at(self, estimate: Estimate, rivals: Sequence[float] = ()) -> MotionFit:
        predicted = self.strike.columns(estimate.strength_factor)
        residuals = {q: values - predicted[q] for q, values in self.given.columns.items()}
        explained = _explained(self.given, residuals)
        squares = [scale**2 * float(residuals[q] @ residuals[q]) for q, scale in self.scales.items()]
        return MotionFit(
            estimate=estimate,
            predicted=MotionHistory(time=self.given.time, **predicted),
            residuals=MotionHistory(time=self.given.time, **residuals),
            root_mean_square={q: math.sqrt(float(np.mean(values**2))) for q, values in residuals.items()},
            normalized_root_mean_square=math.sqrt(sum(squares)),
            r_squared=explained,
            warnings=(*self.input_warnings(), *_poor(explained), *_second_minima(rivals)),
        )

    def input_warnings(self) -> tuple[ModelWarning, ...]:
        return tuple(
            model_warnings.input_warnings(
                projectile=self.strike.prepared.projectile,
                target=self.strike.prepared.target,
                velocity=self.impact.velocity,
                angle_of_attack=self.impact.angle_of_attack,
            )
        )


def _scales(run: MotionRun, length: float) -> dict[str, float]:
    """Return the factor on the residuals of each fitted quantity.

    The factor is the square root of the quantity's share of the weights per row, divided by the span of the quantity.
    """
    weights = {q: run.weights.of(q) for q in run.history.columns if run.weights.of(q) > 0.0}
    require(bool(weights), "weights", "must be greater than 0 for a quantity of the history")
    units = {"depth_displacement": length, "lateral_displacement": length, "rotation": 1.0}
    total, rows = sum(weights.values()), len(run.history.time)
    return {
        q: math.sqrt(weight / total / rows) / max(float(np.ptp(run.history.columns[q])), SMALLEST_SPAN * units[q])
        for q, weight in weights.items()
    }


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
    """Fit the strength factor to a motion by least squares over the given quantities.

    Parameters
    ----------
    projectile, target, impact
        Projectile, concrete, and motion at first contact.
    history
        Motion to fit.
    weights
        Weights of the quantities; equal unless given.
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Integration method and resolution; adaptive unless given.
    confidence_level
        Confidence level of the interval. [1]

    Returns
    -------
    MotionFit

    Raises
    ------
    ParameterError
        If an input is outside its range, or the history does not determine the strength factor.

    Notes
    -----
    Section 3.2 of the source paper only specifies "least square". Here each quantity is divided by its span, so that
    metres and radians can be added, and all have the same influence. If the scatter of the residuals determined the
    weights, the quantity that the model happens to follow best would dominate. The difference between a model and a
    motion is not white noise: neighbouring residuals are correlated. The standard error therefore assumes, for each
    quantity, n (1-r)/(1+r) independent samples, where r is the autocorrelation of its residuals at lag one, at least 0
    (Bayley and Hammersley 1946; von Storch and Zwiers 1999, 6.6). The rows must be at about even intervals. The
    interval does not include an error of the model that all rows share, which shifts S itself.
    """
    require_confidence_level(confidence_level)
    run = _Run(
        MotionRun(impact=impact, history=history, weights=weights or Weights()),
        projectile,
        target,
        resistance,
        numerics,
    )
    return run.at(*_fit([run], [_costs(run)], "history", confidence_level))


def fit_motions(
    *,
    projectile: Projectile,
    target: Target,
    runs: Sequence[MotionRun],
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    confidence_level: float = 0.95,
) -> MotionsFit:
    """Fit a common strength factor to the motions of several runs, and a separate one to each run.

    Parameters
    ----------
    projectile, target
        Projectile and concrete, shared by the runs.
    runs
        One or more strikes at any angles and speeds, each with its motion. All runs have the same weight, however many
        rows they have.
    resistance, numerics, confidence_level
        As for `fit_motion`.

    Returns
    -------
    MotionsFit

    Raises
    ------
    ParameterError
        If an input is outside its range, or the runs together do not determine the strength factor. With several runs
        the error names the run, as in ``runs.0.history.time``.

    Notes
    -----
    The method is that of `fit_motion`, over all quantities of all runs. Differences between the runs count as scatter
    of their residuals, with few independent samples: if S changes from run to run, the interval is wide, and the common
    S fits no run well. Compare it with the strength factors in `alone`.
    """
    require_confidence_level(confidence_level)
    require(bool(runs), "runs", "must be at least 1")
    prepared = []
    for index, run in enumerate(runs):
        with _field_prefix(f"runs.{index}." if len(runs) > 1 else ""):
            prepared.append(_Run(run, projectile, target, resistance, numerics))
    costs = [_costs(run) for run in prepared]
    estimate, rivals = _fit(prepared, costs, "runs" if len(runs) > 1 else "history", confidence_level)
    fits = tuple(run.at(estimate, rivals) for run in prepared)
    if len(prepared) == 1:
        alone: tuple[MotionFit | None, ...] = fits
    else:
        alone = tuple(_fit_alone(run, cost, confidence_level) for run, cost in zip(prepared, costs, strict=True))
    squares = [fit.normalized_root_mean_square**2 for fit in fits]
    return MotionsFit(
        free_surface=usual_unless_given(resistance).free_surface,
        estimate=estimate,
        normalized_root_mean_square=math.sqrt(sum(squares) / len(squares)),
        runs=fits,
        alone=alone,
        warnings=fits[0].warnings if len(fits) == 1 else _common_warnings(prepared, fits, alone, rivals),
    )


@contextmanager
def _field_prefix(prefix: str) -> Iterator[None]:
    """Prepend a prefix to the field of errors about a run that are raised within the block."""
    try:
        yield
    except ParameterError as error:
        if error.field.startswith(("history", "weights")):
            raise error.at(prefix + error.field) from None
        raise


def _costs(run: _Run) -> FloatArray:
    """Return the normalised mean squares of a run over the coarse grid of strength factors."""
    return np.array([np.sum(run.residuals(float(s), rough=True) ** 2) for s in coarse_strengths(FIRST_LOOK)])


def _fit(
    runs: Sequence[_Run], costs: Sequence[FloatArray], name: str, confidence_level: float
) -> tuple[Estimate, tuple[float, ...]]:
    """Return the estimate of a common strength factor, and other minima that fit nearly as well. [1]"""

    def residuals(strength_factor: float) -> FloatArray:
        return np.concatenate([run.residuals(strength_factor) for run in runs])

    def rough(strength_factor: float) -> FloatArray:
        return np.concatenate([run.residuals(strength_factor, rough=True) for run in runs])

    minima = valleys(coarse_strengths(FIRST_LOOK), np.sum(costs, axis=0))
    found = sorted((refine(rough, low, high) for low, _, high in minima), key=lambda valley: valley[1])
    (start, least), others = found[0], found[1:]
    best = minimise(residuals, start, name)
    return _estimate(runs, best, confidence_level), tuple(value for value, cost in others if cost < RIVAL * least)


def _fit_alone(run: _Run, costs: FloatArray, confidence_level: float) -> MotionFit | None:
    """Return the fit of one run; None if it does not determine the strength factor."""
    try:
        return run.at(*_fit([run], [costs], "history", confidence_level))
    except UndeterminedError:
        return None


def _independent(residuals: FloatArray) -> float:
    """Return the effective number of independent samples in autocorrelated residuals."""
    square = float(residuals @ residuals)
    if square == 0.0:
        return float(residuals.size)
    alike = max(0.0, float(residuals[:-1] @ residuals[1:]) / square)
    return max(FEWEST_SAMPLES, residuals.size * (1.0 - alike) / (1.0 + alike))


def _estimate(runs: Sequence[_Run], best: float, confidence_level: float) -> Estimate:
    """Return the estimate, with a standard error by the sandwich estimator.

    Each quantity of each run enters with its own scatter and its own number of independent samples. The degrees of
    freedom follow from the formula of Welch and Satterthwaite for a sum of such variances.
    """
    parts: list[tuple[float, float, FloatArray]] = []
    for run in runs:
        columns, slopes = run.strike.columns(best), run.slopes(best)
        for q, scale in run.scales.items():
            parts.append((scale**2, float(slopes[q] @ slopes[q]), run.given.columns[q] - columns[q]))
    total = sum(square * slope for square, slope, _ in parts)
    variance, spread = 0.0, 0.0
    for square, slope, error in parts:
        bread = square * slope
        freedom = _independent(error) - bread / total
        # The variance of correlated residuals is inflated: their sum of squares is divided not by their number, but by
        # the number of independent samples, minus the share of the fitted parameter that this quantity determines.
        part = square * bread * float(error @ error) / freedom
        variance += part
        spread += part**2 / freedom
    return build_estimate(
        strength_factor=best,
        standard_error=best * math.sqrt(variance) / total,
        degrees_of_freedom=variance**2 / spread if spread > 0.0 else float(sum(error.size for *_, error in parts) - 1),
        confidence_level=confidence_level,
    )


def _explained(history: MotionHistory, residuals: dict[str, FloatArray]) -> dict[str, float]:
    """Return the fraction of the variance of each quantity that the fit explains. [1]"""
    found = {}
    for q, values in history.columns.items():
        square = float(np.sum((values - values.mean()) ** 2))
        if square > 0.0:
            found[q] = 1.0 - float(np.sum(residuals[q] ** 2)) / square
    return found


def _common_warnings(
    runs: Sequence[_Run], fits: Sequence[MotionFit], alone: Sequence[MotionFit | None], rivals: Sequence[float]
) -> tuple[ModelWarning, ...]:
    found = [warning for run in runs for warning in run.input_warnings()]
    for run, fit, own in zip(runs, fits, alone, strict=True):
        where = f" of the run at {math.degrees(run.impact.oblique_angle):g}° and {run.impact.velocity:g} m/s"
        found += _poor(fit.r_squared, where)
        if own is None:
            found.append(ModelWarning("run_undetermined", f"no strength factor fits the motion{where} best"))
    return tuple(dict.fromkeys((*found, *_second_minima(rivals))))


def _poor(explained: Mapping[str, float], where: str = "") -> list[ModelWarning]:
    return [
        ModelWarning("poor_fit", f"the fit explains {max(share, 0.0):.0%} of the variance of {q}{where}")
        for q, share in explained.items()
        if share < POOR
    ]


def _second_minima(rivals: Sequence[float]) -> list[ModelWarning]:
    return [
        ModelWarning(
            "second_minimum",
            f"a strength factor near {rival:.3g} fits nearly as well: the interval covers only one minimum",
        )
        for rival in rivals
    ]
