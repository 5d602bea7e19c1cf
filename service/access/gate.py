"""The gate that every request passes: refuses what may not come in, notes who asks, and secures the answer."""

from http import HTTPStatus

from fastapi import HTTPException, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.arrival import CYCLE, Arrival
from service.access.audit import AuditLog
from service.access.headers import secured
from service.access.keyring import KeyRing
from service.access.rules import (
    LOOPBACK_NAMES,
    PROBES,
    SAFE,
    is_loopback,
    read_headers,
    refuse_key_in_address,
    refuse_other_names,
    refuse_other_sites,
    scope_for,
)
from service.access.usage import Usages
from service.access.visit import ANYONE, VISIT, Caller, Visit
from service.errors import ProblemType
from service.problems import problem_response
from service.settings import Settings

CHALLENGE = {"WWW-Authenticate": "Bearer"}
SCHEME = b"bearer "


class Gate:
    """Middleware, outside all that answers.

    Parameters
    ----------
    app
        What answers.
    settings
        Who may ask, from where, and how slowly.
    keys, usages
        Of the data folder.
    audit
        Told of all that is asked for to be done, where keys are asked for or the log has a file.
    """

    def __init__(self, app: ASGIApp, settings: Settings, keys: KeyRing, usages: Usages, audit: AuditLog) -> None:
        self._app = app
        self._settings = settings
        self._keys = keys
        self._usages = usages
        self._audit = audit
        self._audited = settings.audit_log is not None
        self._tls = settings.tls_certificate is not None
        self._hosts = frozenset(name.lower().encode() for name in settings.allowed_hosts)
        self._origins = frozenset(origin.encode() for origin in settings.cors_origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return
        visit, status, tls = Visit(ANYONE), 0, self._tls
        keys_asked = self._asks_for_keys(scope)
        scope[VISIT] = visit

        async def send_secured(message: Message) -> None:
            if message["type"] == "http.response.start":
                nonlocal status
                status = message["status"]
                message["headers"] = secured(message.get("headers", []), tls=tls)
            await send(message)

        try:
            found = read_headers(scope)
            visit.caller = self._let_in(scope, found, keys_asked)
            cycle = scope.pop(CYCLE, None)
            if cycle is None or cycle.more_body:  # else there is nothing to wait for, and a limit is dear
                receive = Arrival(receive, self._settings.body_seconds, self._settings.slowest_bytes_per_second)
            await self._app(scope, receive, send_secured)
        except HTTPException as refused:
            if status:
                raise
            await refuse(scope, receive, send_secured, refused)
        finally:
            if (keys_asked or self._audited) and scope["method"] not in SAFE:
                self._audit.note(scope, visit, status or 500)

    def _let_in(self, scope: Scope, found: dict[bytes, bytes], keys_asked: bool) -> Caller:
        """Return who asks.

        Raises
        ------
        HTTPException
            If the request may not come in.
        """
        path, method = scope["path"], scope["method"]
        if scope["query_string"] or "ricochet_" in path:
            refuse_key_in_address(scope)
        if path not in PROBES:
            if self._hosts:
                refuse_other_names(found.get(b"host", b""), self._hosts)
            elif not keys_asked and is_loopback(address_of(scope)):
                refuse_other_names(found.get(b"host", b""), LOOPBACK_NAMES)
        if method not in SAFE:
            refuse_other_sites(found, self._origins)
        needed = scope_for(method, path, metrics_open=self._settings.metrics_open)
        if needed is None or not keys_asked:
            return ANYONE
        caller = self._caller(found.get(b"authorization", b""))
        if not caller.may(needed):
            raise HTTPException(HTTPStatus.FORBIDDEN, f"the key is not good for this: it lacks the scope `{needed}`")
        return caller

    def _asks_for_keys(self, scope: Scope) -> bool:
        """Tell whether a key is asked for; it always is of those elsewhere, unless the service is said to be open."""
        if self._settings.access != "auto":
            return self._settings.access == "keys"
        self._keys.look()
        return self._keys.needed or is_loopback(address_of(scope)) is False

    def _caller(self, authorization: bytes) -> Caller:
        """Return whose key this is.

        Raises
        ------
        HTTPException
            401 if it is none that is good.
        """
        if authorization[: len(SCHEME)].lower() != SCHEME:
            raise HTTPException(
                HTTPStatus.UNAUTHORIZED, "a key is needed: `Authorization: Bearer ...`", headers=CHALLENGE
            )
        key = self._keys.find(authorization[len(SCHEME) :].decode("latin-1").strip())
        if key is None:
            headers = {"WWW-Authenticate": 'Bearer error="invalid_token"'}
            raise HTTPException(
                HTTPStatus.UNAUTHORIZED, "the key is none of this service, or no longer good", headers=headers
            )
        return Caller(key.owner, key, self._usages.of(key.id, key.cases_per_hour))


def address_of(scope: Scope) -> str | None:
    """Return the address the request has come to."""
    server = scope.get("server")
    return server[0] if server else None


async def refuse(scope: Scope, receive: Receive, send: Send, refused: HTTPException) -> None:
    """Answer a request that does not come in."""
    content = ProblemType.of_status(refused.status_code).content(refused.detail)
    answer = problem_response(Request(scope), content, refused.headers)
    await answer(scope, receive, send)
