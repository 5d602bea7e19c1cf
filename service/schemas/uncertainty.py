"""Uncertain inputs, and how sure an angle is, as the contract has them."""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from functools import partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import MISSING, BaseModel, Field, StringConstraints, ValidationError, model_validator
from pydantic_core import PydanticCustomError
from typing_extensions import TypeAliasType

from service.schemas.answers import VERSIONED, WARNING, EngineVersion, Key, ModelWarning
from service.schemas.building import EXIT_NAMES, exit_in, warning_texts
from service.schemas.examples import PAPER, PAPER_AT_45
from service.schemas.numerics import Search
from service.schemas.quantities import WHOLE, Count, Flag, Num, Part, degrees, with_examples
from service.schemas.requests import Case, CriticalAngleBase, TrajectoryFields
from service.schemas.resistance import STRENGTH_FACTORS, FreeSurface, Resistance
from service.schemas.strike import Impact, Strike
from service.schemas.sweeps import check_field, put
from solver import Outcome, ParameterError
from solver.arrays import FloatArray
from solver.uncertainty import (
    RESIDUAL,
    AngleStudy,
    AngleUncertainty,
    Crossings,
    Discrete,
    Distribution,
    Ending,
    Estimate,
    Lognormal,
    Normal,
    Sampling,
    TrajectoryStudy,
    TrajectoryUncertainty,
    Triangular,
    TruncatedNormal,
    Uncertain,
    Uniform,
    scaled,
)
from solver.uncertainty.inputs import check_values

SAMPLING = Sampling()
MOST_SAMPLES = 131_072
"""In one request: some minutes of two cores."""
MODELS = ("resistance.free_surface.model", "resistance.strength_factor.model")
"""Fields whose alternatives are names."""
SPEEDS = {"type": "normal", "mean": 238.0, "coefficient_of_variation": 0.02}
STRENGTHS = {"type": "lognormal", "median": 39e6, "dispersion": 0.12}
DECAYS = {"type": "discrete", "values": ["elastic_plastic", "mohr_coulomb"], "weights": [0.8, 0.2]}
SCATTER = [
    {"field": "impact.velocity_m_s", "distribution": SPEEDS},
    {"field": "target.compressive_strength_pa", "distribution": STRENGTHS},
    {"field": "resistance.free_surface.model", "distribution": DECAYS},
]

Finite = Annotated[Num, Field(ge=-1e300, le=1e300)]


class Spread(Part):
    """A mean with a standard deviation or a coefficient of variation."""

    mean: Finite
    standard_deviation: Annotated[Finite, Field(description="In the unit of the field.")] | MISSING = MISSING
    coefficient_of_variation: Annotated[Finite, Field(description="Instead of it: over the mean. [1]")] | MISSING = (
        MISSING
    )


class NormalDistribution(Spread):
    """Normal distribution."""

    model_config = with_examples(SPEEDS)

    type: Literal["normal"]

    def to_solver(self) -> Normal:
        """Return the solver's distribution."""
        return Normal(**_given(self))


class TruncatedNormalDistribution(Spread):
    """Normal distribution cut off at one or two bounds; mean and deviation are those before that."""

    model_config = with_examples(
        {"type": "truncated_normal", "mean": 0.02, "standard_deviation": 0.01, "lower": 0.005, "upper": 0.05}
    )

    type: Literal["truncated_normal"]
    lower: Finite | MISSING = MISSING
    upper: Finite | MISSING = MISSING

    def to_solver(self) -> TruncatedNormal:
        """Return the solver's distribution."""
        return TruncatedNormal(**_given(self))


class LognormalDistribution(Part):
    """A number whose logarithm is normal: by median and dispersion, or by mean and deviation of the number itself."""

    model_config = with_examples(STRENGTHS)

    type: Literal["lognormal"]
    median: Finite | MISSING = MISSING
    dispersion: Annotated[Finite, Field(description="Standard deviation of the natural logarithm. [1]")] | MISSING = (
        MISSING
    )
    mean: Finite | MISSING = MISSING
    standard_deviation: Annotated[Finite, Field(description="In the unit of the field.")] | MISSING = MISSING
    coefficient_of_variation: Annotated[Finite, Field(description="Instead of it: over the mean. [1]")] | MISSING = (
        MISSING
    )

    def to_solver(self) -> Lognormal:
        """Return the solver's distribution."""
        return Lognormal(**_given(self))


class UniformDistribution(Part):
    """Every value between two bounds is as likely."""

    model_config = with_examples({"type": "uniform", "lower": 2200.0, "upper": 2400.0})

    type: Literal["uniform"]
    lower: Finite
    upper: Finite

    def to_solver(self) -> Uniform:
        """Return the solver's distribution."""
        return Uniform(**_given(self))


