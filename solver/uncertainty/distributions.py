"""Distributions of uncertain inputs, with the parameters that engineers use."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.polynomial.legendre import leggauss

from solver.arrays import FloatArray
from solver.checks import plain, require, require_finite, require_positive
from solver.resistance import student_dispersion
from solver.units import Amount

FIELD = "distribution"
"""Field name of a distribution in errors."""
# A Gauss rule with 48 nodes is exact up to degree 95, which includes the square of every polynomial in use.
NODES = 48
"""Number of nodes of a quadrature rule for a smooth density."""
# At this distance the density is 3e-18 of its maximum, below the rounding error of a sum.
FAR = 9.0
"""Distance from the mean, in standard deviations, beyond which a normal density is neglected. [1]"""
# If an input varies by so large a factor, the critical angle is far from linear in it; smaller factors need no high
# orders. The value separates the usual dispersion of S, 0.48, from those of all other inputs, at most 0.12.
WIDE = 0.2
"""Least dispersion of an input with which polynomials of higher order in that input are tried. [ln]"""
# One standard deviation is then a factor of 22,000 either way, more than for any real input.
LARGEST_DISPERSION = 10.0
"""Largest accepted dispersion. [1]"""
# Below 1, the 90 % interval hardly describes the tails. At a million, quantiles differ from those of the normal
# distribution by less than 1e-5 of their value.
FREEDOM = (1.0, 1e6)
"""Range of accepted degrees of freedom. [1]"""
# The smallest coordinate of a sample point is half the distance between neighbouring coordinates, which have 30 bits.
TINY = 2.0**-31
"""Least probability at which a distribution is sampled. [1]"""
# The tolerance accepts up to twenty weights that are rounded to ten decimal places.
WEIGHTS_SUM = 1e-9
"""Largest deviation of the sum of weights from 1. [1]"""


class Continuous(Protocol):
    """Interface of distributions of continuous inputs.

    The surrogate is a polynomial in the standard variables of the inputs. A standard variable is a smooth function of
    its input.
    """

    def standard(self, u: FloatArray) -> FloatArray:
        """Return the standard variable at probabilities between 0 and 1."""

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at values of the standard variable."""

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights of a rule for a mean over the standard variable; the weights sum to 1."""


def _spread(mean: float, deviation: float | None, variation: float | None) -> float:
    """Return the standard deviation, given directly or as a coefficient of variation."""
    given = (deviation is None) + (variation is None) == 1
    require(given, f"{FIELD}.standard_deviation", "must be given, or else coefficient_of_variation, but not both")
    if deviation is not None:
        require_positive(f"{FIELD}.standard_deviation", deviation, None)
        return deviation
    assert variation is not None  # noqa: S101 (one of both)
    require_positive(f"{FIELD}.coefficient_of_variation", variation, "%")
    require(mean != 0.0, f"{FIELD}.coefficient_of_variation", "needs a mean other than 0; give standard_deviation")
    return variation * abs(mean)


def _spread_name(deviation: float | None) -> str:
    return "coefficient_of_variation" if deviation is None else "standard_deviation"


def _require_order(name: str, holds: bool, words: str, other: float) -> None:
    """Raise `ParameterError` unless two parameters are in the required order, which `holds` states."""
    require(holds, f"{FIELD}.{name}", f"must be {words}, {{}}", Amount(other, None))


def _require_finite_spread(name: str, middle: float, deviation: float) -> None:
    """Raise `ParameterError` if samples of a normal distribution could overflow."""
    reach = abs(middle) + FAR * deviation
    require(math.isfinite(reach), f"{FIELD}.{name}", f"is too large: {FAR:g} of them from the mean is no finite number")


@dataclass(frozen=True, slots=True, kw_only=True)
class Normal:
    """Normal distribution.

    Parameters
    ----------
    mean
        Mean in the unit of the field.
    standard_deviation, coefficient_of_variation
        Standard deviation in the unit of the field, or as a fraction of the mean; exactly one of them must be given.
    """

    name: ClassVar[str] = "normal"
    mean: float
    standard_deviation: float | None = None
    coefficient_of_variation: float | None = None

    def __post_init__(self) -> None:
        require_finite(f"{FIELD}.mean", self.mean)
        deviation = _spread(self.mean, self.standard_deviation, self.coefficient_of_variation)
        _require_finite_spread(_spread_name(self.standard_deviation), self.mean, deviation)

    def standard(self, u: FloatArray) -> FloatArray:
        """Return the distances from the mean, in standard deviations, at given probabilities."""
        from scipy.special import ndtri  # noqa: PLC0415 (slow to import, and needed for sampling only)

        return np.asarray(ndtri(u), float)

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at `z` standard deviations from the mean."""
        return self.mean + _spread(self.mean, self.standard_deviation, self.coefficient_of_variation) * z

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights for a mean over the distribution."""
        return _hermite()


@dataclass(frozen=True, slots=True, kw_only=True)
class TruncatedNormal:
    """Normal distribution truncated at one or two bounds.

    Parameters
    ----------
    mean, standard_deviation, coefficient_of_variation
        Parameters of the normal distribution before truncation.
    lower, upper
        Bounds, at least one of them, with the mean between them.
    """

    name: ClassVar[str] = "truncated_normal"
    mean: float
    standard_deviation: float | None = None
    coefficient_of_variation: float | None = None
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        require_finite(f"{FIELD}.mean", self.mean)
        deviation = _spread(self.mean, self.standard_deviation, self.coefficient_of_variation)
        _require_finite_spread(_spread_name(self.standard_deviation), self.mean, deviation)
        require(not (self.lower is None and self.upper is None), f"{FIELD}.lower", "must be given, or else upper")
        if self.lower is not None:
            require_finite(f"{FIELD}.lower", self.lower)
            _require_order("lower", self.lower < self.mean, "below the mean", self.mean)
        if self.upper is not None:
            require_finite(f"{FIELD}.upper", self.upper)
            _require_order("upper", self.upper > self.mean, "above the mean", self.mean)

    @property
    def _deviation(self) -> float:
        return _spread(self.mean, self.standard_deviation, self.coefficient_of_variation)

    @property
    def _bounds(self) -> tuple[float, float]:
        """Bounds as distances from the mean, in standard deviations."""
        lower = -math.inf if self.lower is None else (self.lower - self.mean) / self._deviation
        upper = math.inf if self.upper is None else (self.upper - self.mean) / self._deviation
        return lower, upper

    def standard(self, u: FloatArray) -> FloatArray:
        """Return the distances from the mean, in standard deviations, at given probabilities."""
        from scipy.special import ndtr, ndtri  # noqa: PLC0415 (slow to import, and needed for sampling only)

        # The upper tail is computed separately, because one minus the distribution function would cancel. The quantile
        # of an extreme probability may be infinite, or miss a bound by rounding, and is clipped.
        lower, upper = self._bounds
        below, above = float(ndtr(lower)), float(ndtr(-upper))
        z = ndtri(below + u * (1.0 - below - above))
        return np.asarray(np.clip(z, lower, upper), float)

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at `z` standard deviations from the mean."""
        return self.mean + self._deviation * z

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights for a mean over the distribution."""
        lower, upper = self._bounds
        # No standard rule has a truncated normal density as its weight. Twice as many nodes compensate for this.
        x, w = leggauss(2 * NODES)
        lower, upper = max(lower, -FAR), min(upper, FAR)
        z = 0.5 * (lower + upper) + 0.5 * (upper - lower) * x
        weights = w * np.exp(-0.5 * z * z)
        return z, weights / weights.sum()


@dataclass(frozen=True, slots=True, kw_only=True)
class Lognormal:
    """Lognormal distribution: the logarithm of the input is normal.

    Parameters
    ----------
    median, dispersion
        Median in the unit of the field, and standard deviation of the natural logarithm of the input.
    mean, standard_deviation, coefficient_of_variation
        Mean, and standard deviation or coefficient of variation, in place of median and dispersion.
    """

    name: ClassVar[str] = "lognormal"
    median: float | None = None
    dispersion: float | None = None
    mean: float | None = None
    standard_deviation: float | None = None
    coefficient_of_variation: float | None = None

    def __post_init__(self) -> None:
        by_mean = (self.mean, self.standard_deviation, self.coefficient_of_variation)
        if self.median is not None:
            require(not any(each is not None for each in by_mean), f"{FIELD}.mean", "must not be given with median")
            require_positive(f"{FIELD}.median", self.median, None)
            require(self.dispersion is not None, f"{FIELD}.dispersion", "must be given with median")
            assert self.dispersion is not None  # noqa: S101 (just required)
            require_positive(f"{FIELD}.dispersion", self.dispersion)
            largest = f"must be at most {LARGEST_DISPERSION:g}, got {self.dispersion:g}"
            require(self.dispersion <= LARGEST_DISPERSION, f"{FIELD}.dispersion", largest)
            self._require_finite_values(f"{FIELD}.median")
            return
        require(self.dispersion is None, f"{FIELD}.median", "must be given with dispersion")
        require(self.mean is not None, f"{FIELD}.median", "must be given with dispersion, or else mean")
        assert self.mean is not None  # noqa: S101 (just required)
        require_positive(f"{FIELD}.mean", self.mean, None)
        variation = _spread(self.mean, self.standard_deviation, self.coefficient_of_variation) / self.mean
        most = math.sqrt(math.expm1(LARGEST_DISPERSION**2))
        field = f"{FIELD}.{_spread_name(self.standard_deviation)}"
        require(variation <= most, field, f"must be at most {most:.3g} means")
        self._require_finite_values(f"{FIELD}.mean")

    def _require_finite_values(self, field: str) -> None:
        middle, deviation = self._logarithm
        finite = middle + FAR * deviation <= math.log(sys.float_info.max)
        require(finite, field, f"is too large: {FAR:g} dispersions above it is no finite number")

    @property
    def _logarithm(self) -> tuple[float, float]:
        """Mean and standard deviation of the logarithm."""
        if self.median is not None and self.dispersion is not None:
            return math.log(self.median), self.dispersion
        mean = self.mean or math.nan
        variation = _spread(mean, self.standard_deviation, self.coefficient_of_variation) / mean
        variance = math.log1p(variation * variation)
        return math.log(mean) - 0.5 * variance, math.sqrt(variance)

    @property
    def wide(self) -> bool:
        """True if the dispersion is so large that polynomials of higher order in this input are tried."""
        return self._logarithm[1] >= WIDE

    def standard(self, u: FloatArray) -> FloatArray:
        """Return x/√(1 + x²) at given probabilities, where x = ln(input / median)."""
        from scipy.special import ndtri  # noqa: PLC0415 (slow to import, and needed for sampling only)

        # Critical angles level off where a factor on the resistance is very large or very small. Polynomials in a
        # bounded variable can follow this, whereas polynomials in the logarithm grow without bound.
        return self._bounded(ndtri(u))

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at values of the standard variable."""
        # Written as (1 - z)(1 + z), 1 - z² keeps its relative accuracy near z = ±1, where the input is very large or
        # small.
        middle, _ = self._logarithm
        return np.asarray(np.exp(middle + z / np.sqrt((1.0 - z) * (1.0 + z))), float)

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights for a mean over the distribution."""
        nodes, weights = _normal_panel()
        return self._bounded(nodes), weights

    def _bounded(self, z: FloatArray) -> FloatArray:
        x = self._logarithm[1] * z
        return np.asarray(x / np.sqrt(1.0 + x * x), float)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogStudentT:
    """Log-Student distribution: the logarithm of the input has Student's distribution, with heavier tails than normal.

    Parameters
    ----------
    median
        Median in the unit of the field.
    scale
        Scale of the natural logarithm. [1]
    degrees_of_freedom
        Degrees of freedom, from 1 to a million; with many, the distribution is nearly lognormal. [1]
    lower, upper
        Bounds at which the distribution is truncated, if any, with the median between them. Without them, heavy
        tails may reach beyond the bounds of the field.
    """

    name: ClassVar[str] = "log_student_t"
    median: float
    scale: float
    degrees_of_freedom: float
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        require_positive(f"{FIELD}.median", self.median, None)
        require_positive(f"{FIELD}.scale", self.scale)
        largest = f"must be at most {LARGEST_DISPERSION:g}, got {self.scale:g}"
        require(self.scale <= LARGEST_DISPERSION, f"{FIELD}.scale", largest)
        low, high = FREEDOM
        inside = low <= self.degrees_of_freedom <= high
        require(inside, f"{FIELD}.degrees_of_freedom", f"must be between {low:g} and {high:g}")
        if self.lower is not None:
            require_positive(f"{FIELD}.lower", self.lower, None)
            _require_order("lower", self.lower < self.median, "below the median", self.median)
        if self.upper is not None:
            require_finite(f"{FIELD}.upper", self.upper)
            _require_order("upper", self.upper > self.median, "above the median", self.median)
        if self.lower is None or self.upper is None:
            reach = abs(math.log(self.median)) + self.scale * abs(self._quantile(TINY))
            finite = reach <= math.log(sys.float_info.max)
            without = "lower" if self.lower is None else "upper"
            require(finite, f"{FIELD}.{without}", "must be given: such tails exceed the largest floating-point number")

    @property
    def dispersion(self) -> float:
        """Standard deviation of the logarithm before truncation, or its substitute by `student_dispersion`. [1]"""
        return student_dispersion(self.scale, self.degrees_of_freedom)

    @property
    def wide(self) -> bool:
        """True if the dispersion is so large that polynomials of higher order in this input are tried."""
        return self.dispersion >= WIDE

    def scales(self, u: FloatArray) -> FloatArray:
        """Return ln(input / median) divided by the scale, at given probabilities. [1]"""
        from scipy.special import stdtr  # noqa: PLC0415 (slow to import, and needed for sampling only)

        lower = -math.inf if self.lower is None else math.log(self.lower / self.median) / self.scale
        upper = math.inf if self.upper is None else math.log(self.upper / self.median) / self.scale
        below, above = (float(stdtr(self.degrees_of_freedom, each)) for each in (lower, -upper))
        return np.asarray(np.clip(self._quantile(below + u * (1.0 - below - above)), lower, upper), float)

    def standard(self, u: FloatArray) -> FloatArray:
        """Return x/√(1 + x²) at given probabilities, where x = ln(input / median)."""
        x = self.scale * self.scales(u)
        return np.asarray(x / np.sqrt(1.0 + x * x), float)

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at values of the standard variable."""
        return np.asarray(self.median * np.exp(z / np.sqrt((1.0 - z) * (1.0 + z))), float)

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights for a mean over the distribution."""
        # The rule is over probabilities, because a rule over a finite range, as for a normal distribution, would cut
        # off the heavy tails.
        x, w = leggauss(4 * NODES)
        return self.standard(0.5 * (1.0 + x)), 0.5 * w

    def _quantile(self, u: Any) -> Any:
        from scipy.special import stdtrit  # noqa: PLC0415 (slow to import, and needed for sampling only)

        return stdtrit(self.degrees_of_freedom, u)


@dataclass(frozen=True, slots=True, kw_only=True)
class Uniform:
    """Uniform distribution between two bounds."""

    name: ClassVar[str] = "uniform"
    lower: float
    upper: float

    def __post_init__(self) -> None:
        require_finite(f"{FIELD}.lower", self.lower)
        require_finite(f"{FIELD}.upper", self.upper)
        _require_order("upper", self.upper > self.lower, "above the lower bound", self.lower)

    def standard(self, u: FloatArray) -> FloatArray:
        """Return the position between the bounds, from -1 to 1, at given probabilities."""
        return 2.0 * u - 1.0

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at positions between the bounds."""
        return 0.5 * (self.lower + self.upper) + 0.5 * (self.upper - self.lower) * z

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights for a mean over the distribution."""
        x, w = leggauss(NODES)
        return x, 0.5 * w


@dataclass(frozen=True, slots=True, kw_only=True)
class Triangular:
    """Triangular distribution: the density rises linearly from zero to the mode, then falls linearly to zero."""

    name: ClassVar[str] = "triangular"
    lower: float
    mode: float
    upper: float

    def __post_init__(self) -> None:
        for name in ("lower", "mode", "upper"):
            require_finite(f"{FIELD}.{name}", getattr(self, name))
        _require_order("upper", self.upper > self.lower, "above the lower bound", self.lower)
        inside = self.lower <= self.mode <= self.upper
        bounds = Amount(self.lower, None, bare=True), Amount(self.upper, None)
        require(inside, f"{FIELD}.mode", "must be between the bounds, {} and {}", *bounds)

    @property
    def _peak(self) -> float:
        return (self.mode - self.lower) / (self.upper - self.lower)

    def standard(self, u: FloatArray) -> FloatArray:
        """Return the position between the bounds, from 0 to 1, at given probabilities."""
        peak = self._peak
        rising, falling = np.sqrt(u * peak), 1.0 - np.sqrt((1.0 - u) * (1.0 - peak))
        return np.where(u < peak, rising, falling)

    def value(self, z: FloatArray) -> FloatArray:
        """Return the input at positions between the bounds."""
        return self.lower + (self.upper - self.lower) * z

    def quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Return nodes and weights for a mean over the distribution."""
        # There is a rule on each side of the mode, where the density has a corner.
        peak, (x, w) = self._peak, leggauss(NODES)
        x, w = 0.5 * (1.0 + x), 0.5 * w
        nodes = np.concatenate((peak * x, 1.0 - (1.0 - peak) * x))
        return nodes, np.concatenate((peak * w * 2.0 * x, (1.0 - peak) * w * 2.0 * x))


