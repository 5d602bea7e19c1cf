"""What shots of one's own into the concrete would make of a study: by how much less its inputs scatter after them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from solver.arrays import FloatArray
from solver.projectile import Projectile
from solver.resistance import PublishedTests, Resistance
from solver.strength_scatter import strength_slope
from solver.target import Target
from solver.uncertainty.distributions import Continuous, Discrete, Lognormal
from solver.uncertainty.sampling import Uncertain

RESIDUAL = "resistance.strength_residual"
"""Field of a factor on S, whatever the law of S: the part of its scatter that no input of the law explains."""
STRENGTH = "target.compressive_strength"
"""Field of the strength; in the contract its unit follows."""
COUNTS = (1, 3)
"""Shots after which the range is given."""
HALF = math.sqrt(0.5)
"""Part of the dispersion of S f'c that the strength explains at most: half of the variance."""


@dataclass(frozen=True, slots=True)
class NextShot:
    """What some shots leave of the scatter of a study.

    Notes
    -----
    A depth gives the product S f'c. Its variance in the study is that of the factor on S with that of the strength;
    what exceeds the scatter within a series, t² = d² - w², is what shots reduce: after n of them it is 1/(1/t² + n/w²).
    The strength keeps its scatter unless it would then have more than half of what is left, as in `StrengthScatter`.
    """

    shots: int
    dispersion: float
    """Of S of the shot after them, at the stated strength. [ln]"""
    parts: tuple[tuple[int, float], ...]
    """Places of the inputs that scatter less, each with the part that is left of its dispersion. [1]"""

    def weights(self, unit: FloatArray) -> FloatArray:
        """Return weights with which samples of the study, at (..., inputs) points between 0 and 1, are such of it.

        Notes
        -----
        Importance sampling from the wider distribution: the ratio of the densities is bounded, by 1 over the part, so
        that the samples of a study, or of its surrogate, are enough.
        """
        from scipy.special import ndtri  # noqa: PLC0415 (takes long to import, also where nothing is sampled)

        found = np.ones(unit.shape[:-1])
        for place, part in self.parts:
            found *= np.exp(-0.5 * ndtri(unit[..., place]) ** 2 * (1.0 / part**2 - 1.0)) / part
        return found


def next_shots(
    uncertain: Sequence[Uncertain], *, projectile: Projectile, target: Target, resistance: Resistance
) -> tuple[int, tuple[NextShot, ...]] | None:
    """Return the place of the factor on S among the inputs, and what shots leave; None if it is not lognormal there.

    Parameters
    ----------
    uncertain
        Inputs of the study.
    projectile, target, resistance
        As for `critical_angle`; the median of S after the shots is the one that the law gives now.
    """
    fields = {each.field.removesuffix("_pa"): place for place, each in enumerate(uncertain)}
    place = fields.get(RESIDUAL)
    if place is None or not isinstance(uncertain[place].distribution, Lognormal):
        return None
    own, strength_place = _dispersion(uncertain[place]), fields.get(STRENGTH)
    if own == 0.0:  # The dispersion is lost in rounding.
        return None
    share = 0.0
    if strength_place is not None and not isinstance(uncertain[strength_place].distribution, Discrete):
        share = _dispersion(uncertain[strength_place]) * abs(strength_slope(projectile, target, resistance))
    now, within = math.hypot(own, share), PublishedTests.within_series
    between = now**2 - within**2
    found = []
    for count in COUNTS:
        left = now
        if between > 0.0:
            left = math.sqrt(1.0 / (1.0 / between + count / within**2) + within**2)
        if strength_place is None or share <= HALF * left:
            parts = [(place, min(own, math.sqrt(left**2 - share**2)) / own)]
        else:
            factor = min(own, HALF * left)
            parts = [(place, factor / own), (strength_place, math.sqrt(left**2 - factor**2) / share)]
        found.append(NextShot(count, left, tuple(parts)))
    return place, tuple(found)


def _dispersion(uncertain: Uncertain) -> float:
    """Return half the distance of the logarithms of the quantiles at one standard deviation to each side. [ln]"""
    from scipy.special import ndtr  # noqa: PLC0415 (takes long to import, also where nothing is sampled)

    distribution = cast(Continuous, uncertain.distribution)
    lower, upper = distribution.value(distribution.standard(ndtr(np.array([-1.0, 1.0]))))
    return 0.5 * (math.log(upper) - math.log(lower)) if lower > 0.0 else 0.0
