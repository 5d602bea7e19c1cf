"""Samples that depend on the seed alone, and intervals of what is computed from them."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtri, stdtrit

from solver.arrays import FloatArray
from solver.validation import require, require_between

SCRAMBLINGS = 16
"""Independent randomisations of one Sobol sequence: their scatter is the error of their mean."""
FIRST_POINTS = 16
"""Points of each scrambling in the first round; every round doubles them."""
MOST_SAMPLES = 1_048_576
HALF_BIN = 2.0**-31
"""SciPy's Sobol points have 30 bits: the middle of the cell keeps 0 away."""
UNSEEN = 1.5
"""Share that no sample of n shows, in units of 1/n at one standard error: about 3/n at 95 %, the rule of three."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """How much is sampled.

    Parameters
    ----------
    half_width
        Of the interval of every probability, cut off at 0 and 1, at which sampling ends. [1]
    confidence
        Of every interval. [1]
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
        require_between("sampling.max_samples", self.max_samples, 256, MOST_SAMPLES)
        require_between("sampling.seed", self.seed, 0, 2**53)
        require(self.method in ("auto", "direct"), "sampling.method", "must be 'auto' or 'direct'")

    @property
    def normal_quantile(self) -> float:
        """Standard errors of the half width of an interval."""
        return float(ndtri(0.5 + 0.5 * self.confidence))

    @property
    def student_quantile(self) -> float:
        """Standard errors of the half width where the standard error comes from the scramblings.

        Their means are not quite normal: with half the risk, true values are found within their intervals as often as
        the confidence says (`tests/uncertainty/test_coverage.py`).
        """
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
    from scipy import stats  # noqa: PLC0415 (takes long to import, also where nothing is sampled)

    points = np.empty((SCRAMBLINGS, count, dimensions))
    for number in range(SCRAMBLINGS):
        generator = np.random.default_rng([seed, stream, number])
        points[number] = stats.qmc.Sobol(dimensions, scramble=True, rng=generator).random(count)
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


def quantile_estimate(
    values: FloatArray, weights: FloatArray, level: float, sampling: Sampling, shift: FloatArray | float = 0.0
) -> Estimate:
    """Return a quantile with its interval, after Woodruff (1952): the quantiles at the ends of the share's interval.

    Parameters
    ----------
    values, weights
        (scramblings, n) of samples; those without a value have no weight.
    shift
        Error of the values themselves, by which the interval grows.
    """
    flat, shared = values.ravel(), weights.ravel()
    value = float(np.quantile(flat, level, weights=shared, method="inverted_cdf"))
    totals = weights.sum(axis=1)
    below = np.where(values <= value, weights, 0.0).sum(axis=1) / np.where(totals > 0.0, totals, 1.0)
    half = float(share_half_width(below, sampling, flat.size))
    ends = [min(max(level + sign * half, 0.0), 1.0) for sign in (-1.0, 1.0)]
    shifts = np.broadcast_to(shift, values.shape).ravel()
    lower = float(np.quantile(flat - shifts, ends[0], weights=shared, method="inverted_cdf"))
    upper = float(np.quantile(flat + shifts, ends[1], weights=shared, method="inverted_cdf"))
    return Estimate(value, min(lower, value), max(upper, value))
