"""Resistance of the target: stress on an element, eq. 1, and the strength-factor models behind it.

The strength factor S scales the static part, ``σ = f (S f'c + B ρ v_n²)``. It is fixed over one run. In normal impact
with a crater the depth follows in closed form.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np

from solver.arrays import gauss_rule
from solver.checks import ParameterError, require, require_finite, require_kind, require_number, require_positive
from solver.free_surface import ElasticPlastic, FreeSurface
from solver.projectile import GAUSS_POINTS, Projectile
from solver.target import Crater, ShearPlug, Target

FIELD = "resistance.strength_factor"
ROUNDING = 1e-6
"""Tolerance on correlations, for a covariance that was written with some digits."""
STRENGTH_CHECKS = 801
"""Angles of a range at which the strength factor is looked at."""
EQUATION_9_COEFFICIENTS = (8.469, 0.0149, -0.0013)
"""Eq. 9, fitted to an 80 mm projectile in concrete of 39 MPa. [1, 1/°, 1/°²]"""

ObliquityShape: TypeAlias = Literal["constant", "equation_9"]
"""How a law of strength and diameter varies with the oblique angle: not at all, or as S(θ)/S(0) of eq. 9."""


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

    def polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
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
        Covariance of the coefficients, if known: a search then gives the standard error of its angle.
        [products of their units]

    Notes
    -----
    Eq. 9 fits finite element runs from 0° to 45° and is extrapolated beyond.
    """

    name: ClassVar[str] = "obliquity_polynomial"
    fitted_to: ClassVar[float] = math.radians(45.0)
    coefficients: tuple[float, ...] = EQUATION_9_COEFFICIENTS
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

    def polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees, constant first."""
        return self.coefficients


def positive_up_to(coefficients: Sequence[float], lower: float, upper: float) -> float:
    """The upper end of a range of oblique angles, or the angle below it up to which a polynomial S is above 0. [rad]"""
    angles = np.linspace(lower, upper, STRENGTH_CHECKS)
    values = np.polynomial.polynomial.polyval(np.abs(np.degrees(angles)), coefficients)
    beyond = np.flatnonzero(~(values > 0.0))
    return float(angles[max(beyond[0] - 1, 0)]) if beyond.size else upper


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
    """Power law of the compressive strength and, if wanted, of the diameter of the projectile.

    Parameters
    ----------
    coefficient
        82.6 with exponent -0.544 (Frew et al. 1998), 72 with -0.5 (Li and Chen 2003). [1]
    exponent
        Exponent of the strength. [1]
    reference_strength
        [Pa]
    diameter_exponent
        [1]
    reference_diameter
        [m]
    obliquity_shape
        ``"equation_9"`` multiplies by S(θ)/S(0) of eq. 9.

    Notes
    -----
    ``S = coefficient (f'c / reference_strength)^exponent (d / reference_diameter)^diameter_exponent``
    """

    name: ClassVar[str] = "strength_power_law"
    coefficient: float = 82.6
    exponent: float = -0.544
    reference_strength: float = 1e6
    diameter_exponent: float = 0.0
    reference_diameter: float = 0.0762
    obliquity_shape: ObliquityShape = "constant"

    def __post_init__(self) -> None:
        require_positive(f"{FIELD}.coefficient", self.coefficient)
        require_finite(f"{FIELD}.exponent", self.exponent)
        require_positive(f"{FIELD}.reference_strength", self.reference_strength)
        require_finite(f"{FIELD}.diameter_exponent", self.diameter_exponent)
        require_positive(f"{FIELD}.reference_diameter", self.reference_diameter)
        _check_shape(self.obliquity_shape)

    def polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees, constant first."""
        try:
            by_strength = (target.compressive_strength / self.reference_strength) ** self.exponent
            by_diameter = (projectile.diameter / self.reference_diameter) ** self.diameter_exponent
        except OverflowError:
            return (math.inf,)
        value = float(self.coefficient * by_strength * by_diameter)
        if self.obliquity_shape == "constant":
            return (value,)
        return tuple(value * (each / EQUATION_9_COEFFICIENTS[0]) for each in EQUATION_9_COEFFICIENTS)


def _check_shape(shape: str) -> None:
    known = get_args(ObliquityShape)
    require(shape in known, f"{FIELD}.obliquity_shape", f"must be one of {', '.join(map(repr, known))}, got {shape!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedTests:
    """Power law of strength and diameter fitted to published penetration tests.

    Parameters
    ----------
    obliquity_shape
        The tests are normal impacts. ``"equation_9"`` lets S vary with the oblique angle as S(θ)/S(0) of eq. 9,
        ``"constant"`` keeps it.

    Notes
    -----
    ``S = 6.55 (f'c / 39 MPa)^-0.31 (d / 76.2 mm)^-0.42``, fitted to 45 tests below 900 m/s of Forrestal et al. (1994,
    2003) and Frew et al. (1998, 2006). Predicted over measured depth of 41 tests kept aside is 1.02, with a coefficient
    of variation of 0.16 (0.12 below 900 m/s). The S that fits each of the 45 tests exactly is 1.01 times that of the
    law, with a coefficient of variation of 0.17. In these tests large projectiles went with large targets: part of what
    the law ascribes to the diameter may be the size of the target.
    """

    name: ClassVar[str] = "published_tests"
    law: ClassVar[StrengthPowerLaw] = StrengthPowerLaw(
        coefficient=6.55, exponent=-0.31, reference_strength=39e6, diameter_exponent=-0.42, reference_diameter=0.0762
    )
    coefficient_of_variation: ClassVar[float] = 0.16
    """Scatter of predicted over measured depth, for tests that the law was not fitted to. [1]"""
    compressive_strengths: ClassVar[tuple[float, float]] = (23e6, 108.3e6)
    """Least and greatest of the tests. [Pa]"""
    diameters: ClassVar[tuple[float, float]] = (0.0203, 0.0762)
    """Least and greatest of the tests. [m]"""
    velocities: ClassVar[tuple[float, float]] = (139.3, 815.0)
    """Least and greatest of the tests. [m/s]"""
    obliquity_shape: ObliquityShape = "equation_9"

    def __post_init__(self) -> None:
        _check_shape(self.obliquity_shape)

    def polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
        """S in powers of the oblique angle in degrees, constant first."""
        return replace(self.law, obliquity_shape=self.obliquity_shape).polynomial(target=target, projectile=projectile)


StrengthFactor: TypeAlias = ConstantStrengthFactor | ObliquityPolynomial | StrengthPowerLaw | PublishedTests


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
        Model of the decay near the faces.
    crater
        A front crater, in which the resistance builds up; none unless given.
    rear_plug
        A plug that shears out of the rear of a wall; none unless given.
    """

    strength_factor: StrengthFactor = field(default_factory=ObliquityPolynomial)
    inertia_factor: float = 1.0
    free_surface: FreeSurface = field(default_factory=ElasticPlastic)
    crater: Crater | None = None
    rear_plug: ShearPlug | None = None

    def __post_init__(self) -> None:
        require_kind(FIELD, self.strength_factor, StrengthFactor)
        require_kind("resistance.free_surface", self.free_surface, FreeSurface)
        require_number("resistance.inertia_factor", self.inertia_factor)
        require(
            math.isfinite(self.inertia_factor) and self.inertia_factor >= 0.0,
            "resistance.inertia_factor",
            f"must be at least 0, got {self.inertia_factor:g}",
        )


EQUATION_9 = Resistance()
"""The resistance of the source paper, used unless another is given."""


def strength_factor(*, resistance: Resistance, oblique_angle: float, target: Target, projectile: Projectile) -> float:
    """Strength factor S of one strike.

    Parameters
    ----------
    resistance
        Holds the model of S.
    oblique_angle
        Initial, from the inward normal. [rad]
    target, projectile
        The concrete, and what strikes it: some models go by its strength and by the diameter.

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
    for coefficient in reversed(resistance.strength_factor.polynomial(target=target, projectile=projectile)):
        value = value * degrees + coefficient
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(
            FIELD,
            f"must be greater than 0 at the initial oblique angle of {math.degrees(oblique_angle):g}°, "
            f"but the model gives {value:g}",
        )
    return value


def nose_factor(projectile: Projectile) -> float:
    """N: resistance of the nose to inertia over that of a flat face.

    Notes
    -----
    ``N = (2/a²) ∫ r sin²α dr`` over the nose, by Gauss quadrature; for an ogive (8ψ - 1) / (24ψ²).
    """
    t, w = gauss_rule(GAUSS_POINTS).T
    total = 0.0
    for piece in projectile.nose.outline(projectile.radius):
        _, r, sine, _ = piece.at(t)
        total += piece.length * float((r * sine**3) @ w)
    return 2.0 * total / projectile.radius**2


def closed_form_depth(*, projectile: Projectile, target: Target, velocity: float, strength_factor: float) -> float:
    """Depth of normal impact with a crater of two diameters, in closed form.

    Parameters
    ----------
    projectile, target
        What strikes and what is struck.
    velocity
        At first contact. [m/s]
    strength_factor
        S. [1]

    Returns
    -------
    float
        Depth of the nose tip at rest. [m]

    Raises
    ------
    ParameterError
        If the velocity or the strength factor is not greater than 0.

    Notes
    -----
    Forrestal, Altman, Cargile and Hanchak (1994): the resistance is ``c z`` in the crater, which is 4a deep, and
    ``π a² (S f'c + N ρ V²)`` beyond, so

        z = 4a + m / (2π a² N ρ) ln(1 + N ρ V₁² / (S f'c)),  V₁² = (m V² - 4π a³ S f'c) / (m + 4π a³ N ρ)

    with the speed V₁ at the end of the crater. A projectile too slow to get there stops where the spring has taken up
    its energy, ``z = V sqrt(m/c)`` with c of V₁ = 0, π a S f'c / 4; at the limit both are 4a. The source has ogives
    only; for other noses N is the same integral over their outline.
    """
    require_positive("velocity", velocity)
    require_positive("strength_factor", strength_factor)
    m, a, static = projectile.mass, projectile.radius, strength_factor * target.compressive_strength
    inertia = nose_factor(projectile) * target.density
    excess = m * velocity**2 - 4.0 * math.pi * a**3 * static
    if excess <= 0.0:
        return velocity * math.sqrt(4.0 * m / (math.pi * a * static))
    after_crater = excess / (m + 4.0 * math.pi * a**3 * inertia)
    return 4.0 * a + m / (2.0 * math.pi * a**2 * inertia) * float(np.log1p(inertia * after_crater / static))
