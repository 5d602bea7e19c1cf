"""Fields of a case by their dotted names, and which of them an unknown one may be meant as."""

import difflib
from collections.abc import Iterator
from typing import Any

CLOSE = 0.8
"""Likeness of two names from which one may be meant as the other, by difflib."""


def suggestion(pointer: str) -> str:
    """Return the end of an error for an unknown field: the field it may be meant as, or those beside it."""
    from service.schemas import CriticalAngleRequest, TrajectoryRequest
    from service.schemas.sweeps import schema_of

    field = pointer.strip("/").replace("/", ".")
    known = sorted({name for model in (CriticalAngleRequest, TrajectoryRequest) for name in _names(schema_of(model))})
    if field in known:  # of another request
        return ""
    holder, _, last = field.rpartition(".")
    anywhere = {name.rpartition(".")[2]: name for name in known}
    beside = {name.rpartition(".")[2]: name for name in known if name.rpartition(".")[0] == holder}
    for names in (beside, anywhere):
        without_unit = [name for name in names if name.startswith(f"{last}_")]
        if close := without_unit or difflib.get_close_matches(last, names, 1, CLOSE):
            return f"; did you mean `{names[close[0]]}`?"
    return f"; {holder} has {', '.join(beside)}" if beside and holder else ""


def _names(schema: dict[str, Any], node: dict[str, Any] | None = None, before: str = "") -> Iterator[str]:
    """Yield the fields of a schema, and of its parts."""
    node = schema if node is None else node
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    for variant in node.get("oneOf", node.get("anyOf", ())):
        yield from _names(schema, variant, before)
    for name, field in node.get("properties", {}).items():
        yield f"{before}{name}"
        yield from _names(schema, field, f"{before}{name}.")
