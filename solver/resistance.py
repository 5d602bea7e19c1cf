"""Resistance of the target: the stress on an element (eq. 1) and the laws of the strength factor S.

The strength factor scales the static part of the stress, ``σ = f (S f'c + B ρ v_n²)``, and is constant during a run.
For normal impact with a crater there is a closed form for the depth.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import ClassVar, Literal, TypeAlias, assert_never, get_args

import numpy as np

from solver.arrays import FloatArray, gauss_rule
from solver.checks import (
    ParameterError,
    plain,
    require,
    require_bounds,
    require_finite,
    require_kind,
    require_number,
    require_positive,
    rows_of,
)
from solver.free_surface import ElasticPlastic, FreeSurface
from solver.projectile import GAUSS_POINTS, Profile, Projectile
from solver.target import MOST_PLUG, Crater, ShearPlug, Target
from solver.units import Amount, number

FIELD = "resistance.strength_factor"
"""Dotted name of the strength factor in errors."""
# A covariance that is given with six or seven digits is symmetric and positive semidefinite to about this tolerance.
ROUNDING = 1e-6
"""Tolerance of the checks that a correlation matrix is symmetric and positive semidefinite. [1]"""
# With this number of points, the trapezoidal rule gives an S within `PLAUSIBLE_FACTORS` with an error of at most 1e-5.
PATH_POINTS = 401
"""Number of points on each smooth part of the path on which the nose enters the target."""
# In the default range of 80° the angles are a tenth of a degree apart, which is close enough for the end of a search.
STRENGTH_CHECKS = 801
"""Number of angles at which the sign of the strength factor is checked."""
EQUATION_9_COEFFICIENTS = (8.469, 0.0149, -0.0013)
"""Coefficients of eq. 9, fitted to an 80 mm projectile in concrete of 39 MPa. [1, 1/°, 1/°²]"""

# The search range of the paper ends at 60°. Extrapolated beyond it, the parabola falls to zero at 86.6°, and bodies
# that move nearly along the face would meet hardly any resistance.
HELD_FROM = math.radians(60.0)
"""Oblique angle from which S by eq. 9 is held constant. [rad]"""
NOT_HELD = math.pi / 2.0
"""Value of `held_from` for laws that are never held constant, since no strike reaches this angle. [rad]"""

ObliquityShape: TypeAlias = Literal["constant", "equation_9", "finite_elements"]
"""Dependence of S on the oblique angle: none, S(θ)/S(0) of eq. 9, or S(θ)/S(0) fitted to finite element motions with
the decay law in use."""
# Each shape is a cubic fitted to the S of 11 oblique and 6 normal finite element runs on two meshes. The S of a run is
# fitted to its motion up to the greatest depth of the tip. A quadratic would leave twice the misfit with Mohr-Coulomb
# decay, whose S has a minimum near 48°.
FINITE_ELEMENT_SHAPES: Mapping[str, tuple[float, ...]] = {
    "elastic_plastic": (1.0, 0.003176, -0.0004476, 4.425e-06),
    "mohr_coulomb": (1.0, 0.009102, -0.001073, 1.357e-05),
    "none": (1.0, -0.01498, 0.0004548, -3.918e-06),
}
"""Coefficients of S(θ)/S(0) for finite element motions, by decay law. [1, 1/°, 1/°², 1/°³]"""
FINITE_ELEMENTS_TO = math.radians(55.0)
"""Largest oblique angle of the finite element runs, from which S(θ) is held constant. [rad]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantStrengthFactor:
    """Strength factor that is the same for every strike.

    Parameters
    ----------
    value
        Strength factor; most measured values lie between 5 and 25. [1]
    """

    name: ClassVar[str] = "constant"
    value: float

    def __post_init__(self) -> None:
        require_positive(f"{FIELD}.value", self.value)

    def polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
        """Return the coefficients of S in powers of the oblique angle in degrees, constant first."""
        return (self.value,)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObliquityPolynomial:
    """Polynomial in the initial oblique angle in degrees; the default is eq. 9.

    Parameters
    ----------
    coefficients
        Coefficients from the constant term upwards. [1, 1/°, 1/°², ...]
    covariance
        Covariance of the coefficients, if known; a search then gives the standard error of its angle. [products of
        their units]
    held_from
        Oblique angle from which S is held constant. The default is 60° for the coefficients of eq. 9, even if they are
        given explicitly, and 90°, which means never, for others. With 0, S is constant. [rad]

    Notes
    -----
    Eq. 9 fits finite element runs from 0° to 45° and is extrapolated up to 60°, where S is 4.68.
    """

    name: ClassVar[str] = "obliquity_polynomial"
    fitted_to: ClassVar[float] = math.radians(45.0)
    coefficients: tuple[float, ...] = EQUATION_9_COEFFICIENTS
    covariance: tuple[tuple[float, ...], ...] | None = None
    held_from: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", tuple(plain(self.coefficients)))
        # A fit may be of order nine, the `HIGHEST_ORDER` of the calibration.
        require(1 <= len(self.coefficients) <= 10, f"{FIELD}.coefficients", "must hold 1 to 10 numbers")
        for index, coefficient in enumerate(self.coefficients):
            require_finite(f"{FIELD}.coefficients.{index}", coefficient)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", tuple(tuple(row) for row in plain(self.covariance)))
            _check_covariance(self.covariance, len(self.coefficients))
        if self.held_from is not None:
            require_finite(f"{FIELD}.held_from", self.held_from)
            # The margin allows for the conversion between degrees and radians.
            degrees = math.degrees(self.held_from)
            require(0.0 <= degrees <= 90.0 + 1e-9, f"{FIELD}.held_from", f"must be 0° to 90°, got {degrees:g}°")

    def standard_error(self, oblique_angle: float) -> float:
        """Return the standard error of S at an oblique angle, from the covariance. [1]

        Raises
        ------
        ParameterError
            If the law has no covariance.
        """
        if self.covariance is None:
            raise ParameterError(f"{FIELD}.covariance", "must be given for a standard error")
        # S is linear in the coefficients, so this error propagation is exact. Rounding may leave a variance just below
        # zero.
        powers = math.degrees(min(abs(oblique_angle), held_from(self))) ** np.arange(len(self.coefficients))
        return math.sqrt(max(0.0, float(powers @ np.array(self.covariance) @ powers)))

    def polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
        """Return the coefficients of S in powers of the oblique angle in degrees, constant first."""
        return self.coefficients


