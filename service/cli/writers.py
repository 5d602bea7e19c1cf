"""Output: JSON lines for programs; tables, warnings and progress bars for people."""

import argparse
import csv
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO, TypeAlias

import orjson

from service.cli.arguments import SOME_FAILED, problem_text
from service.columns import base_of, batch_columns, batch_row, csv_cells, summarize, unit_end, unit_of

Item: TypeAlias = Mapping[str, Any]
"""Result or problem of one case of a job."""
ProgressReport: TypeAlias = Callable[..., None]
"""Called with the number of finished cases and the total."""

HEAD_ROWS = 20
"""Rows of the table on a terminal."""
SHOWN = {
    "trajectory": ("outcome", "maximum_depth_m", "final_depth_velocity_m_s", "final_lateral_velocity_m_s"),
    "cra": ("status", "critical_angle_deg", "critical_angle_standard_error_deg"),
    "thickness": ("status", "least_thickness_m"),
    "limit-speed": ("status", "limit_speed_m_s"),
}
"""Columns of the summary in the table on a terminal."""
MINUS = "\N{MINUS SIGN}"
DIGITS = 5
MOST_WRITTEN_OUT = 1e9
"""Numbers from here on have an exponent in a table."""
NUMERAL = re.compile(r"([-+]?[\d.]+(e[-+]?\d+)?)?|nan|-?inf")
"""Number in a table, or an empty cell."""


class Writer(ABC):
    """Receives the results of a job in order."""

    @abstractmethod
    def write(self, items: Sequence[Item]) -> None:
        """Write some results."""

    def close(self) -> None:  # noqa: B027 (most have nothing to do)
        """Finish, after the last result."""


class JsonLines(Writer):
    """Results as JSON lines, as the service sends them."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, items: Sequence[Item]) -> None:
        """Write a line for each result and flush, so that the reader of a pipe gets them at once."""
        self._stream.buffer.write(b"".join(orjson.dumps(item) + b"\n" for item in items))  # JSON is UTF-8 everywhere.
        self._stream.flush()


class SweepTable(Writer):
    """Results of a sweep as CSV, with the base in columns, as the service sends them."""

    def __init__(self, stream: TextIO, operation: str, content: Mapping[str, Any]) -> None:
        self._stream = stream
        self._operation = operation
        self._fields = tuple(axis["field"] for axis in content["axes"])
        self._base = base_of(content["base"], self._fields)
        self._rows = csv.writer(stream, lineterminator="\n")
        self._begun = False

    def write(self, items: Sequence[Item]) -> None:
        """Write a row for each result, the first time with the header above."""
        from service.operations import OPERATIONS

        columns = OPERATIONS[self._operation].columns
        if not self._begun:
            names = [column.name for column in batch_columns(columns, self._fields)]
            self._rows.writerow([*names, *self._base])
            self._begun = True
        for item in items:
            point = tuple(item["point"][field] for field in self._fields)
            self._rows.writerow(csv_cells([*batch_row(columns, item, point), *self._base.values()]))
        self._stream.flush()


class Head(Writer):
    """A table of the first results."""

    def __init__(self, operation: str) -> None:
        self._columns = SHOWN[operation]
        self._rows: list[dict[str, Any]] = []
        self._count = 0

    def write(self, items: Sequence[Item]) -> None:
        """Keep the first results."""
        self._count += len(items)
        self._rows += [self._row(item) for item in items[: HEAD_ROWS - len(self._rows)]]

    def close(self) -> None:
        """Print the table without its empty columns."""
        names = [name for name in self._rows[0] if any(row[name] != "" for row in self._rows)] if self._rows else []
        print_table([heading(name) for name in names], [[row[name] for name in names] for row in self._rows])
        if self._count > len(self._rows):
            print(f"and {self._count - len(self._rows)} more; --csv or --json prints all")

    def _row(self, item: Item) -> dict[str, Any]:
        row = {"index": item["index"], **item.get("point", {}), "custom_id": item.get("custom_id", "")}
        summary = summarize(item["result"]) if "result" in item else {}
        row |= {name: summary.get(name, "") for name in (*self._columns, "warnings")}
        return row | {"problem": problem_text(item["problem"]) if "problem" in item else ""}


class Counts(Writer):
    """Number of results, and of problems among them."""

    def __init__(self) -> None:
        self.total = 0
        self.failed = 0

    def write(self, items: Sequence[Item]) -> None:
        """Count results."""
        self.total += len(items)
        self.failed += sum("problem" in item for item in items)

    @property
    def status(self) -> int:
        """Exit status."""
        return SOME_FAILED if self.failed else 0

    def __str__(self) -> str:
        return f"{self.total} cases, {self.failed} of them with a problem"


def writer_for(args: argparse.Namespace, stream: TextIO, operation: str) -> Writer:
    """Return a writer of JSON lines, or of a table if the stream is a terminal and the flags do not exclude it."""
    return JsonLines(stream) if args.json or not stream.isatty() else Head(operation)


def heading(name: str) -> str:
    """Return the name of a field as the heading of a column, with its unit last."""
    name = name.rpartition(".")[2]
    return f"{name.removesuffix(unit_end(name)).replace('_', ' ')} {unit_of(name)}".rstrip()


def cell(value: Any) -> str:
    """Return a value as text in a table; an exponent stands only where a person would write one."""
    if isinstance(value, float):
        text = f"{value:.{DIGITS}g}"
        return f"{float(text):.0f}" if 10.0**DIGITS <= abs(float(text)) < MOST_WRITTEN_OUT else text
    return "" if value is None else str(value).replace("\x1b", "")


def print_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print a table, with rules on a terminal and as aligned columns elsewhere; numbers are aligned right."""
    stream = sys.stdout
    cells = [list(map(cell, row)) for row in rows]
    right = [all(NUMERAL.fullmatch(line[i]) for line in cells) for i in range(len(columns))]
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
    """Print named values, one a line."""
    if sys.stdout.isatty():
        _print_ruled(("", ""), [[name, cell(value)] for name, value in values.items()], (False, True), sys.stdout)
        return
    width = max(map(len, values))
    for name, value in values.items():
        print(f"{name:{width}}  {cell(value)}")


