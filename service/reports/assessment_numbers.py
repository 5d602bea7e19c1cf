"""Numbers of answers as they stand in a report: each with its pointer and its full value."""

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

MINUS, NARROW = "\N{MINUS SIGN}", "\N{NARROW NO-BREAK SPACE}"


def lookup(content: Any, pointer: str) -> Any:
    """Return what stands at a JSON pointer, None if nothing does."""
    for step in pointer.split("/")[1:]:
        if isinstance(content, Mapping):
            content = content.get(step)
        elif isinstance(content, Sequence) and not isinstance(content, str):
            content = content[int(step)] if int(step) < len(content) else None
        else:
            return None
    return content


class Numbers:
    """Writes numbers that stand in answers; each keeps its pointer and all its digits in the page.

    Parameters
    ----------
    content
        The answers by name.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = content

    def at(self, pointer: str) -> Any:
        """Return what stands at a JSON pointer, None if nothing does."""
        return lookup(self._content, pointer)

    def fixed(self, pointer: str, decimals: int, *, factor: float = 1.0, unit: str = "") -> Markup:
        """Return a number, times a factor, with so many decimals; nothing if there is none."""
        return self._written(pointer, factor, f".{decimals}f", unit)

    def short(self, pointer: str, *, factor: float = 1.0, digits: int = 3, unit: str = "") -> Markup:
        """Return a number, times a factor, with so many significant digits; nothing if there is none."""
        return self._written(pointer, factor, f".{digits}g", unit)

    def angle(self, pointer: str, decimals: int = 2) -> Markup:
        """Return an angle in degrees."""
        return self.fixed(pointer, decimals, unit="°")

    def _written(self, pointer: str, factor: float, spec: str, unit: str) -> Markup:
        value = self.at(pointer)
        if value is None:
            return Markup()
        text = _plain(format(value * factor, spec)).replace("-", MINUS)
        return Markup('<data value="{}" data-from="{}" data-factor="{:g}">{}</data>{}').format(
            repr(float(value)), pointer, factor, text, unit.replace(" ", "\N{NO-BREAK SPACE}")
        )


def _plain(text: str) -> str:
    """Write a small power of ten in full, without a sign at zero."""
    mantissa, exponent, power = text.partition("e")
    if exponent and 0 <= int(power) <= 6:
        text = f"{float(text):.0f}"
    elif exponent:
        text = f"{mantissa}e{int(power)}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def sentence(text: str) -> Markup:
    """Return a warning as a sentence: with a capital and a full stop."""
    return escape(text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else "."))
