"""Building blocks of the models: JSON numbers, and the base classes."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Annotated, Any, ClassVar, Generic, TypeVar

from pydantic import (
    MISSING,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    GetJsonSchemaHandler,
    Strict,
    model_validator,
)
from pydantic_core import CoreSchema

from service.columns import unit_end, unit_of
from solver.checks import BOUNDS
from solver.quantities import Quantity, field_docstrings, quantities
from solver.units import UnitSystem

Num = Annotated[FiniteFloat, Strict()]
"""Finite JSON number, integer or decimal. Strings and booleans, which pydantic would convert, are refused."""

Flag = Annotated[bool, Strict()]
"""JSON true or false. Numbers and strings, which pydantic would convert, are refused."""


# The default is left out of dumps, so that the keys of results in SI units are the same as before this field existed.
Units = Annotated[
    UnitSystem,
    Field(
        exclude_if=lambda units: units is UnitSystem.SI,
        description="Units of the quantities in texts, such as warnings: SI (mm, MPa) or US customary units (in, psi). "
        "Fields are in SI units (m, Pa), and so are the quantities in the errors of a request without this field.",
    ),
]
"""Field of a request that selects the units in the texts of the answer."""


def named_units(content: Any) -> UnitSystem | None:
    """Return the units that a request names; None if it names none. The rest of the request need not be valid."""
    units = content.get("units") if isinstance(content, dict) else None
    return UnitSystem(units) if isinstance(units, str) and units in set(UnitSystem) else None


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, Strict()]
WHOLE = BeforeValidator(_whole)
"""Validator for a `Count` that accepts 12000.0 as 12000: JSON and many languages do not distinguish them."""


@dataclass(frozen=True, slots=True)
class Of:
    """Source of a field in a solver result, if it is not the attribute of the same name.

    Parameters
    ----------
    source
        Dotted path of attributes, or function of the result; None for a value that is not in the result.
    """

    source: str | Callable[[Any], Any] | None


class Part(BaseModel):
    """Base class of all models: unknown fields are refused, and an optional field without a default may be absent.

    An optional field that is null in a request counts as absent, since some generated clients send null for it.

    The description of a field in the contract is its docstring or, without one, the description of the same field in
    the solver with the unit converted. Docstrings are read when a schema is generated; pydantic's
    `use_attribute_docstrings` would read them when the class is created, which would add 0.2 s to every start. Fields
    in `answered_last` follow the others in an answer, which otherwise has the order of the model.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    solved: ClassVar[type | None] = None
    """Class of the solver with the same fields."""
    answered_last: ClassVar[tuple[str, ...]] = ()
    tabled: ClassVar[tuple[str, ...]] = ()
    """Fields that are columns of tables, in order; by default all numbers and strings in the order of the answer."""

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, content: Any) -> Any:
        if isinstance(content, dict) and None in content.values():
            optional = {name for name, field in cls.model_fields.items() if not field.is_required()}
            return {name: value for name, value in content.items() if value is not None or name not in optional}
        return content

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler, /) -> dict[str, Any]:
        """Return the schema with the descriptions of the fields."""
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name in cls.model_fields.keys() & properties.keys():
            text = _docstring_of(cls, name) or properties[name].get("description") or _solver_description(cls, name)
            if text:
                properties[name]["description"] = text
        return schema


def description_of(model: type[Part], name: str) -> str:
    """Return the description of a field with its unit; empty if it has none."""
    return _docstring_of(model, name) or model.model_fields[name].description or _solver_description(model, name)


def _docstring_of(model: type[Part], name: str) -> str:
    bases = [base for base in model.__mro__ if issubclass(base, Part)]
    texts = (field_docstrings(base.__module__).get(base.__name__, {}).get(name, "") for base in bases)
    return next(filter(None, texts), "")


def _solver_description(model: type[Part], name: str) -> str:
    """Return the solver's description of a field, with the unit that the name of the field states."""
    marks = [mark.source for mark in model.model_fields[name].metadata if isinstance(mark, Of)]
    source = marks[-1] if marks else name.removesuffix(unit_end(name))
    kind = solver_class(model)
    if not isinstance(kind, type) or not isinstance(source, str):
        return ""
    found = quantities(kind).get(source, Quantity("", ""))
    if not found.text:
        return ""
    unit = unit_of(name) or found.unit
    gravity = f" In standard gravity, {STANDARD_GRAVITY} m/s²." if name.endswith("_g") else ""
    text = found.text.replace("``", "`")  # Markdown instead of reStructuredText
    return f"{text}{gravity}" + (f" [{unit}]" if unit else "")


def short_description(model: type[Part], name: str) -> str:
    """Return the first sentence of the description of a field, without its unit."""
    return Quantity.of(description_of(model, name)).short


STANDARD_GRAVITY = 9.80665
"""Standard gravity, the unit of accelerations in the contract. [m/s²]"""
KINDS = frozenset({"model", "shape", "type"})
"""Fields that select the variant of a union; the solver has a class for each variant."""
Solved = TypeVar("Solved")


def solver_arguments(part: Part) -> dict[str, Any]:
    """Return the fields of a part as arguments of the solver: names without units, angles in radians.

    Absent fields are left out, so that the defaults of the solver apply.
    """
    return {
        name: _solver_value(value, angle=angle)
        for field, name, angle in _solver_names(type(part))
        if (value := getattr(part, field)) is not MISSING
    }


@cache
def _solver_names(model: type[Part]) -> list[tuple[str, str, bool]]:
    """Return the fields of a model, each with its name in the solver and True for an angle in degrees."""
    fields = [name for name in model.model_fields if name not in KINDS]
    return [(name, name.removesuffix(unit_end(name)), name.endswith("_deg")) for name in fields]


def _solver_value(value: Any, *, angle: bool) -> Any:
    if isinstance(value, SolverPart):
        return value.to_solver()
    if isinstance(value, list):
        return tuple(_solver_value(each, angle=angle) for each in value)
    if isinstance(value, Enum):
        return value.value
    return math.radians(value) if angle else value


class SolverPart(Part, Generic[Solved]):
    """Base class of the models that have the same fields as a class of the solver, which is the type argument."""

    def to_solver(self) -> Solved:
        """Convert the model to an object of the solver's class."""
        kind: Any = solver_class(type(self))
        found: Solved = kind(**solver_arguments(self))
        return found


@cache
def solver_class(model: type[Part]) -> type | None:
    """Return the class of the solver with the same fields as a model, if there is one.

    For a `SolverPart` it is the type argument of the class or of one of its bases.
    """
    bases = [base for base in model.__mro__ if issubclass(base, SolverPart)]
    named = [kind for base in bases for kind in base.__pydantic_generic_metadata__["args"]]
    return named[0] if named else model.solved


def with_examples(*examples: Any) -> ConfigDict:
    """Return a model configuration with these examples in the schema."""
    return ConfigDict(json_schema_extra={"examples": list(examples)})


def within(field: str) -> dict[str, Any]:
    """Return the bounds of a field of the solver, as arguments of `Field`."""
    bound = BOUNDS[field]
    return {"gt" if bound.above else "ge": bound.lower, "lt" if bound.below else "le": bound.upper}


def degrees(angle: float) -> float:
    """Convert an angle from radians to degrees. An angle given in degrees with up to 15 digits is restored exactly."""
    exact = math.degrees(angle)
    short = float(f"{exact:.15g}")
    return short if math.radians(short) == angle else exact
