"""Errors of the service, each with the problem (RFC 9457) that a client receives for it.

A single query is answered with such a problem; a case of a batch keeps it as its result.
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
from service.schemas.sweeps import AxisError, Grid, Outline
from service.schemas.wording import UNKNOWN
from solver import IntegrationError, ParameterError, StepLimitError

Model = TypeVar("Model", bound=BaseModel)
log = logging.getLogger(__name__)

MAX_ERRORS = 100
"""Errors listed in one problem: a body may be wrong in ten thousand places, and nobody reads on."""
MAX_SUGGESTIONS = 10
"""Unknown fields in one problem for which similar ones are looked for: each takes up to a millisecond."""
RETRY_SECONDS = 5
"""When to try again a service that starts, stops or has lost its workers; a worker starts in about 1 s."""


class ServiceError(Exception):
    """Base of the errors that are answered as problems. Subclasses set what they differ in."""

    status: ClassVar[HTTPStatus] = HTTPStatus.INTERNAL_SERVER_ERROR
    type: ClassVar[str] = "urn:ricochet:problem:internal-error"
    title: ClassVar[str] = "The service failed"
    retry_after: int = RETRY_SECONDS
    """Value of `Retry-After` where the status has one. [s]"""


class InvalidBodyError(ServiceError):
    """The body does not fit the contract.

    Parameters
    ----------
    errors
        What is wrong, by `pointer` and `detail`.
    place
        For people: where the first error is, such as a line.
    """

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    type = "urn:ricochet:problem:invalid-request"
    title = "The request does not fit the contract"

    def __init__(self, errors: Sequence[dict[str, str]], place: str = "") -> None:
        super().__init__(place)
        self.errors = list(errors[:MAX_ERRORS])
        self.place = place


class ExecutorError(ServiceError):
    """Base of failures of the executor rather than of the call."""


class WorkerCrashedError(ExecutorError):
    """The call ended every worker process it was given to."""

    type = "urn:ricochet:problem:worker-crashed"
    title = "The query ended every worker process it was given to"


class TaskTimeoutError(ExecutorError):
    """The call took longer than a call may."""

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    type = "urn:ricochet:problem:timeout"
    title = "The query takes longer than one may"


class PoolUnavailableError(ExecutorError):
    """No worker process could be started, the one that took the call was stopped, or the pool is stopping."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:unavailable"
    title = "No worker process can take the query"


class QueueTimeoutError(ExecutorError):
    """No worker has taken the call in the time that it may wait."""


class ComputationCancelled(ServiceError):  # noqa: N818 (as asyncio.CancelledError: not a failure)
    """A shared computation was given up by its owner; the case has to be computed again."""


class QueueFullError(ServiceError):
    """More cases would wait than may.

    Parameters
    ----------
    retry_after
        When there is likely to be room. [s]
    """

    status = HTTPStatus.TOO_MANY_REQUESTS
    type = "urn:ricochet:problem:queue-full"
    title = "Too many cases are waiting"

    def __init__(self, retry_after: int) -> None:
        super().__init__(f"too much work is waiting; there is likely to be room in {retry_after} s")
        self.retry_after = retry_after


class JobsTooLargeError(QueueFullError):
    """The unfinished jobs of an owner would take more than so many bytes of disk."""

    retry_after = 60

    def __init__(self, limit: int) -> None:
        ServiceError.__init__(self, f"the unfinished jobs of one owner may take {limit:,} bytes; let some end first")


