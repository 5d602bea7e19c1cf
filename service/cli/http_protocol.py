"""HTTP/1.1 by uvicorn and httptools, with two changes: upgrades are ignored, and the size of heads is limited.

Uvicorn's other parser, h11, ignores upgrades too, but its regular expression takes 13 s for a head of 64 kB with a
header of blanks that ends in a NUL (65 ms for 4 kB), and blocks the event loop all that time.
"""

from typing import Any

from httptools import HttpParserUpgrade, HttpRequestParser
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

MAX_HEAD_BYTES = 64 * 1024
"""Longest incomplete head of a request [bytes]. Without a limit, a client could fill the memory with one header. The
application refuses heads of more than half this size with a problem document, which says more than the status alone."""
TOO_LONG = b"HTTP/1.1 431 Request Header Fields Too Large\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"


class RequestParser(HttpRequestParser):
    """Parser that hands an offered upgrade to its protocol instead of raising an error."""

    def __init__(self, protocol: "HttpProtocol") -> None:
        super().__init__(protocol)
        self._protocol = protocol
        # As in uvicorn: bytes after a request that closes the connection do not prevent the response to that request.
        self.set_dangerous_leniencies(lenient_data_after_close=True)

    def feed_data(self, data: Any) -> None:
        """Parse received bytes. Those after an offered upgrade are left to the protocol."""
        try:
            super().feed_data(data)
        except HttpParserUpgrade as offer:
            self._protocol.decline_upgrade(data[offer.args[0] :])


class HttpProtocol(HttpToolsProtocol):
    """HTTP connection that ignores offers of an upgrade and limits the size of heads.

    A server may ignore an offer to change the protocol (RFC 9110, section 7.8), which Java's client and `curl --http2`
    make with every request. llhttp, the parser in httptools, does not read the body of such a request and expects
    another protocol after its head. The head is therefore parsed again without the header `Upgrade` by a new parser,
    which then handles the rest of the connection.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.parser = RequestParser(self)
        self._in_head, self._head_bytes = False, 0
        self._declined = b""
        """Bytes to be parsed again by the new parser."""

    def data_received(self, data: bytes) -> None:
        """Parse received bytes, and refuse a head that is too long."""
        begun = self.headers if self._in_head else None
        super().data_received(data)
        while again := self._declined:  # Recursion could overflow the stack: thousands of requests may be pipelined.
            self._declined = b""
            super().data_received(again)
        if not self._in_head or self.headers is not begun:  # Each request has its own list, so this is a new head.
            return
        self._head_bytes += len(data)
        if self._head_bytes > MAX_HEAD_BYTES and not self.transport.is_closing():
            answered: RequestResponseCycle | None = self.cycle
            if answered is None or answered.response_complete:
                self.transport.write(TOO_LONG)
            self.transport.close()

    def decline_upgrade(self, rest: bytes) -> None:
        """Arrange for the head without the header `Upgrade`, and the bytes after it, to be parsed again."""
        kept = [(name, value) for name, value in self.headers if name != b"upgrade"]
        if len(kept) == len(self.headers):  # `CONNECT` changes the protocol without that header, and is refused.
            self.send_400_response("Invalid HTTP request received.")
            return
        version = self.parser.get_http_version().encode()
        line = b"%b %b HTTP/%b\r\n" % (self.parser.get_method(), self.url, version)
        fields = b"".join(b"%b: %b\r\n" % field for field in kept)
        self.parser = RequestParser(self)
        self._declined = line + fields + b"\r\n" + rest

    def on_message_begin(self) -> None:
        """Count the bytes of a new head from zero, and begin the request."""
        self._in_head, self._head_bytes = True, 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Pass the request to the application, unless it will be parsed again."""
        self._in_head = False
        if not self.parser.should_upgrade():
            super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Report the end of the body, unless the request will be parsed again."""
        if not self.parser.should_upgrade():
            super().on_message_complete()
