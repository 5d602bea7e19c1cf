"""Messages of validation errors, with the unit of a bound, a likely unit of the value or a similar field added."""

import re
from collections.abc import Mapping
from functools import cache
from inspect import isclass
from typing import Any

from pydantic import BaseModel

from service import schemas
from service.columns import shown_in, unit_end
from service.schemas.batches import MOST_CASES, MOST_LINES
from service.schemas.similar_names import SOUGHT, field_names, meant_as
from service.schemas.sweeps import schema_of
from service.schemas.wording import UNKNOWN, out_of_bounds, worded
from solver.checks import BOUNDS, ParameterError, require_bounds
from solver.units import whole_number

ITEM = re.compile(r"(\.\d+)+$")
"""Indices at the end of the path of a field. They are removed, as an item has the unit of its list."""
LONGEST_MISSPELT = 200
"""Longest pointer for which a similar field is suggested [characters]: difflib takes longer for longer names. No
pointer of the contract is half as long."""


def explained(pointer: str, error: Mapping[str, Any], *, suggest: bool = True) -> str:
    """Return the message of a pydantic error for the field at a pointer into a request.

    Parameters
    ----------
    suggest
        True to search for a known field that is similar to an unknown one.
    """
    if error["type"] == UNKNOWN:
        return worded(error) + (suggestion(pointer) if suggest and len(pointer) <= LONGEST_MISSPELT else "")
    if error["type"] == "too_long" and pointer == "/cases":
        most, lines = whole_number(MOST_CASES), whole_number(MOST_LINES)
        return f"may have {most} cases at most; send JSON lines (`application/jsonl`), up to {lines}"
    name = pointer.strip("/").replace("/", ".")
    if out_of_bounds(error, "") is None:
        return worded(error)
    field = name.removesuffix(unit_end(name))
    try:
        if field in BOUNDS:
            require_bounds(field, error["input"])
    except ParameterError as bound:
        return bound.requirement
    return worded(error, shown_in(ITEM.sub("", name)))


def suggestion(pointer: str) -> str:
    """Return the end of the message for an unknown field: a similar field, or the fields of the same object."""
    field = ".".join(step for step in pointer.split("/") if step and not step.isdigit())
    known = known_fields()
    if field in known:  # The field exists in another request, so it is not misspelt.
        return SOUGHT.get(field, "; it belongs to another request, shape or model")
    if meant := meant_as(field, known):
        return f"; did you mean `{meant}`?"
    holder, _, _ = field.rpartition(".")
    beside = [name.rpartition(".")[2] for name in known if name.rpartition(".")[0] == holder]
    return f"; {holder} has {', '.join(beside)}" if beside and holder else ""


@cache
def known_fields() -> list[str]:
    """Return the dotted paths of the fields of all requests."""
    models = [each for name, each in vars(schemas).items() if name.endswith("Request") and isclass(each)]
    found = (name for model in models if issubclass(model, BaseModel) for name in field_names(schema_of(model)))
    return sorted(set(found))