class TriangularDistribution(Part):
    """A density that rises from the lower bound to the mode and falls to the upper bound."""

    model_config = with_examples({"type": "triangular", "lower": 12.9, "mode": 13.0, "upper": 13.2})

    type: Literal["triangular"]
    lower: Finite
    mode: Finite
    upper: Finite

    def to_solver(self) -> Triangular:
        """Return the solver's distribution."""
        return Triangular(**_given(self))


Name = Annotated[str, StringConstraints(strict=True, min_length=1, max_length=100)]


DiscreteValues = TypeAliasType(
    "DiscreteValues",
    Annotated[
        list[Finite] | list[Name], Field(min_length=1, max_length=100, description="Numbers, or names of models.")
    ],
)
"""What a discrete distribution chooses from."""


class DiscreteDistribution(Part):
    """Some values, each with its weight: numbers, or names of models."""

    model_config = with_examples(DECAYS)

    type: Literal["discrete"]
    values: DiscreteValues
    weights: (
        Annotated[
            list[Finite],
            Field(min_length=1, max_length=100, description="Probabilities; they sum to 1. Equal when not given."),
        ]
        | MISSING
    ) = MISSING

    def to_solver(self) -> Discrete:
        """Return the solver's distribution."""
        return Discrete(**_given(self))


DistributionOf = TypeAliasType(
    "DistributionOf",
    Annotated[
        NormalDistribution
        | TruncatedNormalDistribution
        | LognormalDistribution
        | UniformDistribution
        | TriangularDistribution
        | DiscreteDistribution,
        Field(discriminator="type", description="In the unit of the field."),
    ],
)


def _given(part: Part) -> dict[str, Any]:
    return part.model_dump(exclude={"type"})


class UncertainInput(Part):
    """An input that scatters, independent of the others."""

    model_config = with_examples(*SCATTER)

    field: Annotated[
        str,
        StringConstraints(strict=True, min_length=1, max_length=200),
        Field(
            description="Dotted path to a number of the request, such as `impact.velocity_m_s`; "
            "`resistance.free_surface.model` or `resistance.strength_factor.model` with names; "
            f"`{RESIDUAL}`, a factor on the strength factor whatever its law."
        ),
    ]
    distribution: DistributionOf


class AngleRange(Part):
    """Angles at even distances, both ends included."""

    model_config = with_examples({"start": 30.0, "stop": 70.0, "count": 81})

    start: Annotated[Num, Field(ge=0.0, lt=90.0, description="[°]")] = 5.0
    stop: Annotated[Num, Field(ge=0.0, lt=90.0, description="[°]")] = 85.0
    count: Annotated[Count, Field(ge=2, le=2001), WHOLE] = 161

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.stop <= self.start:
            raise PydanticCustomError("angle_range", "`stop` must be above `start`")
        return self

    def radians(self) -> FloatArray:
        """Return the angles. [rad]"""
        return np.radians(np.linspace(self.start, self.stop, self.count))


class SamplingMethod(StrEnum):
    """How samples are used."""

    AUTO = "auto"
    DIRECT = "direct"


class SamplingSettings(Part):
    """How much is sampled."""

    model_config = with_examples({"half_width": 0.02, "confidence": 0.95, "max_samples": 16384, "seed": 7})

    half_width: Annotated[
        Num,
        Field(
            ge=1e-4,
            le=0.5,
            description="Of the interval of every probability, cut off at 0 and 1, at which sampling ends. [1]",
        ),
    ] = SAMPLING.half_width
    confidence: Annotated[Num, Field(ge=0.5, le=0.9999, description="Of every interval. [1]")] = SAMPLING.confidence
    max_samples: Annotated[
        Count,
        Field(
            ge=256,
            le=MOST_SAMPLES,
            description="Searches or runs at most, never exceeded. With `sensitivity` at least 256 and those in which "
            "one input is changed alone: two for each continuous input, one for each discrete value.",
        ),
        WHOLE,
    ] = SAMPLING.max_samples
    seed: Annotated[Count, Field(ge=0, le=2**53, description="Sample i of a seed is always the same."), WHOLE] = (
        SAMPLING.seed
    )
    method: Annotated[
        SamplingMethod,
        Field(description="`auto` uses the surrogate where it passes its check, `direct` never."),
    ] = SamplingMethod.AUTO

    def to_solver(self) -> Sampling:
        """Return the solver's settings."""
        return Sampling(**self.model_dump())


