"""How a body is read: what is too long, of another type or no JSON is refused before anything looks at it."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from http import HTTPStatus
from typing import Any

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic_core import from_json

JSON = "application/json"
JSONL = "application/jsonl"


class JsonRequest(Request):
    """A request whose body is read up to a limit and parsed with a limit on nesting.

    NaN, Infinity and 1e999 are parsed, though they are no JSON, so that validation can name the field that holds them.
    """

    async def body(self) -> bytes:
        """Return the body.

        Raises
        ------
        HTTPException
            413 if it is too long.
        """
        if not hasattr(self, "_body"):
            chunks = [chunk async for chunk in stream_up_to(self, self.app.state.settings.max_body_bytes)]
            self._body = b"".join(chunks)
        return self._body

    async def json(self) -> Any:
        """Return the parsed body.

        Raises
        ------
        HTTPException
            400 if it cannot be parsed, or is nested too deep.
        """
        body = await self.body()
        async with self.app.state.turn:
            await asyncio.sleep(0)  # one each time around the event loop: a crowd at once would hold it up
        return parse_json(body, self.app.state.settings.max_body_depth)


class JsonRoute(APIRoute):
    """A route whose body, if it takes one, is JSON and says so."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler that checks the type of the body first."""
        handle = super().get_route_handler()

        async def handle_json(request: Request) -> Response:
            if self.body_field is not None:
                require_type(request, JSON)
            return await handle(JsonRequest(request.scope, request.receive))

        return handle_json


def parse_json(text: bytes, most_deep: int) -> Any:
    """Return what a text says.

    Raises
    ------
    HTTPException
        400 if it is no JSON, or has more objects and lists in one another than `most_deep`.
    """
    try:
        content = from_json(text)
    except ValueError as error:
        raise HTTPException(HTTPStatus.BAD_REQUEST, f"not JSON: {error}") from error
    if text.count(b"{") + text.count(b"[") > most_deep and is_deeper(content, most_deep):
        raise HTTPException(HTTPStatus.BAD_REQUEST, f"the body may be nested {most_deep} deep at most")
    return content


def is_deeper(content: Any, depth: int) -> bool:
    """Tell whether objects and lists are in one another by more than this depth."""
    level = [content]
    for _ in range(depth + 1):
        level = [each for each in level if isinstance(each, dict | list)]
        if not level:
            return False
        level = [inner for each in level for inner in (each.values() if isinstance(each, dict) else each)]
    return True


async def stream_up_to(request: Request, limit: int) -> AsyncIterator[bytes]:
    """Yield the body as it arrives.

    Raises
    ------
    HTTPException
        413 as soon as it is known to be too long.
    """
    length = int(request.headers.get("content-length", 0))
    if length <= limit:
        length = 0
        async for chunk in request.stream():
            length += len(chunk)
            if length > limit:
                break
            yield chunk
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
