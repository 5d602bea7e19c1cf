"""Conversion of solver results to answers: the source, the unit and the columns of each field of a model."""

import math
from collections.abc import Callable, Mapping, Sized
from enum import Enum
from functools import cache
from operator import attrgetter
from types import UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

import numpy as np
from pydantic import MISSING
from typing_extensions import TypeAliasType

from service.columns import IDENTITY, Column, unit_end
from service.schemas.quantities import STANDARD_GRAVITY, Of, Part, degrees, short_description
from solver.arrays import FloatArray

WHOLE_ANSWER = Of(lambda found: found)
"""Marker of a part of an answer that is converted from the same object as the whole answer."""
GIVEN = Of(None)
"""Marker of a field whose value is passed to `walk`, or added to the answer later."""


NOT_TABLED = ()
"""Marker of a number or a string that has no column in the tables of results."""


IDENTIFYING = {column.name for column in IDENTITY}
"""Fields that are columns in the tables of every operation."""


class AnswerField(NamedTuple):
    """Source and conversion of a field of an answer."""

    name: str
    get: Callable[[Any], Any] | None
    """Function from a solver result to the value; None for a field marked `GIVEN`."""
    part: type[Part] | None
    """Model of the value or, for a list, of its items."""
    optional: bool
    """True if an empty value is left out."""
    convert: Callable[[float], float]
    """Function that converts a number from the solver's unit to the unit of the field."""


@cache
def fields_of(model: type[Part]) -> tuple[AnswerField, ...]:
    """Return the fields of a model in the order in which an answer has them."""
    names = [name for name in model.model_fields if name not in model.answered_last]
    return tuple(_field(model, name) for name in (*names, *model.answered_last))


def _field(model: type[Part], name: str) -> AnswerField:
    info = model.model_fields[name]
    marks = [mark for mark in info.metadata if isinstance(mark, Of)]
    source = marks[-1].source if marks else name.removesuffix(unit_end(name))
    get = attrgetter(source) if isinstance(source, str) else source
    convert = degrees if name.endswith("_deg") else in_g if name.endswith("_g") else float
    return AnswerField(name, get, part_of(model, name), info.default is MISSING, convert)


def kind_of(annotation: Any) -> Any:
    """Return the type in an annotation, or `object` for a union of several types."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return kind_of(inner[0])
    if origin is Union or origin is UnionType:
        kinds = [kind for kind in inner if kind is not MISSING]
        return kind_of(kinds[0]) if len(kinds) == 1 else object
    return kind_of(annotation.__value__) if isinstance(annotation, TypeAliasType) else annotation


def part_of(model: type[Part], name: str) -> type[Part] | None:
    """Return the model of a field or, for a list, of its items; None if there is no model."""
    kind = kind_of(model.model_fields[name].annotation)
    while get_origin(kind) is list:
        kind = kind_of(get_args(kind)[0])
    return kind if isinstance(kind, type) and issubclass(kind, Part) else None


def walk(model: type[Part], found: Any, /, **given: Any) -> dict[str, Any]:
    """Convert a solver result to the JSON data of an answer, according to the fields of its model.

    Fields with the suffix `_deg` are converted to degrees, and fields with the suffix `_g` to multiples of standard
    gravity. Nested models are converted recursively, and optional fields that are None, empty or False are left out.

    Parameters
    ----------
    model
        Model of the answer.
    found
        Solver result.
    given
        Values of fields that the result does not contain.
    """
    answer = {}
    for field in fields_of(model):
        if field.name in given:
            value = given[field.name]
        elif field.get is not None:
            value = field.get(found)
        else:
            continue
        if isinstance(value, float):  # Most values are numbers, which are handled here without another call.
            answer[field.name] = field.convert(value)
        elif not field.optional or says_something(value):
            answer[field.name] = _to_json(field, value)
    return answer


def says_something(value: Any) -> bool:
    """Return True unless a value is None, False or an empty collection."""
    return not (value is None or value is False or (isinstance(value, Sized) and not len(value)))


def _to_json(field: AnswerField, value: Any) -> Any:
    if isinstance(value, float):
        return field.convert(value)
    if isinstance(value, list | tuple):
        return [_to_json(field, item) for item in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        return in_unit(field.name, value).tolist()
    return value if field.part is None or isinstance(value, dict) else walk(field.part, value)


@cache
def columns_of(model: type[Part], prefix: str = "", suffix: str = "") -> tuple[Column, ...]:
    """Return the table columns of an answer, or of a part of one.

    Parameters
    ----------
    model
        Model of the answer, or of a part of one.
    prefix, suffix
        Text before each name, and text after each description.
    """
    return tuple(
        Column(f"{prefix}{each.name}", f"{each.description}{suffix}", each.dtype)
        for name in model.tabled or [field.name for field in fields_of(model)]
        for each in _columns_of(model, name)
    )


def _columns_of(model: type[Part], name: str) -> tuple[Column, ...]:
    """Return the columns in the annotations of a field or, if it has none, one column for a number or a string."""
    info = model.model_fields[name]
    given = [mark for mark in info.metadata if isinstance(mark, Column | tuple)]
    if given or name in IDENTIFYING:
        return tuple(each for mark in given for each in ((mark,) if isinstance(mark, Column) else mark))
    kind = kind_of(info.annotation)
    if not (isinstance(kind, type) and issubclass(kind, float | int | str)):
        return ()
    dtype = "S32" if issubclass(kind, Enum) else "S512" if issubclass(kind, str) else "<f8"
    return (Column(name, short_description(model, name), dtype),)


def history_columns(model: type[Part], found: Any) -> dict[str, FloatArray]:
    """Return the columns of a motion over time, keyed by their names in the contract."""
    return {field.name: in_unit(field.name, field.get(found)) for field in fields_of(model) if field.get}


def in_g(acceleration: float) -> float:
    """Convert an acceleration from m/s² to multiples of standard gravity."""
    return float(acceleration / STANDARD_GRAVITY)


def in_unit(name: str, values: Any) -> Any:
    """Convert a number or an array from the solver's unit to the unit that the name of the field states."""
    if name.endswith("_g"):
        return values / STANDARD_GRAVITY
    return np.degrees(values) if name.endswith("_deg") else values


def in_solver_units(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a part of an answer back to the names and units of the solver."""
    ends = {name: unit_end(name) for name in answer}
    return {
        name.removesuffix(ends[name]): math.radians(value) if ends[name] == "_deg" else value
        for name, value in answer.items()
    }
