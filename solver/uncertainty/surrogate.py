"""Polynomial chaos expansion of a smooth function of independent inputs, and Sobol indices with or without it.

References
----------
Xiu, D., Karniadakis, G. E. (2002), SIAM J. Sci. Comput. 24, 619-644; indices from the coefficients: Sudret, B. (2008),
Reliab. Eng. Syst. Saf. 93, 964-979.
"""

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray, IntArray
from solver.uncertainty.distributions import Continuous, Lognormal, LogStudentT
from solver.uncertainty.sampling import Estimate, Sampling


class Shape(NamedTuple):
    """Orders of the polynomial products in a basis."""

    order: int
    """Highest total order of the products. The other fields allow higher orders in products of one or two inputs."""
    narrow: int = 0
    """Highest order of a product with only one input, if that does not span a large factor; used if above `order`."""
    wide: int = 0
    """Highest order of a product with only one input, if that spans a large factor; used if above `order`."""
    wide_with_one: int = 0
    """Highest order of an input that spans a large factor in products with one other input of first order; used if it
    is at least `order`."""

    def terms(self, inputs: int, wide: Sequence[int]) -> IntArray:
        """Return the (terms, inputs) orders, given the indices of the inputs that span a large factor."""
        found = [
            Counter(chosen)
            for order in range(self.order + 1)
            for chosen in itertools.combinations_with_replacement(range(inputs), order)
        ]
        for place in range(inputs):
            alone, with_one = (self.wide, self.wide_with_one) if place in wide else (self.narrow, 0)
            found += [Counter({place: power}) for power in range(self.order + 1, alone + 1)]
            found += [
                Counter({place: power, other: 1})
                for other in range(inputs)
                if other != place
                for power in range(self.order, with_one + 1)
            ]
        rows = [tuple(each[place] for place in range(inputs)) for each in found]
        return np.array(list(dict.fromkeys(rows)), dtype=np.int64).reshape(-1, inputs)


# For seven inputs, order 5 already has 792 terms, and a fit needs `POINTS_PER_TERM` points for each.
SHAPES = tuple(Shape(order) for order in range(1, 6))
"""Shapes tried in every fit."""
# The effect of an input that spans a large factor levels off, which requires high orders; the effect of other inputs is
# nearly linear. With these shapes, 128 points instead of 256 give the angle over a factor of five in S to 0.06°.
WIDE_SHAPES = (
    *(Shape(1, narrow, wide, with_one) for narrow in (1, 2) for wide, with_one in ((4, 2), (6, 3), (8, 4))),
    *(Shape(order, order, wide, with_one) for order in (2, 3) for wide, with_one in ((4, 2), (6, 3), (8, 4))),
)
"""Further shapes tried if an input spans a large factor."""
# With fewer points per term, a fit over many inputs goes through nearly every point, and its cross-validation is
# unreliable.
POINTS_PER_TERM = 2
"""Least number of points per term of a fit."""
# A standard deviation from 400 draws has a relative error of 3.5 %, which is less than the uncertainty of the standard
# error that it estimates.
DRAWS = 400
"""Number of random draws of the coefficients, for the intervals of quantities derived from them."""
# 499 resamples resolve the ends of a 95 % interval, and a batch of 50 limits the memory.
RESAMPLES, BATCH = 499, 50
"""Number of bootstrap resamples, and of resamples in memory at a time."""
# The interval of a deterministic result must not be narrower than its rounding error.
ROUNDING = 1e-12
"""Least half width of an interval, relative to the larger of the value and 1. [1]"""


class Basis:
    """Products of orthonormal polynomials, one for each input.

    Parameters
    ----------
    inputs
        Distributions of the inputs.
    terms
        (terms, inputs) orders of the polynomials.
    """

    def __init__(self, inputs: Sequence[Continuous], terms: IntArray) -> None:
        self.terms = terms
        self.order = int(terms.max(initial=0))
        self._polynomials = [_orthonormal(*each.quadrature(), self.order) for each in inputs]

    def at(self, z: FloatArray) -> FloatArray:
        """Return (n, terms) products at (n, inputs) standard variables."""
        values = np.ones((len(z), len(self.terms)))
        for column, polynomials in enumerate(self._polynomials):
            powers = np.vander(z[:, column], self.order + 1, increasing=True) @ polynomials
            values *= powers[:, self.terms[:, column]]
        return values


def _orthonormal(nodes: FloatArray, weights: FloatArray, order: int) -> FloatArray:
    """Return the coefficients, one column per order, of the polynomials orthonormal under a quadrature rule."""
    # The weighted powers at the nodes are the orthonormal polynomials times a triangular matrix, whose inverse holds
    # the coefficients. A QR decomposition of the powers avoids the matrix of their moments, whose condition number
    # would be squared.
    powers = np.vander(nodes, order + 1, increasing=True)
    _, triangle = np.linalg.qr(np.sqrt(weights)[:, None] * powers)
    inverse = np.linalg.inv(triangle)
    return np.asarray(inverse * np.sign(np.diagonal(triangle)), float)


