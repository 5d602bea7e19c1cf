"""Many cases in one request."""

from fastapi import APIRouter, Request, Response

from service.routes.cases import read_batch
from service.routes.contract import MANY, many_bodies
from service.routes.deliver import AskedPreference, Delivery, IdempotencyKey
from service.schemas import (
    CriticalAngleBatch,
    CriticalAngleCase,
    CriticalAngleResults,
    TrajectoryBatch,
    TrajectoryCase,
    TrajectoryResults,
)

router = APIRouter()


@router.post(
    "/trajectory/batch",
    response_model=TrajectoryResults,
    responses=MANY,
    openapi_extra=many_bodies(TrajectoryBatch, TrajectoryCase),
    tags=["trajectory"],
)
async def compute_trajectories(
    request: Request, preference: AskedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Compute the motion of many projectiles: up to 1,000 as JSON, up to 100,000 as JSON lines.

    Histories are given only if a case asks for its own. A case that is no request refuses the whole batch, and the
    problem tells which: `/cases/17/...` in JSON, counted from 0; the line in JSONL, counted from 1 in words and from 0
    in the pointer. What only the solver can tell of a line is the problem of that case alone.
    """
    delivery = Delivery(request, "trajectory", preference, idempotency_key)
    return await delivery.answer(await read_batch(request, TrajectoryCase))


@router.post(
    "/cra/batch",
    response_model=CriticalAngleResults,
    responses=MANY,
    openapi_extra=many_bodies(CriticalAngleBatch, CriticalAngleCase),
    tags=["critical ricochet angle"],
)
async def find_critical_angles(
    request: Request, preference: AskedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Find many critical angles: up to 1,000 as JSON, up to 100,000 as JSON lines.

    A case that is no request refuses the whole batch, and the problem tells which: `/cases/17/...` in JSON, counted
    from 0; the line in JSONL, counted from 1 in words and from 0 in the pointer. What only the solver can tell of a
    line is the problem of that case alone.
    """
    delivery = Delivery(request, "cra", preference, idempotency_key)
    return await delivery.answer(await read_batch(request, CriticalAngleCase))
