"""`ricochet reproduce` and `ricochet validate`: reports as a page, pictures and tables."""

import argparse
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from service.commands.parsers import examples

EXTRA = frozenset({"jinja2", "markupsafe", "matplotlib"})
"""Packages of the extra `reports`."""
REPORTS = {"reproduce": "reproduction", "validate": "validation"}
"""Module of `service.reports` by command."""
FOLDERS = {"reproduce": Path("build/reproduce"), "validate": Path("build/validation")}
DESCRIPTIONS = {
    "reproduce": "Compute the source paper anew, figure by figure, each number beside the printed one.",
    "validate": "Set the model beside published penetration tests.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags, the same for both."""
    command = parser.prog.split()[-1]
    parser.description = DESCRIPTIONS[command]
    parser.epilog = examples(f"{parser.prog} --output report")
    parser.add_argument(
        "--output", type=Path, default=FOLDERS[command], metavar="FOLDER", help="of the page (%(default)s)"
    )


def run(asked: argparse.Namespace) -> int:
    """Write the report that is asked for; return 1 if it cannot be written."""
    try:
        writer = import_module("service.reports.report")
        report = import_module(f"service.reports.{REPORTS[asked.command]}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in EXTRA:
            raise
        print(f"{error.name} is not installed; reports need it: pip install 'ricochet[reports]'", file=sys.stderr)
        return 1
    try:
        page = _write(writer, report, asked.output)
    except OSError as error:
        print(f"the report cannot be written: {error}", file=sys.stderr)
        return 1
    print(f"wrote {page}")
    return 0


def _write(writer: Any, report: Any, folder: Path) -> Path:
    """Write a report, with a bar on standard error that tells how far it is."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("warming up", total=report.COUNT)

        def tell(what: str) -> None:
            progress.update(task, description=what)

        def counted() -> Iterable[Any]:
            for section in report.sections(tell):
                yield section
                progress.advance(task)

        page: Path = writer.write_report(
            folder, title=report.TITLE, introduction=report.INTRODUCTION, sections=counted()
        )
    return page
