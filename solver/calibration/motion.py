"""Strength factor from the motion of oblique strikes, measured or computed by finite elements (section 3.2)."""

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

FIT_TOLERANCE = 1e-6
"""Relative tolerance of the runs of a fit, unless said otherwise: right to micrometres and thousandths of a degree."""
ROUGH = Numerics(relative_tolerance=1e-3, stations=5, points=3)
"""Settings of the first look: to a tenth of a millimetre, in a fraction of the time."""
FIRST_LOOK = 41
"""Strength factors tried before the fit, 12 % apart: the outcome can flip with S, and each has its own minimum."""
SMALLEST_SPAN = 1e-3
"""Least span of a quantity, over body length or a radian: one that hardly changes must not weigh without bound."""
FEWEST_SAMPLES = 2.0
"""Independent samples that a quantity counts at least, however alike neighbours err."""
RIVAL = 1.5
"""Sum of squares of another minimum, over the least, up to which it is reported. [1]"""
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
    """Root mean square of the residuals, by quantity. [m, m, rad]"""
    normalized_root_mean_square: float
    """Root mean square of all residuals that are fitted, over the spans of their quantities, weighted. [1]"""
    r_squared: Mapping[str, float]
    """Share of its variance that the prediction explains, by quantity; absent for one that never changes. [1]"""
    warnings: tuple[ModelWarning, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionsFit:
    """Strength factor that fits the motions of several runs best, with one decay law."""

    free_surface: FreeSurface
    estimate: Estimate
    """Estimate of the common strength factor."""
    normalized_root_mean_square: float
    """At the common S: root of the mean of the squares of the runs. [1]"""
    runs: tuple[MotionFit, ...]
    """Each run at the common S, in the given order."""
    alone: tuple[MotionFit | None, ...]
    """Each run at the S that fits it best; None for a run that leaves S open."""
    warnings: tuple[ModelWarning, ...]


class _Run:
    """A run prepared for any strength factor, with the scales of the quantities that are fitted."""

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
        """Scaled residuals, one quantity after another; the sum of their squares is the normalised mean square."""
        columns = (self.rough if rough else self.strike).columns(strength_factor)
        return np.concatenate([scale * (self.given.columns[q] - columns[q]) for q, scale in self.scales.items()])

    def slopes(self, strength_factor: float) -> dict[str, FloatArray]:
        """Derivatives of the predicted quantities by ln S."""
        slope = log_slope(lambda factor: np.concatenate(list(self.strike.columns(factor).values())), strength_factor)
        return dict(zip(QUANTITIES, np.split(slope, len(QUANTITIES)), strict=True))

    def at(self, estimate: Estimate, rivals: Sequence[float] = ()) -> MotionFit:
        """The run at a fitted strength factor."""
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
        """What the model warns of before anything is computed."""
        return tuple(
            model_warnings.input_warnings(
                projectile=self.strike.prepared.projectile,
                target=self.strike.prepared.target,
                velocity=self.impact.velocity,
                angle_of_attack=self.impact.angle_of_attack,
            )
        )


def _scales(run: MotionRun, length: float) -> dict[str, float]:
    """Factor of the residuals of each fitted quantity: root of its share of the weight over its rows, over its span."""
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
    """Strength factor that fits a motion best, by least squares over the quantities that are there.

    Parameters
    ----------
    projectile, target, impact
        What struck, what was struck, and how.
    history
        The motion to fit.
    weights
        Weights of the quantities; all alike unless given.
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Route and resolution; adaptive unless given.
    confidence_level
        Confidence level of the interval. [1]

    Returns
    -------
    MotionFit

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts, or the history does not determine the strength factor.

    Notes
    -----
    Section 3.2, which says no more than "least square". Here each quantity is scaled by its span, so that metres and
    radians can be added and each counts for as much: weighed by the scatter of their residuals, the quantity that the
    model happens to follow best would take over. What lies between a model and a motion is no white noise: neighbours
    err alike. The standard error therefore counts, for each quantity, n (1-r)/(1+r)
    samples, r being the autocorrelation of its residuals at lag one, at least 0 (Bayley and Hammersley 1946; von Storch
    and Zwiers 1999, 6.6). Rows should be about evenly apart for that. An error of the model that all rows share moves
    S itself, and no interval includes it.
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
    """One strength factor that fits the motions of several runs best, and the one that fits each of them.

    Parameters
    ----------
    projectile, target
        Shared by the runs.
    runs
        One or more strikes at any angles and speeds, each with its motion. Every run counts alike, however many rows
        it has.
    resistance, numerics, confidence_level
        As for `fit_motion`.

    Returns
    -------
    MotionsFit

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts, or the runs together do not determine the strength factor. Of
        several runs it names fields by the place of the run, such as ``runs.0.history.time``.

    Notes
    -----
    As `fit_motion`, over all quantities of all runs. What the runs differ by counts as scatter of their residuals,
    with few independent samples: where S truly changes from run to run, the interval is wide and S belongs to none of
    them. Compare with the strength factors of the runs alone.
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
    """Name what is wrong with one of several runs by its place."""
    try:
        yield
    except ParameterError as error:
        if error.field.startswith(("history", "weights")):
            raise ParameterError(prefix + error.field, error.requirement) from None
        raise


def _costs(run: _Run) -> FloatArray:
    """Normalised mean squares of a first look over the strength factors."""
    return np.array([np.sum(run.residuals(float(s), rough=True) ** 2) for s in coarse_strengths(FIRST_LOOK)])


def _fit(
    runs: Sequence[_Run], costs: Sequence[FloatArray], name: str, confidence_level: float
) -> tuple[Estimate, tuple[float, ...]]:
    """Best strength factor of some runs together, and others that fit nearly as well."""

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
    try:
        return run.at(*_fit([run], [costs], "history", confidence_level))
    except UndeterminedError:
        return None


def _independent(residuals: FloatArray) -> float:
    """Samples that count as independent among residuals of which neighbours err alike."""
    square = float(residuals @ residuals)
    if square == 0.0:
        return float(residuals.size)
    alike = max(0.0, float(residuals[:-1] @ residuals[1:]) / square)
    return max(FEWEST_SAMPLES, residuals.size * (1.0 - alike) / (1.0 + alike))


def _estimate(runs: Sequence[_Run], best: float, confidence_level: float) -> Estimate:
    """Standard error by the sandwich, with the scatter and the independent samples of each quantity of each run.

    The degrees of freedom are those of Welch and Satterthwaite for a sum of such parts.
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
        # Mean square over the share of independent samples that the fit has not used up, times n / count.
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
    """Share of the variance of each quantity that the fit explains."""
    found = {}
    for q, values in history.columns.items():
        square = float(np.sum((values - values.mean()) ** 2))
        if square > 0.0:
            found[q] = 1.0 - float(np.sum(residuals[q] ** 2)) / square
    return found


def _common_warnings(
    runs: Sequence[_Run], fits: Sequence[MotionFit], alone: Sequence[MotionFit | None], rivals: Sequence[float]
) -> tuple[ModelWarning, ...]:
    """Warnings of a common fit, each said once."""
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
            f"a strength factor near {rival:.3g} fits nearly as well: the interval knows of one minimum only",
        )
        for rival in rivals
    ]