def print_warnings(warnings: Iterable[Mapping[str, Any]]) -> None:
    """Print the warnings of an answer on standard error, and in one line those of most answers."""
    special, standing = _apart(warnings)
    for warning in special:
        print(f"warning: {warning['detail']}", file=sys.stderr)
    if standing:
        print(f"standing notes: {'; '.join(warning['detail'] for warning in standing)}", file=sys.stderr)


def print_warning_codes(warnings: Iterable[Mapping[str, Any]]) -> None:
    """Print the codes of the warnings of an answer on standard error, with how many are not those of most answers."""
    special, standing = _apart(warnings)
    counted = "1 warning" if len(special) == 1 else f"{len(special)} warnings"
    for title, found in ((counted, special), ("standing notes", standing)):
        if found:
            codes = ", ".join(dict.fromkeys(warning["code"] for warning in found))
            print(f"{title} (-v explains): {codes}", file=sys.stderr)


def _apart(warnings: Iterable[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]]:
    """Return the warnings about this answer, and the standing ones, which come with most answers."""
    found: tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]] = ([], [])
    for warning in warnings:
        found[warning.get("standing", False)].append(warning)
    return found


def _print_ruled(columns: Sequence[str], cells: Sequence[Sequence[str]], right: Sequence[bool], stream: TextIO) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(show_header=any(columns))
    for name, numeric in zip(columns, right, strict=True):
        table.add_column(escape(name), justify="right" if numeric else "left")
    for line in cells:
        table.add_row(*(escape(_with_minus(text, stream)) for text in line))
    Console(file=stream, highlight=False).print(table)


def _with_minus(text: str, stream: TextIO) -> str:
    """Return a number with a minus sign where the stream can show one; other text as it is."""
    if not NUMERAL.fullmatch(text):
        return text
    try:
        MINUS.encode(stream.encoding)
    except (LookupError, UnicodeEncodeError):
        return text
    return text.replace("-", MINUS)


@contextmanager
def progress(description: str) -> Iterator[ProgressReport]:
    """Show a progress bar on standard error if it is a terminal; the bar disappears at the end."""
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as bars:
        task = bars.add_task(description, total=None)

        def report(done: int, total: int, detail: str = "") -> None:
            bars.update(task, completed=done, total=total, description=f"{description} {detail}".rstrip())

        yield report
