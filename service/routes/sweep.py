"""Requests that differ in up to four numbers."""

from fastapi import APIRouter, Request, Response

from service.routes.cases import read_sweep
from service.routes.contract import MANY, one_body
from service.routes.deliver import AskedPreference, Delivery, IdempotencyKey
from service.schemas import (
    CriticalAngleBase,
    CriticalAngleResults,
    CriticalAngleSweep,
    TrajectoryBase,
    TrajectoryResults,
    TrajectorySweep,
)

router = APIRouter()


@router.post(
    "/trajectory/sweep",
    response_model=TrajectoryResults,
    responses=MANY,
    openapi_extra=one_body(TrajectorySweep),
    tags=["trajectory"],
)
async def sweep_trajectories(
    request: Request, preference: AskedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Compute a trajectory for every combination of the values of the axes, the last axis fastest.

    Up to 100,000 points. Each has to be a request: the first that is not refuses the sweep, and the problem names the
    values of its axes. What only the solver can tell of a point is the problem of that point alone.
    """
    delivery = Delivery(request, "trajectory", preference, idempotency_key)
    return await delivery.answer(await read_sweep(request, TrajectoryBase))


@router.post(
    "/cra/sweep",
    response_model=CriticalAngleResults,
    responses=MANY,
    openapi_extra=one_body(CriticalAngleSweep),
    tags=["critical ricochet angle"],
)
async def sweep_critical_angles(
    request: Request, preference: AskedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Find the critical angle for every combination of the values of the axes, the last axis fastest.

    Up to 100,000 points. Each has to be a request: the first that is not refuses the sweep, and the problem names the
    values of its axes. What only the solver can tell of a point is the problem of that point alone.
    """
    delivery = Delivery(request, "cra", preference, idempotency_key)
    return await delivery.answer(await read_sweep(request, CriticalAngleBase))
