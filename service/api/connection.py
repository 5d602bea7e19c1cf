"""A connection, as the server has it, with limits on what a client holds by being slow.

The server's own protocol has none: a head may grow without end, or never; an answer may never be read. The server looks
at every connection once a second, which costs a request nothing.

An answer that does not wait for the body of its request has to survive the rest of that body. A socket that is closed
with data unread resets the connection, and the reset destroys the answer in the client's buffer. Such a connection is
closed for writing only, what still arrives is read and discarded, and the socket is closed when the body or the client
has ended, or a bound is reached. A connection that is kept alive discards within the same bounds.

`BodyTimeoutMiddleware` relies on what this server does with a request, and is here too.
"""

import asyncio
from http import HTTPStatus
from typing import Any

import orjson
from fastapi import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn._types import ASGI3Application
from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol, RequestResponseCycle
from uvicorn.server import ServerState

from service.auth.middleware import secured
from service.errors import ProblemType
from service.settings import LimitSettings

CYCLE = "ricochet.cycle"
"""Key in the scope of a request: the server's state of it, such as whether there is more of its body."""
OVERFLOW = 1.1
"""Connections that may be open while one beyond the limit is refused in full, as a multiple of the limit."""


class HeadTooLongError(Exception):
    """The head of a request is longer than it may be."""


class ResponseTransport:
    """The transport as the request that is answered uses it: closing it discards the rest of the request first.

    Parameters
    ----------
    connection
        Closes, and knows whether it has begun to.
    transport
        Writes.
    """

    __slots__ = ("close", "is_closing", "write")

    def __init__(self, connection: "Connection", transport: asyncio.Transport) -> None:
        self.close = connection.close_gracefully
        self.is_closing = connection.is_closing
        self.write = transport.write


