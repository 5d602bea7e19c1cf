"""Overhead of HTTP compared with the bare solver.

    python benchmarks/http_load.py [--cases 20000 2000] [--quick]

1. Throughput of a batch of JSON lines, as a fraction of the throughput of a bare process pool. The pool runs `solver`
   in as many processes as the service has workers, and solves the same cases before and after the batch.
2. Time for each case when the same batch is read from the cache, and CPU time of the server, without its workers, for
   a new case and for a cached one.
3. Requests to a cached `/cra` that are answered in a second, compared with an empty FastAPI route under uvicorn.
4. Longest response time of `/livez` during the batches. A process polls it every 20 ms throughout, so that the polling
   takes the same share of the cores from the bare pool and from the batch.

Client, service and workers share this machine. The cases are from a study of one projectile. They are cheaper than
random ones, so that the overhead of the service is a larger part. Exits with 1 if the angles of pool, batch and cache
differ. Takes about ten minutes; `--quick` uses 200 cases.
"""

import argparse
import json
import math
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from http.client import HTTPConnection
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import mean, median

from fastapi import FastAPI

from benchmarks.clients import raw_request, requests_per_second, run_batch, to_request
from benchmarks.machine import print_machine, print_table
from benchmarks.random_cases import Case, answer_or_error, one_by_one, study_cases
from benchmarks.servers import Server, free_port, service
from benchmarks.timing import process_pool
from solver import RicochetError, warm_up

WORKERS = 2
CHUNK = 25
"""Number of cases that a process of the bare pool takes at a time."""
CACHED_RUNS = 3
POLL_SECONDS = 0.02
RATE_SECONDS, QUICK_RATE_SECONDS, RATE_ROUNDS = 2.0, 0.3, 3


def empty_app() -> FastAPI:
    app = FastAPI(openapi_url=None)

    @app.get("/empty")
    async def empty() -> None:
        return None

    return app


@contextmanager
def empty_service() -> Iterator[Server]:
    """Run the application with the empty route under uvicorn during the block."""
    port = free_port()
    command = [sys.executable, "-m", "uvicorn", "--factory", "benchmarks.http_load:empty_app", "--port", str(port)]
    with tempfile.TemporaryDirectory() as folder:
        server = Server([*command, "--no-access-log"], port, Path(folder) / "log", {}, "/empty")
        try:
            server.start()
            yield server
        finally:
            server.stop()


def solve_bare(pool: ProcessPoolExecutor, cases: list[Case]) -> tuple[list[float | None], float]:
    """Solve cases with the bare pool; return their critical angles [°], None where there is none, and the time [s]."""
    begin = time.perf_counter()
    answers = list(pool.map(answer_or_error, cases, chunksize=CHUNK))
    seconds = time.perf_counter() - begin
    angles = [None if isinstance(answer, RicochetError) else answer.angle for answer in answers]
    return [None if angle is None else math.degrees(angle) for angle in angles], seconds


