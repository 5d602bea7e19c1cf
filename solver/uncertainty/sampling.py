"""Uncertain inputs, their samples, and intervals of what is computed from these.

Samples depend on the seed alone.
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, TypeAlias, cast, get_args

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray
from solver.checks import ParameterError, require, require_between
from solver.uncertainty.distributions import Continuous, Discrete, Distribution, stated_values
from solver.uncertainty.sobol import MOST_DIMENSIONS, scrambled_sobol

MOST_INPUTS = MOST_DIMENSIONS // 2
"""Sensitivity indices take two independent sets of points."""
SCRAMBLINGS = 16
"""Independent randomisations of one Sobol sequence: their scatter is the error of their mean."""
FIRST_POINTS, FEWEST_POINTS = 16, 4
"""Points of each scrambling in the first round, and those of it where wide intervals will do; every round doubles
them."""
FEWEST_SAMPLES, MOST_SAMPLES = 256, 1_048_576
HALF_BIN = 2.0**-31
"""Sobol points have 30 bits: the middle of the cell keeps 0 away."""
UNSEEN = 1.5
"""Share that no sample of n shows, in units of 1/n at one standard error: about 3/n at 95 %, the rule of three."""
MOST_ALTERNATIVES = 8
"""Combinations of discrete values of which each is computed at every point; of more, they are sampled."""
SWING_LEVELS = (0.05, 0.95)
"""Quantiles of an input between which its swing is computed."""
BISECTIONS = 60

Point = tuple[Any, ...]
"""A value of each input, in their order."""
Accepts: TypeAlias = Callable[[int, float], bool]
"""Whether a value of an input is one that the model accepts."""


@dataclass(frozen=True, slots=True)
class Uncertain:
    """An input and its distribution, independent of the others.

    Parameters
    ----------
    field
        Dotted name, as in ``impact.velocity``, ``target.compressive_strength``, ``projectile.mass``,
        ``numerics.retention_energy_fraction``, or its last part where that is clear; a model with discrete values, as
        in ``resistance.free_surface``; or ``resistance.strength_residual``, a factor on the strength factor.
    distribution
        In the unit of the field.
    """

    field: str
    distribution: Distribution

    def __post_init__(self) -> None:
        kinds, given = get_args(Distribution), cast(object, self.distribution)
        if not isinstance(given, kinds):
            *names, last = (kind.__name__ for kind in kinds)
            found = repr(given) if isinstance(given, str) else type(given).__name__
            raise ParameterError(
                "uncertain.distribution",
                f"must be one of solver.uncertainty: {', '.join(names)} or {last}, got {found}; give "
                "Normal(mean=..., standard_deviation=...) for a normal one of SciPy",
            )


def require_inputs(uncertain: object) -> None:
    """Refuse anything but a sequence of inputs, naming what is accepted."""
    given = uncertain if isinstance(uncertain, Iterable) and not isinstance(uncertain, str | Mapping) else [uncertain]
    for each in given:
        if not isinstance(each, Uncertain):
            found = repr(each) if isinstance(each, str) else type(each).__name__
            raise ParameterError(
                "uncertain",
                "must be a sequence of inputs such as Uncertain('impact.velocity', Normal(mean=238.0, "
                f"standard_deviation=2.0)), or usual_scatter(...), got {found}",
            )


def check_inputs(uncertain: Sequence[Uncertain]) -> None:
    """Refuse no input, too many of them, and the same field twice."""
    require(1 <= len(uncertain) <= MOST_INPUTS, "uncertain", f"must hold 1 to {MOST_INPUTS} inputs")
    for index, (field, count) in enumerate(Counter(each.field for each in uncertain).items()):
        if count > 1:
            later = [i for i, each in enumerate(uncertain) if each.field == field][1]
            raise ParameterError(f"uncertain.{later}.field", f"{field!r} is the field of input {index} too")


def check_values(index: int, uncertain: Uncertain, check: Callable[[Any], object]) -> None:
    """Refuse a distribution whose discrete values, bounds, mean or median are not accepted as values of its field.

    Parameters
    ----------
    index
        Place of the input.
    check
        Takes a value; raises ParameterError if it is not accepted.
    """
    for name, value in stated_values(uncertain.distribution):
        try:
            check(value)
        except ParameterError as error:
            field = f"uncertain.{index}.distribution.{name}"
            raise ParameterError(field, f"is no value of {uncertain.field!r}: {error.requirement}") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """How much is sampled.

    Parameters
    ----------
    half_width
        Half width of the interval of every probability, cut off at 0 and 1, at which sampling ends. [1]
    confidence
        Confidence level of every interval. [1]
    max_samples
        Searches or runs at most, never exceeded: 256 or more, and with sensitivities two for each continuous input and
        one for each discrete value besides.
    seed
        Sample i of a seed is always the same.
    method
        ``"auto"`` uses the surrogate where it passes its check, ``"direct"`` never.
    """

    half_width: float = 0.02
    confidence: float = 0.95
    max_samples: int = 16_384
    seed: int = 0
    method: str = "auto"

    def __post_init__(self) -> None:
        require_between("sampling.half_width", self.half_width, 1e-4, 0.5)
        require_between("sampling.confidence", self.confidence, 0.5, 0.9999)
        require_between("sampling.max_samples", self.max_samples, FEWEST_SAMPLES, MOST_SAMPLES)
        require_between("sampling.seed", self.seed, 0, 2**53)
        require(self.method in ("auto", "direct"), "sampling.method", "must be 'auto' or 'direct'")

    @property
    def normal_quantile(self) -> float:
        """Standard errors of the half width of an interval."""
        from scipy.special import ndtri  # noqa: PLC0415 (takes long to import, also where nothing is sampled)

        return float(ndtri(0.5 + 0.5 * self.confidence))

    @property
    def first_points(self) -> int:
        """Points of each scrambling in the first round of a study of angles.

        No fewer than it takes for what no sample shows to be within the half width: 16 for the usual one.
        """
        least = self.student_quantile * UNSEEN / (SCRAMBLINGS * self.half_width)
        return next(count for count in (FEWEST_POINTS, 8, FIRST_POINTS) if count >= min(least, FIRST_POINTS))

    @property
    def student_quantile(self) -> float:
        """Standard errors of the half width where the standard error comes from the scramblings.

        Their means are not quite normal: with half the risk, true values are found within their intervals as often as
        the confidence says (`tests/uncertainty/test_coverage.py`).
        """
        from scipy.special import stdtrit  # noqa: PLC0415 (takes long to import, also where nothing is sampled)

        return float(stdtrit(SCRAMBLINGS - 1, 0.75 + 0.25 * self.confidence))


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its interval at the confidence of the study."""

    value: float
    lower: float
    upper: float

    def __repr__(self) -> str:
        return f"{self.value:.6g} ({self.lower:.6g} to {self.upper:.6g})"


