"""Scatter that the inputs of a study are expected to have after further shots into the same concrete."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from solver.arrays import FloatArray
from solver.projectile import Projectile
from solver.resistance import PublishedTests, Resistance, student_dispersion, tail_ratio
from solver.strength_scatter import strength_slope
from solver.target import Target
from solver.uncertainty.distributions import Continuous, Discrete, Distribution, Lognormal, LogStudentT
from solver.uncertainty.sampling import Uncertain

RESIDUAL = "resistance.strength_residual"
"""Field name of a factor on S, for the part of the scatter of S that the other inputs do not explain."""
STRENGTH = "target.compressive_strength"
"""Field name of the compressive strength, without the suffix `_pa` of the HTTP interface."""
# The first shot narrows the scatter most. For the paper's strike the standard deviation of ln S is 0.48 without shots,
# 0.13 after one, 0.10 after three, and still 0.08 after ten.
COUNTS = (1, 3)
"""Numbers of shots for which the expected range of the critical angle is computed."""
# At most half of the squared range of S f'c is attributed to the strength, as in `StrengthScatter`.
HALF = math.sqrt(0.5)
"""Largest part of the 90 % range of S f'c that is attributed to the strength. [1]"""


@dataclass(frozen=True, slots=True)
class Narrowed:
    """Input whose scatter decreases with the shots."""

    place: int
    """Index among the inputs of the study."""
    part: float
    """Ratio of the dispersion or scale after the shots to its value before. [1]"""
    distribution: Distribution
    """Distribution before the shots."""
    shots: int
    """Number of shots, by which the degrees of freedom of Student's distribution increase."""

    def weights(self, unit: FloatArray) -> FloatArray:
        """Return the ratio of the density after the shots to that before, up to a factor, at given probabilities."""
        from scipy.special import ndtri  # noqa: PLC0415 (slow to import, and needed for sampling only)

        if isinstance(self.distribution, LogStudentT):
            before, t = self.distribution.degrees_of_freedom, self.distribution.scales(unit)
            after = before + self.shots
            logs = 0.5 * (before + 1.0) * np.log1p(t**2 / before)
            logs -= 0.5 * (after + 1.0) * np.log1p((t / self.part) ** 2 / after)
            return np.asarray(np.exp(logs) / self.part, float)
        return np.asarray(np.exp(-0.5 * ndtri(unit) ** 2 * (1.0 / self.part**2 - 1.0)) / self.part, float)


@dataclass(frozen=True, slots=True)
class NextShot:
    """Expected scatter of the inputs of a study after a number of shots.

    Notes
    -----
    A depth gives the product S f'c, whose squared scale d² in the study follows from the squared 90 % ranges of the
    factor on S and of the strength. Shots reduce the part t² = d² - w² that exceeds the squared scale w² within a
    series: after n shots with the usual scatter it is 1/(1/t² + n/w²). A factor with Student's distribution gains n
    degrees of freedom. The strength keeps its scatter unless it would then make up more than half of what remains, as
    in `StrengthScatter`.
    """

    shots: int
    """Number of shots."""
    dispersion: float
    """Standard deviation of ln S for the next shot after these shots, at the stated strength. [ln]"""
    parts: tuple[Narrowed, ...]
    """Inputs whose scatter decreases."""

    def weights(self, unit: FloatArray) -> FloatArray:
        """Return weights that turn samples of the study into samples after the shots.

        Parameters
        ----------
        unit
            (..., inputs) points of the study between 0 and 1.
        """
        # This is importance sampling from a wider distribution. The ratio of the densities is bounded, so the samples
        # of the study, or of its surrogate, are enough.
        found = np.ones(unit.shape[:-1])
        for each in self.parts:
            found *= each.weights(unit[..., each.place])
        return found


def next_shots(
    uncertain: Sequence[Uncertain], *, projectile: Projectile, target: Target, resistance: Resistance
) -> tuple[int, tuple[NextShot, ...]] | None:
    """Return the index of the factor on S among the inputs, and the scatter expected after `COUNTS` shots.

    The result is None unless the factor is an input with a lognormal or log-Student distribution of nonzero width.

    Parameters
    ----------
    uncertain
        Inputs of the study.
    projectile, target, resistance
        As for `critical_angle`. Shots are assumed not to move the median of S.
    """
    fields = {each.field.removesuffix("_pa"): place for place, each in enumerate(uncertain)}
    place = fields.get(RESIDUAL)
    if place is None:
        return None
    factor = uncertain[place].distribution
    if not isinstance(factor, Lognormal | LogStudentT):
        return None
    strength_place = fields.get(STRENGTH)
    # Squared 90 % ranges nearly add up; squared scales of distributions with different tails do not. Ranges are in
    # units of the 90 % range of a standard normal distribution.
    own = _scale(factor) * _ratio(factor, 0)
    if own == 0.0:  # the dispersion is below the rounding error
        return None
    share = 0.0
    if strength_place is not None and not isinstance(uncertain[strength_place].distribution, Discrete):
        share = _scale(uncertain[strength_place].distribution) * abs(strength_slope(projectile, target, resistance))
    now, within = math.hypot(own, share) / _ratio(factor, 0), PublishedTests.within_series
    between = now**2 - within**2
    found = []
    for count in COUNTS:
        scale = now
        if between > 0.0:
            scale = math.sqrt(1.0 / (1.0 / between + count / within**2) + within**2)
        left = scale * _ratio(factor, count)
        if strength_place is None or share <= HALF * left:
            narrow, parts = math.sqrt(left**2 - share**2), {}
        else:
            narrow = HALF * left
            parts = {strength_place: math.sqrt(left**2 - min(own, narrow) ** 2) / share}
        narrow = min(own, narrow)
        parts[place] = narrow / own * _ratio(factor, 0) / _ratio(factor, count)
        narrowed = tuple(Narrowed(at, part, uncertain[at].distribution, count) for at, part in parts.items())
        found.append(NextShot(count, _dispersion(scale, factor, count), narrowed))
    return place, tuple(found)


def _scale(distribution: Distribution) -> float:
    """Return the scale of the logarithm of an input. [ln]

    For a log-Student distribution this is its scale. For others it is half the distance between the logarithms of two
    quantiles, at the probabilities of ±1 standard deviation of a normal distribution, or 0 if the lower quantile is not
    above zero.
    """
    from scipy.special import ndtr  # noqa: PLC0415 (slow to import, and needed for sampling only)

    if isinstance(distribution, LogStudentT):
        return distribution.scale
    found = cast(Continuous, distribution)
    lower, upper = found.value(found.standard(ndtr(np.array([-1.0, 1.0]))))
    return 0.5 * (math.log(upper) - math.log(lower)) if lower > 0.0 else 0.0


def _ratio(factor: Lognormal | LogStudentT, shots: int) -> float:
    """Return the 90 % range of the factor after `shots` shots, relative to a normal one of the same scale. [1]"""
    return 1.0 if isinstance(factor, Lognormal) else tail_ratio(factor.degrees_of_freedom + shots)


def _dispersion(scale: float, factor: Lognormal | LogStudentT, shots: int) -> float:
    """Return the standard deviation of ln S after `shots` shots; `factor` multiplies S in the study. [ln]"""
    if isinstance(factor, Lognormal):
        return scale
    return student_dispersion(scale, factor.degrees_of_freedom + shots)
