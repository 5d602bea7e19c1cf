"""Many cases in one request: batches, and sweeps over up to four numbers, of each operation that has them."""

from dataclasses import dataclass

from fastapi import APIRouter, Request, Response

from service.api.batch_body import BatchReader
from service.api.batch_response import BatchResponse, IdempotencyKey, WantedPreference
from service.api.contract import MANY, many_bodies, one_body
from service.auth.dependencies import RUN
from service.operations import WALL_CASES
from service.schemas import (
    CriticalAngleBase,
    CriticalAngleBatch,
    CriticalAngleCase,
    CriticalAngleResults,
    CriticalAngleSweep,
    LimitSpeedBatch,
    LimitSpeedCase,
    LimitSpeedRequest,
    LimitSpeedResults,
    LimitSpeedSweep,
    ThicknessBatch,
    ThicknessCase,
    ThicknessRequest,
    ThicknessResults,
    ThicknessSweep,
    TrajectoryBase,
    TrajectoryBatch,
    TrajectoryCase,
    TrajectoryResults,
    TrajectorySweep,
)
from service.schemas.quantities import Part


@dataclass(frozen=True, slots=True)
class ManyCases:
    """Routes for many cases of one operation.

    Parameters
    ----------
    operation
        Operation of every case.
    tag
        Group of routes in the contract.
    batch, case, sweep, base, results
        Models: body of a batch and its cases, body of a sweep and its points, answer of both.
    batch_name, sweep_name
        Names of the routes, which are their operation ids.
    batch_summary, sweep_summary
        First words of their descriptions.
    note
        Further sentence of the description of a batch.
    """

    operation: str
    tag: str
    batch: type[Part]
    case: type[Part]
    sweep: type[Part]
    base: type[Part]
    results: type[Part]
    batch_name: str
    batch_summary: str
    sweep_name: str
    sweep_summary: str
    note: str = ""


SEARCH_NOTE = f"A case counts as {WALL_CASES} against a quota, as many as the runs of its search."
MANY_CASES = (
    ManyCases(
        "trajectory",
        "trajectory",
        TrajectoryBatch,
        TrajectoryCase,
        TrajectorySweep,
        TrajectoryBase,
        TrajectoryResults,
        "compute_trajectories",
        "Compute the motion of many projectiles",
        "sweep_trajectories",
        "Compute a trajectory",
        "Histories are given only if a case requests its own.",
    ),
    ManyCases(
        "cra",
        "critical ricochet angle",
        CriticalAngleBatch,
        CriticalAngleCase,
        CriticalAngleSweep,
        CriticalAngleBase,
        CriticalAngleResults,
        "find_critical_angles",
        "Find many critical angles",
        "sweep_critical_angles",
        "Find the critical angle",
    ),
    ManyCases(
        "thickness",
        "walls",
        ThicknessBatch,
        ThicknessCase,
        ThicknessSweep,
        ThicknessRequest,
        ThicknessResults,
        "find_least_thicknesses",
        "Find the least thickness of a wall for many strikes",
        "sweep_least_thicknesses",
        "Find the least thickness of a wall",
        SEARCH_NOTE,
    ),
    ManyCases(
        "limit-speed",
        "walls",
        LimitSpeedBatch,
        LimitSpeedCase,
        LimitSpeedSweep,
        LimitSpeedRequest,
        LimitSpeedResults,
        "find_limit_speeds",
        "Find many limit speeds",
        "sweep_limit_speeds",
        "Find the limit speed",
        SEARCH_NOTE,
    ),
)
"""Operations that take many cases in one request."""

router = APIRouter(dependencies=[RUN])


def add_batch(many: ManyCases) -> None:
    """Add the route for batches of an operation."""

    async def compute_batch(
        request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
    ) -> Response:
        response = BatchResponse(request, many.operation, preference, idempotency_key)
        return await response.to(await BatchReader(request, many.operation, many.case).read_batch())

    router.post(
        f"/{many.operation}/batch",
        name=many.batch_name,
        description=f"{many.batch_summary}: up to 1,000 as JSON, up to 100,000 as JSON lines.\n\n"
        f"{many.note}{' ' * bool(many.note)}"
        "A case that is no request refuses the whole batch, and the problem names it: `/cases/17/...` in JSON, counted "
        "from 0; the line in JSONL, counted from 1 in words and from 0 in the pointer. What only the solver finds "
        "of a line is the problem of that case alone.",
        response_model=many.results,
        responses=MANY,
        openapi_extra=many_bodies(many.batch, many.case),
        tags=[many.tag],
    )(compute_batch)


def add_sweep(many: ManyCases) -> None:
    """Add the route for sweeps of an operation."""

    async def compute_sweep(
        request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
    ) -> Response:
        response = BatchResponse(request, many.operation, preference, idempotency_key)
        return await response.to(await BatchReader(request, many.operation, many.base).read_sweep())

    router.post(
        f"/{many.operation}/sweep",
        name=many.sweep_name,
        description=f"{many.sweep_summary} for every combination of the values of the axes, the last axis fastest."
        "\n\nUp to 100,000 points. Each has to be a request: the first that is not refuses the sweep, and the problem "
        "names the values of its axes. What only the solver finds of a point is the problem of that point alone.",
        response_model=many.results,
        responses=MANY,
        openapi_extra=one_body(many.sweep),
        tags=[many.tag],
    )(compute_sweep)


for add in (add_batch, add_sweep):
    for each in MANY_CASES:
        add(each)
