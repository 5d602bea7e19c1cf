"""`ricochet batch` and `ricochet sweep`: compute many cases locally or through a service."""

import argparse
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
from service.cli.jobs import BatchRequest, run_batch, write_results
from service.cli.outputs import add_output, add_plot, sentence_number
from service.cli.request_body import MISSING, STDIN, RequestBody, read_body, read_text, without_sought
from service.cli.writers import Inputs, Writer, require_excel

if TYPE_CHECKING:
    from service.cli.case_table import CaseTable
    from service.cli.client import Content

READ_SIZE = 256 * 1024
"""Size of the pieces in which a file is read [bytes]. A service validates lines in blocks of 200, or of this many bytes
if the lines are long."""
JSONL = "application/jsonl"
TABLES = frozenset({".csv", ".tsv", ".xlsx"})
"""File extensions of tables of cases."""
OTHER_SPREADSHEETS = frozenset({".xls", ".xlsb", ".xlsm", ".ods", ".numbers", ".parquet"})
"""File extensions of other tables, which are refused with the advice to save them as .xlsx or .csv."""
MAX_LISTED = 50
"""Largest number of errors that are listed, an arbitrary choice: nobody corrects more at once."""
MAX_PLOT_AXES = 2
"""Largest number of axes that a plot can show: a curve has one, a map two."""
MAX_POINTS = 100_000
"""Largest number of points of a sweep that a service accepts: a copy of `MOST_LINES`, which is slow to import."""


class SweepAxis(NamedTuple):
    """An axis of a sweep: field, values, text as typed, and JSON content as sent."""

    field: str
    values: list[float]
    text: str
    content: dict[str, Any]


