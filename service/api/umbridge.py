"""UM-Bridge 1.0 (Seelinger et al., 2023): critical angles and trajectories as models for uncertainty software.

A model has one input vector and one output vector. `config` may replace parts of the paper's strike and choose the
inputs; an input is the number in a field of the request, divided by the `scale` of the input. Errors have the format of
the protocol.

References
----------
Seelinger, L. et al. (2023), UM-Bridge: uncertainty quantification and modeling bridge, J. Open Source Softw. 8, 4748.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Annotated, Any

import orjson
from fastapi import APIRouter, HTTPException, Request, Response
from pydantic import Field, TypeAdapter, ValidationError

from service.api.body import BodyLimits, next_turn, parse_json, read_body
from service.api.negotiation import JSON
from service.api.queries import resolve, validated
from service.api.services import services_of
from service.auth.dependencies import RUN
from service.errors import InvalidBodyError, ProblemType, ServiceError, errors_found, problem_of, validation_errors
from service.operations import OPERATIONS
from service.schemas.quantities import Num, Part
from service.schemas.strike import PAPER, PAPER_AT_45
from service.schemas.sweeps import check_field
from service.schemas.uncertain_inputs import MODELS, with_values
from solver import Outcome, RicochetError, SearchStatus
from solver.uncertainty.next_shot import RESIDUAL
from solver.uncertainty.sampling import MOST_INPUTS

FEATURES = ("Evaluate", "Gradient", "ApplyJacobian", "ApplyHessian")
STATUSES = list(SearchStatus)
OUTCOMES = [Outcome.EMBEDDED, Outcome.RICOCHET, Outcome.IN_MOTION, Outcome.PERFORATED]

router = APIRouter(prefix="/umbridge", dependencies=[RUN], include_in_schema=False)
"""Router outside the OpenAPI document: the protocol defines the routes, and its errors are not problem documents."""


class ModelInput(Part):
    """One element of the input vector: the number in `field` of the request, divided by `scale`."""

    field: Annotated[str, Field(max_length=100)]  # longer than any path
    scale: Annotated[Num, Field(gt=0.0)] = 1.0


DEFAULT_INPUTS = [
    ModelInput(field="impact.velocity_m_s"),
    ModelInput(field="target.compressive_strength_pa", scale=1e6),
]
INPUTS = TypeAdapter(Annotated[list[ModelInput], Field(min_length=1, max_length=MOST_INPUTS)])
VECTOR = TypeAdapter(list[Num])


def critical_angle_output(answer: Mapping[str, Any]) -> list[float]:
    """Return the critical angle [°] and the index of the status in `STATUSES`.

    If there is no critical angle, 0° is returned if every angle gives a ricochet, else 90° (no ricochet, or not
    converged).
    """
    status = SearchStatus(answer["status"])
    limit = 0.0 if status is SearchStatus.ALWAYS_RICOCHET else 90.0
    return [answer.get("critical_angle_deg", limit), float(STATUSES.index(status))]


def trajectory_output(answer: Mapping[str, Any]) -> list[float]:
    """Return the index of the outcome in `OUTCOMES`, maximum depth, exit speed and exit angle. [1, m, m/s, °]

    The depth is 0 if the wall is perforated, and the angle is 0 unless the projectile ricochets: the protocol cannot
    express missing numbers.
    """
    outcome, left = Outcome(answer["outcome"]), answer.get("exit", {"speed_m_s": 0.0})
    angle = left["direction_deg"] if outcome is Outcome.RICOCHET else 0.0
    return [float(OUTCOMES.index(outcome)), answer.get("maximum_depth_m", 0.0), left["speed_m_s"], angle]


@dataclass(frozen=True, slots=True)
class Model:
    """A UM-Bridge model: an operation as a function from an input vector to an output vector."""

    base: Mapping[str, Any]
    """Request that `config` modifies and the inputs vary."""
    size: int
    """Length of the output vector."""
    output: Callable[[Mapping[str, Any]], list[float]]


STRIKE = {**PAPER_AT_45, "output": {"history": False}}
UMBRIDGE_MODELS = {"cra": Model(PAPER, 2, critical_angle_output), "trajectory": Model(STRIKE, 4, trajectory_output)}
"""Models, keyed by the names of their operations."""


class ProtocolError(Exception):
    """An error that is reported in the format of the protocol.

    Parameters
    ----------
    name
        Type of the error in the protocol.
    message
        Text of the error.
    """

    def __init__(self, name: str, message: str, status: int = HTTPStatus.BAD_REQUEST) -> None:
        super().__init__(message)
        self.name = name
        self.status = status


@router.get("/Info")
async def info() -> dict[str, Any]:
    """Return the version of the protocol and the names of the models."""
    return {"protocolVersion": 1.0, "models": list(UMBRIDGE_MODELS)}


@router.post("/{endpoint}")
async def call(endpoint: str, request: Request) -> Response:
    """Respond to a protocol call, with a protocol error if the call fails."""
    try:
        content = await answer(endpoint, request)
    except ProtocolError as error:
        content, status = {"error": {"type": error.name, "message": str(error)}}, error.status
        return Response(orjson.dumps(content), status, media_type=JSON)
    return Response(orjson.dumps(content), media_type=JSON)


async def answer(endpoint: str, request: Request) -> dict[str, Any]:
    """Return the answer to a call.

    Raises
    ------
    ProtocolError
        If the call is not valid or cannot be computed.
    """
    services = services_of(request)
    try:
        limits = BodyLimits.of_one(services.settings)
        body = await read_body(request, limits)
        await next_turn(services.parsing)
        content = parse_json(body or b"{}", limits)
    except InvalidBodyError as error:
        raise protocol_error(error) from None
    except HTTPException as error:
        raise ProtocolError("InvalidInput", str(error.detail), error.status_code) from None
    if not isinstance(content, dict):
        raise ProtocolError("InvalidInput", "the body must be an object")
    if endpoint in FEATURES[1:]:
        raise ProtocolError("UnsupportedFeature", f"{endpoint} is not supported by any model")
    if endpoint not in {"ModelInfo", "InputSizes", "OutputSizes", "Evaluate"}:
        raise ProtocolError("UnsupportedFeature", f"there is no {endpoint}", HTTPStatus.NOT_FOUND)
    name = content.get("name")
    model = UMBRIDGE_MODELS.get(name) if isinstance(name, str) else None
    if not isinstance(name, str) or model is None:
        raise ProtocolError("ModelNotFound", f"name must be one of {', '.join(UMBRIDGE_MODELS)}")
    if endpoint == "ModelInfo":
        return {"support": {feature: feature == "Evaluate" for feature in FEATURES}}
    if endpoint == "OutputSizes":
        return {"outputSizes": [model.size]}
    try:
        inputs, base = read_config(name, model, content.get("config"))
        if endpoint == "InputSizes":
            return {"inputSizes": [len(inputs)]}
        values = read_input(content.get("input"), len(inputs))
        scaled = [value * each.scale for value, each in zip(values, inputs, strict=True)]
        operation = OPERATIONS[name]
        case = validated(with_values(base, [each.field for each in inputs], scaled), operation, services)
        # The output vector has no place for alternatives, each of which would cost a computation.
        case = case.model_copy(update={"alternatives": False})
        found = await resolve(request, operation, case)
    except (ServiceError, RicochetError) as error:
        raise protocol_error(error) from error
    return {"output": [model.output(orjson.loads(found.content))]}


def read_config(name: str, model: Model, config: object) -> tuple[list[ModelInput], dict[str, Any]]:
    """Return the inputs and the request that they vary.

    Raises
    ------
    ProtocolError
        If `config` is not an object, or an input is not a number of the request or occurs twice.
    InvalidBodyError
        If `inputs` is not a valid list of inputs.
    """
    if not isinstance(config, dict | None):
        raise ProtocolError("InvalidInput", "config must be an object")
    parts = dict(config or {})
    inputs = DEFAULT_INPUTS
    if "inputs" in parts:
        try:
            inputs = INPUTS.validate_python(parts.pop("inputs"))
        except ValidationError as error:
            found = [{**each, "loc": ("config", "inputs", *each["loc"])} for each in errors_found(error)]
            raise InvalidBodyError(validation_errors(found)) from error
    base = {**model.base, **parts}
    fields = [each.field for each in inputs]
    for index, field in enumerate(fields):
        place = f"config.inputs.{index}.field"
        if field in fields[:index]:
            raise ProtocolError("InvalidInput", f"{place}: {field!r} is an input already")
        if field in MODELS:
            raise ProtocolError("InvalidInput", f"{place}: {field!r} is no number")
        if field != RESIDUAL:
            try:
                check_field(OPERATIONS[name].request, base, field.split("."))
            except LookupError as error:
                raise ProtocolError("InvalidInput", f"{place}: {field!r} {error.args[0]}") from None
    return inputs, base


def read_input(content: object, size: int) -> list[float]:
    """Return the input vector.

    Raises
    ------
    ProtocolError
        If the content is not a list of one list of `size` finite numbers.
    """
    if not isinstance(content, list) or [len(each) if isinstance(each, list) else -1 for each in content] != [size]:
        raise ProtocolError("InvalidInput", f"input must be one list of {size} numbers")
    try:
        return VECTOR.validate_python(content[0])
    except ValidationError as error:
        detail = validation_errors([{**each, "loc": ("input", 0, *each["loc"])} for each in errors_found(error)[:1]])[0]
        raise ProtocolError("InvalidInput", f"{detail['pointer']}: {detail['detail']}") from None


def protocol_error(error: Exception) -> ProtocolError:
    """Convert an error of the service or the solver to a protocol error."""
    message, status = str(problem_of(error)["detail"]), ProblemType.of(error).status
    if status == HTTPStatus.UNPROCESSABLE_ENTITY:
        return ProtocolError("InvalidInput", message)
    return ProtocolError("InvalidOutput", message, status)
