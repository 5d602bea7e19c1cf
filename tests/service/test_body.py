"""Bodies that come in a crowd are looked at one each time around the event loop."""

import asyncio
from types import SimpleNamespace

import pytest
from starlette.types import Message

from service.routes.body import JsonRequest
from service.settings import Settings

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]
CROWD = 50


async def test_others_have_their_turn_between_two_of_a_crowd() -> None:
    app = SimpleNamespace(state=SimpleNamespace(settings=Settings(), turn=asyncio.Lock()))
    rounds, looked_at = 0, list[int]()

    async def receive() -> Message:
        return {"type": "http.request", "body": b"{}", "more_body": False}

    async def count() -> None:
        nonlocal rounds
        while True:
            rounds += 1
            await asyncio.sleep(0)

    async def ask() -> None:
        request = JsonRequest({"type": "http", "headers": [], "app": app}, receive)
        assert await request.json() == {}
        looked_at.append(rounds)

    counting = asyncio.create_task(count())
    try:
        await asyncio.gather(*(ask() for _ in range(CROWD)))
    finally:
        counting.cancel()
    assert len(set(looked_at)) == CROWD
