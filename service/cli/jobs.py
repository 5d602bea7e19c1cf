"""`ricochet jobs`, and functions that run batches and sweeps as jobs: submit, show progress, write results."""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO
from uuid import uuid4

from service.cli.arguments import (
    FAILED,
    URL,
    CommandError,
    add_actions,
    add_url,
    examples,
    problem_text,
)
from service.cli.outputs import add_output, open_output, sentence_number
from service.cli.writers import (
    Counts,
    Inputs,
    Item,
    ProgressReport,
    Writer,
    print_table,
    print_values,
    progress,
    writer_for,
)

if TYPE_CHECKING:
    from service.cli.client import Client, Content

DEFAULT_URL = "http://127.0.0.1:8000"
SHORTEST_PAUSE, LONGEST_PAUSE = 0.05, 0.5
"""Shortest and longest interval between requests for new results of a job [s]. The interval doubles each time there are
none. An arbitrary choice: the end of a small job is noticed at once, and a long one is polled only twice a second."""
ACTIONS = (
    ("list", "list the jobs, the newest first", "ricochet jobs list"),
    ("show", "print the state of a job", "ricochet jobs show ID --json"),
    ("results", "print the results of a job in order, until it ends", "ricochet jobs results ID -o results.csv"),
    ("cancel", "cancel a job; its finished results are kept", "ricochet jobs cancel ID"),
    ("delete", "cancel and delete a job", "ricochet jobs delete ID"),
)


