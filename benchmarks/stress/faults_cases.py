"""Cases for a service that is being hurt: cheap searches by the thousand, and slow ones."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

from service.schemas.examples import PAPER, PAPER_AT_45

ROUGH = {"lower_deg": 40.0, "upper_deg": 80.0, "tolerance_deg": 1.0}
"""A search that takes some milliseconds."""
STEP = 1e-3
"""Between the velocities of two cases. [m/s]"""
PIECES = 10


def searches(count: int, first: int = 0) -> list[dict[str, Any]]:
    """Cheap searches for the critical angle, the same for the same numbers."""
    return [
        PAPER | {"impact": {"velocity_m_s": 240.0 + STEP * number}, "search": ROUGH}
        for number in range(first, first + count)
    ]


def strikes(count: int, first: int = 0, *, slow: bool) -> list[dict[str, Any]]:
    """Trajectories of some milliseconds each or, slow, of about 2 s."""
    numerics = {"method": "panels"} | ({"panels": 100_000, "time_step_s": 5e-6} if slow else {"panels": 1000})
    return [
        PAPER_AT_45
        | {"impact": {"velocity_m_s": 240.0 + STEP * number, "oblique_angle_deg": 50.0}, "numerics": numerics}
        for number in range(first, first + count)
    ]


def lines(cases: Sequence[dict[str, Any]]) -> bytes:
    """A body of JSON lines."""
    return b"".join(json.dumps(case).encode() + b"\n" for case in cases)


def pieces(body: bytes) -> Iterator[bytes]:
    """A body in pieces, which are sent one after the other."""
    size = -(-len(body) // PIECES)
    for start in range(0, len(body), size):
        yield body[start : start + size]
