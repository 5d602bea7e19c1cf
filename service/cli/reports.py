"""`ricochet reproduce` and `ricochet validate`: reports as a page with figures and tables."""

import argparse
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from service.cli.arguments import FAILED, CommandError, examples

EXTRA = frozenset({"jinja2", "markupsafe", "matplotlib"})
"""Packages of the extra `reports`."""


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet reproduce`."""
    parser.description = "Recompute the source paper figure by figure, each number beside the printed one."
    _add_output(parser, "reproduction", Path("build/reproduce"))


def add_validate(parser: argparse.ArgumentParser) -> None:
    """Define `ricochet validate`."""
    parser.description = "Compare the model with published penetration tests."
    _add_output(parser, "validation", Path("build/validation"))


def _add_output(parser: argparse.ArgumentParser, report: str, folder: Path) -> None:
    parser.epilog = examples(f"{parser.prog} --output report")
    parser.add_argument(
        "--output", type=Path, default=folder, metavar="FOLDER", help="folder of the page (%(default)s)"
    )
    parser.set_defaults(run=run, report=report)


def run(args: argparse.Namespace) -> int:
    """Write a report.

    Raises
    ------
    CommandError
        If the extra `reports` is not installed, or the folder cannot be written.
    """
    try:
        writer = import_module("service.reports.report")
        report = import_module(f"service.reports.{args.report}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in EXTRA:
            raise
        text = f"{error.name} is not installed; reports need it: pip install 'ricochet[reports]'"
        raise CommandError(text, FAILED) from None
    try:
        page = _write(writer, report, args.output)
    except OSError as error:
        raise CommandError(f"the report cannot be written: {error}", FAILED) from None
    print(f"wrote {page}")
    return 0


def _write(writer: Any, report: Any, folder: Path) -> Path:
    """Write a report, with a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("warming up", total=report.COUNT)

        def sections() -> Iterator[Any]:
            for section in report.sections(lambda name: progress.update(task, description=name)):
                yield section
                progress.advance(task)

        page: Path = writer.write_report(
            folder, title=report.TITLE, introduction=report.INTRODUCTION, sections=sections()
        )
    return page
