"""Reports: their sections, the HTML page, and the files of figures and tables."""

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
"""Function that receives a short description of the next step."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A computed number, and the reference value with which it is compared."""

    what: str
    ours: float
    reference: float | None
    """Reference value; None if the source does not print it."""
    unit: str
    """Unit; "1" for a plain number."""
    tolerance: float | None
    """Tolerance of the difference; None if no agreement is claimed."""
    reference_source: str
    note: str = ""

    @property
    def difference(self) -> float | None:
        """Computed number minus the reference."""
        return None if self.reference is None else self.ours - self.reference

    @property
    def holds(self) -> bool | None:
        """Whether the difference is within the tolerance; None without reference or tolerance."""
        if self.difference is None or self.tolerance is None:
            return None
        return abs(self.difference) <= self.tolerance * (1.0 + 1e-9)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure and the numbers that it shows."""

    name: str
    """Name of the files, without suffix."""
    caption: str
    figure: Drawing
    data: Mapping[str, Column]
    """Columns of equal length, by name with unit."""


@dataclass(frozen=True, kw_only=True)
class ReportTable:
    """A table with named columns."""

    name: str
    """Name of the file, without suffix."""
    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of a report; `code` and **strong** in its text are formatted."""

    title: str
    text: Sequence[str]
    comparisons: Sequence[Comparison] = ()
    tables: Sequence[ReportTable] = ()
    figures: Sequence[Figure] = ()
    summary: str = ""
    """Text that the command prints once the report is written; may be empty."""


def paragraphs(text: str) -> list[str]:
    """Split a text at blank lines into paragraphs for `Section.text`; other line breaks become spaces."""
    return [re.sub(r"[ \n]+", " ", part).strip() for part in text.strip().split("\n\n")]


def stack(name: str, series: Mapping[str, Mapping[str, Column]]) -> dict[str, list[object]]:
    """Stack the columns of several series for `Figure.data`.

    Parameters
    ----------
    name
        Name of the column that contains the keys of `series`.
    series
        Columns of each series, of equal length within a series. Columns that a series lacks are left empty.

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
    """Write a report; existing files of the same names are replaced.

    Parameters
    ----------
    folder
        Folder of the report, created if it is missing.
    title, introduction
        Title and first paragraphs of the page.
    sections
        Sections, iterated while the style of figures is active, so that a generator may draw its figures lazily.

    Returns
    -------
    Path
        The page, `index.html`, which needs no other file. The folder also has `comparisons.csv`, `figures/` with
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
    """Write the three files of a figure; return the SVG."""
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
    """Return a value for CSV: floating-point numbers as text with nine digits, "" for None and NaN."""
    if value is None:
        return ""
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return value


NARROW = "\N{NARROW NO-BREAK SPACE}"
SHORT = 5
"""Largest number of significant digits with which a number counts as short, and is shown in full."""
MOST_SPREAD = 1e5
"""Ratio of the largest to the smallest number of a column above which each has its own number of decimals. [1]"""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class ShownSection:
    """A section of a report, and its figures as SVG."""

    section: Section
    pictures: Sequence[bytes]

    @property
    def anchor(self) -> str:
        """Anchor to which the table of contents links."""
        return re.sub(r"[^a-z0-9]+", "-", self.section.title.lower()).strip("-")


def _render(*, title: str, introduction: Sequence[str], shown: Sequence[ShownSection]) -> str:
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
    """Convert `code` and **strong** in a text to HTML, and escape the rest."""
    marked = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", marked))  # noqa: S704 (escaped above)


def _number(value: float | None, digits: int = 4) -> str:
    """Return a number with a few significant digits as text, or all digits of a short number; "" for None and NaN."""
    if value is None or math.isnan(value):
        return ""
    return _printed(f"{value:.{max(digits, SHORT) if _is_short(value) else digits}g}")


def _ours(comparison: Comparison) -> str:
    """Return the computed number as text: four significant digits, or all decimals of the reference if it has more."""
    return _printed(f"{comparison.ours:.{_decimals(comparison)}f}")


def _difference(comparison: Comparison) -> str:
    """Return the difference as text, with the decimals of the computed number, or up to two more if it is small."""
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
    """Return the text of each cell, and whether it is a number.

    A column has a common number of decimals if possible.
    """
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
    """Return a common number of decimals for the numbers of a column; None if they differ too much in size."""
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
    """Return the number of decimals with which a number has this many significant digits."""
    return max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0


def _is_short(value: float) -> bool:
    return float(f"{value:.{SHORT}g}") == value


def _natural_places(value: float) -> int:
    """Return the number of decimals of a short number; 0 for a whole number."""
    return max(0, -int(Decimal(f"{value:.{SHORT}g}").normalize().as_tuple().exponent)) if value else 0


def _printed(text: str) -> str:
    """Replace exponents such as e-05 with powers of ten, and hyphens with minus signs."""
    mantissa, _, power = text.partition("e")
    raised = f"{NARROW}×{NARROW}10{str(int(power)).translate(SUPERSCRIPTS)}" if power else ""
    return mantissa.replace("-", "\N{MINUS SIGN}") + raised
