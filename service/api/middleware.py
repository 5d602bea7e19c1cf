"""ASGI middleware: draining of refused bodies, limits on headers, request checks, compression, security headers.

Keys and scopes are checked by the routes, in `service.auth.dependencies`.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from fastapi import HTTPException, Request
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipResponder, IdentityResponder
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.negotiation import HDF5, PARQUET, coding_of
from service.auth.api_keys import PREFIX, ApiKeyStore
from service.auth.audit_log import AuditLog
from service.auth.dependencies import CONTEXT, RequestContext
from service.auth.quotas import QuotaStore
from service.errors import ProblemType
from service.problems import problem_response
from service.settings import Settings
from service.telemetry import path_of
from solver.units import whole_number

DRAIN_BYTES = 64 * 1024 * 1024
"""Largest part of the body of a refused request that is read and discarded [bytes]. Reading that much takes half a
second."""
DRAIN_SECONDS = 5.0
"""Longest time for which a refused body is read before the response is sent [s]. An arbitrary choice: long enough for
`DRAIN_BYTES` on a usual connection, and a limit for clients that send slowly on purpose."""


class RefusalMiddleware:
    """Reads the rest of a refused body before the response is sent.

    Many clients read the response only after they have sent everything. Closing a socket with unread data resets the
    connection, and the reset destroys the response in the client's buffer. A body that is declared longer than
    `DRAIN_BYTES` is not read. If the body is not read to its end, the connection is closed after the response.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and drain its body before a response with an error status."""
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


MAX_HEADERS = 100
"""Largest number of headers of a request. Browsers and proxies send some thirty; Apache has the same limit."""
MAX_HEADER_BYTES = 8 * 1024
"""Largest length of the value of a header, and of the target of a request [bytes]. nginx has the same limit; a key
takes some 60 bytes."""
MAX_HEAD_BYTES = 32 * 1024
"""Largest total length of the headers of a request, as in nginx [bytes]. They include cookies that other services on
the same host have set."""


class HeaderLimits:
    """Refuses requests with a long head, so that neither inner middleware nor the routes parse long headers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with 414 or 431."""
        refused = refusal_of_head(scope) if scope["type"] == "http" else None
        if refused is None:
            await self._app(scope, receive, send)
            return

        async def send_secured(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = secured(message.get("headers", []), tls=scope.get("scheme") == "https")
            await send(message)

        content = ProblemType.of_status(refused.status_code).content(refused.detail)
        content["instance"] = ""  # The path may be the part that is too long, and is not repeated.
        await problem_response(Request(scope), content)(scope, receive, send_secured)


def refusal_of_head(scope: Scope) -> HTTPException | None:
    """Return the error if the target or the headers of a request exceed a limit, else None."""
    if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > MAX_HEADER_BYTES:
        detail = f"a target may be {whole_number(MAX_HEADER_BYTES)} bytes long at most"
        return HTTPException(HTTPStatus.REQUEST_URI_TOO_LONG, detail)
    headers = scope["headers"]
    if len(headers) > MAX_HEADERS:
        detail = f"a request may have {MAX_HEADERS} headers at most"
    elif max((len(value) for _, value in headers), default=0) > MAX_HEADER_BYTES:
        detail = f"a header may be {whole_number(MAX_HEADER_BYTES)} bytes long at most"
    elif sum(len(name) + len(value) for name, value in headers) > MAX_HEAD_BYTES:
        detail = f"all headers may be {whole_number(MAX_HEAD_BYTES)} bytes long at most"
    else:
        return None
    return HTTPException(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, detail)


class HeadMiddleware:
    """Routes `HEAD` requests to the handlers of `GET`, and sends the headers of their response only."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on. `HEAD` is passed on as `GET`, and the body of the response is discarded."""
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
            await sent.wait()  # The disconnect ends a response that would otherwise stream for ever.
            return {"type": "http.disconnect"}

        await self._app(inner, receive_until_sent, send_head)


