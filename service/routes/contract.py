"""What the operations of the contract have in common: the engine they ask, the problems they may answer."""

from typing import Annotated, Any, TypeAlias

from fastapi import Depends, Request, Response

from service.engine import CacheStatus, Engine
from service.problems import Problem
from service.record import Record

Responses: TypeAlias = dict[int | str, dict[str, Any]]

CACHE_STATUS = {
    "Cache-Status": {
        "description": "`ricochet; hit` if the result was there, `ricochet; fwd=miss` if it was computed (RFC 9211).",
        "schema": {"type": "string"},
        "required": True,
    }
}
RESULT_LINK = {
    "result": {
        "operationId": "get_result",
        "parameters": {"key": "$response.body#/key"},
        "description": "The result again, also as a table.",
    }
}


RETRY_AFTER = {
    "Retry-After": {"description": "When to ask again. [s]", "schema": {"type": "integer"}, "required": True}
}
PROBLEMS: Responses = {
    400: {"description": "The body cannot be parsed."},
    404: {"description": "Nothing is kept under this key."},
    406: {"description": "The result is not given in a form that `Accept` asks for."},
    413: {"description": "The body is too long."},
    415: {"description": "The body is not `application/json`."},
    422: {"description": "A field is wrong, or the case cannot be computed."},
    500: {"description": "The service failed."},
    503: {"description": "The service is not ready, or has no worker for the query.", "headers": RETRY_AFTER},
}


def problems(*statuses: int) -> Responses:
    """Return the declarations of these error statuses."""
    return {status: {"model": Problem, **PROBLEMS[status]} for status in statuses}


COMPUTED: Responses = {
    200: {"description": "The answer.", "headers": CACHE_STATUS, "links": RESULT_LINK},
    **problems(400, 413, 415, 422, 500, 503),
}


async def engine_of(request: Request) -> Engine:
    """Return the engine of the running application. Asynchronous, as FastAPI runs other functions in a thread."""
    engine: Engine = request.app.state.engine
    return engine


AskedEngine = Annotated[Engine, Depends(engine_of)]


def computed(record: Record, status: CacheStatus) -> Response:
    """Reply with a result."""
    header = "ricochet; hit" if status == "hit" else "ricochet; fwd=miss"
    return Response(record.json, media_type="application/json", headers={"Cache-Status": header})