@lru_cache(maxsize=64)
def scrambled(seed: int, dimensions: int, count: int, stream: int = 0) -> FloatArray:
    """Return (scramblings, count, dimensions) points between 0 and 1; `count` is a power of two.

    The first points of a scrambling are the same whatever their count.
    """
    points = np.empty((SCRAMBLINGS, count, dimensions))
    for number in range(SCRAMBLINGS):
        generator = np.random.default_rng([seed, stream, number])
        points[number] = scrambled_sobol(generator, dimensions, count)
    points += HALF_BIN
    points.setflags(write=False)
    return points


def share_half_width(by_scrambling: FloatArray, sampling: Sampling, samples: int) -> FloatArray:
    """Half width of the interval of shares from their values in each scrambling, along the first axis."""
    variance = by_scrambling.var(axis=0, ddof=1) / SCRAMBLINGS
    return np.asarray(sampling.student_quantile * np.sqrt(variance + (UNSEEN / samples) ** 2), float)


def jackknifed(value: float, without: FloatArray, sampling: Sampling) -> Estimate:
    """Return an estimate with its interval from the values that leave out one scrambling each."""
    count = without.size
    error = math.sqrt((count - 1) / count * float(((without - without.mean()) ** 2).sum()))
    half = sampling.student_quantile * error
    return Estimate(value, value - half, value + half)


def share_estimate(by_scrambling: FloatArray, sampling: Sampling, samples: int) -> Estimate:
    """Return a share with its interval, from its values in each scrambling."""
    value, half = float(by_scrambling.mean()), float(share_half_width(by_scrambling, sampling, samples))
    return Estimate(value, max(0.0, value - half), min(1.0, value + half))


def moment_estimates(
    values: FloatArray, weights: FloatArray, sampling: Sampling
) -> tuple[Estimate | None, Estimate | None]:
    """Mean and standard deviation of (scramblings, n) values."""
    totals = weights.sum(axis=1)
    centre = float((weights * values).sum() / totals.sum())
    first = (weights * (values - centre)).sum(axis=1)
    second = (weights * (values - centre) ** 2).sum(axis=1)

    def moments(total: FloatArray, one: FloatArray, two: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = one / total
        return centre + mean, np.sqrt(np.maximum(two / total - mean**2, 0.0))

    mean, deviation = moments(totals.sum(), first.sum(), second.sum())
    rest = totals.sum() - totals
    if not (rest > 0.0).all():  # all of them in one scrambling: nothing is left to compare
        return None, None
    means, deviations = moments(rest, first.sum() - first, second.sum() - second)
    return jackknifed(float(mean), means, sampling), jackknifed(float(deviation), deviations, sampling)


def quantile_estimates(
    values: FloatArray,
    weights: FloatArray,
    levels: Sequence[float],
    sampling: Sampling,
    shift: FloatArray | float = 0.0,
) -> tuple[tuple[float, Estimate], ...]:
    """Return levels with the quantiles there and their intervals.

    The interval is Woodruff's (1952): between the quantiles at the ends of the interval of the share.

    Parameters
    ----------
    values, weights
        (scramblings, n) of samples; those without a value have no weight.
    levels
        Shares. [1]
    shift
        Error of the values themselves, by which the interval grows.
    """
    flat, shared = values.ravel(), weights.ravel()
    totals = weights.sum(axis=1)
    totals = np.where(totals > 0.0, totals, 1.0)

    def quantiles(of: FloatArray, at: FloatArray) -> list[float]:  # of all levels at once, as each call sorts
        return [float(each) for each in np.quantile(of, at, weights=shared, method="inverted_cdf")]

    found = quantiles(flat, np.array(levels))
    below = np.stack([np.where(values <= value, weights, 0.0).sum(axis=1) / totals for value in found], axis=1)
    half = share_half_width(below, sampling, flat.size)
    shifts = np.broadcast_to(shift, values.shape).ravel()
    lower = quantiles(flat - shifts, np.clip(levels - half, 0.0, 1.0))
    upper = quantiles(flat + shifts, np.clip(levels + half, 0.0, 1.0))
    return tuple(
        (level, Estimate(value, min(low, value), max(high, value)))
        for level, value, low, high in zip(levels, found, lower, upper, strict=True)
    )


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