LEAST_BYTES = 1024
"""Length of the shortest response that is compressed [bytes]: a shorter one fits into one network packet anyway."""
THREAD_BYTES = 8 * 1024
"""Length of the shortest response that is compressed in a thread [bytes]. For a shorter one, switching threads would
take longer than the compression."""
LEVEL = 1
"""Compression level of gzip. Level 6 takes four times as long and saves 3 % more."""
EXCLUDED = (*DEFAULT_EXCLUDED_CONTENT_TYPES, HDF5, PARQUET)
"""Media types that are not compressed: formats that already are, and event streams, whose events must not wait in the
compressor."""


class CompressionMiddleware:
    """Compresses responses of 1 kB and more with gzip, for clients that accept it.

    A strong entity tag becomes a weak one, because the compressed bytes differ (RFC 9110, section 8.8.1).
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and compress the response if the client accepts gzip."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_weak(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                changed = "content-encoding" in headers or (message["status"] == 304 and coding != "identity")
                if changed and headers.get("etag", "").startswith('"'):
                    headers["etag"] = "W/" + headers["etag"]
                if "etag" in headers:  # A 304 must have the `Vary` header of the 200 (RFC 9110, section 15.4.5).
                    headers.add_vary_header("Accept-Encoding")
                if "vary" in headers:  # Static files set `Vary` themselves, so it may name a header twice.
                    headers["vary"] = ", ".join(dict.fromkeys(headers["vary"].split(", ")))
            await send(message)

        coding = coding_of(",".join(Headers(scope=scope).getlist("accept-encoding")))
        responder = (
            GZipResponder(
                self._app, LEAST_BYTES, LEVEL, thread_minimum_size=THREAD_BYTES, exclude_content_types=EXCLUDED
            )
            if coding == "gzip"
            else IdentityResponder(self._app, LEAST_BYTES, exclude_content_types=EXCLUDED)
        )
        await responder(scope, receive, send_weak)


PROBES = frozenset({"/livez", "/readyz"})
"""Paths polled by monitors, which send the address of the service instead of its name as `Host`, and have no key."""
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing."""
OWN_SITES = frozenset({b"same-origin", b"none"})
"""Values of `Sec-Fetch-Site` for requests from the service's own page, and for addresses that the user has entered."""
KEY_FIELDS = frozenset({"access_token", "api_key", "api-key", "apikey", "auth", "authorization", "key", "token"})
"""Query parameters in which clients send keys by mistake."""
LOOPBACK_NAMES = frozenset({b"localhost", b"127.0.0.1", b"[::1]"})
"""Host names accepted on the loopback interface while no key is required."""
UNIQUE_HEADERS = frozenset(
    {b"authorization", b"content-length", b"host", b"origin", b"sec-fetch-site", b"transfer-encoding"}
)
"""Headers that decide whether a request is accepted, and therefore must not be repeated."""

CHUNKED = b"chunked"
"""The only transfer coding that the server decodes."""

Pairs = list[tuple[bytes, bytes]]
POLICY = b"default-src 'none'; frame-ancestors 'none'"
"""Content security policy of responses other than pages, in case a browser displays one. Pages set their own policy."""
ALWAYS: Pairs = [
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"content-security-policy", POLICY),
]
TRANSPORT: Pairs = [(b"strict-transport-security", b"max-age=31536000")]
"""Strict-Transport-Security header, valid for a year as usual; sent over TLS only: browsers ignore it elsewhere."""
NO_STORE: Pairs = [(b"cache-control", b"no-store")]
"""Cache policy of most responses: no proxy may store them, because each is meant for one client."""
REVALIDATE: Pairs = [(b"cache-control", b"private, no-cache")]
"""Cache policy of responses with an entity tag, which the client may keep and revalidate."""
USUAL, USUAL_TLS = [*ALWAYS, *NO_STORE], [*ALWAYS, *NO_STORE, *TRANSPORT]
DECIDING = frozenset({b"etag", *(name for name, _ in USUAL_TLS)})
"""Headers of a response that determine which headers are added to it."""


