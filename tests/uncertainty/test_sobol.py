"""Scrambled Sobol points."""

import weakref

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import stats

from solver.uncertainty.sampling import scrambled
from solver.uncertainty.sobol import MOST_DIMENSIONS, scrambled_sobol


@pytest.mark.parametrize("dimensions", [1, 2, 7, MOST_DIMENSIONS])
@pytest.mark.parametrize("count", [1, 2, 4096])
def test_sobol_points_equal_scipy(dimensions: int, count: int) -> None:
    """Points with the same seed are equal to the last bit."""
    expected = stats.qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(5)).random(count)
    assert_array_equal(scrambled_sobol(np.random.default_rng(5), dimensions, count), expected)


def test_points_of_a_study_are_not_kept() -> None:
    points = weakref.ref(scrambled(0, 2, 1024))
    assert points() is None