Inputs = Annotated[list[UncertainInput], Field(min_length=1, max_length=24)]


class UncertainCase(Case):
    """What both requests have in common."""

    uncertain: Inputs
    sampling: Annotated[SamplingSettings, Field(default_factory=SamplingSettings)]

    def canonical(self) -> dict[str, Any]:
        """Return the request as JSON data, defaults filled in."""
        return self.model_dump(mode="json")

    def resolved(self) -> Self:
        """Return the request: each sample fills in what was left open by itself."""
        return self

    def inputs(self, model: type[BaseModel], base: dict[str, Any]) -> list[Uncertain]:
        """Return the inputs of the solver.

        Raises
        ------
        ParameterError
            If a field is no number of the request, a distribution is not valid, or a value that it states is outside
            the accepted range of its field.
        """
        found = []
        for index, each in enumerate(self.uncertain):
            place = f"uncertain.{index}"
            try:
                distribution = each.distribution.to_solver()
            except ParameterError as error:
                raise ParameterError(f"{place}.{error.field}", error.requirement) from None
            names = isinstance(distribution, Discrete) and isinstance(distribution.values[0], str)
            if names and each.field not in MODELS:
                raise ParameterError(f"{place}.distribution.values", f"must be numbers, but for {' and '.join(MODELS)}")
            if each.field in MODELS:
                _check_models(model, base, place, each.field, distribution, names=names)
            found.append(Uncertain(each.field, distribution))
        for index, number in enumerate(found):
            if number.field not in MODELS:
                at = _bases_of(model, base, found, index)[0]
                check_values(index, number, partial(_check, model, at, number.field))
        return found


def _bases_of(
    model: type[BaseModel], base: dict[str, Any], uncertain: Sequence[Uncertain], index: int
) -> list[dict[str, Any]]:
    """Return the requests in which a number is set: one, or one with each of the models whose number it is.

    Raises
    ------
    ParameterError
        If it is no number of one of them.
    """
    field = uncertain[index].field
    if field == RESIDUAL:
        return [base]
    bases, chosen = [base], ""
    for number, each in enumerate(uncertain):
        if each.field in MODELS and field.startswith(each.field.removesuffix("model")):
            assert isinstance(each.distribution, Discrete)  # noqa: S101 (checked)
            bases = [with_values(base, [each.field], [name]) for name in each.distribution.values]
            chosen = f"; it must be a number of every model of uncertain.{number}"
    for request in bases:
        try:
            check_field(model, request, field.split("."))
        except LookupError as error:
            raise ParameterError(f"uncertain.{index}.field", f"{field!r} {error.args[0]}{chosen}") from None
    return bases


def _check(model: Any, base: Mapping[str, Any], field: str, value: float) -> None:
    """Refuse a value of a field that the contract does not accept.

    Raises
    ------
    ParameterError
        If it does not.
    """
    try:
        model.model_validate(with_values(base, [field], [value])).arguments()
    except ValidationError as error:
        detail = error.errors()[0]["msg"]
        raise ParameterError(field, f"{detail[0].lower()}{detail[1:]}, got {value:g}") from None


def _check_models(
    model: type[BaseModel], base: dict[str, Any], place: str, field: str, distribution: Distribution, *, names: bool
) -> None:
    """Refuse alternatives of a model that are no models."""
    if not isinstance(distribution, Discrete) or not names:
        raise ParameterError(f"{place}.distribution", f"of {field!r} must be discrete, with names of models")
    for number, name in enumerate(distribution.values):
        try:
            model.model_validate(with_values(base, [field], [name]))
        except ValidationError:
            raise ParameterError(
                f"{place}.distribution.values.{number}", f"{name!r} is no model of this kind with default numbers"
            ) from None


def with_values(base: Mapping[str, Any], fields: Sequence[str], values: Sequence[Any]) -> dict[str, Any]:
    """Return a request with these values of the fields; models first, then their numbers, a residual last."""
    request, residual = dict(base), None
    for field, value in sorted(zip(fields, values, strict=True), key=lambda each: each[0] not in MODELS):
        if field == RESIDUAL:
            residual = value
        elif field in MODELS:
            part = field.split(".")[1]
            resistance = request.get("resistance", {})
            given = resistance.get(part, {})
            if given.get("model") != value:
                request["resistance"] = {**resistance, part: _with_model(given, value)}
        else:
            request = put(request, field.split("."), value)
    return request if residual is None else _with_residual(request, residual)


