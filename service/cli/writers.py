"""Writers of results: JSON lines, CSV and workbooks for programs; tables, warnings and progress bars for people."""

import argparse
import csv
import math
import re
import sys
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, TextIO, TypeAlias

import orjson

from service.cli.arguments import FAILED, SOME_FAILED, CommandError, problem_text
from service.columns import base_of, batch_columns, batch_row, csv_cells, summarize, unit_end, unit_of

Item: TypeAlias = Mapping[str, Any]
"""One case of a job with its result or its problem."""
ProgressReport: TypeAlias = Callable[..., None]
"""Function that receives the number of finished cases, the total and an optional text."""

HEAD_ROWS = 20
"""Number of rows in the table on a terminal, few enough for a screen of 24 lines."""
SHOWN = {
    "trajectory": ("outcome", "maximum_depth_m", "final_depth_velocity_m_s", "final_lateral_velocity_m_s"),
    "cra": ("status", "critical_angle_deg", "critical_angle_standard_error_deg"),
    "thickness": ("status", "least_thickness_m"),
    "limit-speed": ("status", "limit_speed_m_s"),
    "cra_uncertainty": ("mean_deg", "standard_deviation_deg", "samples", "converged"),
    "trajectory_uncertainty": ("ricochet", "embedded", "perforated", "samples", "converged"),
}
"""Columns of the table on a terminal, by operation."""
MINUS = "\N{MINUS SIGN}"
DIGITS = 5
"""Number of significant digits in a table, an arbitrary choice: the model is far less accurate."""
MOST_WRITTEN_OUT = 1e9
"""Magnitude from which numbers have an exponent in a table. Strengths of concrete in Pa are below it."""
NUMERAL = re.compile(r"([-+]?[\d.]+(e[-+]?\d+)?)?|nan|-?inf")
"""Pattern of a number in a table, or of an empty cell."""


class Writer(ABC):
    """Base class of writers, which receive the results of a job in order."""

    @abstractmethod
    def write(self, items: Sequence[Item]) -> None:
        """Write the next results."""

    def close(self) -> None:  # noqa: B027 (most have nothing to do)
        """Finish the output after the last result."""


class JsonLines(Writer):
    """Writer of JSON lines, as the service sends them."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, items: Sequence[Item]) -> None:
        """Write a line for each result, and flush, so that the reader of a pipe receives it at once."""
        # Bytes are written, as JSON is UTF-8 whatever the encoding of the stream.
        self._stream.buffer.write(b"".join(orjson.dumps(item) + b"\n" for item in items))
        self._stream.flush()


@dataclass(frozen=True, slots=True)
class Inputs:
    """Rows of the input of a batch. Invalid rows are not sent; the cells of a table are copied to the output.

    Parameters
    ----------
    sent
        Numbers of the rows that are sent, in order.
    left_out
        Items with the problems of the invalid rows, by number.
    headers, cells
        Headers of the table, and the cells of every row.
    errors
        Error messages of the invalid rows, by number. They name fields by the headers of the table.
    """

    sent: Sequence[int]
    left_out: Mapping[int, Item]
    headers: Sequence[str] = ()
    cells: Sequence[Sequence[str]] = ()
    errors: Mapping[int, str] = field(default_factory=dict)

    def placed(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield results with their row numbers, each after the problems of the invalid rows before it."""
        for item in items:
            number = item["index"]
            before = self.sent[number - 1] + 1 if number else 0
            yield from self._left_out(before, self.sent[number])
            yield {**item, "index": self.sent[number]}

    def rest(self) -> Iterator[Item]:
        """Yield the problems of the invalid rows after the last row that was sent."""
        yield from self._left_out(self.sent[-1] + 1 if self.sent else 0, max(self.left_out, default=-1) + 1)

    def _left_out(self, first: int, end: int) -> Iterator[Item]:
        return (self.left_out[number] for number in range(first, end) if number in self.left_out)


