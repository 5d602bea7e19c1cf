"""Many cases in one request: batches, and sweeps over up to four numbers."""

from fastapi import APIRouter, Request, Response

from service.api.batch_body import BatchReader
from service.api.batch_response import BatchResponse, IdempotencyKey, WantedPreference
from service.api.contract import MANY, many_bodies, one_body
from service.auth.dependencies import RUN
from service.schemas import (
    CriticalAngleBase,
    CriticalAngleBatch,
    CriticalAngleCase,
    CriticalAngleResults,
    CriticalAngleSweep,
    TrajectoryBase,
    TrajectoryBatch,
    TrajectoryCase,
    TrajectoryResults,
    TrajectorySweep,
)

router = APIRouter(dependencies=[RUN])


@router.post(
    "/trajectory/batch",
    response_model=TrajectoryResults,
    responses=MANY,
    openapi_extra=many_bodies(TrajectoryBatch, TrajectoryCase),
    tags=["trajectory"],
)
async def compute_trajectories(
    request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Compute the motion of many projectiles: up to 1,000 as JSON, up to 100,000 as JSON lines.

    Histories are given only if a case asks for its own. A case that is no request refuses the whole batch, and the
    problem names it: `/cases/17/...` in JSON, counted from 0; the line in JSONL, counted from 1 in words and from 0
    in the pointer. What only the solver can tell of a line is the problem of that case alone.
    """
    response = BatchResponse(request, "trajectory", preference, idempotency_key)
    return await response.to(await BatchReader(request, "trajectory", TrajectoryCase).read_batch())


@router.post(
    "/cra/batch",
    response_model=CriticalAngleResults,
    responses=MANY,
    openapi_extra=many_bodies(CriticalAngleBatch, CriticalAngleCase),
    tags=["critical ricochet angle"],
)
async def find_critical_angles(
    request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Find many critical angles: up to 1,000 as JSON, up to 100,000 as JSON lines.

    A case that is no request refuses the whole batch, and the problem names it: `/cases/17/...` in JSON, counted
    from 0; the line in JSONL, counted from 1 in words and from 0 in the pointer. What only the solver can tell of a
    line is the problem of that case alone.
    """
    response = BatchResponse(request, "cra", preference, idempotency_key)
    return await response.to(await BatchReader(request, "cra", CriticalAngleCase).read_batch())


@router.post(
    "/trajectory/sweep",
    response_model=TrajectoryResults,
    responses=MANY,
    openapi_extra=one_body(TrajectorySweep),
    tags=["trajectory"],
)
async def sweep_trajectories(
    request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Compute a trajectory for every combination of the values of the axes, the last axis fastest.

    Up to 100,000 points. Each has to be a request: the first that is not refuses the sweep, and the problem names the
    values of its axes. What only the solver can tell of a point is the problem of that point alone.
    """
    response = BatchResponse(request, "trajectory", preference, idempotency_key)
    return await response.to(await BatchReader(request, "trajectory", TrajectoryBase).read_sweep())


@router.post(
    "/cra/sweep",
    response_model=CriticalAngleResults,
    responses=MANY,
    openapi_extra=one_body(CriticalAngleSweep),
    tags=["critical ricochet angle"],
)
async def sweep_critical_angles(
    request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Find the critical angle for every combination of the values of the axes, the last axis fastest.

    Up to 100,000 points. Each has to be a request: the first that is not refuses the sweep, and the problem names the
    values of its axes. What only the solver can tell of a point is the problem of that point alone.
    """
    response = BatchResponse(request, "cra", preference, idempotency_key)
    return await response.to(await BatchReader(request, "cra", CriticalAngleBase).read_sweep())
