"""Errors of the service, each with the problem document (RFC 9457) that a client receives for it.

The problem is the response to a single query, or the result of a case of a batch.
"""

import logging
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ValidationError

from service.schemas.explanations import explained
from service.schemas.problems import pointer_of_location, pointer_of_parameter
from service.schemas.requests import Case
from service.schemas.sweeps import AxisError, Grid, Outline
from service.schemas.wording import UNKNOWN
from solver import IntegrationError, ParameterError, StepLimitError
from solver.units import whole_number

Model = TypeVar("Model", bound=BaseModel)
log = logging.getLogger(__name__)

MAX_ERRORS = 100
"""Largest number of errors listed in one problem. A body may have ten thousand, which nobody would read."""
MAX_SUGGESTIONS = 10
"""Largest number of unknown fields in one problem for which similar names are suggested. Finding them takes up
to 1 ms for each field."""
RETRY_SECONDS = 5
"""Value of `Retry-After` while the service starts, stops or has lost its workers [s]. A worker starts in about 1 s."""


class ServiceError(Exception):
    """Base class of errors that are answered with a problem. Subclasses override status, type and title."""

    status: ClassVar[HTTPStatus] = HTTPStatus.INTERNAL_SERVER_ERROR
    type: ClassVar[str] = "urn:ricochet:problem:internal-error"
    title: ClassVar[str] = "The service failed"
    retry_after: int = RETRY_SECONDS
    """Value of the `Retry-After` header, for statuses that are sent with it. [s]"""


class InvalidBodyError(ServiceError):
    """The body does not conform to the contract.

    Parameters
    ----------
    errors
        Field errors, each with its JSON pointer (`pointer`) and message (`detail`).
    place
        Location of the first error, such as a line number, for the message.
    """

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    type = "urn:ricochet:problem:invalid-request"
    title = "The request does not fit the contract"

    def __init__(self, errors: Sequence[dict[str, str]], place: str = "") -> None:
        super().__init__(place)
        self.errors = list(errors[:MAX_ERRORS])
        self.place = place


class ExecutorError(ServiceError):
    """Base class of errors of the executor itself, as opposed to errors that a call raises."""


class WorkerCrashedError(ExecutorError):
    """The call killed every worker process that ran it."""

    type = "urn:ricochet:problem:worker-crashed"
    title = "Every worker process that ran the query ended"


class TaskTimeoutError(ExecutorError):
    """The call exceeded its time limit."""

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    type = "urn:ricochet:problem:timeout"
    title = "The query exceeds its time limit"


class PoolUnavailableError(ExecutorError):
    """No worker process could be started, the worker of the call was stopped, or the pool is shutting down."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:unavailable"
    title = "No worker process can take the query"


class QueueTimeoutError(ExecutorError):
    """No worker took the call within its queue timeout."""


class ComputationCancelled(ServiceError):  # noqa: N818 (as asyncio.CancelledError: not a failure)
    """A shared computation was cancelled by its owner, so the case has to be computed again."""


class QueueFullError(ServiceError):
    """The queue has no room for the cases of a request.

    Parameters
    ----------
    retry_after
        Estimated time until the queue has room. [s]
    """

    status = HTTPStatus.TOO_MANY_REQUESTS
    type = "urn:ricochet:problem:queue-full"
    title = "Too many cases are waiting"

    def __init__(self, retry_after: int) -> None:
        super().__init__(f"too much work is waiting; there is likely to be room in {retry_after} s")
        self.retry_after = retry_after


class JobsTooLargeError(QueueFullError):
    """The unfinished jobs of one owner would exceed their limit on disk space."""

    # An arbitrary choice: space becomes free when a job ends, and nothing here predicts when.
    retry_after = 60

    def __init__(self, limit: int) -> None:
        most = whole_number(limit)
        ServiceError.__init__(self, f"the unfinished jobs of one owner may take {most} bytes; let some end first")


class QueriesWaitingError(QueueFullError):
    """The queue of single queries is full, or a query has waited too long."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:busy"
    title = "Too many queries are waiting"


