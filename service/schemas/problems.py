"""Models of problem documents (RFC 9457), and JSON pointers into requests (RFC 6901)."""

from collections.abc import Iterable
from functools import cache
from typing import Annotated

from pydantic import MISSING, Field

from service.columns import unit_end
from service.schemas.quantities import Num, Part, with_examples

TAGGED = frozenset({"distribution", "nose", "strength_factor"})
"""Fields that are unions. In a location inside one of them, pydantic inserts the name of the variant."""

PLACES = {"velocity": "impact.velocity", "sample_interval": "output.sample_interval"}
"""Dotted paths in a request, keyed by the names of solver arguments that do not belong to an object."""

UNITLESS = frozenset({"distribution", "weights"})
"""Parts of a request in which the names of quantities have no unit suffix."""


def json_pointer(steps: Iterable[str | int]) -> str:
    """Return the JSON pointer with these steps, escaped as in RFC 6901."""
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)


def pointer_of_location(location: Iterable[str | int]) -> str:
    """Convert the location of a pydantic error to a JSON pointer."""
    steps: list[str | int] = []
    in_tagged = False
    for step in location:
        if in_tagged:
            in_tagged = False
        else:
            steps.append(step)
            in_tagged = step in TAGGED
    return json_pointer(steps)


def pointer_of_parameter(field: str) -> str:
    """Convert the solver's name of an input, such as ``projectile.length``, to a JSON pointer."""
    names = PLACES.get(field, field).split(".")
    ends = {} if UNITLESS & set(names) else unit_ends()
    return json_pointer(f"{name}{ends.get(name, '')}" for name in names)


def unit_ends() -> dict[str, str]:
    """Return the unit suffixes that the contract adds to names of the solver, keyed by the solver's names.

    They are collected at each call, because not every command has imported all models yet.
    """
    ends: dict[str, str] = {}
    models = [Part]
    for model in models:  # The loop visits the subclasses that it appends, so it walks the whole tree of models.
        models += model.__subclasses__()
        ends |= ends_in(model)
    return ends


@cache
def ends_in(model: type[Part]) -> dict[str, str]:
    """Return the unit suffixes of the fields of a model, keyed by the names without the suffix."""
    return {name.removesuffix(end): end for name in model.model_fields if (end := unit_end(name))}


TOO_SHORT = {
    "pointer": "/projectile/length_m",
    "detail": "must be at least the length of the nose, 0.132665 m, got 0.1 m",
}
INVALID = {
    "type": "urn:ricochet:problem:invalid-request",
    "title": "The request does not fit the contract",
    "status": 422,
    "detail": ": ".join(TOO_SHORT.values()),
    "instance": "/cra",
    "errors": [TOO_SHORT],
}


class ProblemError(Part):
    """One error in the request."""

    model_config = with_examples(TOO_SHORT)

    pointer: str
    """JSON pointer (RFC 6901) into the request body, empty for the whole body. In a JSONL body the first step is the
    line, counted from 0."""
    detail: str
    """Description of the error."""


class Problem(Part):
    """Problem document (RFC 9457): the reason why there is no answer."""

    model_config = with_examples(INVALID)

    type: str
    """Stable type of the problem, for programs. The manual lists all types."""
    title: str
    """Title of the type."""
    status: Annotated[int, Field(ge=400, le=599)]
    """HTTP status."""
    detail: str
    """Description of this occurrence."""
    instance: str
    """Path of the request."""
    errors: list[ProblemError]
    """Errors in the request body; empty if there are none."""
    stopped_at_s: Num | MISSING = MISSING
    """Time of the motion that the largest number of steps reached, only for the type `step-limit`. [s]"""
