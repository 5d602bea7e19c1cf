import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from solver import ParameterError
from solver.uncertainty import Discrete, Lognormal, LogStudentT, Normal, Triangular, TruncatedNormal, Uniform

U = np.linspace(0.001, 0.999, 41)

SAME = [
    (Normal(mean=238.0, coefficient_of_variation=0.01), stats.norm(238.0, 2.38)),
    (Lognormal(median=39e6, dispersion=0.12), stats.lognorm(0.12, scale=39e6)),
    (TruncatedNormal(mean=2.0, standard_deviation=1.0, lower=0.0), stats.truncnorm(-2.0, np.inf, 2.0, 1.0)),
    (TruncatedNormal(mean=2.0, standard_deviation=1.0, lower=1.5, upper=4.0), stats.truncnorm(-0.5, 2.0, 2.0, 1.0)),
    (Uniform(lower=-1.0, upper=3.0), stats.uniform(-1.0, 4.0)),
    (Triangular(lower=1.0, mode=2.0, upper=5.0), stats.triang(0.25, 1.0, 4.0)),
]


@pytest.mark.parametrize(("distribution", "reference"), SAME)
def test_quantiles_and_moments_agree_with_scipy(distribution: Any, reference: Any) -> None:
    np.testing.assert_allclose(distribution.value(distribution.standard(U)), reference.ppf(U), rtol=1e-9, atol=1e-9)
    nodes, weights = distribution.quadrature()
    values = distribution.value(nodes)
    mean = weights @ values
    assert weights.sum() == pytest.approx(1.0, rel=1e-12)
    assert mean == pytest.approx(reference.mean(), rel=1e-9)
    assert math.sqrt(weights @ (values - mean) ** 2) == pytest.approx(reference.std(), rel=1e-7)


def test_logarithm_of_log_student_t_has_students_distribution() -> None:
    heavy = LogStudentT(median=8.0, scale=0.274, degrees_of_freedom=3.0)
    reference = stats.t(3.0, math.log(8.0), 0.274)
    np.testing.assert_allclose(np.log(heavy.value(heavy.standard(U))), reference.ppf(U), rtol=1e-9)
    assert heavy.dispersion == pytest.approx(reference.std())
    nodes, weights = heavy.quadrature()
    assert weights @ np.tanh(np.log(heavy.value(nodes) / 8.0) - 0.3) == pytest.approx(
        stats.t(3.0, 0.0, 0.274).expect(lambda x: math.tanh(x - 0.3)), abs=1e-5
    )


def test_log_student_t_without_a_deviation_has_the_dispersion_of_its_central_part() -> None:
    """The dispersion is the width of the central 90 % divided by 3.29, as for a normal distribution."""
    reference = stats.t(2.0, 0.0, 0.01)
    central = reference.ppf(0.95) - reference.ppf(0.05)
    found = LogStudentT(median=1.0, scale=0.01, degrees_of_freedom=2.0).dispersion
    assert found == pytest.approx(central / 3.29, rel=1e-3)


def test_log_student_t_is_truncated_only_at_its_bounds() -> None:
    cut = LogStudentT(median=1.0, scale=0.5, degrees_of_freedom=2.0, lower=0.25, upper=7.0)
    values = cut.value(cut.standard(np.linspace(0.0, 1.0, 1001)))
    assert (values[0], values[-1]) == pytest.approx((0.25, 7.0))
    reference = stats.t(2.0, 0.0, 0.5)
    below, above = reference.cdf(math.log(0.25)), reference.sf(math.log(7.0))
    shares = (reference.cdf(np.log(values[1:-1])) - below) / (1.0 - below - above)
    np.testing.assert_allclose(shares, np.linspace(0.0, 1.0, 1001)[1:-1], atol=1e-12)


def test_lognormal_can_be_given_by_its_mean() -> None:
    distribution = Lognormal(mean=39e6, coefficient_of_variation=0.12)
    nodes, weights = distribution.quadrature()
    values = distribution.value(nodes)
    assert weights @ values == pytest.approx(39e6)
    assert math.sqrt(weights @ (values - 39e6) ** 2) == pytest.approx(0.12 * 39e6)


def test_discrete_values_occur_in_proportion_to_their_weights() -> None:
    places = Discrete(values=["a", "b", "c"], weights=[0.5, 0.2, 0.3]).places((np.arange(1000) + 0.5) / 1000)
    assert np.bincount(places).tolist() == [500, 200, 300]


