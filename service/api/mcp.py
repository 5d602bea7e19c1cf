"""Model Context Protocol over HTTP at `/mcp`: the tools of `ricochet mcp`, with the keys and limits of the routes."""

import asyncio
import gc
from collections.abc import Mapping
from dataclasses import replace
from http import HTTPStatus
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import orjson
from anyio.to_thread import run_sync
from fastapi import APIRouter, HTTPException, Request, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.body import BodyLimits, count_fields, next_turn, parse_json, read_body
from service.api.queries import resolve, validated
from service.api.services import services_of
from service.auth.dependencies import RUN
from service.errors import InvalidBodyError, ProblemType, ServiceError, case_problem
from service.operations import OPERATIONS

if TYPE_CHECKING:
    from mcp.server.streamable_http_manager import StreamableHTTPSessionManager

router = APIRouter(dependencies=[RUN], include_in_schema=False)
ENVELOPE_DEPTH = 5
"""Number of levels of nesting that a message adds around the request of a tool, with a margin of two or three."""


def is_installed() -> bool:
    """Return True if the MCP SDK (package `mcp`, an optional dependency) is installed."""
    return find_spec("mcp") is not None


class McpServer:
    """Stateless MCP server, which answers each message independently of earlier ones.

    It starts when the first message arrives, because its imports take a second and few services need them.

    Parameters
    ----------
    max_body_bytes
        Limit on the length of a message. [bytes]
    """

    def __init__(self, max_body_bytes: int) -> None:
        self._max_body_bytes = max_body_bytes
        self._starting = asyncio.Lock()
        self._stopping = asyncio.Event()
        self._manager: StreamableHTTPSessionManager | None = None
        self._running: asyncio.Task[None] | None = None

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one HTTP request. The first request starts the server."""
        async with self._starting:
            manager = self._manager or await self._start()
        await manager.handle_request(scope, receive, send)

    async def stop(self) -> None:
        """Stop the server, and wait until it has ended."""
        self._stopping.set()
        if self._running is not None:
            await self._running

    async def _start(self) -> "StreamableHTTPSessionManager":
        tools = await run_sync(import_module, "service.api.mcp_tools")
        managers = await run_sync(import_module, "mcp.server.streamable_http_manager")
        manager: StreamableHTTPSessionManager = managers.StreamableHTTPSessionManager(
            await run_sync(tools.server_of, compute),
            json_response=True,
            stateless=True,
            max_request_body_size=self._max_body_bytes,
        )
        started = asyncio.Event()

        async def run() -> None:
            async with manager.run():
                started.set()
                await self._stopping.wait()

        self._running = asyncio.create_task(run())
        await started.wait()
        # Freezing the objects of the SDK saves each full garbage collection tens of milliseconds of scanning them.
        gc.freeze()
        self._manager = manager
        return manager


class McpResponse(Response):
    """Response that passes a message to the MCP SDK, which sends the answer itself.

    Parameters
    ----------
    server
        ASGI application of the MCP SDK.
    message
        Body of the request, which has been read and checked already.
    """

    def __init__(self, server: ASGIApp, message: bytes) -> None:
        super().__init__()
        self._server = server
        self._message = message

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request to the SDK, and deliver the body again, since it has been read already."""
        given = False

        async def receive_message() -> Message:
            nonlocal given
            if given:
                return await receive()
            given = True
            return {"type": "http.request", "body": self._message, "more_body": False}

        await self._server(scope, receive_message, send)


@router.post("/mcp")
async def serve_mcp(request: Request) -> Response:
    """Answer a message of the Model Context Protocol (streamable HTTP)."""
    services = services_of(request)
    limits = BodyLimits.of_one(services.settings)
    message = await read_body(request, limits)
    await next_turn(services.parsing)
    parse_json(message, replace(limits, depth=limits.depth + ENVELOPE_DEPTH))
    return McpResponse(services.mcp, message)


async def compute(operation: str, content: Mapping[str, Any], request: Request) -> dict[str, Any]:
    """Return the answer to a tool call. The request is charged and counted like a request to a route.

    Raises
    ------
    ToolError
        If the request is refused or fails.
    """
    from service.api.mcp_tools import ToolError  # noqa: PLC0415 (an extra)

    try:
        found: dict[str, Any] = orjson.loads(await _answer(operation, content, request))
    except Exception as error:
        if isinstance(error, HTTPException):  # `unless_left` raises it when the client has left.
            raise ToolError(ProblemType.of_status(error.status_code).content(error.detail)) from error
        problem = case_problem(error)
        if isinstance(error, ServiceError) and error.status in {
            HTTPStatus.TOO_MANY_REQUESTS,
            HTTPStatus.SERVICE_UNAVAILABLE,
        }:
            problem["retry_after_s"] = error.retry_after
        raise ToolError(problem) from error
    return found


async def _answer(operation: str, content: Mapping[str, Any], request: Request) -> bytes:
    services = services_of(request)
    try:  # The limit was checked with the envelope included; the request alone must keep within the limit of its route.
        count_fields(content, services.settings.max_body_depth)
    except HTTPException:
        detail = f"may be nested {services.settings.max_body_depth} deep at most"
        raise InvalidBodyError([{"pointer": "", "detail": detail}]) from None
    found = OPERATIONS[operation]
    case = validated(content, found, services)
    most = services.settings.small_samples
    if found.study is not None and case.sampling.max_samples > most:
        detail = f"must be at most {most} here: send more to {found.path}, which makes a job"
        raise InvalidBodyError([{"pointer": "/sampling/max_samples", "detail": detail}])
    return (await resolve(request, found, case)).content
