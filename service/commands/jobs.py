"""`ricochet jobs`: the jobs of a service."""

import argparse
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from service.commands.flags import add_forms, add_output, add_url
from service.commands.parsers import add_actions, examples

if TYPE_CHECKING:
    from service.commands.client import Client

HERE = "http://127.0.0.1:8000"
ACTIONS = (
    ("list", "list the jobs, the newest first", "ricochet jobs list"),
    ("show", "tell how far a job is", "ricochet jobs show ID --json"),
    ("results", "give the results of a job as they come, in order", "ricochet jobs results ID -o results.csv"),
    ("cancel", "end a job; what is ready of its results stays", "ricochet jobs cancel ID"),
    ("delete", "end a job and forget it", "ricochet jobs delete ID"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what can be done with jobs, each with its help."""
    parser.description = "Look after the jobs of a service: batches and sweeps that go on without whoever asked."
    parser.epilog = examples(f"ricochet jobs list --url {HERE}")
    for action, own in add_actions(parser, "action", ACTIONS).items():
        if action != "list":
            own.add_argument("id", metavar="ID", help="of the job")
        if action == "results":
            add_output(own)
            add_forms(own, json="give them as JSON lines", csv="give the summaries as a table")
        else:
            own.add_argument("--json", action="store_true", help="print what the service says")
        add_url(own, f"{HERE} if not given")


def run(asked: argparse.Namespace) -> int:
    """Do what is asked; return 3 if it is results and some have a problem."""
    from service.commands.client import connect

    asked.url = asked.url or HERE
    with connect(asked.url) as client:
        if asked.action == "results":
            return _results(client, asked)
        if asked.action == "list":
            _print_all(client.jobs(), as_json=asked.json)
        elif asked.action == "show":
            _print_one(client.job(asked.id), as_json=asked.json)
        elif asked.action == "cancel":
            _print_one(client.cancel(asked.id), as_json=asked.json)
        else:
            client.delete(asked.id)
    return 0


def _results(client: "Client", asked: argparse.Namespace) -> int:
    from service.commands.many import follow
    from service.commands.sinks import sinks_of

    job = client.job(asked.id)
    with sinks_of(asked, job["operation"], {}) as sinks:
        return follow(client, job, sinks, asked)


def _print_all(jobs: list[dict[str, Any]], *, as_json: bool) -> None:
    from service.commands.tables import print_table

    if as_json:
        print(json.dumps({"jobs": jobs}))
        return
    rows = [list(_told(job).values()) for job in jobs]
    print_table(["id", "operation", "status", "done", "total", "cached", "failed", "created"], rows)


def _print_one(job: dict[str, Any], *, as_json: bool) -> None:
    from service.commands.tables import print_values

    if as_json:
        print(json.dumps(job))
        return
    print_values(_told(job) | {name: job[name] for name in ("started", "finished", "expires") if name in job})


def _told(job: Mapping[str, Any]) -> dict[str, Any]:
    counts = {name: job["counts"][name] for name in ("done", "total", "cached", "failed")}
    return {name: job[name] for name in ("id", "operation", "status")} | counts | {"created": job["created"]}
