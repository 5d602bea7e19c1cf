"""One case computed in this process, by what a worker of the service would run."""

import json
from importlib import import_module
from typing import Any

from pydantic import ValidationError

from service.commands.errors import RefusedError
from service.engine import Operation, name_request
from service.keys import SCHEMA_VERSION
from service.kinds import INVALID, content, problem_of
from service.results.record import Record
from service.schemas.alternatives import alternative_requests, answered_alternative, with_alternatives
from service.schemas.pointers import pointer_of_location
from solver import ENGINE_VERSION, RicochetError

OPERATIONS = {"trajectory": "TRAJECTORY", "cra": "CRITICAL_ANGLE"}
"""Name of each in its module among the routes."""


def compute(name: str, body: dict[str, Any]) -> bytes:
    """Return the answer that a service would give.

    Raises
    ------
    RefusedError
        If there is none.
    """
    operation: Operation = getattr(import_module(f"service.routes.{name}"), OPERATIONS[name])
    try:
        request = operation.parse(json.dumps(body).encode())
        record = computed(name, operation, request)
    except ValidationError as error:
        errors = [{"pointer": pointer_of_location(each["loc"]), "detail": each["msg"]} for each in error.errors()]
        raise RefusedError(content(INVALID, "", errors)) from None
    except RicochetError as error:
        raise RefusedError(problem_of(error)) from None
    if not request.alternatives:
        return record.json
    others = alternative_requests(request)
    return with_alternatives(record.json, [attempt(name, operation, laws, other) for laws, other in others])


def computed(name: str, operation: Operation, request: Any) -> Record:
    """Return the record of a request."""
    key, canonical = name_request(name, request)
    function, arguments = operation.call(request)
    answer, history = operation.answer(request, function(*arguments))
    return Record(key, name, canonical, answer, history, ENGINE_VERSION, SCHEMA_VERSION)


def attempt(name: str, operation: Operation, laws: dict[str, Any], request: Any) -> dict[str, Any]:
    """Return an alternative with its answer, or with the problem in its place."""
    try:
        return answered_alternative(laws, computed(name, operation, request).answer)
    except RicochetError as error:
        return {**laws, "problem": {**problem_of(error), "instance": f"/{name}"}}
