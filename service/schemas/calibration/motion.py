"""Strength factor from the motion of a projectile, as the contract has it."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import MISSING, ConfigDict, Field

from service.schemas.answers import VERSIONED, WARNING, EngineVersion, Key, ModelWarning
from service.schemas.building import warnings_told
from service.schemas.calibration.shared import Calibration, FittedStrength, StrengthFactorValue, estimate_told
from service.schemas.projectile import PROJECTILE
from service.schemas.quantities import Flag, Num, Part, with_examples
from service.schemas.requests import MOST_ROWS
from service.schemas.strike import STRIKE, TARGET, Impact
from solver.arrays import FloatArray
from solver.calibration import MotionFit, MotionHistory, Weights
from solver.errors import ParameterError

COMPARED_ROWS = 1000
"""Of a motion that is only compared: a curve needs no more."""
NAMES = {
    "depth_displacement": "depth_displacement_m",
    "lateral_displacement": "lateral_displacement_m",
    "rotation": "rotation_deg",
}
"""The quantities of a motion in the solver and in the contract."""

AT_30: dict[str, Any] = {
    "time_s": [0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025],
    "depth_displacement_m": [0.0, 0.098, 0.173, 0.226, 0.252, 0.256],
    "lateral_displacement_m": [0.0, 0.06, 0.111, 0.147, 0.169, 0.173],
    "rotation_deg": [0.0, 1.9, 7.1, 11.0, 11.6, 11.6],
}
"""What the model gives with a strength factor of 7.91."""
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

Time = Annotated[Num, Field(ge=0.0, le=1.0)]
Displacement = Annotated[Num, Field(ge=-1000.0, le=1000.0)]
Rotation = Annotated[Num, Field(ge=-36_000.0, le=36_000.0)]
DisplacementColumn = Annotated[list[Displacement], Field(min_length=2, max_length=MOST_ROWS, fail_fast=True)]


class MotionRecord(Part):
    """How a projectile moved since first contact: columns of equal length, at least one beside the time."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [AT_30, {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 7.1]}],
            "minProperties": 2,
        }
    )

    time_s: Annotated[
        list[Time],
        Field(min_length=2, max_length=MOST_ROWS, fail_fast=True, description="Since first contact, increasing. [s]"),
    ]
    depth_displacement_m: (
        Annotated[
            DisplacementColumn, Field(description="Of the centre of gravity, along the inward normal of the face. [m]")
        ]
        | MISSING
    ) = MISSING
    lateral_displacement_m: (
        Annotated[
            DisplacementColumn,
            Field(description="Of the centre of gravity along the face, the way the projectile travels. [m]"),
        ]
        | MISSING
    ) = MISSING
    rotation_deg: (
        Annotated[
            list[Rotation],
            Field(
                min_length=2,
                max_length=MOST_ROWS,
                fail_fast=True,
                description="Change of the axis angle; positive as the nose turns toward the face. [°]",
            ),
        ]
        | MISSING
    ) = MISSING

    def to_solver(self) -> MotionHistory:
        """Return the solver's history."""
        depth, lateral, rotation = self.depth_displacement_m, self.lateral_displacement_m, self.rotation_deg
        return MotionHistory(
            time=np.array(self.time_s),
            depth_displacement=None if depth is MISSING else np.array(depth),
            lateral_displacement=None if lateral is MISSING else np.array(lateral),
            rotation=None if rotation is MISSING else np.radians(rotation),
        )


class MotionWeights(Part):
    """Weights of the squared residuals of the quantities, relative, after each is scaled by its span."""

    model_config = with_examples({"depth": 1.0, "lateral": 1.0, "rotation": 0.5})

    depth: Annotated[Num, Field(ge=0.0, le=1e6, description="[1]")] = 1.0
    lateral: Annotated[Num, Field(ge=0.0, le=1e6, description="[1]")] = 1.0
    rotation: Annotated[Num, Field(ge=0.0, le=1e6, description="[1]")] = 1.0

    def to_solver(self) -> Weights:
        """Return the solver's weights."""
        return Weights(depth=self.depth, lateral=self.lateral, rotation=self.rotation)