class Rows:
    """Table of results with a header: the columns of the input, then the columns of the service.

    Parameters
    ----------
    operation
        Operation of the cases.
    digits
        Number of significant digits of computed numbers; None for all.
    base
        Base of a sweep, whose fields become columns.
    inputs
        Rows of the input.
    """

    def __init__(
        self, operation: str, digits: int | None, base: Mapping[str, Any] | None = None, inputs: Inputs | None = None
    ) -> None:
        from service.operations import OPERATIONS

        self._columns = OPERATIONS[operation].columns
        self._digits = digits
        self._whole_base = base or {}
        self._inputs = inputs if inputs and inputs.headers else None

    def under_header(self, items: Sequence[Item], *, first: bool) -> Iterator[list[Any]]:
        """Yield the rows of some results, preceded by the header if they are the first."""
        fields = tuple(items[0].get("point", ()))
        base = base_of(self._whole_base, fields)
        names = [column.name for column in batch_columns(self._columns, fields)]
        count = len(fields)
        if first:
            yield [names[0], *names[1 : 1 + count], *self._header(names[1 + count :]), *base]
        for item in items:
            index, *row = batch_row(self._columns, item, tuple(item.get("point", {}).values()))
            found = dict(zip(names[1 + count :], rounded(row[count:], self._digits), strict=True))
            yield [index, *row[:count], *self._cells(index, found, item), *base.values()]

    def _header(self, names: Sequence[str]) -> list[str]:
        if self._inputs is None:
            return list(names)
        found = without_name(names)
        # A column of the input may have the name of a result, and a table must not have two columns of the same name.
        given = (f"input {name}" if name in found else name for name in self._inputs.headers)
        return [*given, *found, "error"]

    def _cells(self, index: int, found: Mapping[str, Any], item: Item) -> list[Any]:
        if self._inputs is None:
            return list(found.values())
        errors = "; ".join(": ".join(filter(None, each.values())) for each in item.get("problem", {}).get("errors", ()))
        error = errors or (problem_text(item["problem"]) if "problem" in item else None)
        error = self._inputs.errors.get(index, error)
        return [*self._inputs.cells[index], *(found[name] for name in without_name(found)), error]


def without_name(names: Iterable[str]) -> list[str]:
    """Return the names of result columns without `custom_id`, which the columns of the input include."""
    return [name for name in names if name != "custom_id"]


class CsvTable(Writer):
    """Writer of a CSV table with a row for each result."""

    def __init__(self, stream: TextIO, rows: Rows) -> None:
        self._stream = stream
        self._rows = rows
        self._writer = csv.writer(stream, lineterminator="\n")
        self._begun = False

    def write(self, items: Sequence[Item]) -> None:
        """Write a row for each result, and the header before the first one."""
        if items:
            self._writer.writerows(map(csv_cells, self._rows.under_header(items, first=not self._begun)))
            self._begun = True
        self._stream.flush()


class Workbook(Writer):
    """Writer of an Excel workbook with one sheet. The workbook is saved at the end."""

    def __init__(self, stream: TextIO, rows: Rows) -> None:
        require_excel("an Excel workbook")
        from openpyxl import Workbook as Book

        self._stream = stream
        self._rows = rows
        # A write-only workbook keeps finished rows in a temporary file, so that a large batch does not fill the memory.
        self._book = Book(write_only=True)
        self._sheet = self._book.create_sheet("results")
        self._begun = False

    def write(self, items: Sequence[Item]) -> None:
        """Add a row for each result, and the header before the first one."""
        if items:
            for row in self._rows.under_header(items, first=not self._begun):
                self._sheet.append(csv_cells(map(as_number, row)))
            self._begun = True

    def close(self) -> None:
        """Save the workbook, which is kept in temporary files until then."""
        self._book.save(self._stream.buffer)
        self._stream.flush()


def require_excel(feature: str) -> None:
    """Check that workbooks can be written.

    Raises
    ------
    CommandError
        If openpyxl is not installed.
    """
    if find_spec("openpyxl") is None:
        from service.settings import missing_package

        raise CommandError(missing_package(feature, "openpyxl", "excel"), FAILED)


def as_number(value: Any) -> Any:
    """Convert a string with a number to a float, and a float that no sheet can hold (NaN, infinity) to a string."""
    if isinstance(value, str) and value and NUMERAL.fullmatch(value):
        value = float(value)
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def rounded(row: Iterable[Any], digits: int | None) -> list[Any]:
    """Round the floats of a row to `digits` significant digits; None keeps all digits."""
    if digits is None:
        return list(row)
    return [float(f"{value:.{digits}g}") if isinstance(value, float) else value for value in row]


