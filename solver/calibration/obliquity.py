"""Strength factor over obliquity: the polynomial of eq. 9 through fitted values, with its covariance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.resistance import ObliquityPolynomial
from solver.validation import require, require_between, require_positive
from solver.warnings import ModelWarning

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
        Of S, if known. [1]
    """

    oblique_angle: float
    strength_factor: float
    standard_error: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ObliquityFit:
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


def fit_obliquity(*, points: Sequence[ObliquityPoint], order: int = 2) -> ObliquityFit:
    """Least-squares polynomial through strength factors at several oblique angles.

    Parameters
    ----------
    points
        All with a standard error, or none. With them a point weighs as the inverse of its square and the covariance is
        absolute; without, all weigh the same and the covariance follows from the scatter of the residuals.
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