def add_batch(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet batch`."""
    parser.description = (
        "Compute many cases. Each line of the file is a request body in JSON, with an optional custom_id. "
        "Alternatively the file is a table, CSV or Excel, with a case in each row and a field in each column, such as "
        "velocity_m_s, 'Speed (m/s)', fc_MPa or id; units are in the header or in a second line. CSV and Excel "
        "results repeat the columns of the table. Results are written in the order of the file as soon as they are "
        "ready: as JSON lines, or on a terminal as a table of the first ones."
    )
    parser.epilog = examples(
        "ricochet batch cases.jsonl -o angles.csv",
        "ricochet batch cases.jsonl > angles.jsonl",
        "ricochet batch cases.csv --case strike.toml -o angles.csv",
        "ricochet batch cases.csv --case strike.toml --skip-bad -o angles.xlsx",
    )
    parser.add_argument(
        "file",
        type=InputFile,
        metavar="FILE",
        help="file of up to 100,000 cases, .jsonl, .csv, .tsv or .xlsx; - reads JSON lines",
    )
    parser.add_argument(
        "--case", type=InputFile, metavar="CASE", help="TOML or JSON file with the fields that a table lacks"
    )
    parser.add_argument(
        "--keep", action="append", default=[], metavar="HEADER", help="column that is not a field, copied to the output"
    )
    parser.add_argument(
        "--skip-bad", action="store_true", help="compute the valid rows, and write the others with their errors"
    )
    _add_common(parser)
    parser.set_defaults(run=run_file)


def add_sweep(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet sweep`."""
    parser.description = (
        "Compute a case for every combination of the values of up to four fields; the last axis varies fastest. The "
        "file may lack the fields of the axes. For thickness and limit-speed, the quantity to find is ignored in the "
        "file, and so is everything but projectile, target, impact, resistance and numerics."
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
    add_plot(parser, "the result of each case (of a trajectory, its maximum depth) over one axis, or as a map over two")
    parser.set_defaults(run=run_sweep)


def _add_common(parser: argparse.ArgumentParser) -> None:
    add_operation(parser)
    add_output(parser)
    add_data_dir(parser)
    add_url(parser)


def run_file(args: argparse.Namespace) -> int:
    """Compute the cases of a file; return 3 if some of them have a problem."""
    ending = Path(args.file).suffix.lower()
    is_table = ending in TABLES
    if ending in OTHER_SPREADSHEETS:
        raise UsageError(f"{args.file}: is a table of a kind that is not read; save it as .xlsx or .csv")
    if not is_table and (args.case or args.keep):
        flag = "--case" if args.case else "--keep"
        raise UsageError(f"{flag}: goes with a table of cases, .csv, .tsv or .xlsx; {args.file} is read as JSON lines")
    # A missing package is reported before the cases are computed, because a workbook is only written at the end.
    if args.xlsx:
        require_excel(f"--output {args.output}")
    if is_table:
        return run_batch(args, _request(args, *_cases_of_table(args)))
    if args.skip_bad:
        return run_batch(args, _request(args, *_cases_of_lines(args)))
    if args.file == STDIN:
        # A pipe can be read only once, but its content may have to be sent again or checked.
        text = sys.stdin.buffer.read()
        return _run_lines(args, lambda: text)
    file = Path(args.file)
    # An unreadable file is reported now rather than from within the request that streams it.
    _check_readable(file)
    return _run_lines(args, lambda: _read_pieces(file))


def _run_lines(args: argparse.Namespace, read: "Content") -> int:
    """Compute cases from JSON lines as they are read, without checking them first."""
    try:
        return run_batch(args, BatchRequest(_path(args), read, JSONL))
    except RefusedError as error:
        raise _explain_lines(args, error, read) from None


def _path(args: argparse.Namespace, kind: str = "batch") -> str:
    return f"/{args.operation.replace('_', '/')}/{kind}"


def _request(args: argparse.Namespace, cases: Sequence[bytes], inputs: Inputs) -> BatchRequest:
    return BatchRequest(_path(args), lambda: b"\n".join(cases), JSONL, inputs=inputs)


def _cases_of_table(args: argparse.Namespace) -> tuple[list[bytes], Inputs]:
    """Return the valid cases of a table, and all of its rows.

    Raises
    ------
    CommandError
        If the file is not a table, no row is valid, or a row is invalid and `--skip-bad` is not given.
    """
    from service.cli.case_table import CUSTOM_ID, UnknownColumnsError, read_cases
    from service.cli.local import wrong_cases

    base = without_sought(read_body(args.case, args, ()), args.operation)
    try:
        table = read_cases(Path(args.file), args.operation, base.content, args.keep)
    except UnknownColumnsError as error:
        raise CommandError(f"{error}\nfields of a case: {', '.join(error.fields)}") from None
    numbers = [number for number, row in enumerate(table.rows) if not row.error]
    wrong = wrong_cases(args.operation, (dict(table.rows[number].case) for number in numbers))
    errors = {number: [{"pointer": "", "detail": row.error}] for number, row in enumerate(table.rows) if row.error}
    errors |= {numbers[place]: found for place, found in wrong.items()}
    if errors and (not args.skip_bad or len(errors) == len(table.rows)):
        raise bad_rows(_described(table, errors, base), some_good=len(errors) < len(table.rows))
    names = {number: str(table.rows[number].case.get(CUSTOM_ID, "")) for number in errors}
    sent = [number for number in range(len(table.rows)) if number not in errors]
    headers = [column.header for column in table.columns]
    cells, texts = [row.cells for row in table.rows], dict[int, str]()
    for number, found in errors.items():
        place = f"{table.path}:{table.rows[number].line}: "
        described = (_describe(table, number, each, base).removeprefix(place) for each in found)
        texts[number] = "; ".join(described)
    inputs = Inputs(sent, _left_out(errors, names, _path(args)), headers, cells, texts)
    return [json.dumps(table.rows[number].case).encode() for number in sent], inputs


def _described(
    table: "CaseTable", errors: Mapping[int, Sequence[Mapping[str, str]]], base: RequestBody
) -> Iterator[str]:
    """Yield the errors of a table and of the `--case` file. Missing fields without a column are reported once."""
    missing = {each["pointer"] for found in errors.values() for each in found if each["detail"] == MISSING}
    everywhere = {pointer for pointer in missing if not table.gives(pointer)}
    for pointer in sorted(everywhere):
        yield f"{table.path}: {pointer}: is missing in every row; add a column for it, or set it in the --case file"
    for number in sorted(errors):
        for each in errors[number]:
            if each["pointer"] not in everywhere:
                yield _describe(table, number, each, base)


def _describe(table: "CaseTable", number: int, error: Mapping[str, str], base: RequestBody) -> str:
    """Return the message for an error in a row of a table or in the `--case` file, beginning with its place."""
    pointer, detail, row = error["pointer"], error["detail"], table.rows[number]
    in_file = base.describe(pointer, detail) if pointer and base.value_at(pointer) is not None else ""
    place = f"{table.path}:{row.line}: {pointer}".removesuffix(": ")
    return table.described(row, pointer, detail) or in_file or f"{place}: {detail}"


def _cases_of_lines(args: argparse.Namespace) -> tuple[list[bytes], Inputs]:
    """Return the valid cases of a file of JSON lines, and the problems of the other lines.

    Raises
    ------
    CommandError
        If no line is valid.
    """
    from service.cli.local import wrong_cases

    # Empty lines at the end of the file are ignored; elsewhere they are errors, as for a service.
    lines = read_text(args.file).rstrip("\n").encode().split(b"\n")
    errors = wrong_cases(args.operation, lines)
    sent = [number for number in range(len(lines)) if number not in errors]
    if not sent:
        raise bad_rows(_describe_lines(args.file, errors), some_good=False)
    return [lines[number] for number in sent], Inputs(sent, _left_out(errors, {}, _path(args)))


def _left_out(
    errors: Mapping[int, Sequence[Mapping[str, str]]], names: Mapping[int, str], path: str
) -> dict[int, dict[str, Any]]:
    """Return a result item for each invalid case, with the problem that a service would report."""
    from service.errors import InvalidBodyError, problem_of

    items: dict[int, dict[str, Any]] = {}
    for number, found in errors.items():
        problem = problem_of(InvalidBodyError(list(map(dict, found)))) | {"instance": path}
        name = {"custom_id": names[number]} if names.get(number) else {}
        items[number] = {"index": number, **name, "problem": problem}
    return items


def bad_rows(errors: Iterable[str], *, some_good: bool) -> CommandError:
    """Return an error with up to `MAX_LISTED` messages, and a line about `--skip-bad` if some rows are valid."""
    found = list(dict.fromkeys(errors))  # An error in the `--case` file occurs in every row.
    lines = found[:MAX_LISTED]
    if len(found) > MAX_LISTED:
        lines.append(f"and {sentence_number(len(found) - MAX_LISTED)} more")
    if some_good:
        lines.append("--skip-bad computes the others")
    return CommandError("\n".join(lines))


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


def _explain_lines(args: argparse.Namespace, error: RefusedError, read: "Content") -> CommandError:
    """Return an error that lists the invalid lines. The service reports only the first, and counts lines from 0."""
    from service.cli.local import wrong_cases

    content = read()
    # The content of a pipe was kept as bytes; a file is read again.
    text = content if isinstance(content, bytes) else b"".join(content)
    texts = text.rstrip(b"\n").split(b"\n")
    wrong = wrong_cases(args.operation, texts)
    if not wrong:
        for each in error.errors:
            index, _, pointer = each["pointer"].removeprefix("/").partition("/")
            number = int(index) if index.isdigit() else -1
            wrong.setdefault(number, []).append({**each, "pointer": pointer and f"/{pointer}"})
    if not wrong:
        return error
    return bad_rows(_describe_lines(args.file, wrong), some_good=len(wrong) < len(texts))


def _describe_lines(file: str, errors: Mapping[int, Sequence[Mapping[str, str]]]) -> Iterator[str]:
    """Yield the messages for errors by line, counted from 0; errors of the whole file have the number -1."""
    for number, found in sorted(errors.items()):
        place = file if number < 0 else f"{file}:{number + 1}"
        for each in found:
            yield ": ".join(filter(None, (place, each["pointer"], each["detail"])))


def run_sweep(args: argparse.Namespace) -> int:
    """Compute the points of a sweep; return 3 if some of them have a problem."""
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
    """Run a sweep as a job, or in this process if it is small and neither `--url` nor `--data-dir` is given."""
    if not args.url and not args.data_dir:
        from service.cli import local

        count = math.prod(len(axis.values) for axis in args.axis)
        # Only a service writes Parquet, so a sweep with such an output runs as a job.
        if local.is_small(args.operation, count) and not args.parquet:
            return write_results(args, local.compute_sweep(args.operation, content), count, content, writers)
    from service.cli.client import JSON, dumps

    body = dumps(content)
    return run_batch(args, BatchRequest(_path(args, "sweep"), lambda: body, JSON, writers))


def read_axis(text: str) -> SweepAxis:
    """Parse the value of `--axis`.

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
    """Return `count` evenly spaced values from `start` to `stop`, computed as the service does."""
    if not 1 <= count <= MAX_POINTS:
        raise ValueError(count)
    if count == 1:
        return [start]
    step = (stop - start) / (count - 1)
    return [start + step * i for i in range(count - 1)] + [stop]


def _fill(body: dict[str, Any], axes: Sequence[SweepAxis]) -> dict[str, Any]:
    """Set each missing field of an axis to its first value, because the base of a sweep must be a valid request."""
    for axis in axes:
        *steps, last = axis.field.split(".")
        parent: Any = body
        for step in steps:
            parent = parent.setdefault(step, {}) if isinstance(parent, dict) else None
        if isinstance(parent, dict):
            parent.setdefault(last, axis.values[0])
    return body


def _explain_axes(error: RefusedError, body: RequestBody, axes: Sequence[SweepAxis]) -> CommandError:
    """Return an error that names the flag or the file of each invalid field of a sweep."""
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