class MotionCalibrationRequest(Calibration):
    """One strike, and how the projectile moved: as measured, or from a finite element run."""

    model_config = with_examples(
        {
            "projectile": PROJECTILE,
            "target": TARGET,
            "impact": STRIKE | {"oblique_angle_deg": 30.0},
            "history": AT_30,
        },
        {
            "projectile": PROJECTILE,
            "target": TARGET,
            "impact": STRIKE | {"oblique_angle_deg": 30.0},
            "history": AT_30,
            "weights": {"rotation": 0.0},
            "until_s": 0.0015,
            "compare_strength_factors": [7.0, 9.0],
        },
    )

    impact: Impact
    history: MotionRecord
    weights: Annotated[MotionWeights, Field(default_factory=MotionWeights)]
    until_s: (
        Annotated[Num, Field(gt=0.0, le=1.0, description="Uses the rows up to this time, itself included. [s]")]
        | MISSING
    ) = MISSING
    until_greatest_depth: Annotated[
        Flag, Field(description="Uses the rows up to the greatest depth, itself included; not together with `until_s`.")
    ] = False

    def used(self) -> MotionHistory:
        """Return the rows to fit.

        Raises
        ------
        ParameterError
            If there are none.
        """
        history = self.history.to_solver()
        if self.until_greatest_depth:
            if self.until_s is not MISSING:
                raise ParameterError("until_greatest_depth", "must not be asked for together with until_s")
            return history.until(history.time_of_greatest_depth)
        if self.until_s is MISSING:
            return history
        if self.until_s < history.time[1]:
            raise ParameterError("until", f"must leave two rows or more, got {self.until_s:g} s")
        return history.until(self.until_s)

    def arguments(self) -> tuple[dict[str, Any], tuple[float, ...], FloatArray]:
        """Return the arguments of `fit_motion`, the strength factors to compare, and the times of their motions.

        Raises
        ------
        ParameterError
            If values do not go together.
        """
        used = self.used()
        fit = self.model_arguments() | {
            "impact": self.impact.to_solver(),
            "history": used,
            "weights": self.weights.to_solver(),
            "confidence_level": self.confidence_level,
        }
        rows = np.unique(np.linspace(0, used.time.size - 1, COMPARED_ROWS).round().astype(int))
        return fit, self.compared(), used.time[rows]


class FittedMotion(Part):
    """Columns of equal length, for the quantities that were given."""

    model_config = with_examples(PREDICTED, {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 7.122]})

    time_s: Annotated[list[Num], Field(description="Since first contact. [s]")]
    depth_displacement_m: Annotated[list[Num], Field(description="[m]")] | MISSING = MISSING
    lateral_displacement_m: Annotated[list[Num], Field(description="[m]")] | MISSING = MISSING
    rotation_deg: Annotated[list[Num], Field(description="[°]")] | MISSING = MISSING


class MotionMeasures(Part):
    """A number for each quantity that was given."""

    model_config = with_examples(ROOT_MEAN_SQUARE)

    depth_displacement_m: Num | MISSING = MISSING
    lateral_displacement_m: Num | MISSING = MISSING
    rotation_deg: Num | MISSING = MISSING


class ComparedMotion(Part):
    """The motion that the model predicts with one strength factor."""

    model_config = with_examples(
        {"strength_factor": 9.0, "history": {"time_s": [0.0, 0.001], "rotation_deg": [0.0, 6.9]}}
    )

    strength_factor: StrengthFactorValue
    history: Annotated[
        FittedMotion, Field(description=f"At the times of the request; at {COMPARED_ROWS} of them if there are more.")
    ]


class MotionCalibrationAnswer(FittedStrength):
    """The strength factor that fits a motion best."""

    model_config = with_examples(
        {
            "strength_factor": 7.895,
            "standard_error": 0.0095,
            "confidence_interval": [7.875, 7.916],
            "residuals": RESIDUALS,
            "predicted": PREDICTED,
            "root_mean_square": ROOT_MEAN_SQUARE,
            "r_squared": {
                "depth_displacement_m": 0.99998,
                "lateral_displacement_m": 0.99998,
                "rotation_deg": 0.99996,
            },
            "warnings": [WARNING],
        }
        | VERSIONED
    )

    residuals: Annotated[FittedMotion, Field(description="Given minus predicted, of the rows that were used.")]
    predicted: Annotated[FittedMotion, Field(description="With the strength factor that fits best.")]
    root_mean_square: Annotated[MotionMeasures, Field(description="Of the residuals, in the unit of the quantity.")]
    r_squared: Annotated[
        MotionMeasures,
        Field(description="Share of the variance of each quantity that the model explains; absent if it has none. [1]"),
    ]
    compared: (
        Annotated[list[ComparedMotion], Field(description="If strength factors to compare are given.")] | MISSING
    ) = MISSING
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


def motion_answer(fit: MotionFit, compared: Sequence[tuple[float, MotionHistory]]) -> dict[str, Any]:
    """Return the answer from a fit and the motions with the strength factors to compare."""
    given = [name for name in NAMES if getattr(fit.residuals, name) is not None]
    answer = estimate_told(fit.estimate) | {
        "residuals": _columns(fit.residuals, given),
        "predicted": _columns(fit.predicted, given),
        "root_mean_square": _measures(_in_degrees(fit.root_mean_square)),
        "r_squared": _measures(fit.r_squared),
    }
    if compared:
        answer["compared"] = [
            {"strength_factor": factor, "history": _columns(motion, given)} for factor, motion in compared
        ]
    return answer | {"warnings": warnings_told(fit.warnings)}


def _columns(motion: MotionHistory, quantities: Sequence[str]) -> dict[str, list[float]]:
    columns = _in_degrees({name: getattr(motion, name) for name in quantities})
    return {"time_s": motion.time.tolist()} | {NAMES[name]: column.tolist() for name, column in columns.items()}


def _in_degrees(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.degrees(value) if name == "rotation" else value for name, value in values.items()}


def _measures(values: Mapping[str, float]) -> dict[str, float]:
    return {NAMES[name]: float(value) for name, value in values.items() if np.isfinite(value)}
