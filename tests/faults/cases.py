"""Numbered cases: searches and trajectories that take milliseconds, and trajectories that take seconds."""

import json
import time
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from service.schemas.strike import PAPER, PAPER_AT_45

ROUGH = {"lower_deg": 40.0, "upper_deg": 80.0, "tolerance_deg": 1.0}
"""Search range and tolerance with which a search takes a few milliseconds."""
STEP_M_S = 1e-3
"""Difference in velocity between consecutive cases. [m/s]"""
LONG = pytest.param(50, marks=[pytest.mark.slow, pytest.mark.timeout(1200)])
"""Parameter of the slow variant of a test: 50 rounds, and more time."""
PIECES = 10
PIECE_PAUSE_SECONDS = 0.01


def searches(count: int, first: int = 0) -> list[dict[str, Any]]:
    """Return `count` searches for the critical angle, numbered from `first`."""
    return [
        PAPER | {"impact": {"velocity_m_s": 240.0 + STEP_M_S * number}, "search": ROUGH}
        for number in range(first, first + count)
    ]


def trajectories(count: int, first: int = 0, *, slow: bool) -> list[dict[str, Any]]:
    """Return `count` trajectories that take a few milliseconds each, or about 10 s if `slow`."""
    numerics = {"method": "panels"} | ({"panels": 100_000, "time_step_s": 1e-6} if slow else {"panels": 1000})
    return [
        PAPER_AT_45
        | {"impact": {"velocity_m_s": 240.0 + STEP_M_S * number, "oblique_angle_deg": 50.0}, "numerics": numerics}
        for number in range(first, first + count)
    ]


def jsonl(cases: Sequence[dict[str, Any]]) -> bytes:
    return b"".join(json.dumps(case).encode() + b"\n" for case in cases)


def slowly(body: bytes) -> Iterator[bytes]:
    """Yield a body in pieces with pauses, as over a slow connection."""
    size = -(-len(body) // PIECES)
    for start in range(0, len(body), size):
        yield body[start : start + size]
        time.sleep(PIECE_PAUSE_SECONDS)
