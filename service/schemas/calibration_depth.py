"""Models of the fit of a strength factor to penetration depths, and of a polynomial in the angle to such factors."""

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import MISSING, Field, StringConstraints

from service.columns import Column
from service.schemas.answers import VERSIONED, EngineVersion, Key, ModelWarning
from service.schemas.calibration_motion import (
    Calibration,
    ConfidenceInterval,
    FittedStrength,
    Residuals,
    StandardError,
    StrengthFactorValue,
)
from service.schemas.fields import GIVEN, NOT_TABLED, walk
from service.schemas.numerics import Obliquity
from service.schemas.quantities import WHOLE, Count, Num, Of, Part, SolverPart, with_examples, within
from service.schemas.resistance import (
    LARGEST_COEFFICIENT,
    UNCERTAIN,
    CovarianceMatrix,
    ObliquityPolynomial,
)
from service.schemas.strike import PROJECTILE, TARGET
from solver.arrays import FloatArray
from solver.calibration import DepthFit, ObliquityFit
from solver.calibration import DepthTest as SolverTest
from solver.calibration import ObliquityPoint as SolverPoint
from solver.checks import ParameterError

MOST_TESTS = 1000
"""Largest number of tests, about four times the 251 published tests to which the law of S was fitted."""
CURVE_POINTS = 21
"""Number of points of a curve of depth against velocity, enough for a smooth plot."""
# An extension by a fifth on either side shows the trend of the curve without extrapolating far from the tests.
BELOW, ABOVE = 0.8, 1.2
"""Lowest and highest velocity of a curve, relative to the lowest and highest velocity of the tests. [1]"""

TEST = {"velocity_m_s": 238.1, "depth_m": 0.30, "mass_kg": 12.923}
TABLE_1 = [
    TEST,
    {"velocity_m_s": 275.7, "depth_m": 0.38, "mass_kg": 12.900},
    {"velocity_m_s": 314.0, "depth_m": 0.45, "mass_kg": 12.910},
    {"velocity_m_s": 369.5, "depth_m": 0.53, "mass_kg": 12.914},
]
"""Penetration tests of the paper's table 1, as an example."""

POSTERIOR = {"type": "log_student_t", "median": 8.055, "scale": 0.0815, "degrees_of_freedom": 7.0}
"""Posterior of S after the tests of table 1."""

Group = Annotated[str, StringConstraints(strict=True, min_length=1, max_length=128)]


class DepthTest(SolverPart[SolverTest]):
    """One shot in normal impact with its penetration depth."""

    model_config = with_examples(TEST, TEST | {"weight": 0.5, "group": "80 mm"})

    velocity_m_s: Annotated[Num, Field(**within("impact.velocity"))]
    """Speed at first contact. [m/s]"""
    depth_m: Annotated[Num, Field(**within("shot.depth"))]
    """Greatest depth of the nose tip. [m]"""
    mass_kg: Annotated[Num, Field(**within("projectile.mass"))] | MISSING = MISSING
    """Mass of the projectile, if it differs from the mass of `projectile`. [kg]"""
    # Only ratios of weights matter. The bounds are arbitrary: with a millionth of the default weight, a test has
    # no noticeable effect on the fit.
    weight: Annotated[Num, Field(ge=1e-6, le=1e6)] = 1.0
    """Relative weight of the squared residual. [1]"""
    group: Group | MISSING = MISSING
    """Name of the group of the test. Each group of two or more tests gets its own strength factor, in addition to the
    strength factor for all tests."""


class DepthCalibrationRequest(Calibration):
    """Penetration tests of one projectile and target in normal impact, to which a strength factor is fitted."""

    model_config = with_examples(
        {"projectile": PROJECTILE, "target": TARGET, "tests": TABLE_1},
        {
            "projectile": PROJECTILE,
            "target": TARGET,
            "tests": [test | {"group": "slow" if number < 2 else "fast"} for number, test in enumerate(TABLE_1)],
            "resistance": {"inertia_factor": 1.0},
            "confidence_level": 0.9,
            "compare_strength_factors": [7.0, 8.5, 10.0],
        },
    )

    tests: Annotated[list[DepthTest], Field(min_length=1, max_length=MOST_TESTS, fail_fast=True)]

    def arguments(self) -> tuple[dict[str, Any], tuple[float, ...], FloatArray]:
        """Return the arguments of `fit_depth`, the strength factors to compare, and the velocities of their curves.

        Raises
        ------
        ParameterError
            If values contradict each other.
        """
        fit = self.model_arguments() | {
            "tests": [test.to_solver() for test in self.tests],
            "confidence_level": self.confidence_level,
        }
        velocities = [test.velocity_m_s for test in self.tests]
        return fit, self.compared(), np.linspace(BELOW * min(velocities), ABOVE * max(velocities), CURVE_POINTS)


