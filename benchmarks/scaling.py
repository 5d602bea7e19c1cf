"""What a second core gives: two workers over one.

One, two and one worker go through the same strikes in turn, soon enough after one another that the machine's pace is
much the same. What is lost has two causes, and controls tell them apart.

- Workers may wait: fewer than two cores were busy then. At the end of a batch one may be at a hard strike of a fifth of
  a second, and the other has no more: there are so many strikes that this counts for little.
- The same work may take more CPU time on two cores than on one. Threads of one process could be in each other's way;
  processes that share nothing could not. Multiply-adds in the first-level cache share neither memory nor interpreter,
  but need all of their core; a short loop in registers needs hardly any of it.
"""

import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numba import njit

from benchmarks.random_cases import random_cases
from benchmarks.throughput import by_processes, by_threads, process_pool
from benchmarks.timing import Timing, spread

SEED = 21
PIECES = 100
"""Of the work in loops, handed out singly."""
PIECE_SECONDS = 0.02


def measure_scaling(*, strikes: int, turns: int) -> dict[str, Any]:
    """For threads, processes and the two loops, spreads over the turns.

    ``times_one``: wall time of one worker over that of two; ``cpu_ratio``: CPU time of two over that of one;
    ``busy``: CPU time of two over their wall time, the cores that were kept busy.
    """
    cases = random_cases(strikes, SEED)
    with process_pool(1) as one, process_pool(2) as two:
        ways: dict[str, Callable[[int], float]] = {
            "threads": lambda workers: by_threads(cases, threads=workers)[1],
            "processes": lambda workers: by_processes(cases, pool=one if workers == 1 else two, workers=workers)[1],
            "multiply_adds": _pieces(_multiply_adds),
            "registers": _pieces(_in_registers),
        }
        seen: dict[str, list[tuple[Timing, Timing, Timing]]] = {name: [] for name in ways}
        for turn in range(turns):
            print(f"scaling: turn {turn + 1} of {turns}", file=sys.stderr)
            for name, work in ways.items():
                seen[name].append((_time(work, 1), _time(work, 2), _time(work, 1)))
    found = {
        name: {
            "times_one": spread([0.5 * (before.wall + after.wall) / two.wall for before, two, after in rounds]),
            "cpu_ratio": spread([two.cpu / (0.5 * (before.cpu + after.cpu)) for before, two, after in rounds]),
            "busy": spread([two.cpu / two.wall for _, two, _ in rounds]),
        }
        for name, rounds in seen.items()
    }
    return {"strikes": strikes, **found}


def _time(work: Callable[[int], float], workers: int) -> Timing:
    """Of work that returns the CPU seconds of other processes."""
    cpu, wall = time.process_time(), time.perf_counter()
    elsewhere = work(workers)
    return Timing(time.process_time() - cpu + elsewhere, time.perf_counter() - wall)


def _pieces(loop: Callable[[int], float]) -> Callable[[int], float]:
    """Work in pieces of the same length, of a compiled loop with so many rounds."""
    loop(1)
    begin = time.perf_counter()
    loop(1_000_000)
    rounds = round(1_000_000 * PIECE_SECONDS / (time.perf_counter() - begin))

    def work(threads: int) -> float:
        with ThreadPoolExecutor(threads) as pool:
            wait([pool.submit(loop, rounds) for _ in range(PIECES)])
        return 0.0

    return work


@njit(nogil=True)
def _in_registers(rounds: int) -> float:
    a, b, c, d = 1.0, 1.1, 1.2, 1.3
    for _ in range(rounds):
        a, b, c, d = 0.9 * a + 0.1, 0.8 * b + 0.2, 0.7 * c + 0.3, 0.6 * d + 0.4
    return float(a + b + c + d)


@njit(nogil=True, fastmath=True)
def _multiply_adds(rounds: int) -> float:
    numbers = np.ones(512)
    for _ in range(rounds):
        for i in range(numbers.size):
            numbers[i] = 0.999 * numbers[i] + 0.001
    return float(numbers[0])
