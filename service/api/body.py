"""Bodies of requests, read and bounded before FastAPI validates them.

Every route reads its body here. The length, the depth and the numbers of fields and values are checked before
validation, because the validation time grows with each of them: listing the errors of a million fields takes seconds.
Repeated fields are refused.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Self

from anyio.to_thread import run_sync
from fastapi import HTTPException, Request, Response
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from fastapi.security import SecurityScopes
from pydantic_core import from_json
from starlette.requests import ClientDisconnect

from service.api.negotiation import JSON
from service.api.services import services_of
from service.auth.dependencies import authorize
from service.errors import InvalidBodyError
from service.schemas.problems import json_pointer
from service.schemas.quantities import named_units
from service.settings import Settings
from solver.units import whole_number

MAX_FIELDS = 30
"""Largest number of fields of one object, more than twice as many as the largest object of a request has."""
MAX_LISTED_FIELDS = 10_000
"""Largest number of fields in the body of one request. A resistance with a thousand test shots of four fields has
4,000. Validating 10,000 takes some 10 ms."""
MAX_LISTED_VALUES = 10_000
"""Largest number of list items and fields in the body of one request. A nose profile of 1,000 points has 3,000."""
MAX_BATCH_FIELDS = 100_000
"""Largest number of fields in a JSON batch, five times as many as 1,000 usual cases have. Parsing 100,000 takes some
20 ms, in a thread."""
MAX_SERIES_FIELDS = 25_000
"""Largest number of fields in a calibration or a sweep. A thousand tests of five fields have 5,000."""
MAX_SERIES_VALUES = 250_000
"""Largest number of list items and fields in a batch, a calibration or a sweep. An axis of a sweep may have 100,000
values; a calibration to 20 runs with four columns of 3,000 rows has 240,000. Parsing and validating 250,000 takes some
20 ms, in a thread."""
CONTAINERS = (dict, list)


MARKS = {
    b"\xef\xbb\xbf": "begins with a byte order mark",
    b"\xff\xfe": "is in UTF-16 or UTF-32, with a byte order mark",
    b"\xfe\xff": "is in UTF-16, with a byte order mark",
    b"\x00\x00\xfe\xff": "is in UTF-32, with a byte order mark",
}
"""Byte order marks, with which JSON must not begin (RFC 8259, section 8.1), and the message for each."""


@dataclass(frozen=True, slots=True)
class BodyLimits:
    """Limits on a body, which are checked before it is validated.

    Parameters
    ----------
    length
        Length of the body. [bytes]
    depth
        Depth of nested objects and lists.
    fields, values
        Number of fields of all objects, and number of fields and list items together.
    """

    length: int
    depth: int
    fields: int = MAX_LISTED_FIELDS
    values: int = MAX_LISTED_VALUES

    @classmethod
    def of_one(cls, settings: Settings) -> Self:
        """Return the limits of a single request, which also apply to each line of JSONL."""
        return cls(settings.max_body_bytes, settings.max_body_depth)

    @classmethod
    def of_batch(cls, settings: Settings) -> Self:
        """Return the limits of a JSON batch."""
        return cls(settings.max_batch_bytes, settings.max_body_depth, MAX_BATCH_FIELDS, MAX_SERIES_VALUES)

    @classmethod
    def of_series(cls, settings: Settings) -> Self:
        """Return the limits of a body with long lists: a sweep or a calibration."""
        return cls(settings.max_batch_bytes, settings.max_body_depth, MAX_SERIES_FIELDS, MAX_SERIES_VALUES)


class BoundedRequest(Request):
    """Request whose body has already been read within its limits; FastAPI gets the body and its content from it.

    Parameters
    ----------
    request
        Original request.
    text, content
        Body, and its parsed content.
    """

    def __init__(self, request: Request, text: bytes, content: Any) -> None:
        super().__init__(request.scope, request.receive)
        self._text = text
        self._content = content

    async def body(self) -> bytes:
        """Return the body, which has been read already. FastAPI calls this."""
        return self._text

    async def json(self) -> Any:
        """Return the content of the body, which has been parsed already. FastAPI calls this."""
        return self._content


class CheckedRoute(APIRoute):
    """Route that refuses unknown query parameters, and bounds a JSON body before FastAPI validates it.

    FastAPI reads the body before it runs dependencies, so it would parse the bodies of requests without a valid key.
    The key is therefore checked here as well.
    """

    long = False
    """True if the JSON body may hold long lists, as in a calibration."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return FastAPI's handler, preceded by the checks."""
        handle = super().get_route_handler()
        known = sorted(query_parameters(self.dependant))

        async def handle_checked(request: Request) -> Response:
            if self.body_field is not None:
                await authorize(request, SecurityScopes(["run"]))
            if request.scope["query_string"]:
                refuse_unknown(request, known)
            if self.body_field is None:
                return await handle(request)
            body = await bounded(request, long=self.long)
            request.state.units = named_units(await body.json())
            return await handle(body)

        return handle_checked


