"""Growth of times and memory with the numbers of cores, queued cases, results on disk and jobs.

    python benchmarks/growth.py [--quick] [--figure growth.svg]

1. Searches a second against threads, up to the cores of this machine. Chunks a second against workers of a Dask
   cluster; each chunk only sleeps for 0.1 s, so any loss is due to the executor and the scheduler.
2. Memory of the server against queued cases, which are one job of JSON lines.
3. Disk usage, time to open the results and time to start the service, against the number of results. The results are
   copies of 200 computed ones under other keys, in segments of 200; a chunk of a job has up to 256.
4. Times of `GET /jobs`, of accepting a job and of a start, against the number of jobs. The jobs are copies of one that
   has ended.

A line is fitted to each curve by least squares of the relative errors. If the largest relative error is more than
`TOLERANCE`, the table shows where the slope differs most from the initial one. The times in 3 and 4 are the shortest of
several. Takes about six minutes; `--quick` leaves out the largest sizes and takes two. Needs Linux (/proc).
"""

import argparse
import asyncio
import hashlib
import json
import os
import sqlite3
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
from distributed import LocalCluster

from benchmarks.clients import JSONL, run_batch, to_request
from benchmarks.machine import print_machine, print_table
from benchmarks.random_cases import one_by_one, random_cases, study_cases
from benchmarks.scaling import in_threads, measure
from benchmarks.servers import Server, service
from service.cache.cache import ResultCache
from service.cache.record import Record
from service.operations import OPERATIONS, KeyedRequest
from service.reports.style import panels, styled
from service.schemas import CriticalAngleRequest
from service.workers.dask_executor import DaskExecutor
from solver import warm_up

SEGMENT = 200
TOLERANCE = 0.25
STARTS, REQUESTS, SUBMISSIONS = 3, 30, 30
WORKERS, SLEEP_SECONDS, SLEEPS = (1, 2, 4, 8), 0.1, 50
QUEUED = (1_000, 10_000, 100_000)
RESULTS = (1_000, 10_000, 100_000, 1_000_000)
JOBS = (1_000, 10_000, 100_000)
SEARCHES, QUICK_SEARCHES = 1_000, 100


@dataclass
class Curve:
    """Values measured at several sizes."""

    name: str
    unit: str
    against: str
    points: list[tuple[int, float]] = field(default_factory=list)

    def line(self) -> tuple[float, float]:
        """Return constant and slope of the line that is fitted by least squares of the relative errors."""
        sizes, values = np.array(self.points).T
        slope, constant = np.polyfit(sizes, values, 1, w=1.0 / values)
        return float(constant), float(slope)

    def fit(self) -> str:
        """Describe the fitted line or, if it does not fit, where the curve bends."""
        (first, small), *_, (last, large) = self.points
        if len(self.points) < 3:
            return f"{large / small:.3g} times from {first:,} to {last:,}"
        constant, slope = self.line()
        sizes, values = np.array(self.points).T
        off = max(abs((constant + slope * sizes) / values - 1.0))
        slopes = np.diff(values) / np.diff(sizes)
        bend = np.argmax(abs(slopes / slopes[0] - 1.0))
        if off > TOLERANCE:
            return f"bends at {sizes[bend]:,.0f}: from there {slopes[bend] / slopes[0]:.2g} times as steep as at first"
        return f"{constant:.3g} + {slope:.3g} each, within {off:.0%}"


def least(call: Callable[[], object], times: int) -> float:
    """Return the shortest time of several calls. [s]"""
    found = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        found.append(time.perf_counter() - begin)
    return min(found)


def searches(count: int) -> list[Curve]:
    cases, curve = random_cases(count, 31), Curve("searches", "1/s", "threads")
    for threads in range(1, (os.cpu_count() or 1) + 1):
        curve.points.append((threads, count / measure(lambda workers: in_threads(cases, workers), threads).wall))
    return [curve]


def chunks(sizes: Sequence[int]) -> list[Curve]:
    curve = Curve("sleeping chunks", "1/s", "Dask workers")
    for size in sizes:
        with LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=size, threads_per_worker=1, protocol="tcp://", dashboard_address=None
        ) as dask:
            seconds = asyncio.run(seconds_for_chunks(dask.scheduler_address, size))
        curve.points.append((size, SLEEPS * size / seconds))
    return [curve]