class QueriesWaitingError(QueueFullError):
    """More single queries would wait than may."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:busy"
    title = "Too many queries are waiting"


class OwnerQueriesError(QueueFullError):
    """More single queries of one owner would wait or run than this limit."""

    type = "urn:ricochet:problem:owner-busy"
    title = "Too many queries of this owner are waiting"


class QuotaError(ServiceError):
    """More cases are requested with a key than its quota has left.

    Parameters
    ----------
    most
        Cases of the key within an hour.
    count
        Cases requested.
    left
        Cases that are left.
    retry_after
        When so many are allowed again. [s]
    """

    status = HTTPStatus.TOO_MANY_REQUESTS
    type = "urn:ricochet:problem:quota"
    title = "The quota of the key is used up"

    def __init__(self, most: int, count: int, left: int, retry_after: int) -> None:
        super().__init__(f"{count:,} cases exceed the {left:,} that are left of the {most:,} an hour of this key")
        self.retry_after = retry_after


class QuotaTooSmallError(QuotaError):
    """A request has more cases than its key may ever have within an hour, so that waiting does not help.

    Parameters
    ----------
    most
        Cases of the key within an hour.
    count
        Cases of the request that have been counted so far.
    """

    status = HTTPStatus.FORBIDDEN
    type = "urn:ricochet:problem:quota-too-small"
    title = "The quota of the key never allows so many cases"

    def __init__(self, most: int, count: int) -> None:
        ServiceError.__init__(
            self,
            f"the request has at least {count:,} cases, of which this key may have {most:,} an hour; "
            "send fewer at a time",
        )


class OwnerStreamsError(ServiceError):
    """An owner has as many event streams open as this limit."""

    status = HTTPStatus.TOO_MANY_REQUESTS
    type = "urn:ricochet:problem:owner-streams"
    title = "Too many event streams of this owner"
    retry_after = 30
    """Until one of them is likely to have ended. [s]"""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} event streams are open; end one, or read the job itself")


class StreamsFullError(OwnerStreamsError):
    """As many event streams are open as this limit."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:streams-full"
    title = "Too many event streams are open"


class IdempotencyConflictError(ServiceError):
    """The idempotency key belongs to another request."""

    status = HTTPStatus.UNPROCESSABLE_ENTITY
    type = "urn:ricochet:problem:idempotency-conflict"
    title = "The idempotency key belongs to another request"


class IdempotencyBusyError(ServiceError):
    """The request with this idempotency key is still being accepted."""

    status = HTTPStatus.CONFLICT
    type = "urn:ricochet:problem:idempotency-busy"
    title = "The request with this idempotency key is still being accepted"


class StorageError(ServiceError):
    """Jobs cannot be stored or read: the disk is full, read-only or gone."""

    status = HTTPStatus.INSUFFICIENT_STORAGE
    type = "urn:ricochet:problem:storage-full"
    title = "Nothing can be stored now"


class UnsuitableFolderError(StorageError):
    """The file system of the data folder cannot keep what has to be kept, however much room it has."""

    type = "urn:ricochet:problem:unsuitable-folder"
    title = "The data folder is on an unsuitable file system"


SHARED_MEMORY_ERRORS = {
    sqlite3.SQLITE_IOERR_SHMOPEN,
    sqlite3.SQLITE_IOERR_SHMSIZE,
    sqlite3.SQLITE_IOERR_SHMLOCK,
    sqlite3.SQLITE_IOERR_SHMMAP,
}
"""Codes of SQLite for a file that cannot be shared in memory, as on some network and FUSE file systems."""


def storage_reason(error: Exception) -> str:
    """Return why the disk refuses something, without the path."""
    if is_unsuitable(error):
        return (
            "its file system cannot share files in memory, which SQLite needs, as some network and FUSE file systems: "
            "put the data folder on a local one"
        )
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


def is_unsuitable(error: Exception) -> bool:
    """Return whether the file system is what is wrong."""
    return isinstance(error, sqlite3.Error) and getattr(error, "sqlite_errorcode", None) in SHARED_MEMORY_ERRORS


def storage_error(what: str, error: Exception) -> StorageError:
    """Return the error of something that the disk refuses."""
    kind = UnsuitableFolderError if is_unsuitable(error) else StorageError
    return kind(f"{what}: {storage_reason(error)}")


class DownloadsFullError(ServiceError):
    """Files of results that are being sent take all the room there is for them."""

    status = HTTPStatus.SERVICE_UNAVAILABLE
    type = "urn:ricochet:problem:downloads-full"
    title = "Too many files are being sent"
    retry_after = 30
    """Until one of them is likely to have been sent. [s]"""

    def __init__(self) -> None:
        super().__init__(
            "files that other clients are still receiving take all the room; try again, or ask for JSON lines"
        )


class FolderReplacedError(StorageError):
    """The path of the data folder, or of a file in it, leads to something else than when it was opened."""


class DamagedCasesError(ServiceError):
    """What was stored of a block of cases cannot be read.

    Parameters
    ----------
    first, last
        Its cases, from 0.
    """

    type = "urn:ricochet:problem:damaged"
    title = "What was stored is damaged"

    def __init__(self, first: int, last: int) -> None:
        super().__init__(f"what was stored of cases {first} to {last} of the job is damaged: submit them again")


