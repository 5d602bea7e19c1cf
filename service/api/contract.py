"""The contract beyond what FastAPI writes: headers, problems, access, bodies that routes read themselves."""

from collections.abc import Sequence
from typing import Any, TypeAlias

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from service.api.job_models import Job
from service.problems import MEDIA_TYPE
from service.schemas.problems import Problem

Responses: TypeAlias = dict[int | str, dict[str, Any]]

CACHE_STATUS = {
    "Cache-Status": {
        "description": "`ricochet; hit` if the result was there, `ricochet; fwd=miss` if it was computed (RFC 9211).",
        "schema": {"type": "string"},
        "required": True,
    },
    "Server-Timing": {
        "description": "Milliseconds until the request was read, then until its answer was there, and of both.",
        "schema": {"type": "string"},
        "required": True,
    },
}
RESULT_LINK = {
    "result": {
        "operationId": "get_result",
        "parameters": {"key": "$response.body#/key"},
        "description": "The result again, also as a table.",
    }
}


PREFERENCE_APPLIED = {"Preference-Applied": {"description": "RFC 7240.", "schema": {"type": "string"}}}
RATE_LIMIT = {
    "RateLimit-Policy": {
        "description": "Cases an hour of the key, if they are limited: `q` in `w` seconds "
        "(draft-ietf-httpapi-ratelimit-headers-10).",
        "schema": {"type": "string"},
    },
    "RateLimit": {
        "description": "Cases left (`r`), and seconds until more are free (`t`).",
        "schema": {"type": "string"},
    },
}
RETRY_AFTER = {
    **RATE_LIMIT,
    "Retry-After": {
        "description": "When to send the request again. [s]",
        "schema": {"type": "integer"},
        "required": True,
    },
}
RETRY_LATER: dict[str, Any] = {
    "headers": {
        "Retry-After": {
            "description": "When to send the request again, unless it has ended. [s]",
            "schema": {"type": "integer"},
        }
    }
}
PROBLEMS: Responses = {
    400: {"description": "The body cannot be parsed."},
    404: {"description": "Nothing is kept under this name."},
    406: {"description": "The result is not given in a form that `Accept` names."},
    409: {"description": "The request with this idempotency key is still being accepted."},
    413: {"description": "The body is too long."},
    415: {"description": "The body is of another media type."},
    422: {"description": "A field is wrong, or the case cannot be computed."},
    401: {
        "description": "A key is needed, or this one is not, or no longer, good.",
        "headers": {"WWW-Authenticate": {"description": "`Bearer`.", "schema": {"type": "string"}, "required": True}},
    },
    403: {
        "description": "The key is not good for this or never allows so many cases, or the request comes from the page "
        "of another site."
    },
    408: {"description": "The body comes too slowly."},
    429: {"description": "Too many cases wait, or were requested with this key.", "headers": RETRY_AFTER},
    500: {"description": "The service failed."},
    501: {"description": "What draws reports is not installed."},
    503: {"description": "The service is not ready, or has no worker for the query.", "headers": RETRY_AFTER},
    507: {"description": "Nothing can be stored now."},
}


def problems(*statuses: int) -> Responses:
    """Return the declarations of these error statuses."""
    return {status: {"model": Problem, **PROBLEMS[status]} for status in statuses}


COMPUTED: Responses = {
    200: {
        # Declared as media types too, they would make the answers of generated clients unions with text.
        "description": "The answer; CSV or HDF5 where `Accept` names them, as of `/results/{key}`.",
        "headers": CACHE_STATUS,
        "links": RESULT_LINK,
    },
    **problems(400, 406, 413, 415, 422, 429, 500, 503),
}


MANY: Responses = {
    200: {
        "description": "All results, in the order of the request; as JSON lines, in the order in which they finish.",
        "content": {
            "application/jsonl": {"schema": {"type": "string", "description": "A member of `results` a line."}},
            "text/csv": {"schema": {"type": "string", "description": "A row a case: the summary, or the problem."}},
        },
        "headers": {
            "Cache-Status": {
                "description": "`ricochet; hit` if nothing had to be computed; not given for JSON lines (RFC 9211).",
                "schema": {"type": "string"},
            },
            **PREFERENCE_APPLIED,
        },
    },
    202: {
        "model": Job,
        "description": "The job that will have the results.",
        "headers": {
            **RETRY_AFTER,
            "Location": {"description": "Of the job.", "schema": {"type": "string"}, "required": True},
            **PREFERENCE_APPLIED,
        },
        "links": {
            "job": {"operationId": "get_job", "parameters": {"job_id": "$response.body#/id"}},
            "results": {"operationId": "get_job_results", "parameters": {"job_id": "$response.body#/id"}},
        },
    },
    **problems(400, 406, 409, 413, 415, 422, 429, 500, 503, 507),
}


