"""CPU and wall time of a call, and pools of warm processes."""

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import NamedTuple

from solver import warm_up


class Timing(NamedTuple):
    """CPU time of the processes that do the work, with all their threads, and wall time. [s]"""

    cpu: float
    wall: float


def time_call(call: Callable[[], object], *, at_least: float = 0.05) -> Timing:
    """Return the time of a call, averaged over repeated calls that take at least `at_least` seconds in all."""
    calls = 0
    cpu, wall = time.process_time(), time.perf_counter()
    while True:
        call()
        calls += 1
        elapsed = time.perf_counter() - wall
        if elapsed >= at_least:
            return Timing((time.process_time() - cpu) / calls, elapsed / calls)


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Run a pool during the block, which begins when all processes have started and loaded the compiled code."""
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=warm_up) as pool:
        seen: set[int] = set()
        while len(seen) < workers:
            seen |= set(pool.map(_process_id, range(2 * workers)))
        yield pool


def _process_id(_: int) -> int:
    time.sleep(0.05)  # Meanwhile the other processes take the next calls.
    return os.getpid()
