"""`ricochet report`: write a two-page report on a strike, as HTML or PDF."""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.cli.arguments import (
    FAILED,
    SHOWN_UNITS,
    STRIKE,
    CommandError,
    RefusedError,
    add_case,
    add_url,
    examples,
)
from service.cli.local import answers_to, refusals
from service.cli.outputs import add_output_file
from service.cli.plots import check_plot
from service.cli.request_body import read_body
from service.cli.writers import progress

FLAGS = (*STRIKE, SHOWN_UNITS)
BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "microsoft-edge",
    "microsoft-edge-stable",
    "msedge",
)
"""Commands of browsers that can print to PDF without a window."""
PRINTING = (
    "--headless",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--no-pdf-header-footer",
)
PRINT_SECONDS = 120.0
"""Timeout of the browser [s]. Printing takes a few seconds; a first start on a busy machine may take a minute."""


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet report`."""
    parser.description = (
        "Write a report of one strike on two A4 pages: its critical angle with the usual scatter and under other "
        "models, runs just below and just above it, limits of validity, and the empirical formulas. With --angle the "
        "strike at that angle is judged too. About 550 cases are computed. A PDF is printed by an installed Chromium, "
        "Chrome or Edge."
    )
    parser.epilog = examples(
        "ricochet report strike.toml", "ricochet report strike.toml --angle 30 --units us -o report.pdf"
    )
    add_case(parser, FLAGS)
    described = "file to write, .html or .pdf, or - to print the HTML (default: %(default)s)"
    add_output_file(parser, "-o", "--output", endings=(".html", ".pdf"), default="report.html", help=described)
    add_url(parser)
    parser.set_defaults(run=run_report)


def run_report(args: argparse.Namespace) -> int:
    """Compute a strike, and write its report.

    Raises
    ------
    CommandError
        If the report cannot be made, or the file cannot be written.
    """
    browser = find_browser() if args.output and args.output.ending() == ".pdf" else ""
    body = read_body(args.case, args, FLAGS)
    try:
        page = _fetch_report(args.url, body.content) if args.url else make_report(body.content).encode()
    except RefusedError as error:
        raise body.explain(error) from None
    if args.output is None:
        sys.stdout.buffer.write(page)
        return 0
    args.output.write(print_pdf(browser, page, args.output.path.absolute().parent) if browser else page)
    print(f"wrote {args.output}")
    return 0


def _fetch_report(url: str, body: dict[str, Any]) -> bytes:
    from service.cli.client import connect

    with connect(url) as client:
        return client.compute("report", body)


def make_report(case: dict[str, Any]) -> str:
    """Compute a strike in this process, and return its report as an HTML page.

    Parameters
    ----------
    case
        Body of `POST /report`, in the units of the contract. `ricochet init` writes a file with its fields.

    Raises
    ------
    RefusedError
        If the case is invalid, or its search fails; `problem` names the fields.
    CommandError
        If a package of the extra `reports` is not installed.

    Notes
    -----
    Some 550 cases are computed, about twice as many if the case sets a decay law or S. A progress bar is shown on
    standard error if that is a terminal.

    Examples
    --------
    >>> import tomllib
    >>> from pathlib import Path
    >>> from service.cli.reports import make_report
    >>> case = tomllib.loads(Path("strike.toml").read_text())
    >>> Path("report.html").write_text(make_report(case))
    """
    from datetime import UTC, datetime

    from service.assessment import Query, first_queries, require_extra, strike_queries, write_page
    from service.errors import ReportsMissingError, validated_as
    from service.schemas import ReportRequest

    try:
        check_plot()
        require_extra()
    except ReportsMissingError as error:
        raise CommandError(str(error), FAILED) from None
    with refusals():
        request = validated_as(ReportRequest, case)
        request.check()

    answers: dict[str, Any] = {}
    first = first_queries(request)
    total = len(first) + 5
    with progress("computing") as report:

        def answer(queries: Mapping[str, Query]) -> None:
            for name, found in answers_to(queries):
                answers[name] = found
                report(len(answers), total)

        answer(first)
        answer(strike_queries(request, answers["cra"]))
    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return write_page(case, answers, made, None)


def find_browser() -> str:
    """Return the path of a browser that prints to PDF.

    Raises
    ------
    CommandError
        If none is installed.
    """
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        text = (
            "a PDF is printed by Chromium, Chrome or Edge, and none is on PATH: write the report with -o report.html, "
            "open it in any browser and print it"
        )
        raise CommandError(text, FAILED)
    return found


def print_pdf(browser: str, page: bytes, place: Path) -> bytes:
    """Print an HTML page as PDF, with temporary files in the folder `place`.

    Raises
    ------
    CommandError
        If the browser fails.
    OSError
        If the folder cannot be written.
    """
    # The temporary folder is beside the output, because a browser that is confined by snap or flatpak does not see the
    # temporary folder of the system.
    with tempfile.TemporaryDirectory(prefix="ricochet-", dir=place, ignore_cleanup_errors=True) as folder:
        source, target = Path(folder) / "report.html", Path(folder) / "report.pdf"
        source.write_bytes(page)
        command = [browser, *PRINTING, f"--user-data-dir={folder}/profile", f"--print-to-pdf={target}"]
        if getattr(os, "geteuid", lambda: 1)() == 0:
            command.append("--no-sandbox")  # Chromium does not start a sandbox as root; this page runs no script.
        try:
            done = subprocess.run(  # noqa: S603 (a browser on PATH, with a file of this command)
                [*command, source.as_uri()], capture_output=True, text=True, timeout=PRINT_SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            raise CommandError(f"{browser} has not printed within {PRINT_SECONDS:g} s", FAILED) from None
        if not target.exists():
            reason = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
            raise CommandError(f"{browser} has not printed the report: {reason[0]}", FAILED)
        return target.read_bytes()
