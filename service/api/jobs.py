"""Routes of jobs: list, state, title, results in all media types, events, cancellation and deletion."""

import binascii
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import AsyncIterator
from contextlib import aclosing
from http import HTTPStatus
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, Depends, Header, HTTPException, Path, Query, Request, Response
from fastapi.responses import StreamingResponse
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.api.batch_response import job_json, job_response, queue_of, retry_after, root_of, to_job, until
from service.api.body import CheckedRoute
from service.api.contract import RETRY_LATER, Responses, problems
from service.api.job_models import Job, JobChange, JobResults, Jobs
from service.api.negotiation import CSV, HDF5, JSON, JSONL, PARQUET, choose
from service.api.results import (
    FILES,
    ReadyResults,
    as_array,
    as_csv,
    as_lines,
    file_response,
    has_parquet,
)
from service.api.services import services_of, unless_left
from service.auth.dependencies import ReadContext, RunContext
from service.cache.record import CaseResult
from service.jobs.manager import JobManager
from service.jobs.models import JobState
from service.settings import missing_package

router = APIRouter(tags=["jobs"], route_class=CheckedRoute)

FORMS = (JSON, JSONL, CSV, HDF5, PARQUET)
PAGE = 200
"""Default number of rows of a page, which is also the number of cases in a stored block of a job."""
MOST_ROWS = 1_000
"""Largest number of rows of a page, as many as the cases of a JSON batch."""
MOST_DIGITS = 9
"""Largest number of digits of a number in a cursor, enough for any case or job that the service can store."""


async def manager_of(request: Request) -> JobManager:
    """Return the job manager of the running application."""
    return services_of(request).jobs


async def event_stream(request: Request, context: ReadContext) -> AsyncIterator[None]:
    """Count an open event stream for the owner of the key or, without a key, for the client address until it ends."""
    with services_of(request).streams.held(context.queue_owner):
        yield


CurrentManager = Annotated[JobManager, Depends(manager_of)]
JobId = Annotated[str, Path(description="Id of the job.", max_length=200)]


async def job_of(job_id: JobId, jobs: CurrentManager, context: ReadContext) -> JobState:
    """Return the requested job. A job of another owner also gives 404, so that clients cannot tell which ids exist."""
    return known(await jobs.job(job_id, context.principal.visible_owner))


def known(state: JobState | None) -> JobState:
    """Return the job, or raise an error if it is None.

    Raises
    ------
    HTTPException
        404 if there is no job.
    """
    if state is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, "there is no job with this id; it may have expired")
    return state


RequestedJob = Annotated[JobState, Depends(job_of)]
Cursor = Annotated[str, Query(max_length=20, description="`next` of the previous page; empty for the first page.")]
Limit = Annotated[
    int,
    Query(
        ge=1,
        le=MOST_ROWS,
        description="Number of results on a page. Without it, media types other than JSON have all available results.",
    ),
]

RESULTS: Responses = {
    200: {
        "description": "The available results, as the media type that `Accept` selects.",
        "content": {
            JSONL: {"schema": {"type": "string", "description": "One `JobItem` per line."}},
            CSV: {"schema": {"type": "string", "description": "One row per case: its summary, or its problem."}},
            HDF5: {},
            PARQUET: {},
        },
    },
    **problems(404, 406, 422, 429, 500, 503, 507),
}
EVENTS: Responses = {
    200: {"description": "A server-sent event with the `Job` at each of its changes; the last has its final state."},
    **problems(404, 422, 429, 500, 503, 507),
}
LastEventId = Annotated[
    str,
    Header(alias="Last-Event-ID", description="Id of the last event received, whose state is not sent again."),
]


