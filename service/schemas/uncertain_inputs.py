"""Models of uncertain inputs and their distributions, and functions that build the request for each sample."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import MISSING, BaseModel, Field, StringConstraints, ValidationError
from typing_extensions import TypeAliasType

from service.columns import shown_in
from service.schemas.fields import walk
from service.schemas.quantities import Num, Part, SolverPart, with_examples
from service.schemas.requests import Case
from service.schemas.resistance import STRENGTH_FACTORS, FreeSurface, Resistance
from service.schemas.sweeps import check_field, put
from service.schemas.wording import out_of_bounds, worded
from solver import ParameterError
from solver.projectile import mass_properties
from solver.resistance import StrengthFactor
from solver.uncertainty import (
    RESIDUAL,
    Discrete,
    Lognormal,
    LogStudentT,
    Normal,
    Triangular,
    TruncatedNormal,
    Uncertain,
    Uniform,
    scaled,
)
from solver.uncertainty.sampling import check_inputs, check_values
from solver.uncertainty.strikes import THEORY, by_theory

MODELS = ("resistance.free_surface.model", "resistance.strength_factor.model", THEORY)
"""Fields whose values are names of models instead of numbers."""
SPEEDS = {"type": "normal", "mean": 238.0, "coefficient_of_variation": 0.02}
STRENGTHS = {"type": "lognormal", "median": 39e6, "dispersion": 0.12}
THEORIES = {"type": "discrete", "values": ["elastic_plastic", "mohr_coulomb"], "weights": [0.8, 0.2]}
RESIDUALS = {
    "type": "log_student_t",
    "median": 1.0,
    "scale": 0.27,
    "degrees_of_freedom": 3.0,
    "lower": 0.24,
    "upper": 7.0,
}
SCATTER = [
    {"field": "impact.velocity_m_s", "distribution": SPEEDS},
    {"field": "target.compressive_strength_pa", "distribution": STRENGTHS},
    {"field": THEORY, "distribution": THEORIES},
]

CENTRED = [
    {"field": "impact.velocity_m_s", "distribution": {"type": "normal", "coefficient_of_variation": 0.02}},
    {"field": "target.compressive_strength_pa", "distribution": {"type": "lognormal", "dispersion": 0.12}},
    {"field": THEORY, "distribution": THEORIES},
]
"""Inputs of `SCATTER` without centres, which then default to the values of the case."""

Finite = Annotated[Num, Field(ge=-1e300, le=1e300)]


class Centred(Part):
    """Base class of the distributions whose centre may be omitted; it is then the value of the field in the case."""

    centre: ClassVar[str]
    """Name of the parameter that is the centre of the distribution."""

    @property
    def open_centre(self) -> str:
        """Name of the centre if it is omitted, else an empty string."""
        return self.centre if getattr(self, self.centre) is MISSING else ""


class Spread(Centred):
    """Base class of distributions given by a mean and either a standard deviation or a coefficient of variation."""

    centre: ClassVar = "mean"

    mean: Finite | MISSING = MISSING
    """Mean in the unit of the field. By default the value of the case."""
    standard_deviation: Finite | MISSING = MISSING
    """Standard deviation, in the unit of the field."""
    coefficient_of_variation: Finite | MISSING = MISSING
    """Standard deviation divided by the mean; may be given in place of `standard_deviation`. [1]"""


class NormalDistribution(Spread, SolverPart[Normal]):
    """Normal distribution."""

    model_config = with_examples(SPEEDS)

    type: Literal["normal"]


class TruncatedNormalDistribution(Spread, SolverPart[TruncatedNormal]):
    """Normal distribution truncated at one or two bounds. Its mean and deviation apply before the truncation."""

    model_config = with_examples(
        {"type": "truncated_normal", "mean": 0.02, "standard_deviation": 0.01, "lower": 0.005, "upper": 0.05}
    )

    type: Literal["truncated_normal"]
    lower: Finite | MISSING = MISSING
    upper: Finite | MISSING = MISSING


class LognormalDistribution(Centred, SolverPart[Lognormal]):
    """Lognormal distribution, given by median and dispersion, or by mean and deviation of the number itself."""

    model_config = with_examples(STRENGTHS)

    centre: ClassVar = "median"

    type: Literal["lognormal"]
    median: Finite | MISSING = MISSING
    """Median in the unit of the field. By default, unless a mean or a deviation is given, the value of the case."""
    dispersion: Finite | MISSING = MISSING
    """Standard deviation of the natural logarithm. [1]"""
    mean: Finite | MISSING = MISSING
    """Mean; may be given in place of the median. By default, if a deviation is given, the value of the case."""
    standard_deviation: Finite | MISSING = MISSING
    """Standard deviation, in the unit of the field."""
    coefficient_of_variation: Finite | MISSING = MISSING
    """Standard deviation divided by the mean; may be given in place of `standard_deviation`. [1]"""

    @property
    def open_centre(self) -> str:
        """Name of the centre if it is omitted, else an empty string. The centre is the mean if a deviation is given."""
        if self.median is not MISSING or self.mean is not MISSING:
            return ""
        by_mean = any(each is not MISSING for each in (self.standard_deviation, self.coefficient_of_variation))
        return "mean" if by_mean and self.dispersion is MISSING else "median"


class LogStudentTDistribution(Centred, SolverPart[LogStudentT]):
    """Distribution of a number whose logarithm has Student's distribution: lognormal with heavier tails."""

    model_config = with_examples(
        {"type": "log_student_t", "median": 8.055, "scale": 0.0815, "degrees_of_freedom": 7.0},
        RESIDUALS,
    )

    centre: ClassVar = "median"

    type: Literal["log_student_t"]
    median: Finite | MISSING = MISSING
    """Median in the unit of the field. By default the value of the case."""
    scale: Finite
    """Scale of the natural logarithm. [1]"""
    degrees_of_freedom: Finite
    """Degrees of freedom, 1 or more. With many degrees of freedom, the distribution is nearly lognormal. [1]"""
    lower: Finite | MISSING = MISSING
    upper: Finite | MISSING = MISSING
    """Upper bound of a truncated distribution. A field with a limited range needs both bounds, because the tails are
    heavy."""


