"""Of request bodies that arrive together, only one is parsed in each cycle of the event loop."""

import asyncio

import pytest

from service.api.body import next_turn

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]
CROWD = 50


async def test_other_tasks_run_between_two_bodies() -> None:
    parsing = asyncio.Lock()
    rounds, parsed = 0, list[int]()

    async def count() -> None:
        nonlocal rounds
        while True:
            rounds += 1
            await asyncio.sleep(0)

    async def parse() -> None:
        await next_turn(parsing)
        parsed.append(rounds)

    counting = asyncio.create_task(count())
    try:
        await asyncio.gather(*(parse() for _ in range(CROWD)))
    finally:
        counting.cancel()
    assert len(set(parsed)) == CROWD