class OwnerQueriesError(QueueFullError):
    """One owner has as many single queries waiting or running as the limit allows."""

    type = "urn:ricochet:problem:owner-busy"
    title = "Too many queries of this owner are waiting"


class QuotaError(ServiceError):
    """A request needs more cases than the quota of its key has left.

    Parameters
    ----------
    most
        Quota of the key, in cases per hour.
    count
        Number of cases requested.
    left
        Number of cases left in the quota.
    retry_after
        Time until the quota has room for the request. [s]
    """

    status = HTTPStatus.TOO_MANY_REQUESTS
    type = "urn:ricochet:problem:quota"
    title = "The quota of the key is used up"

    def __init__(self, most: int, count: int, left: int, retry_after: int) -> None:
        asked, rest, quota = map(whole_number, (count, left, most))
        super().__init__(f"{asked} cases exceed the {rest} that are left of the {quota} an hour of this key")
        self.retry_after = retry_after


class QuotaTooSmallError(QuotaError):
    """A request needs more cases than the quota of its key allows in an hour, so waiting does not help.

    Parameters
    ----------
    most
        Quota of the key, in cases per hour.
    count
        Number of cases of the request counted so far.
    """

    # 429 would invite the client to send the request again, which is always refused.
    status = HTTPStatus.FORBIDDEN
    type = "urn:ricochet:problem:quota-too-small"
    title = "The quota of the key never allows so many cases"

    def __init__(self, most: int, count: int) -> None:
        ServiceError.__init__(
            self,
            f"the request has at least {whole_number(count)} cases, of which this key may have {whole_number(most)} an "
            "hour; send fewer at a time",
        )


class OwnerStreamsError(ServiceError):
    """One owner has as many event streams open as the limit allows."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    type = "urn:ricochet:problem:owner-streams"
    title = "Too many event streams of this owner"
    retry_after = 30
    """Time after which a stream may have ended, an arbitrary choice: a stream lasts as long as its job. [s]"""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} event streams are open; end one, or read the job itself")


class StreamsFullError(OwnerStreamsError):
    """The number of open event streams has reached its limit."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:streams-full"
    title = "Too many event streams are open"


class IdempotencyConflictError(ServiceError):
    """The idempotency key was used before with a different request."""

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    type = "urn:ricochet:problem:idempotency-conflict"
    title = "The idempotency key belongs to another request"


class IdempotencyBusyError(ServiceError):
    """Another request with this idempotency key is still being read."""

    status = HTTPStatus.CONFLICT
    type = "urn:ricochet:problem:idempotency-busy"
    title = "The request with this idempotency key is still being accepted"


class StorageError(ServiceError):
    """The disk is full, read-only or missing, so jobs or files cannot be stored or read."""

    status = HTTPStatus.INSUFFICIENT_STORAGE
    type = "urn:ricochet:problem:storage-full"
    title = "Nothing can be stored now"


class UnsuitableFolderError(StorageError):
    """The file system of the data folder does not support the shared memory that SQLite needs."""

    type = "urn:ricochet:problem:unsuitable-folder"
    title = "The data folder is on an unsuitable file system"


SHARED_MEMORY_ERRORS = {
    sqlite3.SQLITE_IOERR_SHMOPEN,
    sqlite3.SQLITE_IOERR_SHMSIZE,
    sqlite3.SQLITE_IOERR_SHMLOCK,
    sqlite3.SQLITE_IOERR_SHMMAP,
}
"""SQLite error codes of a failed shared-memory mapping. The write-ahead log needs such mappings, which some network and
FUSE file systems do not support."""


def storage_reason(error: Exception) -> str:
    """Return the reason for a disk error without the path, which clients must not see."""
    if is_unsuitable(error):
        return (
            "its file system cannot share files in memory, which SQLite needs; some network and FUSE file systems "
            "cannot: put the data folder on a local one"
        )
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


