"""Models of the answer to a calibration by motion."""

from collections.abc import Collection, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import MISSING, Field

from service.columns import unit_end
from service.schemas.answers import VERSIONED, WARNING, EngineVersion, Key, ModelWarning
from service.schemas.calibration_motion import (
    AT_30,
    COMPARED_ROWS,
    ConfidenceInterval,
    FittedStrength,
    StandardError,
    StrengthFactorValue,
)
from service.schemas.fields import GIVEN, in_unit, walk
from service.schemas.quantities import Num, Of, Part, with_examples
from service.schemas.resistance import FreeSurfaceModel
from solver.calibration import DecayLawFits, MotionFit, MotionHistory, MotionsFit

RESIDUALS: dict[str, Any] = {
    "time_s": AT_30["time_s"],
    "depth_displacement_m": [0.0, 0.00043, -0.00042, -0.0001, -7e-05, -0.00079],
    "lateral_displacement_m": [0.0, 0.0004, -0.00043, 0.00017, 0.00026, 7e-05],
    "rotation_deg": [0.0, -0.024, -0.019, 0.048, -0.023, -0.025],
}
PREDICTED = {
    "time_s": AT_30["time_s"],
    "depth_displacement_m": [0.0, 0.09757, 0.17342, 0.2261, 0.25207, 0.25679],
    "lateral_displacement_m": [0.0, 0.0596, 0.11143, 0.14683, 0.16874, 0.17293],
    "rotation_deg": [0.0, 1.924, 7.119, 10.952, 11.623, 11.625],
}
ROOT_MEAN_SQUARE = {"depth_displacement_m": 0.00041, "lateral_displacement_m": 0.00027, "rotation_deg": 0.027}
MOTION = {
    "residuals": RESIDUALS,
    "predicted": PREDICTED,
    "root_mean_square": ROOT_MEAN_SQUARE,
    "r_squared": {"depth_displacement_m": 0.99998, "lateral_displacement_m": 0.99998, "rotation_deg": 0.99996},
}
ESTIMATE = {"strength_factor": 7.895, "standard_error": 0.0095, "confidence_interval": [7.875, 7.916]}
OTHER_ESTIMATE = {"strength_factor": 5.661, "standard_error": 1.008, "confidence_interval": [1.658, 9.665]}
NO_DECAY_ESTIMATE = {"strength_factor": 9.935, "standard_error": 2.341, "confidence_interval": [2.971, 16.9]}


class FittedMotion(Part):
    """Motion over time, as columns of equal length for the quantities of the request."""

    model_config = with_examples(PREDICTED, {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 7.122]})

    time_s: list[Num]
    """Time since first contact. [s]"""
    depth_displacement_m: list[Num] | MISSING = MISSING
    """Displacement of the centre of gravity along the inward normal of the face. [m]"""
    lateral_displacement_m: list[Num] | MISSING = MISSING
    """Displacement of the centre of gravity along the face. [m]"""
    rotation_deg: list[Num] | MISSING = MISSING
    """Change of the axis angle. [°]"""


class MotionMeasures(Part):
    """Measure of the quality of the fit, one number for each quantity of the request."""

    model_config = with_examples(ROOT_MEAN_SQUARE)

    depth_displacement_m: Num | MISSING = MISSING
    lateral_displacement_m: Num | MISSING = MISSING
    rotation_deg: Num | MISSING = MISSING


class ComparedMotion(Part):
    """Motion that the model predicts with one strength factor."""

    model_config = with_examples(
        {"strength_factor": 9.0, "history": {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 6.9]}}
    )

    strength_factor: StrengthFactorValue
    history: Annotated[
        FittedMotion,
        Field(description=f"Motion at the times of the request, at no more than {COMPARED_ROWS} of them."),
    ]


NAMES = {name.removesuffix(unit_end(name)): name for name in MotionMeasures.model_fields}
"""Names of the quantities of a motion in the contract, keyed by their names in the solver."""
FittedResiduals = Annotated[FittedMotion, Field(description="Given minus predicted values of the fitted rows.")]
Predicted = Annotated[FittedMotion, Field(description="Motion predicted with the fitted strength factor.")]
RootMeanSquare = Annotated[
    MotionMeasures, Field(description="Root mean square of the residuals, in the unit of the quantity.")
]
NormalizedRootMeanSquare = Annotated[
    Num,
    Field(
        ge=0.0,
        description="Root mean square of the residuals relative to the span of each quantity, over all weighted "
        "quantities of all runs. [1]",
    ),
]
RSquared = Annotated[
    MotionMeasures,
    Field(description="Share of the variance of each quantity that the model explains; absent for zero variance. [1]"),
]
Compared = Annotated[
    list[ComparedMotion], Field(description="Predicted motions for each of `compare_strength_factors`.")
]


class FittedRun(Part):
    """Fit of one of several runs with the common strength factor."""

    model_config = with_examples(MOTION | {"normalized_root_mean_square": 0.0019})

    residuals: FittedResiduals
    predicted: Annotated[Predicted, GIVEN]
    root_mean_square: Annotated[RootMeanSquare, GIVEN]
    r_squared: Annotated[RSquared, GIVEN]
    normalized_root_mean_square: NormalizedRootMeanSquare
    compared: Annotated[Compared | MISSING, GIVEN] = MISSING


class RunAlone(FittedStrength):
    """Strength factor fitted to one of several runs, without the others."""

    model_config = with_examples(ESTIMATE | {"normalized_root_mean_square": 0.0019})

    normalized_root_mean_square: NormalizedRootMeanSquare