def positive_up_to(coefficients: Sequence[float], held: float, lower: float, upper: float) -> float:
    """Return the angle up to which a polynomial S is above 0, or the upper end of the range. [rad]

    Parameters
    ----------
    held
        Oblique angle from which S is constant. [rad]
    lower, upper
        Range of oblique angles. [rad]
    """
    # A grid of values serves any degree, whereas the roots of polynomials of high degree are ill-conditioned.
    angles = np.linspace(lower, upper, STRENGTH_CHECKS)
    values = np.polynomial.polynomial.polyval(np.degrees(np.minimum(np.abs(angles), held)), coefficients)
    beyond = np.flatnonzero(~(values > 0.0))
    return float(angles[max(beyond[0] - 1, 0)]) if beyond.size else upper


def _check_covariance(covariance: tuple[tuple[float, ...], ...], size: int) -> None:
    """Raise `ParameterError` unless a matrix is a covariance matrix of `size` coefficients."""
    name = f"{FIELD}.covariance"
    require(len(covariance) == size, name, f"must have a row for each of the {size} coefficients")
    for index, row in enumerate(covariance):
        require(len(row) == size, f"{name}.{index}", f"must hold {size} numbers, got {len(row)}")
        for column, value in enumerate(row):
            require_finite(f"{name}.{index}.{column}", value)
    matrix = np.array(covariance)
    variances = np.diagonal(matrix)
    require(bool(np.all(variances >= 0.0)), name, "must have no variance below 0")
    # The matrix is scaled to correlations, because the variances of the coefficients of high powers are so small that
    # any error in them would be below the tolerance.
    errors = np.where(variances > 0.0, np.sqrt(variances), 1.0)
    correlation = matrix / errors[:, None] / errors
    require(bool(np.allclose(correlation, correlation.T, rtol=0.0, atol=ROUNDING)), name, "must be symmetric")
    least = float(np.linalg.eigvalsh(correlation).min())
    require(least >= -ROUNDING, name, "must be positive semidefinite, as every covariance is")


