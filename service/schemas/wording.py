"""Messages for pydantic errors. They quote the given value, and do not name Python types."""

from collections.abc import Mapping, Sized
from typing import Any

from solver.units import WHOLE_DIGITS, Amount, number, whole_number

UNKNOWN = "extra_forbidden"
"""Type of pydantic's error for an unknown field."""
LONGEST_SHOWN = 40
"""Largest number of characters of a string, and of digits of a number, that a message quotes: about half a line."""
DIGITS = 12
"""Largest number of significant digits of a number that a message quotes. [1]"""
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
BOUNDS = {
    "greater_than": ("greater than", "gt"),
    "greater_than_equal": ("greater than or equal to", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("less than or equal to", "le"),
}
"""Words for a bound and its name in the context of a pydantic error, keyed by the type of the error."""
LENGTHS = {
    "too_short": ("at least", "min_length", "item"),
    "too_long": ("at most", "max_length", "item"),
    "string_too_short": ("at least", "min_length", "character"),
    "string_too_long": ("at most", "max_length", "character"),
}
"""Words for a bound on a length, its name in the context of a pydantic error, and the noun for the items that it
counts, keyed by the type of the error."""


def worded(error: Mapping[str, Any], unit: str = "") -> str:
    """Return the message for a pydantic error, which quotes the given value.

    Parameters
    ----------
    unit
        SI unit of the value and its bounds in the message.
    """
    condition, *amounts = out_of_bounds(error, unit) or (_worded(error),)
    return condition.format(*amounts) if amounts else condition


def _worded(error: Mapping[str, Any]) -> str:
    """Return the message for any error other than a number outside its bounds."""
    kind, text = str(error["type"]), str(error["msg"]).removeprefix("Value error, ")
    if kind in PHRASES:
        return PHRASES[kind]
    if kind in {"union_tag_not_found", "union_tag_invalid"}:
        return tag_worded(error["ctx"])
    if kind == "float_type" and isinstance(error["input"], int) and not isinstance(error["input"], bool):
        # Pydantic reports an integer beyond the range of float64 as if it were not a number.
        return f"must be a finite number, got {shown(error['input'])}"
    if kind in EXPECTED or text.startswith("Input should be "):
        wanted = EXPECTED.get(kind) or text.removeprefix("Input should be ").replace("a valid ", "a ")
        return f"must be {wanted}, got {shown(error['input'])}"
    if kind in LENGTHS:
        return _length_worded(error)
    return text


def _length_worded(error: Mapping[str, Any]) -> str:
    """Return the message for a list or a string that is too long or too short."""
    words, name, items = LENGTHS[error["type"]]
    bound = error["ctx"][name]
    found = f", got {whole_number(len(error['input']))}" if isinstance(error["input"], Sized) else ""
    return f"must have {words} {whole_number(bound)} {items}{'' if bound == 1 else 's'}{found}"


def out_of_bounds(error: Mapping[str, Any], unit: str) -> tuple[str, *tuple[Amount, ...]] | None:
    """Return the condition and amounts of a `ParameterError` for a number outside a bound; None for any other error.

    Parameters
    ----------
    unit
        SI unit of the number in the message.
    """
    words, name = BOUNDS.get(error["type"], ("", ""))
    value = error["input"]
    if not words or isinstance(value, str):  # A string comes from a query parameter.
        return None
    bound = error["ctx"][name]
    # The bounds of counts may have more digits than those of quantities, and are shown with all of them.
    digits = WHOLE_DIGITS if isinstance(bound, int) else DIGITS
    if isinstance(value, int) and abs(value) >= 10**LONGEST_SHOWN:
        return f"must be {words} {{}}, got {shown(value)}", Amount(bound, unit, digits)
    return f"must be {words} {{}}, got {{}}", Amount(bound, unit, digits), Amount(value, unit, digits)


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
        return number(value, "", DIGITS)  # Bounds are shown in the same form.
    if isinstance(value, int):
        long = abs(value) >= 10**LONGEST_SHOWN
        return f"a number of {len(str(abs(value)))} digits" if long else whole_number(value)
    return repr(value[:LONGEST_SHOWN] + "..." if isinstance(value, str) and len(value) > LONGEST_SHOWN else value)
