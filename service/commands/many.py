"""Many cases: handed in as a job, followed, and their results passed on in order as they come."""

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from service.commands.client import Client, Content, connect
from service.commands.errors import FAILED, CommandError, told
from service.commands.flags import URL
from service.commands.progress import Tell, progress
from service.commands.sinks import Axes, Counts, Item, Sink, sinks_of

if TYPE_CHECKING:
    from pathlib import Path

SHORTEST_PAUSE, LONGEST_PAUSE = 0.05, 0.5
"""Between two looks at a job. [s]"""


@dataclass(frozen=True, slots=True)
class Work:
    """Cases to hand in.

    Parameters
    ----------
    path
        Where to.
    content, media_type
        The body, and what it is.
    axes
        Of a sweep.
    more
        Sinks besides the one that is asked for.
    """

    operation: str
    path: str
    content: Content
    media_type: str
    axes: Axes = field(default_factory=dict)
    more: Sequence[Sink] = ()


def compute_many(asked: argparse.Namespace, work: Work) -> int:
    """Have the cases computed, and pass their results on; return the exit status."""
    with service_of(asked) as client, sinks_of(asked, work.operation, work.axes) as asked_for:
        job = client.submit(work.path, work.content, work.media_type, uuid4().hex)
        sinks = [*asked_for, *work.more]
        if asked.url:
            return follow(client, job, sinks, asked)
        try:
            return follow(client, job, sinks, asked)
        finally:
            with suppress(CommandError):
                client.delete(job["id"])


def service_of(asked: argparse.Namespace) -> AbstractContextManager[Client]:
    """Return the service that is asked for, or a private one."""
    if asked.url:
        return connect(asked.url)
    from service.commands.own_service import own_service

    data_dir: Path | None = asked.data_dir
    return own_service(data_dir)


def follow(client: Client, job: dict[str, Any], sinks: Sequence[Sink], asked: argparse.Namespace) -> int:
    """Pass on the results of a job until it has ended; return the exit status.

    Raises
    ------
    CommandError
        If it does not end well.
    """
    counts = Counts()
    sinks = [*sinks, counts]
    try:
        with progress("computing") as tell:
            for items in results(client, job["id"], tell):
                for sink in sinks:
                    sink.write(items)
    except KeyboardInterrupt:
        print(way_on(job, asked), file=sys.stderr)
        raise
    for sink in sinks:
        sink.end()
    state = client.job(job["id"])
    if state["status"] != "successful":
        why = told(state["problem"]) if "problem" in state else "it was cancelled"
        raise CommandError(f"job {job['id']} has {counts}, and ended early: {why}", FAILED)
    if asked.output or counts.failed or sys.stdout.isatty():
        print(counts, file=sys.stderr)
    return counts.status


def results(client: Client, name: str, tell: Tell) -> Iterator[Sequence[Item]]:
    """Yield the results of a job in order as they are ready, until there are no more to come."""
    cursor, pause = "", SHORTEST_PAUSE
    while True:
        page = client.page(name, cursor)
        if page["results"]:
            yield page["results"]
        if "next" not in page:
            return
        counts = client.job(name)["counts"]
        tell(counts["done"], counts["total"])
        if page["next"] == cursor:
            time.sleep(pause)
            pause = min(2.0 * pause, LONGEST_PAUSE)
        cursor = page["next"]


def way_on(job: dict[str, Any], asked: argparse.Namespace) -> str:
    """Return how to go on with what was interrupted."""
    if asked.url:
        where = "" if os.environ.get(URL) == asked.url else f" --url {asked.url}"
        return f"the job goes on; its results: ricochet jobs results {job['id']}{where}"
    if asked.data_dir:
        return f"what is finished is kept in {asked.data_dir}: the same command goes on from there"
    return "with --data-dir, what is finished would have been kept"