@dataclass(frozen=True, slots=True)
class Expansion:
    """Least-squares fits of one function per alternative, at the same points.

    Parameters
    ----------
    basis
        Basis of the continuous inputs.
    coefficients
        (alternatives, terms) coefficients.
    scatter
        (alternatives, terms, terms) square roots of the covariance matrices of the coefficients.
    held_out
        (n, alternatives) values at the points, minus the predictions of fits that leave out the point.
    """

    basis: Basis
    coefficients: FloatArray
    scatter: FloatArray
    held_out: FloatArray

    @property
    def errors(self) -> FloatArray:
        """(alternatives,) root mean square errors by leave-one-out cross-validation."""
        return np.asarray(np.sqrt((self.held_out**2).mean(axis=0)), float)

    def at(self, z: FloatArray) -> FloatArray:
        """Return (n, alternatives) values at (n, inputs) standard variables."""
        return np.asarray(self.basis.at(z) @ self.coefficients.T, float)


def fit_expansion(inputs: Sequence[Continuous], z: FloatArray, values: FloatArray) -> Expansion | None:
    """Return the fit with the smallest error at held-out points; None if there are too few points.

    The error of a fit is the largest over the alternatives.

    Parameters
    ----------
    z
        (n, inputs) standard variables.
    values
        (n, alternatives) values of the function.
    """
    count, most = len(inputs), len(z) // POINTS_PER_TERM
    wide = [place for place, each in enumerate(inputs) if isinstance(each, Lognormal | LogStudentT) and each.wide]
    shapes = [each for each in SHAPES + WIDE_SHAPES * bool(wide) if math.comb(count + each.order, count) <= most]
    terms = [each for each in (shape.terms(count, wide) for shape in shapes) if len(each) <= most]
    fits = [_fit(Basis(inputs, each), z, values) for each in terms]
    return min(fits, key=lambda fit: float(fit.errors.max()), default=None)


def _fit(basis: Basis, z: FloatArray, values: FloatArray) -> Expansion:
    matrix = basis.at(z)
    orthogonal, triangle = np.linalg.qr(matrix)
    inverse = np.linalg.inv(triangle)
    coefficients = inverse @ (orthogonal.T @ values)
    leverage = (orthogonal**2).sum(axis=1)
    # The residual divided by one minus the leverage is the residual of the fit without the point (Allen 1974), so no
    # fit has to be repeated. The leverage is 1 where a fit goes through a point whatever its value; the floor avoids a
    # division by zero there.
    held_out = (values - matrix @ coefficients) / np.maximum(1.0 - leverage, 1e-9)[:, None]
    errors = np.sqrt((held_out**2).mean(axis=0))
    return Expansion(basis, coefficients.T, errors[:, None, None] * inverse, held_out)


@dataclass(frozen=True, slots=True)
class Moments:
    """Moments and Sobol indices of an expansion."""

    mean: Estimate
    """Mean of the function."""
    standard_deviation: Estimate
    """Standard deviation of the function."""
    first_order: tuple[Estimate, ...]
    """First-order indices of the continuous inputs, then of the discrete ones. [1]"""
    total: tuple[Estimate, ...]
    """Total indices in the same order. [1]"""


def expansion_moments(expansion: Expansion, weights: Sequence[Sequence[float]], sampling: Sampling) -> Moments:
    """Return mean, standard deviation and Sobol indices of an expansion, each with its interval.

    Parameters
    ----------
    weights
        Weights of the values of each discrete input. The alternatives are all combinations of values, with the last
        input varying fastest.
    """
    # The indices are sums of squared coefficients (Sudret 2008), and take no further samples. Their intervals follow
    # from random draws of the coefficients, because the indices are not linear in them.
    joint, supports = _discrete_basis(weights)
    continuous = expansion.basis.terms > 0
    support = np.concatenate(
        (
            np.repeat(continuous[None], len(supports), axis=0),
            np.repeat(supports[:, None], len(continuous), axis=1),
        ),
        axis=2,
    ).reshape(-1, continuous.shape[1] + supports.shape[1])
    generator = np.random.default_rng([sampling.seed, 2])
    draws = generator.standard_normal((DRAWS, *expansion.coefficients.shape))
    scattered = expansion.coefficients + np.einsum("ktu,dku->dkt", expansion.scatter, draws)
    every = np.concatenate((expansion.coefficients[None], scattered))
    terms = np.einsum("kq,dkt->dqt", joint, every).reshape(len(every), -1)
    missed = float(_product(weights) @ expansion.errors**2)
    return _moments(terms, support, missed, sampling)


