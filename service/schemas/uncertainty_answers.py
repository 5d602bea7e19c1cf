"""Models of the answers to uncertainty studies."""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, ClassVar

from pydantic import MISSING, Field
from typing_extensions import TypeAliasType

from service.columns import Column, unit_end
from service.schemas.answers import EXIT, VERSIONED, WARNING, EngineVersion, Key, ModelWarning
from service.schemas.fields import NOT_TABLED, WHOLE_ANSWER, walk
from service.schemas.quantities import Count, Num, Of, Part, degrees, with_examples
from solver import Outcome
from solver.uncertainty import (
    Estimate,
)

ESTIMATE = {"value": 0.22, "lower": 0.21, "upper": 0.23}
AFTER_SHOT = {"shots": 1, "strength_factor_dispersion": 0.115, "lower_deg": 44.5, "upper_deg": 50.4}
SAMPLED = {
    "convergence": {"samples": [266], "half_width": [0.013]},
    "converged": True,
    "samples": 266,
    "samples_failed": 0,
    "samples_outside": 0,
    "seed": 7,
    "warnings": [WARNING],
}
ANGLE_STUDY = (
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
STRIKE_STUDY = {"outcomes": [{"outcome": "ricochet"} | ESTIMATE], "maximum_depth_m": []} | SAMPLED | VERSIONED

TABLED = ("samples", "samples_failed", "samples_outside", "converged")
"""Last columns of the tables of both kinds of study."""


class EstimateAnswer(Part):
    """Estimate of a number with its confidence interval."""

    answered_last: ClassVar = ("value", "lower", "upper")

    model_config = with_examples(ESTIMATE)

    value: Num
    lower: Num
    upper: Num


class QuantileAnswer(EstimateAnswer):
    """Estimate of a quantile with its confidence interval."""

    model_config = with_examples({"level": 0.5, "value": 48.8, "lower": 48.7, "upper": 48.9})

    level: Annotated[Num, Field(ge=0.0, le=1.0)]
    """Level of the quantile: the share of samples below it. [1]"""


def in_degrees(estimate: Estimate | None) -> Estimate | None:
    """Convert the estimate of an angle to degrees."""
    return estimate and Estimate(*map(degrees, (estimate.value, estimate.lower, estimate.upper)))


def quantile_answers(found: Sequence[tuple[float, Estimate]], *, angle: bool = False) -> list[dict[str, Any]]:
    """Return quantiles with their levels as JSON data; `angle` converts them to degrees."""
    return [
        {"level": level} | walk(EstimateAnswer, in_degrees(estimate) if angle else estimate)
        for level, estimate in found
    ]


class ProbabilityCurve(Part):
    """Probability of ricochet over the oblique angle, as columns of equal length."""

    model_config = with_examples(
        {"oblique_angle_deg": [48.0], "ricochet_probability": [0.31], "lower": [0.30], "upper": [0.32]}
    )

    oblique_angle_deg: Annotated[list[Num], Of(lambda found: found.oblique_angles.tolist())]
    ricochet_probability: Annotated[list[Num], Of("probability")]
    lower: list[Num]
    upper: list[Num]


class CriticalAngleDistribution(Part):
    """Distribution of the critical angle over the samples that have one."""

    model_config = with_examples({"share_without_angle": {"value": 1.0, "lower": 0.98, "upper": 1.0}, "quantiles": []})

    mean_deg: Annotated[EstimateAnswer | MISSING, Of(lambda found: in_degrees(found.mean))] = MISSING
    standard_deviation_deg: Annotated[
        EstimateAnswer | MISSING, Of(lambda found: in_degrees(found.standard_deviation))
    ] = MISSING
    quantiles: Annotated[list[QuantileAnswer], Of(lambda found: quantile_answers(found.quantiles, angle=True))]
    """Quantiles of the critical angle. [°]"""
    share_without_angle: Annotated[EstimateAnswer, Of("share_without")]
    """Share of all samples without a critical angle. It includes `samples_failed` and `samples_outside`. [1]"""


InputValue = TypeAliasType("InputValue", Annotated[Num | str, Field(description="A number, or the name of a model.")])
"""Value of an uncertain input: a number, or the name of a model."""


class SwingAnswer(Part):
    """Critical angle with one input changed and the others at their median or most likely value."""

    model_config = with_examples({"value": 234.1, "critical_angle_deg": 48.5})

    value: InputValue
    """Value of the input: its 5 % or 95 % quantile, or a discrete value."""
    critical_angle_deg: Annotated[Num | MISSING, Of("angle")] = MISSING
    """Critical angle; absent if there is none. [°]"""


class AfterShotsAnswer(Part):
    """Expected range of the critical angle after a number of further shots into the same concrete."""

    model_config = with_examples(AFTER_SHOT)

    shots: Count
    strength_factor_dispersion: Annotated[Num, Of("dispersion")]
    """Standard deviation of ln S for the shot after these, at the given compressive strength. [1]"""
    lower_deg: Num
    """Lower end of the 90 % range, if the shots do not change the median of S. [°]"""
    upper_deg: Num
    """Upper end of the 90 % range, if the shots do not change the median of S. [°]"""


class SensitivityAnswer(Part):
    """Share of one input in the variance of the critical angle."""

    model_config = with_examples(
        {"field": "impact.velocity_m_s", "first_order": ESTIMATE, "total": ESTIMATE, "swing": [{"value": 234.1}]}
    )

    field: str
    first_order: EstimateAnswer | MISSING = MISSING
    """First-order Sobol index: share of the variance that the input explains alone. [1]"""
    total: EstimateAnswer | MISSING = MISSING
    """Total Sobol index: share of the variance that the input explains alone and through its interactions. [1]"""
    swing: list[SwingAnswer]
    after_shots: Annotated[list[AfterShotsAnswer] | MISSING, Of(lambda found: found.after_shots or None)] = MISSING
    """Expected range of the angle after one and after three further shots into the same concrete, given for a
    `resistance.strength_residual` with a `lognormal` or `log_student_t` distribution."""


class ConvergenceAnswer(Part):
    """History of the sampling, as columns of equal length."""

    model_config = with_examples({"samples": [266], "half_width": [0.013]})

    samples: Annotated[list[Count], Of(lambda found: [each.samples for each in found.convergence])]
    half_width: Annotated[list[Num], Of(lambda found: [each.half_width for each in found.convergence])]
    """Largest half width of the confidence intervals of the probabilities. [1]"""


class UncertaintyAnswer(Part):
    """Base class of the answers to uncertainty studies."""

    answered_last: ClassVar = tuple(SAMPLED)

    convergence: Annotated[ConvergenceAnswer, WHOLE_ANSWER]
    converged: Annotated[
        bool,
        Column("converged", "true if every interval is within the requested half width", "?"),
    ]
    """True if every interval is within the requested half width."""
    samples: Annotated[Count, Column("samples", "number of searches or runs", "<i8")]
    """Number of searches or runs."""
    samples_failed: Annotated[
        Count, Of("failed"), Column("samples_failed", "number of samples that could not be computed", "<i8")
    ]
    """Number of samples that could not be computed."""
    samples_outside: Annotated[
        Count,
        Of("outside"),
        Column("samples_outside", "number of samples outside the accepted range of an input", "<i8"),
    ]
    """Number of samples outside the accepted range of an input. They count as unknown, like failed ones."""
    seed: Annotated[Count, NOT_TABLED]
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


class StudyProgress(Part):
    """Progress of an uncertainty study."""

    model_config = with_examples(
        {"samples": 1024, "max_samples": 16384, "half_width": 0.031, "requested_half_width": 0.02}
    )

    samples: Count
    """Number of searches or runs computed so far."""
    max_samples: Count
    """Largest number of searches or runs. The study ends earlier if it reaches the requested half width."""
    half_width: Num | MISSING = MISSING
    """Largest half width of the confidence intervals of the probabilities so far. [1]"""
    requested_half_width: Num
    """Half width at which the study ends. [1]"""


class UncertaintyMethod(StrEnum):
    """Method by which probabilities were computed."""

    SURROGATE = "surrogate"
    DIRECT = "direct"


class CriticalAngleUncertaintyAnswer(UncertaintyAnswer):
    """Answer to an uncertainty study of a critical angle."""

    model_config = with_examples(ANGLE_STUDY)

    answered_last: ClassVar = ("sensitivity", *SAMPLED)
    tabled = ("critical_angle", "method", *TABLED)

    probability: Annotated[ProbabilityCurve, WHOLE_ANSWER]
    critical_angle: Annotated[
        CriticalAngleDistribution,
        WHOLE_ANSWER,
        Column("mean_deg", "mean of the critical angle"),
        Column("standard_deviation_deg", "standard deviation of the critical angle"),
    ]
    sensitivity: list[SensitivityAnswer] | MISSING = MISSING
    """Sensitivity to each input, if requested."""
    method: UncertaintyMethod
    """Method of estimation: `surrogate` is a polynomial chaos of the angle, `direct` counts the outcomes of randomised
    Sobol points."""
    polynomial_order: Annotated[Count | MISSING, Of("order"), NOT_TABLED] = MISSING
    """Order of the surrogate."""
    surrogate_error_deg: Annotated[Num | MISSING, NOT_TABLED] = MISSING
    """Root mean square error of the surrogate at held-out points, also given if it was so large that the
    surrogate was not used. [°]"""


class OutcomeProbability(EstimateAnswer):
    """Probability of one outcome, with its confidence interval."""

    model_config = with_examples({"outcome": "ricochet"} | ESTIMATE)

    outcome: Outcome


class FlightQuantilesAnswer(Part):
    """Quantiles of the flight of projectiles that leave the target, each quantity as in the `flight` of an exit."""

    model_config = with_examples({"range_m": [], "farthest_range_m": []})

    range_m: list[QuantileAnswer]
    """Distance of the landing point in the computed direction of exit. [m]"""
    farthest_range_m: list[QuantileAnswer]
    """Greatest distance over all elevations at the speed of exit. [m]"""


class ExitQuantilesAnswer(Part):
    """Quantiles of the state of projectiles at the exit, each quantity as in the `exit` of a trajectory."""

    model_config = with_examples({name: [] for name in EXIT})

    speed_m_s: list[QuantileAnswer]
    direction_deg: list[QuantileAnswer]
    elevation_deg: list[QuantileAnswer]
    axis_angle_deg: list[QuantileAnswer]
    angular_velocity_rad_s: list[QuantileAnswer]
    kinetic_energy_j: list[QuantileAnswer]
    lateral_m: list[QuantileAnswer]
    flight: FlightQuantilesAnswer | MISSING = MISSING
    """Quantiles of the flight, in the answer to a study with `flight`."""


QuantilesByName = Mapping[str, Sequence[tuple[float, Estimate]]]


def exit_answer(found: QuantilesByName, flight: QuantilesByName | None = None) -> dict[str, Any]:
    """Return the quantiles of exits, keyed by their names in the contract; empty if no projectile left the target."""
    flown = _by_contract(FlightQuantilesAnswer, flight or {})
    return _by_contract(ExitQuantilesAnswer, found) | ({"flight": flown} if flown else {})


def _by_contract(model: type[Part], found: QuantilesByName) -> dict[str, Any]:
    names = {name: name.removesuffix(unit_end(name)) for name in model.model_fields}
    return {
        name: quantile_answers(found[own], angle=name.endswith("_deg")) for name, own in names.items() if own in found
    }


class TrajectoryUncertaintyAnswer(UncertaintyAnswer):
    """Answer to an uncertainty study of the outcome of one strike."""

    model_config = with_examples(STRIKE_STUDY)

    tabled = ("outcomes", *TABLED)

    outcomes: Annotated[
        list[OutcomeProbability],
        Of(lambda found: [{"outcome": name} | walk(EstimateAnswer, share) for name, share in found.outcomes]),
        tuple(Column(each.value, f"probability of the outcome {each.value}") for each in Outcome),
    ]
    maximum_depth_m: Annotated[list[QuantileAnswer], Of(lambda found: quantile_answers(found.maximum_depth))]
    """Quantiles of the greatest depth of the deepest point, over the runs that do not perforate. [m]"""
    ricochet_exit: Annotated[
        ExitQuantilesAnswer | MISSING, Of(lambda found: exit_answer(found.ricochet_exit, found.ricochet_flight))
    ] = MISSING
    """Quantiles of the exit of projectiles that ricochet, if there are any."""
    perforation_exit: Annotated[
        ExitQuantilesAnswer | MISSING, Of(lambda found: exit_answer(found.perforation_exit, found.perforation_flight))
    ] = MISSING
    """Quantiles of the exit of projectiles that perforate, if there are any."""
    exit_speed_m_s: Annotated[
        list[QuantileAnswer] | MISSING, Of(lambda found: exit_answer(found.ricochet_exit).get("speed_m_s"))
    ] = MISSING
    """Repeats `speed_m_s` of `ricochet_exit`. [m/s]"""
    exit_angle_deg: Annotated[
        list[QuantileAnswer] | MISSING, Of(lambda found: exit_answer(found.ricochet_exit).get("direction_deg"))
    ] = MISSING
    """Repeats `direction_deg` of `ricochet_exit`. [°]"""
    residual_speed_m_s: Annotated[
        list[QuantileAnswer] | MISSING, Of(lambda found: exit_answer(found.perforation_exit).get("speed_m_s"))
    ] = MISSING
    """Repeats `speed_m_s` of `perforation_exit`. [m/s]"""


class PartialUncertainty(Part):
    """Partial answer to an uncertainty study, from the samples so far."""

    model_config = with_examples(
        {
            "outcomes": [{"outcome": "ricochet"} | ESTIMATE],
            "convergence": {"samples": [266], "half_width": [0.013]},
        }
    )

    probability: ProbabilityCurve | MISSING = MISSING
    """Probability curve of a study of critical angles."""
    outcomes: list[OutcomeProbability] | MISSING = MISSING
    """Probabilities of the outcomes in a study of one strike."""
    convergence: ConvergenceAnswer