class UniformDistribution(SolverPart[Uniform]):
    """Uniform distribution between two bounds."""

    model_config = with_examples({"type": "uniform", "lower": 2200.0, "upper": 2400.0})

    type: Literal["uniform"]
    lower: Finite
    upper: Finite


class TriangularDistribution(Centred, SolverPart[Triangular]):
    """Triangular distribution, whose density rises from the lower bound to the mode and falls to the upper bound."""

    model_config = with_examples({"type": "triangular", "lower": 12.9, "mode": 13.0, "upper": 13.2})

    centre: ClassVar = "mode"

    type: Literal["triangular"]
    lower: Finite
    mode: Finite | MISSING = MISSING
    """Mode in the unit of the field. By default the value of the case."""
    upper: Finite


Name = Annotated[str, StringConstraints(strict=True, min_length=1, max_length=100)]


DiscreteValues = TypeAliasType(
    "DiscreteValues",
    Annotated[
        list[Finite] | list[Name], Field(min_length=1, max_length=100, description="Numbers, or names of models.")
    ],
)
"""Values of a discrete distribution: numbers, or names of models."""


class DiscreteDistribution(SolverPart[Discrete]):
    """Discrete distribution of numbers or of names of models, each with a weight."""

    model_config = with_examples(THEORIES)

    type: Literal["discrete"]
    values: DiscreteValues
    weights: Annotated[list[Finite], Field(min_length=1, max_length=100)] | MISSING = MISSING
    """Probabilities of the values, with a sum of 1. By default all are equal."""


DistributionOf = TypeAliasType(
    "DistributionOf",
    Annotated[
        NormalDistribution
        | TruncatedNormalDistribution
        | LognormalDistribution
        | LogStudentTDistribution
        | UniformDistribution
        | TriangularDistribution
        | DiscreteDistribution,
        Field(discriminator="type", description="Distribution in the unit of the field."),
    ],
)


class UncertainInput(Part):
    """An uncertain input, independent of the others."""

    model_config = with_examples(*SCATTER)

    field: Annotated[
        str,
        StringConstraints(strict=True, min_length=1, max_length=200),  # These are the limits of a sweep's axis.
        Field(
            description="Dotted path to a number of the request, such as `impact.velocity_m_s`; "
            "`resistance.free_surface.model` or `resistance.strength_factor.model` with names; "
            f"`{THEORY}` with `elastic_plastic` and `mohr_coulomb`, each a decay law with its own S(θ), from equation "
            "9 and from finite element motions; "
            f"`{RESIDUAL}`, a factor on the strength factor of any law."
        ),
    ]
    distribution: DistributionOf


def with_centres(uncertain: Sequence[UncertainInput], case: Case) -> list[UncertainInput]:
    """Return the uncertain inputs with omitted centres set to the values of their fields in the case.

    Raises
    ------
    ParameterError
        If the case has no value for such a field.
    """
    content = case.resolved().model_dump(mode="json")
    found = []
    for index, each in enumerate(uncertain):
        distribution: Any = each.distribution
        if name := open_centre(each):
            value = _centre(index, name, each.field, uncertain, case, content)
            distribution = distribution.model_copy(update={name: value})
        found.append(each.model_copy(update={"distribution": distribution}))
    return found


def open_centre(uncertain: UncertainInput) -> str:
    """Return the name of the centre of a distribution if it is omitted, else an empty string."""
    distribution = uncertain.distribution
    return distribution.open_centre if isinstance(distribution, Centred) else ""


