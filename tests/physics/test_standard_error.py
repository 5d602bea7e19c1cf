"""Standard error of the critical angle from the covariance of the strength factor."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import (
    CriticalAngle,
    Numerics,
    ObliquityPolynomial,
    Resistance,
    Search,
    SearchStatus,
    critical_angle,
)
from solver.calibration import fit_obliquity
from solver.strike import PAPER_VELOCITY

from .strikes import CASE, codes, known
from .tables import table_2

NAN = math.nan
TABLE_2 = fit_obliquity(points=table_2()).model
NONE_KNOWN = ((0.0, 0.0, 0.0),) * 3


def find(strength_factor: ObliquityPolynomial, *, numerics: Numerics | None = None, **search: Any) -> CriticalAngle:
    return critical_angle(
        **CASE,
        velocity=PAPER_VELOCITY,
        resistance=Resistance(strength_factor=strength_factor),
        numerics=numerics,
        search=Search(**search),
    )


def constant_term_known_to(error: float) -> ObliquityPolynomial:
    return ObliquityPolynomial(covariance=((error**2, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


def test_standard_error_equals_the_scatter_for_random_coefficients() -> None:
    """The standard deviation of 100 draws has a relative error of 7 %.

    One covariance is from the fit to Table 2; the other has a third of its standard errors.
    """
    for share in (1.0, 1.0 / 3.0):
        covariance = share**2 * np.array(known(TABLE_2.covariance))
        model = replace(TABLE_2, covariance=tuple(map(tuple, covariance.tolist())))
        drawn = np.random.default_rng(11).multivariate_normal(model.coefficients, covariance, 100)
        found = find(model)
        angles = [find(ObliquityPolynomial(coefficients=tuple(row)), upper=math.radians(70.0)).angle for row in drawn]
        scatter = float(np.std([angle for angle in angles if angle is not None], ddof=1))
        assert None not in angles
        assert found.standard_error == pytest.approx(scatter, rel=0.2)


def test_exact_coefficients_give_an_exact_angle() -> None:
    assert find(ObliquityPolynomial(covariance=NONE_KNOWN)).standard_error == 0.0


@pytest.mark.parametrize("method", ["outcome", "secant"])
def test_covariance_changes_nothing_else(method: str) -> None:
    numerics = Numerics(method="adaptive")
    plain = find(ObliquityPolynomial(), method=method, numerics=numerics)
    known = find(constant_term_known_to(0.2), method=method, numerics=numerics)
    assert plain.standard_error is None
    assert known.standard_error is not None
    assert replace(known, standard_error=None) == plain


def test_standard_error_is_proportional_to_the_error_of_the_strength_factor() -> None:
    errors = [find(constant_term_known_to(error)).standard_error for error in (0.1, 0.2, 0.3)]
    assert errors[0] is not None
    assert errors[0] > math.radians(0.1)
    np.testing.assert_allclose(np.array(errors) / errors[0], [1.0, 2.0, 3.0], rtol=0.1)


def test_standard_error_is_known_although_s_vanishes_beyond_the_angle() -> None:
    """Eq. 9 minus 0.5, not held from 60° on, is negative at 85°, the upper end of the search range."""
    wide, narrow = (find(replace(constant_term_known_to(error), held_from=math.radians(90.0))) for error in (0.5, 0.1))
    assert known(wide.standard_error) == pytest.approx(5.0 * known(narrow.standard_error), rel=0.1)


def test_standard_error_is_unknown_if_a_shifted_search_finds_no_angle() -> None:
    close = find(constant_term_known_to(0.5), lower=math.radians(48.0), upper=math.radians(49.0))
    assert close.status is SearchStatus.CONVERGED
    assert close.standard_error is None
    assert "standard_error_unknown" in codes(close)
    vague = find(constant_term_known_to(7.0))
    assert vague.standard_error is None
    assert "standard_error_unknown" in codes(vague)


def test_search_without_an_angle_has_no_standard_error() -> None:
    found = find(constant_term_known_to(0.2), lower=math.radians(10.0), upper=math.radians(35.0))
    assert found.status is SearchStatus.NO_RICOCHET
    assert found.standard_error is None
    assert "standard_error_unknown" not in codes(found)


def test_standard_error_of_the_strength_factor_follows_from_the_covariance() -> None:
    model = ObliquityPolynomial(coefficients=(8.0, -0.05), covariance=((0.04, -1e-3), (-1e-3, 1e-4)))
    for degrees in (0.0, 10.0, -10.0, 40.0):
        expected = math.sqrt(0.04 - 2e-3 * abs(degrees) + 1e-4 * degrees**2)
        assert model.standard_error(math.radians(degrees)) == pytest.approx(expected)
