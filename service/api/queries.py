"""Routes of single queries and of stored results, and `resolve`, which answers a request of any operation."""

import asyncio
import csv
import hashlib
import io
import time
from collections.abc import Awaitable, Callable
from contextlib import nullcontext
from http import HTTPStatus
from typing import Annotated, Any, NamedTuple

from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, HTTPException, Request, Response
from fastapi import Path as PathParameter

from service.api.body import CheckedRoute
from service.api.contract import Responses, problems
from service.api.job_models import Result
from service.api.negotiation import CSV, HDF5, JSON, choose, matches
from service.api.services import Services, in_time, services_of, unless_left
from service.auth.dependencies import READ, RequestContext, context_in
from service.cache.hdf5 import to_hdf5
from service.cache.record import Record
from service.cache.tables import residuals_of
from service.columns import csv_cells, summarize, trial_columns
from service.errors import ProblemType, problem_of, validated_as
from service.jobs.scheduler import problem_name
from service.operations import OPERATIONS, KeyedRequest, Operation
from service.problems import units_named_in
from service.queries import Answered, CacheStatus, check_work
from service.schemas.requests import alternatives_in, answered_alternative, with_alternatives
from service.telemetry import BEGUN

router = APIRouter(tags=["results"], dependencies=[READ], route_class=CheckedRoute)


def to_csv(record: Record) -> bytes:
    """Return the CSV table of a result.

    The table is the history of a run, or its final state if there is none; the table of `residuals_of` for a
    calibration, a study of uncertainty or formulas; the trials of a search; for other operations, the answer in one
    row.
    """
    if record.operation == "trajectory" and record.history is not None:
        names, columns = list(record.history), [column.tolist() for column in record.history.values()]
    elif residuals := residuals_of(record):
        names, columns = list(residuals), list(residuals.values())
    elif "iterations" in record.answer:
        trials = trial_columns(record.answer)
        names, columns = list(trials), list(trials.values())
    elif record.operation == "trajectory":
        final = record.answer["final"]
        names, columns = list(final), [[value] for value in final.values()]
    else:
        summary = summarize(record.answer)
        names = [column.name for column in OPERATIONS[record.operation].columns]
        columns = [[summary.get(name)] for name in names]
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    # A loop lets other threads run between rows, while a single call of `writerows` would hold the interpreter lock.
    for row in zip(*columns, strict=True):
        writer.writerow(csv_cells(row))
    return text.getvalue().encode()


REPRESENTATIONS: dict[str, Callable[[Record], bytes]] = {
    JSON: lambda record: record.json,
    CSV: to_csv,
    HDF5: to_hdf5,
}
"""Media types of a result, the default first, with the functions that encode it."""


def form_of(request: Request) -> str:
    """Return the media type of a result that the client prefers.

    Raises
    ------
    HTTPException
        406 if the client accepts none of the media types in `REPRESENTATIONS`.
    """
    media_type = choose(request.headers.get("accept", "*/*"), tuple(REPRESENTATIONS))
    if media_type is None:
        raise HTTPException(HTTPStatus.NOT_ACCEPTABLE, f"a result is given as {', '.join(REPRESENTATIONS)}")
    return media_type


class Resolved(NamedTuple):
    """An answer, its JSON with alternatives, and whether it came from the cache."""

    record: Record
    content: bytes
    status: CacheStatus


def single_route(operation: Operation) -> Callable[..., Awaitable[Response]]:
    """Return the handler of the route for single requests."""

    async def handle(request: Request, case: operation.request) -> Response:  # type: ignore[name-defined] # set at run time
        check_work(case, services_of(request).settings.max_panel_steps)
        form = form_of(request)
        if operation.long:  # Hashing a long body would block the event loop.
            query = await run_sync(KeyedRequest.of, operation.name, case)
        else:
            query = KeyedRequest.of(operation.name, case)
        read = time.perf_counter()
        found = await resolve(request, operation, case, query)
        return await reply(form, found.record, found.status, request.scope[BEGUN], read, found.content)

    return handle


async def resolve(
    request: Request, operation: Operation, case: Any, query: KeyedRequest | None = None, *, watched: bool = True
) -> Resolved:
    """Answer a validated request. Routes, tools, UM-Bridge and reports all call this.

    The request is charged to the key of the HTTP request, looked up, computed on a cache miss, stored and counted. The
    same holds for each of its alternatives, or for the samples of a study.

    Parameters
    ----------
    query
        Canonical form of the request, if the caller has it.
    watched
        Cancel the work when the client leaves. Callers that combine several requests watch the client themselves, and
        pass False.
    """
    context = context_in(request.scope)
    query = query or KeyedRequest.of(operation.name, case)
    is_study = operation.study is not None
    with nullcontext() if is_study else context.taking(operation.charge(case)):
        work = (_answer_study if is_study else _answer_query)(request, operation, case, query)
        return await (unless_left(request, work) if watched else work)