NATURAL: Mapping[str, Callable[[Case], float]] = {
    RESIDUAL: lambda _: 1.0,
    "projectile.center_of_gravity_m": lambda case: mass_properties(case.projectile.to_solver()).center_of_gravity,
    "projectile.moment_of_inertia_kg_m2": lambda case: mass_properties(case.projectile.to_solver()).moment_of_inertia,
    "target.youngs_modulus_pa": lambda case: case.target.to_solver().elastic_modulus,
    "resistance.strength_factor.held_from_deg": lambda case: math.degrees(case.resistance.to_solver().held_from),
}
"""Functions that return the value used for a field that the case does not set."""


def _centre(
    index: int, name: str, field: str, uncertain: Sequence[UncertainInput], case: Case, content: dict[str, Any]
) -> float:
    """Return the value of a field in a case or, if the case does not set it, the value used in its place.

    Raises
    ------
    ParameterError
        If there is no such value, or the field must have a discrete distribution.
    """
    if field in MODELS:
        raise _not_discrete(index, field)
    path = field.split(".")
    value: Any = content
    for part in path:
        value = value.get(part, {}) if isinstance(value, dict) else {}
    if isinstance(value, float | int) and not isinstance(value, bool):
        return value
    # If a model is itself uncertain, its fields may be missing in the model of the nominal case.
    chosen = any(each.field in MODELS and field.startswith(each.field.removesuffix("model")) for each in uncertain)
    if field != RESIDUAL and not chosen:
        try:
            check_field(type(case), content, path)
        except LookupError as error:
            raise ParameterError(f"uncertain.{index}.field", f"{field!r} {error.args[0]}") from None
    if field in NATURAL:
        return NATURAL[field](case)
    raise ParameterError(
        f"uncertain.{index}.distribution.{name}", f"must be given, since the case has no value of {field!r}"
    )


def _not_discrete(index: int, field: str) -> ParameterError:
    return ParameterError(f"uncertain.{index}.distribution", f"of {field!r} must be discrete, with names of models")


def inputs_of(uncertain: Sequence[UncertainInput], model: type[BaseModel], base: dict[str, Any]) -> list[Uncertain]:
    """Convert uncertain inputs to inputs of the solver, and check them against the request `base`.

    Raises
    ------
    ParameterError
        If a field is not a number of the request, a distribution is not valid, or one of its parameters is outside the
        accepted range of the field.
    """
    found = []
    for index, each in enumerate(uncertain):
        place = f"uncertain.{index}"
        try:
            distribution = each.distribution.to_solver()
        except ParameterError as error:
            raise error.at(f"{place}.{error.field}", unit=shown_in(each.field)) from None
        names = isinstance(distribution, Discrete) and isinstance(distribution.values[0], str)
        if names and each.field not in MODELS:
            raise ParameterError(f"{place}.distribution.values", f"must be numbers, but for {' and '.join(MODELS)}")
        if each.field in MODELS:
            if not isinstance(distribution, Discrete) or not names:
                raise _not_discrete(index, each.field)
            _check_models(model, base, place, each.field, distribution)
        found.append(Uncertain(each.field, distribution))
    for index, number in enumerate(found):
        if number.field not in MODELS:
            at = _bases_of(model, base, found, index)[0]
            check_values(index, number, partial(_check, model, at, number.field))
    return found


def check_fields(uncertain: Sequence[UncertainInput], model: type[BaseModel], base: dict[str, Any]) -> None:
    """Check that the fields of uncertain inputs exist, and that no two inputs have the same field.

    Raises
    ------
    ParameterError
        If a field does not exist, or two inputs have the same field.
    """
    check_inputs(cast("Any", uncertain))  # Only the names of the fields are read.
    for index, each in enumerate(uncertain):
        if each.field in MODELS:
            if not isinstance(each.distribution, DiscreteDistribution):
                raise _not_discrete(index, each.field)
            _check_models(model, base, f"uncertain.{index}", each.field, each.distribution)
    for index, each in enumerate(uncertain):
        if each.field not in MODELS:
            _bases_of(model, base, uncertain, index)


def _bases_of(
    model: type[BaseModel], base: dict[str, Any], uncertain: Sequence[Uncertain | UncertainInput], index: int
) -> list[dict[str, Any]]:
    """Return the requests in which an input is set: the base or, for a parameter of an uncertain model, one per model.

    Raises
    ------
    ParameterError
        If the field is not a number of one of these requests.
    """
    field = uncertain[index].field
    if field == RESIDUAL:
        return [base]
    bases, chosen = [base], ""
    for number, each in enumerate(uncertain):
        if each.field in MODELS and field.startswith(each.field.removesuffix("model")):
            assert isinstance(each.distribution, Discrete | DiscreteDistribution)  # noqa: S101 (checked)
            bases = [with_values(base, [each.field], [name]) for name in each.distribution.values]
            chosen = f"; it must be a number of every model of uncertain.{number}"
    for request in bases:
        try:
            check_field(model, request, field.split("."))
        except LookupError as error:
            raise ParameterError(f"uncertain.{index}.field", f"{field!r} {error.args[0]}{chosen}") from None
    return bases