def count_different(angles: list[float | None], results: list[bytes]) -> int:
    """Return the number of results of a batch whose critical angle differs by more than rounding."""
    found = [json.loads(line).get("result", {}).get("critical_angle_deg") for line in results]
    return sum(not math.isclose(a or 0.0, b or 0.0, rel_tol=1e-15) for a, b in zip(angles, found, strict=True))


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of a process without its children. [s]"""
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def measure_batch(server: Server, pool: ProcessPoolExecutor, count: int, seed: int) -> tuple[list[str], int]:
    """Run a new batch between two runs of the bare pool, then cached; return a row, and how many results differ."""
    cases = list(one_by_one(study_cases(count, seed)))
    requests = [to_request(case) for case in cases]
    angles, before = solve_bare(pool, cases)
    begin = cpu_seconds(server.pid)
    batch = run_batch(server, "/cra/batch", requests)
    middle = cpu_seconds(server.pid)
    _, after = solve_bare(pool, cases)
    cached = [run_batch(server, "/cra/batch", requests) for _ in range(CACHED_RUNS)]
    cpu = middle - begin, (cpu_seconds(server.pid) - middle) / CACHED_RUNS
    different = count_different(angles, batch.results)
    different += sum(again.results != batch.results for again in cached)
    bare, again = mean([before, after]), median([run.seconds for run in cached])
    row = [f"{count:,}", f"{count / bare:.0f}/s", f"{count / batch.seconds:.0f}/s", f"{bare / batch.seconds:.1%}"]
    row += [f"{1e3 * again / count:.3f} ms", " / ".join(f"{1e3 * each / count:.3f} ms" for each in cpu)]
    row += [str(batch.job["counts"]["failed"]), str(different)]
    return row, different


def measure_rates(server: Server, seconds: float) -> list[list[str]]:
    """Return rows with the median rates of a cached `/cra` and of an empty route, measured alternately."""
    [paper] = [to_request(case) for case in one_by_one(study_cases(1, 0))]
    known = raw_request("POST", "/cra", json.dumps(paper).encode())
    rows = []
    with empty_service() as empty:
        for connections in (1, 8):
            rates: dict[int, list[float]] = {server.port: [], empty.port: []}
            for _ in range(RATE_ROUNDS + 1):  # The first round only warms up and is not counted.
                for port, request in ((server.port, known), (empty.port, raw_request("GET", "/empty"))):
                    rate = requests_per_second(port, request, connections=connections, seconds=seconds)
                    rates[port].append(rate)
            hot, bare = median(rates[server.port][1:]), median(rates[empty.port][1:])
            rows.append([str(connections), f"{hot:,.0f}/s", f"{bare:,.0f}/s", f"{hot / bare:.0%}"])
    return rows


def poll(port: int, pipe: Connection) -> None:
    """Request `/livez` every `POLL_SECONDS`, until a message in the pipe is false.

    Each true message is answered with the response times since the one before. [s]
    """
    connection, times = HTTPConnection("127.0.0.1", port, timeout=60.0), list[float]()
    while True:
        begin = time.perf_counter()
        connection.request("GET", "/livez")
        connection.getresponse().read()
        times.append(time.perf_counter() - begin)
        if pipe.poll(POLL_SECONDS):
            if not pipe.recv():
                return
            pipe.send(times)
            times = []


@contextmanager
def polled(server: Server) -> Iterator[Connection]:
    """Poll `/livez` in another process during the block."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=poll, args=(server.port, there))
    process.start()
    try:
        yield here
    finally:
        here.send(False)
        process.join()


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure the overhead of HTTP compared with the bare solver.")
    parser.add_argument("--cases", type=int, nargs="+", default=[20_000, 2_000], help="sizes of the batches")
    parser.add_argument("--quick", action="store_true", help="compute one batch of 200 cases")
    options = parser.parse_args()
    print_machine()
    warm_up()
    rows, total = list[list[str]](), 0
    with process_pool(WORKERS) as pool, service(workers=str(WORKERS)) as server:
        with polled(server) as poller:
            measure_batch(server, pool, 10 * CHUNK, 1)  # This warms up the workers.
            for number, count in enumerate([200] if options.quick else options.cases, 2):
                poller.send(True)
                poller.recv()
                row, different = measure_batch(server, pool, count, number)
                poller.send(True)
                times = poller.recv()
                rows.append([*row, f"{1e3 * max(times):.0f} ms of {len(times):,}"])
                total += different
        rates = measure_rates(server, QUICK_RATE_SECONDS if options.quick else RATE_SECONDS)
    head = [
        "cases",
        "bare pool",
        "over HTTP",
        "share",
        "cached, a case",
        "server CPU, new / cached",
        "failed",
        "different",
        "slowest /livez",
    ]
    print_table(head, rows)
    print_table(["connections", "known /cra", "empty route", "share"], rates)
    return 1 if total else 0


if __name__ == "__main__":
    sys.exit(main())
