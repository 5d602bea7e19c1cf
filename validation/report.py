"""A report: its sections, its page and the files beside the page."""

import csv
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TypeAlias

import jinja2
from markupsafe import Markup, escape
from matplotlib.figure import Figure as Drawing

from service.reports import style
from service.reports.style import embedded
from solver.arrays import FloatArray

Column: TypeAlias = Sequence[object] | FloatArray
Progress: TypeAlias = Callable[[str], None]
"""Called with a few words on the next step."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One number of ours beside one of somebody else's."""

    what: str
    ours: float
    reference: float | None
    """None if the source does not print it."""
    unit: str
    """"1" for a plain number."""
    tolerance: float | None
    """How far ours may be from the reference; None if nothing is claimed."""
    reference_source: str
    note: str = ""

    @property
    def difference(self) -> float | None:
        """Ours minus the reference."""
        return None if self.reference is None else self.ours - self.reference

    @property
    def holds(self) -> bool | None:
        """Whether the difference is within the tolerance; None if there is nothing to hold."""
        if self.difference is None or self.tolerance is None:
            return None
        return abs(self.difference) <= self.tolerance * (1.0 + 1e-9)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A drawing and the numbers in it."""

    name: str
    """Name of its files, without suffix."""
    caption: str
    figure: Drawing
    data: Mapping[str, Column]
    """Columns of equal length, by name with unit."""


@dataclass(frozen=True, kw_only=True)
class ReportTable:
    """Rows under named columns."""

    name: str
    """Name of its file, without suffix."""
    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of a report. `code` and **strong** are understood in its text."""

    title: str
    text: Sequence[str]
    comparisons: Sequence[Comparison] = ()
    tables: Sequence[ReportTable] = ()
    figures: Sequence[Figure] = ()
    summary: str = ""
    """Lines that the command prints after the report is written; empty for none."""


def paragraphs(text: str) -> list[str]:
    """Text with blank lines between its paragraphs as `Section.text`; other line ends do not matter."""
    return [re.sub(r"[ \n]+", " ", part).strip() for part in text.strip().split("\n\n")]


def stack(name: str, series: Mapping[str, Mapping[str, Column]]) -> dict[str, list[object]]:
    """Columns of several series one below the other, for `Figure.data`.

    Parameters
    ----------
    name
        Name of the column that separates the series.
    series
        Columns of each series; within one all are equally long. A column that a series lacks stays empty there.

    Returns
    -------
    dict
        The stacked columns.
    """
    columns: dict[str, list[object]] = {name: []}
    for key, given in series.items():
        length = len(next(iter(given.values())))
        before = len(columns[name])
        columns[name] += [key] * length
        for column in [*given, *(other for other in columns if other not in given and other != name)]:
            values = columns.setdefault(column, [""] * before)
            values.extend(given.get(column, [""] * length))
    return columns


COMPARISON_COLUMNS = (
    "section",
    "what",
    "ours",
    "reference",
    "difference",
    "unit",
    "tolerance",
    "holds",
    "reference_source",
    "note",
)


def write_report(folder: Path, *, title: str, introduction: Sequence[str], sections: Iterable[Section]) -> Path:
    """Write a report; what is in the folder under the same names is replaced.

    Parameters
    ----------
    folder
        Made if it is not there.
    title, introduction
        Head of the page.
    sections
        Fetched one by one, in the style of the figures: a generator may draw in its body.

    Returns
    -------
    Path
        The page, `index.html`, which needs none of the other files. Beside it are `comparisons.csv`, `figures/` with
        PNG, SVG and CSV of each figure and `tables/` with a CSV of each table.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    for part in ("figures", "tables"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    shown: list[ShownSection] = []
    with style.styled():
        for section in sections:
            pictures = [_write_figure(folder / "figures", figure) for figure in section.figures]
            for table in section.tables:
                _write_csv(folder / "tables" / f"{table.name}.csv", table.columns, table.rows)
            shown.append(ShownSection(section, pictures))
    compared = [(part.section.title, each) for part in shown for each in part.section.comparisons]
    _write_csv(folder / "comparisons.csv", COMPARISON_COLUMNS, [_comparison_row(*pair) for pair in compared])
    index = folder / "index.html"
    index.write_text(_render(title=title, introduction=introduction, shown=shown), encoding="utf-8")
    return index


def _write_figure(folder: Path, figure: Figure) -> bytes:
    """Write its three files and return the SVG."""
    picture = folder / f"{figure.name}.svg"
    figure.figure.savefig(picture, metadata={"Date": None})
    figure.figure.savefig(picture.with_suffix(".png"))
    _write_csv(picture.with_suffix(".csv"), list(figure.data), zip(*figure.data.values(), strict=True))
    return picture.read_bytes()


def _comparison_row(section: str, comparison: Comparison) -> list[object]:
    return [
        section,
        comparison.what,
        comparison.ours,
        comparison.reference,
        comparison.difference,
        comparison.unit,
        comparison.tolerance,
        {True: "yes", False: "no", None: ""}[comparison.holds],
        comparison.reference_source,
        comparison.note,
    ]


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> object:
    """Nine digits, which is more than any of it is worth; nothing for nothing."""
    if value is None:
        return ""
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return value


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
        """Anchor that the table of contents links to."""
        return re.sub(r"[^a-z0-9]+", "-", self.section.title.lower()).strip("-")


def _render(*, title: str, introduction: Sequence[str], shown: Sequence[ShownSection]) -> str:
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
        "prose": _prose,
        "number": _number,
        "cells": _cells,
        "ours": _ours,
        "difference": _difference,
        "embedded": embedded,
    }
    held = [each.holds for part in shown for each in part.section.comparisons if each.holds is not None]
    template = environment.from_string(Path(__file__).with_name("template.html").read_text(encoding="utf-8"))
    return template.render(title=title, introduction=introduction, shown=shown, held=sum(held), checked=len(held))


def _prose(text: str) -> Markup:
    """Text with `code` and **strong**, the rest as it is."""
    marked = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", marked))  # noqa: S704 (escaped above)


def _number(value: float | None, digits: int = 4) -> str:
    """A few significant digits, or all that a short number has; nothing for nothing."""
    if value is None or math.isnan(value):
        return ""
    return _printed(f"{value:.{max(digits, SHORT) if _is_short(value) else digits}g}")


def _ours(comparison: Comparison) -> str:
    """Our number with four significant digits, or as many decimals as the reference if these are more."""
    return _printed(f"{comparison.ours:.{_decimals(comparison)}f}")


def _difference(comparison: Comparison) -> str:
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


def _cells(table: ReportTable) -> list[list[tuple[str, bool]]]:
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
            texts.append((_number(value), True))
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
