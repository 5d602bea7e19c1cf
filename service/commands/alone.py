"""One case computed in this process, by what a worker of the service would run."""

import json
from typing import Any

import orjson
from pydantic import ValidationError

from service.cache.record import Record
from service.cache_key import result_key
from service.commands.errors import RefusedError
from service.errors import InvalidBodyError, problem_of, validation_errors
from service.operations import OPERATIONS
from solver import RicochetError


def compute(name: str, body: dict[str, Any]) -> bytes:
    """Return the answer that a service would give.

    Raises
    ------
    RefusedError
        If there is none.
    """
    operation = OPERATIONS[name]
    try:
        request: Any = operation.request.model_validate_json(json.dumps(body))
        canonical = request.canonical()
        content = orjson.dumps(canonical)
        return Record(result_key(name, canonical), name, content, *operation.compute(content)).json
    except ValidationError as error:
        raise RefusedError(problem_of(InvalidBodyError(validation_errors(error.errors())))) from None
    except RicochetError as error:
        raise RefusedError(problem_of(error)) from None
