"""One case computed in this process, by what a worker of the service would run."""

import json
from typing import Any

from pydantic import ValidationError

from service.cache.record import Record
from service.cache_key import KeyedRequest
from service.commands.errors import RefusedError
from service.errors import InvalidBodyError, problem_of, validation_errors
from service.operations import OPERATIONS
from service.schemas.alternatives import alternative_requests, answered_alternative, with_alternatives
from solver import RicochetError


def compute(name: str, body: dict[str, Any]) -> bytes:
    """Return the answer that a service would give.

    Raises
    ------
    RefusedError
        If there is none.
    """
    try:
        request: Any = OPERATIONS[name].request.model_validate_json(json.dumps(body))
        record = computed(name, request)
    except ValidationError as error:
        raise RefusedError(problem_of(InvalidBodyError(validation_errors(error.errors())))) from None
    except RicochetError as error:
        raise RefusedError(problem_of(error)) from None
    if not request.alternatives:
        return record.json
    others = alternative_requests(request)
    return with_alternatives(record.json, [attempt(name, laws, other) for laws, other in others])


def computed(name: str, request: Any) -> Record:
    """Return the record of a request."""
    query = KeyedRequest.of(name, request)
    return Record(query.key, name, query.json, *OPERATIONS[name].compute(query.json))


def attempt(name: str, laws: dict[str, Any], request: Any) -> dict[str, Any]:
    """Return an alternative with its answer, or with the problem in its place."""
    try:
        return answered_alternative(laws, computed(name, request).answer)
    except RicochetError as error:
        return {**laws, "problem": {**problem_of(error), "instance": f"/{name}"}}
