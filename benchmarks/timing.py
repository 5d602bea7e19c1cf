"""CPU and wall time of calls, and what to say about many of them."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Timing:
    """Of one call. [s]"""

    cpu: float
    """Of every thread of the process that did the work."""
    wall: float


def time_call(call: Callable[[], object], *, at_least: float = 0.05) -> Timing:
    """Time of one call, averaged over as many in a row as fill `at_least` seconds."""
    calls = 0
    cpu, wall = time.process_time(), time.perf_counter()
    while True:
        call()
        calls += 1
        elapsed = time.perf_counter() - wall
        if elapsed >= at_least:
            return Timing((time.process_time() - cpu) / calls, elapsed / calls)


def spread(values: Sequence[float]) -> dict[str, Any]:
    """Median, extremes and number of repeated measurements."""
    return {"median": statistics.median(values), "lowest": min(values), "highest": max(values), "count": len(values)}


def summary(timings: Sequence[Timing]) -> dict[str, Any]:
    """Spread of the CPU and of the wall time of one call. [s]"""
    return {
        "cpu_s": spread([timing.cpu for timing in timings]),
        "wall_s": spread([timing.wall for timing in timings]),
    }