class DamagedJobError(DamagedCasesError):
    """What was stored of a job cannot be read.

    Parameters
    ----------
    fields
        Names of what cannot be read.
    """

    def __init__(self, fields: Sequence[str]) -> None:
        text = (
            f"of the job, {', '.join(fields)} cannot be read any more: take the results that are there, delete it and "
        )
        ServiceError.__init__(self, f"{text}submit it again")


STATUS_PROBLEMS = {
    HTTPStatus.BAD_REQUEST: ("bad-request", "The request cannot be read"),
    HTTPStatus.UNAUTHORIZED: ("key-required", "A valid API key is required"),
    HTTPStatus.FORBIDDEN: ("forbidden", "The request is not allowed"),
    HTTPStatus.NOT_FOUND: ("not-found", "There is nothing under this name"),
    HTTPStatus.METHOD_NOT_ALLOWED: ("method-not-allowed", "The path does not take this method"),
    HTTPStatus.NOT_ACCEPTABLE: ("not-acceptable", "The answer has no form that `Accept` names"),
    HTTPStatus.REQUEST_TIMEOUT: ("body-too-slow", "The body comes too slowly"),
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE: ("body-too-long", "The body is too long"),
    HTTPStatus.REQUEST_URI_TOO_LONG: ("target-too-long", "The target of the request is too long"),
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE: ("unsupported-media-type", "The body is of another media type"),
    HTTPStatus.MISDIRECTED_REQUEST: ("unknown-host", "The service has no such name"),
    HTTPStatus.UNPROCESSABLE_ENTITY: (InvalidBodyError.type.rpartition(":")[2], InvalidBodyError.title),
    HTTPStatus.TOO_MANY_REQUESTS: ("too-many-requests", "Too many requests come from one address"),  # by nginx.conf
    HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE: ("head-too-long", "The head of the request is too long"),
    HTTPStatus.NOT_IMPLEMENTED: ("not-implemented", "The service cannot do this"),
    HTTPStatus.BAD_GATEWAY: ("no-answer", "The service behind this one does not answer"),
    HTTPStatus.SERVICE_UNAVAILABLE: ("not-ready", "The service is not ready"),
}
"""Type, without its prefix, and title of what is refused with an HTTP status alone. They do not follow the phrases of
`HTTPStatus`, which differ between versions of Python."""


class JobGoneError(StorageError):
    """The job has been deleted meanwhile: there is none with its id."""

    status = HTTPStatus.NOT_FOUND
    type = f"urn:ricochet:problem:{STATUS_PROBLEMS[HTTPStatus.NOT_FOUND][0]}"
    title = STATUS_PROBLEMS[HTTPStatus.NOT_FOUND][1]


class ReportsMissingError(ServiceError):
    """What draws reports is not installed.

    Parameters
    ----------
    package
        The package that is missing.
    """

    status = HTTPStatus.NOT_IMPLEMENTED
    type = "urn:ricochet:problem:reports-missing"
    title = "Reports are not installed"

    def __init__(self, package: str) -> None:
        from service.settings import missing_package  # noqa: PLC0415 (takes long to import, and no query needs it)

        super().__init__(missing_package("a report", package, "reports"))


class UnusableFolderError(Exception):
    """It cannot be done with this folder; the text says why."""


class FolderInUseError(UnusableFolderError):
    """The data folder belongs to another running service."""


class FolderLayoutError(UnusableFolderError):
    """A file of the data folder is of another version of the program.

    Parameters
    ----------
    name
        Name of the file.
    found, known
        Its layout, and that of this version.
    """

    def __init__(self, name: str, found: int, known: int) -> None:
        super().__init__(
            f"{name} in the data folder has layout {found}, of another version of ricochet; this one reads layout "
            f"{known} and has left everything as it is: set RICOCHET_DATA_DIR to another folder, or use that version"
        )


class DamagedFileError(Exception):
    """The file is not what was written."""


class MissingExtraError(Exception):
    """Traces are enabled, and what sends them is not installed; the text says how to mend it."""


