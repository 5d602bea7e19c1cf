"""Errors of validation in words: the unit of a bound, the unit a value may be meant in, the field that is meant."""

import re
from collections.abc import Mapping
from functools import cache
from inspect import isclass
from typing import Any

from pydantic import BaseModel

from service import schemas
from service.columns import unit_end, unit_of
from service.schemas.batches import MOST_CASES, MOST_LINES
from service.schemas.similar_names import SOUGHT, field_names, meant_as
from service.schemas.sweeps import schema_of
from service.schemas.wording import UNKNOWN, worded
from solver.checks import BOUNDS, ParameterError, require_bounds

OUT_OF_BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
"""Types of the errors of numbers outside their bounds."""
ITEM = re.compile(r"(/\d+)+$")
"""Index at the end of a JSON pointer; the item has the unit of its list."""
LONGEST_MISSPELT = 200
"""Longest pointer to a field that may be a misspelt one: difflib takes time in proportion to the length of a name."""


def explained(pointer: str, error: Mapping[str, Any], *, suggest: bool = True) -> str:
    """Return the message of an error of pydantic for the field at a pointer into a request.

    Parameters
    ----------
    suggest
        Whether to look for the field that an unknown one may be meant as.
    """
    if error["type"] == UNKNOWN:
        return worded(error) + (suggestion(pointer) if suggest and len(pointer) <= LONGEST_MISSPELT else "")
    if error["type"] == "too_long" and pointer == "/cases":
        return f"may have {MOST_CASES:,} cases at most; send JSON lines (`application/jsonl`), up to {MOST_LINES:,}"
    if error["type"] not in OUT_OF_BOUNDS:
        return worded(error)
    field = pointer.strip("/").replace("/", ".").removesuffix(unit_end(pointer))
    try:
        if field in BOUNDS:
            require_bounds(field, error["input"])
    except ParameterError as bound:
        return bound.requirement
    return worded(error, unit_of(ITEM.sub("", pointer)))


def suggestion(pointer: str) -> str:
    """Return the end of an error for an unknown field: the field it may be meant as, or those beside it."""
    field = ".".join(step for step in pointer.split("/") if step and not step.isdigit())
    known = known_fields()
    if field in known:  # The field belongs to another request.
        return SOUGHT.get(field, "; it belongs to another request, shape or model")
    if meant := meant_as(field, known):
        return f"; did you mean `{meant}`?"
    holder, _, _ = field.rpartition(".")
    beside = [name.rpartition(".")[2] for name in known if name.rpartition(".")[0] == holder]
    return f"; {holder} has {', '.join(beside)}" if beside and holder else ""


@cache
def known_fields() -> list[str]:
    """Return the fields of all requests, by their places."""
    models = [each for name, each in vars(schemas).items() if name.endswith("Request") and isclass(each)]
    found = (name for model in models if issubclass(model, BaseModel) for name in field_names(schema_of(model)))
    return sorted(set(found))
