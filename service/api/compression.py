"""Answers in the coding that a client accepts: zstd, gzip or none."""

from typing import TYPE_CHECKING

from anyio.to_thread import run_sync
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipResponder, IdentityResponder
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from zstandard import COMPRESSOBJ_FLUSH_BLOCK, COMPRESSOBJ_FLUSH_FINISH, ZstdCompressor

from service.api.negotiation import HDF5, PARQUET, coding_of

if TYPE_CHECKING:
    from zstandard import ZstdCompressionObj

LEAST_BYTES = 1024
"""Shortest answer that is compressed."""
THREAD_BYTES = 8 * 1024
"""Shortest answer that is compressed in a thread: a shorter one takes less time than the change of threads."""
LEVEL = 1
"""Effort of both: level 6 of gzip takes four times as long and saves 3 % more."""
EXCLUDED = (*DEFAULT_EXCLUDED_CONTENT_TYPES, HDF5, PARQUET)
"""Media types that are compressed already, and event streams."""


class CompressionMiddleware:
    """Compresses answers of 1 kB and more for clients that accept it.

    A strong ETag becomes a weak one: these bytes are others (RFC 9110, section 8.8.1).
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_weak(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                if "content-encoding" in headers and headers.get("etag", "").startswith('"'):
                    headers["etag"] = "W/" + headers["etag"]
                if "vary" in headers:  # Assets have it already, and the responder adds it once more.
                    headers["vary"] = ", ".join(dict.fromkeys(headers["vary"].split(", ")))
            await send(message)

        coding = coding_of(",".join(Headers(scope=scope).getlist("accept-encoding")))
        responder: IdentityResponder
        if coding == "gzip":
            responder = GZipResponder(
                self._app, LEAST_BYTES, LEVEL, thread_minimum_size=THREAD_BYTES, exclude_content_types=EXCLUDED
            )
        else:
            kind = ZstdResponder if coding == "zstd" else IdentityResponder
            responder = kind(self._app, LEAST_BYTES, exclude_content_types=EXCLUDED)
        await responder(scope, receive, send_weak)


class ZstdResponder(IdentityResponder):
    """Compresses an answer with zstd, as Starlette's responder does with gzip."""

    content_encoding = "zstd"
    _compressor: "ZstdCompressionObj | None" = None

    async def apply_compression(self, body: bytes, *, more_body: bool) -> bytes:
        """Return a part of the answer compressed, so that the client can read all of it at once."""
        compressor = self._compressor = self._compressor or ZstdCompressor(LEVEL).compressobj()
        mode = COMPRESSOBJ_FLUSH_BLOCK if more_body else COMPRESSOBJ_FLUSH_FINISH

        def compress() -> bytes:
            return compressor.compress(body) + compressor.flush(mode)

        return await run_sync(compress) if len(body) >= THREAD_BYTES else compress()
