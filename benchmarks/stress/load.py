"""The service under load: a large batch against a bare pool, what others notice of it, and hot answers.

The cases are those of a study of one projectile. They take about as long as the paper's, a third of what random ones
do, so that the service's own share of the time counts for more.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

import numpy as np
import orjson

from benchmarks.random_cases import study_cases
from benchmarks.stress.bodies import to_arguments, to_lines, to_requests
from benchmarks.stress.clients import Batch, requests_per_second, run_batch, to_request
from benchmarks.stress.lines import Line
from benchmarks.stress.servers import ROOT, WORKERS, Server, empty_service, memory_of, service
from benchmarks.throughput import process_pool
from service.schemas.examples import PAPER
from service.schemas.quantities import degrees
from solver import RicochetError, critical_angle

CHUNK = 25
"""Cases handed to a process of the bare pool at once."""
SHARE = 0.8
"""Of the throughput of the bare pool."""
TIMES_FASTER = 20.0
"""A batch that is cached than one that is not."""
TRAJECTORY_SECONDS = 0.5
LIVEZ_SECONDS = 0.05
GROWTH_MB = 200.0
MOST_SAMPLES = 200
HOT_SHARE = 0.5
"""Of the requests an empty route answers."""
HOT_SECONDS = 2.0
HOT_ROUNDS = 3
CONNECTIONS = (1, 8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """How much to measure.

    Parameters
    ----------
    cases
        Of the batch that is compared with the bare pool.
    polled_cases, copies
        Different ones of the batch during which the server is asked other things, and how often each is in it: large
        batches show what memory is taken, whether they are computed or not.
    rounds
        Of bare pool and batch, in turn, each with cases of its own.
    """

    cases: int
    polled_cases: int
    copies: int
    rounds: int

    @property
    def largest(self) -> int:
        """Cases of the largest batch."""
        return max(self.cases, self.polled_cases * self.copies)


QUICK = Sizes(cases=200, polled_cases=100, copies=20, rounds=1)
USUAL = Sizes(cases=6_000, polled_cases=6_000, copies=10, rounds=1)
FULL = Sizes(cases=20_000, polled_cases=20_000, copies=5, rounds=1)


def measure_load(sizes: Sizes) -> list[Line]:
    """Lines 1 to 3."""
    lines: list[Line] = []
    with service() as server:
        with memory_of(server) as memory:
            with process_pool(WORKERS) as pool:
                lines += _throughput(server, pool, sizes)
            lines += _others(server, sizes)
        lines.append(_growth(memory, sizes))
        with empty_service() as empty:
            lines += _hot(server, empty)
    return lines


def _throughput(server: Server, pool: ProcessPoolExecutor, sizes: Sizes) -> list[Line]:
    solve_bare(pool, to_requests(study_cases(10 * CHUNK, 0)))
    run_batch(server, "/cra/batch", to_lines(to_requests(study_cases(10 * CHUNK, 0))))
    bare, batches, again = list[float](), list[Batch](), list[Batch]()
    different, failed, computed = 0, 0, 0
    for turn in range(sizes.rounds):
        requests = to_requests(study_cases(sizes.cases, 10 + turn))
        _tell(f"{sizes.cases:,} cases through the bare pool, the service, and the bare pool again")
        angles, seconds = solve_bare(pool, requests)
        bare.append(seconds)
        batches.append(run_batch(server, "/cra/batch", to_lines(requests)))
        bare.append(solve_bare(pool, requests)[1])
        found = [angle_of(line) for line in batches[-1].results]
        different += sum(here != there for here, there in zip(found, angles, strict=True))
        solved = [request for request, line in zip(requests, batches[-1].results, strict=True) if has_result(line)]
        failed += len(requests) - len(solved)  # a failure is not kept, and would be computed again
        again += [run_batch(server, "/cra/batch", to_lines(solved)) for _ in range(3)]
        angles = [angle for angle, line in zip(found, batches[-1].results, strict=True) if has_result(line)]
        different += sum([angle_of(line) for line in batch.results] != angles for batch in again[-3:])
        computed += sum(batch.job["counts"]["total"] - batch.job["counts"]["cached"] for batch in again[-3:])
    pool_rate = sizes.cases / mean(bare)
    rate = sizes.cases / mean(batch.seconds for batch in batches)
    cached = median(len(batch.results) / batch.seconds for batch in again)
    details = {
        "cases": sizes.cases,
        "failed": failed,
        "bare_pool_s": bare,
        "batch_s": [_times(batch) for batch in batches],
        "cached_batch_s": [_times(batch) for batch in again],
    }
    return [
        Line(
            number=1,
            what=f"{sizes.cases:,} different `/cra` cases over HTTP, {WORKERS} workers",
            required=f"at least {SHARE:.0%} of the throughput of the bare pool",
            measured=f"{rate / pool_rate:.1%} ({rate:.0f} of {pool_rate:.0f} cases/s)",
            held=rate >= SHARE * pool_rate,
            details=details,
        ),
        Line(
            number=1,
            what="the same batch again, cached",
            required=f"at least {TIMES_FASTER:.0f} times faster",
            measured=f"{cached / rate:.1f} times ({1e3 / cached:.3f} ms a case)",
            held=cached >= TIMES_FASTER * rate and not computed,
            details={"computed": computed},
        ),
        Line(
            number=1,
            what="answers of the batch, the cached batch and the bare pool",
            required="the same to the last bit",
            measured="all the same" if not different else f"{different} differ",
            held=not different,
        ),
    ]


def _others(server: Server, sizes: Sizes) -> list[Line]:
    requests = sizes.copies * to_lines(to_requests(study_cases(sizes.polled_cases, 30)))
    batched = f"during a batch of {sizes.polled_cases * sizes.copies:,} cases, {sizes.polled_cases:,} different"
    _tell(f"the server asked other things {batched}")
    with polled(server, "livez") as livez, polled(server, "trajectory") as runs:
        batch = run_batch(server, "/cra/batch", requests, keep=False)
    lively, run = (np.array(found["seconds"]) for found in (livez, runs))
    running = np.array(livez["running_seconds"])
    return [
        Line(
            number=2,
            what=f"`/trajectory`, 5 a second, {batched}",
            required=f"95th percentile below {TRAJECTORY_SECONDS:g} s",
            measured=_quantiles(run, 50, 95),
            held=bool(np.percentile(run, 95) < TRAJECTORY_SECONDS),
            details={"seconds": _spread(run), "batch_s": _times(batch)},
        ),
        Line(
            number=2,
            what=f"`/livez`, 100 a second, {batched}",
            required=f"never above {LIVEZ_SECONDS * 1e3:g} ms",
            measured=f"{_quantiles(lively, 50, 99)}; max {running.max() * 1e3:.1f} ms but for waits for a free core",
            held=bool(lively.max() < LIVEZ_SECONDS),
            details={"seconds": _spread(lively), "running_seconds": _spread(running)},
        ),
    ]


def _growth(memory: list[int], sizes: Sizes) -> Line:
    growth = (max(memory) - memory[0]) / 1e6
    return Line(
        number=2,
        what=f"memory of the server over all batches, the largest of {sizes.largest:,} cases",
        required=f"grows by less than {GROWTH_MB:g} MB",
        measured=f"{growth:.0f} MB (from {memory[0] / 1e6:.0f} after the start)",
        held=growth < GROWTH_MB,
        details={"bytes": memory[:: max(1, len(memory) // MOST_SAMPLES)]},
    )


def _hot(server: Server, empty: Server) -> list[Line]:
    _tell("hot answers against an empty route")
    asked = to_request("POST", "/cra", json.dumps(PAPER).encode())
    nothing = to_request("GET", "/empty")
    requests_per_second(server, asked, connections=1, seconds=1.0)
    requests_per_second(empty, nothing, connections=1, seconds=1.0)
    lines = []
    for connections in CONNECTIONS:
        hot, bare = list[float](), list[float]()
        for _ in range(HOT_ROUNDS):
            bare.append(requests_per_second(empty, nothing, connections=connections, seconds=HOT_SECONDS))
            hot.append(requests_per_second(server, asked, connections=connections, seconds=HOT_SECONDS))
        share = median(hot) / median(bare)
        lines.append(
            Line(
                number=3,
                what=f"hot `/cra`, {connections} connection{'s' if connections > 1 else ''}",
                required=f"at least {HOT_SHARE:.0%} of the requests of an empty FastAPI route",
                measured=f"{share:.0%} ({median(hot):,.0f} of {median(bare):,.0f} requests/s)",
                held=share >= HOT_SHARE,
                details={"hot": hot, "empty": bare},
            )
        )
    return lines


@contextmanager
def polled(server: Server, kind: str) -> Iterator[dict[str, list[float]]]:
    """Ask the server all the time; what came of it is there behind the block."""
    found: dict[str, list[float]] = {}
    command = [sys.executable, "-m", "benchmarks.stress.poller", kind, str(server.port), str(server.pid)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield found
        output, _ = process.communicate("", timeout=60.0)
    if process.returncode:
        raise RuntimeError(f"the poller of {kind} failed")
    found |= json.loads(output)


def solve_bare(pool: ProcessPoolExecutor, requests: Sequence[dict[str, Any]]) -> tuple[list[float | None], float]:
    """Angles in degrees, and the seconds it took a pool without anything around it."""
    calls = [to_arguments(request) for request in requests]
    begin = time.perf_counter()
    answers = list(pool.map(solve, calls, chunksize=CHUNK))
    seconds = time.perf_counter() - begin
    angles = [None if isinstance(answer, RicochetError) else answer.angle for answer in answers]
    return [None if angle is None else degrees(angle) for angle in angles], seconds


def solve(arguments: dict[str, Any]) -> Any:
    """The answer, sent back whole, or why there is none."""
    try:
        return critical_angle(**arguments)
    except RicochetError as error:
        return error


def angle_of(line: bytes) -> float | None:
    """Critical angle of a result of a batch, if it has one."""
    angle: float | None = orjson.loads(line).get("result", {}).get("critical_angle_deg")
    return angle


def has_result(line: bytes) -> bool:
    """Tell whether a case of a batch has been solved."""
    return "result" in orjson.loads(line)


def _times(batch: Batch) -> dict[str, float]:
    return {"accepted": batch.accepted, "done": batch.done, "read": batch.seconds}


def _spread(seconds: Any) -> dict[str, float]:
    names = {"p50": 50, "p95": 95, "p99": 99, "p99.9": 99.9, "max": 100}
    return {"count": len(seconds)} | {name: float(np.percentile(seconds, part)) for name, part in names.items()}


def _quantiles(seconds: Any, *parts: int) -> str:
    told = [f"p{part} {np.percentile(seconds, part) * 1e3:.1f}" for part in parts]
    return f"{', '.join(told)}, max {seconds.max() * 1e3:.1f} ms of {len(seconds):,}"


def _tell(what: str) -> None:
    print(f"load: {what}", file=sys.stderr)
