"""Errors of pydantic in the words of this project, with the value; its own name what only Python has."""

import re
from collections.abc import Mapping, Sized
from typing import Any

UNKNOWN = "extra_forbidden"
"""Type of the error of a field that a request does not have."""
LONGEST_SHOWN = 40
"""Characters of a text that an error quotes."""
PHRASES = {
    "missing": "is missing",
    UNKNOWN: "unknown field",
    "json_invalid": "is not JSON",
}
EXPECTED = {
    "dict_type": "an object",
    "model_type": "an object",
    "model_attributes_type": "an object",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list",
}
"""Expected kind of value by the type of an error of pydantic, where its own message names a Python type."""
LENGTH = re.compile(r"\w+ should have (.*?)(?: after validation.*)?")


def worded(error: Mapping[str, Any], unit: str = "") -> str:
    """Return the message of an error of pydantic in the words of this project, with the value.

    Parameters
    ----------
    unit
        Unit of the value and of its bounds.
    """
    kind, text = str(error["type"]), str(error["msg"]).removeprefix("Value error, ")
    if kind in PHRASES:
        return PHRASES[kind]
    if kind in {"union_tag_not_found", "union_tag_invalid"}:
        return tag_worded(error["ctx"])
    if kind == "float_type" and isinstance(error["input"], int) and not isinstance(error["input"], bool):
        return f"must be a finite number, got {shown(error['input'])}"  # A whole number beyond those of float64.
    space = unit if unit == "°" else f" {unit}".rstrip()
    if kind in EXPECTED or text.startswith("Input should be "):
        wanted = EXPECTED.get(kind) or text.removeprefix("Input should be ").replace("a valid ", "a ")
        return f"must be {wanted}{space}, got {shown(error['input'])}{space}"
    if found := LENGTH.fullmatch(text):
        return f"must have {found[1]}" + (f", got {len(error['input'])}" if isinstance(error["input"], Sized) else "")
    return text


def tag_worded(context: Mapping[str, str]) -> str:
    """Return the message for a part of several shapes or models that does not say which it is."""
    name = context["discriminator"].strip("'")
    if "tag" not in context:
        return f"`{name}` is missing"
    return f"`{name}` must be one of {context['expected_tags']}, got {shown(context['tag'])}"


def shown(value: Any) -> str:
    """Return a value as an error quotes it, the begin of a long text."""
    if isinstance(value, Mapping):
        return "an object"
    if isinstance(value, list | tuple):
        return "a list"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return f"{value:.12g}"  # The bounds beside it have no more digits, and 95.0 is 95 there.
    if isinstance(value, int) and abs(value) >= 10**LONGEST_SHOWN:
        return f"a number of {len(str(abs(value)))} digits"
    return repr(value[:LONGEST_SHOWN] + "..." if isinstance(value, str) and len(value) > LONGEST_SHOWN else value)
