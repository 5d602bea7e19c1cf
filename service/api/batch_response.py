"""Responses to batches and sweeps: a job if there are many cases or the client prefers a job, else the results."""

import asyncio
import re
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterable, Sequence
from contextlib import aclosing, suppress
from dataclasses import dataclass
from http import HTTPStatus
from operator import attrgetter
from typing import Annotated, Any, TypeVar

import orjson
from anyio import CancelScope
from fastapi import Depends, Header, HTTPException, Request, Response
from fastapi.responses import StreamingResponse

from service.api.batch_body import BatchBody, BatchReader
from service.api.negotiation import CSV, JSON, JSONL, choose
from service.api.results import ReadyResults, as_array, as_csv, as_lines, csv_head, csv_rows, to_item, to_lines
from service.api.services import services_of, unless_left
from service.auth.dependencies import context_in
from service.cache.record import CaseResult
from service.jobs.manager import JobManager
from service.jobs.models import Charge, Idempotency, JobCase, JobState, StoredSweep
from service.operations import OPERATIONS, KeyedRequest, Many, Operation

FORMS = (JSON, JSONL, CSV)
VARY = {"Vary": "Prefer, Accept"}
LONGEST_RETRY = 60
"""Largest value of `Retry-After` for a job, so that clients notice within a minute if it ends early. [s]"""

Result = TypeVar("Result")

IdempotencyKey = Annotated[
    str,
    Header(
        alias="Idempotency-Key",
        max_length=255,
        description="Key chosen by the client. A request that is sent again with the same key and body is answered "
        "with the job that the first one created, even if the client had disconnected before the answer. It has no "
        "effect on work that is answered at once.",
    ),
]
Prefer = Annotated[
    str,
    Header(
        alias="Prefer",
        description="Preferences (RFC 7240): `respond-async` creates a job whatever the size of the work; `wait=10` "
        "waits up to 10 seconds for the results of a job.",
    ),
]


PREFERENCE = re.compile(r'(?:"(?:[^"\\]|\\.)*"?|[^",])+')
"""Pattern of an element of a comma-separated header, in which quoted text may contain commas. The alternatives begin
with different characters and nothing follows the group, so no header can make the pattern backtrack."""
MOST_DIGITS = 9
"""Number of digits of `wait` that are read, enough for thirty years. Python refuses to convert thousands of digits."""


@dataclass(frozen=True, slots=True)
class Preference:
    """Preferences of a client in the `Prefer` header (RFC 7240).

    Parameters
    ----------
    respond_async
        True if the client wants a job whatever the size of the work.
    wait
        Time for which the client will wait for the results; None if not given. [s]
    """

    respond_async: bool = False
    wait: int | None = None

    def applied(self, waited: float | None) -> dict[str, str]:
        """Return the `Preference-Applied` header of a job; empty if no preference was applied."""
        applied = ["respond-async"] * self.respond_async
        if self.wait is not None and waited is not None:
            applied.append(f"wait={min(self.wait, int(waited))}")
        return {"Preference-Applied": ", ".join(applied)} if applied else {}


def read_preference(headers: Iterable[str]) -> Preference:
    """Return the preferences in `Prefer` headers. Unknown and malformed ones are ignored, as RFC 7240 requires."""
    found: dict[str, str] = {}
    for text in PREFERENCE.findall(",".join(headers).lower()):
        name, _, value = text.partition(";")[0].partition("=")  # Neither preference has parameters after a semicolon.
        found.setdefault(name.strip(), value.strip().strip('"'))  # The first of repeated preferences wins (RFC 7240).
    wait = found.get("wait", "")
    seconds = int(wait[:MOST_DIGITS]) if wait.isascii() and wait.isdigit() else None
    return Preference("respond-async" in found, seconds)


async def preference_of(request: Request, prefer: Prefer = "") -> Preference:
    """Return the preferences of the client. Routes use this function as a FastAPI dependency."""
    return read_preference(request.headers.getlist("prefer") if prefer else ())


WantedPreference = Annotated[Preference, Depends(preference_of)]


