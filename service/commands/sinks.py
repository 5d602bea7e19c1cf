"""Where the results of many cases go as they come: lines of JSON, rows of a table, the head of one for people."""

import argparse
import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TextIO, TypeAlias

import orjson

from service.columns import csv_header, csv_row, summarize
from service.commands.errors import FAILED, SOME_FAILED, CommandError, told
from service.commands.tables import heading, print_table

Item: TypeAlias = Mapping[str, Any]
Axes: TypeAlias = Mapping[str, Sequence[float]]
"""Fields of a sweep and their values; none of a batch."""
HEAD = 20
"""Rows that people get to see."""
TOLD = {
    "trajectory": ("outcome", "maximum_depth_m", "final_depth_velocity_m_s", "final_lateral_velocity_m_s"),
    "cra": ("status", "critical_angle_deg", "critical_angle_standard_error_deg"),
}
"""Columns of the summary that people get to see."""


class Sink(Protocol):
    """Takes results in order."""

    def write(self, items: Sequence[Item]) -> None:
        """Take some more."""

    def end(self) -> None:
        """See that there are no more."""


class Lines:
    """JSON lines, as the service sends them."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, items: Sequence[Item]) -> None:
        """Write them at once, so that whoever reads a pipe need not wait for the rest."""
        self._stream.write(b"".join(orjson.dumps(item) + b"\n" for item in items).decode())
        self._stream.flush()

    def end(self) -> None:
        """Nothing follows."""


class Rows:
    """The summaries as CSV."""

    def __init__(self, stream: TextIO, operation: str, axes: Axes) -> None:
        self._stream = stream
        self._operation = operation
        self._points = Points(axes)
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(csv_header(operation, tuple(axes)))

    def write(self, items: Sequence[Item]) -> None:
        """Write a row for each."""
        self._writer.writerows(self._row(item) for item in items)
        self._stream.flush()

    def end(self) -> None:
        """Nothing follows."""

    def _row(self, item: Item) -> list[Any]:
        return csv_row(self._operation, item, tuple(self._points.at(item["index"])))


class Head:
    """A table of the first results, for people."""

    def __init__(self, operation: str, axes: Axes) -> None:
        self._operation = operation
        self._axes = list(axes)
        self._points = Points(axes)
        self._rows: list[list[Any]] = []
        self._count = 0

    def write(self, items: Sequence[Item]) -> None:
        """Keep the first."""
        self._count += len(items)
        self._rows += [self._row(item) for item in items[: HEAD - len(self._rows)]]

    def end(self) -> None:
        """Print them, without columns in which nothing stands."""
        names = ["index", *self._axes, "custom_id", *TOLD[self._operation], "warnings", "problem"]
        used = [i for i in range(len(names)) if any(row[i] != "" for row in self._rows)]
        print_table([heading(names[i]) for i in used], [[row[i] for i in used] for row in self._rows])
        if self._count > len(self._rows):
            print(f"and {self._count - len(self._rows)} more: --csv or --json gives all")

    def _row(self, item: Item) -> list[Any]:
        head = [item["index"], *self._points.at(item["index"]), item.get("custom_id", "")]
        told_of = TOLD[self._operation]
        if "result" not in item:
            return [*head, *[""] * len(told_of), "", told(item["problem"])]
        answer = item["result"]
        values = summarize(answer)
        return [*head, *(values.get(name, "") for name in told_of), values["warnings"], ""]


class Counts:
    """How many there are, and how many of them have a problem."""

    def __init__(self) -> None:
        self.total = 0
        self.failed = 0

    def write(self, items: Sequence[Item]) -> None:
        """Count them."""
        self.total += len(items)
        self.failed += sum("problem" in item for item in items)

    def end(self) -> None:
        """Nothing follows."""

    @property
    def status(self) -> int:
        """Exit status."""
        return SOME_FAILED if self.failed else 0

    def __str__(self) -> str:
        return f"{self.total} cases, {self.failed} of them with a problem"


class Points:
    """The values of the axes of a sweep by the index of a case: the last axis is the fastest."""

    def __init__(self, axes: Axes) -> None:
        self._axes = list(axes.values())

    def at(self, index: int) -> list[float]:
        """Return the values of one case."""
        found = []
        for values in reversed(self._axes):
            index, place = divmod(index, len(values))
            found.append(values[place])
        return found[::-1]


@contextmanager
def sinks_of(asked: argparse.Namespace, operation: str, axes: Axes) -> Iterator[list[Sink]]:
    """Open what was asked for: lines in a pipe, a table on a terminal, unless it was said.

    Raises
    ------
    CommandError
        If the file cannot be written.
    """
    if asked.output is None:
        if asked.csv:
            yield [Rows(sys.stdout, operation, axes)]
        elif asked.json or not sys.stdout.isatty():
            yield [Lines(sys.stdout)]
        else:
            yield [Head(operation, axes)]
        return
    try:
        file = asked.output.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise CommandError(f"{asked.output}: {error.strerror or error}", FAILED) from None
    with file:
        table = asked.csv or (not asked.json and asked.output.suffix.lower() == ".csv")
        yield [Rows(file, operation, axes) if table else Lines(file)]
