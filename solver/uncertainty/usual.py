"""Usual scatter of the inputs of a strike, of its strength factor, and of the theory of its decay."""

import math
from dataclasses import replace
from typing import assert_never

from solver.free_surface import ElasticPlastic, MohrCoulomb
from solver.projectile import Projectile
from solver.resistance import (
    EQUATION_9_COEFFICIENTS,
    HELD_FROM,
    PLAUSIBLE_FACTORS,
    ConstantStrengthFactor,
    ObliquityPolynomial,
    OwnTests,
    PublishedTests,
    Resistance,
    StrengthPowerLaw,
    held_from,
    usual_unless_given,
)
from solver.strength_scatter import ScatterSource, StrengthScatter, scatter_of_strength
from solver.target import Target
from solver.uncertainty.distributions import Discrete, Lognormal, LogStudentT, Normal
from solver.uncertainty.next_shot import RESIDUAL
from solver.uncertainty.sampling import Uncertain
from solver.uncertainty.strikes import THEORY

# The coefficients of variation are rough estimates.
VELOCITY, DENSITY, MASS = 0.02, 0.02, 0.005
"""Coefficients of variation of velocity, density and mass. [1]"""
# Dispersions are not known to more decimals, and longer numbers would only clutter the inputs that users see.
DIGITS = 4
"""Number of decimals to which dispersions and scales are rounded."""
# If S itself is outside the plausible range, its distribution must not be truncated close to its median. A factor of
# two is arbitrary.
WITHIN = 0.5, 2.0
"""Range of the factor on S that truncation never removes. [1]"""
# The standard deviation is a rough estimate.
ATTACK = math.radians(1.0)
"""Standard deviation of the angle of attack. [rad]"""
THEORY_LAWS: tuple[type[ElasticPlastic | MohrCoulomb], ...] = (ElasticPlastic, MohrCoulomb)
"""Decay laws from which the theory is selected if it is an uncertain input."""
# The weights are a judgement; with equal weights the ends of the 90 % range of the paper's strike are about 0.8°
# lower. Elastic-plastic decay with eq. 9 gives the paper's angle. Mohr-Coulomb decay follows finite element motions
# more closely, and its S(θ) was fitted to them. The law without decay neglects the free surface and serves for
# comparison only.
THEORIES = (0.8, 0.2)
"""Weights of `THEORY_LAWS`. [1]"""


def has_own_law(resistance: Resistance | None) -> bool:
    """Return whether the user has chosen a decay law or S; the theory is then not an uncertain input by default.

    Notes
    -----
    This is true for any decay law except the elastic-plastic one, and for a value or coefficients of S that the user
    has given. With elastic-plastic decay it is false for published tests, the user's own shots, eq. 9, and the
    published power law.
    """
    if resistance is None:
        return False
    if not isinstance(resistance.free_surface, ElasticPlastic):
        return True
    model = resistance.strength_factor
    match model:
        case ConstantStrengthFactor():
            return True
        case ObliquityPolynomial():
            return tuple(model.coefficients) != EQUATION_9_COEFFICIENTS or held_from(model) != HELD_FROM
        case StrengthPowerLaw():
            return replace(model, obliquity_shape=StrengthPowerLaw().obliquity_shape) != StrengthPowerLaw()
        case PublishedTests() | OwnTests():
            return False
        case _:
            assert_never(model)


def usual_scatter(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    angle_of_attack: float = 0.0,
    resistance: Resistance | None = None,
    theories: bool | None = None,
    strength_scatter: ScatterSource = "law",
) -> tuple[Uncertain, ...]:
    """Return the inputs that usually scatter in a strike, for use in `critical_angle_uncertainty`.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, resistance
        As for `critical_angle`. [SI, rad]
    theories
        Whether to include the theory of the decay among the inputs. By default it is included unless `has_own_law` is
        true.
    strength_scatter
        Tests from which the scatter of S is taken, see `known_strength`.

    Returns
    -------
    tuple of Uncertain
        Speed, strength, density, mass, angle of attack, a factor on S and, if it is included, the theory of the decay.

    Raises
    ------
    ParameterError
        If no strength factor gives the depth of one of the user's own shots.

    Notes
    -----
    The factor on S has the scatter of the law, or of shots into the same concrete, except for the part that the
    strength explains, see `StrengthScatter`. Its distribution has heavy tails, and is truncated where S would be
    outside `PLAUSIBLE_FACTORS`, but never between half and twice its median. Without truncation, about one sample in a
    hundred would have an S that no concrete has.
    """
    resistance = usual_unless_given(resistance)
    factor = resistance.strength_polynomial(target=target, projectile=projectile)[0]
    scatter = scatter_of_strength(
        projectile=projectile, target=target, resistance=resistance, strength_scatter=strength_scatter
    )
    inputs = (
        Uncertain("impact.velocity", Normal(mean=velocity, coefficient_of_variation=VELOCITY)),
        Uncertain(
            "target.compressive_strength",
            Lognormal(median=target.compressive_strength, dispersion=round(scatter.strength, DIGITS)),
        ),
        Uncertain("target.density", Normal(mean=target.density, coefficient_of_variation=DENSITY)),
        Uncertain("projectile.mass", Normal(mean=projectile.mass, coefficient_of_variation=MASS)),
        Uncertain("impact.angle_of_attack", Normal(mean=angle_of_attack, standard_deviation=ATTACK)),
        Uncertain(RESIDUAL, _residual(scatter, factor)),
    )
    if has_own_law(resistance) if theories is None else not theories:
        return inputs
    names = tuple(law.name for law in THEORY_LAWS)
    return (*inputs, Uncertain(THEORY, Discrete(values=names, weights=THEORIES)))


def _residual(scatter: StrengthScatter, factor: float) -> LogStudentT:
    """Return the distribution of the factor on S, given the S of the law in normal impact. [1]"""
    lower, upper = (each / factor if factor > 0.0 else 1.0 for each in PLAUSIBLE_FACTORS)
    return LogStudentT(
        median=1.0,
        scale=round(scatter.residual, DIGITS),
        degrees_of_freedom=scatter.degrees_of_freedom,
        lower=round(min(lower, WITHIN[0]), DIGITS),
        upper=round(max(upper, WITHIN[1]), DIGITS),
    )
