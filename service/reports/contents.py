"""What a report is made of: sections of text, comparisons, tables and figures."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from matplotlib.figure import Figure as Drawing

from solver.arrays import FloatArray

Column: TypeAlias = Sequence[object] | FloatArray
Tell: TypeAlias = Callable[[str], None]
"""Told in a few words what is being done."""


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
class Table:
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
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


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
