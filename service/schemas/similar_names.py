"""Names of the fields of requests, and suggestions for unknown ones."""

import difflib
import re
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from service.columns import unit_end
from service.names import ALIASES

CASE = {"projectile", "target", "impact", "resistance", "numerics", "search", "output", "alternatives"}
"""Top-level fields of the request for a case."""
SOUGHT = {
    "impact.oblique_angle_deg": "; the search determines the angle: `/trajectory` takes a strike at one angle",
    "impact.velocity_m_s": "; the search determines the speed: `/thickness` and `/trajectory` take one speed",
    "resistance.strength_factor": "; it is what is fitted here",
}
"""Ends of the messages for fields that a search or a fit determines, and that its request therefore does not have."""
SEPARATORS = re.compile(r"[^a-z0-9]+")
SIMILAR = 0.8
"""Smallest ratio of difflib at which a name is suggested, an arbitrary choice: it admits one wrong letter in five.
[1]"""


def field_names(
    schema: dict[str, Any], node: dict[str, Any] | None = None, before: str = "", *, in_lists: bool = True
) -> Iterator[str]:
    """Yield the dotted paths of the fields of a schema, with the fields of list items unless `in_lists` is False."""
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


def meant_as(field: str, known: Sequence[str]) -> str:
    """Return the known field that was probably meant by an unknown one; empty if none is similar.

    A common name of the same quantity takes precedence over a similar spelling, and a field of the same object over
    fields of other objects. Of other objects, only the fields of a case are suggested, not the fields of a study or a
    calibration.
    """
    holder, _, last = field.rpartition(".")
    name = SEPARATORS.sub("_", last.lower())
    cases = [each for each in known if each.partition(".")[0] in CASE]
    beside = [each for each in known if each.rpartition(".")[0] == holder]
    for places in (beside, cases):
        for each in places:
            if name in ALIASES.get(each, ()) or (places is beside and name in usual_names().get(last_name(each), ())):
                return each
        # Of several fields with the same name the first is kept, hence the reversed order. The unit may be omitted.
        whole = {each.rpartition(".")[2]: each for each in reversed(places)}
        names = {each.removesuffix(unit_end(each)): where for each, where in whole.items()} | whole
        for word in (name, last):
            if close := difflib.get_close_matches(word, names, 1, SIMILAR):
                return names[close[0]]
    return ""


def last_name(field: str) -> str:
    """Return the last part of a dotted path."""
    return field.rpartition(".")[2]


@cache
def usual_names() -> dict[str, tuple[str, ...]]:
    """Return the common names of quantities, keyed by field name, which is the same in all objects."""
    return {last_name(field): names for field, names in ALIASES.items()}
