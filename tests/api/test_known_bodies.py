"""Bodies that were answered just before are answered from memory, and as they would be otherwise."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Scope

from service.api.app import create_app
from service.api.body import KnownBodies
from service.schemas.strike import PAPER, PAPER_AT_45
from service.settings import Settings

from .many import searches

pytestmark = pytest.mark.anyio

JSON = {"Content-Type": "application/json"}


@pytest.fixture
async def app(tmp_path: Path) -> AsyncIterator[FastAPI]:
    app = create_app(Settings(data_dir=tmp_path / "data", workers=1, log_level="error"))
    async with app.router.lifespan_context(app):
        yield app


async def call(app: ASGIApp, path: str, body: bytes, headers: dict[str, str], *, parts: int = 1) -> tuple[int, Any]:
    """Ask the application as a server does; return the status, the headers and the body."""
    size = max(1, -(-len(body) // parts))
    pieces = [body[i : i + size] for i in range(0, len(body), size)] or [b""]
    messages = [
        {"type": "http.request", "body": piece, "more_body": number < len(pieces)}
        for number, piece in enumerate(pieces, 1)
    ]
    sent: list[Message] = []

    async def receive() -> Message:
        if not messages:
            await asyncio.Event().wait()  # the client stays
        return messages.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    named = {"content-length": str(len(body)), "host": "service"} | {n.lower(): v for n, v in headers.items()}
    scope: Scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": "POST" if body else "GET",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": b"",
        "headers": [(name.encode(), value.encode()) for name, value in named.items()],
        "server": ("service", 80),
        "client": ("client", 1),
    }
    await app(scope, receive, send)
    return sent[0]["status"], b"".join(message.get("body", b"") for message in sent[1:])


@pytest.mark.parametrize(("path", "body"), [("/cra", PAPER), ("/trajectory", PAPER_AT_45)])
async def test_known_body_is_answered_alike(app: FastAPI, path: str, body: dict[str, Any]) -> None:
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://service") as client:
        answers = [await client.post(path, content=orjson.dumps(body), headers=JSON) for _ in range(3)]
    assert [answer.headers["Cache-Status"] for answer in answers] == ["ricochet; fwd=miss", *["ricochet; hit"] * 2]
    assert len({answer.content for answer in answers}) == 1
    named = [answer.headers.keys() - {"x-request-id"} for answer in answers]
    assert named[0] == named[1] == named[2]


async def test_same_bytes_to_the_other_route_are_another_request(app: FastAPI) -> None:
    body = orjson.dumps(PAPER)
    assert (await call(app, "/cra", body, JSON))[0] == 200
    assert (await call(app, "/trajectory", body, JSON))[0] == 422
    assert (await call(app, "/cra", body, JSON))[0] == 200


async def test_known_body_of_another_type_is_refused_all_the_same(app: FastAPI) -> None:
    body = orjson.dumps(PAPER)
    assert (await call(app, "/cra", body, JSON))[0] == 200
    assert (await call(app, "/cra", body, {"Content-Type": "text/plain"}))[0] == 415
    assert (await call(app, "/cra", body, JSON | {"Content-Encoding": "gzip"}))[0] == 415


async def test_body_in_parts_is_put_together(app: FastAPI) -> None:
    body = orjson.dumps(PAPER)
    whole = await call(app, "/cra", body, JSON)
    assert await call(app, "/cra", body, JSON, parts=3) == whole
    assert await call(app, "/cra", body, JSON) == whole


async def test_memory_for_bodies_is_bounded(app: FastAPI) -> None:
    bodies = app.state.services.bodies = KnownBodies(40_000)
    for case in searches(20):
        assert (await call(app, "/cra", orjson.dumps(case), JSON))[0] == 200
    assert 1 < len(bodies) < 10
    assert bodies.currsize <= 5_000
