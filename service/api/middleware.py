"""Middleware between the server and the routes that no setting turns off."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send


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
