"""Where a study samples: the points of every round as values of the inputs."""

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray
from solver.uncertainty.distributions import Continuous, Discrete
from solver.uncertainty.inputs import Uncertain
from solver.uncertainty.sampling import FIRST_POINTS, SCRAMBLINGS, Sampling, scrambled
from solver.validation import require

MOST_ALTERNATIVES = 8
"""Combinations of discrete values of which each is computed at every point; of more, they are sampled."""
SWING_LEVELS = (0.05, 0.95)
"""Quantiles of an input between which its swing is computed."""

BISECTIONS = 60

Point = tuple[Any, ...]
"""A value of each input, in their order."""
Accepts: TypeAlias = Callable[[int, float], bool]
"""Whether a value of an input is one that the model accepts."""


class Design:
    """Sample points of some inputs.

    Parameters
    ----------
    uncertain
        Inputs.
    sampling
        Seed and budget.
    swings
        Whether each input is also changed alone.

    Raises
    ------
    ParameterError
        If the budget does not hold the first round.
    """

    def __init__(self, uncertain: Sequence[Uncertain], sampling: Sampling, *, swings: bool = False) -> None:
        self.uncertain = tuple(uncertain)
        self.sampling = sampling
        self.discrete = [i for i, each in enumerate(uncertain) if isinstance(each.distribution, Discrete)]
        self.continuous = [i for i in range(len(uncertain)) if i not in self.discrete]
        choices = [self._discrete(i) for i in self.discrete]
        self.swings = self._swing_points() if swings else []
        """Input and point of every one-at-a-time change, the others at their median or likeliest value."""
        first_round, budget = SCRAMBLINGS * FIRST_POINTS, sampling.max_samples
        least = first_round + len(self.swings)
        require(
            budget >= least,
            "sampling.max_samples",
            f"must be at least {least} for the sensitivity to these inputs, {first_round} samples and "
            f"{len(self.swings)} in which one input is changed alone, got {budget}",
        )
        count = math.prod(len(each.values) for each in choices)
        fits = count * first_round <= max(budget // 2, first_round) and count * first_round + len(self.swings) <= budget
        self.enumerated = count <= MOST_ALTERNATIVES and fits
        """Whether every combination of discrete values is computed at every point."""
        self.choice_weights = [each.probabilities for each in choices] if self.enumerated else []
        ranges = [range(len(each)) for each in self.choice_weights]
        self.combinations = list(itertools.product(*ranges)) if self.enumerated else [()]
        self.weights = np.array([math.prod(each) for each in itertools.product(*self.choice_weights)])

    @property
    def alternatives(self) -> int:
        """Cases at every point."""
        return len(self.combinations)

    def unit(self, count: int) -> FloatArray:
        """Return (scramblings, count, 2 inputs) points between 0 and 1: two independent sets side by side."""
        return scrambled(self.sampling.seed, 2 * len(self.uncertain), count)

    def standard(self, unit: FloatArray) -> FloatArray:
        """Return standard variables of the continuous inputs."""
        inputs = self.continuous_inputs()
        return np.stack([each.standard(unit[..., i]) for i, each in zip(self.continuous, inputs, strict=True)], -1)

    def continuous_inputs(self) -> list[Continuous]:
        """Return distributions of the continuous inputs."""
        return [cast(Continuous, self.uncertain[i].distribution) for i in self.continuous]

    def points(self, unit: FloatArray) -> list[Point]:
        """Return values at (n, inputs) points between 0 and 1, with every combination where they are enumerated."""
        columns = self._columns(unit)
        if not self.enumerated or not self.discrete:
            return list(zip(*columns, strict=True))
        found = []
        for row in zip(*columns, strict=True):
            for combination in self.combinations:
                values = list(row)
                for i, place in zip(self.discrete, combination, strict=True):
                    values[i] = self._discrete(i).values[place]
                found.append(tuple(values))
        return found

    def sampled(self, unit: FloatArray) -> list[Point]:
        """Return values at (n, inputs) points between 0 and 1, discrete ones sampled too."""
        return list(zip(*self._columns(unit), strict=True))

    def alternative_at(self, unit: FloatArray) -> npt.NDArray[np.int64]:
        """Return places among the alternatives of the discrete values at these points."""
        place = np.zeros(unit.shape[:-1], np.int64)
        if self.enumerated:
            for i in self.discrete:
                place = place * len(self._discrete(i).values) + self._discrete(i).places(unit[..., i])
        return place

    def beyond(self, unit: FloatArray, accepts: Accepts) -> npt.NDArray[np.bool_]:
        """Return which points have a continuous input outside the range that is accepted of it.

        Each input is judged alone, the others as in the strike: what is accepted of it is an interval around its
        median, whose ends are found by bisection.
        """
        found = np.zeros(unit.shape[:-1], bool)
        for i in self.continuous:
            distribution = cast(Continuous, self.uncertain[i].distribution)
            values = distribution.value(distribution.standard(unit[..., i]))
            for end, outside in ((float(values.min()), np.less), (float(values.max()), np.greater)):
                if not accepts(i, end):
                    found |= outside(values, _last_accepted(partial(accepts, i), self._middle(i), end))
        return found

    def _swing_points(self) -> list[tuple[int, Point]]:
        middle = [self._middle(i) for i in range(len(self.uncertain))]
        return [
            (i, (*middle[:i], value, *middle[i + 1 :])) for i in range(len(self.uncertain)) for value in self._ends(i)
        ]

    def _columns(self, unit: FloatArray) -> list[list[Any]]:
        columns: list[list[Any]] = []
        for i, each in enumerate(self.uncertain):
            if isinstance(each.distribution, Discrete):
                columns.append([each.distribution.values[place] for place in each.distribution.places(unit[:, i])])
            else:
                columns.append(each.distribution.value(each.distribution.standard(unit[:, i])).tolist())
        return columns

    def _discrete(self, i: int) -> Discrete:
        return cast(Discrete, self.uncertain[i].distribution)

    def _middle(self, i: int) -> Any:
        distribution = self.uncertain[i].distribution
        if isinstance(distribution, Discrete):
            return distribution.values[distribution.likeliest]
        return float(distribution.value(distribution.standard(np.array([0.5])))[0])

    def _ends(self, i: int) -> list[Any]:
        distribution = self.uncertain[i].distribution
        if isinstance(distribution, Discrete):
            return list(distribution.values)
        return [float(each) for each in distribution.value(distribution.standard(np.array(SWING_LEVELS)))]


def _last_accepted(accepts: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return the number between these that is accepted and next to one that is not."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if accepts(middle) else (inside, middle)
    return inside