class JobResponse:
    """The response to a request whose work becomes a job.

    Parameters
    ----------
    request
        HTTP request. Its body is not read here.
    operation
        Operation of every case.
    preference
        Preferences of the client.
    idempotency_key
        Idempotency key of the client, empty if it sent none.
    """

    def __init__(self, request: Request, operation: str, preference: Preference, idempotency_key: str) -> None:
        self.operation = operation
        self._request = request
        self.path: str = request.scope["path"]
        self.root = root_of(request)
        self.preference = preference
        self._token = idempotency_key
        services = services_of(request)
        self._jobs, self._settings, self._stopping = services.jobs, services.settings, services.stopping
        self._context = context_in(request.scope)

    async def accept(
        self,
        blocks: AsyncIterator[list[JobCase]],
        digest: str | Callable[[], str],
        sweep: StoredSweep | None = None,
        charge: Charge | None = None,
        count: int = 0,
        estimate: Callable[[], int] = lambda: 0,
    ) -> JobState:
        """Create a job with these cases, or return the job created earlier with the same idempotency key.

        See `JobManager.accept` for the parameters.
        """
        idempotency = Idempotency(self._token, digest) if self._token else None
        owner = self._context.principal.owner
        state, new = await self._jobs.accept(
            self.operation,
            blocks,
            owner=owner,
            queue=self._context.queue_owner,
            idempotency=idempotency,
            sweep=sweep,
            charge=charge,
            count=count,
            estimate=estimate,
        )
        self._context.job = state.id
        if not new:  # The request that created the job has already been charged.
            self._context.give_back()
        return state

    async def wait(self, state: JobState) -> tuple[JobState, bool, dict[str, str]]:
        """Wait for the job as long as the client prefers.

        Returns
        -------
        state
            State of the job after the wait.
        answered
            True if the response should be the results.
        headers
            `Vary`, and `Preference-Applied` if a preference was applied.
        """
        # A proxy may close a connection on which nothing is sent for too long, so the service limits the wait.
        waited = None if self.preference.wait is None else min(self.preference.wait, self._settings.most_wait_seconds)
        if waited:
            changes = until(self._stopping, self._jobs.changes(state.id))
            with suppress(TimeoutError):
                async with asyncio.timeout(waited), aclosing(changes):
                    async for change in changes:
                        state = change
        headers = {**VARY, **self.preference.applied(waited)}
        return state, waited is not None and state.status == "successful", headers

    def accepted(self, state: JobState, headers: dict[str, str]) -> Response:
        """Return a response with status 202, the job and its location."""
        headers = headers | {"Location": f"{self.root}/jobs/{state.id}"} | retry_after(state, self._jobs)
        return job_response(self.root, state, HTTPStatus.ACCEPTED, headers, queue=queue_of(state, self._jobs))


