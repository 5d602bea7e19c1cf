"""The report of one strike: its numbers are cases of cache and executor like any other, a worker draws the page."""

import asyncio
from collections.abc import Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any

import orjson
from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from service.api.body import JSON, next_turn, parse_json, read_body, require_type
from service.api.contract import one_body, problems
from service.api.page import REPORT_POLICY
from service.api.queries import computed, computed_with_alternatives, validated, validated_as
from service.api.services import services_of
from service.api.uncertainty import unless_left
from service.assessment import Query, first_queries, require_extra, strike_queries, write_page
from service.auth.dependencies import RUN, context_in
from service.errors import InvalidBodyError, ProblemType, problem_of
from service.operations import OPERATIONS, UNCERTAIN, KeyedRequest
from service.schemas import ReportRequest

NEEDED = "cra"
"""The query without whose answer there is no report."""

router = APIRouter(dependencies=[RUN])


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

    Of some 300 cases, most of them samples of the usual scatter; each is kept and counted like any other. With
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
    found = await asyncio.gather(*(answer(request, name, query) for name, query in queries.items()))
    return dict(zip(queries, found, strict=True))


async def answer(request: Request, name: str, query: Query) -> Any:
    """Answer one query; its problem takes the place of an answer that a report can do without."""
    services, context = services_of(request), context_in(request.scope)
    operation = query.operation
    try:
        case = validated(query.body, operation, services)
        keyed = KeyedRequest.of(operation, case)
        if operation in UNCERTAIN:
            with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
                record, status = await services.jobs.answer_study(
                    operation, keyed, case, take=context.take, limiter=services.reading
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