def add_jobs(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `ricochet jobs`."""
    parser.description = "List, follow and cancel the jobs of a service: batches and sweeps that run in the background."
    parser.epilog = examples(f"ricochet jobs list --url {DEFAULT_URL}")
    for action, subparser in add_actions(parser, ACTIONS).items():
        if action != "list":
            subparser.add_argument("id", metavar="ID", help="id of the job")
        if action == "results":
            add_output(subparser)
        else:
            subparser.add_argument("--json", action="store_true", help="print the answer as the service sends it")
        add_url(subparser, DEFAULT_URL)
    parser.set_defaults(run=run_jobs)


def run_jobs(args: argparse.Namespace) -> int:
    """Run an action; return 3 if some of the printed results are problems."""
    from service.cli.client import connect

    args.url = args.url or DEFAULT_URL
    with connect(args.url) as client:
        if args.action == "results":
            return print_results(client, args)
        if args.action == "list":
            _print_all(client.jobs(), as_json=args.json)
        elif args.action == "show":
            _print_one(client.job(args.id), as_json=args.json)
        elif args.action == "cancel":
            _print_one(client.cancel(args.id), as_json=args.json)
        else:
            client.delete(args.id)
    return 0


def _print_all(jobs: list[dict[str, Any]], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"jobs": jobs}))
        return
    rows = [[*_summary(job).values(), *_queue(job).values()] for job in jobs]
    names = ("id", "operation", "status", "done", "total", "cached", "failed", "created", "jobs ahead", "remaining s")
    print_table(list(names), rows)


def _print_one(job: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(job))
        return
    times = {name: job[name] for name in ("started", "finished", "expires") if name in job}
    print_values(_summary(job) | times | (_queue(job) if "queue" in job else {}))


def _summary(job: Mapping[str, Any]) -> dict[str, Any]:
    counts = {name: job["counts"][name] for name in ("done", "total", "cached", "failed")}
    return {name: job[name] for name in ("id", "operation", "status")} | counts | {"created": job["created"]}


def _queue(job: Mapping[str, Any]) -> dict[str, Any]:
    """Return the place of a job in the queue and its remaining time, both empty if it has ended."""
    queue = job.get("queue", {})
    return {"jobs ahead": queue.get("jobs_ahead", ""), "remaining s": queue.get("remaining_s", "")}


def print_results(client: "Client", args: argparse.Namespace) -> int:
    """Write the results of a job until it ends; return the exit status."""
    job = client.job(args.id)
    with open_output(args) as stream:
        return follow(client, job, args, stream)


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """Request for many cases.

    Parameters
    ----------
    path
        Route of the batch or the sweep.
    content, media_type
        Body and its media type.
    writers
        Additional writers of the results, such as a plot.
    inputs
        Rows of the input, if some are not sent or their cells are copied to the output.
    """

    path: str
    content: "Content"
    media_type: str
    writers: Sequence[Writer] = ()
    inputs: Inputs | None = None


def run_batch(args: argparse.Namespace, request: BatchRequest) -> int:
    """Compute cases as a job, write their results, and return the exit status."""
    with service_for(args) as client, open_output(args) as stream:
        # With a random idempotency key a repeated submission is safe, and two equal batches become two jobs.
        job = client.submit(request.path, request.content, request.media_type, uuid4().hex)
        if args.url:
            return follow(client, job, args, stream, request)
        try:
            return follow(client, job, args, stream, request)
        finally:
            # The private service ends here, so the job is of no further use. If a data folder was given, the results
            # stay in it.
            with suppress(CommandError):
                client.delete(job["id"])


def write_results(
    args: argparse.Namespace,
    results: Iterable[Item],
    count: int,
    content: Mapping[str, Any],
    further: Sequence[Writer] = (),
) -> int:
    """Write the results of a sweep that is computed in this process, and return the exit status.

    Parameters
    ----------
    results
        Results in order. Each is computed when the iterable yields it.
    count
        Number of results.
    content
        Base and axes of the sweep.
    further
        Additional writers of the results.
    """
    counts = Counts()
    with open_output(args) as stream, kept_rows(args, stream, counts, count):
        table = writer_for(args, stream, args.operation, content["base"])
        writers = (table, *further, counts)
        with progress("computing") as report:
            for item in results:
                for writer in writers:
                    writer.write([item])
                report(counts.total, count)
        for writer in writers:
            writer.close()
    report_counts(args, counts)
    return counts.status


@contextmanager
def kept_rows(args: argparse.Namespace, stream: TextIO, counts: Counts, total: int) -> Iterator[None]:
    """Print the name of the file with the results so far if the block fails."""
    try:
        yield
    except BaseException:
        if args.output and Path(stream.name).stat().st_size:  # A workbook is empty until it is saved.
            print(f"{sentence_number(counts.total)} of {sentence_number(total)} rows in {stream.name}", file=sys.stderr)
        raise


def report_counts(args: argparse.Namespace, counts: Counts) -> None:
    """Print the number of results on standard error, unless they were piped or redirected and none is a problem."""
    if args.output or counts.failed or sys.stdout.isatty():
        print(counts, file=sys.stderr)


def service_for(args: argparse.Namespace) -> AbstractContextManager["Client"]:
    """Open a client for the service at `--url`, or for a private service in this process."""
    if args.url:
        from service.cli.client import connect

        return connect(args.url)
    from service.workers.template import template

    template.start()  # The template loads the solver while this process imports the server.
    from service.cli.server import local_server

    data_dir: Path | None = args.data_dir
    return local_server(data_dir)


def follow(
    client: "Client",
    job: dict[str, Any],
    args: argparse.Namespace,
    stream: TextIO,
    request: BatchRequest | None = None,
) -> int:
    """Write the results of a job until it ends, and return the exit status.

    Parameters
    ----------
    stream
        Output for the results in the format of the flags. A Parquet file comes from the service as a whole.
    request
        Request that created the job, if this command has sent it.

    Raises
    ------
    CommandError
        If the job fails or is cancelled.
    """
    counts = Counts()
    inputs = request.inputs if request else None
    writers: list[Writer] = [*(request.writers if request else ()), counts]
    if not args.parquet:
        asked = client.job(job["id"]).get("request", {})  # The answer to a submission lacks the request.
        base = asked["base"] if "axes" in asked else None
        writers.insert(0, writer_for(args, stream, job["operation"], base, inputs))
    if args.parquet:
        # A service that cannot write Parquet refuses this request at once, rather than the one after the computation.
        client.parquet(job["id"], limit=1)
    with kept_rows(args, stream, counts, job["counts"]["total"]):
        try:
            with progress("computing") as report:
                for page in pages(client, job["id"], report):
                    items = list(inputs.placed(page)) if inputs else page
                    for writer in writers:
                        writer.write(items)
        except KeyboardInterrupt:
            # The hint is printed for Ctrl-C only, after which the job of a service continues without this command.
            print(how_to_continue(job, args), file=sys.stderr)
            raise
        if args.parquet:
            stream.buffer.write(client.parquet(job["id"]))
            stream.flush()
        for writer in writers:
            if inputs:
                writer.write(list(inputs.rest()))
            writer.close()
        state = client.job_at_its_end(job["id"])
        if state["status"] != "successful":
            reason = problem_text(state["problem"]) if "problem" in state else "it was cancelled"
            raise CommandError(f"job {job['id']} ended early, after {counts}: {reason}", FAILED)
    report_counts(args, counts)
    return counts.status


def pages(client: "Client", job_id: str, report: ProgressReport) -> Iterator[Sequence[Item]]:
    """Yield the results of a job in order as they become available, until it ends."""
    cursor, pause = "", SHORTEST_PAUSE
    while True:
        page = client.page(job_id, cursor)
        if page["results"]:
            yield page["results"]
        if "next" not in page:
            return
        counts = client.job(job_id)["counts"]
        report(counts["done"], counts["total"])
        # Pause only if the cursor has not moved, which means that there are no new results.
        if page["next"] == cursor:
            time.sleep(pause)
            pause = min(2.0 * pause, LONGEST_PAUSE)
        else:
            pause = SHORTEST_PAUSE
        cursor = page["next"]


def how_to_continue(job: dict[str, Any], args: argparse.Namespace) -> str:
    """Return a hint that names the commands to continue or stop the job after Ctrl-C."""
    if args.url:
        from service.cli.client import without_secrets

        where = "" if os.environ.get(URL) == args.url else f" --url {without_secrets(args.url)}"
        names = f"{job['id']}{where}"
        return (
            f"the job continues at the service; to stop it: ricochet jobs cancel {names}; "
            f"for its results: ricochet jobs results {names}"
        )
    if args.data_dir:
        return f"finished results are kept in {args.data_dir}; the same command continues from there"
    return "the same command begins anew; with --data-dir it would continue"
