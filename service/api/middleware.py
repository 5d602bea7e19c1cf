"""Middleware between the server and the routes that no setting turns off."""

import asyncio
from contextlib import suppress
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

DRAIN_BYTES = 64 * 1024 * 1024
"""Most that is read of the body of a refused request: half a second of work."""
DRAIN_SECONDS = 5.0
"""Longest that such a body is read; a client that waits for the answer gets it then."""


class RefusalMiddleware:
    """Reads the rest of the body of a refused request before it is answered.

    Many clients read only once they have sent everything. A socket that is closed with data unread resets the
    connection, and the reset destroys the answer in the client's buffer. Beyond the bounds the answer is sent at once,
    and the connection is closed after it.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        length = int(headers.get("content-length", 0))
        # A client that waits for "100 Continue" has sent nothing, and receiving would request the body.
        waits = headers.get("expect", "").lower() == "100-continue"
        left = (length > 0 or "transfer-encoding" in headers) and not waits

        async def receive_some() -> Message:
            nonlocal left
            message = await receive()
            left = left and message.get("more_body", False)
            return message

        async def drain() -> None:
            taken = 0
            with suppress(TimeoutError):
                async with asyncio.timeout(DRAIN_SECONDS):
                    while left and taken <= DRAIN_BYTES:
                        taken += len((await receive_some()).get("body", b""))

        async def send_after_body(message: Message) -> None:
            if left and message["type"] == "http.response.start" and message["status"] >= HTTPStatus.BAD_REQUEST:
                if length <= DRAIN_BYTES:
                    await drain()
                if left:
                    MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, receive_some, send_after_body)


class HeadMiddleware:
    """Lets `HEAD` reach the routes of `GET`; the server sends the head of their answer alone."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        inner, sent = {**scope, "method": "GET"}, asyncio.Event()

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                scope["route"] = inner.get("route")
                await send(message)
            elif not sent.is_set():
                sent.set()
                await send({"type": "http.response.body", "body": b""})

        async def receive_until_sent() -> Message:
            await sent.wait()  # then a stream that would go on ends
            return {"type": "http.disconnect"}

        await self._app(inner, receive_until_sent, send_head)
