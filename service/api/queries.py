"""Single queries: one trajectory, one critical angle, one calibration, the formulas for one strike."""

import asyncio
import time
from contextlib import nullcontext
from http import HTTPStatus
from typing import Any, TypeVar

from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ValidationError

from service.api.body import JSON, KnownBody, next_turn, parse_json, read_body, require_type
from service.api.contract import COMPUTED, one_body
from service.api.services import Services, services_of, unless_left
from service.auth.dependencies import RUN, RequestContext, context_in
from service.errors import InvalidBodyError, ProblemType, problem_of, validation_errors
from service.jobs.scheduler import problem_name
from service.operations import OPERATIONS, KeyedRequest
from service.queries import Answered, CacheStatus, check_work
from service.schemas import (
    CriticalAngleAnswer,
    CriticalAngleRequest,
    DepthCalibrationAnswer,
    DepthCalibrationRequest,
    FormulasAnswer,
    FormulasRequest,
    LimitSpeedAnswer,
    LimitSpeedRequest,
    MotionCalibrationAnswer,
    MotionCalibrationRequest,
    ObliquityCalibrationAnswer,
    ObliquityCalibrationRequest,
    ThicknessAnswer,
    ThicknessRequest,
    TrajectoryAnswer,
    TrajectoryRequest,
)
from service.schemas.problems import json_pointer
from service.schemas.requests import alternative_requests, answered_alternative, with_alternatives
from service.telemetry import BEGUN

MAX_FIELDS = 20
"""Fields of an object of a calibration, which has half as many: listing a million errors would take a second."""

Model = TypeVar("Model", bound=BaseModel)

router = APIRouter(dependencies=[RUN])


@router.post(
    "/cra",
    response_model=CriticalAngleAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(CriticalAngleRequest),
    tags=["critical ricochet angle"],
)
async def find_critical_angle(request: Request) -> Response:
    """Find the smallest oblique angle, from the normal, at which a projectile is turned away.

    That there is none in the range is an answer too; its `status` says so.
    """
    return await answer(request, "cra")


@router.post(
    "/trajectory",
    response_model=TrajectoryAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(TrajectoryRequest),
    tags=["trajectory"],
)
async def compute_trajectory(request: Request) -> Response:
    """Compute the motion of a projectile until it is turned away, through, at rest, or out of time."""
    return await answer(request, "trajectory")


@router.post(
    "/calibration/depth",
    response_model=DepthCalibrationAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(DepthCalibrationRequest),
    tags=["calibration"],
)
async def calibrate_by_depth(request: Request) -> Response:
    """Find the strength factor that fits depths of penetration best, by weighted least squares.

    The shots are along the normal, of one projectile into one target.
    """
    return await answer(request, "calibration_depth", long=True)


@router.post(
    "/calibration/motion",
    response_model=MotionCalibrationAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(MotionCalibrationRequest),
    tags=["calibration"],
)
async def calibrate_by_motion(request: Request) -> Response:
    """Find the strength factor that fits the motion in oblique strikes best, measured or by finite elements.

    The motion is that of one strike, or of several `runs` at any angles and speeds, which one strength factor is to fit
    together. The fit is made with every decay law.
    """
    return await answer(request, "calibration_motion", long=True)


@router.post(
    "/calibration/obliquity",
    response_model=ObliquityCalibrationAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(ObliquityCalibrationRequest),
    tags=["calibration"],
)
async def calibrate_over_obliquity(request: Request) -> Response:
    """Fit a polynomial in the oblique angle to strength factors.

    The answer holds it in the form in which a `resistance` takes it, so that `/cra` gives its angle a standard error.
    """
    return await answer(request, "calibration_obliquity", long=True)


@router.post(
    "/formulas",
    response_model=FormulasAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(FormulasRequest),
    tags=["formulas"],
)
async def evaluate_formulas(request: Request) -> Response:
    """Evaluate the empirical formulas of the field: penetration depth, scabbing and perforation thickness.

    Each says whether the strike is in the range it was fitted to. An oblique strike counts with the component of its
    velocity along the normal.
    """
    return await answer(request, "formulas")


@router.post(
    "/thickness",
    response_model=ThicknessAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(ThicknessRequest),
    tags=["walls"],
)
async def find_least_thickness(request: Request) -> Response:
    """Find the least thickness of a wall that a strike does not perforate, beside what the empirical formulas say."""
    return await answer(request, "thickness")


@router.post(
    "/limit-speed",
    response_model=LimitSpeedAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(LimitSpeedRequest),
    tags=["walls"],
)
async def find_limit_speed(request: Request) -> Response:
    """Find the least speed at which a projectile perforates a wall."""
    return await answer(request, "limit-speed")