class AuthMiddleware:
    """Request checks, security headers and audit log.

    Parameters
    ----------
    app
        ASGI application to wrap.
    settings
        Settings for access, host names, origins and TLS.
    keys, quotas
        Stores of API keys and of their quotas.
    audit
        Audit log of every POST, PATCH and DELETE, written when keys are required or an audit file is set.
    """

    def __init__(
        self, app: ASGIApp, settings: Settings, keys: ApiKeyStore, quotas: QuotaStore, audit: AuditLog
    ) -> None:
        self._app = app
        self._access = settings.access
        self._metrics_open = settings.metrics_open
        self._keys = keys
        self._quotas = quotas
        self._audit = audit
        self._audited = settings.audit_log is not None
        self._tls = settings.tls_certificate is not None
        self._hosts = frozenset(name.lower().encode() for name in settings.allowed_hosts)
        self._origins = frozenset(origin.encode() for origin in settings.cors_origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request and pass it on, or refuse it. WebSockets are ignored, since the service has none."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return
        status, key_required = 0, self._requires_key(scope)
        # Behind a trusted proxy, uvicorn sets the scheme that the proxy reports.
        tls = self._tls or scope.get("scheme") == "https"
        public = self._metrics_open and path_of(scope) == "/metrics"
        context = RequestContext(
            self._keys, self._quotas, key_required=key_required and not public, client=client_of(scope)
        )
        scope[CONTEXT] = context

        async def send_secured(message: Message) -> None:
            if message["type"] == "http.response.start":
                nonlocal status
                status = message["status"]
                message["headers"] = secured(message.get("headers", []), tls=tls)
                if context.principal.quota is not None:
                    MutableHeaders(scope=message).update(context.principal.quota.fields())
            await send(message)

        try:
            self._check(scope, key_required)
        except HTTPException as refused:
            content = ProblemType.of_status(refused.status_code).content(refused.detail)
            if PREFIX in path_of(scope):  # The response must not repeat a key, since clients log responses.
                content["instance"] = ""
            await problem_response(Request(scope), content)(scope, receive, send_secured)
        else:
            await self._app(scope, receive, send_secured)
        finally:
            if (key_required or self._audited) and scope["method"] not in SAFE:
                self._audit.record(scope, context, status or 500)

    def _requires_key(self, scope: Scope) -> bool:
        """Return True if a key is required. Clients on other machines need one unless access is `open`.

        A client of a trusted proxy counts as another machine even if the proxy runs on this one.
        """
        if self._access != "auto":
            return self._access == "keys"
        self._keys.reload()
        return self._keys.required or is_loopback(address_of(scope)) is False or is_loopback(client_of(scope)) is False

    def _check(self, scope: Scope, key_required: bool) -> None:
        """Refuse requests that no key could permit.

        Raises
        ------
        HTTPException
            400 for a repeated header or a key in the URL, 403 for a request from the page of another site, 421 for an
            unknown host, 501 for an unsupported transfer coding.
        """
        headers = read_headers(scope)
        refuse_transfer_codings(headers.get(b"transfer-encoding", CHUNKED))
        path = path_of(scope)
        if scope["query_string"] or PREFIX in path:
            refuse_key_in_address(scope)
        if path not in PROBES:
            if self._hosts:
                refuse_other_hosts(headers.get(b"host", b""), self._hosts)
            # Without keys, checking the host name is the only defence against DNS rebinding: a page of another site
            # whose own name resolves to this machine. A service on a socket file cannot be reached by a browser.
            elif not key_required and is_loopback(address_of(scope)) is not None:
                refuse_other_hosts(headers.get(b"host", b""), LOOPBACK_NAMES)
        if scope["method"] not in SAFE:
            refuse_other_sites(headers, self._origins)


def address_of(scope: Scope) -> str | None:
    """Return the address of the service that the request was sent to."""
    server = scope.get("server")
    return server[0] if server else None


def client_of(scope: Scope) -> str | None:
    """Return the address of the client; behind a trusted proxy, the address in `X-Forwarded-For`."""
    client = scope.get("client")
    return client[0] if client else None


@lru_cache(maxsize=1024)
def is_loopback(address: str | None) -> bool | None:
    """Return whether an address is a loopback address; None if it is no network address."""
    try:
        return ip_address((address or "").partition("%")[0]).is_loopback
    except ValueError:
        return None


def read_headers(scope: Mapping[str, Any]) -> dict[bytes, bytes]:
    """Return the headers that decide whether a request is accepted.

    Raises
    ------
    HTTPException
        400 if one of them is repeated, because a proxy may have used the other value (request smuggling).
    """
    found: dict[bytes, bytes] = {}
    for name, value in scope["headers"]:
        if name in UNIQUE_HEADERS:
            if name in found:
                raise HTTPException(HTTPStatus.BAD_REQUEST, f"the header {name.decode()} must not be repeated")
            found[name] = value
    return found


def refuse_transfer_codings(codings: bytes) -> None:
    """Refuse transfer codings other than `chunked` alone, because the server would not decode the body.

    Raises
    ------
    HTTPException
        501 for any other coding (RFC 9112, section 6.1).
    """
    if codings.strip().lower() != CHUNKED:
        raise HTTPException(HTTPStatus.NOT_IMPLEMENTED, "the one Transfer-Encoding that is decoded is `chunked`")


def refuse_key_in_address(scope: Scope) -> None:
    """Refuse URLs that contain a key, because browsers and proxies log URLs.

    Raises
    ------
    HTTPException
        400 if the path or the query contains a key, or the query has a parameter in `KEY_FIELDS`.
    """
    query: bytes = scope["query_string"]
    fields = parse_qsl(query.decode("latin-1"), keep_blank_values=True) if query else ()
    if PREFIX in path_of(scope) or any(name.lower() in KEY_FIELDS or PREFIX in name + value for name, value in fields):
        raise HTTPException(
            HTTPStatus.BAD_REQUEST,
            "a key never goes into an address, where logs keep it: send it as `Authorization: Bearer ...`, and revoke "
            "it if this was one",
        )


def refuse_other_hosts(host: bytes, allowed: frozenset[bytes]) -> None:
    """Refuse requests for an unknown host.

    Starlette's `TrustedHostMiddleware` would answer 400 with plain text, and refuse the probes too.

    Raises
    ------
    HTTPException
        421 if the host is not allowed.
    """
    name = host.lower()
    if not name.endswith(b"]"):  # An IPv6 address without a port ends with a bracket, and has colons of its own.
        before, colon, port = name.rpartition(b":")
        name = before if colon and port.isdigit() else name
    if name not in allowed:
        raise HTTPException(HTTPStatus.MISDIRECTED_REQUEST, "unknown Host header; see RICOCHET_ALLOWED_HOSTS")


def refuse_other_sites(headers: Mapping[bytes, bytes], origins: frozenset[bytes]) -> None:
    """Refuse requests that the page of another site makes a browser send (cross-site request forgery).

    Raises
    ------
    HTTPException
        403 if the request comes from the page of a site that is not in `origins`.
    """
    origin, site = headers.get(b"origin"), headers.get(b"sec-fetch-site")
    if origin is None and site is None:  # Every current browser sends one of the two, so the client is no browser.
        return
    if site in OWN_SITES or origin in origins:
        return
    with suppress(ValueError):  # A malformed origin is refused like another site.
        if site is None and origin is not None and urlsplit(origin).netloc == headers.get(b"host"):
            return
    raise HTTPException(HTTPStatus.FORBIDDEN, "requests by pages of other sites are refused; see RICOCHET_CORS_ORIGINS")


def secured(headers: Pairs, *, tls: bool) -> Pairs:
    """Return the headers of a response with the missing security headers added; existing ones are kept."""
    # Most responses have none of the headers in `DECIDING`, and get one of the prepared lists.
    for name, _ in headers:
        if name in DECIDING:
            break
    else:
        return [*headers, *(USUAL_TLS if tls else USUAL)]
    there = {name for name, _ in headers}
    wanted = [*ALWAYS, *(REVALIDATE if b"etag" in there else NO_STORE), *(TRANSPORT if tls else [])]
    return [*headers, *(pair for pair in wanted if pair[0] not in there)]