@router.get("/jobs", response_model=Jobs, response_description="The jobs.", responses=problems(422, 500, 507))
async def list_jobs(
    request: Request,
    jobs: CurrentManager,
    context: ReadContext,
    cursor: Cursor = "",
    limit: Annotated[int, Query(ge=1, le=MOST_ROWS, description="Number of jobs on a page.")] = PAGE,
) -> Response:
    """List the jobs of the owner in pages, newest first. With the scope `admin`, the jobs of all owners are listed."""
    owner, before = context.principal.visible_owner, read_cursor(cursor)
    # One job more than the page holds shows whether another page follows.
    states = await jobs.jobs(owner, before=before, limit=limit + 1)
    root = root_of(request)
    content: dict[str, Any] = {"jobs": [to_job(root, each, queue=queue_of(each, jobs)) for each in states[:limit]]}
    if len(states) > limit:
        content["next"] = write_cursor(states[limit - 1].number).decode()
    return Response(orjson.dumps(content, option=orjson.OPT_UTC_Z), media_type=JSON)


@router.get(
    "/jobs/{job_id}",  # noqa: FAST003 (of RequestedJob)
    response_model=Job,
    response_description="The job.",
    responses={200: RETRY_LATER, **problems(404, 422, 500, 507)},
)
async def get_job(request: Request, job: RequestedJob, jobs: CurrentManager) -> Response:
    """Return a job with its progress, the request for a sweep or a study, and the answer of a study so far."""
    headers = {} if job.final else retry_after(job, jobs)
    return job_response(
        root_of(request),
        job,
        headers=headers,
        request=await jobs.request(job),
        partial=await jobs.partial(job),
        queue=queue_of(job, jobs),
    )


@router.get("/jobs/{job_id}/results", response_model=JobResults, responses=RESULTS)  # noqa: FAST003
async def get_job_results(
    request: Request,
    job: RequestedJob,
    jobs: CurrentManager,
    context: ReadContext,
    cursor: Cursor = "",
    limit: Limit = PAGE,
) -> Response:
    """Return the available results of a job, in the order of the request. The job may still be running.

    JSON is returned in pages. JSON lines, HDF5, CSV and Parquet (one row per case, with its summary) have all available
    results from the cursor on, unless a limit is given. Parquet is refused by a service without the extra `parquet`.
    """
    # Parquet, the last of the media types, needs an optional package.
    forms = FORMS if has_parquet() else FORMS[:-1]
    form = choose(request.headers.get("accept", "*/*"), forms)
    if form is None:
        more = "" if has_parquet() else f"; {missing_package('Parquet', 'pyarrow', 'parquet')}"
        raise HTTPException(HTTPStatus.NOT_ACCEPTABLE, f"results are given as {', '.join(forms)}{more}")
    # Files and streams are complete by default. Only JSON is cut into pages, because clients read it into memory.
    most = limit if form == JSON or "limit" in request.query_params else None
    ready = ReadyResults(jobs, job, await jobs.sweep(job), read_cursor(cursor), most, context.take)
    if form in FILES:
        return await unless_left(request, file_response(request, ready, form))
    path = f"{root_of(request)}/jobs/{job.id}/results"
    if form == CSV:
        content = as_csv(ready)
    elif form == JSONL:
        content = as_lines(ready, path)
    else:
        page = Page(job, ready.start, limit)
        content = as_array(ready, path, page.note, page.end)
    # `Vary` keeps a shared cache from answering a request for one media type with another.
    return StreamingResponse(content, media_type=form, headers={"Vary": "Accept"})


class Page:
    """A page of results that is being sent, and the cursor of the next page.

    Parameters
    ----------
    job
        State of the job before its results were read. If it had ended by then, missing results will not follow.
    start
        Number of the first case.
    limit
        Largest number of cases of the page.
    """

    def __init__(self, job: JobState, start: int, limit: int) -> None:
        self._job = job
        self._limit = limit
        self._next = start
        self._count = 0

    def note(self, results: list[CaseResult]) -> None:
        """Count results, and remember the case that follows them."""
        self._count += len(results)
        self._next = results[-1].number + 1

    def end(self) -> bytes:
        """Return the JSON after the results: the cursor of the next page, or nothing if no more results will come."""
        complete = self._job.status != "damaged" and self._next >= self._job.total
        # `_job` is the state before the results were read: a job that has ended since may have more results.
        if complete or (self._job.final and self._count < self._limit):
            return b""
        return b',"next":"%b"' % write_cursor(self._next)