async def seconds_for_chunks(address: str, workers: int) -> float:
    """Return the time in which a cluster completes `SLEEPS` chunks for each worker. The chunks only sleep. [s]"""
    executor = DaskExecutor(address=address, workers=1, task_seconds=60.0)
    await executor.start()
    try:
        while executor.cluster.capacity < workers:
            await executor.cluster.changed.wait()
        await asyncio.gather(*(executor.run([(time.sleep, (0.0,))]) for _ in range(4 * workers)))  # Warms up the pools.
        begin = time.perf_counter()
        found = await asyncio.gather(*(executor.run([(time.sleep, (SLEEP_SECONDS,))]) for _ in range(SLEEPS * workers)))
        seconds = time.perf_counter() - begin
    finally:
        await executor.stop(1.0)
    failed = [result.error for results in found for result in results if result.error is not None]
    if failed:
        raise RuntimeError(f"{len(failed)} chunks failed: {failed[0]}")
    return seconds


def memory(sizes: Sequence[int]) -> list[Curve]:
    """Measure the current and the peak resident memory of a server that has just accepted a job."""
    kept, most = Curve("memory", "MB", "queued cases"), Curve("greatest memory", "MB", "queued cases")
    for number, size in enumerate(sizes):
        body = b"".join(json.dumps(to_request(case)).encode() + b"\n" for case in one_by_one(study_cases(size, number)))
        with service() as server:
            submit(server, body)
            status = Path(f"/proc/{server.pid}/status").read_text()
            for curve, name in ((kept, "VmRSS:"), (most, "VmHWM:")):
                curve.points.append((size, int(status.partition(name)[2].split()[0]) / 1e3))
    return [kept, most]


def submit(server: Server, body: bytes) -> None:
    """Submit a job of JSON lines.

    Raises
    ------
    RuntimeError
        If the job is refused.
    """
    exchange(server, "POST", "/cra/batch", 202, body, {"Content-Type": JSONL, "Prefer": "respond-async"})


def exchange(
    server: Server,
    method: str,
    path: str,
    status: int,
    body: bytes | None = None,
    headers: dict[str, str] | None = None,
) -> None:
    """Send a request and read the answer.

    Raises
    ------
    RuntimeError
        If the answer has a status other than `status`.
    """
    with closing(HTTPConnection("127.0.0.1", server.port, timeout=600.0)) as connection:
        connection.request(method, path, body, headers or {})
        answer = connection.getresponse()
        content = answer.read()
        if answer.status != status:
            raise RuntimeError(f"{path} answered {answer.status}: {content[:500]!r}")


def results(sizes: Sequence[int]) -> list[Curve]:
    disk = Curve("disk", "MB", "results")
    opening, start = Curve("opening the results", "s", "results"), Curve("start", "s", "results")
    cases = [to_request(case) for case in one_by_one(study_cases(SEGMENT, 41))]
    texts = [KeyedRequest.of("cra", CriticalAngleRequest.model_validate(case)).json for case in cases]
    answers = [OPERATIONS["cra"].compute(text)[0] for text in texts]
    with tempfile.TemporaryDirectory() as temporary:
        folder, done = Path(temporary), 0

        def opened() -> ResultCache:
            return ResultCache(folder / "data", memory_bytes=10**8, disk_bytes=10**12)

        for size in sizes:
            with opened() as cache:
                for first in range(done, size, SEGMENT):
                    keys = [hashlib.sha256(b"%d" % number).hexdigest() for number in range(first, first + SEGMENT)]
                    copies = zip(keys, texts, answers, strict=True)
                    cache.put_many([Record(key, "cra", text, answer) for key, text, answer in copies])
            done = size
            disk.points.append((size, bytes_in(folder / "data") / 1e6))
            opening.points.append((size, least(lambda: opened().close(), STARTS)))
            start.points.append((size, least_start(folder)))
    return [disk, opening, start]


def bytes_in(folder: Path) -> int:
    """Return the disk usage of the files in a folder, in whole blocks. [bytes]"""
    return sum(512 * path.stat().st_blocks for path in folder.rglob("*"))