STUDIED: Responses = {
    **COMPUTED,
    200: {
        **COMPUTED[200],
        "headers": {**CACHE_STATUS, **PREFERENCE_APPLIED},
    },
    202: {
        **MANY[202],
        "description": "The job that will have the answer as its only result.",
    },
    **problems(409, 507),
}


def one_body(model: type[BaseModel]) -> dict[str, Any]:
    """Return the declaration of a JSON body that the route reads itself, piece by piece."""
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": reference(model)}}}}


def many_bodies(model: type[BaseModel], line: type[BaseModel]) -> dict[str, Any]:
    """Return the declaration of a body that is JSON, or JSON lines: those as binary, as clients send a file of them."""
    declared = one_body(model)
    declared["requestBody"]["content"]["application/jsonl"] = {
        "schema": {"type": "string", "format": "binary", "description": f"A `{line.__name__}` a line."}
    }
    return declared


def reference(model: type[BaseModel]) -> dict[str, str]:
    """Return the place of a model in the contract."""
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def declare_bodies(schemas: dict[str, Any], models: Sequence[type[BaseModel]]) -> None:
    """Add the models of the bodies that FastAPI does not get to see."""
    _, found = models_json_schema(
        [(model, "validation") for model in models], ref_template="#/components/schemas/{model}"
    )
    for name, schema in found["$defs"].items():
        schemas.setdefault(name, schema)
    for name in sorted(schemas):  # As FastAPI sorts those that it sees.
        schemas[name] = schemas.pop(name)


def declare_answers(contract: dict[str, Any]) -> None:
    """Let answers have fields that a client does not know: generated clients then survive a new one."""
    schemas = contract["components"]["schemas"]
    sent = {
        name
        for operations in contract["paths"].values()
        for operation in operations.values()
        for name in components_in(operation.get("requestBody"), schemas)
    }
    for name in schemas.keys() - sent:
        if schemas[name].get("additionalProperties") is False:
            del schemas[name]["additionalProperties"]


def components_in(node: Any, schemas: dict[str, Any], found: set[str] | None = None) -> set[str]:
    """Return the names of all components that a part of the contract refers to, also by others."""
    found = set() if found is None else found
    if isinstance(node, dict):
        name = str(node.get("$ref", "")).rpartition("/")[2]
        if name in schemas and name not in found:
            found.add(name)
            components_in(schemas[name], schemas, found)
    for each in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        components_in(each, schemas, found)
    return found


FORMATS = {"number": "double", "integer": "int64"}
"""Formats of numbers: without them some generators take 32 bits."""


def declare_formats(node: Any) -> None:
    """Give every number in a part of the contract its format."""
    if isinstance(node, dict) and isinstance(kind := node.get("type"), str) and kind in FORMATS:
        node["format"] = FORMATS[kind]
    if isinstance(node, dict):
        for name, each in node.items():
            if name not in {"example", "examples"}:
                declare_formats(each)
    elif isinstance(node, list):
        for each in node:
            declare_formats(each)


def declare_access(operation: dict[str, Any]) -> None:
    """Declare that a key is optional, as a service may be open, and how an operation is refused without one."""
    if "security" not in operation:
        operation["security"] = []
        return
    ((scheme, (scope,)),) = operation["security"][0].items()
    operation["security"] = [{}, {scheme: []}]  # A scheme other than OAuth has no scopes to list.
    refused = problems(400, 401, 403, *([408] if "requestBody" in operation else []))
    refused[403]["description"] = (
        f"The key lacks the scope `{scope}` or never allows so many cases, or the request comes from the page of "
        "another site."
    )
    for status, response in refused.items():
        declared = {name: value for name, value in response.items() if name != "model"}
        content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
        operation["responses"].setdefault(str(status), {**declared, "content": content})
    operation["responses"] = dict(sorted(operation["responses"].items()))


def declare_defaults(schemas: dict[str, Any]) -> None:
    """Rename `default` to `x-default`: openapi-typescript makes a field with a default one that has to be given."""
    for schema in schemas.values():
        for field in schema.get("properties", {}).values():
            if "default" in field:
                field["x-default"] = field.pop("default")


def declare_events(responses: dict[str, Any]) -> None:
    """Declare server-sent events in words: what FastAPI says of them is of a later OpenAPI."""
    content = responses.get("200", {}).get("content", {})
    if "text/event-stream" in content:
        content["text/event-stream"] = {"schema": {"description": "Server-sent events."}}


def declare_problems(responses: dict[str, Any]) -> None:
    """Give the errors among these responses their media type, which FastAPI takes from the route."""
    for status, response in responses.items():
        if status >= "400":
            (content,) = response["content"].values()
            response["content"] = {MEDIA_TYPE: content}