class BatchResponse(JobResponse):
    """The response to a batch or a sweep.

    Raises
    ------
    HTTPException
        406 if the client accepts none of the media types.
    """

    def __init__(self, request: Request, operation: str, preference: Preference, idempotency_key: str) -> None:
        form = choose(request.headers.get("accept", "*/*"), FORMS)
        if form is None:
            raise HTTPException(HTTPStatus.NOT_ACCEPTABLE, f"results are given as {' or '.join(FORMS)}")
        super().__init__(request, operation, preference, idempotency_key)
        self.form = form

    async def to(self, body: BatchBody) -> Response:
        """Return a response with the results, or with the job that computes them.

        A request that fails or is cancelled before it has results or a job is not charged.
        """
        try:
            # Only as many cases are read here as are needed to choose between results and a job. The job manager reads
            # the rest, and refuses too many cases early.
            operation, blocks = OPERATIONS[self.operation], self._charged(body.blocks)
            if operation.study is None:
                small, rest = await take(blocks, self._settings.small_cases, operation.cost)
            else:
                small, rest = await take(blocks, self._settings.small_samples, attrgetter("work"))
            if rest is None and not self.preference.respond_async:
                return await self._answer_now(small, body.sweep)
            state = await self.accept(
                chain(small, rest), body.digest, body.sweep, count=body.count, estimate=body.estimate
            )
        except BaseException:
            self._context.give_back()
            raise
        state, answered, headers = await self.wait(state)
        return self._answer_all(state, body.sweep, headers) if answered else self.accepted(state, headers)

    async def _charged(self, blocks: AsyncIterator[list[JobCase]]) -> AsyncIterator[list[JobCase]]:
        async for cases in blocks:
            self._context.take(sum(case.request.work for case in cases))
            yield cases

    async def _answer_now(self, cases: Sequence[JobCase], sweep: StoredSweep | None) -> Response:
        results = self._jobs.run_now(self.operation, cases, owner=self._context.queue_owner)
        if self.form == JSONL:
            beginning = begin(results)  # An error before the first result still gets an error status.
            begun = await unless_left(self._request, beginning)
            lines = (to_lines([result], self.path, sweep) async for result in begun)
            return StreamingResponse(closing(lines, results), media_type=JSONL, headers=VARY)
        found = await unless_left(self._request, all_of(results))
        # `Cache-Status` has one value for the whole response: a hit only if no case was computed.
        status = "ricochet; hit" if all(result.cached for result in found) else "ricochet; fwd=miss"
        if self.form == CSV:
            content = csv_head(self.operation, sweep) + csv_rows(found, self.operation, sweep)
        else:
            content = b'{"results":[%b]}' % b",".join(to_item(result, self.path, sweep) for result in found)
        return Response(content, media_type=self.form, headers={**VARY, "Cache-Status": status})

    def _answer_all(self, state: JobState, sweep: StoredSweep | None, headers: dict[str, str]) -> Response:
        ready = ReadyResults(self._jobs, state, sweep, take=self._context.take)
        path = f"{self.root}/jobs/{state.id}/results"
        if self.form == CSV:
            content = as_csv(ready)
        else:
            content = as_lines(ready, path) if self.form == JSONL else as_array(ready, path)
        headers = {**headers, "Content-Location": path}
        return StreamingResponse(content, media_type=self.form, headers=headers)


def batch_route(operation: Operation, many: Many) -> Callable[..., Awaitable[Response]]:
    """Return the handler of the batch route of an operation."""

    async def handle(request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = "") -> Response:
        response = BatchResponse(request, operation.name, preference, idempotency_key)
        return await response.to(await BatchReader(request, operation.name, many.models.case).read_batch())

    return handle


def sweep_route(operation: Operation, many: Many) -> Callable[..., Awaitable[Response]]:
    """Return the handler of the sweep route of an operation."""

    async def handle(request: Request, preference: WantedPreference, idempotency_key: IdempotencyKey = "") -> Response:
        response = BatchResponse(request, operation.name, preference, idempotency_key)
        return await response.to(await BatchReader(request, operation.name, many.models.base).read_sweep())

    return handle


async def take(
    blocks: AsyncIterator[list[JobCase]], most: int, cost: Callable[[KeyedRequest], int]
) -> tuple[list[JobCase], AsyncIterator[list[JobCase]] | None]:
    """Read blocks until the cases cost more than `most`; return the cases read, and the remaining blocks or None."""
    taken: list[JobCase] = []
    total = 0
    async for cases in blocks:
        taken += cases
        total += sum(cost(case.request) for case in cases)
        if total > most:
            return taken, blocks
    return taken, None


async def chain(first: list[JobCase], rest: AsyncIterator[list[JobCase]] | None) -> AsyncIterator[list[JobCase]]:
    """Yield the first cases and then the remaining blocks."""
    yield first
    if rest is not None:
        async for cases in rest:
            yield cases


async def begin(results: AsyncGenerator[CaseResult, None]) -> AsyncIterator[CaseResult]:
    """Wait for the first result, and return an iterator over all results."""
    first = await anext(results, None)

    async def resumed() -> AsyncIterator[CaseResult]:
        if first is not None:
            yield first
        async for result in results:
            yield result

    return resumed()


