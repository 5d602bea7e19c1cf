"""The usual scatter of a strike: that of its inputs, of the strength factor, and of the theory of the decay."""

import math
from dataclasses import replace

from solver.free_surface import ElasticPlastic, MohrCoulomb
from solver.projectile import Projectile
from solver.resistance import (
    EQUATION_9_COEFFICIENTS,
    HELD_FROM,
    PLAUSIBLE_FACTORS,
    ConstantStrengthFactor,
    ObliquityPolynomial,
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

VELOCITY, DENSITY, MASS = 0.02, 0.02, 0.005
"""Coefficients of variation. [1]"""
DIGITS = 4
"""Of dispersions and scales: no more are known."""
WITHIN = 0.5, 2.0
"""Factors on S that are never cut off, though S itself is beyond those of concretes. [1]"""
ATTACK = math.radians(1.0)
"""Standard deviation of the angle of attack. [rad]"""
THEORY_LAWS: tuple[type[ElasticPlastic | MohrCoulomb], ...] = (ElasticPlastic, MohrCoulomb)
THEORIES = (0.8, 0.2)
"""Weights of these decay laws, a judgement: the first with eq. 9 gives the paper's angle, the second follows the
motions of finite elements more closely and has the S(θ) fitted to these. No decay at all is not a theory and is not
among them."""


def has_own_law(resistance: Resistance | None) -> bool:
    """Return whether a law is chosen that is not among those of the theories, so that the verdict is on that law.

    Notes
    -----
    It is so with another decay than the elastic-plastic one, and with a value or coefficients of S of one's own.
    Published tests, shots of one's own, eq. 9 and the published power law leave the theory of the decay open.
    """
    if resistance is None:
        return False
    model = resistance.strength_factor
    if not isinstance(resistance.free_surface, ElasticPlastic) or isinstance(model, ConstantStrengthFactor):
        return True
    if isinstance(model, ObliquityPolynomial):
        return tuple(model.coefficients) != EQUATION_9_COEFFICIENTS or held_from(model) != HELD_FROM
    return isinstance(model, StrengthPowerLaw) and (
        replace(model, obliquity_shape=StrengthPowerLaw().obliquity_shape) != StrengthPowerLaw()
    )


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
    """Return what usually scatters of a strike, as `critical_angle_uncertainty` takes it.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, resistance
        As for `critical_angle`. [SI, rad]
    theories
        Whether the theory of the decay scatters too; unless given, it does where no law of one's own is chosen.
    strength_scatter
        Tests from which the scatter of S comes, see `known_strength`.

    Returns
    -------
    tuple of Uncertain
        Speed, strength, density, mass, angle of attack, a factor on S and, last, the theory of the decay.

    Raises
    ------
    ParameterError
        If no strength factor gives the depth of one's own shot.

    Notes
    -----
    The factor on S has the scatter of the law, or of the shots into the very concrete, less what the strength explains
    of it: see `StrengthScatter`. Its tails are heavy, so it is cut off where S would be beyond `PLAUSIBLE_FACTORS`:
    without, a sample in a thousand would have an S of no concrete.
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
    """Return the distribution of the factor on S, where S is so much in normal impact. [1]"""
    lower, upper = (each / factor if factor > 0.0 else 1.0 for each in PLAUSIBLE_FACTORS)
    return LogStudentT(
        median=1.0,
        scale=round(scatter.residual, DIGITS),
        degrees_of_freedom=scatter.degrees_of_freedom,
        lower=round(min(lower, WITHIN[0]), DIGITS),
        upper=round(max(upper, WITHIN[1]), DIGITS),
    )
