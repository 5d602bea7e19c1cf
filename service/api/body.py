"""Bodies of requests: reading them within a limit, JSON, and which bodies have which results."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from http import HTTPStatus
from typing import Any, NamedTuple

from cachetools import LRUCache
from fastapi import HTTPException, Request
from pydantic_core import from_json
from starlette.requests import ClientDisconnect

from service.errors import InvalidBodyError

REMEMBERED_BYTES = 8 * 1024
"""Longest body that is remembered; few are longer."""
REMEMBERED_SHARE = 1 / 8
"""Memory for remembered bodies over that for results: some 20,000 of the usual bodies by default."""
MAX_FIELDS = 20
"""Fields of an object of a body whose objects have half as many at most."""
OVERHEAD = 300
"""Memory of an entry beside its body, about. [bytes]"""


MARKS = {
    b"\xef\xbb\xbf": "begins with a byte order mark",
    b"\xff\xfe": "is in UTF-16 or UTF-32, with a byte order mark",
    b"\xfe\xff": "is in UTF-16, with a byte order mark",
    b"\x00\x00\xfe\xff": "is in UTF-32, with a byte order mark",
}
"""What a body may begin with that JSON does not (RFC 8259, section 8.1)."""


class KnownBody(NamedTuple):
    """The result of a body, the cases it counts as, and its length."""

    key: str
    cases: int
    length: int


class KnownBodies(LRUCache[tuple[str, bytes], KnownBody]):
    """Which bodies have which results: the same bytes to the same path mean the same key.

    Parameters
    ----------
    memory_bytes
        Memory for results.
    """

    def __init__(self, memory_bytes: int) -> None:
        super().__init__(REMEMBERED_SHARE * memory_bytes, getsizeof=lambda known: known.length + OVERHEAD)

    def remember(self, path: str, body: bytes, key: str, cases: int) -> KnownBody:
        """Note the result of this body, and the cases it counts as."""
        known = KnownBody(key, cases, len(body))
        if len(body) <= min(REMEMBERED_BYTES, self.maxsize - OVERHEAD):
            self[path, body] = known
        return known


async def read_body(request: Request, limit: int) -> bytes:
    """Return the body.

    Raises
    ------
    HTTPException
        413 if it is too long.
    """
    return b"".join([chunk async for chunk in stream_up_to(request, limit)])


async def stream_up_to(request: Request, limit: int) -> AsyncIterator[bytes]:
    """Yield the body as it arrives.

    Raises
    ------
    HTTPException
        413 as soon as it is known to be too long, 400 if the client leaves.
    """
    length = int(request.headers.get("content-length", 0))
    if length <= limit:
        length = 0
        try:
            async for chunk in request.stream():
                length += len(chunk)
                if length > limit:
                    break
                yield chunk
        except ClientDisconnect:
            raise HTTPException(HTTPStatus.BAD_REQUEST, "the body breaks off") from None
    if length > limit:
        raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the body may be {limit} bytes long at most")


def require_type(request: Request, *accepted: str) -> str:
    """Return the media type of the body, refusing others and encodings.

    Raises
    ------
    HTTPException
        415.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    if media_type not in accepted or coding != "identity":
        found = f"{media_type or 'no content type'}{'' if coding == 'identity' else f' in {coding}'}"
        raise HTTPException(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
            f"the body must be {' or '.join(accepted)}, got {found}",
            headers={"Accept": ", ".join(accepted)},
        )
    return media_type


def parse_json(text: bytes, max_depth: int) -> Any:
    """Return the content of a JSON text.

    NaN, Infinity and 1e999 are parsed, though they are no JSON, so that validation can name the field that holds them.

    Raises
    ------
    HTTPException
        400 if it is not JSON in UTF-8, or has more objects and lists in one another than `max_depth`.
    """
    if text.startswith(tuple(MARKS)):
        named = next(name for mark, name in MARKS.items() if text.startswith(mark))
        raise HTTPException(HTTPStatus.BAD_REQUEST, f"the body {named}; send UTF-8 without one")
    if text[1:2] == b"\x00" or text[:1] == b"\x00":
        raise HTTPException(HTTPStatus.BAD_REQUEST, "the body is in UTF-16 or UTF-32; send UTF-8")
    try:
        content = from_json(text)
    except ValueError as error:
        raise HTTPException(HTTPStatus.BAD_REQUEST, f"not JSON: {error}") from error
    if text.count(b"{") + text.count(b"[") > max_depth and is_deeper(content, max_depth):
        raise HTTPException(HTTPStatus.BAD_REQUEST, f"the body may be nested {max_depth} deep at most")
    return content


def is_deeper(content: Any, depth: int) -> bool:
    """Return whether objects and lists are nested by more than this depth."""
    level = [content]
    for _ in range(depth + 1):
        level = [each for each in level if isinstance(each, dict | list)]
        if not level:
            return False
        level = [inner for each in level for inner in (each.values() if isinstance(each, dict) else each)]
    return True


def refuse_crowd(content: Mapping[str, Any], pointer: str = "") -> None:
    """Refuse an object with too many fields: listing what is wrong with a million would take a second.

    Raises
    ------
    InvalidBodyError
        If it has more than `MAX_FIELDS`.
    """
    if len(content) > MAX_FIELDS:
        raise InvalidBodyError([{"pointer": pointer, "detail": f"has {len(content)} fields, most of them unknown"}])


async def next_turn(parsing: asyncio.Lock) -> None:
    """Wait for a turn to parse: one body each time around the event loop, so that a crowd does not hold it up."""
    async with parsing:
        await asyncio.sleep(0)
