"""Models of jobs and of their results in the contract."""

import re
from collections.abc import Iterable
from enum import StrEnum
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from pydantic import MISSING, AwareDatetime, BeforeValidator, Field, StringConstraints
from typing_extensions import TypeAliasType

from service.operations import OPERATIONS, Operation
from service.schemas.answers import FOUND, VERSIONED
from service.schemas.batches import Item
from service.schemas.problems import Problem
from service.schemas.quantities import Count, Part, with_examples
from service.schemas.strike import PAPER
from service.schemas.sweeps import EVEN, LISTED, Axis
from service.schemas.uncertainty_answers import PartialUncertainty, StudyProgress

ID = "0123456789abcdef0123456789abcdef"
COUNTS = {"total": 200, "done": 120, "cached": 20, "failed": 1}
LINKS = {
    "self": f"/jobs/{ID}",
    "results": f"/jobs/{ID}/results",
    "events": f"/jobs/{ID}/events",
    "cancel": f"/jobs/{ID}/cancel",
}
TITLE = "speed × strength, 80 mm, 13 kg"
RUNNING = {
    "id": ID,
    "operation": "cra",
    "status": "running",
    "counts": COUNTS,
    "title": TITLE,
    "created": "2026-01-01T12:00:00.000000Z",
    "started": "2026-01-01T12:00:01.000000Z",
    "links": LINKS,
}


class SweepRequest(Part):
    """Request for a sweep, as the client sent it."""

    model_config = with_examples({"base": PAPER, "axes": [EVEN, LISTED]})

    base: dict[str, Any]
    """Request for a single case. Each axis replaces the value of the field that it names."""
    axes: list[Axis]


LISTED_OPERATIONS = sorted(OPERATIONS.values(), key=lambda each: (each.study is not None, each.name != "trajectory"))
"""All operations in the order of the contract. Generated clients depend on the order, so it is fixed here."""


def union_of(name: str, models: Iterable[type[Part]], description: str) -> Any:
    """Return a named union of models."""
    union: Any = reduce(or_, models)
    return TypeAliasType(name, Annotated[union, Field(description=description)])


if TYPE_CHECKING:
    Result: TypeAlias = Part
    JobRequest: TypeAlias = Part
else:
    Result = union_of("Result", (each.answer for each in LISTED_OPERATIONS), "Answer of any operation.")
    """Type of the results that are stored under keys."""
    JobRequest = union_of(
        "JobRequest",
        (SweepRequest, *(each.request for each in LISTED_OPERATIONS if each.study is not None)),
        "Request of the job, absent in lists of jobs: a sweep as the client sent it, or one study of uncertainty with "
        "all defaults filled in.",
    )
    """Type of the field `request` of a job."""

Number = Annotated[Count, Field(ge=0)]
Path = Annotated[str, Field(description="Path on this service.")]


def in_jobs(operation: Operation) -> bool:
    """Return True if an operation can become a job."""
    return operation.many is not None or operation.study is not None


JobOperation = StrEnum(  # type: ignore[misc] # mypy expects the names to be literals
    "JobOperation",
    {
        **{re.sub("[^A-Z]", "_", each.name.upper()): each.name for each in LISTED_OPERATIONS if in_jobs(each)},
        "UNKNOWN": "unknown",
    },
)
JobOperation.__doc__ = (
    "Operation of every case of a job; `unknown` if its name is damaged. Each study of uncertainty is one case."
)


class JobStatus(StrEnum):
    """Status of a job: waiting (`accepted`), running, finished, failed, cancelled (`dismissed`), or unreadable."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    SUCCESSFUL = "successful"
    FAILED = "failed"
    DISMISSED = "dismissed"
    DAMAGED = "damaged"


class JobCounts(Part):
    """Numbers of cases in a job."""

    model_config = with_examples(COUNTS)

    total: Number
    done: Number
    """Number of cases with a result or a problem, including `cached` and `failed`."""
    cached: Number
    """Number of cases whose result was in the cache."""
    failed: Number
    """Number of cases that ended with a problem."""


class JobLinks(Part):
    """Paths of a job, its results, its events and its cancellation."""

    model_config = with_examples(LINKS)

    self_: Annotated[Path, Field(alias="self")]
    results: Path
    events: Path
    cancel: Path


class JobQueue(Part):
    """Place of an unfinished job in the queue, and its estimated remaining time."""

    model_config = with_examples({"jobs_ahead": 1, "remaining_s": 12})

    jobs_ahead: Number
    """Number of jobs of the same owner that run before this one: jobs with fewer cases left, and older jobs with as
    many."""
    remaining_s: Number
    """Estimated time until the job ends, at the rate of the last half minute; 3600 means an hour or more."""


UNSHOWN = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Characters removed from titles: control characters, line ends and marks that change the writing direction. They could
falsify the display of a title in a terminal or a list of jobs."""
Title = Annotated[
    str,
    StringConstraints(strict=True, strip_whitespace=True, min_length=1, max_length=200),
    BeforeValidator(lambda given: UNSHOWN.sub("", given) if isinstance(given, str) else given),
]


class JobChange(Part):
    """Fields of a job that can be changed."""

    model_config = with_examples({"title": TITLE})

    title: Title
    """New title."""


class Job(Part):
    """Work that continues after its request has been answered."""

    model_config = with_examples(RUNNING)

    id: str
    """Unique id that cannot be guessed."""
    operation: JobOperation
    status: JobStatus
    counts: JobCounts
    title: str | MISSING = MISSING
    """Title given by the client. The default title of a sweep names its axes and the projectile."""
    created: AwareDatetime
    """Time at which the job was accepted."""
    started: AwareDatetime | MISSING = MISSING
    """Time at which the job began to run."""
    finished: AwareDatetime | MISSING = MISSING
    """Time at which the job ended."""
    expires: AwareDatetime | MISSING = MISSING
    """Time at which the job will be removed. Its results may be kept longer under their keys."""
    queue: JobQueue | MISSING = MISSING
    """Place in the queue and remaining time of an unfinished job; absent in events and in the answer to `PATCH`."""
    problem: Problem | MISSING = MISSING
    """Reason why the job failed or is damaged."""
    axes: list[str] | MISSING = MISSING
    """Fields that a sweep varies."""
    request: JobRequest | MISSING = MISSING
    progress: StudyProgress | MISSING = MISSING
    """Progress of a job that consists of one study of uncertainty and has begun."""
    partial: PartialUncertainty | MISSING = MISSING
    """Answer so far of a job that consists of one study and has not succeeded; absent in lists of jobs."""
    links: JobLinks


class Jobs(Part):
    """One page of the list of jobs, newest first."""

    model_config = with_examples({"jobs": [RUNNING], "next": "MTIz"})

    jobs: list[Job]
    next: str | MISSING = MISSING
    """Cursor of the page with older jobs; absent on the last page."""


class JobItem(Item):
    """One case of a job, with its result or its problem."""

    model_config = with_examples({"index": 0, "custom_id": "paper", "result": FOUND | VERSIONED})

    result: Result | MISSING = MISSING


class JobResults(Part):
    """One page of the available results of a job, in the order of the request."""

    model_config = with_examples({"results": [{"index": 0, "result": FOUND | VERSIONED}], "next": "MQ"})

    results: list[JobItem]
    next: str | MISSING = MISSING
    """Cursor of the next page; absent once all results have been returned."""
