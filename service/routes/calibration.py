"""Strength factors from tests: from depths, from motions, and over obliquity.

Their requests may be as long as those of many cases, and are read like them: in a thread, and with a limit on all that
could be wrong with them.
"""

from dataclasses import dataclass
from typing import Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, Response
from pydantic import MISSING, BaseModel, ValidationError

from service.engine import Engine, Named, Operation, name_request
from service.pool.worker import run_depth_calibration, run_motion_calibration, run_obliquity_calibration
from service.problems import InvalidBodyError, errors_told
from service.routes.body import JSON, parse_json, require_type, stream_up_to
from service.routes.contract import COMPUTED, AskedEngine, computed, one_body
from service.schemas import (
    DepthCalibrationAnswer,
    DepthCalibrationRequest,
    MotionCalibrationAnswer,
    MotionCalibrationRequest,
    ObliquityCalibrationAnswer,
    ObliquityCalibrationRequest,
    depth_answer,
    motion_answer,
    obliquity_answer,
)
from service.schemas.pointers import json_pointer

MOST_FIELDS = 20
"""Of an object of these requests, which have half as many: what is wrong with each of a million would take a second
to tell."""

COUNTS = 20
"""Cases that a fit counts as: it takes as long."""
MOTION_FITS = 3
"""Fits of each motion: one with every decay law."""

router = APIRouter(tags=["calibration"])

OPERATIONS = {
    "calibration_depth": Operation(
        call=lambda case: (run_depth_calibration, case.arguments()),
        answer=lambda _, found: (depth_answer(found.fit, found.curves), None),
        parse=DepthCalibrationRequest.model_validate_json,
    ),
    "calibration_motion": Operation(
        call=lambda case: (run_motion_calibration, case.arguments()),
        answer=lambda _, found: (motion_answer(found.fits, found.compared, several=found.several), None),
        parse=MotionCalibrationRequest.model_validate_json,
    ),
    "calibration_obliquity": Operation(
        call=lambda case: (run_obliquity_calibration, (case.arguments(),)),
        answer=lambda _, fit: (obliquity_answer(fit), None),
        parse=ObliquityCalibrationRequest.model_validate_json,
    ),
}


@router.post(
    "/calibration/depth",
    response_model=DepthCalibrationAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(DepthCalibrationRequest),
)
async def calibrate_by_depth(request: Request, engine: AskedEngine) -> Response:
    """Find the strength factor that fits depths of penetration best, by weighted least squares.

    The shots are along the normal, of one projectile into one target.
    """
    return await answer_long(request, "calibration_depth", DepthCalibrationRequest, engine)


@router.post(
    "/calibration/motion",
    response_model=MotionCalibrationAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(MotionCalibrationRequest),
)
async def calibrate_by_motion(request: Request, engine: AskedEngine) -> Response:
    """Find the strength factor that fits the motion in oblique strikes best, measured or by finite elements.

    Of one strike, or of several `runs` at any angles and speeds with one strength factor; with every decay law.
    """
    return await answer_long(request, "calibration_motion", MotionCalibrationRequest, engine)


@router.post(
    "/calibration/obliquity",
    response_model=ObliquityCalibrationAnswer,
    responses=COMPUTED,
    openapi_extra=one_body(ObliquityCalibrationRequest),
)
async def calibrate_over_obliquity(request: Request, engine: AskedEngine) -> Response:
    """Fit a polynomial in the oblique angle to strength factors.

    The answer holds it in the form in which a `resistance` takes it, so that `/cra` gives its angle a standard error.
    """
    return await answer_long(request, "calibration_obliquity", ObliquityCalibrationRequest, engine)


async def answer_long(request: Request, operation: str, model: type[BaseModel], engine: Engine) -> Response:
    """Read a request and reply with its result."""
    require_type(request, JSON)
    state = request.app.state
    body = b"".join([chunk async for chunk in stream_up_to(request, state.settings.max_batch_bytes)])
    asked = await run_sync(read_asked, body, operation, model, state.settings.max_body_depth, limiter=state.reading)
    return await computed(request, operation, asked.case, engine, asked.named, counts=_counts(asked.case))


def _counts(case: Any) -> int:
    """Cases that a calibration counts as."""
    if not isinstance(case, MotionCalibrationRequest):
        return COUNTS
    return COUNTS * MOTION_FITS * (1 if case.runs is MISSING else len(case.runs))


@dataclass(frozen=True, slots=True)
class Asked:
    """A validated request and its name."""

    case: Any
    named: Named


def read_asked(body: bytes, operation: str, model: type[BaseModel], most_deep: int) -> Asked:
    """Validate a body.

    Raises
    ------
    HTTPException, InvalidBodyError
        If it is no request.
    """
    content = parse_json(body, most_deep)
    refuse_crowds(content)
    try:
        case: Any = model.model_validate(content)
    except ValidationError as error:
        raise InvalidBodyError(errors_told(error.errors())) from error
    return Asked(case, name_request(operation, case))


def refuse_crowds(content: Any, steps: tuple[str | int, ...] = ()) -> None:
    """Refuse objects with too many fields, at any depth."""
    if isinstance(content, dict):
        if len(content) > MOST_FIELDS:
            detail = f"has {len(content)} fields, most of them unknown"
            raise InvalidBodyError([{"pointer": json_pointer(steps), "detail": detail}])
        for name, item in content.items():
            refuse_crowds(item, (*steps, name))
    elif isinstance(content, list):
        for index, item in enumerate(content):
            if isinstance(item, dict | list):
                refuse_crowds(item, (*steps, index))