class Head(Writer):
    """Writer of a table with the first results, for a terminal."""

    def __init__(self, operation: str) -> None:
        self._columns = SHOWN[operation]
        self._rows: list[dict[str, Any]] = []
        self._count = 0

    def write(self, items: Sequence[Item]) -> None:
        """Collect the first results."""
        self._count += len(items)
        self._rows += [self._row(item) for item in items[: HEAD_ROWS - len(self._rows)]]

    def close(self) -> None:
        """Print the table without empty columns."""
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
    """Writer that counts results, and problems among them."""

    def __init__(self) -> None:
        self.total = 0
        self.failed = 0

    def write(self, items: Sequence[Item]) -> None:
        """Count the results, and the problems among them."""
        self.total += len(items)
        self.failed += sum("problem" in item for item in items)

    @property
    def status(self) -> int:
        """Exit status of the command."""
        return SOME_FAILED if self.failed else 0

    def __str__(self) -> str:
        return f"{self.total} cases, {self.failed} of them with a problem"


def writer_for(
    args: argparse.Namespace,
    stream: TextIO,
    operation: str,
    base: Mapping[str, Any] | None = None,
    inputs: Inputs | None = None,
) -> Writer:
    """Return a writer in the format of the flags. The default is JSON lines, or a table on a terminal."""
    if args.csv or args.xlsx:
        return (CsvTable if args.csv else Workbook)(stream, Rows(operation, args.digits, base, inputs))
    return JsonLines(stream) if args.json or not stream.isatty() else Head(operation)


def heading(name: str) -> str:
    """Return the heading of a column for a field, with its unit at the end."""
    name = name.rpartition(".")[2]
    return f"{name.removesuffix(unit_end(name)).replace('_', ' ')} {unit_of(name)}".rstrip()


def cell(value: Any) -> str:
    """Return a value as text in a table. Exponents are used only for very large and very small numbers."""
    if isinstance(value, float):
        text = f"{value:.{DIGITS}g}"
        return f"{float(text):.0f}" if 10.0**DIGITS <= abs(float(text)) < MOST_WRITTEN_OUT else text
    # Strings from a request could otherwise send escape sequences to the terminal.
    return "" if value is None else str(value).replace("\x1b", "")


def print_csv(columns: Mapping[str, Sequence[Any]], digits: int | None) -> None:
    """Print columns of equal length as CSV; see `rounded` for the digits."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(csv_cells(rounded(row, digits)) for row in zip(*columns.values(), strict=True))


def print_table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table with numbers aligned right, and with rules if standard output is a terminal.

    Parameters
    ----------
    columns
        Header, left out if all its cells are empty.
    """
    cells = [list(map(cell, row)) for row in rows]
    right = [all(NUMERAL.fullmatch(line[i]) for line in cells) for i in range(len(columns))]
    if sys.stdout.isatty():
        _print_ruled(columns, cells, right, sys.stdout)
        return
    lines = [list(columns), *cells] if any(columns) else cells
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    for line in lines:
        aligned = (
            part.rjust(width) if numeric else part.ljust(width)
            for part, width, numeric in zip(line, widths, right, strict=True)
        )
        print("  ".join(aligned).rstrip())


def print_values(values: Mapping[str, Any]) -> None:
    """Print named values, one per line."""
    print_table(("", ""), values.items())


def print_warnings(warnings: Iterable[Mapping[str, Any]], *, verbose: bool) -> None:
    """Print warnings on standard error: one line of codes or, if `verbose`, the full texts and the standing notes."""
    special, standing = _apart(warnings)
    if verbose:
        for warning in special:
            print(f"warning: {warning['detail']}", file=sys.stderr)
        if standing:
            print(f"standing notes: {'; '.join(warning['detail'] for warning in standing)}", file=sys.stderr)
    elif special:
        counted = "1 warning" if len(special) == 1 else f"{len(special)} warnings"
        counts = Counter(warning["code"] for warning in special)
        codes = (code if count == 1 else f"{code} ({count} times)" for code, count in counts.items())
        print(f"{counted} (-v explains): {', '.join(codes)}", file=sys.stderr)


def _apart(warnings: Iterable[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]]:
    """Return the warnings that are not standing notes, and the standing notes."""
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
    """Replace the hyphen of a number with a minus sign if the encoding of the stream has one."""
    if not NUMERAL.fullmatch(text):
        return text
    try:
        MINUS.encode(stream.encoding)
    except (LookupError, UnicodeEncodeError):
        return text
    return text.replace("-", MINUS)


@contextmanager
def progress(description: str) -> Iterator[ProgressReport]:
    """Show a progress bar on standard error if that is a terminal. The bar disappears at the end."""
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
