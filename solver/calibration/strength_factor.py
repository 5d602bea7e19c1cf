"""Minimisation and confidence intervals for all fits of S, and the fit of a polynomial such as eq. 9."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from solver.arrays import ComparedByFields, FloatArray
from solver.checks import ParameterError, require, require_between, require_positive, rows_of
from solver.display import DataFrame
from solver.resistance import ObliquityPolynomial
from solver.warnings import ModelWarning

# Measured values lie between 2.3 and 30, so a fit below 0.5 or above 50 indicates a wrong input.
LOWEST, HIGHEST = 0.5, 50.0
"""Range of strength factors in a fit. [1]"""
# A minimum this close to an end of the range is not a true minimum: the sum of squares still decreases there.
BOUND_MARGIN = 1e-3
"""Distance in ln S from an end of the range within which a minimum is rejected. [ln]"""
# A motion changes over this increment by far more than the error of a run, about 1e-6.
LOG_STEP = 1e-3
"""Increment of ln S in central differences. [ln]"""
# A change of 1e-6 is far below any standard error of a fit.
FIT_TOLERANCE = 1e-6
"""Change of ln S at which a fit ends. [ln]"""
# A fit that starts near the minimum takes a few evaluations. It reaches this limit only if the sum of squares is not
# smooth.
MOST_STEPS = 50
"""Largest number of evaluations of the residuals in a fit, not counting those for their derivatives."""
# This tolerance is enough to compare local minima; the fit itself then starts from the deepest one.
ROUGHLY = 1e-3
"""Tolerance on ln S with which local minima are found before the lowest is refined. [1]"""
# The square of a far smaller slope underflows, and the normal equation would divide by zero.
SMALLEST_SLOPE = 1e-30
"""Least absolute derivative with respect to ln S that one of the residuals must exceed for them to determine S."""
# The deepest minimum on the coarse grid need not be the deepest of all. Three is arbitrary.
REFINED = 3
"""Largest number of local minima that are compared before a fit."""

Residuals: TypeAlias = Callable[[float], FloatArray]
"""Function that returns the weighted residuals for a strength factor."""


class UndeterminedError(ParameterError):
    """Raised if tests or histories do not determine the strength factor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Fitted strength factor with its confidence interval."""

    strength_factor: float
    """Strength factor S. [1]"""
    standard_error: float
    """Standard error of S; NaN for a single test, which shows no scatter. [1]"""
    confidence_interval: tuple[float, float]
    """Confidence interval by Student's distribution, cut off at 0; NaN for a single test. [1]"""
    confidence_level: float
    """Fraction of such intervals that contain the true value. [1]"""
    degrees_of_freedom: float
    """Degrees of freedom of Student's distribution. [1]"""


def build_estimate(
    *, strength_factor: float, standard_error: float, degrees_of_freedom: float, confidence_level: float
) -> Estimate:
    """Compute the confidence interval of a fitted value, and return both as an estimate."""
    from scipy.special import stdtrit  # noqa: PLC0415 (slow to import, and needed for fits only)

    reach = float(stdtrit(degrees_of_freedom, 0.5 + 0.5 * confidence_level)) * standard_error
    return Estimate(
        strength_factor=strength_factor,
        standard_error=standard_error,
        confidence_interval=(max(0.0, strength_factor - reach), strength_factor + reach),
        confidence_level=confidence_level,
        degrees_of_freedom=degrees_of_freedom,
    )


def require_confidence_level(value: float) -> None:
    """Raise `ParameterError` unless a confidence level is between 0 and 1."""
    require(math.isfinite(value) and 0.0 < value < 1.0, "confidence_level", f"must be between 0 and 1, got {value:g}")


def coarse_strengths(count: int) -> FloatArray:
    """Return a grid of strength factors over the range of a fit, evenly spaced in ln S."""
    return np.geomspace(LOWEST, HIGHEST, count)