class DecayLawRun(Part):
    """Fit of one of several runs with one decay law."""

    model_config = with_examples(
        {"normalized_root_mean_square": 0.0042, "alone": ESTIMATE | {"normalized_root_mean_square": 0.0019}}
    )

    normalized_root_mean_square: NormalizedRootMeanSquare
    """Normalised root mean square with the common strength factor. [1]"""
    alone: Annotated[RunAlone | MISSING, GIVEN] = MISSING
    """Fit to this run without the others; absent if the run does not determine the strength factor."""


class DecayLawFit(Part):
    """Best fit with one decay law. If the motion does not determine the strength factor, only the law is named."""

    model_config = with_examples(
        {"free_surface": "elastic_plastic"} | ESTIMATE | {"normalized_root_mean_square": 0.0019},
        {"free_surface": "none"},
    )

    free_surface: Annotated[FreeSurfaceModel, Of("free_surface.name")]
    strength_factor: Annotated[Annotated[Num, Field(gt=0.0)] | MISSING, Of("estimate.strength_factor")] = MISSING
    """Strength factor fitted to all runs. [1]"""
    standard_error: Annotated[StandardError | MISSING, Of("estimate.standard_error")] = MISSING
    confidence_interval: Annotated[ConfidenceInterval | MISSING, Of("estimate.confidence_interval")] = MISSING
    normalized_root_mean_square: NormalizedRootMeanSquare | MISSING = MISSING
    runs: Annotated[list[DecayLawRun] | MISSING, GIVEN] = MISSING
    """Fits of the `runs` of the request, in its order."""


class MotionCalibrationAnswer(FittedStrength):
    """Strength factor that fits motions best, with the requested decay law and with each of the other laws.

    `residuals`, `predicted`, `root_mean_square`, `r_squared` and `compared` belong to a single strike; if the request
    has `runs`, each of `runs` has its own.
    """

    model_config = with_examples(
        ESTIMATE
        | MOTION
        | {
            "normalized_root_mean_square": 0.0019,
            "decay_laws": [
                {"free_surface": "elastic_plastic"} | ESTIMATE | {"normalized_root_mean_square": 0.0019},
                {"free_surface": "mohr_coulomb"} | OTHER_ESTIMATE | {"normalized_root_mean_square": 0.1418},
                {"free_surface": "none"} | NO_DECAY_ESTIMATE | {"normalized_root_mean_square": 0.1951},
            ],
            "best_decay_law": "elastic_plastic",
            "warnings": [WARNING],
        }
        | VERSIONED
    )

    residuals: Annotated[FittedResiduals | MISSING, GIVEN] = MISSING
    predicted: Annotated[Predicted | MISSING, GIVEN] = MISSING
    root_mean_square: Annotated[RootMeanSquare | MISSING, GIVEN] = MISSING
    r_squared: Annotated[RSquared | MISSING, GIVEN] = MISSING
    compared: Annotated[Compared | MISSING, GIVEN] = MISSING
    normalized_root_mean_square: NormalizedRootMeanSquare
    runs: Annotated[list[FittedRun] | MISSING, GIVEN] = MISSING
    """Fits of the `runs` of the request, in its order."""
    decay_laws: Annotated[list[DecayLawFit], GIVEN]
    """Fits with each decay law, including the requested one."""
    best_decay_law: Annotated[FreeSurfaceModel, GIVEN]
    """Law with the least normalised root mean square."""
    warnings: Annotated[list[ModelWarning], GIVEN]
    key: Key
    engine_version: EngineVersion


def motion_answer(
    fits: DecayLawFits, compared: Sequence[Sequence[tuple[float, MotionHistory]]], *, several: bool
) -> dict[str, Any]:
    """Return the answer from the fits and, for each run, the motions with the strength factors to compare.

    If `several` is True, the answer has a list of runs, even of only one.
    """
    requested = fits.requested
    runs = [_run(fit, motions) for fit, motions in zip(requested.runs, compared, strict=True)]
    laws = [_decay_law(name, fit, several=several) for name, fit in fits.laws.items()]
    rest = walk(MotionCalibrationAnswer, requested, decay_laws=laws, best_decay_law=fits.best, warnings=fits.warnings)
    return walk(FittedStrength, requested) | ({"runs": runs} if several else runs[0]) | rest


def _run(fit: MotionFit, compared: Sequence[tuple[float, MotionHistory]]) -> dict[str, Any]:
    given, measures = fit.residuals.columns, fit.root_mean_square
    return walk(
        FittedRun,
        fit,
        predicted=_motion(fit.predicted, given),
        root_mean_square={NAMES[name]: float(in_unit(NAMES[name], value)) for name, value in measures.items()},
        r_squared={NAMES[name]: float(value) for name, value in fit.r_squared.items() if np.isfinite(value)},
        compared=[{"strength_factor": factor, "history": _motion(motion, given)} for factor, motion in compared],
    )


def _motion(motion: MotionHistory, quantities: Collection[str]) -> dict[str, Any]:
    """Return a motion as JSON data, with the given quantities only."""
    return walk(FittedMotion, MotionHistory(time=motion.time, **{name: motion.columns[name] for name in quantities}))


def _decay_law(name: str, fit: MotionsFit | None, *, several: bool) -> dict[str, Any]:
    if fit is None:
        return {"free_surface": name}
    runs = [walk(DecayLawRun, run, alone=alone) for run, alone in zip(fit.runs, fit.alone, strict=True)]
    return walk(DecayLawFit, fit, runs=runs if several else ())
