"""Write a report as one page, and as files beside it."""

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from service.reports import page, style
from service.reports.contents import Column, Comparison, Figure, Section, Table, Tell, paragraphs, stack

__all__ = ["Column", "Comparison", "Figure", "Section", "Table", "Tell", "paragraphs", "stack", "write_report"]

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
    shown: list[page.ShownSection] = []
    with style.styled():
        for section in sections:
            pictures = [_write_figure(folder / "figures", figure) for figure in section.figures]
            for table in section.tables:
                _write_csv(folder / "tables" / f"{table.name}.csv", table.columns, table.rows)
            shown.append(page.ShownSection(section, pictures))
    compared = [(part.section.title, each) for part in shown for each in part.section.comparisons]
    _write_csv(folder / "comparisons.csv", COMPARISON_COLUMNS, [_comparison_row(*pair) for pair in compared])
    index = folder / "index.html"
    index.write_text(page.render(title=title, introduction=introduction, shown=shown), encoding="utf-8")
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
