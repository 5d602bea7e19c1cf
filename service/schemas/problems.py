"""Problems as the contract has them (RFC 9457), and JSON pointers into requests (RFC 6901)."""

from collections.abc import Iterable
from functools import cache
from typing import Annotated

from pydantic import Field

from service.columns import unit_end
from service.schemas.quantities import Part, with_examples

TAGGED = frozenset({"distribution", "nose", "strength_factor"})
"""Fields of several shapes. In a place inside one of them, pydantic names the shape after the field."""

PLACES = {"velocity": "impact.velocity", "sample_interval": "output.sample_interval"}
"""Arguments of the solver that are elsewhere in a request."""

UNITLESS = frozenset({"distribution", "weights"})
"""Parts whose numbers are named after quantities, but have no units."""


def json_pointer(steps: Iterable[str | int]) -> str:
    """Pointer of these steps."""
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)


def pointer_of_location(location: Iterable[str | int]) -> str:
    """Pointer of a location of pydantic."""
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
    """Pointer of an input as the solver names it, such as ``projectile.length``."""
    names = PLACES.get(field, field).split(".")
    ends = {} if UNITLESS & set(names) else unit_ends()
    return json_pointer(f"{name}{ends.get(name, '')}" for name in names)


def unit_ends() -> dict[str, str]:
    """Return what the contract adds to the names of the solver: the units with which the models name quantities.

    Collected anew each time, because not every command has imported all models yet.
    """
    ends: dict[str, str] = {}
    models = [Part]
    for model in models:  # It grows on the way.
        models += model.__subclasses__()
        ends |= ends_in(model)
    return ends


@cache
def ends_in(model: type[Part]) -> dict[str, str]:
    """Return the units in the names of the fields of a model, by the names without them."""
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
    """One thing that is wrong with the request."""

    model_config = with_examples(TOO_SHORT)

    pointer: str
    """JSON pointer (RFC 6901) into the request body; empty for all of it. Of a JSONL body the first step is the line,
    counted from 0."""
    detail: str
    """What is wrong with it."""


class Problem(Part):
    """Why there is no answer (RFC 9457)."""

    model_config = with_examples(INVALID)

    type: str
    """Stable, for programs; the manual lists all of them."""
    title: str
    """Title of the type."""
    status: Annotated[int, Field(ge=400, le=599)]
    """The HTTP status."""
    detail: str
    """What happened in this occurrence."""
    instance: str
    """Path of the request."""
    errors: list[ProblemError]
    """What is wrong with the request body, if anything is."""
