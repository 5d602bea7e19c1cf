"""Critical angles from the fitted strength factors, and the angles at which finite elements change their outcome."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.reports.finite_elements.calibration import (
    BRACKETING,
    CALIBRATED,
    NORMAL,
    ROUGHER,
    Calibrations,
    fit_until,
)
from service.reports.paper.strike import history_of
from service.reports.reference import FiniteElementRun, equation_9
from solver import (
    ConstantStrengthFactor,
    CriticalAngle,
    ObliquityPolynomial,
    Outcome,
    Resistance,
    critical_angle,
)
from solver.calibration import Estimate, ObliquityFit, ObliquityPoint, Weights, fit_obliquity
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from solver.resistance import StrengthFactor, strength_factor

CHOSEN = "second order, points alike"
PAPER = "the paper's eq. 9"
BY_ERRORS = "second order, by standard errors"
LINEAR = "first order, points alike"
BY_SCATTER = "second order, points alike, quantities weighed by the scatter of what the fit leaves of them"
ONE_NORMAL = "second order, points alike, S at 0° from the motion of one normal run"
TO_DEEPEST_CENTER = "second order, points alike, fitted until the centre of gravity is deepest"
NEAR = "constant, the mean S fitted from 48° to 55°"


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A model of the strength factor and the critical angle that follows."""

    model: StrengthFactor
    answer: CriticalAngle
    cpu_seconds: float

    @property
    def degrees(self) -> float | None:
        """The critical angle; None without one. [°]"""
        return None if self.answer.angle is None else math.degrees(self.answer.angle)

    @property
    def error_degrees(self) -> float | None:
        """Its standard error; None if it is not known. [°]"""
        return None if self.answer.standard_error is None else math.degrees(self.answer.standard_error)

    @property
    def factor(self) -> float | None:
        """Strength factor at the critical angle; None without one. [1]"""
        if self.answer.angle is None:
            return None
        resistance = Resistance(strength_factor=self.model)
        return strength_factor(
            resistance=resistance, oblique_angle=self.answer.angle, target=PAPER_TARGET, projectile=PAPER_PROJECTILE
        )


def polynomials(found: Calibrations) -> dict[str, ObliquityFit]:
    """Polynomials through the calibrated runs: the chosen one, then others that could have been."""
    points = found.points
    (normal,) = found.of([NORMAL])
    later = {
        each.run.oblique_angle: fit_until(
            each.run, history_of(each.run).time_of_greatest_depth, numerics=ROUGHER
        ).estimate
        for each in found.of(CALIBRATED)
    }
    return {
        CHOSEN: fit_obliquity(points=_points(points)),
        BY_ERRORS: fit_obliquity(points=_points(points, weighted=True)),
        LINEAR: fit_obliquity(points=_points(points), order=1),
        BY_SCATTER: fit_obliquity(points=_points(points | _by_scatter(found))),
        TO_DEEPEST_CENTER: fit_obliquity(points=_points(points | later)),
        ONE_NORMAL: fit_obliquity(points=_points(points | {0.0: normal.estimate})),
    }


def _by_scatter(found: Calibrations) -> dict[float, Estimate]:
    """S of the calibrated runs, weighed as if what the fits leave were noise. [rad]"""
    fitted = {}
    for each in found.of(CALIBRATED):
        given, left = history_of(each.run).until(float(each.fit.predicted.time[-1])), each.fit.root_mean_square
        weights = {name: (float(np.ptp(values)) / left[name]) ** 2 for name, values in given.columns.items()}
        fit = fit_until(
            each.run,
            float(given.time[-1]),
            Weights(**{name.removesuffix("_displacement"): weight for name, weight in weights.items()}),
            ROUGHER,
        )
        fitted[each.run.oblique_angle] = fit.estimate
    return fitted


def predictions(found: Calibrations, fits: Mapping[str, ObliquityFit]) -> dict[str, Prediction]:
    """Critical angle by each polynomial, by the S of the runs near it, and by the paper's eq. 9."""
    near = float(np.mean([each.estimate.strength_factor for each in found.of(BRACKETING)]))
    models: dict[str, StrengthFactor] = {what: fit.model for what, fit in fits.items()}
    models |= {NEAR: ConstantStrengthFactor(value=near), PAPER: ObliquityPolynomial(coefficients=equation_9())}
    return {what: _predict(model) for what, model in models.items()}


def bracket(runs: Sequence[FiniteElementRun]) -> tuple[float, float]:
    """Largest angle at which no run is turned away, and the smallest at which one is. [rad]"""
    turned = [run.oblique_angle for run in runs if run.outcome == Outcome.RICOCHET]
    kept = [run.oblique_angle for run in runs if run.outcome != Outcome.RICOCHET]
    return max(kept), min(turned)


def _points(estimates: Mapping[float, Estimate], *, weighted: bool = False) -> list[ObliquityPoint]:
    return [
        ObliquityPoint(
            oblique_angle=angle,
            strength_factor=estimate.strength_factor,
            standard_error=estimate.standard_error if weighted else None,
        )
        for angle, estimate in estimates.items()
    ]


def _predict(model: StrengthFactor) -> Prediction:
    start = time.process_time()
    answer = critical_angle(
        projectile=PAPER_PROJECTILE,
        target=PAPER_TARGET,
        velocity=PAPER_VELOCITY,
        resistance=Resistance(strength_factor=model),
    )
    return Prediction(model=model, answer=answer, cpu_seconds=time.process_time() - start)