def _with_model(given: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a part with another model; an option set to other than its default stays if that model has it too."""
    own, other = (STRENGTH_FACTORS.get(each, FreeSurface) for each in (str(given.get("model")), name))
    kept = {
        option: value
        for option, value in given.items()
        if option in own.model_fields and option in other.model_fields and value != own.model_fields[option].default
    }
    return {**kept, "model": name}


def _with_residual(request: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Return a request with a multiple of its strength factor, as a law that the contract has."""
    resistance = Resistance.model_validate(request.get("resistance", {}))
    law = scaled(resistance.to_solver().strength_factor, factor)
    content: dict[str, Any] = {"model": law.name}
    for name, field in LAW_FIELDS.items():
        if hasattr(law, name):
            value = getattr(law, name)
            content[field] = list(value) if isinstance(value, tuple) else value
    return {**request, "resistance": {**request.get("resistance", {}), "strength_factor": content}}


LAW_FIELDS = {
    "value": "value",
    "coefficients": "coefficients",
    "coefficient": "coefficient",
    "exponent": "exponent",
    "reference_strength": "reference_strength_pa",
    "diameter_exponent": "diameter_exponent",
    "reference_diameter": "reference_diameter_m",
    "obliquity_shape": "obliquity_shape",
}
"""Constants of strength factor models in the solver and in the contract."""


class CriticalAngleUncertaintyRequest(UncertainCase):
    """Strikes with inputs that scatter, at every oblique angle."""

    model_config = with_examples({**PAPER, "uncertain": SCATTER})

    impact: Strike
    search: Annotated[Search, Field(default_factory=Search)]
    oblique_angles_deg: Annotated[
        AngleRange, Field(default_factory=AngleRange, description="At which the probability is given.")
    ]
    sensitivity: Annotated[Flag, Field(description="Whether to give Sobol indices and swings.")] = True

    @property
    def base(self) -> dict[str, Any]:
        """The request of a sample before its values are set."""
        names = {"projectile", "target", "resistance", "numerics", "impact", "search"}
        return self.model_dump(mode="json", include=names)

    def study(self) -> AngleStudy:
        """Return the study.

        Raises
        ------
        ParameterError
            If values do not go together.
        """
        lower, upper = self.search.to_solver().bounds
        inputs = self.inputs(CriticalAngleBase, self.base)

        def accepts(index: int, value: float) -> bool:
            base = _bases_of(CriticalAngleBase, self.base, inputs, index)[0]
            try:
                _check(CriticalAngleBase, base, inputs[index].field, value)
            except ParameterError:
                return False
            return True

        return AngleStudy(
            inputs,
            self.oblique_angles_deg.radians(),
            self.sampling.to_solver(),
            sensitivity=self.sensitivity,
            bounds=(lower, upper),
            accepts=accepts,
        )


class TrajectoryUncertaintyRequest(UncertainCase):
    """One strike with inputs that scatter."""

    model_config = with_examples({**PAPER_AT_45, "uncertain": SCATTER})

    impact: Impact

    @property
    def base(self) -> dict[str, Any]:
        """The request of a sample before its values are set; no history is computed."""
        names = {"projectile", "target", "resistance", "numerics", "impact"}
        return self.model_dump(mode="json", include=names) | {"output": {"history": False}}

    def study(self) -> TrajectoryStudy:
        """Return the study.

        Raises
        ------
        ParameterError
            If values do not go together.
        """
        return TrajectoryStudy(self.inputs(TrajectoryFields, self.base), self.sampling.to_solver())


def crossings_in(answer: Mapping[str, Any]) -> Crossings:
    """Return what a study keeps of the answer to a critical angle."""
    others = [math.radians(angle) for angle in answer["other_crossings_deg"]]
    if answer["status"] == "not_converged":
        return Crossings(problem="failed")
    if "critical_angle_deg" not in answer:
        return Crossings(tuple(sorted(others)), answer["status"] == "always_ricochet")
    first = math.radians(answer["critical_angle_deg"])
    angles = sorted((first, *others))
    return Crossings(tuple(angles), angles.index(first) % 2 == 1)


def ending_in(answer: Mapping[str, Any]) -> Ending:
    """Return what a study keeps of the answer to a trajectory."""
    left = answer.get("exit")
    return Ending(answer["outcome"], answer["maximum_depth_m"], None if left is None else exit_in(left))


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

    level: Annotated[Num, Field(ge=0.0, le=1.0, description="Share of the samples below it.")]


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
    quantiles: Annotated[list[QuantileAnswer], Field(description="[°]")]
    share_without_angle: Annotated[EstimateAnswer, Field(description="Of all samples with an outcome.")]


InputValue = TypeAliasType("InputValue", Annotated[Num | str, Field(description="A number, or the name of a model.")])
"""Value of an input."""


class SwingAnswer(Part):
    """Critical angle with one input changed and the others at their median or likeliest value."""

    model_config = with_examples({"value": 234.1, "critical_angle_deg": 48.5})

    value: Annotated[
        InputValue, Field(description="Value of the input: its 5 % and 95 % quantiles, or each discrete value.")
    ]
    critical_angle_deg: Annotated[Num, Field(description="If there is one. [°]")] | MISSING = MISSING


class SensitivityAnswer(Part):
    """Share of one input in the variance of the critical angle."""

    model_config = with_examples(
        {"field": "impact.velocity_m_s", "first_order": ESTIMATE, "total": ESTIMATE, "swing": [{"value": 234.1}]}
    )

    field: str
    first_order: Annotated[EstimateAnswer, Field(description="Share of the input alone. [1]")] | MISSING = MISSING
    total: Annotated[EstimateAnswer, Field(description="Share with its interactions. [1]")] | MISSING = MISSING
    swing: list[SwingAnswer]


class ConvergenceAnswer(Part):
    """History of the sampling, columns of equal length."""

    model_config = with_examples({"samples": [266], "half_width": [0.013]})

    samples: list[Count]
    half_width: Annotated[list[Num], Field(description="Largest of all intervals of a probability. [1]")]


class UncertaintyAnswer(Part):
    """What both answers have in common."""

    convergence: ConvergenceAnswer
    converged: Annotated[bool, Field(description="Whether every interval is within the half width wanted.")]
    samples: Annotated[Count, Field(description="Searches or runs.")]
    samples_failed: Annotated[Count, Field(description="Those that could not be computed.")]
    samples_outside: Annotated[
        Count, Field(description="Those outside the accepted range: they count as not known, as failed ones do.")
    ]
    seed: Count
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


class StudyProgress(Part):
    """How far a study of uncertainty is."""

    model_config = with_examples(
        {"samples": 1024, "max_samples": 16384, "half_width": 0.031, "requested_half_width": 0.02}
    )

    samples: Annotated[Count, Field(description="Searches or runs done.")]
    max_samples: Annotated[Count, Field(description="At most; it ends earlier if the half width is reached.")]
    half_width: (
        Annotated[Num, Field(description="Reached: largest of all intervals of a probability. [1]")] | MISSING
    ) = MISSING
    requested_half_width: Annotated[Num, Field(description="At which it ends. [1]")]


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
    sensitivity: Annotated[list[SensitivityAnswer], Field(description="If wanted.")] | MISSING = MISSING
    method: Annotated[
        UncertaintyMethod,
        Field(
            description="`surrogate`: a polynomial chaos of the angle; `direct`: outcomes of randomised Sobol points."
        ),
    ]
    polynomial_order: Annotated[Count, Field(description="Of the surrogate.")] | MISSING = MISSING
    surrogate_error_deg: (
        Annotated[Num, Field(description="Root mean square at held-out points, also where it was too large. [°]")]
        | MISSING
    ) = MISSING


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
    maximum_depth_m: Annotated[list[QuantileAnswer], Field(description="Quantiles over all runs. [m]")]
    ricochet_exit: Annotated[ExitQuantilesAnswer, Field(description="Of those turned away, if any.")] | MISSING = (
        MISSING
    )
    perforation_exit: (
        Annotated[ExitQuantilesAnswer, Field(description="Of those that perforated, if any.")] | MISSING
    ) = MISSING
    exit_speed_m_s: (
        Annotated[list[QuantileAnswer], Field(description="`speed_m_s` of `ricochet_exit`. [m/s]")] | MISSING
    ) = MISSING
    exit_angle_deg: (
        Annotated[list[QuantileAnswer], Field(description="`direction_deg` of `ricochet_exit`. [°]")] | MISSING
    ) = MISSING
    residual_speed_m_s: (
        Annotated[list[QuantileAnswer], Field(description="`speed_m_s` of `perforation_exit`. [m/s]")] | MISSING
    ) = MISSING


class PartialUncertainty(Part):
    """Answer to a study from the samples so far."""

    model_config = with_examples(
        {
            "outcomes": [{"outcome": "ricochet"} | ESTIMATE],
            "convergence": {"samples": [266], "half_width": [0.013]},
        }
    )

    probability: Annotated[ProbabilityCurve, Field(description="Of critical angles.")] | MISSING = MISSING
    outcomes: Annotated[list[OutcomeProbability], Field(description="Of one strike.")] | MISSING = MISSING
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
