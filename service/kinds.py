"""Kinds of problems: the one table from an exception to what is told of it (RFC 9457).

A single query is answered with such a problem; a case of a batch keeps it as its result.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from service.admission import (
    OwnerQueriesError,
    OwnerStreamsError,
    QueriesWaitingError,
    QueueFullError,
    QuotaError,
    StreamsFullError,
)
from service.jobs.store import IdempotencyBusyError, IdempotencyConflictError, StorageError
from service.pool.lane import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.schemas.pointers import pointer_of_parameter
from solver import IntegrationError, ParameterError, StepLimitError

log = logging.getLogger(__name__)


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
    QueriesWaitingError: Kind(HTTPStatus.SERVICE_UNAVAILABLE, "busy", "Too many queries are waiting"),
    QueueFullError: Kind(HTTPStatus.TOO_MANY_REQUESTS, "queue-full", "Too many cases are waiting"),
    OwnerQueriesError: Kind(HTTPStatus.TOO_MANY_REQUESTS, "owner-busy", "Too many queries of this owner are waiting"),
    QuotaError: Kind(HTTPStatus.TOO_MANY_REQUESTS, "quota", "The key has asked for too many cases"),
    OwnerStreamsError: Kind(HTTPStatus.TOO_MANY_REQUESTS, "owner-streams", "Too many event streams of this owner"),
    StreamsFullError: Kind(HTTPStatus.SERVICE_UNAVAILABLE, "streams-full", "Too many event streams are open"),
    IdempotencyConflictError: Kind(
        HTTPStatus.UNPROCESSABLE_ENTITY, "idempotency-conflict", "The idempotency key belongs to another request"
    ),
    IdempotencyBusyError: Kind(
        HTTPStatus.CONFLICT, "idempotency-busy", "The request with this idempotency key is still being accepted"
    ),
    StorageError: Kind(HTTPStatus.INSUFFICIENT_STORAGE, "storage-full", "Nothing can be stored now"),
    Exception: FAILED,
}


def kind_of(exception: Exception, kinds: Mapping[type[Exception], Kind] = KINDS) -> Kind:
    """Kind of an exception: that of its nearest ancestor in the table."""
    return next(kinds[ancestor] for ancestor in type(exception).__mro__ if ancestor in kinds)


def errors_of(exception: Exception) -> list[dict[str, str]]:
    """Return what is wrong with the request of one case, and where, as far as the exception tells."""
    if isinstance(exception, ParameterError):
        return [{"pointer": pointer_of_parameter(exception.field), "detail": exception.requirement}]
    return []


def content(kind: Kind, detail: str, errors: list[dict[str, str]]) -> dict[str, Any]:
    """Return a problem but for its `instance`, which only whoever answers knows."""
    return {"type": kind.uri, "title": kind.title, "status": int(kind.status), "detail": detail, "errors": errors}


def detail_of(exception: Exception, kind: Kind, errors: list[dict[str, str]]) -> str:
    """Return what happened, for people; nothing of the inside of the service."""
    if errors:
        return ": ".join(filter(None, errors[0].values())) + (" (and more)" if len(errors) > 1 else "")
    return "The log of the service has the cause." if kind is FAILED else str(exception)


def problem_of(exception: Exception) -> dict[str, Any]:
    """Return the problem of a case that has no answer; pointers are into the request of that case."""
    kind = kind_of(exception)
    if kind is FAILED:
        log.error("a case failed", exc_info=exception)
    errors = errors_of(exception)
    return content(kind, detail_of(exception, kind, errors), errors)
