"""`/livez` is answered quickly while the service is busy."""

import asyncio
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from service.schemas.strike import PAPER

from .many import ROUGH

POLLER = Path(__file__).with_name("liveness_poller.py")
QUERIES = 200
LIMIT_MS = 100.0


def query(number: int) -> tuple[str, dict[str, object]]:
    """Return path and body of a new query: a trajectory for odd numbers, a critical angle for even ones."""
    speed = {"velocity_m_s": 250.0 + 0.5 * number}
    if number % 2:
        strike = PAPER | {"impact": speed | {"oblique_angle_deg": 55.0}}
        return "/trajectory", strike | {"numerics": {"relative_tolerance": 1e-4}}
    return "/cra", PAPER | {"impact": speed, "search": ROUGH}


async def keep_busy(url: str) -> set[int]:
    async with httpx.AsyncClient(
        base_url=url, timeout=120.0, trust_env=False, limits=httpx.Limits(max_connections=QUERIES)
    ) as client:
        answers = await asyncio.gather(*(client.post(path, json=body) for path, body in map(query, range(QUERIES))))
    return {answer.status_code for answer in answers}


@pytest.mark.slow  # The time limit holds only on an otherwise idle machine.
@pytest.mark.timeout(180)
def test_liveness_answers_are_quick_while_two_hundred_queries_run(live_url: str) -> None:
    command = [sys.executable, str(POLLER), str(urlsplit(live_url).port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as poller:
        statuses = asyncio.run(keep_busy(live_url))
        output, _ = poller.communicate()
    assert poller.returncode == 0
    assert statuses == {200}
    count, slowest = map(float, output.split())
    assert count > 100
    assert slowest < LIMIT_MS
