"""Uncertain inputs, their sample points, and the intervals of results."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias, cast, get_args

import numpy as np
import numpy.typing as npt

from solver.arrays import FloatArray
from solver.checks import ParameterError, require, require_between
from solver.uncertainty.distributions import Continuous, Discrete, Distribution, stated_values
from solver.uncertainty.sobol import MOST_DIMENSIONS, scrambled_sobol

# Sensitivity indices take two independent sets of points, each with one dimension per input.
MOST_INPUTS = MOST_DIMENSIONS // 2
"""Largest number of uncertain inputs."""
# The scatter between independent scramblings of a Sobol sequence gives the error of their mean. With 16, this error is
# known to about a fifth, and the points of each scrambling are still evenly spread.
SCRAMBLINGS = 16
"""Number of scramblings of the Sobol sequence."""
# Sixteen points in 16 scramblings take the smallest budget, 256 samples. Every further round doubles the number of
# points.
FIRST_POINTS, FEWEST_POINTS = 16, 4
"""Number of points of each scrambling in the first round: the usual number, and the least, for a large half width."""
# The lower bound is the first round. The upper one is arbitrary, well below the 2**30 points of the sequence.
FEWEST_SAMPLES, MOST_SAMPLES = 256, 1_048_576
"""Bounds of the budget of samples."""
# Coordinates of Sobol points have 30 bits and may be 0, where most distributions have no finite value. So half the
# distance between neighbours is added.
HALF_BIN = 2.0**-31
"""Half the distance between neighbouring coordinates of Sobol points. [1]"""
# An event that none of n samples shows may have a probability of up to 3/n at 95 % confidence (the rule of three). That
# is two standard errors of 1.5/n.
UNSEEN = 1.5
"""Standard error of the probability of an event that no sample shows, times the number of samples. [1]"""
# Computing every combination at every point is more accurate, but the cost is proportional to the number of
# combinations. The value is arbitrary.
MOST_ALTERNATIVES = 8
"""Largest number of combinations of discrete values with which all are computed at every point; with more, the values
are sampled."""
# These are the ends of the 90 % range of the input, as in the range of the angle.
SWING_LEVELS = (0.05, 0.95)
"""Probabilities of the quantiles of an input with which its swing is computed."""
# Sixty halvings reach the precision of a float, which has 53 bits.
BISECTIONS = 60
"""Number of bisections to find the end of an accepted range."""

Point = tuple[Any, ...]
"""Values of the inputs, in the order of the inputs."""
Accepts: TypeAlias = Callable[[int, float], bool]
"""Function that returns whether the model accepts a value, given the index of an input and the value."""


@dataclass(frozen=True, slots=True)
class Uncertain:
    """Uncertain input with its distribution, independent of all other inputs.

    Parameters
    ----------
    field
        Dotted name of a number, such as ``impact.velocity``, ``target.compressive_strength``, ``projectile.mass`` or
        ``numerics.retention_energy_fraction``, or its last part where that is unambiguous; a model, such as
        ``resistance.free_surface``, for discrete values; ``resistance.theory``, the name of a decay law, for discrete
        values that select this law and the S(θ) that belongs to it; or ``resistance.strength_residual``, a factor on
        the strength factor.
    distribution
        Distribution in the unit of the field.

    Examples
    --------
    >>> from solver.uncertainty import Normal, Uncertain
    >>> Uncertain("impact.velocity", Normal(mean=238.0, coefficient_of_variation=0.01)).field
    'impact.velocity'
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
    """Raise `ParameterError` unless the argument is a sequence of `Uncertain`."""
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
    """Raise `ParameterError` if there are no inputs or too many, or if two of them have the same field."""
    require(1 <= len(uncertain) <= MOST_INPUTS, "uncertain", f"must hold 1 to {MOST_INPUTS} inputs")
    for index, (field, count) in enumerate(Counter(each.field for each in uncertain).items()):
        if count > 1:
            later = [i for i, each in enumerate(uncertain) if each.field == field][1]
            raise ParameterError(f"uncertain.{later}.field", f"{field!r} is the field of input {index} too")


