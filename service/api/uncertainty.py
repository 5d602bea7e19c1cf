"""How sure an angle or an outcome is: samples are cases of cache and executor like those of a batch."""

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator, Coroutine
from contextlib import nullcontext
from http import HTTPStatus
from typing import Any, TypeVar

from anyio.to_thread import run_sync
from fastapi import APIRouter, HTTPException, Request, Response

from service.api.batch_response import IdempotencyKey, JobResponse, WantedPreference
from service.api.body import JSON, KnownBody, Preference, next_turn, parse_json, read_body, require_type
from service.api.contract import STUDIED, one_body
from service.api.queries import reply, validated
from service.api.services import Services, services_of
from service.auth.dependencies import RUN, RequestContext, context_in
from service.errors import InvalidBodyError, PoolUnavailableError
from service.jobs.models import Case
from service.operations import UNCERTAIN, KeyedRequest
from service.queries import check_work
from service.schemas import (
    CriticalAngleUncertaintyAnswer,
    CriticalAngleUncertaintyRequest,
    TrajectoryUncertaintyAnswer,
    TrajectoryUncertaintyRequest,
)
from service.telemetry import BEGUN

Result = TypeVar("Result")

router = APIRouter(dependencies=[RUN])


@router.post(
    "/cra/uncertainty",
    response_model=CriticalAngleUncertaintyAnswer,
    responses=STUDIED,
    openapi_extra=one_body(CriticalAngleUncertaintyRequest),
    tags=["critical ricochet angle"],
)
async def estimate_critical_angle(
    request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Estimate the probability of ricochet over the oblique angle, and what the critical angle is sensitive to.

    Up to 131,072 searches, each a case that is kept and counted like any other; a request that is sent again is
    answered from the cache. `max_samples` above 16,384 (unless the service is set otherwise) or `Prefer:
    respond-async` makes a job, which counts as `max_samples` cases until it ends, then as the samples it has taken. A
    sample outside the accepted range counts as not known and widens the intervals.
    """
    return await estimate(request, "cra_uncertainty", preference, idempotency_key)


@router.post(
    "/trajectory/uncertainty",
    response_model=TrajectoryUncertaintyAnswer,
    responses=STUDIED,
    openapi_extra=one_body(TrajectoryUncertaintyRequest),
    tags=["trajectory"],
)
async def estimate_trajectory(
    request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = ""
) -> Response:
    """Estimate the probability of each outcome of one strike, with quantiles of depth, exit speed and exit angle.

    What is answered at once and what becomes a job is as with critical angles.
    """
    return await estimate(request, "trajectory_uncertainty", preference, idempotency_key)


async def estimate(request: Request, operation: str, preference: Preference, idempotency_key: str) -> Response:
    """Answer one request: from the cache, by its samples, or with a job."""
    services, path, begun = services_of(request), request.scope["path"], request.scope[BEGUN]
    require_type(request, JSON)
    body = await read_body(request, services.settings.max_body_bytes)
    context = context_in(request.scope)
    known, study = services.bodies.find(path, body), None
    if known is None:
        study = await read_study(services, body, operation)
        known = KnownBody(study[1].key, 1)
        services.bodies.remember(path, body, known)
    read = time.perf_counter()
    record = None if preference.respond_async else await services.queries.result(known.key)
    if record is not None:
        context.take(known.cases)
        services.metrics.count(operation, record.outcome, "hit", 1)
        return reply(record.json, "hit", f"total;dur={1e3 * (time.perf_counter() - begun):.2f}")
    case, query = study or await read_study(services, body, operation)
    check_work(await run_sync(UNCERTAIN[operation].base, case), services.settings.max_panel_steps)
    if preference.respond_async or case.sampling.max_samples > services.settings.small_samples:
        digest = hashlib.sha256(f"{path} {JSON}\n".encode() + body).hexdigest()
        job = JobResponse(request, operation, preference, idempotency_key)
        return await answer_with_job(services, context, job, case, query, digest, begun)
    with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
        answer = services.jobs.answer_study(operation, query, case, take=context.take, limiter=services.reading)
        computed, status = await unless_left(request, answer)
    if status == "hit":  # computed for another request
        context.take(known.cases)
    services.metrics.count(operation, computed.outcome, status, 1)
    now = time.perf_counter()
    timing = f"validate;dur={1e3 * (read - begun):.2f}, compute;dur={1e3 * (now - read):.2f}"
    return reply(computed.json, status, f"{timing}, total;dur={1e3 * (now - begun):.2f}")


async def unless_left(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """Return the result of work; cancel it once the client has left or the service is stopping.

    Raises
    ------
    HTTPException
        400 if the client has left.
    PoolUnavailableError
        If the service is stopping.
    """
    working = asyncio.ensure_future(work)
    left = asyncio.ensure_future(disconnected(request))
    stopping = asyncio.ensure_future(services_of(request).stopping.wait())
    try:
        await asyncio.wait([working, left, stopping], return_when=asyncio.FIRST_COMPLETED)
    finally:
        left.cancel()
        stopping.cancel()
        if not working.done():
            working.cancel()
            await asyncio.wait([working])
    if not working.cancelled():
        return working.result()
    if left.done() and not left.cancelled():
        raise HTTPException(HTTPStatus.BAD_REQUEST, "the client has left")
    raise PoolUnavailableError("the service is stopping")


async def disconnected(request: Request) -> None:
    """Return once the client has closed the connection, after the body has been read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def read_study(services: Services, body: bytes, operation: str) -> tuple[Any, KeyedRequest]:
    """Return the validated request, and its canonical form with its key."""
    if not body:
        raise InvalidBodyError([{"pointer": "", "detail": "Field required"}])
    await next_turn(services.parsing)
    case = validated(parse_json(body, services.settings.max_body_depth), operation, services)
    return case, KeyedRequest.of(operation, case)


async def answer_with_job(
    services: Services,
    context: RequestContext,
    response: JobResponse,
    case: Any,
    query: KeyedRequest,
    digest: str,
    begun: float,
) -> Response:
    """Return the job of a study; its answer, if it is there in the time that the client waits.

    It counts as all the samples it may take until it ends, then as those it has taken.
    """
    await run_sync(case.study)  # refuses inputs that do not go together
    try:
        charge = context.charge(case.sampling.max_samples)
        state = await response.accept(one_block(Case(query)), digest, charge=charge)
    except BaseException:
        context.give_back()
        raise
    state, answered, headers = await response.wait(state)
    record = await services.queries.result(query.key) if answered else None
    if record is None:
        return response.accepted(state, headers)
    answer = reply(
        record.json, "hit" if state.cached else "miss", f"total;dur={1e3 * (time.perf_counter() - begun):.2f}"
    )
    answer.headers.update(headers | {"Content-Location": f"/results/{query.key}"})
    return answer


async def one_block(case: Case) -> AsyncIterator[list[Case]]:
    """Yield the only case of a job."""
    yield [case]