BAD = [
    (Normal, {"mean": 1.0, "standard_deviation": -1.0}, "standard_deviation", "greater than 0"),
    (Normal, {"mean": math.nan, "standard_deviation": 1.0}, "mean", "finite"),
    (Normal, {"mean": 1.0}, "standard_deviation", "coefficient_of_variation"),
    (Normal, {"mean": 1.0, "standard_deviation": 1.0, "coefficient_of_variation": 1.0}, "standard_deviation", "both"),
    (Normal, {"mean": 0.0, "coefficient_of_variation": 0.1}, "coefficient_of_variation", "mean other than 0"),
    (Lognormal, {"median": 39e6, "dispersion": -0.1}, "dispersion", "greater than 0"),
    (Lognormal, {"median": 39e6}, "dispersion", "with median"),
    (Lognormal, {"mean": -1.0, "standard_deviation": 1.0}, "mean", "greater than 0"),
    (Lognormal, {"median": 39e6, "dispersion": 430.0}, "dispersion", "at most 10, got 430"),
    (Lognormal, {"mean": 1e-9, "standard_deviation": 1e300}, "standard_deviation", "at most 5.18e+21 means"),
    (Lognormal, {"mean": 1e300, "coefficient_of_variation": 1e300}, "coefficient_of_variation", "at most 5.18e+21"),
    (Lognormal, {"median": 1e300, "dispersion": 9.0}, "median", "no finite number"),
    (LogStudentT, {"median": 0.0, "scale": 0.1, "degrees_of_freedom": 3.0}, "median", "greater than 0"),
    (LogStudentT, {"median": 8.0, "scale": -0.1, "degrees_of_freedom": 3.0}, "scale", "greater than 0"),
    (LogStudentT, {"median": 8.0, "scale": 11.0, "degrees_of_freedom": 3.0}, "scale", "at most 10, got 11"),
    (LogStudentT, {"median": 8.0, "scale": 0.1, "degrees_of_freedom": 0.5}, "degrees_of_freedom", "between 1 and"),
    (LogStudentT, {"median": 8.0, "scale": 0.1, "degrees_of_freedom": math.nan}, "degrees_of_freedom", "between 1"),
    (LogStudentT, {"median": 8.0, "scale": 0.5, "degrees_of_freedom": 1.0}, "lower", "must be given"),
    (LogStudentT, {"median": 8.0, "scale": 0.5, "degrees_of_freedom": 1.0, "lower": 2.0}, "upper", "must be given"),
    (LogStudentT, {"median": 8.0, "scale": 0.1, "degrees_of_freedom": 3.0, "lower": 9.0}, "lower", "below the median"),
    (LogStudentT, {"median": 8.0, "scale": 0.1, "degrees_of_freedom": 3.0, "upper": 7.0}, "upper", "above the median"),
    (Normal, {"mean": 1e300, "coefficient_of_variation": 1e10}, "coefficient_of_variation", "no finite number"),
    (TruncatedNormal, {"mean": 1.0, "standard_deviation": 1.0, "lower": 2.0}, "lower", "below the mean, 1"),
    (TruncatedNormal, {"mean": 1.0, "standard_deviation": 1.0, "upper": 0.5}, "upper", "above the mean, 1"),
    (TruncatedNormal, {"mean": 1.0, "standard_deviation": 1.0}, "lower", "upper"),
    (Uniform, {"lower": 2.0, "upper": 1.0}, "upper", "above the lower bound, 2"),
    (Triangular, {"lower": 0.0, "mode": 2.0, "upper": 1.0}, "mode", "between the bounds, 0 and 1"),
    (Discrete, {"values": [1.0, 2.0], "weights": [0.5, 0.6]}, "weights", "sum to 1, got 1.1"),
    (Discrete, {"values": [1.0, 2.0], "weights": [1.0]}, "weights", "as many as values, 2, got 1"),
    (Discrete, {"values": [1.0, 2.0], "weights": [1.5, -0.5]}, "weights.1", "greater than 0"),
    (Discrete, {"values": [1.0, 1.0]}, "values.1", "repeat"),
]


@pytest.mark.parametrize(("kind", "parameters", "field", "requirement"), BAD)
def test_invalid_parameters_of_distributions_are_named(
    kind: Any, parameters: dict[str, Any], field: str, requirement: str
) -> None:
    with pytest.raises(ParameterError) as error:
        kind(**parameters)
    assert error.value.field == f"distribution.{field}"
    assert requirement in error.value.requirement
