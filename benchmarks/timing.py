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
    """CPU time of all threads of the process that does the work, and wall time. [s]"""

    cpu: float
    wall: float


def time_call(call: Callable[[], object], *, at_least: float = 0.05) -> Timing:
    """Return the time of one call, averaged over as many calls as take `at_least` seconds."""
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
    """Run a pool during the block, after all its processes have started and loaded the compiled code."""
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=warm_up) as pool:
        seen: set[int] = set()
        while len(seen) < workers:
            seen |= set(pool.map(_process_id, range(2 * workers)))
        yield pool


def _process_id(_: int) -> int:
    time.sleep(0.05)  # The pause lets every other process take a call.
    return os.getpid()