@dataclass(frozen=True, slots=True, kw_only=True)
class Discrete:
    """Discrete distribution of numbers or models.

    Parameters
    ----------
    values
        Values, none of them repeated.
    weights
        Probabilities of the values, which sum to 1; equal unless given.
    """

    name: ClassVar[str] = "discrete"
    values: Sequence[Any]
    weights: Sequence[float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(plain(self.values)))
        if self.weights is not None:
            object.__setattr__(self, "weights", tuple(plain(self.weights)))
        require(len(self.values) >= 1, f"{FIELD}.values", "must hold at least one value")
        twice = next((i for i, value in enumerate(self.values) if value in list(self.values[:i])), None)
        require(twice is None, f"{FIELD}.values.{twice}", "must not repeat a value")
        if self.weights is None:
            return
        same = len(self.weights) == len(self.values)
        require(same, f"{FIELD}.weights", f"must be as many as values, {len(self.values)}, got {len(self.weights)}")
        for index, weight in enumerate(self.weights):
            require_positive(f"{FIELD}.weights.{index}", weight)
        total = math.fsum(self.weights)
        require(abs(total - 1.0) <= WEIGHTS_SUM, f"{FIELD}.weights", f"must sum to 1, got {total:.12g}")

    @property
    def probabilities(self) -> tuple[float, ...]:
        """Probabilities of the values. [1]"""
        return tuple(self.weights or (1.0 / len(self.values),) * len(self.values))

    @property
    def likeliest(self) -> int:
        """Index of the value with the largest weight, the first one if several have it."""
        return int(np.argmax(self.probabilities))

    def places(self, u: FloatArray) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Return the indices of the values at given probabilities."""
        steps = np.cumsum(self.probabilities)[:-1]
        return np.searchsorted(steps, u, side="right").astype(np.int64)


Distribution: TypeAlias = Normal | TruncatedNormal | Lognormal | LogStudentT | Uniform | Triangular | Discrete


def stated_values(distribution: Distribution) -> list[tuple[str, Any]]:
    """Return the parameters of a distribution that are values of its field, as (name, value) pairs.

    These are the discrete values, bounds, mean and median.
    """
    if isinstance(distribution, Discrete):
        return [(f"values.{number}", value) for number, value in enumerate(distribution.values)]
    names = ("lower", "median", "mean", "upper")
    return [(name, value) for name in names if (value := getattr(distribution, name, None)) is not None]


@lru_cache(maxsize=1)
def _normal_panel() -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights for the mean of a smooth function, other than a polynomial, of a normal variable."""
    # A Gauss-Hermite rule is exact for polynomials, but its nodes are too far apart for functions that level off.
    x, w = leggauss(4 * NODES)
    weights = w * np.exp(-0.5 * (FAR * x) ** 2)
    return FAR * x, weights / weights.sum()


def _hermite() -> tuple[FloatArray, FloatArray]:
    x, w = hermegauss(NODES)
    return x, w / w.sum()
