"""Batches and jobs: requests of many cases, and the state and results of a job."""

from enum import StrEnum
from typing import Annotated, Any

from pydantic import MISSING, AwareDatetime, Field, StringConstraints
from typing_extensions import TypeAliasType

from service.schemas.answers import FOUND, RUN, VERSIONED, CriticalAngleAnswer, TrajectoryAnswer
from service.schemas.calibration import DepthCalibrationAnswer, MotionCalibrationAnswer, ObliquityCalibrationAnswer
from service.schemas.examples import PAPER, PAPER_AT_45
from service.schemas.problems import INVALID, Problem
from service.schemas.quantities import Count, Flag, Num, Part, with_examples
from service.schemas.requests import CriticalAngleBase, TrajectoryFields, TrajectoryOutput
from service.schemas.sweeps import EVEN, LISTED, Axis

MOST_CASES = 1_000
"""Of a JSON batch, which is parsed in one piece."""
MOST_LINES = 100_000
"""Of a JSONL batch, and points of a sweep."""

CustomId = Annotated[
    str,
    StringConstraints(strict=True, min_length=1, max_length=128),
    Field(description="Given back with the result. It need not be unique, though it serves better if it is."),
]
Index = Annotated[Count, Field(ge=0, description="Of the case in the request, from 0.")]


class BatchOutput(TrajectoryOutput):
    """What the answer to a trajectory among many holds."""

    model_config = with_examples({"history": True, "sample_interval_s": 1e-4})

    history: Annotated[
        Flag, Field(description="Whether to give the motion over time; not among many, unless asked for.")
    ] = False


class TrajectoryBase(TrajectoryFields):
    """One strike among many: as a single one, but without a history unless asked for."""

    model_config = with_examples(PAPER_AT_45)

    output: Annotated[BatchOutput, Field(default_factory=BatchOutput)]


class TrajectoryCase(TrajectoryBase):
    """A case of a batch of trajectories."""

    model_config = with_examples(PAPER_AT_45 | {"custom_id": "shot-1"})

    custom_id: CustomId | MISSING = MISSING

    def canonical(self) -> dict[str, Any]:
        """Return the resolved request as JSON data, as the same case gives it alone."""
        return self.resolved().model_dump(mode="json", exclude={"custom_id"})


class CriticalAngleCase(CriticalAngleBase):
    """A case of a batch of critical angles."""

    model_config = with_examples(PAPER | {"custom_id": "paper"})

    custom_id: CustomId | MISSING = MISSING

    def canonical(self) -> dict[str, Any]:
        """Return the resolved request as JSON data, as the same case gives it alone."""
        return self.resolved().model_dump(mode="json", exclude={"custom_id"})


class TrajectoryBatch(Part):
    """Trajectories to compute."""

    model_config = with_examples({"cases": [PAPER_AT_45, PAPER_AT_45 | {"custom_id": "again"}]})

    cases: Annotated[list[TrajectoryCase], Field(min_length=1, max_length=MOST_CASES)]


class CriticalAngleBatch(Part):
    """Critical angles to find."""

    model_config = with_examples({"cases": [PAPER, PAPER | {"custom_id": "again"}]})

    cases: Annotated[list[CriticalAngleCase], Field(min_length=1, max_length=MOST_CASES)]


class Cases(Part):
    """A batch before its cases are looked at."""

    cases: Annotated[list[Any], Field(min_length=1, max_length=MOST_CASES)]


class Item(Part):
    """What became of one case: its result, or the problem that kept it from having one."""

    index: Index
    custom_id: CustomId | MISSING = MISSING
    point: (
        Annotated[dict[str, Num], Field(description="Of a sweep: the values of its axes, by their fields.")] | MISSING
    ) = MISSING
    problem: Annotated[Problem, Field(description="Why there is no result.")] | MISSING = MISSING


class TrajectoryItem(Item):
    """What became of one trajectory: its result, or the problem that kept it from having one."""

    model_config = with_examples({"index": 0, "custom_id": "shot-1", "result": RUN | VERSIONED})

    result: TrajectoryAnswer | MISSING = MISSING


class CriticalAngleItem(Item):
    """What became of one critical angle: its result, or the problem that kept it from having one."""

    model_config = with_examples({"index": 0, "result": FOUND | VERSIONED}, {"index": 1, "problem": INVALID})

    result: CriticalAngleAnswer | MISSING = MISSING