def query_parameters(dependant: Dependant) -> set[str]:
    """Return the names of the query parameters of a route and of its dependencies."""
    own = {parameter.alias for parameter in dependant.query_params}
    return own.union(*map(query_parameters, dependant.dependencies))


def refuse_unknown(request: Request, known: Sequence[str]) -> None:
    """Refuse unknown query parameters, since a misspelt one would silently have no effect.

    Raises
    ------
    InvalidBodyError
        If there is an unknown parameter.
    """
    takes = f"; there is {', '.join(known)}" if known else "; there is none here"
    unknown = [name for name in request.query_params if name not in known]
    if unknown:
        raise InvalidBodyError(
            # Names are cut to 100 characters, so that the answer stays short whatever a client sends.
            [{"pointer": json_pointer([name[:100]]), "detail": f"unknown query parameter{takes}"} for name in unknown]
        )


class LongBodyRoute(CheckedRoute):
    """Route whose JSON body may hold long lists."""

    long = True


async def bounded(request: Request, *, long: bool) -> BoundedRequest:
    """Read and parse a JSON body within its limits.

    Raises
    ------
    HTTPException
        400 if the body is not JSON or exceeds a limit other than the length, 413 if it is too long, 415 if it is
        compressed or of another media type.
    InvalidBodyError
        If the body is empty, or an object has too many fields.
    """
    services = services_of(request)
    require_type(request, JSON)
    limits = (BodyLimits.of_series if long else BodyLimits.of_one)(services.settings)
    text = await read_body(request, limits)
    if not text:
        raise InvalidBodyError([{"pointer": "", "detail": "the body is missing"}])
    if long:  # Parsing takes some 20 ms, which would block the event loop for too long.
        content = await run_sync(parse_json, text, limits, limiter=services.reading)
    else:
        await next_turn(services.parsing)
        content = parse_json(text, limits)
    return BoundedRequest(request, text, content)


async def read_body(request: Request, limits: BodyLimits) -> bytes:
    """Read the whole body within the limit on its length.

    Raises
    ------
    HTTPException
        413 if the body is too long.
    """
    return b"".join([chunk async for chunk in stream_up_to(request, limits.length)])


async def stream_up_to(request: Request, limit: int) -> AsyncIterator[bytes]:
    """Yield the body as it arrives.

    Raises
    ------
    HTTPException
        413 as soon as the body is known to be too long, 400 if the client leaves.
    """
    # A body whose declared length is too large is refused before it is read. A chunked body declares no length, so its
    # bytes are counted as they arrive.
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
        detail = f"the body may be {whole_number(limit)} bytes long at most"
        raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, detail)


