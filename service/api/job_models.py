"""Jobs and results of any operation, as the contract has them."""

import re
from collections.abc import Iterable
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, Union

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
    """A sweep as it was sent."""

    model_config = with_examples({"base": PAPER, "axes": [EVEN, LISTED]})

    base: dict[str, Any]
    """A request, in which the axes set their fields anew."""
    axes: list[Axis]


LISTED_OPERATIONS = sorted(OPERATIONS.values(), key=lambda each: (each.study is not None, each.name != "trajectory"))
"""All operations in the order of the contract, which generated clients keep."""


def union_of(name: str, models: Iterable[type[Part]], description: str) -> Any:
    """Return the type of what is one of these."""
    union: Any = Union.__getitem__(tuple(models))
    return TypeAliasType(name, Annotated[union, Field(description=description)])


if TYPE_CHECKING:
    Result: TypeAlias = Part
    JobRequest: TypeAlias = Part
else:
    Result = union_of("Result", (each.answer for each in LISTED_OPERATIONS), "Any answer.")
    """What a key may stand for."""
    JobRequest = union_of(
        "JobRequest",
        (SweepRequest, *(each.request for each in LISTED_OPERATIONS if each.study is not None)),
        "What a job computes, not in lists of jobs: a sweep as it was sent, or a study of uncertainty with every "
        "default filled in.",
    )
    """Body that made a job."""

Number = Annotated[Count, Field(ge=0)]
Path = Annotated[str, Field(description="Path at this service.")]


def in_jobs(operation: Operation) -> bool:
    """Return whether there are jobs of an operation."""
    return operation.many is not None or operation.study is not None


JobOperation = StrEnum(  # type: ignore[misc] # mypy wants the names here
    "JobOperation",
    {
        **{re.sub("[^A-Z]", "_", each.name.upper()): each.name for each in LISTED_OPERATIONS if in_jobs(each)},
        "UNKNOWN": "unknown",
    },
)
JobOperation.__doc__ = (
    "What every case of a job computes; `unknown` if that is damaged. A study of uncertainty is one case."
)


class JobStatus(StrEnum):
    """`accepted` waits, `running` has begun; the others are final: all cases done, given up, cancelled, unreadable."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    SUCCESSFUL = "successful"
    FAILED = "failed"
    DISMISSED = "dismissed"
    DAMAGED = "damaged"


class JobCounts(Part):
    """Cases of a job."""

    model_config = with_examples(COUNTS)

    total: Number
    done: Number
    """With a result or a problem, the next two included."""
    cached: Number
    """Whose result was there already."""
    failed: Number
    """With a problem."""


class JobLinks(Part):
    """Paths of a job."""

    model_config = with_examples(LINKS)

    self_: Annotated[Path, Field(alias="self")]
    results: Path
    events: Path
    cancel: Path


class JobQueue(Part):
    """Place of a job that has not ended, and when it is likely to have."""

    model_config = with_examples({"jobs_ahead": 1, "remaining_s": 12})

    jobs_ahead: Number
    """Jobs of the same owner that are computed first, because they have fewer cases left."""
    remaining_s: Number
    """Time until the job is likely to have ended, at the rate of the last half minute; 3600 is an hour or more."""


UNSHOWN = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Control characters, and those that end a line or turn the direction of what follows them."""
Title = Annotated[
    str,
    StringConstraints(strict=True, strip_whitespace=True, min_length=1, max_length=200),
    BeforeValidator(lambda given: UNSHOWN.sub("", given) if isinstance(given, str) else given),
]


class JobChange(Part):
    """What may be changed of a job."""

    model_config = with_examples({"title": TITLE})

    title: Title
    """In place of the one it has."""


class Job(Part):
    """Work that goes on after its request has been answered."""

    model_config = with_examples(RUNNING)

    id: str
    """Unique, and not to be guessed."""
    operation: JobOperation
    status: JobStatus
    counts: JobCounts
    title: str | MISSING = MISSING
    """As given; of a sweep otherwise what varies, and the projectile."""
    created: AwareDatetime
    """When it was accepted."""
    started: AwareDatetime | MISSING = MISSING
    """When it was begun."""
    finished: AwareDatetime | MISSING = MISSING
    """When it ended."""
    expires: AwareDatetime | MISSING = MISSING
    """When it is removed; its results may stay longer, by their keys."""
    queue: JobQueue | MISSING = MISSING
    """Place and estimate, unless it has ended; not in events."""
    problem: Problem | MISSING = MISSING
    """Why it failed."""
    axes: list[str] | MISSING = MISSING
    """Fields that vary, if it is a sweep."""
    request: JobRequest | MISSING = MISSING
    progress: StudyProgress | MISSING = MISSING
    """How far it is, if it is a study of uncertainty that has begun."""
    partial: PartialUncertainty | MISSING = MISSING
    """Answer so far, if it is a study that has not finished; not in lists of jobs."""
    links: JobLinks


class Jobs(Part):
    """A page of jobs, the newest first."""

    model_config = with_examples({"jobs": [RUNNING], "next": "MTIz"})

    jobs: list[Job]
    next: str | MISSING = MISSING
    """Cursor of the page with older jobs, if there are any."""


class JobItem(Item):
    """What became of one case of a job: its result, or the problem that kept it from having one."""

    model_config = with_examples({"index": 0, "custom_id": "paper", "result": FOUND | VERSIONED})

    result: Result | MISSING = MISSING


class JobResults(Part):
    """Results of a job that are ready, in the order of the request."""

    model_config = with_examples({"results": [{"index": 0, "result": FOUND | VERSIONED}], "next": "MQ"})

    results: list[JobItem]
    next: str | MISSING = MISSING
    """Cursor of the page that follows; absent once there is nothing more to come."""
