"""Tables for people: with rules on a terminal, aligned columns and nothing else in a pipe."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TextIO

UNITS = {
    "_kg_m2": "kg m²",
    "_kg_m3": "kg/m³",
    "_rad_s": "rad/s",
    "_n_m": "N m",
    "_m_s": "m/s",
    "_deg": "°",
    "_pa": "Pa",
    "_kg": "kg",
    "_m": "m",
    "_s": "s",
    "_n": "N",
    "_j": "J",
}
"""By what a name of the contract ends with, the longest first."""
DIGITS = 5


def heading(name: str) -> str:
    """Return the name of a column in words, with its unit behind."""
    name = name.rpartition(".")[2]
    for end, unit in UNITS.items():
        if name.endswith(end):
            return f"{name.removesuffix(end).replace('_', ' ')} {unit}"
    return name.replace("_", " ")


def cell(value: Any) -> str:
    """Return a value as people read it."""
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    return "" if value is None else str(value).replace("\x1b", "")


def print_table(columns: Sequence[str], rows: Sequence[Sequence[Any]], stream: TextIO | None = None) -> None:
    """Print a table; numbers stand to the right."""
    stream = stream or sys.stdout
    cells = [list(map(cell, row)) for row in rows]
    right = [all(isinstance(row[i], int | float) or row[i] == "" for row in rows) for i in range(len(columns))]
    if stream.isatty():
        _print_ruled(columns, cells, right, stream)
        return
    lines = [list(columns), *cells]
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    for line in lines:
        aligned = (
            part.rjust(width) if numeric else part.ljust(width)
            for part, width, numeric in zip(line, widths, right, strict=True)
        )
        print("  ".join(aligned).rstrip(), file=stream)


def print_values(values: Mapping[str, Any]) -> None:
    """Print named values, one below the other."""
    if sys.stdout.isatty():
        _print_ruled(("", ""), [[name, cell(value)] for name, value in values.items()], (False, True), sys.stdout)
        return
    width = max(map(len, values))
    for name, value in values.items():
        print(f"{name:{width}}  {cell(value)}")


def print_warnings(warnings: Iterable[Mapping[str, str]]) -> None:
    """Tell what to know before relying on a result."""
    for warning in warnings:
        print(f"warning: {warning['detail']}", file=sys.stderr)


def _print_ruled(columns: Sequence[str], cells: Sequence[Sequence[str]], right: Sequence[bool], stream: TextIO) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(show_header=any(columns))
    for name, numeric in zip(columns, right, strict=True):
        table.add_column(escape(name), justify="right" if numeric else "left")
    for line in cells:
        table.add_row(*map(escape, line))
    Console(file=stream, highlight=False).print(table)
