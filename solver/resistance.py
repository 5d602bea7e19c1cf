"""Resistance of the target: stress on an element, eq. 1, and the strength-factor models behind it.

The strength factor S scales the static part, ``σ = f (S f'c + B ρ v_n²)``. It is fixed over one run.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar, TypeAlias

from solver.errors import ParameterError
from solver.free_surface import ElasticPlastic, FreeSurface
from solver.target import Target
from solver.validation import require, require_finite, require_positive

FIELD = "resistance.strength_factor"


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantStrengthFactor:
    """The same strength factor for every strike.

    Parameters
    ----------
    value
        S. [1]
    """

    name: ClassVar[str] = "constant"
    value: float

    def __post_init__(self) -> None:
        require_positive(f"{FIELD}.value", self.value)

    def polynomial(self, target: Target) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees, constant first."""
        return (self.value,)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObliquityPolynomial:
    """Polynomial in the initial oblique angle in degrees; the default is eq. 9.

    Parameters
    ----------
    coefficients
        From the constant term upwards. [1, 1/°, 1/°², ...]

    Notes
    -----
    Eq. 9 fits finite element runs from 0° to 45° and is extrapolated beyond.
    """

    name: ClassVar[str] = "obliquity_polynomial"
    fitted_to: ClassVar[float] = math.radians(45.0)
    coefficients: tuple[float, ...] = (8.469, 0.0149, -0.0013)

    def __post_init__(self) -> None:
        require(1 <= len(self.coefficients) <= 10, f"{FIELD}.coefficients", "must hold 1 to 10 numbers")
        for index, coefficient in enumerate(self.coefficients):
            require_finite(f"{FIELD}.coefficients.{index}", coefficient)

    def polynomial(self, target: Target) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees, constant first."""
        return self.coefficients


@dataclass(frozen=True, slots=True, kw_only=True)
class StrengthPowerLaw:
    """Power of the compressive strength in MPa.

    Parameters
    ----------
    coefficient
        82.6 with exponent -0.544 (Frew et al. 1998), 72 with -0.5 (Li and Chen 2003). [1]
    exponent
        [1]
    """

    name: ClassVar[str] = "strength_power_law"
    coefficient: float = 82.6
    exponent: float = -0.544

    def __post_init__(self) -> None:
        require_positive(f"{FIELD}.coefficient", self.coefficient)
        require_finite(f"{FIELD}.exponent", self.exponent)

    def polynomial(self, target: Target) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees: a constant, the same at every angle."""
        return (float(self.coefficient * (target.compressive_strength / 1e6) ** self.exponent),)


StrengthFactor: TypeAlias = ConstantStrengthFactor | ObliquityPolynomial | StrengthPowerLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class Resistance:
    """How the target resists.

    Parameters
    ----------
    strength_factor
        Model of S; eq. 9 unless given.
    inertia_factor
        B. [1]
    free_surface
        Model of the decay near the face.
    """

    strength_factor: StrengthFactor = field(default_factory=ObliquityPolynomial)
    inertia_factor: float = 1.0
    free_surface: FreeSurface = field(default_factory=ElasticPlastic)

    def __post_init__(self) -> None:
        require(
            math.isfinite(self.inertia_factor) and self.inertia_factor >= 0.0,
            "resistance.inertia_factor",
            f"must be at least 0, got {self.inertia_factor:g}",
        )


def strength_factor(*, resistance: Resistance, oblique_angle: float, target: Target) -> float:
    """Strength factor S of one strike.

    Parameters
    ----------
    resistance
        Holds the model of S.
    oblique_angle
        Initial, from the inward normal. [rad]
    target
        The concrete.

    Returns
    -------
    float
        [1]

    Raises
    ------
    ParameterError
        If the model gives a value that is not above zero at this angle.
    """
    degrees, value = abs(math.degrees(oblique_angle)), 0.0
    for coefficient in reversed(resistance.strength_factor.polynomial(target)):
        value = value * degrees + coefficient
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(
            FIELD,
            f"must be greater than 0 at the initial oblique angle of {math.degrees(oblique_angle):g}°, "
            f"but the model gives {value:g}",
        )
    return value
