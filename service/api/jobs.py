"""Routes of jobs: their state, their results in every form, and their end."""

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
from service.api.middleware import client_of
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
"""Rows of a page unless the client asks for another number."""
MOST_ROWS = 1_000
"""Largest page."""
MOST_DIGITS = 9
"""Digits of the number of a case or a job."""


async def manager_of(request: Request) -> JobManager:
    """Return the job manager of the running application."""
    return services_of(request).jobs


async def event_stream(request: Request, context: ReadContext) -> AsyncIterator[None]:
    """Count an event stream as open while a request lasts: of the owner of a key, or of an address without one."""
    principal = context.principal
    holder = principal.owner if principal.key else f"address {client_of(request.scope)}"
    with services_of(request).streams.held(holder):
        yield


CurrentManager = Annotated[JobManager, Depends(manager_of)]
JobId = Annotated[str, Path(description="Id of the job.", max_length=200)]


async def job_of(job_id: JobId, jobs: CurrentManager, context: ReadContext) -> JobState:
    """Return the requested job; one of another owner is not found."""
    return known(await jobs.job(job_id, context.principal.visible_owner))


def known(state: JobState | None) -> JobState:
    """Return the job, if there is one.

    Raises
    ------
    HTTPException
        404 if there is none.
    """
    if state is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, "there is no job with this id; it may have expired")
    return state


RequestedJob = Annotated[JobState, Depends(job_of)]
Cursor = Annotated[str, Query(max_length=20, description="`next` of the page before; empty for the first.")]
Limit = Annotated[
    int,
    Query(ge=1, le=MOST_ROWS, description="Results of a page. The other forms give all that is ready unless limited."),
]

RESULTS: Responses = {
    200: {
        "description": "What is ready, in the form that `Accept` names.",
        "content": {
            JSONL: {"schema": {"type": "string", "description": "A `JobItem` a line."}},
            CSV: {"schema": {"type": "string", "description": "A row a case: the summary, or the problem."}},
            HDF5: {},
            PARQUET: {},
        },
    },
    **problems(404, 406, 422, 429, 500, 503, 507),
}
EVENTS: Responses = {
    200: {"description": "A `Job` whenever it changes, as the data of server-sent events; the last is its end."},
    **problems(404, 422, 429, 500, 503, 507),
}
LastEventId = Annotated[
    str,
    Header(alias="Last-Event-ID", description="Id of the event seen last: its state is not sent again."),
]


@router.get("/jobs", response_model=Jobs, response_description="The jobs.", responses=problems(422, 500, 507))
async def list_jobs(
    request: Request,
    jobs: CurrentManager,
    context: ReadContext,
    cursor: Cursor = "",
    limit: Annotated[int, Query(ge=1, le=MOST_ROWS, description="Jobs of a page.")] = PAGE,
) -> Response:
    """List the jobs of the owner in pages, the newest first; with the scope `admin`, those of all."""
    owner, before = context.principal.visible_owner, read_cursor(cursor)
    states = await jobs.jobs(
        owner, before=before, limit=limit + 1
    )  # One more than the page holds shows whether another follows.
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
    """Return a job: how far it is; the request of a sweep or a study of uncertainty; of a study, the answer so far."""
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
    """Give the results that are ready, in the order of the request, at any time.

    JSON comes in pages; JSON lines, CSV and Parquet (the summaries, a row a case) and HDF5 hold all that is ready from
    the cursor on, unless a limit is given. Parquet takes a service with the extra `parquet`, and is refused without.
    """
    forms = FORMS if has_parquet() else FORMS[:-1]
    form = choose(request.headers.get("accept", "*/*"), forms)
    if form is None:
        more = "" if has_parquet() else f"; {missing_package('Parquet', 'pyarrow', 'parquet')}"
        raise HTTPException(HTTPStatus.NOT_ACCEPTABLE, f"results are given as {', '.join(forms)}{more}")
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
    return StreamingResponse(content, media_type=form, headers={"Vary": "Accept"})


class Page:
    """A page of results that is being sent, and the cursor of the results that follow.

    Parameters
    ----------
    job
        As it was before its results were read: if it had ended then, what is missing now never comes.
    start
        First case.
    limit
        Largest number of cases of the page.
    """

    def __init__(self, job: JobState, start: int, limit: int) -> None:
        self._job = job
        self._limit = limit
        self._next = start
        self._count = 0

    def note(self, results: list[CaseResult]) -> None:
        """Note how far the results go."""
        self._count += len(results)
        self._next = results[-1].number + 1

    def end(self) -> bytes:
        """Return what follows the results of the page: the cursor, if anything may follow."""
        complete = self._job.status != "damaged" and self._next >= self._job.total
        if complete or (self._job.final and self._count < self._limit):
            return b""
        return b',"next":"%b"' % write_cursor(self._next)


def write_cursor(number: int) -> bytes:
    """Return the cursor of this case or job."""
    return urlsafe_b64encode(str(number).encode()).rstrip(b"=")


def read_cursor(cursor: str) -> int:
    """Return the number in a cursor; 0 if it is empty.

    Raises
    ------
    HTTPException
        422 if the service has not made it.
    """
    try:
        text = urlsafe_b64decode(cursor.encode("ascii") + b"=" * (-len(cursor) % 4)) or b"0"
    except (binascii.Error, UnicodeEncodeError):
        text = b""
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
    """Send a job whenever it changes, until it has ended. A job that has ended is sent once."""
    keys = services_of(request).keys
    async with aclosing(until(services_of(request).stopping, jobs.changes(job.id))) as changes:
        async for state in changes:
            if context.principal.key and not keys.holds(context.principal.key):
                return  # The key has been revoked.
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
    """End a job; what is ready of its results stays until it expires. A job that has ended stays as it is."""
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
    """Give a job another title."""
    state = known(await jobs.rename(job_id, change.title, context.principal.visible_owner))
    context.job = state.id
    return job_response(root_of(request), state)


@router.delete(
    "/jobs/{job_id}",
    status_code=HTTPStatus.NO_CONTENT,
    response_description="The job is gone.",
    responses=problems(404, 422, 500, 507),
)
async def delete_job(request: Request, job_id: JobId, jobs: CurrentManager, context: RunContext) -> None:
    """Cancel a job and forget it; its results stay, by their keys, as long as there is room."""
    if not await jobs.delete(job_id, context.principal.visible_owner):
        known(None)
    await services_of(request).downloads.remove_of(job_id)
    context.job = job_id
