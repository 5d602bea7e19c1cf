"""The page of a report: one HTML file that needs nothing else."""

import base64
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from importlib.resources import files

import jinja2
from markupsafe import Markup, escape

from service.reports.contents import Comparison, Section, Table

NARROW = "\N{NARROW NO-BREAK SPACE}"
SHORT = 5
"""Significant digits of a number that is written out."""
MOST_SPREAD = 1e5
"""Over this, the numbers of a column are printed each for itself."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class ShownSection:
    """A section and its figures as SVG."""

    section: Section
    pictures: Sequence[bytes]

    @property
    def anchor(self) -> str:
        """Where the table of contents leads."""
        return re.sub(r"[^a-z0-9]+", "-", self.section.title.lower()).strip("-")


def render(*, title: str, introduction: Sequence[str], shown: Sequence[ShownSection]) -> str:
    """Return the page as text.

    Parameters
    ----------
    title, introduction
        Its head.
    shown
        Its sections.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {
        "prose": prose,
        "number": number,
        "cells": cells,
        "ours": ours,
        "difference": difference,
        "embedded": embedded,
    }
    held = [each.holds for part in shown for each in part.section.comparisons if each.holds is not None]
    template = environment.from_string(files("service.reports").joinpath("template.html").read_text(encoding="utf-8"))
    return template.render(title=title, introduction=introduction, shown=shown, held=sum(held), checked=len(held))


def prose(text: str) -> Markup:
    """Text with `code` and **strong**, the rest as it is."""
    marked = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", marked))  # noqa: S704 (escaped above)


def number(value: float | None, digits: int = 4) -> str:
    """A few significant digits, or all that a short number has; nothing for nothing."""
    if value is None or math.isnan(value):
        return ""
    return _printed(f"{value:.{max(digits, SHORT) if _is_short(value) else digits}g}")


def ours(comparison: Comparison) -> str:
    """Our number with four significant digits, or as many decimals as the reference if these are more."""
    return _printed(f"{comparison.ours:.{_decimals(comparison)}f}")


def difference(comparison: Comparison) -> str:
    """The difference with the decimals of our number, and up to two more if it is smaller than these show."""
    if comparison.difference is None:
        return ""
    decimals = _decimals(comparison)
    places = min(max(decimals, _places(comparison.difference, 2)), decimals + 2)
    rounded = round(comparison.difference, places)
    return _printed(f"{rounded:+.{places}f}") if rounded else "0"


def _decimals(comparison: Comparison) -> int:
    printed = comparison.reference if comparison.reference is not None and _is_short(comparison.reference) else 0.0
    return min(max(_places(comparison.ours, 4), _natural_places(printed)), 9)


def cells(table: Table) -> list[list[tuple[str, bool]]]:
    """The rows as texts, each with whether it is a number; numbers of a column have the same decimals."""
    columns = [_column(values) for values in zip(*table.rows, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def _column(values: Sequence[object]) -> list[tuple[str, bool]]:
    numbers = [value for value in values if isinstance(value, float) and not math.isnan(value)]
    places = _common_places(numbers)
    texts = []
    for value in values:
        if not isinstance(value, float):
            texts.append(("" if value is None else str(value), isinstance(value, int)))
        elif places is None or math.isnan(value):
            texts.append((number(value), True))
        else:
            texts.append((_printed(f"{round(value, places) + 0.0:.{places}f}"), True))
    return texts


def _common_places(numbers: Sequence[float]) -> int | None:
    """Decimals for all of these; None if they differ too much in size."""
    sizes = [abs(value) for value in numbers if value]
    if not sizes:
        return 0
    if max(sizes) > MOST_SPREAD * min(sizes):
        return None
    if all(map(_is_short, numbers)):
        return max(map(_natural_places, numbers))
    places = _places(max(sizes), 4)
    return places if min(sizes) >= 0.5 * 10.0**-places else None


def _places(value: float, digits: int) -> int:
    """Decimals that give this many significant digits."""
    return max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0


def _is_short(value: float) -> bool:
    return float(f"{value:.{SHORT}g}") == value


def _natural_places(value: float) -> int:
    """Decimals of a short number as it is written; none of a multiple of ten."""
    return max(0, -int(Decimal(f"{value:.{SHORT}g}").normalize().as_tuple().exponent)) if value else 0


def _printed(text: str) -> str:
    """Powers of ten and minus signs as they are printed."""
    mantissa, _, power = text.partition("e")
    raised = f"{NARROW}×{NARROW}10{str(int(power)).translate(SUPERSCRIPTS)}" if power else ""
    return mantissa.replace("-", "\N{MINUS SIGN}") + raised


def embedded(picture: bytes) -> str:
    """An SVG as the address of an image: identifiers of one do not reach into another."""
    return "data:image/svg+xml;base64," + base64.b64encode(picture).decode("ascii")
