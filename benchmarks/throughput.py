"""Many random strikes at once: threads of the solver against processes of the standard library.

Each size is measured over the same strikes: with sizes below `mix` several calls in a row go through the first `mix`
of them, so that a single easy or hard strike does not decide.
"""

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import Any, TypeAlias

from benchmarks.batches import answer_or_error, answers_or_errors
from benchmarks.random_cases import Case, Cases, one_by_one, random_cases, together
from benchmarks.timing import Timing, spread
from solver import RicochetError, warm_up

SEED = 1

Answered: TypeAlias = tuple[int, float]
"""Failures, and CPU seconds of other processes than this one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """What to measure."""

    counts: tuple[int, ...]
    mix: int
    """Strikes that every size goes through at least."""
    repetitions: int
    longest: float
    """A repetition that would take longer is left out, one that takes a twentieth of it is not repeated. [s]"""
    most_for_processes: int
    """Strikes; more are answered by threads alone."""


@dataclass(slots=True)
class Way:
    """Threads or processes, one or two of them, and what was seen for one size."""

    kind: str
    workers: int
    answer: Callable[[Cases], Answered]
    timings: list[Timing] = field(default_factory=list)
    """Of one strike."""
    failures: int = 0
    expected: float = 0.0
    """Of one strike, from the size before. [s]"""

    def repeat(self, batches: list[Cases]) -> None:
        """Answer every batch, one after the other."""
        count = sum(len(batch["velocity"]) for batch in batches)
        elsewhere, self.failures = 0.0, 0
        cpu, wall = time.process_time(), time.perf_counter()
        for batch in batches:
            failures, seconds = self.answer(batch)
            self.failures += failures
            elsewhere += seconds
        wall = time.perf_counter() - wall
        cpu = time.process_time() - cpu + elsewhere
        self.timings.append(Timing(cpu / count, wall / count))


def measure_throughput(sizes: Sizes) -> list[dict[str, Any]]:
    """One row for each size and way, by size."""
    rows: list[dict[str, Any]] = []
    with process_pool(1) as one, process_pool(2) as two:
        ways = [
            Way("threads", 1, partial(by_threads, threads=1)),
            Way("threads", 2, partial(by_threads, threads=2)),
            Way("processes", 1, partial(by_processes, pool=one, workers=1)),
            Way("processes", 2, partial(by_processes, pool=two, workers=2)),
        ]
        for count in sizes.counts:
            rows += _measure_size(count, sizes, ways)
    return rows


def _measure_size(count: int, sizes: Sizes, ways: list[Way]) -> list[dict[str, Any]]:
    total = max(count, sizes.mix)
    batches = list(in_batches(random_cases(total, SEED), count))
    if count > sizes.most_for_processes:
        ways = [way for way in ways if way.kind == "threads"]
    able = [way for way in ways if way.expected * total <= sizes.longest]
    for way in ways:
        way.timings = []
        if way not in able:
            print(f"throughput: {count} by {way.workers} {way.kind} left out, too long", file=sys.stderr)
    for repetition in range(sizes.repetitions):
        print(f"throughput: {count} strikes, repetition {repetition + 1}", file=sys.stderr)
        first = repetition % max(len(able), 1)
        for way in able[first:] + able[:first]:
            way.repeat(batches)
            way.expected = way.timings[-1].wall
        if any(way.expected * total > sizes.longest / 20.0 for way in able):
            break
    single = {way.kind: way for way in able if way.workers == 1}
    return [_row(count, way, single.get(way.kind)) for way in able]


def _row(count: int, way: Way, single: Way | None) -> dict[str, Any]:
    row: dict[str, Any] = {
        "cases": count,
        "kind": way.kind,
        "workers": way.workers,
        "wall_s_per_case": spread([timing.wall for timing in way.timings]),
        "cpu_s_per_case": spread([timing.cpu for timing in way.timings]),
        "cases_per_second": spread([1.0 / timing.wall for timing in way.timings]),
        "failures": way.failures,
    }
    if single is not None:
        pairs = zip(single.timings, way.timings, strict=True)
        row["times_one_worker"] = spread([one.wall / many.wall for one, many in pairs])
    return row


def in_batches(cases: Cases, size: int) -> Iterator[Cases]:
    """Cases in sets of `size`."""
    rows = one_by_one(cases)
    while batch := list(islice(rows, size)):
        yield together(iter(batch))


def by_threads(cases: Cases, *, threads: int) -> Answered:
    """Through the solver's own call for many."""
    answers = answers_or_errors(cases, threads=threads)
    return sum(isinstance(answer, RicochetError) for answer in answers), 0.0


def by_processes(cases: Cases, *, pool: ProcessPoolExecutor, workers: int) -> Answered:
    """Through a pool of processes, in pieces that keep each busy and are few."""
    rows = list(one_by_one(cases))
    piece = max(1, min(16, len(rows) // (4 * workers)))
    answers = list(pool.map(solve_one, rows, chunksize=piece))
    failures = sum(isinstance(answer, RicochetError) for answer, _ in answers)
    return failures, sum(seconds for _, seconds in answers)


def solve_one(case: Case) -> tuple[object, float]:
    """The answer, sent back whole, and the CPU seconds it took."""
    begin = time.process_time()
    answer = answer_or_error(case)
    return answer, time.process_time() - begin


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool whose processes have all started and are warm."""
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=warm_up) as pool:
        seen: set[int] = set()
        while len(seen) < workers:
            seen |= set(pool.map(_name_yourself, range(2 * workers)))
        yield pool


def _name_yourself(_: int) -> int:
    time.sleep(0.05)  # long enough for the others to take a share
    return os.getpid()