def write_cursor(number: int) -> bytes:
    """Return the cursor of a case or a job. It is encoded so that clients do not compute cursors themselves."""
    return urlsafe_b64encode(str(number).encode()).rstrip(b"=")


def read_cursor(cursor: str) -> int:
    """Return the number in a cursor; 0 if it is empty.

    Raises
    ------
    HTTPException
        422 if the cursor was not made by this service.
    """
    try:
        text = urlsafe_b64decode(cursor.encode("ascii") + b"=" * (-len(cursor) % 4)) or b"0"
    except (binascii.Error, UnicodeEncodeError):
        text = b""
    # The number is encoded again and compared, because base64 has several encodings of the same bytes.
    if not text.isdigit() or len(text) > MOST_DIGITS or (cursor and write_cursor(int(text)) != cursor.encode()):
        raise HTTPException(HTTPStatus.UNPROCESSABLE_ENTITY, "`cursor` must be one that this service has given")
    return int(text)


@router.get(
    "/jobs/{job_id}/events",  # noqa: FAST003
    response_class=EventSourceResponse,
    responses=EVENTS,
    dependencies=[Depends(event_stream)],
)
async def follow_job(
    request: Request,
    job: RequestedJob,
    jobs: CurrentManager,
    context: ReadContext,
    last_event_id: LastEventId = "",
) -> AsyncIterator[ServerSentEvent]:
    """Send an event with the job at each change until it has ended. A job that has already ended is sent once."""
    keys = services_of(request).keys
    async with aclosing(until(services_of(request).stopping, jobs.changes(job.id))) as changes:
        async for state in changes:
            if context.principal.key and not keys.holds(context.principal.key):
                return  # The key has expired or has been revoked.
            # The final state is sent even to a client that has it. Otherwise the client would reconnect for ever.
            if state.final or str(state.revision) != last_event_id:
                content = job_json(root_of(request), state, partial=await jobs.partial(state))
                yield ServerSentEvent(raw_data=content.decode(), id=str(state.revision))


@router.post(
    "/jobs/{job_id}/cancel",
    response_model=Job,
    response_description="The job.",
    responses=problems(404, 422, 500, 507),
)
async def cancel_job(request: Request, job_id: JobId, jobs: CurrentManager, context: RunContext) -> Response:
    """Cancel a job. Its available results are kept until it expires. A job that has ended does not change."""
    state = known(await jobs.cancel(job_id, context.principal.visible_owner))
    context.job = state.id
    return job_response(root_of(request), state)


@router.patch(
    "/jobs/{job_id}",
    response_model=Job,
    response_description="The job.",
    responses=problems(400, 404, 413, 415, 422, 500, 507),
)
async def change_job(
    request: Request, job_id: JobId, jobs: CurrentManager, context: RunContext, change: JobChange
) -> Response:
    """Change the title of a job."""
    state = known(await jobs.rename(job_id, change.title, context.principal.visible_owner))
    context.job = state.id
    return job_response(root_of(request), state)


@router.delete(
    "/jobs/{job_id}",
    status_code=HTTPStatus.NO_CONTENT,
    response_description="The job has been deleted.",
    responses=problems(404, 422, 500, 507),
)
async def delete_job(request: Request, job_id: JobId, jobs: CurrentManager, context: RunContext) -> None:
    """Cancel and delete a job. Its results stay under their keys until they are evicted."""
    if not await jobs.delete(job_id, context.principal.visible_owner):
        known(None)
    # The files of the job are removed at once instead of being evicted later, because the client no longer needs them.
    await services_of(request).downloads.remove_of(job_id)
    context.job = job_id
