"""What is refused whoever asks, and which scope a request takes. What is not named here takes a key."""

from collections.abc import Mapping
from functools import cache
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from fastapi import HTTPException

from service.access.key import PREFIX, Scope

PROBES = frozenset({"/livez", "/readyz"})
"""Asked by those who know neither names nor keys."""
OPEN = PROBES | {"/", "/version", "/docs", "/openapi.json", "/favicon.ico"}
OPEN_FOLDERS = ("/docs/assets/", "/page/")
"""Files that come with the package: nothing of what anybody has computed."""
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing."""
OWN = frozenset({b"same-origin", b"none"})
"""`Sec-Fetch-Site` of what a page of the service, or the user, asks for."""
KEY_FIELDS = frozenset({"access_token", "api_key", "api-key", "apikey", "auth", "authorization", "key", "token"})
LOOPBACK_NAMES = frozenset({b"localhost", b"127.0.0.1", b"[::1]"})
LOOKED_AT = frozenset(
    {b"authorization", b"content-length", b"host", b"origin", b"sec-fetch-site", b"transfer-encoding"}
)
"""Headers that decide; none may be there twice."""


def read_headers(scope: Mapping[str, Any]) -> dict[bytes, bytes]:
    """Return the headers that decide.

    Raises
    ------
    HTTPException
        400 if one is there twice: another server on the way may have read the other.
    """
    found: dict[bytes, bytes] = {}
    for name, value in scope["headers"]:
        if name in LOOKED_AT:
            if name in found:
                raise HTTPException(HTTPStatus.BAD_REQUEST, f"the header {name.decode()} may be there once")
            found[name] = value
    return found


def scope_for(method: str, path: str, *, metrics_open: bool = False) -> Scope | None:
    """Return what a key must be good for; None if no key is needed."""
    if path in OPEN or path.startswith(OPEN_FOLDERS) or (metrics_open and path == "/metrics"):
        return None
    return "read" if method in SAFE else "run"


@cache
def is_loopback(address: str | None) -> bool | None:
    """Tell whether a connection to this address comes from this machine; None if it is no address of a network."""
    try:
        return ip_address((address or "").partition("%")[0]).is_loopback
    except ValueError:
        return None


def refuse_key_in_address(scope: Mapping[str, Any]) -> None:
    """Refuse addresses with a key in them: they stand in the logs of every proxy on the way.

    Raises
    ------
    HTTPException
        400.
    """
    query: bytes = scope["query_string"]
    fields = parse_qsl(query.decode("latin-1"), keep_blank_values=True) if query else ()
    if PREFIX in scope["path"] or any(name.lower() in KEY_FIELDS or PREFIX in name + value for name, value in fields):
        raise HTTPException(
            HTTPStatus.BAD_REQUEST,
            "a key never goes into an address, where logs keep it: send it as `Authorization: Bearer ...`, and revoke "
            "it if this was one",
        )


def refuse_other_names(host: bytes, allowed: frozenset[bytes]) -> None:
    """Refuse requests for another name than those of the service.

    Raises
    ------
    HTTPException
        421.
    """
    name = host.lower()
    if not name.endswith(b"]"):  # of an IPv6 address
        before, colon, port = name.rpartition(b":")
        name = before if colon and port.isdigit() else name
    if name not in allowed:
        raise HTTPException(
            HTTPStatus.MISDIRECTED_REQUEST, "the service does not go by this name; RICOCHET_ALLOWED_HOSTS has those"
        )


def refuse_other_sites(found: Mapping[bytes, bytes], origins: frozenset[bytes]) -> None:
    """Refuse what the page of another site has a browser send to change something.

    Raises
    ------
    HTTPException
        403.
    """
    origin, site = found.get(b"origin"), found.get(b"sec-fetch-site")
    if origin is None and site is None:
        return
    if site in OWN or origin in origins:
        return
    if site is None and origin is not None and urlsplit(origin).netloc == found.get(b"host"):
        return
    raise HTTPException(
        HTTPStatus.FORBIDDEN, "pages of other sites may not ask; RICOCHET_CORS_ORIGINS has those that may"
    )
