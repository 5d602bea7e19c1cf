"""How a JSON body is read: what is no JSON, too long or of another type is refused before anything looks at it."""

from collections.abc import Callable, Coroutine
from http import HTTPStatus
from typing import Any

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic_core import from_json

JSON = "application/json"


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
            limit: int = self.app.state.settings.max_body_bytes
            chunks, length = [], int(self.headers.get("content-length", 0))
            if length <= limit:
                length = 0
                async for chunk in self.stream():
                    chunks.append(chunk)
                    length += len(chunk)
                    if length > limit:
                        break
            if length > limit:
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the body may be {limit} bytes long at most")
            self._body = b"".join(chunks)
        return self._body

    async def json(self) -> Any:
        """Return the parsed body.

        Raises
        ------
        HTTPException
            400 if it cannot be parsed.
        """
        try:
            return from_json(await self.body())
        except ValueError as error:
            raise HTTPException(HTTPStatus.BAD_REQUEST, f"not JSON: {error}") from error


class JsonRoute(APIRoute):
    """A route whose body, if it takes one, is JSON and says so."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler that checks the type of the body first."""
        handle = super().get_route_handler()

        async def handle_json(request: Request) -> Response:
            if self.body_field is not None:
                require_json(request)
            return await handle(JsonRequest(request.scope, request.receive))

        return handle_json


def require_json(request: Request) -> None:
    """Refuse a body of another type or encoding.

    Raises
    ------
    HTTPException
        415.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    if media_type != JSON or coding != "identity":
        found = f"{media_type or 'no content type'}{'' if coding == 'identity' else f' in {coding}'}"
        raise HTTPException(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE, f"the body must be {JSON}, got {found}", headers={"Accept": JSON}
        )