def is_unsuitable(error: Exception) -> bool:
    """Return True if the error is caused by an unsuitable file system."""
    return isinstance(error, sqlite3.Error) and getattr(error, "sqlite_errorcode", None) in SHARED_MEMORY_ERRORS


def storage_error(what: str, error: Exception) -> StorageError:
    """Return the `StorageError` for a disk error; `what` says what failed, such as "jobs cannot be stored"."""
    kind = UnsuitableFolderError if is_unsuitable(error) else StorageError
    return kind(f"{what}: {storage_reason(error)}")


class DownloadsFullError(ServiceError):
    """Downloads in progress take all the disk space that is reserved for downloads."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:downloads-full"
    title = "Too many files are being sent"
    retry_after = 30
    """Time after which a download may have ended, an arbitrary choice: it depends on the clients. [s]"""

    def __init__(self) -> None:
        super().__init__(
            "files that other clients are still receiving take all the room; try again, or ask for JSON lines"
        )


class FolderReplacedError(StorageError):
    """The data folder, or a file in it, has been removed or replaced since it was opened."""


class DamagedCasesError(ServiceError):
    """A stored block of cases is damaged.

    Parameters
    ----------
    first, last
        Numbers of the first and the last case of the block, counted from 0.
    """

    type = "urn:ricochet:problem:damaged"
    title = "What was stored is damaged"

    def __init__(self, first: int, last: int) -> None:
        super().__init__(f"what was stored of cases {first} to {last} of the job is damaged: submit them again")


class DamagedJobError(DamagedCasesError):
    """The stored row of a job is damaged.

    Parameters
    ----------
    fields
        Names of the unreadable columns.
    """

    def __init__(self, fields: Sequence[str]) -> None:
        text = f"{', '.join(fields)} of the job can no longer be read: keep the results that exist, delete the job and "
        ServiceError.__init__(self, f"{text}submit it again")


STATUS_PROBLEMS = {
    HTTPStatus.BAD_REQUEST: ("bad-request", "The request cannot be read"),
    HTTPStatus.UNAUTHORIZED: ("key-required", "A valid API key is required"),
    HTTPStatus.FORBIDDEN: ("forbidden", "The request is not allowed"),
    HTTPStatus.NOT_FOUND: ("not-found", "There is nothing under this name"),
    HTTPStatus.METHOD_NOT_ALLOWED: ("method-not-allowed", "The path does not take this method"),
    HTTPStatus.NOT_ACCEPTABLE: ("not-acceptable", "The answer has no form that `Accept` names"),
    HTTPStatus.REQUEST_TIMEOUT: ("body-too-slow", "The body arrives too slowly"),
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE: ("body-too-long", "The body is too long"),
    HTTPStatus.REQUEST_URI_TOO_LONG: ("target-too-long", "The target of the request is too long"),
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE: ("unsupported-media-type", "The body is of another media type"),
    HTTPStatus.MISDIRECTED_REQUEST: ("unknown-host", "Unknown host name"),
    HTTPStatus.UNPROCESSABLE_ENTITY: (InvalidBodyError.type.rpartition(":")[2], InvalidBodyError.title),
    HTTPStatus.TOO_MANY_REQUESTS: ("too-many-requests", "Too many requests come from one address"),  # sent by nginx
    HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE: ("head-too-long", "The head of the request is too long"),
    HTTPStatus.NOT_IMPLEMENTED: ("not-implemented", "The service cannot do this"),
    HTTPStatus.BAD_GATEWAY: ("no-answer", "The service behind this one does not answer"),
    HTTPStatus.SERVICE_UNAVAILABLE: ("not-ready", "The service is not ready"),
}
"""Types (without their prefix) and titles of problems that only state an HTTP status. They are written out because the
phrases of `HTTPStatus` differ between versions of Python."""


class JobGoneError(StorageError):
    """The job was deleted while a request for it was being processed."""

    status = HTTPStatus.NOT_FOUND
    type = f"urn:ricochet:problem:{STATUS_PROBLEMS[HTTPStatus.NOT_FOUND][0]}"
    title = STATUS_PROBLEMS[HTTPStatus.NOT_FOUND][1]


class ReportsMissingError(ServiceError):
    """The extra that draws reports is not installed.

    Parameters
    ----------
    package
        Name of the missing package.
    """

    status = HTTPStatus.NOT_IMPLEMENTED
    type = "urn:ricochet:problem:reports-missing"
    title = "Reports are not installed"

    def __init__(self, package: str) -> None:
        from service.settings import missing_package  # noqa: PLC0415 (takes long to import, and no query needs it)

        super().__init__(missing_package("a report", package, "reports"))


class UnusableFolderError(Exception):
    """The data folder cannot be used; the message gives the reason."""


class FolderInUseError(UnusableFolderError):
    """The data folder is locked by another running service."""


class FolderLayoutError(UnusableFolderError):
    """A file in the data folder was written by another version of the program.

    Parameters
    ----------
    name
        Name of the file.
    found, known
        Layout number of the file, and the layout number that this version reads.
    """

    def __init__(self, name: str, found: int, known: int) -> None:
        super().__init__(
            f"{name} in the data folder has layout {found}, of another version of ricochet; this one reads layout "
            f"{known} and has left everything as it is: set RICOCHET_DATA_DIR to another folder, or use that version"
        )


class DamagedFileError(Exception):
    """The content of a file differs from what was written, or was written by another version."""


class MissingExtraError(Exception):
    """Traces are enabled, but the extra that sends them is missing; the message names the command that installs it."""


@dataclass(frozen=True, slots=True)
class ProblemType:
    """Status, type and title that all problems of one type share."""

    status: HTTPStatus
    type: str
    title: str

    @classmethod
    def of(cls, exception: BaseException) -> Self:
        """Return the problem type of an exception. The type of an unexpected one is that of `ServiceError`."""
        if isinstance(exception, ServiceError):
            return cls(exception.status, exception.type, exception.title)
        for ancestor in type(exception).__mro__:
            if ancestor in SOLVER_ERRORS:
                return cls(*SOLVER_ERRORS[ancestor])
        return cls(ServiceError.status, ServiceError.type, ServiceError.title)

    @classmethod
    def of_status(cls, status: int) -> Self:
        """Return the problem type of an error that has only an HTTP status."""
        found = HTTPStatus(status)
        name, title = STATUS_PROBLEMS.get(found, ("", ""))
        return cls(found, f"urn:ricochet:problem:{name}" if name else "about:blank", title or found.phrase)

    def content(self, detail: str, errors: Sequence[dict[str, str]] = ()) -> dict[str, Any]:
        """Return a problem document without `instance`, which depends on the request."""
        status = int(self.status)
        return {"type": self.type, "title": self.title, "status": status, "detail": detail, "errors": list(errors)}


SOLVER_ERRORS: Mapping[type, tuple[HTTPStatus, str, str]] = {
    ParameterError: (InvalidBodyError.status, InvalidBodyError.type, InvalidBodyError.title),
    StepLimitError: (
        HTTPStatus.UNPROCESSABLE_ENTITY,
        "urn:ricochet:problem:step-limit",
        "The run needs more time steps than one may take",
    ),
    IntegrationError: (
        HTTPStatus.UNPROCESSABLE_ENTITY,
        "urn:ricochet:problem:not-integrable",
        "The motion could not be integrated",
    ),
}
"""Status, type and title of the solver's errors. They are mapped here because the solver does not depend on HTTP."""


