"""Resistance of the target: stress on an element, eq. 1, and the strength-factor models behind it.

The strength factor S scales the static part, ``σ = f (S f'c + B ρ v_n²)``. It is fixed over one run.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar, TypeAlias

import numpy as np

from solver.errors import ParameterError
from solver.free_surface import ElasticPlastic, FreeSurface
from solver.target import Target
from solver.validation import require, require_finite, require_positive

FIELD = "resistance.strength_factor"
ROUNDING = 1e-6
"""Tolerance on correlations, for a covariance that was written with some digits."""
STRENGTH_CHECKS = 801
"""Angles of a range at which the strength factor is looked at."""


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
    covariance
        Of the coefficients, if known: a search then tells the standard error of its angle. [products of their units]

    Notes
    -----
    Eq. 9 fits finite element runs from 0° to 45° and is extrapolated beyond.
    """

    name: ClassVar[str] = "obliquity_polynomial"
    fitted_to: ClassVar[float] = math.radians(45.0)
    coefficients: tuple[float, ...] = (8.469, 0.0149, -0.0013)
    covariance: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        require(1 <= len(self.coefficients) <= 10, f"{FIELD}.coefficients", "must hold 1 to 10 numbers")
        for index, coefficient in enumerate(self.coefficients):
            require_finite(f"{FIELD}.coefficients.{index}", coefficient)
        if self.covariance is not None:
            _check_covariance(self.covariance, len(self.coefficients))

    def standard_error(self, oblique_angle: float) -> float:
        """Standard error of S at an oblique angle, from the covariance. [1]"""
        if self.covariance is None:
            raise ParameterError(f"{FIELD}.covariance", "must be given for a standard error")
        powers = abs(math.degrees(oblique_angle)) ** np.arange(len(self.coefficients))
        return math.sqrt(max(0.0, float(powers @ np.array(self.covariance) @ powers)))

    def positive_up_to(self, lower: float, upper: float) -> float:
        """The upper end of a range of oblique angles, or the angle below it up to which S is above zero. [rad]"""
        angles = np.linspace(lower, upper, STRENGTH_CHECKS)
        values = np.polynomial.polynomial.polyval(np.abs(np.degrees(angles)), self.coefficients)
        beyond = np.flatnonzero(~(values > 0.0))
        return float(angles[max(beyond[0] - 1, 0)]) if beyond.size else upper

    def polynomial(self, target: Target) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees, constant first."""
        return self.coefficients


def _check_covariance(covariance: tuple[tuple[float, ...], ...], size: int) -> None:
    """Refuse what is no covariance of so many coefficients."""
    name = f"{FIELD}.covariance"
    require(len(covariance) == size, name, f"must have a row for each of the {size} coefficients")
    for index, row in enumerate(covariance):
        require(len(row) == size, f"{name}.{index}", f"must hold {size} numbers, got {len(row)}")
        for column, value in enumerate(row):
            require_finite(f"{name}.{index}.{column}", value)
    matrix = np.array(covariance)
    variances = np.diagonal(matrix)
    require(bool(np.all(variances >= 0.0)), name, "must have no variance below 0")
    # In units of the standard errors, or the small ones of high powers would pass unseen.
    errors = np.where(variances > 0.0, np.sqrt(variances), 1.0)
    correlation = matrix / errors[:, None] / errors
    require(bool(np.allclose(correlation, correlation.T, rtol=0.0, atol=ROUNDING)), name, "must be symmetric")
    least = float(np.linalg.eigvalsh(correlation).min())
    require(least >= -ROUNDING, name, "must be positive semidefinite, as every covariance is")


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


EQUATION_9 = Resistance()
"""The resistance of the source paper, used unless another is given."""


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
