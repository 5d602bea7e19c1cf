"""Fitted strength factors: the search that the fits share, the interval, and the polynomial over obliquity (eq. 9)."""

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
    """NaN from a single test, which shows no scatter. [1]"""
    confidence_interval: tuple[float, float]
    """By Student's distribution, and not below 0; NaN from a single test. [1]"""
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
        f"must determine the strength factor, but no value between {LOWEST:g} and {HIGHEST:g} fits best: "
        "check the units, the projectile and the target",
    )


HIGHEST_ORDER = 9
RIGHT_ANGLE = 90.0  # [°]
UNLIKELY = 0.01
"""Chance of a larger scatter below which the standard errors of the points are called too small. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObliquityPoint:
    """A strength factor fitted at one oblique angle.

    Parameters
    ----------
    oblique_angle
        From the inward normal. [rad]
    strength_factor
        S. [1]
    standard_error
        Standard error of S, if known. [1]
    """

    oblique_angle: float
    strength_factor: float
    standard_error: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObliquityFit(ComparedByFields):
    """Polynomial through strength factors, in the oblique angle in degrees."""

    coefficients: tuple[float, ...]
    """From the constant term upwards. [1, 1/°, 1/°², ...]"""
    covariance: tuple[tuple[float, ...], ...] | None
    """Covariance of the coefficients; None if there are as many as points, and the points have no standard errors."""
    residuals: FloatArray
    """(n,) given minus fitted. [1]"""
    degrees_of_freedom: int
    """Points less coefficients."""
    warnings: tuple[ModelWarning, ...]

    @property
    def model(self) -> ObliquityPolynomial:
        """The same as a model of the strength factor."""
        return ObliquityPolynomial(coefficients=self.coefficients, covariance=self.covariance)


def fit_obliquity(*, points: "Sequence[ObliquityPoint] | DataFrame", order: int = 2) -> ObliquityFit:
    """Least-squares polynomial through strength factors at several oblique angles.

    Parameters
    ----------
    points
        Or a DataFrame with their fields as columns. All with a standard error, or none. With them a point weighs as the
        inverse of its square and the covariance is absolute; without, all weigh the same and the covariance follows
        from the scatter of the residuals.
    order
        Highest power of the angle, 0 to 9.

    Returns
    -------
    ObliquityFit

    Raises
    ------
    ParameterError
        If a point is not a point, or they are at fewer different angles than there are coefficients.

    Notes
    -----
    Eq. 9. The sign of the angle does not matter, as in `ObliquityPolynomial`.
    """
    points = rows_of("points", points, ObliquityPoint)
    degrees, values, errors = _columns(points, order)
    scales = RIGHT_ANGLE ** -np.arange(order + 1.0)
    # The matrix is built in the angle over a right one, or high powers would be lost to rounding.
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
    """Angles without their sign in degrees, strength factors and standard errors, checked."""
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
    from scipy.special import chdtrc  # noqa: PLC0415 (takes long to import, also where nothing is fitted)

    if known and degrees_of_freedom > 0 and float(chdtrc(degrees_of_freedom, chi_square)) < UNLIKELY:
        return (
            ModelWarning(
                "scatter_beyond_standard_errors",
                f"the points lie {math.sqrt(chi_square / degrees_of_freedom):.2g} times as far off the polynomial as "
                "their standard errors say: these are too small, or the order is",
            ),
        )
    return ()