def _moments(terms: FloatArray, support: npt.NDArray[np.bool_], missed: float, sampling: Sampling) -> Moments:
    """Return moments and indices from the coefficients in the first row, with intervals from the other rows.

    Parameters
    ----------
    terms
        (1 + draws, terms) coefficients of the expansion, and random draws of them.
    support
        (terms, inputs) mask of the inputs on which each term depends.
    missed
        Variance that the expansion does not explain, by cross-validation.
    """
    varying = support.any(axis=1)
    squares = terms**2
    variances = squares[:, varying].sum(axis=1)
    variance = float(variances[0])
    fraction = missed / variance if variance > 0.0 else 0.0
    deviation = math.sqrt(variance)
    quantile = sampling.normal_quantile

    def estimate(values: FloatArray, extra: float, lower: float, upper: float) -> Estimate:
        value = float(values[0])
        half = quantile * float(np.std(values[1:])) + extra + ROUNDING * max(1.0, abs(value))
        return Estimate(value, max(lower, value - half), min(upper, value + half))

    safe = np.where(variances > 0.0, variances, 1.0)
    first: list[Estimate] = []
    total: list[Estimate] = []
    for column in range(support.shape[1]):
        alone = support[:, column] & (support.sum(axis=1) == 1)
        for estimates, mask in ((first, alone), (total, support[:, column])):
            estimates.append(estimate(squares[:, mask].sum(axis=1) / safe, fraction, 0.0, 1.0))
    constant = terms[:, ~varying][:, 0]
    return Moments(
        mean=estimate(constant, 0.0, -math.inf, math.inf),
        standard_deviation=estimate(np.sqrt(variances), math.sqrt(variance + missed) - deviation, 0.0, math.inf),
        first_order=tuple(first),
        total=tuple(total),
    )


def _product(weights: Sequence[Sequence[float]]) -> FloatArray:
    """Return the weights of all combinations of values."""
    return np.array([math.prod(each) for each in itertools.product(*weights)])


def _discrete_basis(weights: Sequence[Sequence[float]]) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return orthonormal functions of the discrete inputs.

    Returns
    -------
    tuple
        (combinations, functions) matrix that turns values at the combinations into coefficients, and (functions,
        inputs) mask of the inputs on which each function depends.
    """
    joint, supports = np.ones((1, 1)), np.zeros((1, 0), bool)
    for each in weights:
        roots = np.sqrt(np.array(each))
        size = roots.size
        full = np.eye(size)
        full[:, 0] = roots
        orthogonal, triangle = np.linalg.qr(full)
        orthogonal = orthogonal * np.sign(np.diagonal(triangle))
        joint = np.kron(joint, orthogonal * roots[:, None])
        varies = np.arange(size) > 0
        supports = np.concatenate((np.repeat(supports, size, axis=0), np.tile(varies, len(supports))[:, None]), axis=1)
    return joint, supports


def direct_indices(
    own: FloatArray, other: FloatArray, mixed: FloatArray, sampling: Sampling
) -> list[tuple[Estimate, Estimate]]:
    """Compute first-order and total Sobol indices by the direct method, with bootstrap intervals.

    Parameters
    ----------
    own, other
        (n,) values at the two sets of samples.
    mixed
        (inputs, n) values at the first set with one input taken from the second.
    """
    from scipy import stats  # noqa: PLC0415 (slow to import, and needed for sampling only)

    size = own.size
    mixed = np.concatenate((mixed, own[None]))  # one more input, since SciPy drops the axis of a single one

    def indices(rows: npt.NDArray[np.int64], axis: int) -> FloatArray:  # SciPy treats each resample as one output
        rows = np.atleast_2d(np.moveaxis(rows, axis, -1)).astype(np.int64)
        found = stats.sobol_indices(func={"f_A": own[rows], "f_B": other[rows], "f_AB": mixed[:, rows]}, n=size)
        both = np.stack([np.reshape(each, (len(rows), -1)) for each in (found.first_order, found.total_order)])[
            ..., :-1
        ]
        return np.moveaxis(both, 1, -1)

    value = indices(np.arange(size), -1)[..., 0]
    spread = stats.bootstrap(
        (np.arange(size),),
        indices,
        n_resamples=RESAMPLES,
        batch=BATCH,
        confidence_level=sampling.confidence,
        method="percentile",
        rng=np.random.default_rng([sampling.seed, 3]),
    ).confidence_interval
    low, high = np.asarray(spread.low), np.asarray(spread.high)
    first, total = (
        [Estimate(*map(float, each)) for each in zip(value[row], low[row], high[row], strict=True)] for row in (0, 1)
    )
    return list(zip(first, total, strict=True))