def problem_types() -> list[ProblemType]:
    """Return all problem types, sorted by type and status."""
    errors = [ServiceError]
    for error in errors:  # The loop visits the subclasses that it appends, so it walks the whole tree of errors.
        errors += error.__subclasses__()
    found = {ProblemType(error.status, error.type, error.title) for error in errors}
    found |= {ProblemType(*each) for each in SOLVER_ERRORS.values()}
    found |= {ProblemType.of_status(status) for status in STATUS_PROBLEMS}
    return sorted(found, key=lambda each: (each.type, each.status))


def field_errors(exception: BaseException) -> list[dict[str, str]]:
    """Return the field errors that an exception carries, each with its pointer and message."""
    if isinstance(exception, InvalidBodyError):
        return exception.errors
    if isinstance(exception, ParameterError):
        return [{"pointer": pointer_of_parameter(exception.field), "detail": exception.requirement}]
    return []


def errors_found(error: ValidationError) -> list[Any]:
    """Return the first `MAX_ERRORS` errors of a failed validation, without links to the documentation of pydantic."""
    return error.errors(include_url=False)[:MAX_ERRORS]


def validation_errors(errors: Sequence[Any], before: str = "") -> list[dict[str, str]]:
    """Convert pydantic errors to pointers and messages; `before` is prepended to each pointer."""
    found: list[dict[str, str]] = []
    unknown = 0
    for error in errors[:MAX_ERRORS]:
        pointer = pointer_of_location(error["loc"])
        unknown += error["type"] == UNKNOWN
        found.append(
            {"pointer": before + pointer, "detail": explained(pointer, error, suggest=unknown <= MAX_SUGGESTIONS)}
        )
    return found


