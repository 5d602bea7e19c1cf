"""Answers of how sure an angle or an outcome is."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any

from pydantic import MISSING, Field
from typing_extensions import TypeAliasType

from service.schemas.answers import VERSIONED, WARNING, EngineVersion, Key, ModelWarning
from service.schemas.building import EXIT_NAMES, warning_texts
from service.schemas.quantities import Count, Num, Part, degrees, with_examples
from solver import Outcome
from solver.uncertainty import (
    AngleUncertainty,
    Estimate,
    TrajectoryUncertainty,
)

ESTIMATE = {"value": 0.22, "lower": 0.21, "upper": 0.23}


class EstimateAnswer(Part):
    """A number with its interval."""

    model_config = with_examples(ESTIMATE)

    value: Num
    lower: Num
    upper: Num


class QuantileAnswer(EstimateAnswer):
    """A quantile with its interval."""

    model_config = with_examples({"level": 0.5, "value": 48.8, "lower": 48.7, "upper": 48.9})

    level: Annotated[Num, Field(ge=0.0, le=1.0)]
    """Share of the samples below it."""


class ProbabilityCurve(Part):
    """Probability of ricochet over the oblique angle, columns of equal length."""

    model_config = with_examples(
        {"oblique_angle_deg": [48.0], "ricochet_probability": [0.31], "lower": [0.30], "upper": [0.32]}
    )

    oblique_angle_deg: list[Num]
    ricochet_probability: list[Num]
    lower: list[Num]
    upper: list[Num]


class CriticalAngleDistribution(Part):
    """The critical angle of the samples that have one. [°]"""

    model_config = with_examples({"share_without_angle": {"value": 1.0, "lower": 0.98, "upper": 1.0}, "quantiles": []})

    mean_deg: EstimateAnswer | MISSING = MISSING
    standard_deviation_deg: EstimateAnswer | MISSING = MISSING
    quantiles: list[QuantileAnswer]
    """[°]"""
    share_without_angle: EstimateAnswer
    """Share of all samples with an outcome."""


InputValue = TypeAliasType("InputValue", Annotated[Num | str, Field(description="A number, or the name of a model.")])
"""Value of an input."""


class SwingAnswer(Part):
    """Critical angle with one input changed and the others at their median or likeliest value."""

    model_config = with_examples({"value": 234.1, "critical_angle_deg": 48.5})

    value: InputValue
    """Value of the input: its 5 % and 95 % quantiles, or each discrete value."""
    critical_angle_deg: Num | MISSING = MISSING
    """If there is one. [°]"""


class SensitivityAnswer(Part):
    """Share of one input in the variance of the critical angle."""

    model_config = with_examples(
        {"field": "impact.velocity_m_s", "first_order": ESTIMATE, "total": ESTIMATE, "swing": [{"value": 234.1}]}
    )

    field: str
    first_order: EstimateAnswer | MISSING = MISSING
    """Share of the input alone. [1]"""
    total: EstimateAnswer | MISSING = MISSING
    """Share with its interactions. [1]"""
    swing: list[SwingAnswer]


class ConvergenceAnswer(Part):
    """History of the sampling, columns of equal length."""

    model_config = with_examples({"samples": [266], "half_width": [0.013]})

    samples: list[Count]
    half_width: list[Num]
    """Largest of all intervals of a probability. [1]"""


class UncertaintyAnswer(Part):
    """What both answers have in common."""

    convergence: ConvergenceAnswer
    converged: bool
    """Whether every interval is within the half width wanted."""
    samples: Count
    """Searches or runs."""
    samples_failed: Count
    """Those that could not be computed."""
    samples_outside: Count
    """Those outside the accepted range: they count as not known, as failed ones do."""
    seed: Count
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


class StudyProgress(Part):
    """How far a study of uncertainty is."""

    model_config = with_examples(
        {"samples": 1024, "max_samples": 16384, "half_width": 0.031, "requested_half_width": 0.02}
    )

    samples: Count
    """Searches or runs done."""
    max_samples: Count
    """At most; it ends earlier if the half width is reached."""
    half_width: Num | MISSING = MISSING
    """Reached: largest of all intervals of a probability. [1]"""
    requested_half_width: Num
    """At which it ends. [1]"""


SAMPLED = {
    "convergence": {"samples": [266], "half_width": [0.013]},
    "converged": True,
    "samples": 266,
    "samples_failed": 0,
    "samples_outside": 0,
    "seed": 7,
    "warnings": [WARNING],
}


class UncertaintyMethod(StrEnum):
    """How probabilities were computed."""

    SURROGATE = "surrogate"
    DIRECT = "direct"


class CriticalAngleUncertaintyAnswer(UncertaintyAnswer):
    """How sure a critical angle is."""

    model_config = with_examples(
        {
            "probability": {
                "oblique_angle_deg": [48.0],
                "ricochet_probability": [0.31],
                "lower": [0.30],
                "upper": [0.32],
            },
            "critical_angle": {"quantiles": [], "share_without_angle": ESTIMATE},
            "method": "surrogate",
            "polynomial_order": 3,
            "surrogate_error_deg": 0.009,
        }
        | SAMPLED
        | VERSIONED
    )

    probability: ProbabilityCurve
    critical_angle: CriticalAngleDistribution
    sensitivity: list[SensitivityAnswer] | MISSING = MISSING
    """If wanted."""
    method: UncertaintyMethod
    """`surrogate`: a polynomial chaos of the angle; `direct`: outcomes of randomised Sobol points."""
    polynomial_order: Count | MISSING = MISSING
    """Order of the surrogate."""
    surrogate_error_deg: Num | MISSING = MISSING
    """Root mean square at held-out points, also where it was too large. [°]"""


class OutcomeProbability(EstimateAnswer):
    """Probability of one outcome."""

    model_config = with_examples({"outcome": "ricochet"} | ESTIMATE)

    outcome: Outcome


EXIT_QUANTILES: dict[str, Any] = {name: [] for name in EXIT_NAMES.values()}


class ExitQuantilesAnswer(Part):
    """Quantiles of how projectiles leave the target, each quantity as in the `exit` of a trajectory."""

    model_config = with_examples(EXIT_QUANTILES)

    speed_m_s: list[QuantileAnswer]
    direction_deg: list[QuantileAnswer]
    elevation_deg: list[QuantileAnswer]
    axis_angle_deg: list[QuantileAnswer]
    angular_velocity_rad_s: list[QuantileAnswer]
    kinetic_energy_j: list[QuantileAnswer]
    lateral_m: list[QuantileAnswer]


class TrajectoryUncertaintyAnswer(UncertaintyAnswer):
    """How sure the outcome of one strike is."""

    model_config = with_examples(
        {"outcomes": [{"outcome": "ricochet"} | ESTIMATE], "maximum_depth_m": []} | SAMPLED | VERSIONED
    )

    outcomes: list[OutcomeProbability]
    maximum_depth_m: list[QuantileAnswer]
    """Quantiles over all runs. [m]"""
    ricochet_exit: ExitQuantilesAnswer | MISSING = MISSING
    """Exit of those turned away, if any."""
    perforation_exit: ExitQuantilesAnswer | MISSING = MISSING
    """Exit of those that perforated, if any."""
    exit_speed_m_s: list[QuantileAnswer] | MISSING = MISSING
    """`speed_m_s` of `ricochet_exit`. [m/s]"""
    exit_angle_deg: list[QuantileAnswer] | MISSING = MISSING
    """`direction_deg` of `ricochet_exit`. [°]"""
    residual_speed_m_s: list[QuantileAnswer] | MISSING = MISSING
    """`speed_m_s` of `perforation_exit`. [m/s]"""


class PartialUncertainty(Part):
    """Answer to a study from the samples so far."""

    model_config = with_examples(
        {
            "outcomes": [{"outcome": "ricochet"} | ESTIMATE],
            "convergence": {"samples": [266], "half_width": [0.013]},
        }
    )

    probability: ProbabilityCurve | MISSING = MISSING
    """Probability curve of a study of critical angles."""
    outcomes: list[OutcomeProbability] | MISSING = MISSING
    """Outcomes of a study of one strike."""
    convergence: ConvergenceAnswer


def _estimate(estimate: Estimate, *, angle: bool = False) -> dict[str, float]:
    turn = degrees if angle else float
    return {"value": turn(estimate.value), "lower": turn(estimate.lower), "upper": turn(estimate.upper)}


def _quantiles(found: Sequence[tuple[float, Estimate]], *, angle: bool = False) -> list[dict[str, float]]:
    return [{"level": level} | _estimate(estimate, angle=angle) for level, estimate in found]


def _sampled(found: AngleUncertainty | TrajectoryUncertainty) -> dict[str, Any]:
    return {
        "convergence": {
            "samples": [each.samples for each in found.convergence],
            "half_width": [each.half_width for each in found.convergence],
        },
        "converged": found.converged,
        "samples": found.samples,
        "samples_failed": found.failed,
        "samples_outside": found.outside,
        "seed": found.seed,
        "warnings": warning_texts(found.warnings),
    }


def critical_angle_uncertainty_answer(found: AngleUncertainty) -> dict[str, Any]:
    """Return the answer without key and version."""
    angle: dict[str, Any] = {}
    for name, estimate in (("mean_deg", found.mean), ("standard_deviation_deg", found.standard_deviation)):
        if estimate is not None:
            angle[name] = _estimate(estimate, angle=True)
    answer: dict[str, Any] = {
        "probability": {
            "oblique_angle_deg": [degrees(each) for each in found.oblique_angles.tolist()],
            "ricochet_probability": found.probability.tolist(),
            "lower": found.lower.tolist(),
            "upper": found.upper.tolist(),
        },
        "critical_angle": angle
        | {
            "quantiles": _quantiles(found.quantiles, angle=True),
            "share_without_angle": _estimate(found.share_without),
        },
        "method": found.method,
    }
    if found.order is not None:
        answer["polynomial_order"] = found.order
    if found.surrogate_error is not None:
        answer["surrogate_error_deg"] = degrees(found.surrogate_error)
    if found.sensitivity:
        answer["sensitivity"] = [
            {
                "field": each.field,
                **{
                    name: _estimate(estimate)
                    for name, estimate in (("first_order", each.first_order), ("total", each.total))
                    if estimate is not None
                },
                "swing": [
                    {"value": change.value}
                    | ({} if change.angle is None else {"critical_angle_deg": degrees(change.angle)})
                    for change in each.swing
                ],
            }
            for each in found.sensitivity
        ]
    return answer | _sampled(found)


def trajectory_uncertainty_answer(found: TrajectoryUncertainty) -> dict[str, Any]:
    """Return the answer without key and version."""
    answer: dict[str, Any] = {
        "outcomes": [{"outcome": name} | _estimate(estimate) for name, estimate in found.outcomes],
        "maximum_depth_m": _quantiles(found.maximum_depth),
    }
    for name, exits in (("ricochet_exit", found.ricochet_exit), ("perforation_exit", found.perforation_exit)):
        if exits:
            answer[name] = {to: _quantiles(exits[own], angle=to.endswith("_deg")) for own, to in EXIT_NAMES.items()}
    if found.ricochet_exit:
        answer["exit_speed_m_s"] = answer["ricochet_exit"]["speed_m_s"]
        answer["exit_angle_deg"] = answer["ricochet_exit"]["direction_deg"]
    if found.perforation_exit:
        answer["residual_speed_m_s"] = answer["perforation_exit"]["speed_m_s"]
    return answer | _sampled(found)
