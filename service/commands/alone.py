"""One case computed in this process, by what a worker of the service would run."""

import json
from importlib import import_module
from typing import Any

from pydantic import ValidationError

from service.commands.errors import RefusedError
from service.engine import Operation, name_request
from service.errors import InvalidBodyError, problem_of, validation_errors
from service.keys import SCHEMA_VERSION
from service.results.record import Record
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
        key, canonical = name_request(name, request)
        function, arguments = operation.call(request)
        answer, history = operation.answer(request, function(*arguments))
    except ValidationError as error:
        raise RefusedError(problem_of(InvalidBodyError(validation_errors(error.errors())))) from None
    except RicochetError as error:
        raise RefusedError(problem_of(error)) from None
    return Record(key, name, canonical, answer, history, ENGINE_VERSION, SCHEMA_VERSION).json
