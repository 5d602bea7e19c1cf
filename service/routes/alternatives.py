"""Single queries, with the same case under other laws if wanted: each a case of cache and pool like any other."""

import asyncio
import time
from http import HTTPStatus
from typing import Any

from fastapi import Request, Response

from service.access.visit import visit_in
from service.admission import check_work
from service.engine import CacheStatus, Engine
from service.kinds import kind_of, problem_of
from service.routes.contract import answered, computed, reply
from service.schemas import CriticalAngleRequest, TrajectoryRequest
from service.schemas.alternatives import alternative_requests, answered_alternative, with_alternatives


async def computed_with_alternatives(
    request: Request, operation: str, case: TrajectoryRequest | CriticalAngleRequest, engine: Engine
) -> Response:
    """Reply with the result of a single query; if it wants alternatives, each of them counts as a case too."""
    if not case.alternatives:
        return await computed(request, operation, case, engine)
    validated = time.perf_counter()
    others = alternative_requests(case)
    check_work(case, request.app.state.settings.max_panel_steps)
    visit_in(request.scope).take(1 + len(others))

    async def attempt(laws: dict[str, Any], other: Any) -> tuple[dict[str, Any], CacheStatus]:
        try:
            record, status = await answered(request, operation, other, engine)
        except Exception as error:
            if kind_of(error).status != HTTPStatus.UNPROCESSABLE_ENTITY:
                raise
            return {**laws, "problem": {**problem_of(error), "instance": request.scope["path"]}}, "miss"
        return answered_alternative(laws, record.answer), status

    (record, status), *found = await asyncio.gather(
        answered(request, operation, case, engine), *(attempt(laws, other) for laws, other in others)
    )
    content = with_alternatives(record.json, [alternative for alternative, _ in found])
    known = all(each == "hit" for each in (status, *(each for _, each in found)))
    return reply(request, content, "hit" if known else "miss", validated)
