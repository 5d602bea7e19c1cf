"""Routes of the operations: single requests, studies, batches and sweeps."""

from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any

from fastapi import APIRouter, Response
from pydantic import BaseModel

from service.api.batch_response import batch_route, sweep_route
from service.api.body import CheckedRoute, LongBodyRoute
from service.api.contract import COMPUTED, MANY, STUDIED, many_bodies, one_body
from service.api.queries import single_route
from service.api.studies import study_route
from service.auth.dependencies import RUN
from service.operations import Many, Operation

PREFERENCES = (
    "`Prefer: respond-async` always creates a job. `Prefer: wait=10` waits up to 10 seconds for a job, at most 30 "
    "unless the service is configured otherwise; the answer is 200 if the job has succeeded by then, else 202."
)
ANSWERED = (
    "\n\nUp to 100 cases are answered at once with 200. More become a job: the answer is 202, and the results are at "
    "`/jobs/{job_id}/results`. A search for perforation counts as 20 cases, and a service may be configured to "
    f"a number other than 100. {PREFERENCES}"
)
"""Paragraph in the descriptions of batch and sweep routes, except for studies, that states when the answer is a job."""
STUDIES_ANSWERED = (
    "\n\nEach study counts as its `max_samples`, also against a quota. Up to 16,384 samples are answered at once with "
    "200. More become a job: the answer is 202, and the results are at `/jobs/{job_id}/results`. A service may be "
    "configured to a number other than 16,384. The answer to each study is stored, but not its samples. "
    f"{PREFERENCES}"
)
"""Paragraph in the descriptions of batch and sweep routes of studies that states when the answer is a job."""
STUDY_ANSWERED = (
    "\n\nThe answer is 200 once the samples are computed. A study whose `max_samples` exceeds 16,384, unless the "
    "service is configured otherwise, becomes a job and is answered with 202, unless its answer is stored. "
    f"{PREFERENCES}"
)
"""Paragraph in the descriptions of study routes that states when the answer is a job."""


def add_routes(router: APIRouter, operations: Mapping[str, Operation]) -> None:
    """Add the routes of the given operations. Batch and sweep routes are sorted by the number of runs of a case.

    `router` is the application's own, because FastAPI matches the routes of an included router twice.
    """
    # The routes of studies come last.
    in_order = sorted(operations.values(), key=lambda each: each.study is not None)
    many = [
        (each, each.many)
        for each in sorted(in_order, key=lambda each: (each.study is not None, each.runs))
        if each.many is not None
    ]
    for each in in_order:
        if each.study is None:
            add(router, each, single_route(each), responses=COMPUTED)
    for each, found in many:
        add_many(router, each, found, "batch", found.batch, batch_description(each), batch_route(each, found))
    for each, found in many:
        add_many(router, each, found, "sweep", found.sweep, sweep_description(each), sweep_route(each, found))
    for each in in_order:
        if each.study is not None:
            add(router, each, study_route(each), responses=STUDIED)


def bodies_of(operations: Iterable[Operation]) -> list[type[BaseModel]]:
    """Return the models of batches and sweeps, whose bodies the routes read themselves, without FastAPI."""
    found: list[type[BaseModel]] = []
    for each in operations:
        found += (each.many.models.batch, each.many.models.sweep) if each.many else ()
    return found


def add(router: APIRouter, operation: Operation, handle: Callable[..., Awaitable[Response]], **options: Any) -> None:
    """Add the route for a single request of an operation."""
    router.add_api_route(
        operation.path,
        handle,
        methods=["POST"],
        name=operation.route,
        description=operation.description + (STUDY_ANSWERED if operation.study is not None else ""),
        response_model=operation.answer,
        route_class_override=LongBodyRoute if operation.long else CheckedRoute,
        tags=[operation.tag],
        dependencies=[RUN],
        **options,
    )


def add_many(
    router: APIRouter,
    operation: Operation,
    many: Many,
    kind: str,
    names: tuple[str, str],
    description: str,
    handle: Callable[..., Awaitable[Response]],
) -> None:
    """Add the route for batches or for sweeps of an operation."""
    models = many.models
    router.add_api_route(
        f"{operation.path}/{kind}",
        handle,
        methods=["POST"],
        name=names[0],
        description=f"{names[1]}{description}",
        response_model=models.results,
        responses=MANY,
        route_class_override=CheckedRoute,
        openapi_extra=many_bodies(models.batch, models.case) if kind == "batch" else one_body(models.sweep),
        tags=[operation.tag],
        dependencies=[RUN],
    )


def answered(operation: Operation) -> str:
    """Return the paragraph in the descriptions of batch and sweep routes that states when the answer is a job."""
    return ANSWERED if operation.study is None else STUDIES_ANSWERED


def batch_description(operation: Operation) -> str:
    """Return the description of a batch route without its first words, which name the operation."""
    note = operation.many.note if operation.many else ""
    return (
        ": up to 1000 as JSON, up to 100,000 as JSON lines.\n\n"
        f"{note}{' ' * bool(note)}"
        "The whole batch is refused if one case is invalid, and the problem names that case: `/cases/17/...` in JSON, "
        "counted from 0; the line in JSONL, counted from 1 in the text and from 0 in the pointer. An error in a line "
        "that only the solver finds is the problem of that case alone."
        f"{answered(operation)}"
    )


def sweep_description(operation: Operation) -> str:
    """Return the description of a sweep route without its first words, which name the operation."""
    return (
        " for every combination of the values of the axes, the last axis fastest."
        "\n\nUp to 100,000 points. The sweep is refused at the first point that is not a valid request, and the "
        "problem names the values of its axes. An error that only the solver finds at a point is the problem of that "
        "point alone."
        f"{answered(operation)}"
    )