def least_start(folder: Path) -> float:
    """Return the shortest time, of several starts, until a service with this folder is ready. [s]"""
    ready = []
    for _ in range(STARTS):
        begin = time.perf_counter()
        with service(folder, cache_bytes=str(10**12)):
            ready.append(time.perf_counter() - begin)
    return min(ready)


def jobs(sizes: Sequence[int]) -> list[Curve]:
    listing, accepting = Curve("GET /jobs", "ms", "jobs"), Curve("accepting a job", "ms", "jobs")
    start = Curve("start", "s", "jobs")
    [case] = [to_request(each) for each in one_by_one(study_cases(1, 51))]
    body = json.dumps(case).encode()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with service(folder) as server:
            run_batch(server, "/cra/batch", [case])
        for size in sizes:
            copy_job(folder / "data" / "jobs.sqlite", size)
            start.points.append((size, least_start(folder)))
            with service(folder) as server:
                listed = least(partial(exchange, server, "GET", "/jobs", 200), REQUESTS)
                accepted = least(partial(submit, server, body), SUBMISSIONS)
            listing.points.append((size, 1e3 * listed))
            accepting.points.append((size, 1e3 * accepted))
    return [listing, accepting, start]


COPY = """
WITH RECURSIVE copies (number) AS (SELECT 1 UNION ALL SELECT number + 1 FROM copies WHERE number < ?)
INSERT INTO jobs (id, {columns}) SELECT lower(hex(randomblob(16))), {columns}
FROM copies JOIN (SELECT * FROM jobs ORDER BY number LIMIT 1)
"""
COPY_PARTS = """
INSERT INTO {table} (job, {columns}) SELECT jobs.number, {columns}
FROM jobs JOIN (SELECT * FROM {table} ORDER BY job LIMIT 1) WHERE jobs.number NOT IN (SELECT job FROM {table})
"""


def copy_job(path: Path, size: int) -> None:
    """Copy the first job, with its cases, until there are `size` jobs."""
    with closing(sqlite3.connect(path)) as database, database:

        def columns_of(table: str, *keys: str) -> str:
            names = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            return ", ".join(name for name in names if name not in keys)

        there = database.execute("SELECT count(*) FROM jobs").fetchone()[0]
        database.execute(COPY.format(columns=columns_of("jobs", "number", "id")), (size - there,))
        for table in ("slices", "states"):
            database.execute(COPY_PARTS.format(table=table, columns=columns_of(table, "job")))


def draw(curves: Sequence[Curve], path: Path) -> None:
    """Draw every curve with its line. An axis is logarithmic if its values span more than a decade."""
    with styled():
        rows = -(-len(curves) // 3)
        figure, axes = panels(len(curves), rows=rows, height=2.2 * rows)
        for each, curve in zip(axes, curves, strict=True):
            sizes, values = np.array(curve.points).T
            constant, slope = curve.line()
            between = np.geomspace(sizes[0], sizes[-1], 50)
            each.plot(sizes, values, "o", between, constant + slope * between, "-", color="#123f73")
            if sizes[-1] > 10.0 * sizes[0]:
                each.set_xscale("log")
            else:
                each.set_xticks(sizes)
            if max(values) > 10.0 * min(values):
                each.set_yscale("log")
            else:
                each.set_ylim(0.0, 1.15 * max(values))
            each.set_xlabel(curve.against)
            each.set_title(f"{curve.name} [{curve.unit}]")
        figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the growth of times and memory.")
    parser.add_argument("--quick", action="store_true", help="leave out the largest sizes")
    parser.add_argument("--figure", type=Path, help="draw the curves into this file")
    options = parser.parse_args()
    end = -1 if options.quick else None
    print_machine()
    warm_up()
    curves = [
        *searches(QUICK_SEARCHES if options.quick else SEARCHES),
        *chunks(WORKERS[:end]),
        *memory(QUEUED[:end]),
        *results(RESULTS[:end]),
        *jobs(JOBS[:end]),
    ]
    rows = [
        [
            f"{each.name} [{each.unit}]",
            each.against,
            ", ".join(f"{size:,}: {value:.3g}" for size, value in each.points),
            each.fit(),
        ]
        for each in curves
    ]
    print_table(["", "against", "measured", "line"], rows)
    if options.figure is not None:
        draw(curves, options.figure)


if __name__ == "__main__":
    main()
