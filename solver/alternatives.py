"""One case under every decay law and every strength law on offer: how much the choice of model decides."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from solver.free_surface import ElasticPlastic, MohrCoulomb, NoFreeSurface
from solver.resistance import EQUATION_9, ObliquityPolynomial, PublishedTests, Resistance, StrengthPowerLaw
from solver.validation import RicochetError

DECAY_LAWS = {
    ElasticPlastic: "decay: theory",
    MohrCoulomb: "decay: theory, nearest to finite element motions",
    NoFreeSurface: "no decay",
}
"""Decay models, with what each was fitted to."""
STRENGTH_LAWS = {
    ObliquityPolynomial: "S: finite elements, 80 mm into 39 MPa, 0° to 45°",
    PublishedTests: "S: 45 tests at 0°, 20 to 76 mm, 23 to 108 MPa, over the angle as eq. 9",
    StrengthPowerLaw: "S: tests at 0° of Frew et al. (1998), over the angle constant",
}
"""Models of the strength factor with their default constants, with what each was fitted to."""

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Alternative(Generic[Answer]):
    """Answer to a case under one choice of the laws."""

    resistance: Resistance
    answer: Answer | RicochetError
    """The error, if the case cannot be computed with these laws."""

    @property
    def free_surface(self) -> str:
        """Name of the decay model."""
        return self.resistance.free_surface.name

    @property
    def strength_factor(self) -> str:
        """Name of the model of the strength factor."""
        return self.resistance.strength_factor.name

    @property
    def fitted_to(self) -> str:
        """What the laws were fitted to."""
        return fitted_to(self.resistance)


def alternatives(
    function: Callable[..., Answer], *, resistance: Resistance | None = None, **case: Any
) -> tuple[Alternative[Answer], ...]:
    """Answers to one case under each decay law with each strength law.

    Parameters
    ----------
    function
        `critical_angle` or `simulate`.
    resistance
        As in the case; only its inertia factor, and whether the decay includes inertia, are kept.
    **case
        The other arguments of the function.

    Returns
    -------
    tuple of Alternative
        Decay laws in the order elastic-plastic, Mohr-Coulomb, none; with each the strength laws of eq. 9, of the
        published tests, and of the strength alone.

    Examples
    --------
    >>> for each in alternatives(critical_angle, projectile=projectile, target=target, velocity=238.0):
    ...     print(each.free_surface, each.strength_factor, each.answer.angle, each.fitted_to)
    """
    return tuple(
        Alternative(choice, _attempt(function, case | {"resistance": choice}))
        for choice in alternative_resistances(resistance or EQUATION_9)
    )


def alternative_resistances(resistance: Resistance = EQUATION_9) -> tuple[Resistance, ...]:
    """Return each decay law with each strength law, with the inertia of the given resistance."""
    inertia = getattr(resistance.free_surface, "inertia", False)
    decays = (ElasticPlastic(inertia=inertia), MohrCoulomb(inertia=inertia), NoFreeSurface())
    return tuple(
        replace(resistance, free_surface=decay, strength_factor=strength())
        for decay in decays
        for strength in STRENGTH_LAWS
    )


def fitted_to(resistance: Resistance) -> str:
    """Return what the laws of one of these resistances were fitted to."""
    return f"{STRENGTH_LAWS[type(resistance.strength_factor)]}; {DECAY_LAWS[type(resistance.free_surface)]}"


def _attempt(function: Callable[..., Answer], case: dict[str, Any]) -> Answer | RicochetError:
    try:
        return function(**case)
    except RicochetError as error:
        return error
