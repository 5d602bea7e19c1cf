"""Helpers for refused requests: bodies with one changed field, and checks of the problem in the answer."""

import copy
from typing import Any

import httpx

from service.schemas.problems import Problem

TEXT = {"Content-Type": "application/json"}
LITERALS = ["NaN", "Infinity", "-Infinity", "1e999", "-1e999", '"1"', "true", "null", "[1]", "{}", "1" + "0" * 400]


def problem_of(response: httpx.Response, status: int) -> Problem:
    assert response.status_code == status, response.text
    assert response.headers["Content-Type"] == "application/problem+json"
    found = Problem.model_validate(response.json())
    assert found.status == status
    assert found.instance == response.request.url.path
    return found


def refused_at(response: httpx.Response, *pointers: str, status: int = 422) -> Problem:
    """Check that a request was refused with errors at exactly these JSON pointers; return the problem."""
    found = problem_of(response, status)
    assert [error.pointer for error in found.errors] == list(pointers), found
    return found


def changed(body: dict[str, Any], pointer: str, value: Any) -> dict[str, Any]:
    """Return a copy of the body with another value at a JSON pointer, or without that field if the value is `...`."""
    result: Any = copy.deepcopy(body)
    *parents, last = pointer.strip("/").split("/")
    place = result
    for name in parents:
        place = place[int(name)] if isinstance(place, list) else place.setdefault(name, {})
    if value is ...:
        del place[last]
    else:
        place[int(last) if isinstance(place, list) else last] = value
    assert isinstance(result, dict)
    return result
