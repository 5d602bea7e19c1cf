"""One trajectory."""

from fastapi import APIRouter, Request, Response

from service.engine import Operation
from service.pool.worker import run_trajectory
from service.routes.alternatives import computed_with_alternatives
from service.routes.body import JsonRoute
from service.routes.contract import COMPUTED, AskedEngine
from service.schemas import TrajectoryAnswer, TrajectoryRequest, trajectory_answer

router = APIRouter(route_class=JsonRoute, tags=["trajectory"])

TRAJECTORY = Operation(
    call=lambda case: (run_trajectory, (case.arguments(),)),
    answer=lambda _, trajectory: trajectory_answer(trajectory),
    parse=TrajectoryRequest.model_validate_json,
)


@router.post("/trajectory", response_model=TrajectoryAnswer, responses=COMPUTED)
async def compute_trajectory(request: Request, case: TrajectoryRequest, engine: AskedEngine) -> Response:
    """Compute the motion of a projectile from first contact until it is turned away, at rest, or out of time."""
    return await computed_with_alternatives(request, "trajectory", case, engine)