def require_type(request: Request, *accepted: str) -> str:
    """Return the media type of the body, which must be one of the accepted types and not compressed.

    The limits on the length of a body would not limit the length of a compressed one after decompression.

    Raises
    ------
    HTTPException
        415 if the media type is not accepted, or the body is compressed.
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


def parse_json(text: bytes, limits: BodyLimits) -> Any:
    """Parse JSON within the limits of a body.

    NaN and Infinity, which are not JSON, and numbers beyond float64, such as 1e999, are accepted, so that validation
    can name the field that holds them.

    Raises
    ------
    HTTPException
        400 if the text is not JSON in UTF-8, exceeds a limit, or has a field twice in one object.
    InvalidBodyError
        If an object has more than `MAX_FIELDS` fields.
    """
    if text.startswith(tuple(MARKS)):
        named = next(name for mark, name in MARKS.items() if text.startswith(mark))
        raise HTTPException(HTTPStatus.BAD_REQUEST, f"the body {named}; send UTF-8 without one")
    if text[1:2] == b"\x00" or text[:1] == b"\x00":
        raise HTTPException(HTTPStatus.BAD_REQUEST, "the body is in UTF-16 or UTF-32; send UTF-8")
    # Counting colons and commas limits the time of parsing before it begins. Those within strings are counted too,
    # which does not matter, because no string in a request is long.
    fields = text.count(b":")
    if fields > limits.fields or text.count(b",") > limits.values:
        most_fields, most_values = whole_number(limits.fields), whole_number(limits.values)
        detail = f"the body may have {most_fields} fields and {most_values} values at most"
        raise HTTPException(HTTPStatus.BAD_REQUEST, detail)
    try:
        content = from_json(text)
    except ValueError as error:
        # The parser has a limit of its own, some 200 levels, which is above the limit of the settings.
        deep = "recursion limit" in str(error)
        detail = too_deep(limits.depth) if deep else f"not JSON: {error}"
        raise HTTPException(HTTPStatus.BAD_REQUEST, detail) from error
    # If the numbers of fields and colons differ, the fast parser has dropped a repeated field, or a string contains a
    # colon. Only the slow parser of the standard library reports repeated fields, so it runs in these cases alone.
    if count_fields(content, limits.depth) != fields:
        json.loads(text, object_pairs_hook=refuse_repeated)
    return content


def count_fields(content: Any, max_depth: int) -> int:
    """Return the number of fields of all objects in the content of a body.

    Raises
    ------
    HTTPException
        400 if objects and lists are nested deeper than `max_depth`.
    InvalidBodyError
        If an object has more than `MAX_FIELDS` fields, because listing an error for each could take seconds.
    """
    fields, level = 0, [((), content)] if isinstance(content, CONTAINERS) else list[tuple[tuple[Any, ...], Any]]()
    for _ in range(max_depth):
        inner: list[tuple[tuple[Any, ...], Any]] = []
        for steps, each in level:
            if isinstance(each, dict):
                if len(each) > MAX_FIELDS:
                    detail = f"has {whole_number(len(each))} fields, most of them unknown"
                    raise InvalidBodyError([{"pointer": json_pointer(steps), "detail": detail}])
                fields += len(each)
            pairs = each.items() if isinstance(each, dict) else enumerate(each)
            inner += [((*steps, step), item) for step, item in pairs if isinstance(item, CONTAINERS)]
        if not inner:
            return fields
        level = inner
    raise HTTPException(HTTPStatus.BAD_REQUEST, too_deep(max_depth))


def too_deep(max_depth: int) -> str:
    """Return the message for a body that is nested too deeply."""
    return f"the body may be nested {max_depth} deep at most"


def refuse_repeated(fields: list[tuple[str, Any]]) -> None:
    """Refuse an object with a repeated field: some parsers use the first value, others the last.

    Raises
    ------
    HTTPException
        400 if a field is repeated (RFC 8259, section 4: names should be unique).
    """
    seen: set[str] = set()
    for name, _ in fields:
        if name in seen:
            raise HTTPException(HTTPStatus.BAD_REQUEST, f"an object of the body has the field {name[:100]!r} twice")
        seen.add(name)


async def next_turn(parsing: asyncio.Lock) -> None:
    """Wait until a body may be parsed: one in each iteration of the event loop, so that many bodies do not block it."""
    async with parsing:
        await asyncio.sleep(0)