async def answer(request: Request, operation: str, *, long: bool = False) -> Response:
    """Answer one request: from memory if its very bytes were answered before, else by its validated content.

    Parameters
    ----------
    long
        Whether the body may be as long as that of many cases. It is then validated in a thread.
    """
    services, path, begun = services_of(request), request.scope["path"], request.scope[BEGUN]
    require_type(request, JSON)
    body = await read_body(request, services.settings.max_batch_bytes if long else services.settings.max_body_bytes)
    context = context_in(request.scope)
    known = services.bodies.find(path, body)
    record = None if known is None else services.cache.recall(known.key)
    if known is not None and record is not None:
        context.take(known.cases)
        services.metrics.count(operation, record.outcome, "hit", 1)
        return reply(record.json, "hit", f"total;dur={1e3 * (time.perf_counter() - begun):.2f}")
    if long:
        case = await run_sync(validated_long, body, operation, services, limiter=services.reading)
    elif body:
        await next_turn(services.parsing)
        case = validated(parse_json(body, services.settings.max_body_depth), operation, services)
    else:
        raise InvalidBodyError([{"pointer": "", "detail": "Field required"}])
    read, cases = time.perf_counter(), OPERATIONS[operation].cases(case)
    with context.taking(cases):
        query = await run_sync(KeyedRequest.of, operation, case) if long else KeyedRequest.of(operation, case)
        if getattr(case, "alternatives", False):
            answering = computed_with_alternatives(request, operation, case, query)
            content, status = await unless_left(request, answering)
        else:
            found, status = await unless_left(request, computed(services, context, operation, query))
            content = found.json
            services.bodies.remember(path, body, KnownBody(query.key, cases))
    now = time.perf_counter()
    timing = f"validate;dur={1e3 * (read - begun):.2f}, compute;dur={1e3 * (now - read):.2f}"
    return reply(content, status, f"{timing}, total;dur={1e3 * (now - begun):.2f}")


async def computed_with_alternatives(
    request: Request, operation: str, case: Any, query: KeyedRequest
) -> tuple[bytes, CacheStatus]:
    """Return the answer with those under other laws, each a case of cache and executor like any other."""
    services, context = services_of(request), context_in(request.scope)

    async def attempt(laws: dict[str, Any], other: Any) -> tuple[dict[str, Any], CacheStatus]:
        try:
            found, known = await computed(services, context, operation, KeyedRequest.of(operation, other))
        except Exception as error:
            if ProblemType.of(error).status != HTTPStatus.UNPROCESSABLE_ENTITY:
                raise
            return {**laws, "problem": {**problem_of(error), "instance": request.scope["path"]}}, "miss"
        return answered_alternative(laws, found.answer), known

    others = alternative_requests(case)
    (record, status), *found = await asyncio.gather(
        computed(services, context, operation, query), *(attempt(laws, other) for laws, other in others)
    )
    content = with_alternatives(record.json, [alternative for alternative, _ in found])
    return content, "hit" if all(each == "hit" for each in (status, *(each for _, each in found))) else "miss"


async def computed(services: Services, context: RequestContext, operation: str, query: KeyedRequest) -> Answered:
    """Return the record of a request, and whether it was there; count what has none."""
    try:
        with services.owner_queries.held(context.principal.owner) if context.principal.key else nullcontext():
            return await services.queries.answer(operation, query, context.queue_owner)
    except Exception as error:
        services.metrics.count(operation, problem_name(problem_of(error)), "miss", 1)
        raise


def reply(content: bytes, status: CacheStatus, timing: str) -> Response:
    """Return a result as the answer, with how it came about."""
    headers = {"Cache-Status": "ricochet; hit" if status == "hit" else "ricochet; fwd=miss", "Server-Timing": timing}
    return Response(content, headers=headers, media_type=JSON)


def validated_long(body: bytes, operation: str, services: Services) -> Any:
    """Validate a body that may be long."""
    content = parse_json(body, services.settings.max_body_depth)
    refuse_crowds(content)
    return validated(content, operation, services)


def validated(content: Any, operation: str, services: Services) -> Any:
    """Return the content of a body as a request.

    Raises
    ------
    InvalidBodyError, ParameterError
        If it is not valid, or takes more work than one run may.
    """
    case = validated_as(OPERATIONS[operation].request, content)
    check_work(case, services.settings.max_panel_steps)
    return case


def validated_as(model: type[Model], content: Any) -> Model:
    """Return the content of a body as this model.

    Raises
    ------
    InvalidBodyError
        If it is not valid.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(error.errors())) from error


def refuse_crowds(content: Any, steps: tuple[str | int, ...] = ()) -> None:
    """Refuse objects with too many fields, at any depth."""
    if isinstance(content, dict):
        if len(content) > MAX_FIELDS:
            detail = f"has {len(content)} fields, most of them unknown"
            raise InvalidBodyError([{"pointer": json_pointer(steps), "detail": detail}])
        for name, item in content.items():
            refuse_crowds(item, (*steps, name))
    elif isinstance(content, list):
        for index, item in enumerate(content):
            if isinstance(item, dict | list):
                refuse_crowds(item, (*steps, index))
