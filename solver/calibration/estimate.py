"""A fitted strength factor and what is known about it, and the search for it that the fits share."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from solver.arrays import FloatArray
from solver.errors import ParameterError
from solver.validation import require

LOWEST, HIGHEST = 0.5, 50.0
"""Strength factors among which a fit looks. Published ones lie between 5 and 22."""
BOUND_MARGIN = 1e-3
"""Distance in ln S to either end at which an answer counts as lying there."""
LOG_STEP = 1e-3
"""Step of the difference quotients in ln S, far above the errors of a run."""
FIT_TOLERANCE = 1e-6
"""Change of ln S below which a fit ends."""
MOST_STEPS = 50
ROUGHLY = 1e-3
"""Width in ln S to which a valley is searched before the fit itself."""
SMALLEST_SLOPE = 1e-30
"""Slope of the residuals over ln S, below which its square is lost."""
REFINED = 3
"""Valleys of a first look that are refined before the deepest is taken."""

Residuals: TypeAlias = Callable[[float], FloatArray]
"""Weighted residuals at a strength factor."""


class UndeterminedError(ParameterError):
    """Tests or histories that leave the strength factor open."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A fitted strength factor."""

    strength_factor: float
    """S. [1]"""
    standard_error: float
    """[1]"""
    confidence_interval: tuple[float, float]
    """By Student's distribution, and not below 0. [1]"""
    confidence_level: float
    """Share of such intervals that hold the true value. [1]"""
    degrees_of_freedom: float
    """Degrees of freedom of that distribution. [1]"""


def build_estimate(
    *, strength_factor: float, standard_error: float, degrees_of_freedom: float, confidence_level: float
) -> Estimate:
    """Dress a fitted value with its interval."""
    from scipy.special import stdtrit  # noqa: PLC0415 (takes long to import, also where nothing is fitted)

    reach = float(stdtrit(degrees_of_freedom, 0.5 + 0.5 * confidence_level)) * standard_error
    return Estimate(
        strength_factor=strength_factor,
        standard_error=standard_error,
        confidence_interval=(max(0.0, strength_factor - reach), strength_factor + reach),
        confidence_level=confidence_level,
        degrees_of_freedom=degrees_of_freedom,
    )


def require_confidence_level(value: float) -> None:
    """Refuse a level that is not between 0 and 1."""
    require(math.isfinite(value) and 0.0 < value < 1.0, "confidence_level", f"must be between 0 and 1, got {value:g}")


def coarse_strengths(count: int) -> FloatArray:
    """Strength factors to look at first, evenly apart in ln S."""
    return np.geomspace(LOWEST, HIGHEST, count)


def valleys(strengths: FloatArray, costs: FloatArray) -> list[tuple[float, float, float]]:
    """The deepest minima of a first look, each with its neighbours on both sides, deepest first."""
    padded = np.concatenate(([np.inf], costs, [np.inf]))
    found = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    last = len(strengths) - 1
    return [
        (float(strengths[max(i - 1, 0)]), float(strengths[i]), float(strengths[min(i + 1, last)]))
        for i in found[np.argsort(costs[found], kind="stable")][:REFINED]
    ]


def refine(residuals: Residuals, lower: float, upper: float) -> tuple[float, float]:
    """Least sum of squares between two strength factors, roughly: where, and how much."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 (takes long to import, also where nothing is fitted)

    found = minimize_scalar(
        lambda x: float(np.sum(residuals(math.exp(x)) ** 2)),
        bounds=(math.log(lower), math.log(upper)),
        method="bounded",
        options={"xatol": ROUGHLY},
    )
    return math.exp(float(found.x)), float(found.fun)


def minimise(residuals: Residuals, start: float, field: str) -> float:
    """Strength factor of least squares, from a start, sought in ln S.

    Raises
    ------
    UndeterminedError
        For `field`, if the residuals do not change with S, or are least at an end of the range.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 (takes long to import, also where nothing is fitted)

    low, high = math.log(LOWEST), math.log(HIGHEST)

    def misses(point: FloatArray) -> FloatArray:
        return residuals(math.exp(point[0]))

    def slope(point: FloatArray) -> FloatArray:
        values = log_slope(residuals, math.exp(point[0]))
        if not np.abs(values).max() > SMALLEST_SLOPE:
            raise _undetermined(field)
        return values[:, None]

    found = least_squares(
        misses,
        [min(max(math.log(start), low + BOUND_MARGIN), high - BOUND_MARGIN)],
        jac=slope,
        bounds=([low], [high]),
        xtol=FIT_TOLERANCE,
        ftol=FIT_TOLERANCE**2,
        gtol=None,
        max_nfev=MOST_STEPS,
    )
    if not low + BOUND_MARGIN < found.x[0] < high - BOUND_MARGIN:
        raise _undetermined(field)
    return math.exp(float(found.x[0]))


def log_slope(values: Residuals, strength_factor: float) -> FloatArray:
    """Derivatives by ln S, by central differences."""
    upper = values(strength_factor * math.exp(LOG_STEP))
    lower = values(strength_factor * math.exp(-LOG_STEP))
    slope: FloatArray = (upper - lower) / (2.0 * LOG_STEP)
    return slope


def _undetermined(field: str) -> UndeterminedError:
    return UndeterminedError(
        field,
        f"must tell the strength factor, but no value between {LOWEST:g} and {HIGHEST:g} fits best: "
        "check the units, the projectile and the target",
    )