def check_values(index: int, uncertain: Uncertain, check: Callable[[Any], object]) -> None:
    """Check that discrete values, bounds, mean and median of a distribution are valid values of its field.

    Parameters
    ----------
    index
        Index of the input.
    check
        Function that raises `ParameterError` if a value is not accepted.

    Raises
    ------
    ParameterError
        If a value is not accepted. The error names the parameter of the distribution.
    """
    for name, value in stated_values(uncertain.distribution):
        try:
            check(value)
        except ParameterError as error:
            field = f"uncertain.{index}.distribution.{name}"
            raise error.at(field, before=f"is no value of {uncertain.field!r}: ") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """Accuracy, budget and seed of a study.

    Parameters
    ----------
    half_width
        Half width of the interval of each probability, cut off at 0 and 1, at which sampling ends. [1]
    confidence
        Confidence level of every interval. [1]
    max_samples
        Limit on the number of searches or runs. It must be at least 256, plus two for each continuous input and one for
        each discrete value if sensitivities are computed.
    seed
        Seed of the sample points; the same seed always gives the same points.
    method
        ``"auto"`` uses the surrogate if it passes its check and its intervals are narrower; ``"direct"`` never uses it.

    Raises
    ------
    ParameterError
        If a value is outside its range.
    """

    # For a probability of one half, 2,400 independent samples give this half width at 95 %. The budget is seven times
    # as large, to allow for rare combinations of inputs and for sensitivities.
    half_width: float = 0.02
    confidence: float = 0.95
    max_samples: int = 16_384
    seed: int = 0
    method: str = "auto"

    def __post_init__(self) -> None:
        # A half width of 1e-4 takes a hundred million independent samples, more than the largest budget, and 0.5 is the
        # half width of the range from 0 to 1. With a confidence below one half, an interval is more often wrong than
        # right; the upper bound of the confidence is arbitrary. Every JSON reader preserves integers up to 2**53.
        require_between("sampling.half_width", self.half_width, 1e-4, 0.5)
        require_between("sampling.confidence", self.confidence, 0.5, 0.9999)
        require_between("sampling.max_samples", self.max_samples, FEWEST_SAMPLES, MOST_SAMPLES)
        require_between("sampling.seed", self.seed, 0, 2**53)
        require(self.method in ("auto", "direct"), "sampling.method", "must be 'auto' or 'direct'")

    @property
    def normal_quantile(self) -> float:
        """Half width of an interval divided by its standard error, for the normal distribution. [1]"""
        from scipy.special import ndtri  # noqa: PLC0415 (slow to import, and needed for sampling only)

        return float(ndtri(0.5 + 0.5 * self.confidence))

    @property
    def first_points(self) -> int:
        """Number of points of each scrambling in the first round of a study of angles."""
        # With fewer points, the probability of unseen events alone would exceed the half width, and the round would be
        # wasted. The default half width requires 16.
        least = self.student_quantile * UNSEEN / (SCRAMBLINGS * self.half_width)
        return next(count for count in (FEWEST_POINTS, 8, FIRST_POINTS) if count >= min(least, FIRST_POINTS))

    @property
    def student_quantile(self) -> float:
        """Half width of an interval, in standard errors that come from the scatter between scramblings. [1]"""
        # The means of the scramblings are not quite normal. With half the nominal probability outside, intervals
        # contain the true value as often as the confidence level states (`tests/uncertainty/test_coverage.py`).
        from scipy.special import stdtrit  # noqa: PLC0415 (slow to import, and needed for sampling only)

        return float(stdtrit(SCRAMBLINGS - 1, 0.75 + 0.25 * self.confidence))


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate with its interval at the confidence level of the study."""

    value: float
    """Best estimate of the value."""
    lower: float
    """Lower end of the interval."""
    upper: float
    """Upper end of the interval."""

    def __repr__(self) -> str:
        return f"{self.value:.6g} ({self.lower:.6g} to {self.upper:.6g})"


# The points are not cached: each large study would leave up to 403 MB in a process that lives long. To compute them
# again for every use takes 0.4 to 1.2 % of a verdict (28 to 41 ms of 3.5 to 7 s), also of a repeated one, and 0.3 to
# 0.6 % of a study with the default sampling (58 to 107 ms of 18 s).
def scrambled(seed: int, dimensions: int, count: int, stream: int = 0) -> FloatArray:
    """Return (scramblings, count, dimensions) points in (0, 1); `count` is a power of two.

    The first points of a scrambling do not depend on `count`. Each `stream` has independent points.
    """
    points = np.empty((SCRAMBLINGS, count, dimensions))
    for number in range(SCRAMBLINGS):
        generator = np.random.default_rng([seed, stream, number])
        points[number] = scrambled_sobol(generator, dimensions, count)
    points += HALF_BIN
    points.setflags(write=False)
    return points


def share_half_width(by_scrambling: FloatArray, sampling: Sampling, samples: int) -> FloatArray:
    """Return the half width of the interval of each probability, given its value in each scrambling.

    Parameters
    ----------
    by_scrambling
        (scramblings, ...) probabilities.
    samples
        Total number of samples, which bounds the probability of unseen events.
    """
    variance = by_scrambling.var(axis=0, ddof=1) / SCRAMBLINGS
    return np.asarray(sampling.student_quantile * np.sqrt(variance + (UNSEEN / samples) ** 2), float)


def jackknifed(value: float, without: FloatArray, sampling: Sampling) -> Estimate:
    """Return an estimate with its jackknife interval, given its values without each scrambling in turn."""
    count = without.size
    error = math.sqrt((count - 1) / count * float(((without - without.mean()) ** 2).sum()))
    half = sampling.student_quantile * error
    return Estimate(value, value - half, value + half)


def share_estimate(by_scrambling: FloatArray, sampling: Sampling, samples: int) -> Estimate:
    """Return a probability with its interval, given its value in each scrambling."""
    value, half = float(by_scrambling.mean()), float(share_half_width(by_scrambling, sampling, samples))
    return Estimate(value, max(0.0, value - half), min(1.0, value + half))


def moment_estimates(
    values: FloatArray, weights: FloatArray, sampling: Sampling
) -> tuple[Estimate | None, Estimate | None]:
    """Return the mean and standard deviation of (scramblings, n) values; None if only one scrambling has weight."""
    # The mean is subtracted before values are squared, which avoids cancellation in the variance.
    totals = weights.sum(axis=1)
    centre = float((weights * values).sum() / totals.sum())
    first = (weights * (values - centre)).sum(axis=1)
    second = (weights * (values - centre) ** 2).sum(axis=1)

    def moments(total: FloatArray, one: FloatArray, two: FloatArray) -> tuple[FloatArray, FloatArray]:
        mean = one / total
        return centre + mean, np.sqrt(np.maximum(two / total - mean**2, 0.0))

    mean, deviation = moments(totals.sum(), first.sum(), second.sum())
    rest = totals.sum() - totals
    if not (rest > 0.0).all():  # only one scrambling has values, so there is no scatter between scramblings
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
    """Return the quantile at each probability, with its interval.

    The intervals are Woodruff's (1952): their ends are the quantiles at the ends of the interval of the probability.

    Parameters
    ----------
    values, weights
        (scramblings, n) values and weights of samples; samples without a value have zero weight.
    levels
        Probabilities. [1]
    shift
        Errors of the values themselves, which widen the intervals.
    """
    flat, shared = values.ravel(), weights.ravel()
    totals = weights.sum(axis=1)
    totals = np.where(totals > 0.0, totals, 1.0)

    # NumPy supports weights only with the inverse of the empirical distribution function, without interpolation between
    # samples. All levels are computed in one call, because each call sorts the values.
    def quantiles(of: FloatArray, at: FloatArray) -> list[float]:
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
    """Sample points of uncertain inputs.

    Parameters
    ----------
    uncertain
        Inputs with their distributions.
    sampling
        Seed and budget.
    swings
        Add points at which only one input is changed.

    Raises
    ------
    ParameterError
        If the budget is too small for the first round and the swings.
    """

    def __init__(self, uncertain: Sequence[Uncertain], sampling: Sampling, *, swings: bool = False) -> None:
        self.uncertain = tuple(uncertain)
        self.sampling = sampling
        self.discrete = [i for i, each in enumerate(uncertain) if isinstance(each.distribution, Discrete)]
        self.continuous = [i for i in range(len(uncertain)) if i not in self.discrete]
        choices = [self._discrete(i) for i in self.discrete]
        self.swings = self._swing_points() if swings else []
        """Index of the changed input, and the point; all other inputs are at their median or likeliest value."""
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
        """True if every combination of discrete values is computed at every point."""
        self.choice_weights = [each.probabilities for each in choices] if self.enumerated else []
        ranges = [range(len(each)) for each in self.choice_weights]
        self.combinations = list(itertools.product(*ranges)) if self.enumerated else [()]
        self.weights = np.array([math.prod(each) for each in itertools.product(*self.choice_weights)])

    @property
    def alternatives(self) -> int:
        """Number of combinations of discrete values that are computed at every point."""
        return len(self.combinations)

    def unit(self, count: int) -> FloatArray:
        """Return (scramblings, count, 2 × inputs) points in (0, 1): two independent sets side by side."""
        return scrambled(self.sampling.seed, 2 * len(self.uncertain), count)

    def standard(self, unit: FloatArray) -> FloatArray:
        """Return the standard variables of the continuous inputs at points in (0, 1)."""
        inputs = self.continuous_inputs()
        return np.stack([each.standard(unit[..., i]) for i, each in zip(self.continuous, inputs, strict=True)], -1)

    def continuous_inputs(self) -> list[Continuous]:
        """Return the distributions of the continuous inputs."""
        return [cast(Continuous, self.uncertain[i].distribution) for i in self.continuous]

    def points(self, unit: FloatArray) -> list[Point]:
        """Return the inputs at (n, inputs) points in (0, 1), with all combinations of enumerated discrete values."""
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
        """Return the inputs at (n, inputs) points in (0, 1), with discrete values sampled."""
        return list(zip(*self._columns(unit), strict=True))

    def alternative_at(self, unit: FloatArray) -> npt.NDArray[np.int64]:
        """Return the index in `combinations` of the discrete values at each point."""
        place = np.zeros(unit.shape[:-1], np.int64)
        if self.enumerated:
            for i in self.discrete:
                place = place * len(self._discrete(i).values) + self._discrete(i).places(unit[..., i])
        return place

    def beyond(self, unit: FloatArray, accepts: Accepts) -> npt.NDArray[np.bool_]:
        """Return a mask of the points at which the model does not accept a continuous input."""
        # Each input is checked alone, with the others as in the strike. Its accepted range is an interval around its
        # median, so one bisection for each end replaces a check of every point.
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
    """Find the end of the accepted range between an accepted and a refused number, by bisection."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if accepts(middle) else (inside, middle)
    return inside
