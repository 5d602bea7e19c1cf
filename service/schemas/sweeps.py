"""Models of sweeps, and the grid of their points."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import new_class
from typing import Annotated, Any, Generic, Self, TypeVar

from pydantic import MISSING, BaseModel, Field, StringConstraints, model_validator
from pydantic_core import PydanticCustomError

from service.schemas.batches import MOST_LINES, Batch, NamedCase, ResultItem, Results
from service.schemas.problems import INVALID
from service.schemas.quantities import WHOLE, Count, Num, Part, with_examples
from service.schemas.requests import Case
from service.schemas.similar_names import SOUGHT, field_names, meant_as
from solver.units import whole_number

MOST_AXES = 4
"""Largest number of axes, an arbitrary choice: ten values on each of four axes are 10,000 points already."""
EVEN = {"field": "impact.velocity_m_s", "start": 200.0, "stop": 300.0, "count": 3}
ANGLES = {"field": "impact.oblique_angle_deg", "values": [0.0, 20.0]}
LISTED = {"field": "target.compressive_strength_pa", "values": [39e6, 97e6]}

Base = TypeVar("Base", bound=Case)
AxisNumber = Annotated[Num, Field(ge=-1e300, le=1e300)]


class Axis(Part):
    """A field and its values, either listed or evenly spaced between two ends, both included."""

    model_config = with_examples(EVEN, LISTED)

    # No path of a field is half as long. The bound keeps errors short, since they quote the path.
    field: Annotated[str, StringConstraints(strict=True, min_length=1, max_length=200)]
    """Dotted path to a number of the base, such as `impact.velocity_m_s`."""
    values: Annotated[list[AxisNumber], Field(min_length=1, max_length=MOST_LINES, fail_fast=True)] | MISSING = MISSING
    """List of all values, in any order."""
    start: AxisNumber | MISSING = MISSING
    """First value, unless the values are listed."""
    stop: AxisNumber | MISSING = MISSING
    """Last value, unless the values are listed."""
    count: Annotated[Count, Field(ge=1, le=MOST_LINES), WHOLE] | MISSING = MISSING
    """Number of values from `start` to `stop`, both included."""

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        listed = self.values is not MISSING
        given = [part is not MISSING for part in (self.start, self.stop, self.count)]
        if any(given) if listed else not all(given):
            raise PydanticCustomError("axis_form", "takes either `values` or all of `start`, `stop` and `count`")
        return self

    def numbers(self) -> list[float]:
        """Return the values of the axis."""
        if self.values is not MISSING:
            return self.values
        assert self.start is not MISSING  # noqa: S101 (`_check_form` requires it)
        assert self.stop is not MISSING  # noqa: S101
        assert self.count is not MISSING  # noqa: S101
        if self.count == 1:
            return [self.start]
        # The last value is `stop` itself, which a sum of rounded steps would miss.
        step = (self.stop - self.start) / (self.count - 1)
        return [self.start + step * i for i in range(self.count - 1)] + [self.stop]


class Sweep(Part, Generic[Base]):
    """Cases of one operation that differ in the fields of the axes."""

    base: Base
    """Complete request in which the axes replace the values of their fields."""
    axes: Annotated[list[Axis], Field(min_length=1, max_length=MOST_AXES)]


@dataclass(frozen=True, slots=True)
class CaseModels:
    """Models of batches and sweeps of one operation."""

    base: type[Case]
    """Model of a point of a sweep."""
    case: type[Case]
    batch: type[Part]
    sweep: type[Part]
    results: type[Part]

    @classmethod
    def of(
        cls,
        name: str,
        base: type[Case],
        answer: type[Part],
        *,
        one: str,
        many: str,
        verb: str,
        example: Mapping[str, Any],
        custom_id: str,
        axes: Sequence[Mapping[str, Any]],
        result: Mapping[str, Any],
        items: Sequence[Mapping[str, Any]] = (),
    ) -> Self:
        """Make the models of the batches and sweeps of an operation.

        Parameters
        ----------
        name
            Prefix of the names of the models.
        base, answer
            Models of a request in a batch and of its answer.
        one, many, verb
            Words for the result in the singular and the plural, and `compute` or `find`.
        example, custom_id, axes, result
            Request, name of a case, axes of a sweep and answer for the examples.
        items
            Examples of cases in an answer; by default one with a result and one with a problem.
        """

        def model(kind: str, doc: str, *examples: Mapping[str, Any], bases: tuple[Any, ...]) -> Any:
            body = {"__doc__": doc, "__module__": __name__, "model_config": with_examples(*map(dict, examples))}
            return new_class(f"{name}{kind}", bases, exec_body=lambda namespace: namespace.update(body))

        title, found = f"{many[0].upper()}{many[1:]}", {"index": 0, "result": result}
        case = model(
            "Case", f"A case of a batch of {many}.", {**example, "custom_id": custom_id}, bases=(NamedCase, base)
        )
        item = model(
            "Item",
            f"One {one} as a case of a batch: its result, or the problem that prevented it.",
            *(items or (found, {"index": 1, "problem": INVALID})),
            bases=(ResultItem.__class_getitem__(answer),),
        )
        return cls(
            base,
            case,
            model(
                "Batch",
                f"{title} to {verb}.",
                {"cases": [example, {**example, "custom_id": "again"}]},
                bases=(Batch.__class_getitem__(case),),
            ),
            model(
                "Sweep",
                f"{title} that differ in the fields of the axes: every combination, the last axis fastest.",
                {"base": example, "axes": axes},
                bases=(Sweep.__class_getitem__(base),),
            ),
            model(
                "Results",
                f"{title}, in the order of the request.",
                {"results": [found]},
                bases=(Results.__class_getitem__(item),),
            ),
        )


class Outline(Part):
    """Body of a sweep whose points have not been validated yet, since they are validated in blocks."""

    base: dict[str, Any]
    axes: Annotated[list[Axis], Field(min_length=1, max_length=MOST_AXES, fail_fast=True)]


class AxisError(Exception):
    """An axis of a sweep is not valid.

    Parameters
    ----------
    pointer
        JSON pointer to the axes, or to the field of one of them.
    detail
        Description of the error.
    """

    def __init__(self, pointer: str, detail: str) -> None:
        super().__init__(detail)
        self.pointer = pointer
        self.detail = detail


class Grid:
    """Points of a sweep in order.

    Parameters
    ----------
    model
        Model with which every point is validated.
    outline
        Base and axes.

    Raises
    ------
    AxisError
        If an axis does not name a number of the base, two axes name the same one, or there are too many points.
    """

    def __init__(self, model: type[BaseModel], outline: Outline) -> None:
        self.base = outline.base
        self.fields = [axis.field for axis in outline.axes]
        self.listed = [axis.values is not MISSING for axis in outline.axes]
        self.values = [axis.numbers() for axis in outline.axes]
        self.count = math.prod(map(len, self.values))
        self._paths = [field.split(".") for field in self.fields]
        for number, field in enumerate(self.fields):
            try:
                check_field(model, self.base, self._paths[number])
                if field in self.fields[:number]:
                    raise LookupError("is the field of another axis")
            except LookupError as error:
                raise AxisError(f"/axes/{number}/field", f"{field!r} {error.args[0]}") from None
        if self.count > MOST_LINES:
            points, most = whole_number(self.count), whole_number(MOST_LINES)
            raise AxisError("/axes", f"make {points} points; {most} at most are computed")

    def points(self) -> Iterator[tuple[float, ...]]:
        """Return an iterator over the values of the axes at all points; the last axis varies fastest."""
        return itertools.product(*self.values)

    def request(self, point: Sequence[float]) -> dict[str, Any]:
        """Return the request of a point: the base with the values of the axes."""
        request = self.base
        for path, value in zip(self._paths, point, strict=True):
            request = put(request, path, value)
        return request

    def pointer(self, number: int, pointer: str) -> str:
        """Convert a pointer into the request of a point to a pointer into the sweep."""
        for axis, path in enumerate(self._paths):
            if pointer == "/" + "/".join(path):
                later = math.prod(map(len, self.values[axis + 1 :]))
                index = number // later % len(self.values[axis])
                return f"/axes/{axis}/values/{index}" if self.listed[axis] else f"/axes/{axis}"
        return f"/base{pointer}"


def put(part: Mapping[str, Any], path: Sequence[str], value: float) -> dict[str, Any]:
    """Return a copy of an object with a value at a path."""
    name, *rest = path
    return {**part, name: put(part.get(name) or {}, rest, value) if rest else value}


def check_field(model: type[BaseModel], base: dict[str, Any], path: Sequence[str]) -> None:
    """Check that a path leads to a number of the request.

    Raises
    ------
    LookupError
        If there is no number at the path; the message is the end of a sentence that begins with the path.
    """
    schema, given = schema_of(model), base
    node: dict[str, Any] = schema
    for name in path:
        node = _variant(schema, _resolved(schema, node), given)
        if name not in node.get("properties", {}):
            raise LookupError(f"is no field of the request{_reason(schema, '.'.join(path))}")
        if not isinstance(given, dict):
            raise LookupError(f"is not there: the part that has {name!r} is not an object in the base")
        node, given = node["properties"][name], given.get(name) or {}
    if _resolved(schema, node).get("type") not in {"number", "integer"}:
        raise LookupError("is no number")


def _reason(schema: dict[str, Any], field: str) -> str:
    """Return the end of the message for a path that is not a field of the request."""
    names = set(field_names(schema))
    if field in names:
        return " with the shape or model that the base has there"
    if field in SOUGHT:
        return SOUGHT[field]
    meant = meant_as(field, sorted(names))
    return f"; did you mean `{meant}`?" if meant else ""


@cache
def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON schema of a request model, cached after the first call."""
    return model.model_json_schema()


def _resolved(schema: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _variant(schema: dict[str, Any], node: dict[str, Any], given: Any) -> dict[str, Any]:
    """Return the variant of a union that the base selects."""
    if "discriminator" not in node:
        return node
    name, mapping = node["discriminator"]["propertyName"], node["discriminator"]["mapping"]
    tag = given.get(name) if isinstance(given, dict) else None
    if not isinstance(tag, str) or tag not in mapping:
        raise LookupError(f"cannot be checked: set {name!r} in the base to one of {', '.join(mapping)}")
    return _resolved(schema, {"$ref": mapping[tag]})
