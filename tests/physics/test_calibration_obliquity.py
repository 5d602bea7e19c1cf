"""Fit of a polynomial to strength factors over the oblique angle."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from solver import ParameterError, Resistance, SearchStatus, critical_angle, strength_factor
from solver.arrays import FloatArray
from solver.calibration import ObliquityPoint, fit_obliquity
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from validation.reference import equation_9

from .strikes import CASE, known
from .tables import table_2

NAN = math.nan
DEGREES = np.array([0.0, 5.0, 10.0, 20.0, 25.0, 35.0, 45.0, 50.0, 60.0, 65.0, 75.0, 80.0])


def points(
    degrees: Sequence[float] | FloatArray,
    values: Sequence[float] | FloatArray,
    errors: Sequence[float] | FloatArray | None = None,
) -> list[ObliquityPoint]:
    known: Sequence[float | None] = [None] * len(degrees) if errors is None else list(errors)
    return [
        ObliquityPoint(oblique_angle=math.radians(angle), strength_factor=value, standard_error=error)
        for angle, value, error in zip(degrees, values, known, strict=True)
    ]


def noisy() -> tuple[FloatArray, FloatArray]:
    """Return points of a parabola with noise, and their standard errors."""
    random = np.random.default_rng(5)
    errors = random.uniform(0.05, 0.3, DEGREES.size)
    return 9.0 - 0.02 * DEGREES - 1e-4 * DEGREES**2 + errors * random.normal(size=DEGREES.size), errors


def test_table_2_gives_equation_9_to_its_printed_digits() -> None:
    found = fit_obliquity(points=table_2())
    coefficients = zip(found.coefficients, (3, 4, 4), strict=True)
    assert tuple(round(value, digits) for value, digits in coefficients) == equation_9()
    assert found.degrees_of_freedom == 1
    assert found.warnings == ()


def test_covariance_without_standard_errors_equals_polyfit() -> None:
    values, _ = noisy()
    found = fit_obliquity(points=points(DEGREES, values))
    coefficients, covariance = np.polyfit(DEGREES, values, 2, cov=True)
    np.testing.assert_allclose(found.coefficients, coefficients[::-1], rtol=1e-9)
    np.testing.assert_allclose(known(found.covariance), covariance[::-1, ::-1], rtol=1e-9)


def test_covariance_with_standard_errors_is_absolute() -> None:
    values, errors = noisy()
    found = fit_obliquity(points=points(DEGREES, values, errors))
    coefficients, covariance = np.polyfit(DEGREES, values, 2, w=1.0 / errors, cov="unscaled")
    np.testing.assert_allclose(found.coefficients, coefficients[::-1], rtol=1e-9)
    np.testing.assert_allclose(known(found.covariance), covariance[::-1, ::-1], rtol=1e-9)
    assert found.warnings == ()


@pytest.mark.parametrize("order", range(10))
def test_fit_to_points_on_a_polynomial_recovers_it(order: int) -> None:
    coefficients = 9.0 * (-1.0) ** np.arange(order + 1) * 90.0 ** -np.arange(order + 1.0)
    values = np.polynomial.polynomial.polyval(DEGREES, coefficients)
    found = fit_obliquity(points=points(-DEGREES, values), order=order)
    np.testing.assert_allclose(found.coefficients, coefficients, rtol=1e-6)
    assert np.abs(found.residuals).max() < 1e-10


@pytest.mark.parametrize("order", range(10))
def test_covariance_of_any_order_is_valid(order: int) -> None:
    values, errors = noisy()
    model = fit_obliquity(points=points(DEGREES, values, errors), order=order).model
    assert 0.0 < model.standard_error(math.radians(20.0)) < 0.3


def test_exact_fit_has_no_covariance_unless_errors_are_given() -> None:
    found = fit_obliquity(points=points([0.0, 20.0, 40.0], [9.0, 8.0, 6.5]))
    assert found.covariance is None
    assert found.degrees_of_freedom == 0
    assert [warning.code for warning in found.warnings] == ["covariance_unknown"]
    known = fit_obliquity(points=points([0.0, 20.0, 40.0], [9.0, 8.0, 6.5], [0.1, 0.2, 0.3]))
    assert known.covariance is not None
    for angle, error in ((0.0, 0.1), (20.0, 0.2), (40.0, 0.3)):
        assert known.model.standard_error(math.radians(angle)) == pytest.approx(error)


def test_error_of_a_mean_falls_with_the_root_of_the_number() -> None:
    found = fit_obliquity(points=points([10.0] * 4, [8.0, 8.2, 7.8, 8.0], [0.1] * 4), order=0)
    assert found.coefficients == pytest.approx((8.0,))
    assert found.model.standard_error(0.0) == pytest.approx(0.1 / math.sqrt(4.0))


def test_residuals_larger_than_the_standard_errors_cause_a_warning() -> None:
    values, errors = noisy()
    found = fit_obliquity(points=points(DEGREES, values, errors / 10.0))
    assert [warning.code for warning in found.warnings] == ["scatter_beyond_standard_errors"]


def test_fitted_model_can_be_used_in_a_search() -> None:
    model = fit_obliquity(points=table_2()).model
    found = critical_angle(**CASE, velocity=PAPER_VELOCITY, resistance=Resistance(strength_factor=model))
    assert found.status is SearchStatus.CONVERGED
    assert math.degrees(known(found.angle)) == pytest.approx(48.57, abs=0.1)
    assert known(found.standard_error) > 0.0
    fitted = strength_factor(
        resistance=Resistance(strength_factor=model),
        oblique_angle=math.radians(15.0),
        target=PAPER_TARGET,
        projectile=PAPER_PROJECTILE,
    )
    assert fitted == pytest.approx(8.25 + 0.153, abs=1e-3)


REFUSED: list[tuple[str, Callable[[], list[ObliquityPoint]], int]] = [
    ("points", list, 2),
    ("points", lambda: points([0.0, 20.0], [9.0, 8.0]), 2),
    ("points", lambda: points([20.0, -20.0, 20.0], [9.0, 8.0, 8.0]), 1),
    ("points.1.oblique_angle", lambda: points([0.0, 90.0, 20.0], [9.0, 8.0, 8.0]), 1),
    ("points.2.strength_factor", lambda: points([0.0, 10.0, 20.0], [9.0, 8.0, 0.0]), 1),
    ("points.0.strength_factor", lambda: points([0.0, 10.0, 20.0], [NAN, 8.0, 8.0]), 1),
    ("points.1.standard_error", lambda: points([0.0, 10.0, 20.0], [9.0, 8.0, 8.0], [0.1, 0.0, 0.1]), 1),
    (
        "points.2.standard_error",
        lambda: [*points([0.0, 10.0], [9.0, 8.0], [0.1, 0.1]), *points([20.0], [8.0])],
        1,
    ),
    ("order", table_2, -1),
    ("order", table_2, 10),
]


@pytest.mark.parametrize(("field", "given", "order"), REFUSED)
def test_invalid_points_are_refused(field: str, given: Callable[[], list[ObliquityPoint]], order: int) -> None:
    with pytest.raises(ParameterError) as refused:
        fit_obliquity(points=given(), order=order)
    assert refused.value.field == field