class TrajectoryResults(Part):
    """Trajectories, in the order of the request."""

    model_config = with_examples({"results": [{"index": 0, "result": RUN | VERSIONED}]})

    results: list[TrajectoryItem]


class CriticalAngleResults(Part):
    """Critical angles, in the order of the request."""

    model_config = with_examples({"results": [{"index": 0, "result": FOUND | VERSIONED}]})

    results: list[CriticalAngleItem]


ID = "0123456789abcdef0123456789abcdef"
COUNTS = {"total": 200, "done": 120, "cached": 20, "failed": 1}
LINKS = {
    "self": f"/jobs/{ID}",
    "results": f"/jobs/{ID}/results",
    "events": f"/jobs/{ID}/events",
    "cancel": f"/jobs/{ID}/cancel",
}
RUNNING = {
    "id": ID,
    "operation": "cra",
    "status": "running",
    "counts": COUNTS,
    "created": "2026-01-01T12:00:00.000000Z",
    "started": "2026-01-01T12:00:01.000000Z",
    "links": LINKS,
}

Result = TypeAliasType(
    "Result",
    Annotated[
        TrajectoryAnswer
        | CriticalAngleAnswer
        | DepthCalibrationAnswer
        | MotionCalibrationAnswer
        | ObliquityCalibrationAnswer,
        Field(description="Any answer."),
    ],
)
"""What a key may stand for."""
Number = Annotated[Count, Field(ge=0)]
Path = Annotated[str, Field(description="Path at this service.")]


class JobOperation(StrEnum):
    """What every case of a job asks for."""

    TRAJECTORY = "trajectory"
    CRA = "cra"


class JobStatus(StrEnum):
    """`accepted` waits, `running` has begun; the others are final: all cases done, given up, cancelled."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    SUCCESSFUL = "successful"
    FAILED = "failed"
    DISMISSED = "dismissed"


class JobCounts(Part):
    """Cases of a job."""

    model_config = with_examples(COUNTS)

    total: Number
    done: Annotated[Number, Field(description="With a result or a problem, the next two included.")]
    cached: Annotated[Number, Field(description="Whose result was there already.")]
    failed: Annotated[Number, Field(description="With a problem.")]


class JobLinks(Part):
    """Where a job is asked about."""

    model_config = with_examples(LINKS)

    self_: Annotated[Path, Field(alias="self")]
    results: Path
    events: Path
    cancel: Path


class SweepRequest(Part):
    """A sweep as it was sent."""

    model_config = with_examples({"base": PAPER, "axes": [EVEN, LISTED]})

    base: Annotated[dict[str, Any], Field(description="A request, in which the axes set their fields anew.")]
    axes: list[Axis]


class Job(Part):
    """Work that goes on after its request has been answered."""

    model_config = with_examples(RUNNING)

    id: Annotated[str, Field(description="Unique, and not to be guessed.")]
    operation: JobOperation
    status: JobStatus
    counts: JobCounts
    created: Annotated[AwareDatetime, Field(description="When it was accepted.")]
    started: Annotated[AwareDatetime, Field(description="When it was begun.")] | MISSING = MISSING
    finished: Annotated[AwareDatetime, Field(description="When it ended.")] | MISSING = MISSING
    expires: (
        Annotated[AwareDatetime, Field(description="When it is removed; its results may stay longer, by their keys.")]
        | MISSING
    ) = MISSING
    problem: Annotated[Problem, Field(description="Why it failed.")] | MISSING = MISSING
    axes: Annotated[list[str], Field(description="Fields that vary, if it is a sweep.")] | MISSING = MISSING
    request: (
        Annotated[SweepRequest, Field(description="The sweep that it computes, as it was sent; not in lists of jobs.")]
        | MISSING
    ) = MISSING
    links: JobLinks


class Jobs(Part):
    """Jobs, the newest first."""

    model_config = with_examples({"jobs": [RUNNING]})

    jobs: list[Job]


class JobItem(Item):
    """What became of one case of a job: its result, or the problem that kept it from having one."""

    model_config = with_examples({"index": 0, "custom_id": "paper", "result": FOUND | VERSIONED})

    result: Result | MISSING = MISSING


class JobResults(Part):
    """Results of a job that are ready, in the order of the request."""

    model_config = with_examples({"results": [{"index": 0, "result": FOUND | VERSIONED}], "next": "MQ"})

    results: list[JobItem]
    next: (
        Annotated[
            str,
            Field(description="Cursor of the page that follows; absent once there is nothing more to come."),
        ]
        | MISSING
    ) = MISSING
