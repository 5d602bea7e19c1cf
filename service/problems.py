"""Errors of the application answered as RFC 9457 problems, by the table of `service.kinds` and what is added here."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from service.kinds import INVALID, KINDS, Kind, content, detail_of, kind_of
from service.kinds import errors_of as errors_of_case
from service.schemas.pointers import pointer_of_location
from service.schemas.problems import Problem, ProblemError

__all__ = ["InvalidBodyError", "Problem", "ProblemError", "errors_told", "install_problem_handlers"]

MEDIA_TYPE = "application/problem+json"
MOST_ERRORS = 100
"""A body may be wrong in ten thousand places; nobody reads on."""
RETRY_SECONDS = 5
"""When a client may come back to a service that starts, stops or has lost its workers; a worker starts in about 1 s."""


class InvalidBodyError(Exception):
    """A body of many cases does not fit the contract.

    Parameters
    ----------
    errors
        What is wrong, by `pointer` and `detail`.
    place
        For people, where the first of it is, such as a line.
    """

    def __init__(self, errors: list[dict[str, str]], place: str = "") -> None:
        super().__init__(place)
        self.errors = errors[:MOST_ERRORS]
        self.place = place


HANDLED: Mapping[type[Exception], Kind] = {**KINDS, RequestValidationError: INVALID, InvalidBodyError: INVALID}
OF_THE_BODY = {HTTPStatus.BAD_REQUEST, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.UNSUPPORTED_MEDIA_TYPE}
"""Statuses that tell of the whole body."""
PASSING = {HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.TOO_MANY_REQUESTS}
"""Statuses that a client may hope to be over soon."""


def install_problem_handlers(app: FastAPI) -> None:
    """Have every error of the application answered as a problem."""
    for exception in HANDLED:
        app.add_exception_handler(exception, answer_exception)
    app.add_exception_handler(HTTPException, answer_http_exception)


async def answer_exception(request: Request, exception: Exception) -> Response:
    """Answer an exception of the table."""
    kind, errors = kind_of(exception, HANDLED), errors_of(exception)
    detail = detail_of(exception, kind, errors)
    if isinstance(exception, InvalidBodyError) and exception.place:
        detail = f"{exception.place}: {detail}"
    return problem(request, kind, detail, errors, retry_after=getattr(exception, "retry_after", RETRY_SECONDS))


async def answer_http_exception(request: Request, exception: Exception) -> Response:
    """Answer an error that is no more than its status."""
    assert isinstance(exception, HTTPException)  # noqa: S101 (the handler of nothing else)
    status = HTTPStatus(exception.status_code)
    errors = [{"pointer": "", "detail": exception.detail}] if status in OF_THE_BODY else []
    headers = dict(exception.headers or {})
    if status is HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(allowed_methods(request))
    return problem(request, Kind(status, "", status.phrase), exception.detail, errors, headers)


def allowed_methods(request: Request) -> list[str]:
    """Return what may be asked of this path; the framework tells of the first of its routes alone."""
    contract: FastAPI = request.app
    found = {
        method.upper()
        for path, operations in contract.openapi()["paths"].items()
        if compile_path(path)[0].match(request.scope["path"])
        for method in operations
    }
    return sorted(found) or ["GET"]


def errors_of(exception: Exception) -> list[dict[str, str]]:
    """Return what is wrong with the request body, and where, as far as the exception tells."""
    if isinstance(exception, InvalidBodyError):
        return exception.errors
    if isinstance(exception, RequestValidationError):
        return errors_told([{**error, "loc": error["loc"][1:]} for error in exception.errors()[:MOST_ERRORS]])
    return errors_of_case(exception)


def errors_told(errors: Sequence[Any], before: str = "") -> list[dict[str, str]]:
    """Return errors of a validation as they are told: a pointer each, behind this one, and what is wrong there."""
    return [
        {"pointer": before + pointer_of_location(error["loc"]), "detail": error["msg"]}
        for error in errors[:MOST_ERRORS]
    ]


def problem(
    request: Request,
    kind: Kind,
    detail: str,
    errors: list[dict[str, str]],
    headers: Mapping[str, str] | None = None,
    retry_after: int = RETRY_SECONDS,
) -> Response:
    """Return the answer to a request that has none."""
    told = {**content(kind, detail, errors), "instance": request.scope["path"]}
    response = Response(orjson.dumps(told), kind.status, headers=headers, media_type=MEDIA_TYPE)
    if kind.status in PASSING:
        response.headers["Retry-After"] = str(retry_after)
    return response
