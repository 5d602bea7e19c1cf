"""Command `python -m validation`, which writes the report `reproduce` or `validate` with its figures and tables."""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from validation import published_tests, reproduction
from validation.report import Section, write_report


def main(arguments: list[str] | None = None) -> int:
    """Write the requested report; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m validation", description="Compare the model with published results."
    )
    reports = parser.add_subparsers(required=True, metavar="REPORT")
    for name, report, folder, text in (
        ("reproduce", reproduction, "build/reproduce", "recompute the source paper beside its printed numbers"),
        ("validate", published_tests, "build/validation", "compare with published penetration tests"),
    ):
        command = reports.add_parser(name, help=text, description=text)
        command.add_argument(
            "--output", type=Path, default=Path(folder), metavar="FOLDER", help="folder of the page (%(default)s)"
        )
        command.set_defaults(report=report)
    args = parser.parse_args(arguments)
    try:
        page, summaries = write(args.report, args.output)
    except OSError as error:
        print(f"the report cannot be written: {error}", file=sys.stderr)
        return 1
    print(*summaries, f"wrote {page}", sep="\n")
    return 0


def write(report: Any, folder: Path) -> tuple[Path, list[str]]:
    """Write a report, with a progress bar on standard error; return its page and the summaries to print.

    Parameters
    ----------
    report
        Module with `TITLE`, `INTRODUCTION`, `COUNT` and `sections`.
    folder
        Folder of the page.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    summaries = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("warming up", total=report.COUNT)

        def sections() -> Iterator[Section]:
            for section in report.sections(lambda name: progress.update(task, description=name)):
                yield section
                if section.summary:
                    summaries.append(section.summary)
                progress.advance(task)

        page = write_report(folder, title=report.TITLE, introduction=report.INTRODUCTION, sections=sections())
    return page, summaries


if __name__ == "__main__":
    sys.exit(main())