async def _answer_query(request: Request, operation: Operation, case: Any, query: KeyedRequest) -> Resolved:
    """Answer a query and its alternatives, each of which is looked up and computed like any other case."""
    services, context, name = services_of(request), context_in(request.scope), operation.name

    async def attempt(laws: dict[str, Any], other: Any) -> tuple[dict[str, Any], CacheStatus]:
        try:
            found, known = await computed(services, context, name, KeyedRequest.of(name, other))
        except Exception as error:
            # A failed alternative is answered with its problem. Other errors, such as a full queue, fail the request.
            if ProblemType.of(error).status != HTTPStatus.UNPROCESSABLE_ENTITY:
                raise
            with units_named_in(request):
                return {**laws, "problem": {**problem_of(error), "instance": request.scope["path"]}}, "miss"
        return answered_alternative(laws, found.answer), known

    others = alternatives_in(case)
    if not others:
        record, status = await computed(services, context, name, query)
        return Resolved(record, record.json, status)
    (record, status), *found = await asyncio.gather(
        computed(services, context, name, query), *(attempt(laws, other) for laws, other in others)
    )
    content = with_alternatives(record.json, [alternative for alternative, _ in found])
    hit = all(each == "hit" for each in (status, *(each for _, each in found)))
    return Resolved(record, content, "hit" if hit else "miss")


async def _answer_study(request: Request, operation: Operation, case: Any, query: KeyedRequest) -> Resolved:
    """Answer a study. Its samples are charged before they are computed; a stored answer is charged as one case."""
    services, context = services_of(request), context_in(request.scope)
    status: CacheStatus = "hit"
    record = await services.queries.result(query.key)
    if record is None:
        with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
            study = services.jobs.answer_study(
                operation.name, query, case, owner=context.queue_owner, take=context.take, limiter=services.reading
            )
            found: Answered = await in_time(study, services.settings.study_seconds)
            record, status = found
    if status == "hit":
        context.take(1)
    services.metrics.count(operation.name, record.outcome, status, 1)
    return Resolved(record, record.json, status)


async def computed(services: Services, context: RequestContext, operation: str, query: KeyedRequest) -> Answered:
    """Return the record of a request and whether it came from the cache; count failures by their problem."""
    try:
        with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
            return await services.queries.answer(operation, query, context.queue_owner)
    except Exception as error:
        services.metrics.count(operation, problem_name(problem_of(error)), "miss", 1)
        raise


async def reply(
    form: str,
    record: Record,
    status: CacheStatus,
    begun: float,
    read: float,
    content: bytes | None = None,
) -> Response:
    """Return the response with a result, including the headers `Cache-Status` and `Server-Timing`.

    Parameters
    ----------
    form
        Media type of the response.
    begun, read
        Times at which the request arrived and had been read, on the performance counter. [s]
    content
        JSON of the answer, if it has more than the result, such as alternatives.
    """
    if form != JSON or content is None:
        content = record.json if form == JSON else await run_sync(REPRESENTATIONS[form], record)
    now = time.perf_counter()
    parts = (("validate", read - begun), ("compute", now - read), ("total", now - begun))
    timing = ", ".join(f"{name};dur={1e3 * seconds:.2f}" for name, seconds in parts)
    headers = {"Cache-Status": "ricochet; hit" if status == "hit" else "ricochet; fwd=miss", "Server-Timing": timing}
    return Response(content, headers={**headers, "Vary": "Accept"}, media_type=form)


def validated(content: Any, operation: Operation, services: Services) -> Any:
    """Validate the content of a body as a request.

    Raises
    ------
    InvalidBodyError, ParameterError
        If the content is not valid, or a run would take too much work.
    """
    case = validated_as(operation.request, content)
    check_work(case, services.settings.max_panel_steps)
    return case


DECLARED: Responses = {
    200: {
        "description": "The result, as the media type that `Accept` selects.",
        "headers": {
            "ETag": {
                "description": "Strong entity tag of this representation.",
                "schema": {"type": "string"},
                "required": True,
            }
        },
        "content": {CSV: {"schema": {"type": "string"}}, HDF5: {}},
    },
    304: {"description": "The client has this representation of the result."},
    **problems(404, 406, 422, 500),
}
KEY = {"pattern": "^[0-9a-f]{64}$"}


@router.get("/results/{key}", response_model=Result, responses=DECLARED)
async def get_result(
    request: Request,
    key: Annotated[str, PathParameter(description="Key of an answer.", json_schema_extra=KEY)],
    if_none_match: Annotated[
        str, Header(alias="If-None-Match", description="Entity tags of the representations that the client has.")
    ] = "",
) -> Response:
    """Return the result stored under a key, as JSON, CSV or HDF5.

    HDF5 has the whole result. CSV has one table, such as the history of a run, the trials of a search, or the residuals
    of a calibration.
    """
    media_type = form_of(request)
    record = await services_of(request).queries.result(key)
    if record is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, "no result is kept under this key")
    content = await run_sync(REPRESENTATIONS[media_type], record)
    headers = {"ETag": f'"{hashlib.sha256(content).hexdigest()[:32]}"', "Vary": "Accept"}
    if matches(if_none_match, headers["ETag"]):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    return Response(content, media_type=media_type, headers=headers)
