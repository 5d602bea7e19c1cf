"""Gain from a second core: ratio of the rates at which two workers and one worker compute random strikes.

    python benchmarks/scaling.py [--quick] [--cases 1000] [--turns 5]

Each turn computes the same strikes with one worker, then with two, and with one again, so that a drift in the speed
of the machine cancels. The workers are threads of `critical_angle_many`, or processes. A gain below two can have two
causes:

- A worker waits, so fewer than two cores are busy. Near the end of a batch one worker may compute a hard strike for a
  fifth of a second while the other has none left. With many strikes this matters little.
- The same work takes more CPU time on two cores than on one.

Two loops in threads, measured in the same way, show how much of the second cause is due to the machine, because their
threads share neither memory nor the interpreter. One loop multiplies and adds numbers in the first-level cache, and
keeps the arithmetic units of its core busy. The other is a short chain of operations in registers, which leaves most of
them idle.

A turn takes about 25 s for 1,000 cases; `--quick` computes 20 cases in a single turn.
"""

import argparse
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, wait
from functools import partial

import numpy as np
from numba import njit

from benchmarks.machine import print_machine, print_table, spread, time_spread
from benchmarks.random_cases import Case, Cases, answer_or_error, one_by_one, random_cases
from benchmarks.timing import Timing, process_pool
from solver import critical_angle_many, warm_up

SEED = 21
PIECES = 100
"""Number of calls into which the work of a loop is divided; threads take them one by one."""
PIECE_SECONDS = 0.02
"""Approximate duration of one of these calls. [s]"""

Work = Callable[[int], float]
"""Function that does the work with a number of workers, and returns the CPU time of other processes. [s]"""


def in_threads(cases: Cases, workers: int) -> float:
    """Compute the cases in threads of the solver; the time returned is 0, because no other process works."""
    deque(critical_angle_many(**cases, threads=workers), maxlen=0)
    return 0.0


def in_processes(cases: list[Case], pools: dict[int, ProcessPoolExecutor], workers: int) -> float:
    """Compute the cases in processes, in pieces small enough to keep each of them busy."""
    piece = max(1, min(16, len(cases) // (4 * workers)))
    return sum(pools[workers].map(cpu_time_of, cases, chunksize=piece))


def cpu_time_of(case: Case) -> float:
    """Compute a case; return its CPU time. [s]"""
    begin = time.process_time()
    answer_or_error(case)
    return time.process_time() - begin


def in_loops(loop: Callable[[int], float]) -> Work:
    """Return a function that runs a compiled loop in pieces of `PIECE_SECONDS` in threads."""
    loop(1)
    begin = time.perf_counter()
    loop(1_000_000)
    rounds = round(1_000_000 * PIECE_SECONDS / (time.perf_counter() - begin))

    def work(workers: int) -> float:
        with ThreadPoolExecutor(workers) as pool:
            wait([pool.submit(loop, rounds) for _ in range(PIECES)])
        return 0.0

    return work


@njit(nogil=True)
def registers(rounds: int) -> float:
    """Run a short chain of operations on four numbers in registers."""
    a, b, c, d = 1.0, 1.1, 1.2, 1.3
    for _ in range(rounds):
        a, b, c, d = 0.9 * a + 0.1, 0.8 * b + 0.2, 0.7 * c + 0.3, 0.6 * d + 0.4
    return float(a + b + c + d)


@njit(nogil=True, fastmath=True)
def multiply_adds(rounds: int) -> float:
    """Multiply and add numbers in 4 kB of memory."""
    numbers = np.ones(512)
    for _ in range(rounds):
        for i in range(numbers.size):
            numbers[i] = 0.999 * numbers[i] + 0.001
    return float(numbers[0])


def measure(work: Work, workers: int) -> Timing:
    """Do the work; return the CPU time of all processes, and the wall time. [s]"""
    cpu, wall = time.process_time(), time.perf_counter()
    elsewhere = work(workers)
    return Timing(time.process_time() - cpu + elsewhere, time.perf_counter() - wall)


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare two workers with one.")
    parser.add_argument("--quick", action="store_true", help="compute 20 cases in one turn")
    parser.add_argument("--cases", type=int, default=1_000)
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args()
    count, turns = (20, 1) if options.quick else (options.cases, options.turns)
    print_machine()
    warm_up()
    cases = random_cases(count, SEED)
    with process_pool(1) as single, process_pool(2) as pair:
        works: dict[str, Work] = {
            "threads": partial(in_threads, cases),
            "processes": partial(in_processes, list(one_by_one(cases)), {1: single, 2: pair}),
            "multiply-adds in the first-level cache": in_loops(multiply_adds),
            "a short loop in registers": in_loops(registers),
        }
        seen = {
            name: [(measure(work, 1), measure(work, 2), measure(work, 1)) for _ in range(turns)]
            for name, work in works.items()
        }
    one, two = ([count / round_[index].wall for round_ in seen["threads"]] for index in (0, 1))
    print(f"searches a second, random strikes: {spread(one)} on one thread, {spread(two)} on two\n")
    rows = []
    for name, rounds in seen.items():
        gain = [0.5 * (before.wall + after.wall) / both.wall for before, both, after in rounds]
        cost = [both.cpu / (0.5 * (before.cpu + after.cpu)) for before, both, after in rounds]
        busy = [both.cpu / both.wall for _, both, _ in rounds]
        units = count if name in {"threads", "processes"} else PIECES
        walls = [time_spread([round_[index].wall / units for round_ in rounds]) for index in (0, 1)]
        rows.append([name, *walls, spread(gain), spread(cost), spread(busy)])
    head = [f"{count:,} random strikes, or {PIECES} pieces", "a piece, one worker", "two workers"]
    print_table([*head, "times as fast", "CPU time of two over one", "cores busy"], rows)


if __name__ == "__main__":
    main()
