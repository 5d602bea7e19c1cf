"""Array types, Gauss-Legendre rules, and polynomials for the sine and the arc cosine.

The compiler vectorises a loop that evaluates a polynomial, but not a loop that calls a library function. The
polynomials are interpolated at Chebyshev nodes when the package is imported. The stated errors are the largest found on
a fine grid.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from solver.compilation import exact

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]


class ComparedByFields:
    """Base of dataclasses with array fields: two objects are equal if all their fields have equal values."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        pairs = [(getattr(self, name), getattr(other, name)) for name in self.__dataclass_fields__]
        return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs)

    def __hash__(self) -> int:
        return hash(tuple(getattr(self, name) for name in self.__dataclass_fields__))


@cache
def gauss_rule(count: int) -> FloatArray:
    """Return nodes and weights of the Gauss-Legendre rule on [0, 1], as columns of a (count, 2) array.

    The array is cached, so callers must not modify it.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return np.column_stack(((nodes + 1.0) / 2.0, weights / 2.0))


def interpolation(degree: int) -> tuple[FloatArray, FloatArray]:
    """Return Chebyshev nodes on [-1, 1], and the matrix that turns values there into polynomial coefficients.

    The coefficients begin with the constant term.
    """
    # Interpolation at Chebyshev nodes is nearly as accurate as the best polynomial of the same degree. The Chebyshev
    # coefficients are computed first, because the Vandermonde matrix of the powers is ill-conditioned.
    nodes = np.cos((np.arange(degree + 1) + 0.5) * np.pi / (degree + 1))
    series = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, degree))
    powers = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        powers[: k + 1, k] = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[k, : k + 1])
    return nodes, powers @ series


def fit(function: Callable[[FloatArray], FloatArray], degree: int) -> FloatArray:
    """Interpolate a function on [-1, 1] by a polynomial; return its (degree + 1,) coefficients, constant first."""
    nodes, matrix = interpolation(degree)
    return np.asarray(matrix @ function(nodes))


def _sine_ratio(t: FloatArray) -> FloatArray:
    # sin(x)/x is even, so a polynomial in x² needs half the degree of a polynomial in x.
    x = np.sqrt((t + 1.0) / 2.0) * np.pi / 2.0
    return np.sin(x) / x


def _arc_ratio(t: FloatArray) -> FloatArray:
    # Near c = 1 the arc cosine grows like the square root of 1 - c. Dividing by that root leaves a smooth function.
    c = (t + 1.0) / 2.0
    return np.arccos(c) / np.sqrt(1.0 - c)


# These are the lowest degrees with errors of at most 1e-10 and 1e-8, both below the largest error of the decay
# polynomials, 2e-7 (`solver.free_surface`).
SINE = tuple(float(c) for c in fit(_sine_ratio, 5))
ARC = tuple(float(c) for c in fit(_arc_ratio, 8))
SINE_SCALE = 8.0 / math.pi**2
"""Factor that maps the square of an angle up to π/2 to the interval [0, 2]. [1/rad²]"""


@exact
def sine(x: float) -> float:
    """Return the sine of an angle between -π/2 and π/2, with an error of at most 1e-10."""
    t = SINE_SCALE * x * x - 1.0
    ratio = SINE[-1]
    for k in range(len(SINE) - 2, -1, -1):
        ratio = ratio * t + SINE[k]
    return x * ratio


@exact
def arc_cosine(c: float) -> float:
    """Return the angle between 0 and π whose cosine is `c`, with an error of at most 1e-8. [rad]"""
    # The polynomial covers 0 ≤ c ≤ 1; the angle of a negative cosine follows by symmetry.
    size = abs(c)
    t = 2.0 * size - 1.0
    ratio = ARC[-1]
    for k in range(len(ARC) - 2, -1, -1):
        ratio = ratio * t + ARC[k]
    angle = math.sqrt(1.0 - size) * ratio
    return angle if c >= 0.0 else math.pi - angle
