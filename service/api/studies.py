"""Studies of one strike: how sure an angle or an outcome is, and the report.

Their samples are cases of cache and executor like those of a batch. A worker draws the page of a report.
"""

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any

import orjson
from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from service.api.batch_response import IdempotencyKey, JobResponse, WantedPreference
from service.api.body import JSON, KnownBody, Preference, next_turn, parse_json, read_body, require_type
from service.api.contract import STUDIED, one_body, problems
from service.api.page import REPORT_POLICY
from service.api.queries import computed, computed_with_alternatives, reply, validated, validated_as
from service.api.services import Services, services_of, unless_left
from service.assessment import Query, first_queries, require_extra, strike_queries, write_page
from service.auth.dependencies import RUN, RequestContext, context_in
from service.errors import InvalidBodyError, ProblemType, problem_of
from service.jobs.models import JobCase
from service.operations import OPERATIONS, UNCERTAIN, KeyedRequest, work_of
from service.queries import check_work
from service.schemas import (
    CriticalAngleUncertaintyAnswer,
    CriticalAngleUncertaintyRequest,
    ReportRequest,
    TrajectoryUncertaintyAnswer,
    TrajectoryUncertaintyRequest,
)
from service.telemetry import BEGUN, path_of

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
    services, path, begun = services_of(request), path_of(request.scope), request.scope[BEGUN]
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
    base = await run_sync(UNCERTAIN[operation].base, case)
    check_work(base, services.settings.max_panel_steps)
    if preference.respond_async or case.sampling.max_samples > services.settings.small_samples:
        digest = hashlib.sha256(f"{path} {JSON}\n".encode() + body).hexdigest()
        job = JobResponse(request, operation, preference, idempotency_key)
        charge = case.sampling.max_samples * work_of(UNCERTAIN[operation].sample, base)
        return await answer_with_job(services, context, job, case, query, digest, begun, charge)
    with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
        answer = services.jobs.answer_study(
            operation, query, case, owner=context.queue_owner, take=context.take, limiter=services.reading
        )
        found, status = await unless_left(request, answer)
    if status == "hit":  # computed for another request
        context.take(known.cases)
    services.metrics.count(operation, found.outcome, status, 1)
    now = time.perf_counter()
    timing = f"validate;dur={1e3 * (read - begun):.2f}, compute;dur={1e3 * (now - read):.2f}"
    return reply(found.json, status, f"{timing}, total;dur={1e3 * (now - begun):.2f}")


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
    most: int,
) -> Response:
    """Return the job of a study; its answer, if it is there in the time that the client waits.

    It counts as all the samples it may take, `most`, until it ends, then as those it has taken.
    """
    await run_sync(case.study)  # refuses inputs that do not go together
    try:
        charge = context.charge(most)
        state = await response.accept(one_block(JobCase(query)), digest, charge=charge)
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
    answer.headers.update(headers | {"Content-Location": f"{response.root}/results/{query.key}"})
    return answer


async def one_block(case: JobCase) -> AsyncIterator[list[JobCase]]:
    """Yield the only case of a job."""
    yield [case]


NEEDED = "cra"
"""The query without whose answer there is no report."""


@router.post(
    "/report",
    response_class=HTMLResponse,
    responses={
        200: {
            "description": "A page that needs no other file, for two sheets of A4.",
            "content": {"text/html": {"schema": {"type": "string"}}},
        },
        **problems(400, 413, 415, 422, 429, 500, 501, 503),
    },
    openapi_extra=one_body(ReportRequest),
    tags=["critical ricochet angle"],
)
async def make_report(request: Request) -> HTMLResponse:
    """Write the report of one strike: critical angle and spread, other models, runs, limits of validity, formulas.

    It takes some 300 cases, most of them samples of the usual scatter; each is kept and counted like any other. With
    `impact.oblique_angle_deg` the strike at that angle is judged too.
    """
    require_extra()
    services = services_of(request)
    require_type(request, JSON)
    body = await read_body(request, services.settings.max_body_bytes)
    if not body:
        raise InvalidBodyError([{"pointer": "", "detail": "Field required"}])
    await next_turn(services.parsing)
    given = parse_json(body, services.settings.max_body_depth)
    strike = validated_as(ReportRequest, given)
    strike.check()
    answers = await unless_left(request, answers_to(request, strike))
    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    page = await services.executor.submit(write_page, given, answers, made, str(request.base_url))
    return HTMLResponse(page, headers={"Cache-Control": "no-store", "Content-Security-Policy": REPORT_POLICY})


async def answers_to(request: Request, strike: ReportRequest) -> dict[str, Any]:
    """Return the answers of the report by name, an object with a `problem` where there is none."""
    found = await answer_all(request, first_queries(strike))
    return found | await answer_all(request, strike_queries(strike, found[NEEDED]))


async def answer_all(request: Request, queries: Mapping[str, Query]) -> dict[str, Any]:
    """Answer some queries at the same time."""
    found = await asyncio.gather(*(answer_query(request, name, query) for name, query in queries.items()))
    return dict(zip(queries, found, strict=True))


async def answer_query(request: Request, name: str, query: Query) -> Any:
    """Answer one query; its problem takes the place of an answer that a report can do without."""
    services, context = services_of(request), context_in(request.scope)
    operation = query.operation
    try:
        case = validated(query.body, operation, services)
        keyed = KeyedRequest.of(operation, case)
        if operation in UNCERTAIN:
            with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
                record, status = await services.jobs.answer_study(
                    operation, keyed, case, owner=context.queue_owner, take=context.take, limiter=services.reading
                )
            services.metrics.count(operation, record.outcome, status, 1)
            return orjson.loads(record.json)
        context.take(OPERATIONS[operation].cases(case))
        if getattr(case, "alternatives", False):
            content, _ = await computed_with_alternatives(request, operation, case, keyed)
            return orjson.loads(content)
        record, _ = await computed(services, context, operation, keyed)
        return orjson.loads(record.json)
    except Exception as error:
        if name == NEEDED or ProblemType.of(error).status != HTTPStatus.UNPROCESSABLE_ENTITY:
            raise
        return {"problem": problem_of(error)}
