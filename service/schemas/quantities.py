"""Building blocks of the contract: numbers as JSON knows them, and the base of every model."""

import ast
import math
import sys
from collections.abc import Mapping
from enum import Enum
from functools import cache
from inspect import cleandoc, getsource
from itertools import pairwise
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

from service.columns import unit_end
from solver.checks import BOUNDS

Num = Annotated[FiniteFloat, Strict()]
"""A JSON number, 13 as good as 13.0. No text, no truth value, nothing infinite."""

Flag = Annotated[bool, Strict()]
"""true or false, not 1 or "yes"."""


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, Strict()]
WHOLE = BeforeValidator(_whole)
"""With a `Count`, after its bounds: a JSON integer, 12000.0 as good as 12000."""


@cache
def _field_docstrings(module: str) -> Mapping[str, Mapping[str, str]]:
    """Read the docstrings of the fields of the classes of a module, each on one line."""
    classes = [node for node in ast.parse(getsource(sys.modules[module])).body if isinstance(node, ast.ClassDef)]
    return {
        each.name: {
            field.target.id: cleandoc(text.value.value).replace("\n", " ")
            for field, text in pairwise(each.body)
            if isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
            and isinstance(text.value.value, str)
        }
        for each in classes
    }


def short_description(model: type[BaseModel], field: str) -> str:
    """Return the first sentence of the description of a field, without its unit."""
    parts = [base for base in model.__mro__ if issubclass(base, Part)]
    texts = [_field_docstrings(base.__module__).get(base.__name__, {}).get(field) for base in parts]
    text = next(filter(None, texts), model.model_fields[field].description or "")
    sentence = text.partition(". ")[0].partition(" [")[0].rstrip(".")
    return sentence[:1].lower() + sentence[1:]


class Part(BaseModel):
    """Base of all models: unknown fields are refused, a field that is not given is absent.

    An optional field that is null in a request is absent too, as some generated clients send what they leave out.

    The docstring of a field is its description in the contract. It is read when a schema is made: pydantic's
    `use_attribute_docstrings` reads it when the class is made, which adds a fifth of a second to every start. Fields
    named in `answered_last` come behind the others in an answer, whose order is otherwise that of the model.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    answered_last: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, content: Any) -> Any:
        if isinstance(content, dict) and None in content.values():
            optional = {name for name, field in cls.model_fields.items() if not field.is_required()}
            return {name: value for name, value in content.items() if value is not None or name not in optional}
        return content

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler, /) -> dict[str, Any]:
        """Return the schema with the docstrings of the fields."""
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for base in reversed(cls.__mro__):
            if issubclass(base, Part):
                for name, text in _field_docstrings(base.__module__).get(base.__name__, {}).items():
                    properties[name]["description"] = text
        return schema


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
        found: Solved = _solver_class(type(self))(**solver_arguments(self))
        return found


@cache
def _solver_class(model: type[SolverPart[Any]]) -> Any:
    """Return the class of the solver that a model, or one that it inherits from, names in brackets."""
    bases = [base for base in model.__mro__ if issubclass(base, SolverPart)]
    return next(filter(None, (base.__pydantic_generic_metadata__["args"] for base in bases)))[0]


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
