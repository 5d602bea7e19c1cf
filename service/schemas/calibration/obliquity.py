"""Strength factor over the oblique angle, as the contract has it."""

import itertools
import math
from typing import Annotated, Any

from pydantic import MISSING, Field

from service.schemas.answers import VERSIONED, EngineVersion, Key, ModelWarning
from service.schemas.building import warnings_told
from service.schemas.calibration.shared import Residuals, StrengthFactorValue
from service.schemas.numerics import Obliquity
from service.schemas.quantities import WHOLE, Count, Num, Part, with_examples
from service.schemas.resistance import (
    LARGEST_COEFFICIENT,
    UNCERTAIN,
    CovarianceMatrix,
    ObliquityPolynomial,
)
from solver.calibration import ObliquityFit
from solver.calibration import ObliquityPoint as SolverPoint
from solver.errors import ParameterError

MOST_POINTS = 1000
TABLE_2 = [
    {"oblique_angle_deg": angle, "strength_factor": factor}
    for angle, factor in ((0.0, 8.52), (15.0, 8.25), (30.0, 7.91), (45.0, 6.48))
]
"""Of the paper."""


class ObliquityPoint(Part):
    """A strength factor at one oblique angle."""

    model_config = with_examples(TABLE_2[1], TABLE_2[1] | {"standard_error": 0.1})

    oblique_angle_deg: Annotated[Obliquity, Field(description="From the normal. [°]")]
    strength_factor: StrengthFactorValue
    standard_error: (
        Annotated[
            Num, Field(ge=1e-6, le=1000.0, description="Of the strength factor; given for all points or for none. [1]")
        ]
        | MISSING
    ) = MISSING

    def to_solver(self) -> SolverPoint:
        """Return the solver's point."""
        return SolverPoint(
            oblique_angle=math.radians(self.oblique_angle_deg),
            strength_factor=self.strength_factor,
            standard_error=None if self.standard_error is MISSING else self.standard_error,
        )


class ObliquityCalibrationRequest(Part):
    """Strength factors over the oblique angle, and the order of the polynomial through them."""

    model_config = with_examples(
        {"points": TABLE_2}, {"points": [point | {"standard_error": 0.1} for point in TABLE_2], "order": 1}
    )

    points: Annotated[list[ObliquityPoint], Field(min_length=1, max_length=MOST_POINTS, fail_fast=True)]
    order: Annotated[
        Count,
        Field(ge=0, le=9, description="Of the polynomial; there must be more points at different angles. [1]"),
        WHOLE,
    ] = 2

    def canonical(self) -> dict[str, Any]:
        """Return the request as JSON data, defaults filled in."""
        return self.model_dump(mode="json")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `fit_obliquity`."""
        return {"points": [point.to_solver() for point in self.points], "order": self.order}


class ObliquityCalibrationAnswer(Part):
    """The polynomial that fits strength factors over the oblique angle best."""

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

    coefficients: Annotated[list[Num], Field(description="From the constant term upwards. [1, 1/°, 1/°², ...]")]
    covariance: CovarianceMatrix | MISSING = MISSING
    residuals: Annotated[Residuals, Field(description="Given minus fitted strength factor of each point. [1]")]
    strength_factor_model: Annotated[
        ObliquityPolynomial, Field(description="The same as the `strength_factor` of a `resistance`.")
    ]
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


def obliquity_answer(fit: ObliquityFit) -> dict[str, Any]:
    """Return the answer from a fit.

    Raises
    ------
    ParameterError
        If the points are so close together that the polynomial is beyond what a request takes.
    """
    polynomial: dict[str, Any] = {"coefficients": list(fit.coefficients)}
    if fit.covariance is not None:
        polynomial["covariance"] = [list(row) for row in fit.covariance]
    numbers = [*fit.coefficients, *itertools.chain.from_iterable(fit.covariance or ())]
    if not all(abs(number) <= LARGEST_COEFFICIENT for number in numbers):
        raise ParameterError(
            "points",
            f"are too close together for a polynomial of this order: it has numbers above {LARGEST_COEFFICIENT:g}",
        )
    return polynomial | {
        "residuals": fit.residuals.tolist(),
        "strength_factor_model": {"model": "obliquity_polynomial"} | polynomial,
        "warnings": warnings_told(fit.warnings),
    }
