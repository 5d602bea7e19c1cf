"""Scatter of the strength factor about its law, and the part of it that the compressive strength causes."""

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, assert_never, get_args

import numpy as np

from solver.checks import BOUNDS, require
from solver.projectile import Projectile
from solver.resistance import (
    ConstantStrengthFactor,
    ObliquityPolynomial,
    OwnTests,
    PublishedTests,
    Resistance,
    Shot,
    ShotPrediction,
    StrengthPosterior,
    StrengthPowerLaw,
    predict_shot,
    tail_ratio,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from solver.target import Target

TABLE_1 = OwnTests(
    shots=(
        Shot(velocity=238.1, depth=0.30, mass=12.923),
        Shot(velocity=275.7, depth=0.38, mass=12.900),
        Shot(velocity=314.0, depth=0.45, mass=12.910),
        Shot(velocity=369.5, depth=0.53, mass=12.914),
    )
)
"""Four shots of the paper's Table 1, as own tests of the paper's concrete and projectile."""
ScatterSource: TypeAlias = Literal["law", "paper_table_1"]
"""Tests from which the scatter of S is taken: those behind the law of published tests, or the four in the paper's Table
1."""
# Cores from one structure scatter by 10 to 15 %. The value matters little, because tests give the scatter of the
# product S f'c, and the strength accounts for only a part of it. With half the value, the ends of the 90 % range of the
# paper's strike move by 0.2° at most, with twice the value by 0.9°.
STRENGTH_DISPERSION = 0.12
"""Standard deviation of the logarithm of the compressive strength about its stated value. [ln]"""
# The laws are power laws or nearly so. Their logarithm is nearly linear in ln f'c, so the increment may be as large as
# one per cent.
STRENGTH_STEP = 0.01
"""Increment of ln f'c in the finite difference of ln(S f'c). [ln]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class StrengthScatter:
    """Scatter of S about its law, split into the part that the strength causes and a remainder.

    Notes
    -----
    Depths of tests give the product S f'c, and the laws of S were fitted to stated strengths. So the scatter of S in
    tests is the scatter of the product at the stated strength, and includes the scatter of the strength about its
    stated value. If the strength is sampled too, a factor on S represents the remaining scatter: `residual` is its
    scale, and its tails are those of the product. By the law of published tests, S f'c varies as f'c to the power 0.82,
    so the strength contributes (0.82 × 0.12 × 1.645)² to the squared 90 % range of ln(S f'c), which is 6 % of it, and
    strength and factor together reproduce that range to 1 %. If the strength would make up more than half of the
    squared range of the product, each gets half.
    """

    dispersion: float
    """Standard deviation of ln S for concrete of a given strength. [1]"""
    strength: float
    """Standard deviation of the logarithm of the compressive strength. [ln]"""
    residual: float
    """Scale of a factor on S, independent of the strength. [ln]"""
    degrees_of_freedom: float
    """Degrees of freedom of Student's distribution of the factor on S. [1]"""


def known_strength(
    *, projectile: Projectile, target: Target, resistance: Resistance, strength_scatter: ScatterSource = "law"
) -> tuple[ShotPrediction, StrengthPosterior | None]:
    """Return the predictive distribution of ln S for the next shot, and the posterior of S from shots, if any.

    With shots, the location of the distribution is the logarithm of the posterior median. Without shots it is 0, since
    the distribution is then that of the deviation from the law.

    Parameters
    ----------
    projectile, target, resistance
        Parts of the strike, as for `critical_angle`.
    strength_scatter
        ``"law"``: S scatters like the published tests about their law or, with own tests in the resistance, by their
        posterior. ``"paper_table_1"``: S scatters like the posterior of the paper's four shots, for any strike; the
        caller is responsible for this choice.

    Raises
    ------
    ParameterError
        If no strength factor gives the depth of a shot, or the source is unknown or conflicts with own tests.
    """
    known = get_args(ScatterSource)
    require(
        strength_scatter in known,
        "strength_scatter",
        f"must be one of {', '.join(map(repr, known))}, got {strength_scatter!r}",
    )
    model = resistance.strength_factor
    match model:
        case OwnTests():
            require(strength_scatter == "law", "strength_scatter", "must be 'law' if S follows from own tests")
            posterior = model.posterior(
                projectile=projectile, target=target, inertia_factor=resistance.inertia_factor, crater=resistance.crater
            )
        case ConstantStrengthFactor() | ObliquityPolynomial() | StrengthPowerLaw() | PublishedTests():
            if strength_scatter == "law":
                return predict_shot(np.zeros(0)), None
            posterior = TABLE_1.posterior(projectile=PAPER_PROJECTILE, target=PAPER_TARGET)
        case _:
            assert_never(model)
    return ShotPrediction(math.log(posterior.median), posterior.scale, posterior.degrees_of_freedom), posterior


def scatter_of_strength(
    *, projectile: Projectile, target: Target, resistance: Resistance, strength_scatter: ScatterSource = "law"
) -> StrengthScatter:
    """Return the scatter of S and of the strength; the arguments are those of `known_strength`."""
    known, _ = known_strength(
        projectile=projectile, target=target, resistance=resistance, strength_scatter=strength_scatter
    )
    slope = strength_slope(projectile, target, resistance)
    strength = STRENGTH_DISPERSION
    # The squared 90 % ranges of a normal and a Student's distribution nearly add up; their squared scales do not.
    ratio = tail_ratio(known.degrees_of_freedom)
    total = known.scale * ratio
    if slope != 0.0:
        strength = min(strength, math.sqrt(0.5) * total / abs(slope))
    return StrengthScatter(
        dispersion=known.dispersion,
        strength=strength,
        residual=math.sqrt(total**2 - (slope * strength) ** 2) / ratio,
        degrees_of_freedom=known.degrees_of_freedom,
    )


def strength_slope(projectile: Projectile, target: Target, resistance: Resistance) -> float:
    """Return the derivative d ln(S f'c) / d ln f'c in normal impact. [1]"""
    # A strength at the upper bound gets a backward difference.
    step = STRENGTH_STEP
    if not BOUNDS["target.compressive_strength"].holds(math.exp(step) * target.compressive_strength):
        step = -step
    other = replace(target, compressive_strength=math.exp(step) * target.compressive_strength)
    here, there = (resistance.strength_polynomial(target=each, projectile=projectile)[0] for each in (target, other))
    return 1.0 + math.log(there / here) / step if min(here, there) > 0.0 else 1.0
