"""Names of the fields of a request, and which of them a name that is none may be meant as."""

import difflib
import re
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from service.columns import unit_end
from service.names import ALIASES

CASE = {"projectile", "target", "impact", "resistance", "numerics", "search", "output", "alternatives"}
"""Parts of the request of a case."""
SOUGHT = {
    "impact.oblique_angle_deg": "; the angle is what is searched for here: `/trajectory` takes a strike at one angle",
    "impact.velocity_m_s": "; the speed is what is searched for here: `/thickness` and `/trajectory` take one speed",
    "resistance.strength_factor": "; it is what is fitted here",
}
"""Ends of the errors for fields that a search or a fit finds, which its request does not have."""
SEPARATORS = re.compile(r"[^a-z0-9]+")
SIMILAR = 0.8
"""Similarity above which a misspelt name gets a suggestion, by difflib. [1]"""


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


def meant_as(field: str, known: Sequence[str]) -> str:
    """Return which of these fields one that does not exist may be meant as; empty if none is close.

    A name of the same quantity comes before one that is spelled alike, and a field of the same part before others. A
    field of a case is not mistaken for one of a study or a calibration.
    """
    holder, _, last = field.rpartition(".")
    name = SEPARATORS.sub("_", last.lower())
    cases = [each for each in known if each.partition(".")[0] in CASE]
    beside = [each for each in known if each.rpartition(".")[0] == holder]
    for places in (beside, cases):
        for each in places:
            if name in ALIASES.get(each, ()) or (places is beside and name in usual_names().get(last_name(each), ())):
                return each
        # Of several places, the first one counts; a unit may be left out.
        whole = {each.rpartition(".")[2]: each for each in reversed(places)}
        names = {each.removesuffix(unit_end(each)): where for each, where in whole.items()} | whole
        for word in (name, last):
            if close := difflib.get_close_matches(word, names, 1, SIMILAR):
                return names[close[0]]
    return ""


def last_name(field: str) -> str:
    """Return the name of a field in its part."""
    return field.rpartition(".")[2]


@cache
def usual_names() -> dict[str, tuple[str, ...]]:
    """Return the usual names of quantities, by the name of their fields in any part: shots have masses too."""
    return {last_name(field): names for field, names in ALIASES.items()}
