"""Building blocks of the contract: numbers as JSON knows them, and the base of every model."""

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
    FiniteFloat,
    GetJsonSchemaHandler,
    Strict,
    model_validator,
)
from pydantic_core import CoreSchema

from service.columns import unit_end, unit_of
from solver.checks import BOUNDS
from solver.quantities import Quantity, field_docstrings, quantities

Num = Annotated[FiniteFloat, Strict()]
"""A JSON number, 13 as good as 13.0. No text, no truth value, nothing infinite."""

Flag = Annotated[bool, Strict()]
"""true or false, not 1 or "yes"."""


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, Strict()]
WHOLE = BeforeValidator(_whole)
"""With a `Count`, after its bounds: a JSON integer, 12000.0 as good as 12000."""


@dataclass(frozen=True, slots=True)
class Of:
    """Where the solver has the value of a field, if not in an attribute with the name of the field without its unit.

    Parameters
    ----------
    source
        Path of attributes, or a function of what the solver returns; None if the value is not from there.
    """

    source: str | Callable[[Any], Any] | None


class Part(BaseModel):
    """Base of all models: unknown fields are refused, a field that is not given is absent.

    An optional field that is null in a request is absent too, as some generated clients send what they leave out.

    The description of a field in the contract is its docstring or, without one, that of the field of the solver, in the
    unit of the name. It is read when a schema is made: pydantic's `use_attribute_docstrings` reads it when the class is
    made, which adds a fifth of a second to every start. Fields named in `answered_last` come behind the others in an
    answer, whose order is otherwise that of the model.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    solved: ClassVar[type | None] = None
    """Class of the solver that has the same fields."""
    answered_last: ClassVar[tuple[str, ...]] = ()
    tabled: ClassVar[tuple[str, ...]] = ()
    """Fields that are columns of tables, in their order; all numbers and texts, in that of the answer, unless given."""

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
    """Return the description of a field, with its unit; empty without one."""
    return _docstring_of(model, name) or model.model_fields[name].description or _solver_description(model, name)


def _docstring_of(model: type[Part], name: str) -> str:
    bases = [base for base in model.__mro__ if issubclass(base, Part)]
    texts = (field_docstrings(base.__module__).get(base.__name__, {}).get(name, "") for base in bases)
    return next(filter(None, texts), "")


def _solver_description(model: type[Part], name: str) -> str:
    """Return the description that the solver has of a field, in the unit of its name."""
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
"""Unit of accelerations. [m/s²]"""
KINDS = frozenset({"model", "shape", "type"})
"""Fields that say which of several models a part is; the solver has a class for each."""
Solved = TypeVar("Solved")


def solver_arguments(part: Part) -> dict[str, Any]:
    """Return the fields of a part as the solver names and takes them: without units, angles in radians.

    What is not given is left out, so that the solver's own default counts.
    """
    return {
        name: _plain(value, angle=angle)
        for field, name, angle in _solver_names(type(part))
        if (value := getattr(part, field)) is not MISSING
    }


@cache
def _solver_names(model: type[Part]) -> list[tuple[str, str, bool]]:
    """Return the fields of a model, each with the solver's name and whether it is an angle in degrees."""
    fields = [name for name in model.model_fields if name not in KINDS]
    return [(name, name.removesuffix(unit_end(name)), name.endswith("_deg")) for name in fields]


def _plain(value: Any, *, angle: bool) -> Any:
    if isinstance(value, SolverPart):
        return value.to_solver()
    if isinstance(value, list):
        return tuple(_plain(each, angle=angle) for each in value)
    if isinstance(value, Enum):
        return value.value
    return math.radians(value) if angle else value


class SolverPart(Part, Generic[Solved]):
    """Base of the models that have a class of the solver, named in brackets, with the same fields but for the units."""

    def to_solver(self) -> Solved:
        """Return the solver's object."""
        kind: Any = solver_class(type(self))
        found: Solved = kind(**solver_arguments(self))
        return found


@cache
def solver_class(model: type[Part]) -> type | None:
    """Return the class of the solver that has the same fields as a model, if there is one.

    A `SolverPart`, or one that it inherits from, names it in brackets.
    """
    bases = [base for base in model.__mro__ if issubclass(base, SolverPart)]
    named = [kind for base in bases for kind in base.__pydantic_generic_metadata__["args"]]
    return named[0] if named else model.solved


def with_examples(*examples: Any) -> ConfigDict:
    """Model configuration that shows these in the schema."""
    return ConfigDict(json_schema_extra={"examples": list(examples)})


def within(field: str) -> dict[str, Any]:
    """Return the bounds of a field of the solver, as arguments of `Field`."""
    bound = BOUNDS[field]
    return {"gt" if bound.above else "ge": bound.lower, "lt" if bound.below else "le": bound.upper}


def degrees(angle: float) -> float:
    """Degrees of an angle in radians; those it was made from, where they had 15 digits or fewer."""
    exact = math.degrees(angle)
    short = float(f"{exact:.15g}")
    return short if math.radians(short) == angle else exact
