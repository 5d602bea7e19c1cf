"""One critical ricochet angle."""

from fastapi import APIRouter, Request, Response

from service.engine import Operation
from service.pool.worker import run_cra
from service.routes.alternatives import computed_with_alternatives
from service.routes.body import JsonRoute
from service.routes.contract import COMPUTED, AskedEngine
from service.schemas import CriticalAngleAnswer, CriticalAngleRequest, critical_angle_answer

router = APIRouter(route_class=JsonRoute, tags=["critical ricochet angle"])

CRITICAL_ANGLE = Operation(
    call=lambda case: (run_cra, case.arguments()),
    answer=lambda _, case: critical_angle_answer(case.found, case.trajectory),
    parse=CriticalAngleRequest.model_validate_json,
)


@router.post("/cra", response_model=CriticalAngleAnswer, responses=COMPUTED)
async def find_critical_angle(request: Request, case: CriticalAngleRequest, engine: AskedEngine) -> Response:
    """Find the smallest oblique angle, from the normal, at which a projectile is turned away.

    That there is none in the range is an answer too, and told by its `status`.
    """
    return await computed_with_alternatives(request, "cra", case, engine)
