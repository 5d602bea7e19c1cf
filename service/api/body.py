"""Requests as they arrive: their bodies, `Accept`, conditional requests (RFC 9110) and `Prefer` (RFC 7240)."""

import asyncio
import re
from collections.abc import AsyncIterator, Iterable, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, NamedTuple

from cachetools import LRUCache
from fastapi import HTTPException, Request
from pydantic_core import from_json
from starlette.requests import ClientDisconnect

PREFERENCE = re.compile(
    r'\s*([!#$%&\'*+.^_`|~0-9a-z-]+)\s*(?:=\s*("(?:[^"\\]|\\.)*"|[^\s;,"]*))?[^,"]*(?:"[^"]*"[^,"]*)*'
)
"""A token, its value, and parameters, which none of ours has. Of what is said twice the first counts."""
MOST_DIGITS = 9


def choose(accept: str, offered: Sequence[str]) -> str | None:
    """Return the media type the client likes best, the first of several; None if it takes none of those offered."""
    ranges = [_parse(part) for part in accept.split(",") if part.strip()]
    qualities = [_quality(media_type, ranges) for media_type in offered]
    best = max(qualities)
    return offered[qualities.index(best)] if best > 0.0 else None


def matches(if_none_match: str, etag: str) -> bool:
    """Return whether the client has this representation already."""
    tags = [tag.strip().removeprefix("W/") for tag in if_none_match.split(",")]
    return "*" in tags or etag in tags


def _parse(part: str) -> tuple[str, float]:
    media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return media_range, float(value)
            except ValueError:
                return media_range, 0.0
    return media_range, 1.0


def _quality(media_type: str, ranges: list[tuple[str, float]]) -> float:
    """Quality of the most specific range that holds the media type."""
    qualities = dict(ranges) if ranges else {"*/*": 1.0}
    for media_range in (media_type, f"{media_type.partition('/')[0]}/*", "*/*"):
        if media_range in qualities:
            return qualities[media_range]
    return 0.0


@dataclass(frozen=True, slots=True)
class Preference:
    """How long a client will wait, and whether it would rather not wait at all.

    Parameters
    ----------
    respond_async
        Whether it wants a job whatever the size of the work.
    wait
        Time to wait for the answer; None if it does not say. [s]
    """

    respond_async: bool = False
    wait: int | None = None

    def applied(self, waited: float | None) -> dict[str, str]:
        """Return the header that says which preferences were obeyed in making a job, if any was."""
        applied = ["respond-async"] * self.respond_async
        if self.wait is not None and waited is not None:
            applied.append(f"wait={min(self.wait, int(waited))}")
        return {"Preference-Applied": ", ".join(applied)} if applied else {}


def read_preference(headers: Iterable[str]) -> Preference:
    """Return what these headers say; what they say of other matters, or wrongly, is passed over."""
    found: dict[str, str] = {}
    for match in PREFERENCE.finditer(",".join(headers).lower()):
        found.setdefault(match[1], (match[2] or "").strip('"'))
    wait = found.get("wait", "")
    seconds = int(wait[:MOST_DIGITS]) if wait.isascii() and wait.isdigit() else None
    return Preference("respond-async" in found, seconds)


JSON = "application/json"
JSONL = "application/jsonl"
REMEMBERED_BYTES = 8 * 1024
"""Longest body that is remembered; few are longer."""
REMEMBERED_SHARE = 1 / 8
"""Memory for remembered bodies over that for results: some 20,000 of the usual bodies by default."""
OVERHEAD = 300
"""Memory of an entry beside its body, about. [bytes]"""


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
        400 if it is no JSON, or has more objects and lists in one another than `max_depth`.
    """
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


async def next_turn(parsing: asyncio.Lock) -> None:
    """Wait for a turn to parse: one body each time around the event loop, so that a crowd does not hold it up."""
    async with parsing:
        await asyncio.sleep(0)
