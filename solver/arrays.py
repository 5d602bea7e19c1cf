"""Array types, Gauss-Legendre rules, and short polynomials in place of library functions.

Library functions keep a loop from running several points at a time. The polynomials are interpolated at Chebyshev nodes
when the package is imported; the errors given are the largest on a fine grid.
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
    """Base of dataclasses that hold arrays, which are equal if all their values are."""

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
    """Nodes and weights on [0, 1], in the two columns of a (count, 2) array that is not to be written to."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return np.column_stack(((nodes + 1.0) / 2.0, weights / 2.0))


def interpolation(degree: int) -> tuple[FloatArray, FloatArray]:
    """Chebyshev nodes on [-1, 1], and the matrix from values there to coefficients, constant first."""
    nodes = np.cos((np.arange(degree + 1) + 0.5) * np.pi / (degree + 1))
    series = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, degree))
    powers = np.zeros((degree + 1, degree + 1))
    for k in range(degree + 1):
        powers[: k + 1, k] = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[k, : k + 1])
    return nodes, powers @ series


def fit(function: Callable[[FloatArray], FloatArray], degree: int) -> FloatArray:
    """(degree + 1,) coefficients, constant first, of a polynomial close to `function` on [-1, 1]."""
    nodes, matrix = interpolation(degree)
    return np.asarray(matrix @ function(nodes))


def _sine_ratio(t: FloatArray) -> FloatArray:
    x = np.sqrt((t + 1.0) / 2.0) * np.pi / 2.0
    return np.sin(x) / x


def _arc_ratio(t: FloatArray) -> FloatArray:
    c = (t + 1.0) / 2.0
    return np.arccos(c) / np.sqrt(1.0 - c)


SINE = tuple(float(c) for c in fit(_sine_ratio, 5))
ARC = tuple(float(c) for c in fit(_arc_ratio, 8))
SINE_SCALE = 8.0 / math.pi**2


@exact
def sine(x: float) -> float:
    """Sine of an angle up to a quarter turn either side of zero, to 1e-10."""
    t = SINE_SCALE * x * x - 1.0
    ratio = SINE[-1]
    for k in range(len(SINE) - 2, -1, -1):
        ratio = ratio * t + SINE[k]
    return x * ratio


@exact
def arc_cosine(c: float) -> float:
    """Angle of a cosine, to 1e-8."""
    size = abs(c)
    t = 2.0 * size - 1.0
    ratio = ARC[-1]
    for k in range(len(ARC) - 2, -1, -1):
        ratio = ratio * t + ARC[k]
    angle = math.sqrt(1.0 - size) * ratio
    return angle if c >= 0.0 else math.pi - angle