async def all_of(results: AsyncGenerator[CaseResult, None]) -> list[CaseResult]:
    """Collect all results, in the order of their cases."""
    async with aclosing(results):
        return sorted([result async for result in results], key=lambda result: result.number)


async def until(stopping: asyncio.Event, changes: AsyncGenerator[JobState, None]) -> AsyncGenerator[JobState, None]:
    """Yield the changes of a job until the service begins to stop."""
    stopped = asyncio.ensure_future(stopping.wait())
    async with aclosing(changes):
        try:
            while not stopped.done():
                change = asyncio.ensure_future(anext(changes, None))
                try:
                    await asyncio.wait({change, stopped}, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    # A generator cannot be closed while its next item is being awaited.
                    await settle(change)
                if change.cancelled() or (state := change.result()) is None:
                    return
                yield state
        finally:
            stopped.cancel()


async def settle(task: asyncio.Future[Any]) -> None:
    """Cancel a task unless it is done, and wait until it has ended."""
    if not task.done():
        task.cancel()
        # Without the shield the wait would be cancelled too: this often runs while a request is being cancelled.
        with CancelScope(shield=True):
            await asyncio.wait({task})


async def closing(content: AsyncIterator[bytes], source: AsyncGenerator[Any, None]) -> AsyncIterator[bytes]:
    """Yield the content, and close the source even if the client leaves before the end."""
    async with aclosing(source):
        async for part in content:
            yield part


def retry_after(state: JobState, jobs: JobManager) -> dict[str, str]:
    """Return the `Retry-After` header for a job: its estimated remaining time, at most `LONGEST_RETRY`."""
    return {"Retry-After": str(min(LONGEST_RETRY, jobs.seconds_until_done(state)))}


def queue_of(state: JobState, jobs: JobManager) -> dict[str, int] | None:
    """Return the number of jobs ahead of a job and its estimated remaining time; None if it has ended."""
    if state.final:
        return None
    return {"jobs_ahead": jobs.jobs_ahead(state), "remaining_s": jobs.seconds_until_done(state)}


def root_of(request: Request) -> str:
    """Return the path prefix under which a proxy publishes the service; empty without a proxy."""
    root: str = request.scope.get("root_path", "")
    return root


def job_response(
    root: str,
    state: JobState,
    status: HTTPStatus = HTTPStatus.OK,
    headers: dict[str, str] | None = None,
    request: dict[str, Any] | None = None,
    partial: dict[str, Any] | None = None,
    queue: dict[str, int] | None = None,
) -> Response:
    """Return a response with a job."""
    return Response(job_json(root, state, request, partial, queue), status, media_type=JSON, headers=headers)


def job_json(
    root: str,
    state: JobState,
    request: dict[str, Any] | None = None,
    partial: dict[str, Any] | None = None,
    queue: dict[str, int] | None = None,
) -> bytes:
    """Return a job as JSON."""
    return orjson.dumps(to_job(root, state, request, partial, queue), option=orjson.OPT_UTC_Z)


def to_job(
    root: str,
    state: JobState,
    request: dict[str, Any] | None = None,
    partial: dict[str, Any] | None = None,
    queue: dict[str, int] | None = None,
) -> dict[str, Any]:
    """Return a job in the form of the contract; `request`, `partial` and `queue` are included if given."""
    path = f"{root}/jobs/{state.id}"
    times = {name: getattr(state, name) for name in ("created", "started", "finished", "expires")}
    problem = None if state.problem is None else {**state.problem, "instance": path}
    return {
        "id": state.id,
        "operation": state.operation,
        "status": state.status,
        "counts": {name: getattr(state, name) for name in ("total", "done", "cached", "failed")},
        **{k: v for k, v in {"title": state.title, **times, "problem": problem}.items() if v is not None},
        **({"queue": queue} if queue else {}),
        **({"axes": state.axes} if state.axes else {}),
        **({"request": request} if request else {}),
        **({"progress": state.progress} if state.progress else {}),
        **({"partial": partial} if partial else {}),
        "links": {"self": path, **{name: f"{path}/{name}" for name in ("results", "events", "cancel")}},
    }
