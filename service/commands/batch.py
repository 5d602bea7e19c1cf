"""`ricochet batch`: many cases from a file."""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from service.commands.body import STDIN
from service.commands.errors import CommandError, RefusedError
from service.commands.flags import add_data_dir, add_forms, add_operation, add_output, add_url
from service.commands.parsers import examples

PIECE = 256 * 1024
"""Read at once. [bytes]"""
MEDIA_TYPE = "application/jsonl"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its flags."""
    parser.description = (
        "Compute many cases, each a line of JSON with the body of a request, and a custom_id if it likes. Results come "
        "in the order of the file as they are ready: as JSON lines, or as a table of the first on a terminal."
    )
    parser.epilog = examples("ricochet batch cases.jsonl -o angles.csv", "ricochet batch cases.jsonl > angles.jsonl")
    parser.add_argument("file", metavar="FILE.jsonl", help="up to 100,000 cases; - is a pipe")
    add_operation(parser)
    add_output(parser)
    add_forms(parser, json="give the results as JSON lines", csv="give the summaries as a table")
    add_data_dir(parser)
    add_url(parser)


def run(asked: argparse.Namespace) -> int:
    """Have them computed; return 3 if some have a problem."""
    from service.commands.many import Work, compute_many

    if asked.file == STDIN:
        text = sys.stdin.buffer.read()
        work = Work(asked.operation, f"/{asked.operation}/batch", lambda: text, MEDIA_TYPE)
    else:
        path = Path(asked.file)
        _check_readable(path)
        work = Work(asked.operation, f"/{asked.operation}/batch", lambda: _pieces(path), MEDIA_TYPE)
    try:
        return compute_many(asked, work)
    except RefusedError as error:
        raise _explained(error, asked.file) from None


def _check_readable(path: Path) -> None:
    try:
        with path.open("rb"):
            return
    except OSError as error:
        raise CommandError(f"{path}: {error.strerror or error}") from None


def _pieces(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            yield piece


def _explained(error: RefusedError, file: str) -> CommandError:
    """Return a refusal with the lines of the file: the service counts from 0."""
    told = []
    for each in error.errors:
        _, _, rest = each["pointer"].partition("/")
        index, _, pointer = rest.partition("/")
        place = f"{file}:{int(index) + 1}" if index.isdigit() else file
        told.append(": ".join(filter(None, (place, pointer and f"/{pointer}", each["detail"]))))
    return CommandError("\n".join(told), error.status) if told else error
