"""How sure an angle or an outcome is: samples are cases of cache and executor like those of a batch."""

import time
from collections.abc import Generator, Sequence
from contextlib import aclosing, nullcontext
from typing import Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, Response

from service.api.body import JSON, KnownBody, next_turn, parse_json, read_body, require_type
from service.api.contract import COMPUTED, one_body
from service.api.queries import reply, validated
from service.api.services import Services, services_of
from service.auth.dependencies import RUN, RequestContext, context_in
from service.cache.record import Record
from service.errors import InvalidBodyError
from service.jobs.models import Case, CaseResult
from service.logs import BEGUN
from service.operations import UNCERTAIN, KeyedRequest, StudyOperation
from service.queries import check_work
from service.schemas import (
    CriticalAngleUncertaintyAnswer,
    CriticalAngleUncertaintyRequest,
    TrajectoryUncertaintyAnswer,
    TrajectoryUncertaintyRequest,
)

PART = 1000
"""Samples handed over at a time: other small batches get in between."""

router = APIRouter(dependencies=[RUN])


@router.post(
    "/cra/uncertainty",
    response_model=CriticalAngleUncertaintyAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(CriticalAngleUncertaintyRequest),
    tags=["critical ricochet angle"],
)
async def estimate_critical_angle(request: Request) -> Response:
    """Estimate the probability of ricochet over the oblique angle, and what the critical angle is sensitive to.

    Up to 16,384 searches, each a case that is kept and counted like any other; a request that is sent again is
    answered from the cache. A sample outside what the contract takes counts as not known and widens the intervals.
    """
    return await estimate(request, "cra_uncertainty")


@router.post(
    "/trajectory/uncertainty",
    response_model=TrajectoryUncertaintyAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(TrajectoryUncertaintyRequest),
    tags=["trajectory"],
)
async def estimate_trajectory(request: Request) -> Response:
    """Estimate the probability of each outcome of one strike, with quantiles of depth, exit speed and exit angle."""
    return await estimate(request, "trajectory_uncertainty")


async def estimate(request: Request, operation: str) -> Response:
    """Answer one request: from the cache, or by its samples."""
    services, path, begun = services_of(request), request.scope["path"], request.scope[BEGUN]
    require_type(request, JSON)
    body = await read_body(request, services.settings.max_body_bytes)
    context = context_in(request.scope)
    if not body:
        raise InvalidBodyError([{"pointer": "", "detail": "Field required"}])
    known, study = services.bodies.find(path, body), None
    if known is None:
        study = await read_study(services, body, operation)
        known = KnownBody(study[1].key, 1)
        services.bodies.remember(path, body, known)
    read = time.perf_counter()
    record = await services.queries.result(known.key)
    if record is not None:
        context.take(known.cases)
        services.metrics.count(operation, record.outcome, "hit", 1)
        return reply(record.json, "hit", f"total;dur={1e3 * (time.perf_counter() - begun):.2f}")
    case, query = study or await read_study(services, body, operation)
    with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
        answer = await run_study(services, context, UNCERTAIN[operation], case)
    record = Record(query.key, operation, query.json, answer)
    services.metrics.count(operation, record.outcome, "miss", 1)
    record = await run_sync(services.cache.put, record)
    now = time.perf_counter()
    timing = f"validate;dur={1e3 * (read - begun):.2f}, compute;dur={1e3 * (now - read):.2f}"
    return reply(record.json, "miss", f"{timing}, total;dur={1e3 * (now - begun):.2f}")


async def read_study(services: Services, body: bytes, operation: str) -> tuple[Any, KeyedRequest]:
    """Return the validated request, and its canonical form with its key."""
    await next_turn(services.parsing)
    case = validated(parse_json(body, services.settings.max_body_depth), operation, services)
    return case, KeyedRequest.of(operation, case)


async def run_study(
    services: Services, context: RequestContext, operation: StudyOperation, case: Any
) -> dict[str, Any]:
    """Return the answer to a study whose samples are computed by the executor, or were before."""
    check_work(await run_sync(operation.base, case), services.settings.max_panel_steps)
    steps = (await run_sync(case.study)).steps()
    batch, answer = await run_sync(advance, steps, None)
    while answer is None:
        requests = await run_sync(operation.requests, case, batch.points, limiter=services.reading)
        found = [operation.outside] * len(requests)
        numbers = [number for number, each in enumerate(requests) if each is not None]
        context.take(len(numbers))
        for begin in range(0, len(numbers), PART):
            part = numbers[begin : begin + PART]
            cases = [Case(each) for number in part if (each := requests[number]) is not None]
            async with aclosing(services.jobs.run_now(operation.sample, cases)) as results:
                async for result in results:
                    found[part[result.number]] = _finding(operation, result)
        batch, answer = await run_sync(advance, steps, found)
    return operation.answer(answer)


def advance(steps: Generator[Any, Any, Any], found: Sequence[Any] | None) -> tuple[Any, Any]:
    """Return the next batch of a study, or None and its answer."""
    try:
        return (next(steps) if found is None else steps.send(found)), None
    except StopIteration as end:
        return None, end.value


def _finding(operation: StudyOperation, result: CaseResult) -> Any:
    """Return what a study keeps of a sample."""
    if result.record is not None:
        return operation.finding(result.record.answer)
    invalid = (result.problem or {}).get("type") == InvalidBodyError.type
    return operation.outside if invalid else operation.failed
