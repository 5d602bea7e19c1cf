"""Functions with known Sobol indices and quantiles, which stand in for the solver."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from scipy import stats

from solver.arrays import FloatArray
from solver.uncertainty import AngleStudy, AngleUncertainty, Crossings, Estimate, Normal, Sampling, Uncertain, Uniform
from solver.uncertainty.results import LEVELS
from tests.physics.strikes import known

ROUNDING = 1e-9


class Linear:
    """A linear function of normal inputs, whose results are known exactly."""

    slopes = np.array([1.0, 2.0, 3.0])
    distributions: tuple[Any, ...] = (Normal(mean=0.0, standard_deviation=1.0),) * 3
    grid = np.linspace(-6.0, 16.0, 23)
    mean = 5.0
    deviation = float(np.sqrt((slopes**2).sum()))
    first_order = total = slopes**2 / (slopes**2).sum()
    tolerance = ROUNDING

    def __call__(self, x: FloatArray) -> FloatArray:
        return np.asarray(x @ self.slopes + self.mean, float)

    def share(self, y: FloatArray) -> FloatArray:
        return np.asarray(stats.norm.cdf(y, self.mean, self.deviation), float)


class Ishigami:
    """The function of Ishigami and Homma (1990), with a = 7 and b = 0.1."""

    a, b = 7.0, 0.1
    distributions = (Uniform(lower=-math.pi, upper=math.pi),) * 3
    grid = np.linspace(-9.0, 16.0, 26)
    mean = a / 2.0
    alone, second = 0.5 * (1.0 + b * math.pi**4 / 5.0) ** 2, a**2 / 8.0
    together = b**2 * math.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    variance = alone + second + together
    deviation = math.sqrt(variance)
    first_order = np.array([alone, second, 0.0]) / variance
    total = np.array([alone + together, second, together]) / variance
    tolerance = 2e-4  # The sorted sample below gives the distribution with this accuracy.

    def __init__(self) -> None:
        x = math.pi * (2.0 * stats.qmc.Sobol(3, rng=5).random(2**18) - 1.0)
        self._sorted = np.sort(self(x))

    def __call__(self, x: FloatArray) -> FloatArray:
        return np.asarray(np.sin(x[:, 0]) * (1.0 + self.b * x[:, 2] ** 4) + self.a * np.sin(x[:, 1]) ** 2, float)

    def share(self, y: FloatArray) -> FloatArray:
        return np.asarray(np.searchsorted(self._sorted, y, side="right") / self._sorted.size, float)


class Function(Protocol):
    """A function, the distributions of its inputs, and the values at which its own distribution is evaluated."""

    distributions: Any
    grid: FloatArray

    def __call__(self, x: FloatArray) -> FloatArray: ...


def run(function: Function, *, sensitivity: bool = True, **sampling: Any) -> AngleUncertainty:
    """Run a study in which the value of a function takes the place of the critical angle."""
    inputs = [Uncertain(f"x.{i}", each) for i, each in enumerate(function.distributions)]
    study = AngleStudy(inputs, function.grid, Sampling(**sampling), sensitivity=sensitivity, bounds=(-1e3, 1e3))
    answer: AngleUncertainty = answer_of(
        study, lambda points: [Crossings((float(y),)) for y in function(np.array(points, float))]
    )
    return answer


def answer_of(study: Any, evaluate: Callable[[Sequence[Any]], Sequence[Any]]) -> Any:
    """Run a study with `evaluate` as the model that computes batches of points; return its answer."""
    steps = study.steps()
    batch = next(steps)
    while True:
        try:
            batch = steps.send(evaluate(batch.points))
        except StopIteration as end:
            return end.value


def misses(function: Any, answer: AngleUncertainty) -> list[str]:
    """Return the names of the quantities whose true value is outside the interval in the answer."""
    tolerance = function.tolerance

    def outside(estimate: Estimate, lowest: float, highest: float) -> bool:
        return not estimate.lower - tolerance <= highest or not lowest <= estimate.upper + tolerance

    found = {
        "mean": outside(known(answer.mean), function.mean, function.mean),
        "standard deviation": outside(known(answer.standard_deviation), function.deviation, function.deviation),
    }
    for level, estimate in answer.quantiles:  # The level must lie between the shares at the limits of the interval.
        low, high = function.share(np.array([estimate.lower - tolerance, estimate.upper + tolerance]))
        found[f"quantile {level}"] = not low - tolerance <= level <= high + tolerance
    for i, each in enumerate(answer.sensitivity):
        found[f"first order {i}"] = outside(known(each.first_order), function.first_order[i], function.first_order[i])
        found[f"total {i}"] = outside(known(each.total), function.total[i], function.total[i])
    shares = function.share(function.grid)
    wrong = (shares < answer.lower - tolerance) | (shares > answer.upper + tolerance)
    found |= {f"share at {y:g}": bool(each) for y, each in zip(function.grid, wrong, strict=True)}
    assert len(LEVELS) == len(answer.quantiles)
    return [name for name, missed in found.items() if missed]