def validated_as(model: type[Model], content: Any, pointer: str = "") -> Model:
    """Validate the content of a body, or of the part of it at `pointer`, with a model.

    Raises
    ------
    InvalidBodyError
        If the content is not valid.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(errors_found(error), pointer)) from error


def grid_of(model: type[Case], outline: Outline) -> Grid:
    """Validate the base and the axes of a sweep, and return the grid of its points.

    Parameters
    ----------
    model
        Model with which the base and every point are validated.

    Raises
    ------
    InvalidBodyError
        If the base or an axis is not valid.
    """
    base = validated_as(model, outline.base, "/base")
    try:
        base.check_fields()
    except ParameterError as error:
        errors = [{**each, "pointer": f"/base{each['pointer']}"} for each in field_errors(error)]
        raise InvalidBodyError(errors) from error
    try:
        return Grid(model, outline)
    except AxisError as error:
        raise InvalidBodyError([{"pointer": error.pointer, "detail": error.detail}]) from error


@contextmanager
def errors_of_point(grid: Grid, number: int, point: Sequence[float]) -> Iterator[None]:
    """Convert errors raised for one point of a sweep to an `InvalidBodyError` that names the values of the axes."""
    try:
        yield
    except (ValidationError, ParameterError) as error:
        found = field_errors(error) if isinstance(error, ParameterError) else validation_errors(errors_found(error))
        place = "at " + ", ".join(f"{field} = {value:g}" for field, value in zip(grid.fields, point, strict=True))
        errors = [{**each, "pointer": grid.pointer(number, each["pointer"])} for each in found]
        raise InvalidBodyError(errors, place) from error


def problem_of(exception: BaseException) -> dict[str, Any]:
    """Return the problem document of an exception, without `instance`.

    For an unexpected error it only refers to the log, because the message of the error may contain paths or data.
    """
    kind, found = ProblemType.of(exception), field_errors(exception)
    if found:
        detail = ": ".join(filter(None, found[0].values())) + (" (and more)" if len(found) > 1 else "")
        if isinstance(exception, InvalidBodyError) and exception.place:
            detail = f"{exception.place}: {detail}"
    else:
        detail = "The log of the service has the cause." if kind.type == ServiceError.type else str(exception)
    content = kind.content(detail, found)
    return content | {"stopped_at_s": exception.time} if isinstance(exception, StepLimitError) else content


def case_problem(exception: BaseException) -> dict[str, Any]:
    """Return the problem of a failed case, and log unexpected errors. Pointers refer to the request of the case."""
    problem = problem_of(exception)
    if problem["type"] == ServiceError.type:
        log.error("a case failed", exc_info=exception)
    return problem
