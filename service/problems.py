"""Exception handlers that answer every error of the application with a problem document (RFC 9457)."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from http import HTTPStatus

import orjson
from anyio.to_thread import run_sync
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from service.errors import (
    MAX_ERRORS,
    RETRY_SECONDS,
    InvalidBodyError,
    ProblemType,
    ServiceError,
    problem_of,
    validation_errors,
)
from service.telemetry import path_of
from solver import RicochetError
from solver.units import written_in

MEDIA_TYPE = "application/problem+json"
OF_THE_BODY = {HTTPStatus.BAD_REQUEST, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.UNSUPPORTED_MEDIA_TYPE}
"""Statuses of errors that concern the whole body, whose pointer is therefore empty."""
RETRIED_STATUSES = {HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.TOO_MANY_REQUESTS}
"""Statuses that are sent with `Retry-After`."""


def install_problem_handlers(app: FastAPI) -> None:
    """Install the handlers that answer errors of the application with problems."""
    for exception in (ServiceError, RicochetError, Exception):
        app.add_exception_handler(exception, answer_exception)
    app.add_exception_handler(RequestValidationError, answer_validation_error)
    app.add_exception_handler(HTTPException, answer_http_exception)


def units_named_in(request: Request) -> AbstractContextManager[None]:
    """Return a context in which errors are written in the units that the body of a request names, if it names any."""
    # Callers must leave the context before they await anything, since tasks that outlive the request would inherit it.
    return written_in(getattr(request.state, "units", None))


async def answer_exception(request: Request, exception: Exception) -> Response:
    """Answer an exception of the service or the solver, or an unexpected one, with its problem."""
    with units_named_in(request):
        content = problem_of(exception)
    retry_after = exception.retry_after if isinstance(exception, ServiceError) else RETRY_SECONDS
    return problem_response(request, content, retry_after=retry_after)


async def answer_validation_error(request: Request, exception: Exception) -> Response:
    """Answer validation errors that FastAPI found in a request."""
    assert isinstance(exception, RequestValidationError)  # noqa: S101 (registered for this class only)
    # FastAPI prepends "body" or "query" to the location, which is not part of a pointer into the body.
    found = [{**error, "loc": error["loc"][1:]} for error in exception.errors()[:MAX_ERRORS]]
    with units_named_in(request):
        errors = validation_errors(found)
    return await answer_exception(request, InvalidBodyError(errors))


async def answer_http_exception(request: Request, exception: Exception) -> Response:
    """Answer an exception that carries an HTTP status and a message, such as one raised by Starlette."""
    assert isinstance(exception, HTTPException)  # noqa: S101 (registered for this class only)
    status = HTTPStatus(exception.status_code)
    detail = exception.detail
    errors = [{"pointer": "", "detail": exception.detail}] if status in OF_THE_BODY else []
    headers = dict(exception.headers or {})
    if status is HTTPStatus.METHOD_NOT_ALLOWED:
        # The call runs in a thread, because building the OpenAPI document for the first time takes most of a second.
        headers["Allow"] = ", ".join(await run_sync(allowed_methods, request, headers.get("Allow", "GET")))
        detail = f"this path does not take {request.method}; it takes {headers['Allow']}"
    elif detail == HTTPStatus.NOT_FOUND.phrase:  # Only Starlette raises 404 with this message, if no route matched.
        detail = "there is no such path; `/openapi.json` lists them"
    return problem_response(request, ProblemType.of_status(status).content(detail, errors), headers)


def allowed_methods(request: Request, known: str) -> list[str]:
    """Return the methods that the routes of a path accept.

    Starlette lists only the methods of the first matching route, so they are collected from the contract.

    Parameters
    ----------
    known
        Methods that Starlette lists, used for paths outside the contract.
    """
    contract: FastAPI = request.app
    found = {
        method.upper()
        for path, operations in contract.openapi()["paths"].items()
        if compile_path(path)[0].match(path_of(request.scope))
        for method in operations
    }
    found = found or set(known.split(", "))
    return sorted(found | {"HEAD"} if "GET" in found else found)


def problem_response(
    request: Request,
    content: Mapping[str, object],
    headers: Mapping[str, str] | None = None,
    retry_after: int = RETRY_SECONDS,
) -> Response:
    """Return a response with a problem document; `instance` defaults to the path of the request."""
    body = orjson.dumps({**content, "instance": content.get("instance", request.scope["path"])})
    response = Response(body, int(str(content["status"])), headers=headers, media_type=MEDIA_TYPE)
    if response.status_code in RETRIED_STATUSES:
        response.headers["Retry-After"] = str(retry_after)
    return response
