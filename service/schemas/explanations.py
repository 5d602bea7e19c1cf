"""Errors of validation in words: the unit of a bound, the unit a value may be meant in, the field that is meant."""

import difflib
from collections.abc import Iterator, Mapping
from functools import cache
from inspect import isclass
from typing import Any

from pydantic import BaseModel

from service import schemas
from service.columns import unit_end, unit_of
from service.schemas.batches import MOST_CASES, MOST_LINES
from service.schemas.sweeps import schema_of
from solver.checks import BOUNDS, ParameterError, require_bounds

UNKNOWN = "extra_forbidden"
"""Type of the error of a field that a request does not have."""
SEARCHED = {
    "impact.oblique_angle_deg": "; the angle is what is searched for here: `/trajectory` takes a strike at one angle",
    "impact.velocity_m_s": "; the speed is what is searched for here: `/thickness` and `/trajectory` take one speed",
}
"""Ends of the errors for fields that a search varies, which its request does not have."""
NO_OBJECT = {"dict_type", "model_attributes_type", "model_type"}
"""Types of the errors of a value that should be an object: pydantic names the class that it would make of it."""
OUT_OF_BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
"""Types of the errors of numbers outside their bounds."""
CASE = {"projectile", "target", "impact", "resistance", "numerics", "search", "output", "alternatives"}
"""Parts of the request of a case."""
LONGEST_MISSPELT = 200
"""Longest pointer to a field that may be a misspelt one: difflib takes time in proportion to the length of a name."""
SIMILAR = 0.8
"""Similarity above which a misspelt name gets a suggestion, by difflib. [1]"""


def explained(pointer: str, error: Mapping[str, Any], *, suggest: bool = True) -> str:
    """Return the message of an error of pydantic for the field at a pointer into a request.

    Parameters
    ----------
    suggest
        Whether to look for the field that an unknown one may be meant as.
    """
    detail: str = error["msg"]
    if error["type"] == UNKNOWN:
        return detail + suggestion(pointer) if suggest and len(pointer) <= LONGEST_MISSPELT else detail
    if error["type"] in NO_OBJECT:
        return "Input should be an object"
    if error["type"] == "too_long" and pointer == "/cases":
        return f"may have {MOST_CASES:,} cases at most; send JSON lines (`application/jsonl`), up to {MOST_LINES:,}"
    if error["type"] not in OUT_OF_BOUNDS:
        return detail
    field = pointer.strip("/").replace("/", ".").removesuffix(unit_end(pointer))
    try:
        if field in BOUNDS:
            require_bounds(field, error["input"])
    except ParameterError as bound:
        return bound.requirement
    unit = unit_of(pointer)
    return f"{detail}°" if unit == "°" else f"{detail} {unit}".rstrip()


def suggestion(pointer: str) -> str:
    """Return the end of an error for an unknown field: the field it may be meant as, or those beside it."""
    field = ".".join(step for step in pointer.split("/") if step and not step.isdigit())
    known = known_fields()
    if field in known:  # The field belongs to another request.
        return SEARCHED.get(field, "")
    holder, _, last = field.rpartition(".")
    # Of several places, the first one counts; a field of a case is not mistaken for one of a study or a calibration.
    anywhere = {name.rpartition(".")[2]: name for name in reversed(known) if name.partition(".")[0] in CASE}
    beside = {name.rpartition(".")[2]: name for name in known if name.rpartition(".")[0] == holder}
    for names in (beside, anywhere):
        without_unit = [name for name in names if name.startswith(f"{last}_")]
        if close := without_unit or difflib.get_close_matches(last, names, 1, SIMILAR):
            return f"; did you mean `{names[close[0]]}`?"
    return f"; {holder} has {', '.join(beside)}" if beside and holder else ""


@cache
def known_fields() -> list[str]:
    """Return the fields of all requests, by their places."""
    models = [each for name, each in vars(schemas).items() if name.endswith("Request") and isclass(each)]
    found = (name for model in models if issubclass(model, BaseModel) for name in field_names(schema_of(model)))
    return sorted(set(found))


def field_names(
    schema: dict[str, Any], node: dict[str, Any] | None = None, before: str = "", *, in_lists: bool = True
) -> Iterator[str]:
    """Yield the fields of a schema and of its parts, those of the items of lists too unless they are left out."""
    node = schema if node is None else node
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    for variant in node.get("oneOf", node.get("anyOf", ())):
        yield from field_names(schema, variant, before, in_lists=in_lists)
    if in_lists and "items" in node:
        yield from field_names(schema, node["items"], before)
    for name, field in node.get("properties", {}).items():
        yield f"{before}{name}"
        yield from field_names(schema, field, f"{before}{name}.", in_lists=in_lists)