def valleys(strengths: FloatArray, costs: FloatArray) -> list[tuple[float, float, float]]:
    """Return up to `REFINED` local minima on a grid, deepest first, as (left neighbour, minimum, right neighbour)."""
    padded = np.concatenate(([np.inf], costs, [np.inf]))
    found = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    last = len(strengths) - 1
    return [
        (float(strengths[max(i - 1, 0)]), float(strengths[i]), float(strengths[min(i + 1, last)]))
        for i in found[np.argsort(costs[found], kind="stable")][:REFINED]
    ]


def refine(residuals: Residuals, lower: float, upper: float) -> tuple[float, float]:
    """Return the strength factor with the least sum of squares between two bounds, and that sum."""
    # Brent's bounded minimisation needs no derivatives, each of which would take two more runs.
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 (slow to import, and needed for fits only)

    found = minimize_scalar(
        lambda x: float(np.sum(residuals(math.exp(x)) ** 2)),
        bounds=(math.log(lower), math.log(upper)),
        method="bounded",
        options={"xatol": ROUGHLY},
    )
    return math.exp(float(found.x)), float(found.fun)


def minimise(residuals: Residuals, start: float, field: str) -> float:
    """Return the strength factor with the least sum of squares, starting at `start`. [1]

    Raises
    ------
    UndeterminedError
        If the residuals do not change with S, or are least at an end of the range. The error names `field`.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 (slow to import, and needed for fits only)

    # The search is in ln S, because S is positive and its errors are relative.
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
    """Return the derivatives of `values` with respect to ln S, by central differences."""
    # Central differences have an error of second order in the increment, forward differences one of first order.
    upper = values(strength_factor * math.exp(LOG_STEP))
    lower = values(strength_factor * math.exp(-LOG_STEP))
    slope: FloatArray = (upper - lower) / (2.0 * LOG_STEP)
    return slope


def _undetermined(field: str) -> UndeterminedError:
    return UndeterminedError(
        field,
        f"must determine the strength factor, but no value between {LOWEST:g} and {HIGHEST:g} fits best: "
        "check the units, the projectile and the target",
    )


# With any realistic number of points, a polynomial of higher order would oscillate between them.
HIGHEST_ORDER = 9
"""Highest order of a polynomial in the angle."""
RIGHT_ANGLE = 90.0
"""Angle by which all angles are divided in a fit. [°]"""
# One in a hundred is arbitrary.
UNLIKELY = 0.01
"""Probability of a scatter larger than found, below which a warning says that the standard errors of the points are too
small or the order too low. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObliquityPoint:
    """Strength factor fitted at one oblique angle.

    Parameters
    ----------
    oblique_angle
        Oblique angle from the inward normal. [rad]
    strength_factor
        Strength factor S. [1]
    standard_error
        Standard error of S, if known. [1]
    """

    oblique_angle: float
    strength_factor: float
    standard_error: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObliquityFit(ComparedByFields):
    """Polynomial in the oblique angle in degrees, fitted to strength factors."""

    coefficients: tuple[float, ...]
    """Coefficients from the constant term upwards. [1, 1/°, 1/°², ...]"""
    covariance: tuple[tuple[float, ...], ...] | None
    """Covariance of the coefficients; None if there are as many coefficients as points, and the points have no standard
    errors."""
    residuals: FloatArray
    """(n,) given minus fitted strength factors. [1]"""
    degrees_of_freedom: int
    """Number of points minus the number of coefficients."""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the fit."""

    @property
    def model(self) -> ObliquityPolynomial:
        """Fitted polynomial, as the `strength_factor` of a `Resistance`."""
        return ObliquityPolynomial(coefficients=self.coefficients, covariance=self.covariance)


def fit_obliquity(*, points: "Sequence[ObliquityPoint] | DataFrame", order: int = 2) -> ObliquityFit:
    """Fit a polynomial in the oblique angle to strength factors by least squares.

    Parameters
    ----------
    points
        Points, or a DataFrame with their fields as columns. Either all points have a standard error or none has. With
        standard errors, the weight of a point is the inverse square of its error, and the covariance is absolute.
        Without them all weights are equal, and the covariance follows from the scatter of the residuals.
    order
        Highest power of the angle, 0 to 9.

    Returns
    -------
    ObliquityFit

    Raises
    ------
    ParameterError
        If an input is outside its range, only some points have a standard error, or the angles are too few or too close
        together for the order.

    Notes
    -----
    Eq. 9 of the source paper is such a polynomial. The sign of the angle has no effect, as in `ObliquityPolynomial`.
    """
    points = rows_of("points", points, ObliquityPoint)
    degrees, values, errors = _columns(points, order)
    scales = RIGHT_ANGLE ** -np.arange(order + 1.0)
    # The angle is divided by 90°, so that powers up to the ninth have similar sizes. The singular value decomposition
    # reveals a rank deficiency, and avoids the normal equations, which would square the condition number.
    matrix = np.vander(degrees / RIGHT_ANGLE, order + 1, increasing=True) / errors[:, None]
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    least = max(matrix.shape) * np.finfo(np.float64).eps * singular[0]
    require(singular[-1] > least, "points", f"are too close together for a polynomial of order {order}")
    root = scales[:, None] * right.T / singular
    coefficients = root @ (left.T @ (values / errors))
    residuals = values - np.polynomial.polynomial.polyval(degrees, coefficients)
    chi_square = float(np.sum((residuals / errors) ** 2))
    freedom = len(points) - order - 1
    known = points[0].standard_error is not None
    covariance: tuple[tuple[float, ...], ...] | None = None
    if known or freedom > 0:
        spread = 1.0 if known else chi_square / freedom
        covariance = tuple(tuple(map(float, row)) for row in spread * (root @ root.T))
    return ObliquityFit(
        coefficients=tuple(map(float, coefficients)),
        covariance=covariance,
        residuals=residuals,
        degrees_of_freedom=freedom,
        warnings=_warnings(chi_square=chi_square, degrees_of_freedom=freedom, known=known),
    )


def _columns(points: Sequence[ObliquityPoint], order: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Check the points; return absolute angles in degrees, strength factors, and standard errors, 1 if unknown."""
    require_between("order", order, 0, HIGHEST_ORDER)
    known = [point.standard_error is not None for point in points]
    for index, point in enumerate(points):
        field = f"points.{index}"
        require(
            math.isfinite(point.oblique_angle) and abs(point.oblique_angle) < math.pi / 2.0,
            f"{field}.oblique_angle",
            f"must be less than 90° from the normal, got {math.degrees(point.oblique_angle):g}°",
        )
        require_positive(f"{field}.strength_factor", point.strength_factor)
        require(known[index] or not any(known), f"{field}.standard_error", "must be given, since other points have one")
        if point.standard_error is not None:
            require_positive(f"{field}.standard_error", point.standard_error)
    degrees = np.abs(np.degrees([point.oblique_angle for point in points]))
    different = len(np.unique(degrees))
    require(
        different > order,
        "points",
        f"must be at {order + 1} or more different angles for a polynomial of order {order}, got {different}",
    )
    values = np.array([point.strength_factor for point in points])
    errors = np.array([1.0 if point.standard_error is None else point.standard_error for point in points])
    return degrees, values, errors


def _warnings(*, chi_square: float, degrees_of_freedom: int, known: bool) -> tuple[ModelWarning, ...]:
    if not known and degrees_of_freedom == 0:
        return (
            ModelWarning(
                "covariance_unknown",
                "as many coefficients as points, and no standard errors: nothing shows how well they are known",
            ),
        )
    from scipy.special import chdtrc  # noqa: PLC0415 (slow to import, and needed for fits only)

    if known and degrees_of_freedom > 0 and float(chdtrc(degrees_of_freedom, chi_square)) < UNLIKELY:
        return (
            ModelWarning(
                "scatter_beyond_standard_errors",
                f"the points lie {math.sqrt(chi_square / degrees_of_freedom):.2g} times as far off the polynomial as "
                "their standard errors say: these are too small, or the order is too low",
            ),
        )
    return ()