@dataclass(frozen=True, slots=True, kw_only=True)
class StrengthPowerLaw:
    """Power law of the compressive strength and, optionally, of the diameter of the projectile.

    Parameters
    ----------
    coefficient
        Strength factor in normal impact at the reference strength and diameter. [1] Frew et al. (1998) give 82.6 with
        the exponent -0.544, Li and Chen (2003) 72 with -0.5.
    exponent
        Exponent of the strength. [1]
    reference_strength
        Strength by which the strength of the target is divided. [Pa]
    diameter_exponent
        Exponent of the diameter; 0 leaves it out. [1]
    reference_diameter
        Diameter by which the diameter of the projectile is divided. [m]
    obliquity_shape
        Dependence of S on the oblique angle. ``equation_9`` multiplies S by S(θ)/S(0) of eq. 9, held from 60°;
        ``finite_elements`` by S(θ)/S(0) fitted to finite element motions with the decay law in use, held from 55°.

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
        require_positive(f"{FIELD}.reference_strength", self.reference_strength, "MPa")
        require_finite(f"{FIELD}.diameter_exponent", self.diameter_exponent)
        require_positive(f"{FIELD}.reference_diameter", self.reference_diameter, "mm")
        _check_shape(self.obliquity_shape)

    def polynomial(
        self, *, target: Target, projectile: Projectile, decay: str = ElasticPlastic.name
    ) -> tuple[float, ...]:
        """Return the coefficients of S in powers of the oblique angle in degrees, for the decay law named `decay`."""
        try:
            by_strength = (target.compressive_strength / self.reference_strength) ** self.exponent
            by_diameter = (projectile.diameter / self.reference_diameter) ** self.diameter_exponent
        except OverflowError:
            return (math.inf,)
        value = float(self.coefficient * by_strength * by_diameter)
        if self.obliquity_shape == "constant":
            return (value,)
        equation_9 = self.obliquity_shape == "equation_9"
        shape = EQUATION_9_COEFFICIENTS if equation_9 else FINITE_ELEMENT_SHAPES[decay]
        return tuple(value * (each / shape[0]) for each in shape)


def _check_shape(shape: str) -> None:
    known = get_args(ObliquityShape)
    require(shape in known, f"{FIELD}.obliquity_shape", f"must be one of {', '.join(map(repr, known))}, got {shape!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedTests:
    """Power law of strength and diameter fitted to published penetration tests, with the scatter of the tests about it.

    Parameters
    ----------
    obliquity_shape
        Dependence of S on the oblique angle, about which the tests, all at normal incidence, say nothing.
        ``equation_9`` takes S(θ)/S(0) from eq. 9, ``finite_elements`` from finite element motions with the decay law in
        use; with ``constant`` S is the same at all angles.

    Notes
    -----
    ``S = 8.84 (f'c / 39 MPa)^-0.18 (d / 76.2 mm)^-0.24``, the median of a mixed model with a random intercept for each
    series, fitted to 251 tests of 34 articles up to 900 m/s (Concrete Penetration Failure Response Dataset). In 38 of
    these the stated mass exceeds that of a solid steel body.

    The scatter about the median is modelled as follows. Within a series, ln S is normal with a variance that has a
    scaled inverse chi-square distribution, with `degrees_of_freedom` and the scale `within_series`. The mean of a
    series is normal with a variance proportional to that one, so over all series it has Student's distribution with the
    scale `between_series`. The next shot has Student's distribution too, whether or not there are shots into the same
    concrete.
    """

    name: ClassVar[str] = "published_tests"
    law: ClassVar[StrengthPowerLaw] = StrengthPowerLaw(
        coefficient=8.84, exponent=-0.18, reference_strength=39e6, diameter_exponent=-0.24, reference_diameter=0.0762
    )
    between_series: ClassVar[float] = 0.266
    """Scale of ln S between series, that is of the series means about the law. [ln]"""
    within_series: ClassVar[float] = 0.0677
    """Scale of ln S between shots of one projectile type into one concrete. [ln]"""
    # The likelihood is greatest at 5 for both scales together, and at 3.2 for the scatter within series alone. 3 is
    # nearly as likely and more conservative: series in articles outside the fit deviate more than those in it.
    degrees_of_freedom: ClassVar[float] = 3.0
    """Degrees of freedom of Student's distribution, between and within series. [1]"""
    compressive_strengths: ClassVar[tuple[float, float]] = (13.13e6, 108.3e6)
    """Smallest and largest compressive strength in the tests. [Pa]"""
    diameters: ClassVar[tuple[float, float]] = (0.0099, 0.203)
    """Smallest and largest projectile diameter in the tests. [m]"""
    velocities: ClassVar[tuple[float, float]] = (67.1, 897.0)
    """Lowest and highest speed at first contact in the tests. [m/s]"""
    obliquity_shape: ObliquityShape = "equation_9"

    def __post_init__(self) -> None:
        _check_shape(self.obliquity_shape)

    def polynomial(
        self, *, target: Target, projectile: Projectile, decay: str = ElasticPlastic.name
    ) -> tuple[float, ...]:
        """Return the coefficients of S in powers of the oblique angle in degrees, for the decay law named `decay`."""
        law = replace(self.law, obliquity_shape=self.obliquity_shape)
        return law.polynomial(target=target, projectile=projectile, decay=decay)


# No laboratory fires so many shots into one concrete.
MOST_SHOTS = 1000
"""Largest number of shots in `OwnTests`."""
NORMAL_QUANTILE = 1.6448536
"""Half-width of the 90 % interval of a normal distribution. [standard deviations]"""
# Measured values lie between 2.3 and 30. A depth that requires a value far outside this range is probably in a wrong
# unit, or belongs to another projectile.
PLAUSIBLE_FACTORS = (2.0, 60.0)
"""Smallest and largest S accepted from a shot. [1]"""
# For a single shot this limit is about 3 standard deviations of the normal distribution with the same 90 % interval.
FAR_OFF = 2.5
"""Deviation of the ln S of a shot from the prediction by the other shots, relative to the dispersion of that
prediction, above which a warning appears. [1]"""
SLIPS: tuple[tuple[str, float, str], ...] = (
    ("depth", 1e-3, "millimetres given as metres"),
    ("depth", 1e-2, "centimetres given as metres"),
    ("depth", 0.0254, "inches given as metres"),
    ("depth", 1e3, "metres given as millimetres"),
    ("velocity", 1e3, "km/s given as m/s"),
    ("velocity", 0.3048, "ft/s given as m/s"),
    ("mass", 1e-3, "grams given as kilograms"),
    ("mass", 1e3, "kilograms given as grams"),
)
"""Common unit mistakes: the quantity, the factor that corrects it, and a description."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """Shot at normal incidence into the concrete of the strike; the target must be thick enough to stop it.

    Parameters
    ----------
    velocity
        Speed at first contact. [m/s]
    depth
        Depth of the nose tip at rest; the strength factor that gives this depth must be 2 to 60. [m]
    mass
        Mass of the projectile; the mass in the strike unless given. [kg]
    diameter
        Diameter of the projectile; the diameter in the strike unless given. The projectile of the strike is scaled to
        it. [m]
    """

    velocity: float
    depth: float
    mass: float | None = None
    diameter: float | None = None


def student_dispersion(scale: float, degrees_of_freedom: float) -> float:
    """Return the standard deviation of Student's distribution, or a substitute where it has none.

    Up to two degrees of freedom the variance is infinite. The substitute is the standard deviation of the normal
    distribution with the same 90 % interval.
    """
    if degrees_of_freedom > 2.0:
        return scale * math.sqrt(degrees_of_freedom / (degrees_of_freedom - 2.0))
    return scale * tail_ratio(degrees_of_freedom)


def tail_ratio(degrees_of_freedom: float) -> float:
    """Return the ratio of the 90 % intervals of Student's and the normal distribution with the same scale. [1]"""
    from scipy.special import stdtrit  # noqa: PLC0415 (takes long to import)

    return float(stdtrit(degrees_of_freedom, 0.95)) / NORMAL_QUANTILE


def _student_range(median: float, scale: float, degrees_of_freedom: float) -> tuple[float, float]:
    """Return the 90 % range of a quantity whose logarithm has Student's distribution."""
    reach = math.exp(scale * NORMAL_QUANTILE * tail_ratio(degrees_of_freedom))
    return median / reach, median * reach


@dataclass(frozen=True, slots=True)
class ShotPrediction:
    """Predictive distribution of ln S for the next shot of a series: Student's distribution."""

    location: float
    """Median of ln S or, from `predict_shot`, of its deviation from the law. [ln]"""
    scale: float
    """Scale of the distribution. [ln]"""
    degrees_of_freedom: float
    """Degrees of freedom of the distribution. [1]"""

    @property
    def dispersion(self) -> float:
        """Standard deviation of ln S. [ln]"""
        return student_dispersion(self.scale, self.degrees_of_freedom)

    @property
    def factors(self) -> tuple[float, float]:
        """Ends of the 90 % range of S, divided by its median. [1]"""
        return _student_range(1.0, self.scale, self.degrees_of_freedom)


def predict_shot(
    misses: FloatArray,
    *,
    between: float = PublishedTests.between_series,
    within: float = PublishedTests.within_series,
    degrees_of_freedom: float = PublishedTests.degrees_of_freedom,
) -> ShotPrediction:
    """Return the predictive distribution of the deviation of ln S from the law, for the next shot of a series.

    Parameters
    ----------
    misses
        (n,) deviations of ln S from the law in the shots so far; n may be 0. [ln]
    between, within
        Scales of ln S between series and within a series. [ln, ln]
    degrees_of_freedom
        Degrees of freedom at both scales. [1]

    Notes
    -----
    In the model of `PublishedTests`, a normal mean and a scaled inverse chi-square variance, the posterior is conjugate
    (Gelman et al., Bayesian Data Analysis, 3rd ed., section 3.3). The prior mean counts as ``(within / between)²``
    shots.
    """
    prior, count = (within / between) ** 2, len(misses)
    mean = float(misses.mean()) if count else 0.0
    squares = float(((misses - mean) ** 2).sum()) + prior * count / (prior + count) * mean**2
    freedom = degrees_of_freedom + count
    variance = (degrees_of_freedom * within**2 + squares) / freedom
    return ShotPrediction(
        location=count * mean / (prior + count),
        scale=math.sqrt(variance * (1.0 + 1.0 / (prior + count))),
        degrees_of_freedom=freedom,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class StrengthPosterior:
    """Posterior of the strength factor of the next shot into the same concrete: ln S has Student's distribution."""

    median: float
    """Median of S. [1]"""
    scale: float
    """Scale of ln S. [ln]"""
    degrees_of_freedom: float
    """Degrees of freedom of the distribution of ln S. [1]"""
    prior_median: float
    """Median of S by the law of the published tests, without the shots. [1]"""
    factors: tuple[float, ...]
    """S of each shot, converted to the diameter of the projectile. [1]"""
    deviations: tuple[float, ...]
    """Deviation of the ln S of each shot from the prediction by the law and the other shots, relative to the dispersion
    of that prediction. [1]"""

    @property
    def dispersion(self) -> float:
        """Standard deviation of ln S. [ln]"""
        return student_dispersion(self.scale, self.degrees_of_freedom)

    @property
    def prior_dispersion(self) -> float:
        """Standard deviation of ln S without the shots. [ln]"""
        return predict_shot(np.zeros(0)).dispersion

    @property
    def spread(self) -> tuple[float, float]:
        """90 % range of S. [1]"""
        return _student_range(self.median, self.scale, self.degrees_of_freedom)

    @property
    def prior_spread(self) -> tuple[float, float]:
        """90 % range of S without the shots. [1]"""
        prior = predict_shot(np.zeros(0))
        return _student_range(self.prior_median, prior.scale, prior.degrees_of_freedom)


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnTests:
    """Strength factor of a concrete, from shots into it, with the published tests as the prior.

    Parameters
    ----------
    shots
        One to 1,000 shots, each with an S of 2 to 60. One shot that agrees with the law narrows the standard deviation
        of ln S from 0.48 to 0.12.
    obliquity_shape
        Dependence of S on the oblique angle, as for `PublishedTests`.
    residual
        Factor on S, for studies in which S scatters. [1]

    Raises
    ------
    ParameterError
        If there are no shots, or a value is outside its range.

    Examples
    --------
    >>> law = OwnTests(shots=(Shot(velocity=238.1, depth=0.30, mass=12.923),))
    >>> critical_angle(..., resistance=Resistance(strength_factor=law))
    >>> law.posterior(target=target, projectile=projectile).dispersion

    Notes
    -----
    The S of each shot follows from its depth, and is converted to the diameter of the projectile with the exponent of
    `PublishedTests`. The scatter of `PublishedTests` is the prior; see `predict_shot`. The dispersion is that of the
    next shot: it grows with the scatter of the shots, and with their distance from the law.
    """

    name: ClassVar[str] = "own_tests"
    shots: tuple[Shot, ...]
    obliquity_shape: ObliquityShape = "equation_9"
    residual: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "shots", tuple(rows_of(f"{FIELD}.shots", self.shots, Shot)))
        count = len(self.shots)
        amounts = Amount(MOST_SHOTS, ""), Amount(count, "")
        require(1 <= count <= MOST_SHOTS, f"{FIELD}.shots", "must hold 1 to {} shots, got {}", *amounts)
        for index, shot in enumerate(self.shots):
            for like in ("impact.velocity", "shot.depth", "projectile.mass", "projectile.diameter"):
                name = like.split(".")[1]
                if (value := getattr(shot, name)) is not None:
                    require_bounds(f"{FIELD}.shots.{index}.{name}", value, like)
        _check_shape(self.obliquity_shape)
        require_positive(f"{FIELD}.residual", self.residual)

    def posterior(
        self, *, target: Target, projectile: Projectile, inertia_factor: float = 1.0, crater: Crater | None = None
    ) -> StrengthPosterior:
        """Return the posterior of S for the next shot into the same concrete, in normal impact.

        Parameters
        ----------
        target, projectile
            Concrete, and projectile of the next shot.
        inertia_factor, crater
            Inertia factor and crater of the resistance in which S is used.

        Raises
        ------
        ParameterError
            If no strength factor within `PLAUSIBLE_FACTORS` gives the depth of a shot.
        """
        return _posterior(self, replace(target, thickness=None), projectile, inertia_factor, crater)

    def polynomial(
        self,
        *,
        target: Target,
        projectile: Projectile,
        inertia_factor: float = 1.0,
        crater: Crater | None = None,
        decay: str = ElasticPlastic.name,
    ) -> tuple[float, ...]:
        """Return the coefficients of S in powers of the oblique angle in degrees, for the decay law named `decay`."""
        law = self.power_law(target=target, projectile=projectile, inertia_factor=inertia_factor, crater=crater)
        return law.polynomial(target=target, projectile=projectile, decay=decay)

    def power_law(
        self, *, target: Target, projectile: Projectile, inertia_factor: float = 1.0, crater: Crater | None = None
    ) -> StrengthPowerLaw:
        """Return the median of S, times `residual`, as a power law of strength and diameter, which may vary in studies.

        Notes
        -----
        A depth gives the product of S and the strength, so the S of a shot is inversely proportional to the strength
        assumed for it. The exponent of the power law is the mean of -1, weighted by the shots, and of the exponent of
        the published tests, weighted by the prior.
        """
        found = self.posterior(target=target, projectile=projectile, inertia_factor=inertia_factor, crater=crater)
        between, within = PublishedTests.between_series**2, PublishedTests.within_series**2
        prior = within / (within + len(self.shots) * between)
        return StrengthPowerLaw(
            coefficient=self.residual * found.median,
            exponent=prior * PublishedTests.law.exponent - (1.0 - prior),
            reference_strength=target.compressive_strength,
            diameter_exponent=PublishedTests.law.diameter_exponent,
            reference_diameter=projectile.diameter,
            obliquity_shape=self.obliquity_shape,
        )


@lru_cache(maxsize=256)  # a search looks up the same posterior at each of its trials
def _posterior(
    law: OwnTests, target: Target, projectile: Projectile, inertia_factor: float, crater: Crater | None
) -> StrengthPosterior:
    prior = PublishedTests(obliquity_shape="constant").polynomial(target=target, projectile=projectile)[0]
    exponent = PublishedTests.law.diameter_exponent

    def factor_of(shot: Shot) -> float:
        body = body_of(shot, projectile)
        factor = strength_factor_of_depth(
            projectile=body,
            target=target,
            velocity=shot.velocity,
            depth=shot.depth,
            inertia_factor=inertia_factor,
            crater=crater,
        )
        return float(factor * (projectile.diameter / body.diameter) ** exponent)

    factors = []
    lower, upper = PLAUSIBLE_FACTORS
    for index, shot in enumerate(law.shots):
        try:
            factor = factor_of(shot)
        except ParameterError as error:
            name, before = error.field, ""
            if name.startswith("projectile."):  # the scaled body of this shot is too small or too large
                name, before = "diameter", f"makes a {name} that "
            raise error.at(f"{FIELD}.shots.{index}.{name}", before=before) from None
        if not lower <= factor <= upper:
            mass = projectile.mass if shot.mass is None else shot.mass
            slip, corrected = _likely_slip(shot, mass, factor_of, prior)
            raise ParameterError(
                f"{FIELD}.shots.{index}.depth",
                "of {} at {} requires a strength factor of {}, which must be between "
                f"{lower:g} and {upper:g}; {slip}",
                Amount(shot.depth, "mm"),
                Amount(shot.velocity, "m/s"),
                Amount(factor, "", 3),
                *corrected,
            )
        factors.append(factor)
    misses = np.log(np.array(factors) / prior)
    found = predict_shot(misses)
    # A shot is compared with the prediction by the law and all other shots, because a prediction that includes the shot
    # would follow it.
    others = [predict_shot(np.delete(misses, place)) for place in range(len(misses))]
    deviations = [(miss - each.location) / each.dispersion for miss, each in zip(misses.tolist(), others, strict=True)]
    return StrengthPosterior(
        median=prior * math.exp(found.location),
        scale=found.scale,
        degrees_of_freedom=found.degrees_of_freedom,
        prior_median=prior,
        factors=tuple(factors),
        deviations=tuple(deviations),
    )


def _likely_slip(
    shot: Shot, mass: float, factor_of: Callable[[Shot], float], prior: float
) -> tuple[str, tuple[Amount, ...]]:
    """Return the unit mistake whose correction brings the S of an implausible shot nearest to the law.

    The mistake is returned as a text, followed by the amounts that take the places of ``{}`` in it.

    Parameters
    ----------
    mass
        Mass of the projectile of the shot. [kg]
    factor_of
        Function from a shot to its S. [1]
    prior
        Value of S by the law of the published tests. [1]
    """
    found = []
    for quantity, factor, slip in SLIPS:
        right = factor * (mass if quantity == "mass" else getattr(shot, quantity))
        try:
            other = factor_of(replace(shot, **{quantity: right}))
        except ParameterError:  # no S gives the depth of the corrected shot either
            continue
        if PLAUSIBLE_FACTORS[0] <= other <= PLAUSIBLE_FACTORS[1]:
            unit = {"depth": "mm", "velocity": "m/s", "mass": "kg"}[quantity]
            text = f"perhaps {slip}: with a {quantity} of {{}} it is {number(other, '', 3)}"
            found.append((abs(math.log(other / prior)), text, Amount(right, unit, 4)))
    if not found:
        return "compare speed, depth, mass, diameter and strength with those measured", ()
    _, text, amount = min(found)
    return text, (amount,)


def body_of(shot: Shot, projectile: Projectile) -> Projectile:
    """Return the projectile of a shot: that of the strike, scaled to the diameter and with the mass of the shot."""
    mass = projectile.mass if shot.mass is None else shot.mass
    scale = 1.0 if shot.diameter is None else shot.diameter / projectile.diameter
    nose = projectile.nose
    if isinstance(nose, Profile):
        nose = Profile(points=tuple((scale * x, scale * r) for x, r in nose.points))
    # A body does not turn in normal impact, so its centre of gravity and moment of inertia have no effect.
    return Projectile(nose=nose, diameter=scale * projectile.diameter, length=scale * projectile.length, mass=mass)


def shaped_as_finite_elements(model: "StrengthFactor") -> "StrengthFactor":
    """Replace S(θ)/S(0) of eq. 9 in a law by that of finite element motions; return other laws unchanged."""
    if isinstance(model, ObliquityPolynomial):
        if model.coefficients != EQUATION_9_COEFFICIENTS or held_from(model) != HELD_FROM:
            return model
        return StrengthPowerLaw(coefficient=EQUATION_9_COEFFICIENTS[0], exponent=0.0, obliquity_shape="finite_elements")
    if isinstance(model, ConstantStrengthFactor) or model.obliquity_shape != "equation_9":
        return model
    return replace(model, obliquity_shape="finite_elements")


# docs/explanation/architecture.md has the recipe for adding a law. mypy reports the functions that do not handle a new
# law.
StrengthFactor: TypeAlias = ConstantStrengthFactor | ObliquityPolynomial | StrengthPowerLaw | PublishedTests | OwnTests


def held_from(model: StrengthFactor) -> float:
    """Return the oblique angle from which the S of a law is held constant; 90° if it never is. [rad]"""
    if isinstance(model, ObliquityPolynomial):
        if model.held_from is not None:
            return model.held_from
        return HELD_FROM if model.coefficients == EQUATION_9_COEFFICIENTS else NOT_HELD
    if isinstance(model, ConstantStrengthFactor) or model.obliquity_shape == "constant":
        return NOT_HELD
    return HELD_FROM if model.obliquity_shape == "equation_9" else FINITE_ELEMENTS_TO


@dataclass(frozen=True, slots=True, kw_only=True)
class Resistance:
    """Laws of the resistance of the target.

    Parameters
    ----------
    strength_factor
        Law of S; eq. 9 unless given.
    inertia_factor
        Factor B on density times squared velocity. [1]
    free_surface
        Law of the decay near the faces.
    crater
        Front crater, in which the resistance builds up; none when not given.
    rear_plug
        Plug that shears out of the rear of a wall; none when not given. It has no effect on a half-space.

    Raises
    ------
    ParameterError
        If a law is of the wrong type, or the inertia factor is negative.

    Examples
    --------
    >>> from solver import MohrCoulomb, PublishedTests, Resistance
    >>> resistance = Resistance(strength_factor=PublishedTests(), free_surface=MohrCoulomb())
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

    def strength_polynomial(self, *, target: Target, projectile: Projectile) -> tuple[float, ...]:
        """Return the coefficients of S in powers of the oblique angle in degrees, constant first."""
        model, decay = self.strength_factor, self.free_surface.name
        match model:
            case OwnTests():  # the S of a measured depth depends on inertia and crater
                return model.polynomial(
                    target=target,
                    projectile=projectile,
                    inertia_factor=self.inertia_factor,
                    crater=self.crater,
                    decay=decay,
                )
            case StrengthPowerLaw() | PublishedTests():
                return model.polynomial(target=target, projectile=projectile, decay=decay)
            case ConstantStrengthFactor() | ObliquityPolynomial():
                return model.polynomial(target=target, projectile=projectile)
            case _:
                assert_never(model)

    def without_shots(self, *, target: Target, projectile: Projectile) -> "Resistance":
        """Replace own tests by their power law, so that the S of the shots is computed only once.

        Raises
        ------
        ParameterError
            If no strength factor gives the depth of a shot.
        """
        if not isinstance(self.strength_factor, OwnTests):
            return self
        law = self.strength_factor.power_law(
            target=target, projectile=projectile, inertia_factor=self.inertia_factor, crater=self.crater
        )
        return replace(self, strength_factor=law)

    @property
    def held_from(self) -> float:
        """Oblique angle from which S is held constant; 90° if it never is. [rad]"""
        return held_from(self.strength_factor)


EQUATION_9 = Resistance()
"""Resistance of the source paper, the default."""


def usual_unless_given(resistance: object) -> Resistance:
    """Return the given resistance, or the one of the source paper for None.

    Raises
    ------
    ParameterError
        If it is of another type. For a bare law the error names the parameter of `Resistance` to which it belongs.
    """
    if resistance is None:
        return EQUATION_9
    if isinstance(resistance, Resistance):
        return resistance
    name = type(resistance).__name__
    for parameter, laws in (("free_surface", get_args(FreeSurface)), ("strength_factor", get_args(StrengthFactor))):
        if isinstance(resistance, laws):
            raise ParameterError("resistance", f"must be a Resistance: give Resistance({parameter}={name}(...))")
    raise ParameterError("resistance", f"must be a Resistance, got {name}")


def strength_factor(*, resistance: Resistance, oblique_angle: float, target: Target, projectile: Projectile) -> float:
    """Return the strength factor S of one strike.

    Parameters
    ----------
    resistance
        Resistance that contains the law of S.
    oblique_angle
        Initial oblique angle from the inward normal. [rad]
    target, projectile
        Concrete and projectile; some laws depend on strength and diameter.

    Returns
    -------
    float
        Strength factor. [1]

    Raises
    ------
    ParameterError
        If the law gives a value that is not above zero at this angle.
    """
    resistance = usual_unless_given(resistance)
    degrees, value = math.degrees(min(abs(oblique_angle), resistance.held_from)), 0.0
    for coefficient in reversed(resistance.strength_polynomial(target=target, projectile=projectile)):
        value = value * degrees + coefficient
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(
            FIELD,
            f"must be greater than 0 at the initial oblique angle of {math.degrees(oblique_angle):g}°, "
            f"but the model gives {value:g}",
        )
    return value


def plug_height(*, resistance: Resistance, target: Target, projectile: Projectile) -> float:
    """Return the height of the plug that shears out of the rear of a wall; 0 without a plug. [m]

    Notes
    -----
    The shear strength of the concrete is ``(S / S_ref) f'c / √3``, where S_ref is the median of `PublishedTests` in
    normal impact, for this strength and diameter. S scales the force of the projectile and the shear strength alike, so
    the height does not depend on it. The height is at most `MOST_PLUG` of the wall.
    """
    # If the height grew with S, a larger S could lower the limit speed: it was 144, 158 and 128 m/s at the 5, 50 and 95
    # % quantiles of S for a body of 168 mm on a wall of 0.25 m.
    if resistance.rear_plug is None:
        return 0.0
    (reference,) = PublishedTests.law.polynomial(target=target, projectile=projectile)
    height = resistance.rear_plug.height(strength_factor=reference, diameter=projectile.diameter)
    return height if target.thickness is None else min(height, MOST_PLUG * target.thickness)


def nose_factor(projectile: Projectile) -> float:
    """Return the nose factor N: the inertial resistance of the nose divided by that of a flat face. [1]

    Notes
    -----
    ``N = (2/a²) ∫ r sin²α dr`` over the nose, by Gauss quadrature; for an ogive it is (8ψ - 1) / (24ψ²).
    """
    t, w = gauss_rule(GAUSS_POINTS).T
    total = 0.0
    for piece in projectile.nose.outline(projectile.radius):
        _, r, sine, _ = piece.at(t)
        total += piece.length * float((r * sine**3) @ w)
    return 2.0 * total / projectile.radius**2


def strength_factor_of_depth(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    depth: float,
    inertia_factor: float = 1.0,
    crater: Crater | None = None,
) -> float:
    """Return the strength factor S with which normal impact on a half-space ends at a measured depth.

    Parameters
    ----------
    projectile, target
        Projectile and concrete; the thickness of the target has no effect.
    velocity
        Speed at first contact. [m/s]
    depth
        Depth of the nose tip at rest. [m]
    inertia_factor
        Factor B of eq. 1. [1]
    crater
        Front crater, in which the resistance builds up; none unless given.

    Returns
    -------
    float
        Strength factor. [1]

    Raises
    ------
    ParameterError
        If the velocity or the depth is not greater than 0, or no factor gives such a depth.

    Notes
    -----
    The force is ``w (S f'c A(z) + B ρ v² I(z))``: A is the cross-sectional area of the part of the nose that is inside,
    ``I = ∫ sin²α dA`` over that area, and w the fraction of the resistance that acts within the crater. The equation of
    motion is linear in v², and solved for S it gives

        S = m v² / (2 f'c ∫ w A exp(J) dz),  J(z) = (2 B ρ / m) ∫ w I dz

    over the path of the tip, so no search is needed.
    """
    require_positive("velocity", velocity)
    require_positive("depth", depth)
    inside, area, drag = _nose_inside(projectile)
    crater_depth = 0.0 if crater is None else crater.depth_diameters * projectile.diameter
    drag = drag * 2.0 * inertia_factor * target.density / projectile.mass
    # Beyond nose and crater the integrand is an exponential with a known integral. Up to there the trapezoidal rule is
    # used, with the corners of the integrand among its points.
    varied = min(depth, max(inside[-1], crater_depth))
    corners = sorted({0.0, varied, *(z for z in (float(inside[-1]), crater_depth) if z < varied)})
    z = np.unique(np.concatenate([np.linspace(*ends, PATH_POINTS) for ends in pairwise(corners)] or [np.zeros(1)]))
    share = np.ones_like(z) if crater_depth == 0.0 else np.minimum(z / crater_depth, 1.0)
    exponent = _cumulative(share * np.interp(z, inside, drag), z)
    growth = float(drag[-1]) * (depth - varied)
    with np.errstate(over="ignore"):  # if an integral overflows, S is 0, which is refused below
        integral = float(np.trapezoid(share * np.interp(z, inside, area) * np.exp(exponent), z))
        beyond = float(np.expm1(growth)) / growth if growth > 0.0 else 1.0  # no cancellation for a small exponent
        integral += float(area[-1]) * float(np.exp(exponent[-1])) * beyond * (depth - varied)
    found = float(projectile.mass * velocity**2 / (2.0 * target.compressive_strength * integral))
    if not (math.isfinite(found) and found > 0.0):
        amounts = Amount(depth, "mm"), Amount(velocity, "m/s")
        raise ParameterError("depth", "of {} at {} is not reached with any strength factor", *amounts)
    return found


def _nose_inside(projectile: Projectile) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return depths of the tip [m], and area and ``∫ sin²α dA`` of the part of the nose inside at each depth. [m²]"""
    t = np.linspace(0.0, 1.0, PATH_POINTS)
    pieces = [(piece.length, piece.at(t)) for piece in projectile.nose.outline(projectile.radius)]
    depth = np.concatenate([x for _, (x, _, _, _) in pieces])
    area: FloatArray = np.pi * np.concatenate([r for _, (_, r, _, _) in pieces]) ** 2
    drags, total = [], 0.0
    for length, (_, r, sine, _) in pieces:
        drags.append(total + _cumulative(2.0 * np.pi * r * sine**3, length * t))
        total = float(drags[-1][-1])
    return depth, area, np.concatenate(drags)


def _cumulative(values: FloatArray, places: FloatArray) -> FloatArray:
    """Return the integral from the first place to each place, by the trapezoidal rule."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(places)
    return np.concatenate(([0.0], np.cumsum(steps)))


def closed_form_depth(*, projectile: Projectile, target: Target, velocity: float, strength_factor: float) -> float:
    """Return the depth of a normal impact with a crater of two diameters, in closed form.

    Parameters
    ----------
    projectile, target
        Projectile and concrete.
    velocity
        Speed at first contact. [m/s]
    strength_factor
        Strength factor S. [1]

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

    with the speed V₁ at the end of the crater. A projectile too slow to reach that point stops where the work of the
    resistance ``c z`` equals its energy, at ``z = V sqrt(m/c)`` with c = π a S f'c / 4. At the limit V₁ = 0 both
    formulas give 4a. The source covers ogives only; for other noses N is the same integral over their outline.
    """
    require_positive("velocity", velocity)
    require_positive("strength_factor", strength_factor)
    m, a, static = projectile.mass, projectile.radius, strength_factor * target.compressive_strength
    inertia = nose_factor(projectile) * target.density
    excess = m * velocity**2 - 4.0 * math.pi * a**3 * static
    if excess <= 0.0:
        return velocity * math.sqrt(4.0 * m / (math.pi * a * static))
    after_crater = excess / (m + 4.0 * math.pi * a**3 * inertia)
    # For slow projectiles the argument of the logarithm is close to 1, where `log1p` avoids cancellation.
    return 4.0 * a + m / (2.0 * math.pi * a**2 * inertia) * float(np.log1p(inertia * after_crater / static))