def _check(model: Any, base: Mapping[str, Any], field: str, value: float) -> None:
    """Check that the contract accepts a value of a field.

    Raises
    ------
    ParameterError
        If the value is not accepted.
    """
    try:
        model.model_validate(with_values(base, [field], [value])).arguments()
    except ValidationError as error:
        [first, *_] = error.errors()
        condition, *amounts = out_of_bounds(first, shown_in(field)) or (worded(first),)
        raise ParameterError(field, condition, *amounts) from None


def accepts(
    model: type[BaseModel], base: dict[str, Any], uncertain: Sequence[Uncertain], index: int, value: float
) -> bool:
    """Return True if the contract accepts a value of an input, with the other inputs as in the request."""
    at = _bases_of(model, base, uncertain, index)[0]
    try:
        _check(model, at, uncertain[index].field, value)
    except ParameterError:
        return False
    return True


def _check_models(
    model: type[BaseModel],
    base: dict[str, Any],
    place: str,
    field: str,
    distribution: Discrete | DiscreteDistribution,
) -> None:
    """Check that the values of an uncertain model are names of models that the contract accepts there."""
    for number, name in enumerate(distribution.values):
        try:
            model.model_validate(with_values(base, [field], [name]))
        except (ValidationError, ParameterError):
            raise ParameterError(
                f"{place}.distribution.values.{number}", f"{name!r} is no model of this kind with default numbers"
            ) from None


def with_values(base: Mapping[str, Any], fields: Sequence[str], values: Sequence[Any]) -> dict[str, Any]:
    """Return a copy of a request with its fields set to these values."""
    request, residual = dict(base), None
    # Models are set before their numbers, since setting a model replaces its numbers. The factor on S comes last,
    # because it multiplies the law that the other values have set.
    for field, value in sorted(
        zip(fields, values, strict=True), key=lambda each: (each[0] != THEORY, each[0] not in MODELS)
    ):
        if field == RESIDUAL:
            residual = value
        elif field == THEORY:
            request = _with_theory(request, value)
        elif field in MODELS:
            part = field.split(".")[1]
            resistance = request.get("resistance", {})
            given = resistance.get(part, {})
            if given.get("model") != value:
                request["resistance"] = {**resistance, part: _with_model(given, value)}
        else:
            request = put(request, field.split("."), value)
    return request if residual is None else _with_residual(request, residual)


def _with_theory(request: Mapping[str, Any], theory: str) -> dict[str, Any]:
    """Return a request with a theory of the decay.

    Fields that the theory does not set stay as they were sent, so that the keys of the results stay the same.
    """
    before = Resistance.model_validate(request.get("resistance", {})).to_solver()
    after = by_theory(before, theory)
    if after.strength_factor != before.strength_factor:
        request = _with_law(request, after.strength_factor)
    return with_values(request, ["resistance.free_surface.model"], [theory])


def _with_model(given: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a part with another model. Options that differ from their default are kept if the other model has them."""
    own, other = (STRENGTH_FACTORS.get(each, FreeSurface) for each in (str(given.get("model")), name))
    kept = {
        option: value
        for option, value in given.items()
        if option in own.model_fields and option in other.model_fields and value != own.model_fields[option].default
    }
    return {**kept, "model": name}


def _with_residual(request: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Return a request with S multiplied by a factor, as one of the strength factor models of the contract."""
    resistance = Resistance.model_validate(request.get("resistance", {}))
    return _with_law(request, scaled(resistance.to_solver().strength_factor, factor))


def _with_law(request: Mapping[str, Any], law: StrengthFactor) -> dict[str, Any]:
    """Return a request with a strength factor model of the solver."""
    content = walk(STRENGTH_FACTORS[law.name], law, model=law.name)
    return {**request, "resistance": {**request.get("resistance", {}), "strength_factor": content}}


def without_shots(case: Case, request: dict[str, Any]) -> dict[str, Any]:
    """Return the request of a sample with the model `own_tests` replaced by the equivalent power law.

    Otherwise the request of every sample would contain the shots, and the fit to them would be repeated for each.

    Raises
    ------
    ParameterError
        If no strength factor gives the depth of a shot.
    """
    arguments = case.shared_arguments()
    given = arguments["resistance"]
    found = given.without_shots(target=arguments["target"], projectile=arguments["projectile"])
    return request if found is given else _with_law(request, found.strength_factor)