def _error_in(fit: DepthFit) -> float | None:
    """Return the standard error of a fit, or None for a single test."""
    error = fit.estimate.standard_error
    return None if math.isnan(error) else error


def _interval_in(fit: DepthFit) -> tuple[float, float] | None:
    """Return the confidence interval of a fit, or None for a single test."""
    return None if math.isnan(fit.estimate.standard_error) else fit.estimate.confidence_interval


class DepthGroup(FittedStrength):
    """Strength factor of a group of tests."""

    model_config = with_examples(
        {
            "group": "80 mm",
            "strength_factor": 8.377,
            "standard_error": 0.345,
            "confidence_interval": [7.534, 9.22],
        }
    )

    group: Group


class DepthCurve(Part):
    """Depths that the model predicts with one strength factor, for the mass of `projectile`."""

    model_config = with_examples(
        {"strength_factor": 8.5, "velocity_m_s": [238.1, 369.5], "depth_m": [0.274, 0.562]},
    )

    strength_factor: StrengthFactorValue
    velocity_m_s: Annotated[
        list[Num],
        Field(
            description=f"Velocities from {BELOW:g} times the lowest of the tests to {ABOVE:g} times the highest. [m/s]"
        ),
    ]
    depth_m: list[Num]
    """Greatest depth of the nose tip. [m]"""


class Posterior(Part):
    """Posterior of S for the next shot into the same concrete, with the published tests as the prior.

    The weights of the tests have no effect on it.
    """

    model_config = with_examples(POSTERIOR)

    type: Annotated[Literal["log_student_t"], Of("name")]
    median: Num
    """Median of S. [1]"""
    scale: Num
    """Scale of ln S, which has Student's distribution. [1]"""
    degrees_of_freedom: Num
    """Degrees of freedom of Student's distribution. [1]"""


class DepthCalibrationAnswer(Part):
    """Strength factor that fits penetration depths best."""

    model_config = with_examples(
        {
            "strength_factor": 8.377,
            "standard_error": 0.345,
            "confidence_interval": [7.534, 9.22],
            "residuals": [0.0221, 0.0304, 0.017, -0.0399],
            "predicted_depth_m": [0.2779, 0.3496, 0.433, 0.5699],
            "root_mean_square_m": 0.0287,
            "posterior": POSTERIOR,
            "warnings": [],
        }
        | VERSIONED
    )

    strength_factor: Annotated[Num, Field(gt=0.0), Of("estimate.strength_factor")]
    """Strength factor that fits best. [1]"""
    standard_error: Annotated[StandardError | MISSING, Of(_error_in)] = MISSING
    """Standard error of the strength factor, if there are several tests. The scatter within the series of published
    tests counts as three additional tests. [1]"""
    confidence_interval: Annotated[
        ConfidenceInterval | MISSING,
        Of(_interval_in),
        Column("confidence_low", "lower end of the confidence interval of the strength factor"),
        Column("confidence_high", "upper end of the confidence interval of the strength factor"),
    ] = MISSING
    residuals: Residuals
    """Measured minus predicted depth of each test. [m]"""
    predicted_depth_m: Annotated[list[Num], Of("predicted")]
    """Predicted depth of each test. [m]"""
    root_mean_square_m: Annotated[Num, Field(ge=0.0), Of("root_mean_square"), NOT_TABLED]
    """Weighted root mean square of the residuals. [m]"""
    groups: Annotated[list[DepthGroup] | MISSING, GIVEN] = MISSING
    """Strength factors of the groups of two or more tests, if the tests name groups."""
    curves: Annotated[list[DepthCurve] | MISSING, GIVEN] = MISSING
    """Predicted depths for each of `compare_strength_factors`."""
    posterior: Posterior
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


