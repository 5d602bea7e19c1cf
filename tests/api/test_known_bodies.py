"""Bodies that were answered just before are answered from memory, and as they would be otherwise."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from fastapi import FastAPI

from service.api.app import create_app
from service.api.body import KnownBodies
from service.schemas.strike import PAPER, PAPER_AT_45
from service.settings import Settings

from .many import searches
from .refused import TEXT

pytestmark = pytest.mark.anyio

BODY = orjson.dumps(PAPER)


@pytest.fixture
async def app(tmp_path: Path) -> AsyncIterator[FastAPI]:
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1, log_level="error"))
    async with app.router.lifespan_context(app):
        yield app


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://service", headers=TEXT) as client:
        yield client


async def in_parts(body: bytes, size: int) -> AsyncIterator[bytes]:
    for start in range(0, len(body), size):
        yield body[start : start + size]


@pytest.mark.parametrize(("path", "body"), [("/cra", PAPER), ("/trajectory", PAPER_AT_45)])
async def test_known_body_is_answered_alike(client: httpx.AsyncClient, path: str, body: dict[str, Any]) -> None:
    answers = [await client.post(path, content=orjson.dumps(body)) for _ in range(3)]
    assert [answer.headers["Cache-Status"] for answer in answers] == ["ricochet; fwd=miss", *["ricochet; hit"] * 2]
    assert len({answer.content for answer in answers}) == 1
    named = [answer.headers.keys() - {"x-request-id"} for answer in answers]
    assert named[0] == named[1] == named[2]


async def test_same_bytes_to_the_other_route_are_another_request(client: httpx.AsyncClient) -> None:
    for path, status in (("/cra", 200), ("/trajectory", 422), ("/cra", 200)):
        assert (await client.post(path, content=BODY)).status_code == status


async def test_known_body_of_another_type_is_refused_all_the_same(client: httpx.AsyncClient) -> None:
    for headers, status in ((TEXT, 200), ({"Content-Type": "text/plain"}, 415), ({"Content-Encoding": "gzip"}, 415)):
        assert (await client.post("/cra", content=BODY, headers=headers)).status_code == status


async def test_body_in_parts_is_put_together(client: httpx.AsyncClient) -> None:
    whole = await client.post("/cra", content=BODY)
    length = {"Content-Length": str(len(BODY))}
    parts = await client.post("/cra", content=in_parts(BODY, len(BODY) // 3), headers=length)
    again = await client.post("/cra", content=BODY)
    assert [each.status_code for each in (whole, parts, again)] == [200] * 3
    assert whole.content == parts.content == again.content


async def test_memory_for_bodies_is_bounded(app: FastAPI, client: httpx.AsyncClient) -> None:
    bodies = app.state.services.bodies = KnownBodies(40_000)
    for case in searches(20):
        assert (await client.post("/cra", content=orjson.dumps(case))).status_code == 200
    assert 1 < len(bodies) < 10
    assert bodies.currsize <= 5_000