@dataclass(frozen=True, slots=True)
class ProblemType:
    """What all problems of one type have in common."""

    status: HTTPStatus
    type: str
    title: str

    @classmethod
    def of(cls, exception: BaseException) -> Self:
        """Return the type of the problem that an exception is answered as; unforeseen ones are failures."""
        if isinstance(exception, ServiceError):
            return cls(exception.status, exception.type, exception.title)
        for ancestor in type(exception).__mro__:
            if ancestor in SOLVER_ERRORS:
                return cls(*SOLVER_ERRORS[ancestor])
        return cls(ServiceError.status, ServiceError.type, ServiceError.title)

    @classmethod
    def of_status(cls, status: int) -> Self:
        """Return the type of a problem that is no more than its HTTP status."""
        found = HTTPStatus(status)
        name, title = STATUS_PROBLEMS.get(found, ("", ""))
        return cls(found, f"urn:ricochet:problem:{name}" if name else "about:blank", title or found.phrase)

    def content(self, detail: str, errors: Sequence[dict[str, str]] = ()) -> dict[str, Any]:
        """Return a problem of this type without its `instance`, which depends on the request."""
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
"""The solver's errors, which know nothing of HTTP."""


def problem_types() -> list[ProblemType]:
    """Return the types of all problems, in the order of their names."""
    errors = [ServiceError]
    for error in errors:  # It grows on the way.
        errors += error.__subclasses__()
    found = {ProblemType(error.status, error.type, error.title) for error in errors}
    found |= {ProblemType(*each) for each in SOLVER_ERRORS.values()}
    found |= {ProblemType.of_status(status) for status in STATUS_PROBLEMS}
    return sorted(found, key=lambda each: (each.type, each.status))


def field_errors(exception: BaseException) -> list[dict[str, str]]:
    """Return what is wrong with a request and where, as far as the exception says."""
    if isinstance(exception, InvalidBodyError):
        return exception.errors
    if isinstance(exception, ParameterError):
        return [{"pointer": pointer_of_parameter(exception.field), "detail": exception.requirement}]
    return []


def errors_found(error: ValidationError) -> list[Any]:
    """Return the first of pydantic's errors, with no more of each than is said of it."""
    return error.errors(include_url=False)[:MAX_ERRORS]


def validation_errors(errors: Sequence[Any], before: str = "") -> list[dict[str, str]]:
    """Return pydantic's errors as pointers, behind this one, and details."""
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
    """Return the content of a body, or of the part at a pointer, as this model.

    Raises
    ------
    InvalidBodyError
        If it is not valid.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(errors_found(error), pointer)) from error


def grid_of(model: type[BaseModel], outline: Outline) -> Grid:
    """Return the points of a sweep.

    Parameters
    ----------
    model
        Request that the base and every point have to be.

    Raises
    ------
    InvalidBodyError
        If the base is not valid or an axis cannot be laid.
    """
    validated_as(model, outline.base, "/base")
    try:
        return Grid(model, outline)
    except AxisError as error:
        raise InvalidBodyError([{"pointer": error.pointer, "detail": error.detail}]) from error


@contextmanager
def errors_of_point(grid: Grid, number: int, point: Sequence[float]) -> Iterator[None]:
    """Turn what is wrong with the request of a point into an error that names its place in the sweep."""
    try:
        yield
    except (ValidationError, ParameterError) as error:
        found = field_errors(error) if isinstance(error, ParameterError) else validation_errors(errors_found(error))
        place = "at " + ", ".join(f"{field} = {value:g}" for field, value in zip(grid.fields, point, strict=True))
        errors = [{**each, "pointer": grid.pointer(number, each["pointer"])} for each in found]
        raise InvalidBodyError(errors, place) from error


def problem_of(exception: BaseException, errors: Sequence[dict[str, str]] | None = None) -> dict[str, Any]:
    """Return the problem that an exception is answered as, without its `instance`.

    Only the log has the cause of an error that is not foreseen.

    Parameters
    ----------
    errors
        What is wrong with the request; as far as the exception says when not given.
    """
    kind, found = ProblemType.of(exception), field_errors(exception) if errors is None else errors
    if found:
        detail = ": ".join(filter(None, found[0].values())) + (" (and more)" if len(found) > 1 else "")
        if isinstance(exception, InvalidBodyError) and exception.place:
            detail = f"{exception.place}: {detail}"
    else:
        detail = "The log of the service has the cause." if kind.type == ServiceError.type else str(exception)
    return kind.content(detail, found)


def case_problem(exception: BaseException) -> dict[str, Any]:
    """Return the problem of a case without an answer, and log a failure; pointers are into the case's request."""
    problem = problem_of(exception)
    if problem["type"] == ServiceError.type:
        log.error("a case failed", exc_info=exception)
    return problem
