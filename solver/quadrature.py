"""Gauss-Legendre rules."""

from functools import cache

import numpy as np

from solver.arrays import FloatArray


@cache
def gauss_rule(count: int) -> FloatArray:
    """Nodes and weights on [0, 1], in the two columns of a (count, 2) array that is not to be written to."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return np.column_stack(((nodes + 1.0) / 2.0, weights / 2.0))
