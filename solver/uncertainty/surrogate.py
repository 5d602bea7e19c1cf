"""Polynomial chaos: a smooth function of independent inputs as a sum of orthonormal polynomials; indices of Sobol.

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
    """Which products of polynomials a basis has."""

    order: int
    """Highest total order of all products."""
    narrow: int = 0
    """Highest order of an input alone, if higher."""
    wide: int = 0
    """As before, of an input that spans a large factor."""
    wide_with_one: int = 0
    """Highest order of such an input in products with the first order of one other, if higher."""

    def terms(self, inputs: int, wide: Sequence[int]) -> IntArray:
        """Return (terms, inputs) orders; `wide` are the places of the inputs that span a large factor."""
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


SHAPES = tuple(Shape(order) for order in range(1, 6))
WIDE_SHAPES = (
    *(Shape(1, narrow, wide, with_one) for narrow in (1, 2) for wide, with_one in ((4, 2), (6, 3), (8, 4))),
    *(Shape(order, order, wide, with_one) for order in (2, 3) for wide, with_one in ((4, 2), (6, 3), (8, 4))),
)
"""Shapes tried besides where an input spans a large factor: its effect levels off, that of the others hardly bends."""
POINTS_PER_TERM = 2
"""Points of a fit, at least: three inputs more would otherwise be fitted through every point."""
DRAWS = 400
"""Samples of the coefficients within their errors, for the intervals of what is computed from them."""
RESAMPLES, BATCH = 499, 50
ROUNDING = 1e-12
"""Half width of an interval at least, over the value. [1]"""


class Basis:
    """Products of orthonormal polynomials, one for each input.

    Parameters
    ----------
    inputs
        Their distributions.
    terms
        (terms, inputs) order of each polynomial.
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
    """Coefficients, a column for each order, of the polynomials orthonormal under this quadrature."""
    # Weighted columns of powers are those of orthonormal polynomials times a triangle, whose inverse so holds the
    # coefficients. QR finds it from the powers themselves: the condition of their moments is theirs squared.
    powers = np.vander(nodes, order + 1, increasing=True)
    _, triangle = np.linalg.qr(np.sqrt(weights)[:, None] * powers)
    inverse = np.linalg.inv(triangle)
    return np.asarray(inverse * np.sign(np.diagonal(triangle)), float)


@dataclass(frozen=True, slots=True)
class Expansion:
    """Least-squares fit of one function for each alternative, at the same points.

    Parameters
    ----------
    basis
        Basis of the continuous inputs.
    coefficients
        (alternatives, terms).
    scatter
        (alternatives, terms, terms) square roots of their covariances.
    held_out
        (n, alternatives) values less what the fit without that point says.
    """

    basis: Basis
    coefficients: FloatArray
    scatter: FloatArray
    held_out: FloatArray

    @property
    def errors(self) -> FloatArray:
        """(alternatives,) root mean square error at points that each fit had not seen, every point held out in turn."""
        return np.asarray(np.sqrt((self.held_out**2).mean(axis=0)), float)

    def at(self, z: FloatArray) -> FloatArray:
        """Return (n, alternatives) values at (n, inputs) standard variables."""
        return np.asarray(self.basis.at(z) @ self.coefficients.T, float)


def fit_expansion(inputs: Sequence[Continuous], z: FloatArray, values: FloatArray) -> Expansion | None:
    """Return the fit with the smallest error at held-out points; None if there are too few points.

    Parameters
    ----------
    z
        (n, inputs) standard variables.
    values
        (n, alternatives).
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
    held_out = (values - matrix @ coefficients) / np.maximum(1.0 - leverage, 1e-9)[:, None]
    errors = np.sqrt((held_out**2).mean(axis=0))
    return Expansion(basis, coefficients.T, errors[:, None, None] * inverse, held_out)


@dataclass(frozen=True, slots=True)
class Moments:
    """What the coefficients of an expansion give directly."""

    mean: Estimate
    standard_deviation: Estimate
    first_order: tuple[Estimate, ...]
    total: tuple[Estimate, ...]
    """Indices of the continuous inputs, then of the discrete ones."""


def expansion_moments(expansion: Expansion, weights: Sequence[Sequence[float]], sampling: Sampling) -> Moments:
    """Return mean, standard deviation and Sobol indices, each with its interval.

    Parameters
    ----------
    weights
        Weights of the values of each discrete input; the alternatives are every combination, the last input fastest.
    """
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
    """Moments of the coefficients in the first row, with intervals from the scatter of the others."""
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
    """Weights of the combinations."""
    return np.array([math.prod(each) for each in itertools.product(*weights)])


def _discrete_basis(weights: Sequence[Sequence[float]]) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Orthonormal functions of the discrete inputs.

    Returns
    -------
    tuple
        (combinations, functions) from values at the combinations to coefficients, and (functions, inputs) which inputs
        each function varies with.
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
    """Sobol indices by the direct method, with bootstrap intervals.

    Parameters
    ----------
    own, other
        (n,) values at the two sets of samples.
    mixed
        (inputs, n) at the first set with one input of the second.
    """
    from scipy import stats  # noqa: PLC0415 (takes long to import, also where nothing is sampled)

    size = own.size
    mixed = np.concatenate((mixed, own[None]))  # an input without effect: SciPy drops the axis of a single one

    def indices(rows: npt.NDArray[np.int64], axis: int) -> FloatArray:  # the resamples are SciPy's many outputs
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
