"""Routes of uncertainty studies, verdicts and reports of one strike.

Samples are looked up, computed and stored like the cases of a batch. The page of a report is drawn by a worker.
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
from service.api.body import CheckedRoute
from service.api.contract import problems
from service.api.negotiation import JSON
from service.api.page import REPORT_POLICY
from service.api.queries import form_of, reply, resolve, validated
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
from service.errors import ProblemType, problem_of
from service.jobs.models import JobCase
from service.operations import OPERATIONS, KeyedRequest, Operation
from service.problems import units_named_in
from service.queries import check_work
from service.schemas import ReportRequest, VerdictAnswer, verdict_answer
from service.telemetry import BEGUN, path_of

router = APIRouter(dependencies=[RUN], route_class=CheckedRoute)


def study_route(operation: Operation) -> Callable[..., Awaitable[Response]]:
    """Return the handler of the route for a study, which is answered from the cache, by sampling, or with a job."""

    async def handle(
        request: Request,
        case: operation.request,  # type: ignore[name-defined] # set at run time
        preference: WantedPreference,
        idempotency_key: IdempotencyKey = "",
    ) -> Response:
        services = services_of(request)
        check_work(case, services.settings.max_panel_steps)
        form = form_of(request)
        query = KeyedRequest.of(operation.name, case)
        read = time.perf_counter()
        # A study in the cache is answered at once, whatever its size.
        large = case.sampling.max_samples > services.settings.small_samples
        if preference.respond_async or (large and await services.queries.result(query.key) is None):
            digest = hashlib.sha256(f"{path_of(request.scope)} {JSON}\n".encode() + await request.body()).hexdigest()
            job = JobResponse(request, operation.name, preference, idempotency_key)
            return await answer_with_job(job, request, case, query, digest)
        found = await resolve(request, operation, case, query)
        return await reply(form, found.record, found.status, request.scope[BEGUN], read)

    return handle


async def answer_with_job(
    response: JobResponse, request: Request, case: Any, query: KeyedRequest, digest: str
) -> Response:
    """Create the job of a study, and return the job, or the answer if it is ready while the client waits.

    The job is charged the cost of all samples that it may take; the unused part is given back when it ends.
    """
    services, context = services_of(request), context_in(request.scope)
    await run_sync(case.study)  # Raises an error for inconsistent inputs now, so that no job is created for them.
    read = time.perf_counter()
    try:
        # All samples are charged beforehand, so that two simultaneous studies cannot exceed the quota together.
        charge = context.charge(query.work)
        state = await response.accept(one_block(JobCase(query)), digest, charge=charge)
    # Not `Exception`: the charge is given back after a cancellation too.
    except BaseException:
        context.give_back()
        raise
    state, answered, headers = await response.wait(state)
    record = await services.queries.result(query.key) if answered else None
    if record is None:
        return response.accepted(state, headers)
    answer = await reply(form_of(request), record, "hit" if state.cached else "miss", request.scope[BEGUN], read)
    answer.headers.update(headers | {"Content-Location": f"{response.root}/results/{query.key}"})
    return answer


async def one_block(case: JobCase) -> AsyncIterator[list[JobCase]]:
    """Yield the single case of a study's job as one block."""
    yield [case]


PAGE_COST = 50
"""Cost of drawing the page of a report, which takes some 0.5 s. [ordinary cases]"""
NEEDED = "cra"
"""Name of the query without whose answer there is no verdict and no report."""


@router.post(
    "/verdict",
    response_model=VerdictAnswer,
    response_description="The verdict, and the queries that it is based on.",
    responses=problems(400, 413, 415, 422, 429, 500, 503),
    tags=["critical ricochet angle"],
)
async def judge_strike(request: Request, strike: ReportRequest) -> Response:
    """Judge a strike in one sentence: outcome, probability of ricochet, critical angle with its 90 % range.

    The page, the report and the command line show the same sentence. A verdict costs some 530 cases, most of them
    samples of the usual scatter. It costs twice as many if the request chooses a decay law other than
    `elastic_plastic`, or gives S as a value or coefficients, because a second study then covers both decay theories
    with their usual S. Each case is stored and counted like any other. A target with a thickness is also judged as a
    wall.
    """
    limit = 2.0 * services_of(request).settings.study_seconds
    answers = await unless_left(request, in_time(verdict_answers(request, strike), limit))
    return Response(orjson.dumps(verdict_answer(strike, answers)), media_type=JSON)


async def verdict_answers(request: Request, strike: ReportRequest) -> dict[str, Any]:
    """Return the answers on which a verdict is based, keyed by name. A failed query is answered with its `problem`."""
    found = await answer_all(request, verdict_queries(strike))
    return found | await answer_all(request, weighing_queries(strike, found[NEEDED]))


@router.post(
    "/report",
    response_class=HTMLResponse,
    responses={
        200: {
            "description": "A self-contained HTML page, which prints on two sheets of A4.",
            "content": {"text/html": {"schema": {"type": "string"}}},
        },
        **problems(400, 413, 415, 422, 429, 500, 501, 503),
    },
    tags=["critical ricochet angle"],
)
async def make_report(request: Request, strike: ReportRequest) -> HTMLResponse:
    """Write a report on one strike: critical angle and spread, other models, runs, limits of validity, formulas.

    A report costs some 550 cases, most of them samples of the usual scatter. Each case is stored and counted like any
    other. With `impact.oblique_angle_deg` the strike at that angle is judged as well.
    """
    # A missing package is reported before the answers are computed for a page that cannot be drawn.
    require_extra()
    strike.check()
    given, limit = await request.json(), 2.0 * services_of(request).settings.study_seconds
    page = await unless_left(request, in_time(write_report(request, strike, given), limit))
    return HTMLResponse(page, headers={"Cache-Control": "no-store", "Content-Security-Policy": REPORT_POLICY})


async def write_report(request: Request, strike: ReportRequest, given: Any) -> str:
    """Compute the answers for a report, and have a worker draw its page."""
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
    """Return the answers on which a report is based, keyed by name. A failed query is answered with its `problem`."""
    found = await answer_all(request, first_queries(strike))
    return found | await answer_all(request, strike_queries(strike, found[NEEDED]))


async def answer_all(request: Request, queries: Mapping[str, Query]) -> dict[str, Any]:
    """Answer queries concurrently, and return the answers, keyed by name."""
    found = await asyncio.gather(*(answer_query(request, name, query) for name, query in queries.items()))
    return dict(zip(queries, found, strict=True))


async def answer_query(request: Request, name: str, query: Query) -> Any:
    """Answer one query. If the strike makes it impossible, return its problem instead, unless it is `NEEDED`."""
    operation = OPERATIONS[query.operation]
    try:
        with units_named_in(request):
            case = validated(query.body, operation, services_of(request))
        return orjson.loads((await resolve(request, operation, case, watched=False)).content)
    except Exception as error:
        # A query that is impossible for this strike is reported within the answer. A busy or failing service fails the
        # whole request.
        if name == NEEDED or ProblemType.of(error).status != HTTPStatus.UNPROCESSABLE_ENTITY:
            raise
        with units_named_in(request):
            return {"problem": problem_of(error)}