class Connection(HttpToolsProtocol):
    """The server's protocol, with limits; the application it serves has them in its settings."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._limits: LimitSettings = config.app.state.services.settings  # type: ignore[union-attr] # it is the FastAPI application
        self._waiting: float | None = None
        """Since when a head is waited for."""
        self._in_head = False
        self._head_bytes = 0
        """Bytes of the head, without the piece that is being read."""
        self._piece_bytes = 0
        self._unread: tuple[float, int] | None = None
        """Since when the client has been looked at as it reads, and what it had not read then."""
        self._refusal = HTTPStatus.BAD_REQUEST
        self._answered: RequestResponseCycle | None = None
        self._responding: ResponseTransport
        self._discarding: asyncio.TimerHandle | None = None
        """Ends the connection if the rest of a request that has been answered takes too long."""
        self._discarded_bytes = 0
        self._lingering = False
        """Whether everything has been sent, and the connection ends with the request."""
        self._unparsable = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin."""
        super().connection_made(transport)
        self._responding = ResponseTransport(self, transport)
        self._waiting = self.loop.time()
        if len(self.connections) > self._limits.max_connections:
            self._refusal = HTTPStatus.SERVICE_UNAVAILABLE
            self.send_400_response("too many connections are open")
            if len(self.connections) > OVERFLOW * self._limits.max_connections:
                transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the requests of the connection."""
        self._abandon_requests()
        self._stop_discarding()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has arrived."""
        if self.transport.is_closing():
            return
        if self._discarding is not None:
            self._discarded_bytes += len(data)
            if self._discarded_bytes > self._limits.max_discarded_bytes:
                self._stop_reading()
                return
            if self._unparsable:
                return
        self._piece_bytes = len(data)
        super().data_received(data)
        if self._in_head:
            self._head_bytes += len(data)
            if self._head_bytes > self._limits.max_head_bytes and not self.is_closing():
                self._refusal = HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
                self.send_400_response("")

    def on_message_begin(self) -> None:
        """Begin a request."""
        super().on_message_begin()
        self._in_head, self._head_bytes = True, 0

    def on_headers_complete(self) -> None:
        """Begin to answer."""
        if self.is_closing():  # the request before was the last one
            return
        limits = self._limits
        if len(self.headers) > limits.max_head_fields or (
            self._head_bytes + self._piece_bytes > limits.max_head_bytes and self._length() > limits.max_head_bytes
        ):
            self._refusal = HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
            raise HeadTooLongError  # the parser gives up, and the server refuses
        self._waiting, self._in_head = None, False
        super().on_headers_complete()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: ASGI3Application) -> None:
        self._answered = cycle
        cycle.scope[CYCLE] = cycle  # type: ignore[literal-required] # its keys are those of the server
        cycle.transport = self._responding  # type: ignore[assignment] # as much of a transport as it uses
        super()._start_asgi_task(cycle, app)

    def on_message_complete(self) -> None:
        """Note that a request has arrived whole."""
        if self._discarding is not None:
            self._stop_discarding()
            self._waiting = self.loop.time()
            if self._lingering:
                self.transport.close()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the next request, or for the end of this one."""
        if self._lingering:
            self.server_state.total_requests += 1
            return
        if self.cycle is self._answered and self.cycle.more_body:
            self._discard()
        elif not self.pipeline:
            self._waiting = self.loop.time()
        super().on_response_complete()

    def is_closing(self) -> bool:
        """Whether nothing more is sent."""
        return self._lingering or self.transport.is_closing()

    def close_gracefully(self) -> None:
        """Close the connection once the rest of the request has arrived, which is not looked at."""
        if self.transport.is_closing():
            return
        if self.cycle is not self._answered or self.cycle.more_body:
            self._linger()
        else:
            self.transport.close()

    def shutdown(self) -> None:
        """Answer what there is, and end the connection."""
        if self._discarding is None:
            super().shutdown()
        elif not self._lingering:
            self._linger()

    def _linger(self) -> None:
        """Send nothing more, and end the connection when the client does, or as soon as a bound is reached."""
        self._lingering, self._waiting = True, None
        self._abandon_requests()
        self._unset_keepalive_if_required()
        if self.transport.can_write_eof():  # not with TLS, where the length of the answer has to do
            self.transport.write_eof()
        self._discard()
        self.flow.resume_reading()

    def _discard(self) -> None:
        self._stop_discarding()
        self._discarded_bytes = 0
        self._discarding = self.loop.call_later(self._limits.discard_seconds, self._stop_reading)

    def _stop_reading(self) -> None:
        """End the connection though the client still sends."""
        if self.transport.get_write_buffer_size():
            self.transport.close()
        else:  # with TLS, closing would go on reading for half a minute
            self.transport.abort()

    def _stop_discarding(self) -> None:
        if self._discarding is not None:
            self._discarding.cancel()
            self._discarding = None

    def _abandon_requests(self) -> None:
        """End what is being answered; with several requests in a row it is not the one the server knows of."""
        self.pipeline.clear()
        for cycle in (self._answered, self.cycle):
            if cycle is not None and not cycle.response_complete:
                cycle.disconnected = True
                cycle.message_event.set()

    def resume_writing(self) -> None:
        """Go on sending: the client has read."""
        self._unread = None
        super().resume_writing()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no request as every other is refused: with a problem."""
        status, limits = self._refusal, self._limits
        detail = {
            HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE: "the head of a request may have "
            f"{limits.max_head_fields} fields and {limits.max_head_bytes:,} bytes",
            HTTPStatus.REQUEST_TIMEOUT: "the head of the request comes too slowly",
        }.get(status, msg)
        body = orjson.dumps({**ProblemType.of_status(status).content(detail), "instance": ""})
        headers = [
            (b"content-type", b"application/problem+json"),
            (b"content-length", b"%d" % len(body)),
            (b"connection", b"close"),
        ]
        if status is HTTPStatus.SERVICE_UNAVAILABLE:
            headers.append((b"retry-after", b"5"))
        head = [b"%b: %b\r\n" % pair for pair in secured(headers, tls=self.config.is_ssl)]
        self.transport.write(b"".join([STATUS_LINE[status], *head, b"\r\n", body]))
        self._unparsable = True
        self._linger()

    def look(self, now: float) -> None:
        """End the connection if its client is too slow."""
        closing = self.transport.is_closing()
        if self._waiting is not None and not closing and now - self._waiting > self._limits.head_seconds:
            if self._in_head:
                self._refusal = HTTPStatus.REQUEST_TIMEOUT
                self.send_400_response("")
            else:
                self.transport.close()
        elif closing or self.flow.write_paused:
            self._look_at_reader(now)

    def _look_at_reader(self, now: float) -> None:
        left = self.transport.get_write_buffer_size()
        if self._unread is None:
            self._unread = now, left
            return
        since, before = self._unread
        if now - since < self._limits.send_seconds:
            return
        if before - left < (now - since) * self._limits.slowest_bytes_per_second:
            self.transport.abort()
        self._unread = now, left

    def _length(self) -> int:
        return len(self.url) + sum(len(name) + len(value) + 4 for name, value in self.headers)


class BodyTimeout:
    """Receives a request as long as its body comes fast enough; only time spent waiting for it counts.

    Parameters
    ----------
    receive
        The server's.
    seconds
        Time to wait in all, beside what the body takes at the slowest rate. [s]
    slowest
        Rate. [bytes/s]
    """

    __slots__ = ("_left", "_receive", "_slowest", "_whole")

    def __init__(self, receive: Receive, seconds: float, slowest: float) -> None:
        self._receive = receive
        self._left = seconds
        self._slowest = slowest
        self._whole = False

    async def __call__(self) -> Message:
        """Receive the next message.

        Raises
        ------
        HTTPException
            408 if it comes too late.
        """
        if self._whole:
            return await self._receive()
        now = asyncio.get_running_loop().time
        begun = now()
        try:
            async with asyncio.timeout(self._left):
                message = await self._receive()
        except TimeoutError:
            raise HTTPException(
                HTTPStatus.REQUEST_TIMEOUT, "the body comes too slowly", headers={"Connection": "close"}
            ) from None
        self._left += len(message.get("body", b"")) / self._slowest - (now() - begun)
        self._whole = not message.get("more_body", False)
        return message


class BodyTimeoutMiddleware:
    """Middleware that gives up bodies that come too slowly."""

    def __init__(self, app: ASGIApp, limits: LimitSettings) -> None:
        self._app = app
        self._limits = limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        cycle = scope.pop(CYCLE, None)
        if scope["type"] == "http" and (cycle is None or cycle.more_body):  # else nothing is waited for
            receive = BodyTimeout(receive, self._limits.body_seconds, self._limits.slowest_bytes_per_second)
        await self._app(scope, receive, send)
