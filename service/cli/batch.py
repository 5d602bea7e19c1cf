"""`ricochet batch` and `ricochet sweep`: many cases, computed locally or by a service."""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from service.cli.arguments import (
    STRIKE,
    CommandError,
    InputFile,
    RefusedError,
    UsageError,
    add_case,
    add_data_dir,
    add_operation,
    add_url,
    examples,
)
from service.cli.case_table import ENDINGS, read_cases
from service.cli.jobs import BatchRequest, run_batch, write_results
from service.cli.outputs import add_output, add_plot
from service.cli.request_body import STDIN, RequestBody, read_body, without_sought
from service.cli.writers import Writer

READ_SIZE = 256 * 1024
"""Number of bytes that are read from a file at a time."""
JSONL = "application/jsonl"
MAX_PLOT_AXES = 2
MAX_POINTS = 100_000
"""Largest number of points of a sweep that a service accepts."""


class SweepAxis(NamedTuple):
    """A field of a sweep with its values, as typed and as sent."""

    field: str
    values: list[float]
    text: str
    content: dict[str, Any]


def add_batch(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet batch`."""
    parser.description = (
        "Compute many cases. Each line of the file is a request body in JSON, with an optional custom_id; or the file "
        "is a CSV table with a case in each row, whose columns are fields with their units, such as velocity_m_s or "
        "resistance.strength_factor.model. Results are written in the order of the file as soon as they are ready: as "
        "JSON lines, or on a terminal as a table of the first."
    )
    parser.epilog = examples(
        "ricochet batch cases.jsonl -o angles.csv",
        "ricochet batch cases.jsonl > angles.jsonl",
        "ricochet batch cases.csv --case strike.toml -o angles.csv",
    )
    parser.add_argument(
        "file", type=InputFile, metavar="FILE", help="up to 100,000 cases, .jsonl or .csv; - reads JSON lines"
    )
    parser.add_argument("--case", type=InputFile, metavar="CASE", help="TOML or JSON file with what a table leaves out")
    _add_common(parser)
    parser.set_defaults(run=run_file)


def add_sweep(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet sweep`."""
    parser.description = (
        "Compute a case for every combination of the values of up to four fields; the last axis varies fastest. The "
        "case may leave out the fields of the axes. For thickness and limit-speed, what is sought and other parts than "
        "projectile, target, impact, resistance and numerics are left out of the file."
    )
    parser.epilog = examples(
        "ricochet sweep strike.toml --axis impact.velocity_m_s=200:300:3 --csv",
        "ricochet sweep strike.toml --axis impact.velocity_m_s=240,280 "
        "--axis target.compressive_strength_pa=30e6:40e6:2 --plot map.svg",
        "ricochet sweep strike.toml --operation thickness --axis impact.oblique_angle_deg=0:40:3 --csv",
    )
    add_case(parser, STRIKE)
    parser.add_argument(
        "--axis",
        action="append",
        required=True,
        type=read_axis,
        metavar="FIELD=VALUES",
        help="values separated by commas, or START:STOP:COUNT evenly spaced; up to four axes",
    )
    _add_common(parser)
    add_plot(parser, "what is found, of trajectories the maximum depth, over one axis, or as a map over two")
    parser.set_defaults(run=run_sweep)


def _add_common(parser: argparse.ArgumentParser) -> None:
    add_operation(parser)
    add_output(parser)
    add_data_dir(parser)
    add_url(parser)


def run_file(args: argparse.Namespace) -> int:
    """Compute the cases of a file; return 3 if some have a problem."""
    path = f"/{args.operation}/batch"
    lines: Sequence[int] = range(1, sys.maxsize)
    is_table = Path(args.file).suffix.lower() in ENDINGS
    if args.case and not is_table:
        raise UsageError("--case needs a table of cases, .csv or .tsv")
    if is_table:
        base = without_sought(read_body(args.case, args, ()), args.operation).content
        cases, lines = read_cases(Path(args.file), args.operation, base)
        request = BatchRequest(path, lambda: b"\n".join(cases), JSONL)
    elif args.file == STDIN:
        text = sys.stdin.buffer.read()
        request = BatchRequest(path, lambda: text, JSONL)
    else:
        file = Path(args.file)
        _check_readable(file)
        request = BatchRequest(path, lambda: _read_pieces(file), JSONL)
    try:
        return run_batch(args, request)
    except RefusedError as error:
        raise _explain_lines(error, args.file, lines) from None


def _check_readable(file: Path) -> None:
    try:
        with file.open("rb"):
            return
    except OSError as error:
        raise CommandError(f"{file}: {error.strerror or error}") from None


def _read_pieces(file: Path) -> Iterator[bytes]:
    with file.open("rb") as stream:
        while piece := stream.read(READ_SIZE):
            yield piece


def _explain_lines(error: RefusedError, file: str, numbers: Sequence[int]) -> CommandError:
    """Return a problem with the line of each invalid case, which the service counts from 0."""
    lines = []
    for each in error.errors:
        _, _, rest = each["pointer"].partition("/")
        index, _, pointer = rest.partition("/")
        line = f"{file}:{numbers[int(index)]}" if index.isdigit() else file
        lines.append(": ".join(filter(None, (line, pointer and f"/{pointer}", each["detail"]))))
    return CommandError("\n".join(lines), error.status) if lines else error


def run_sweep(args: argparse.Namespace) -> int:
    """Compute the points of a sweep; return 3 if some have a problem."""
    axes: list[SweepAxis] = args.axis
    body = without_sought(read_body(args.case, args, STRIKE), args.operation)
    content = {"base": _fill(body.content, axes), "axes": [axis.content for axis in axes]}
    writers: list[Writer] = []
    if args.plot:
        from service.cli.plots import SweepPlot, check_plot

        if len(axes) > MAX_PLOT_AXES:
            raise UsageError(f"--plot needs one axis or two, not {len(axes)}")
        check_plot()
        writers = [SweepPlot(args.plot, args.operation, [axis.field for axis in axes])]
    try:
        return _compute_sweep(args, content, writers)
    except RefusedError as error:
        raise _explain_axes(error, body, axes) from None


def _compute_sweep(args: argparse.Namespace, content: dict[str, Any], writers: Sequence[Writer]) -> int:
    """Compute the points in this process if they are few and nothing is to be kept, else as a job."""
    if not args.url and not args.data_dir:
        from service.cli import local

        count = math.prod(len(axis.values) for axis in args.axis)
        if local.is_small(args.operation, count) and not args.parquet:
            return write_results(args, local.compute_sweep(args.operation, content), count, content, writers)
    from service.cli.client import JSON, dumps

    body = dumps(content)
    return run_batch(args, BatchRequest(f"/{args.operation}/sweep", lambda: body, JSON, writers))


def read_axis(text: str) -> SweepAxis:
    """Return the axis of a flag `--axis`.

    Raises
    ------
    ArgumentTypeError
        If the text is not FIELD=A,B,C or FIELD=START:STOP:COUNT.
    """
    field, equals, range_ = text.partition("=")
    try:
        if not equals or not all(field.split(".")):
            raise ValueError(text)
        if ":" not in range_:
            values = [float(value) for value in range_.split(",")]
            return SweepAxis(field, values, text, {"field": field, "values": values})
        first, last, number = range_.split(":")
        start, stop, count = float(first), float(last), int(number)
        content = {"field": field, "start": start, "stop": stop, "count": count}
        return SweepAxis(field, _linspace(start, stop, count), text, content)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be FIELD=A,B,C or FIELD=START:STOP:COUNT with at most {MAX_POINTS:,} values, got {text!r}"
        ) from None


def _linspace(start: float, stop: float, count: int) -> list[float]:
    """Return evenly spaced values, computed as the service does."""
    if not 1 <= count <= MAX_POINTS:
        raise ValueError(count)
    if count == 1:
        return [start]
    step = (stop - start) / (count - 1)
    return [start + step * i for i in range(count - 1)] + [stop]


def _fill(body: dict[str, Any], axes: Sequence[SweepAxis]) -> dict[str, Any]:
    """Set missing fields of the axes to their first value, because the base of a sweep must be a valid request."""
    for axis in axes:
        *steps, last = axis.field.split(".")
        parent: Any = body
        for step in steps:
            parent = parent.setdefault(step, {}) if isinstance(parent, dict) else None
        if isinstance(parent, dict):
            parent.setdefault(last, axis.values[0])
    return body


def _explain_axes(error: RefusedError, body: RequestBody, axes: Sequence[SweepAxis]) -> CommandError:
    """Return a problem with the flag or the file of each invalid field."""
    lines = []
    by_pointer = {"/" + axis.field.replace(".", "/"): axis for axis in axes}
    for each in error.errors:
        _, part, *steps = each["pointer"].split("/") if each["pointer"].count("/") else ("", "")
        pointer = "".join(f"/{step}" for step in steps)
        if part == "base" and pointer not in by_pointer:
            lines.append(body.describe(pointer, each["detail"]))
        elif part == "base":
            lines.append(f"--axis {by_pointer[pointer].text}: {each['detail']}")
        elif part == "axes" and steps:
            lines.append(f"--axis {axes[int(steps[0])].text}: {each['detail']}")
        else:
            lines.append(f"--axis: {each['detail']}")
    return CommandError("\n".join(lines), error.status) if lines else error
