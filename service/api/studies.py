"""Studies of one strike: how sure an angle or an outcome is, and the report.

Their samples are cases of cache and executor like those of a batch. A worker draws the page of a report.
"""

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any

import orjson
from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from service.api.batch_response import IdempotencyKey, JobResponse, WantedPreference
from service.api.body import BodyLimits, read_body, require_type
from service.api.contract import one_body, problems
from service.api.negotiation import JSON
from service.api.page import REPORT_POLICY
from service.api.queries import form_of, read_content, read_request, recalled, reply, resolve, validated
from service.api.services import in_time, services_of, unless_left
from service.assessment import (
    Query,
    first_queries,
    require_extra,
    strike_queries,
    verdict_queries,
    weighing_queries,
    write_page,
)
from service.auth.dependencies import RUN, context_in
from service.errors import ProblemType, problem_of, validated_as
from service.jobs.models import JobCase
from service.operations import OPERATIONS, KeyedRequest, Operation, study_of
from service.queries import check_work
from service.schemas import ReportRequest, VerdictAnswer, verdict_answer
from service.telemetry import BEGUN, path_of

router = APIRouter(dependencies=[RUN])


def study_route(operation: Operation) -> Callable[..., Awaitable[Response]]:
    """Return the handler for a study of uncertainty: from the cache, by its samples, or with a job."""

    async def handle(request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = "") -> Response:
        services, path, begun = services_of(request), path_of(request.scope), request.scope[BEGUN]
        require_type(request, JSON)
        form = form_of(request)
        body = await read_body(request, BodyLimits.of_one(services.settings))
        known, case = services.bodies.get((path, body)), None
        if known is None:
            case = await read_request(services, body, operation)
            known = services.bodies.remember(path, body, KeyedRequest.of(operation.name, case).key, 1)
        read = time.perf_counter()
        record = None if preference.respond_async else await services.queries.result(known.key)
        if record is not None:
            return await recalled(request, operation, record, known.cases, form)
        case = case or await read_request(services, body, operation)
        most = case.sampling.max_samples
        if preference.respond_async or most > services.settings.small_samples:
            study = study_of(operation.name)
            base = await run_sync(study.base, case)
            check_work(base, services.settings.max_panel_steps)
            digest = hashlib.sha256(f"{path} {JSON}\n".encode() + body).hexdigest()
            job = JobResponse(request, operation.name, preference, idempotency_key)
            return await answer_with_job(
                job, request, operation, case, digest, most * OPERATIONS[study.sample].work(base)
            )
        found = await resolve(request, operation, case)
        return await reply(form, found.record, found.status, begun, read)

    return handle


async def answer_with_job(
    response: JobResponse, request: Request, operation: Operation, case: Any, digest: str, most: int
) -> Response:
    """Return the job of a study; its answer, if it is there in the time that the client waits.

    It counts as all the samples it may take, `most`, until it ends, then as those it has taken.
    """
    services, context = services_of(request), context_in(request.scope)
    query = KeyedRequest.of(operation.name, case)
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
    answer = await reply(form_of(request), record, "hit" if state.cached else "miss", request.scope[BEGUN])
    answer.headers.update(headers | {"Content-Location": f"{response.root}/results/{query.key}"})
    return answer


async def one_block(case: JobCase) -> AsyncIterator[list[JobCase]]:
    """Yield the only case of a job."""
    yield [case]


PAGE_COST = 50
"""Cost of drawing the page of a report, some 0.5 s. [ordinary cases]"""
NEEDED = "cra"
"""The query without whose answer there is no report."""


@router.post(
    "/verdict",
    response_model=VerdictAnswer,
    response_description="The verdict, and the queries it rests on.",
    responses=problems(400, 413, 415, 422, 429, 500, 503),
    openapi_extra=one_body(ReportRequest),
    tags=["critical ricochet angle"],
)
async def judge_strike(request: Request) -> Response:
    """Judge a strike in one sentence: outcome, probability of ricochet, critical angle with its 90 % range.

    The page, the report and the command line print the same sentence. It takes some 530 cases, most of them samples of
    the usual scatter, and twice as many with a law of one's own, beside which the theories stand; each is kept and
    counted like any other. A target with a thickness is judged as a wall too.
    """
    strike, _ = await read_report(request)
    limit = 2.0 * services_of(request).settings.study_seconds
    answers = await unless_left(request, in_time(verdict_answers(request, strike), limit))
    return Response(orjson.dumps(verdict_answer(strike, answers)), media_type=JSON)


async def verdict_answers(request: Request, strike: ReportRequest) -> dict[str, Any]:
    """Return the answers that a verdict is made from by name, an object with a `problem` where there is none."""
    found = await answer_all(request, verdict_queries(strike))
    return found | await answer_all(request, weighing_queries(strike, found[NEEDED]))


async def read_report(request: Request) -> tuple[ReportRequest, Any]:
    """Return the strike of a body, and the body as JSON data."""
    services = services_of(request)
    require_type(request, JSON)
    given = await read_content(services, await read_body(request, BodyLimits.of_one(services.settings)))
    return validated_as(ReportRequest, given), given


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

    It takes some 550 cases, most of them samples of the usual scatter; each is kept and counted like any other. With
    `impact.oblique_angle_deg` the strike at that angle is judged too.
    """
    require_extra()
    services = services_of(request)
    strike, given = await read_report(request)
    strike.check()
    page = await unless_left(
        request, in_time(write_report(request, strike, given), 2.0 * services.settings.study_seconds)
    )
    return HTMLResponse(page, headers={"Cache-Control": "no-store", "Content-Security-Policy": REPORT_POLICY})


async def write_report(request: Request, strike: ReportRequest, given: Any) -> str:
    """Return the page of a report."""
    answers = await answers_to(request, strike)
    return await services_of(request).queries.submit(
        write_page,
        given,
        answers,
        datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        str(request.base_url),
        owner=context_in(request.scope).queue_owner,
        cost=PAGE_COST,
    )


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
    operation = OPERATIONS[query.operation]
    try:
        case = validated(query.body, operation, services_of(request))
        return orjson.loads((await resolve(request, operation, case, watched=False)).content)
    except Exception as error:
        if name == NEEDED or ProblemType.of(error).status != HTTPStatus.UNPROCESSABLE_ENTITY:
            raise
        return {"problem": problem_of(error)}
