"""From an exception to an RFC 9457 problem: one table, and the handlers that look it up."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Annotated, Any

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import Field
from starlette.exceptions import HTTPException

from service.lane import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.schemas.pointers import pointer_of_location, pointer_of_parameter
from service.schemas.quantities import Part, with_examples
from solver import IntegrationError, ParameterError, StepLimitError

MEDIA_TYPE = "application/problem+json"
MOST_ERRORS = 100
"""A body may be wrong in ten thousand places; nobody reads on."""
RETRY_SECONDS = 5
"""When a client may come back to a service that starts, stops or has lost its workers; a worker starts in about 1 s."""

TOO_SHORT = {
    "pointer": "/projectile/length_m",
    "detail": "must be at least the length of the nose, 0.132665 m, got 0.1 m",
}


class ProblemError(Part):
    """One thing that is wrong with the request."""

    model_config = with_examples(TOO_SHORT)

    pointer: Annotated[str, Field(description="JSON pointer (RFC 6901) into the request body; empty for all of it.")]
    detail: Annotated[str, Field(description="What is wrong with it.")]


class Problem(Part):
    """Why there is no answer (RFC 9457)."""

    model_config = with_examples(
        {
            "type": "urn:ricochet:problem:invalid-request",
            "title": "The request does not fit the contract",
            "status": 422,
            "detail": ": ".join(TOO_SHORT.values()),
            "instance": "/cra",
            "errors": [TOO_SHORT],
        }
    )

    type: Annotated[str, Field(description="Stable, for programs; `about:blank` where the status says it all.")]
    title: Annotated[str, Field(description="Of the type.")]
    status: Annotated[int, Field(ge=400, le=599, description="The HTTP status.")]
    detail: Annotated[str, Field(description="Of this occurrence.")]
    instance: Annotated[str, Field(description="The path that was asked.")]
    errors: Annotated[list[ProblemError], Field(description="What is wrong with the request body, if anything is.")]


@dataclass(frozen=True, slots=True)
class Kind:
    """What all problems of one type have in common."""

    status: HTTPStatus
    name: str
    title: str

    @property
    def uri(self) -> str:
        """Identifier of the type."""
        return f"urn:ricochet:problem:{self.name}" if self.name else "about:blank"


INVALID = Kind(HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", "The request does not fit the contract")
FAILED = Kind(HTTPStatus.INTERNAL_SERVER_ERROR, "internal-error", "The service failed")

KINDS: Mapping[type[Exception], Kind] = {
    RequestValidationError: INVALID,
    ParameterError: INVALID,
    StepLimitError: Kind(
        HTTPStatus.UNPROCESSABLE_ENTITY, "step-limit", "The run needs more time steps than one may take"
    ),
    IntegrationError: Kind(HTTPStatus.UNPROCESSABLE_ENTITY, "not-integrable", "The motion could not be integrated"),
    TaskTimeoutError: Kind(HTTPStatus.UNPROCESSABLE_ENTITY, "timeout", "The query takes longer than one may"),
    WorkerCrashedError: Kind(
        HTTPStatus.INTERNAL_SERVER_ERROR, "worker-crashed", "The query ended every worker process it was given to"
    ),
    PoolUnavailableError: Kind(HTTPStatus.SERVICE_UNAVAILABLE, "unavailable", "No worker process can take the query"),
    Exception: FAILED,
}
OF_THE_BODY = {HTTPStatus.BAD_REQUEST, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.UNSUPPORTED_MEDIA_TYPE}
"""Statuses that tell of the whole body."""


def install_problem_handlers(app: FastAPI) -> None:
    """Have every error of the application answered as a problem."""
    for exception in KINDS:
        app.add_exception_handler(exception, answer_exception)
    app.add_exception_handler(HTTPException, answer_http_exception)


async def answer_exception(request: Request, exception: Exception) -> Response:
    """Answer an exception of the table."""
    kind = next(KINDS[ancestor] for ancestor in type(exception).__mro__ if ancestor in KINDS)
    errors = errors_of(exception)
    if errors:
        detail = ": ".join(filter(None, errors[0].values())) + (" (and more)" if len(errors) > 1 else "")
    else:
        detail = "The log of the service has the cause." if kind is FAILED else str(exception)
    return problem(request, kind, detail, errors)


async def answer_http_exception(request: Request, exception: Exception) -> Response:
    """Answer an error that is no more than its status."""
    assert isinstance(exception, HTTPException)  # noqa: S101 (the handler of nothing else)
    status = HTTPStatus(exception.status_code)
    errors = [{"pointer": "", "detail": exception.detail}] if status in OF_THE_BODY else []
    return problem(request, Kind(status, "", status.phrase), exception.detail, errors, exception.headers)


def errors_of(exception: Exception) -> list[dict[str, str]]:
    """Return what is wrong with the request body, and where, as far as the exception tells."""
    if isinstance(exception, ParameterError):
        return [{"pointer": pointer_of_parameter(exception.field), "detail": exception.requirement}]
    if isinstance(exception, RequestValidationError):
        found: Sequence[Any] = exception.errors()[:MOST_ERRORS]
        return [{"pointer": pointer_of_location(error["loc"][1:]), "detail": error["msg"]} for error in found]
    return []


def problem(
    request: Request,
    kind: Kind,
    detail: str,
    errors: list[dict[str, str]],
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return the answer to a request that has none."""
    content = {
        "type": kind.uri,
        "title": kind.title,
        "status": kind.status,
        "detail": detail,
        "instance": request.url.path,
        "errors": errors,
    }
    response = Response(orjson.dumps(content), kind.status, headers=headers, media_type=MEDIA_TYPE)
    if kind.status is HTTPStatus.SERVICE_UNAVAILABLE:
        response.headers["Retry-After"] = str(RETRY_SECONDS)
    return response
