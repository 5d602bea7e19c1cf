"""Messages for pydantic errors, which quote the given value and do not name Python types."""

import re
from collections.abc import Mapping, Sized
from typing import Any

UNKNOWN = "extra_forbidden"
"""Type of pydantic's error for an unknown field."""
LONGEST_SHOWN = 40
"""Largest number of characters of a text, and of digits of a number, that a message quotes: about half a line."""
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
"""Expected kind of value, keyed by the type of a pydantic error whose message names a Python type."""
LENGTH = re.compile(r"\w+ should have (.*?)(?: after validation.*)?")


def worded(error: Mapping[str, Any], unit: str = "") -> str:
    """Return the message for a pydantic error, which quotes the given value.

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
        # Pydantic reports an integer beyond the range of float64 as no number at all.
        return f"must be a finite number, got {shown(error['input'])}"
    space = unit if unit == "°" else f" {unit}".rstrip()
    if kind in EXPECTED or text.startswith("Input should be "):
        wanted = EXPECTED.get(kind) or text.removeprefix("Input should be ").replace("a valid ", "a ")
        return f"must be {wanted}{space}, got {shown(error['input'])}{space}"
    if found := LENGTH.fullmatch(text):
        return f"must have {found[1]}" + (f", got {len(error['input'])}" if isinstance(error["input"], Sized) else "")
    return text


def tag_worded(context: Mapping[str, str]) -> str:
    """Return the message for a union whose discriminator is missing or unknown."""
    name = context["discriminator"].strip("'")
    if "tag" not in context:
        return f"`{name}` is missing"
    return f"`{name}` must be one of {context['expected_tags']}, got {shown(context['tag'])}"


def shown(value: Any) -> str:
    """Return a value as it is quoted in a message, shortened if it is long."""
    if isinstance(value, Mapping):
        return "an object"
    if isinstance(value, list | tuple):
        return "a list"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return f"{value:.12g}"  # The bounds in the message have no more digits, and 95.0 becomes 95 as in a bound.
    if isinstance(value, int) and abs(value) >= 10**LONGEST_SHOWN:
        return f"a number of {len(str(abs(value)))} digits"
    return repr(value[:LONGEST_SHOWN] + "..." if isinstance(value, str) and len(value) > LONGEST_SHOWN else value)