def depth_answer(fit: DepthFit, curves: Sequence[tuple[float, FloatArray, FloatArray]]) -> dict[str, Any]:
    """Return the answer for a fit and its curves; each curve is a strength factor with velocities and depths."""
    groups = [{"group": name} | walk(FittedStrength, group) for name, group in fit.groups.items()]
    compared = [
        {"strength_factor": factor, "velocity_m_s": velocities.tolist(), "depth_m": depths.tolist()}
        for factor, velocities, depths in curves
    ]
    return walk(DepthCalibrationAnswer, fit, groups=groups, curves=compared)


MOST_POINTS = 1000
"""Largest number of points of a polynomial fit, equal to `MOST_TESTS`."""
TABLE_2 = [
    {"oblique_angle_deg": angle, "strength_factor": factor}
    for angle, factor in ((0.0, 8.52), (15.0, 8.25), (30.0, 7.91), (45.0, 6.48))
]
"""Strength factors of the paper's table 2."""


class ObliquityPoint(SolverPart[SolverPoint]):
    """A strength factor at one oblique angle."""

    model_config = with_examples(TABLE_2[1], TABLE_2[1] | {"standard_error": 0.1})

    oblique_angle_deg: Obliquity
    """Angle between the velocity and the inward normal. [°]"""
    strength_factor: StrengthFactorValue
    # The upper bound is the same as for a strength factor. The lower bound keeps the weight of the point, the inverse
    # square of the error, finite.
    standard_error: Annotated[Num, Field(ge=1e-6, le=1000.0)] | MISSING = MISSING
    """Standard error of the strength factor, given for all points or for none. [1]"""


class ObliquityCalibrationRequest(Part):
    """Strength factors at several oblique angles, and the order of the polynomial to fit."""

    model_config = with_examples(
        {"points": TABLE_2}, {"points": [point | {"standard_error": 0.1} for point in TABLE_2], "order": 1}
    )

    points: Annotated[list[ObliquityPoint], Field(min_length=1, max_length=MOST_POINTS, fail_fast=True)]
    # The bound is the solver's `HIGHEST_ORDER`, and the default is the order of eq. 9.
    order: Annotated[Count, Field(ge=0, le=9), WHOLE] = 2
    """Degree of the polynomial, less than the number of different angles. [1]"""

    def canonical(self) -> dict[str, Any]:
        """Return the request as JSON data, with defaults filled in."""
        return self.model_dump(mode="json")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `fit_obliquity`."""
        return {"points": [point.to_solver() for point in self.points], "order": self.order}


class ObliquityCalibrationAnswer(Part):
    """Polynomial in the oblique angle that fits the strength factors best."""

    model_config = with_examples(
        {
            "coefficients": [8.469, 0.0149, -0.0013],
            "covariance": UNCERTAIN["covariance"],
            "residuals": [0.051, -0.153, 0.153, -0.051],
            "strength_factor_model": UNCERTAIN,
            "warnings": [],
        }
        | VERSIONED
    )

    coefficients: list[Num]
    """Coefficients from the constant term upwards. [1, 1/°, 1/°², ...]"""
    covariance: CovarianceMatrix | MISSING = MISSING
    residuals: Residuals
    """Given minus fitted strength factor of each point. [1]"""
    strength_factor_model: Annotated[ObliquityPolynomial, GIVEN]
    """The polynomial in the form that `resistance.strength_factor` of a request has."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


def obliquity_answer(fit: ObliquityFit) -> dict[str, Any]:
    """Return the answer for a fitted polynomial.

    Raises
    ------
    ParameterError
        If the points are so close together that the coefficients exceed the bounds of a request.
    """
    numbers = [*fit.coefficients, *itertools.chain.from_iterable(fit.covariance or ())]
    if not all(abs(number) <= LARGEST_COEFFICIENT for number in numbers):
        raise ParameterError(
            "points",
            f"are too close together for a polynomial of this order: it has numbers above {LARGEST_COEFFICIENT:g}",
        )
    model = walk(ObliquityPolynomial, fit.model, model="obliquity_polynomial")
    return walk(ObliquityCalibrationAnswer, fit, strength_factor_model=model)
