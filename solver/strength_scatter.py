"""How sure the strength factor of a strike is: its scatter by the law in use, and how strength shares in it."""

import math
from dataclasses import dataclass, replace

from solver.checks import BOUNDS
from solver.projectile import Projectile
from solver.resistance import (
    EQUATION_9_COEFFICIENTS,
    ObliquityPolynomial,
    OwnTests,
    PublishedTests,
    Resistance,
    Shot,
    StrengthPosterior,
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
"""The shots behind eq. 9: they are own tests of the concrete and the nose of the paper."""
STRENGTH_DISPERSION = 0.12
"""Usual scatter of the compressive strength about the one stated. [ln]"""
STRENGTH_STEP = 0.01
"""Step of ln f'c for the slope of ln(S f'c). [ln]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class StrengthScatter:
    """Scatter of S about its law, with that of the strength apart from it.

    Notes
    -----
    Depths of tests give the product S f'c, and the laws of S were fitted to stated strengths. So what is known of S by
    tests, `dispersion`, holds for the product at the stated strength, and the scatter of the strength about the stated
    one is part of it: of 0.326² by the law, (0.82 × 0.12)², 9 %. What is left, `residual`, is that of S beside a
    strength that scatters too; where tests leave less than the strength alone would give, each has half the variance.
    """

    dispersion: float
    """Of S at the stated strength. [ln]"""
    between: float
    """Part of it that shots of one's own reduce. [ln]"""
    strength: float
    """Of the compressive strength. [ln]"""
    residual: float
    """Of a factor on S, independent of the strength. [ln]"""


def own_tests_behind(*, projectile: Projectile, target: Target, resistance: Resistance) -> OwnTests | None:
    """Return the shots into the very concrete that S rests on: own tests, or Table 1 with eq. 9; None without."""
    model = resistance.strength_factor
    if isinstance(model, OwnTests):
        return model
    by_equation_9 = isinstance(model, ObliquityPolynomial) and tuple(model.coefficients) == EQUATION_9_COEFFICIENTS
    same = (projectile.nose, projectile.diameter, target.compressive_strength, target.density) == (
        PAPER_PROJECTILE.nose,
        PAPER_PROJECTILE.diameter,
        PAPER_TARGET.compressive_strength,
        PAPER_TARGET.density,
    )
    return TABLE_1 if by_equation_9 and same else None


def known_strength(
    *, projectile: Projectile, target: Target, resistance: Resistance
) -> tuple[float, StrengthPosterior | None]:
    """Return the dispersion of S of the next shot, and what shots into the very concrete say of it, if there are any.

    Parameters
    ----------
    projectile, target, resistance
        As for `critical_angle`.

    Raises
    ------
    ParameterError
        If no strength factor gives the depth of a shot.
    """
    tests = own_tests_behind(projectile=projectile, target=target, resistance=resistance)
    if tests is None:
        return math.hypot(PublishedTests.between_series, PublishedTests.within_series), None
    posterior = tests.posterior(
        projectile=projectile, target=target, inertia_factor=resistance.inertia_factor, crater=resistance.crater
    )
    return posterior.dispersion, posterior


def strength_scatter(*, projectile: Projectile, target: Target, resistance: Resistance) -> StrengthScatter:
    """Return how S scatters beside the strength; for the arguments see `known_strength`."""
    dispersion, _ = known_strength(projectile=projectile, target=target, resistance=resistance)
    slope = strength_slope(projectile, target, resistance)
    strength = STRENGTH_DISPERSION
    if slope != 0.0:
        strength = min(strength, math.sqrt(0.5) * dispersion / abs(slope))
    return StrengthScatter(
        dispersion=dispersion,
        between=math.sqrt(max(dispersion**2 - PublishedTests.within_series**2, 0.0)),
        strength=strength,
        residual=math.sqrt(dispersion**2 - (slope * strength) ** 2),
    )


def strength_slope(projectile: Projectile, target: Target, resistance: Resistance) -> float:
    """Return d ln(S f'c) / d ln f'c in normal impact."""
    step = STRENGTH_STEP
    if not BOUNDS["target.compressive_strength"].holds(math.exp(step) * target.compressive_strength):
        step = -step
    other = replace(target, compressive_strength=math.exp(step) * target.compressive_strength)
    here, there = (resistance.strength_polynomial(target=each, projectile=projectile)[0] for each in (target, other))
    return 1.0 + math.log(there / here) / step if min(here, there) > 0.0 else 1.0
