"""Additions to the OpenAPI document of FastAPI: headers, problems, access, and bodies that routes read themselves."""

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
        "description": "`ricochet; hit` if the result came from the cache, `ricochet; fwd=miss` if it was computed "
        "(RFC 9211).",
        "schema": {"type": "string"},
        "required": True,
    },
    "Server-Timing": {
        "description": "Time for reading the request, for computing its answer, and in total. [ms]",
        "schema": {"type": "string"},
        "required": True,
    },
}
RESULT_LINK = {
    "result": {
        "operationId": "get_result",
        "parameters": {"key": "$response.body#/key"},
        "description": "The same result, also as a table.",
    }
}


PREFERENCE_APPLIED = {
    "Preference-Applied": {"description": "Preferences that were applied (RFC 7240).", "schema": {"type": "string"}}
}
RATE_LIMIT = {
    "RateLimit-Policy": {
        "description": "Quota of the key, if it has one: `q` cases in `w` seconds "
        "(draft-ietf-httpapi-ratelimit-headers-10).",
        "schema": {"type": "string"},
    },
    "RateLimit": {
        "description": "Cases left in the quota (`r`), and seconds until there are more (`t`).",
        "schema": {"type": "string"},
    },
}
RETRY_AFTER = {
    **RATE_LIMIT,
    "Retry-After": {
        "description": "Time after which to send the request again. [s]",
        "schema": {"type": "integer"},
        "required": True,
    },
}
RETRY_LATER: dict[str, Any] = {
    "headers": {
        "Retry-After": {
            "description": "Time after which to send the request again; absent once the job has ended. [s]",
            "schema": {"type": "integer"},
        }
    }
}
PROBLEMS: Responses = {
    400: {"description": "The body cannot be parsed."},
    404: {"description": "Nothing is stored under this key or id."},
    406: {"description": "The result is not available as any media type in `Accept`."},
    409: {"description": "The request with this idempotency key is still being accepted."},
    413: {"description": "The body is too long."},
    415: {"description": "The media type of the body is not supported."},
    422: {"description": "A field is wrong, or the case cannot be computed."},
    401: {
        "description": "The API key is missing, invalid, expired or revoked.",
        "headers": {"WWW-Authenticate": {"description": "`Bearer`.", "schema": {"type": "string"}, "required": True}},
    },
    403: {
        "description": "The key lacks the scope, its quota never allows so many cases, or the request comes from the "
        "page of another site."
    },
    408: {"description": "The body arrives too slowly."},
    429: {
        "description": "Too many cases are waiting, or the quota of the key is used up.",
        "headers": RETRY_AFTER,
    },
    500: {"description": "The service failed."},
    501: {"description": "The extra that draws reports is not installed."},
    503: {"description": "The service is not ready, or has no worker for the query.", "headers": RETRY_AFTER},
    507: {"description": "The service cannot store anything at present."},
}


def problems(*statuses: int) -> Responses:
    """Return the declarations of responses with the given error statuses."""
    return {status: {"model": Problem, **PROBLEMS[status]} for status in statuses}


COMPUTED: Responses = {
    200: {
        # CSV and HDF5 are named in words only. If they were declared as media types, generated clients would return
        # either a model or a string, and callers would have to check which.
        "description": "The answer. `Accept` selects CSV or HDF5, as for `/results/{key}`.",
        "headers": CACHE_STATUS,
        "links": RESULT_LINK,
    },
    **problems(400, 406, 413, 415, 422, 429, 500, 503),
}


MANY: Responses = {
    200: {
        "description": "All results, in the order of the request; as JSON lines, in the order in which they finish.",
        "content": {
            "application/jsonl": {"schema": {"type": "string", "description": "One member of `results` per line."}},
            "text/csv": {"schema": {"type": "string", "description": "One row per case: its summary, or its problem."}},
        },
        "headers": {
            "Cache-Status": {
                "description": "`ricochet; hit` if nothing had to be computed; absent for JSON lines and for the "
                "results of a job (RFC 9211).",
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
            "Location": {"description": "Path of the job.", "schema": {"type": "string"}, "required": True},
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
    """Return the declaration of a JSON body that the route reads itself, without FastAPI."""
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": reference(model)}}}}


def many_bodies(model: type[BaseModel], line: type[BaseModel]) -> dict[str, Any]:
    """Return the declaration of a body that is JSON or JSON lines.

    JSON lines are declared as binary, since generated clients then send a file instead of encoding an object.
    """
    declared = one_body(model)
    declared["requestBody"]["content"]["application/jsonl"] = {
        "schema": {"type": "string", "format": "binary", "description": f"One `{line.__name__}` per line."}
    }
    return declared


def reference(model: type[BaseModel]) -> dict[str, str]:
    """Return a JSON reference to the schema of a model in the components of the document."""
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def declare_bodies(schemas: dict[str, Any], models: Sequence[type[BaseModel]]) -> None:
    """Add the models of bodies that routes read themselves. FastAPI adds only the models of route parameters."""
    _, found = models_json_schema(
        [(model, "validation") for model in models], ref_template="#/components/schemas/{model}"
    )
    for name, schema in found["$defs"].items():
        schemas.setdefault(name, schema)
    for name in sorted(schemas):  # FastAPI sorts its components; keeping that order keeps diffs small.
        schemas[name] = schemas.pop(name)


def declare_answers(contract: dict[str, Any]) -> None:
    """Allow additional fields in answers, so that generated clients accept the fields of a later version."""
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
    """Return the names of all components that a part of the contract refers to, directly or indirectly."""
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
"""OpenAPI formats of number types. Without them some client generators choose 32-bit numbers."""


def declare_formats(node: Any) -> None:
    """Add the format to every number in a part of the contract."""
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
    """Declare the key as optional, since a service may be open, and add the responses to requests that lack access."""
    if "security" not in operation:
        operation["security"] = []
        return
    ((scheme, (scope,)),) = operation["security"][0].items()
    operation["security"] = [{}, {scheme: []}]  # Scopes belong to OAuth schemes; linters refuse them on others.
    refused = problems(400, 401, 403, *([408] if "requestBody" in operation else []))
    refused[403]["description"] = (
        f"The key lacks the scope `{scope}`, its quota never allows so many cases, or the request comes from the page "
        "of another site."
    )
    for status, response in refused.items():
        declared = {name: value for name, value in response.items() if name != "model"}
        content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
        operation["responses"].setdefault(str(status), {**declared, "content": content})
    operation["responses"] = dict(sorted(operation["responses"].items()))


def declare_defaults(schemas: dict[str, Any]) -> None:
    """Rename `default` to `x-default`, since openapi-typescript makes fields with a default mandatory."""
    for schema in schemas.values():
        for field in schema.get("properties", {}).values():
            if "default" in field:
                field["x-default"] = field.pop("default")


def declare_events(responses: dict[str, Any]) -> None:
    """Describe server-sent events in words, since FastAPI's schema for them requires a later version of OpenAPI."""
    content = responses.get("200", {}).get("content", {})
    if "text/event-stream" in content:
        content["text/event-stream"] = {"schema": {"description": "Server-sent events."}}


def declare_problems(responses: dict[str, Any]) -> None:
    """Declare error responses as problem documents. FastAPI declares them with the media type of the route's answer."""
    for status, response in responses.items():
        if status >= "400":
            (content,) = response["content"].values()
            response["content"] = {MEDIA_TYPE: content}
