"""Tools of the Model Context Protocol: single queries with the schemas of their routes. Requires the extra `mcp`.

An answer is a JSON object with `answer`, which is the answer of the route without the columns of a history, and
`validity_limits`; its text is a summary. A refusal has `is_error` and two texts: a summary, and the problem document
(RFC 9457) of the route. It has no structured content, because structured content must match the schema of an answer.
"""

import re
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, TypeAlias

import orjson
from mcp.server import Server, ServerRequestContext
from mcp.types import (
    CallToolRequestParams,
    CallToolResult,
    ListToolsResult,
    PaginatedRequestParams,
    TextContent,
    Tool,
    ToolAnnotations,
)

from service.columns import summarize
from service.errors import InvalidBodyError, ProblemType, problem_of
from service.operations import OPERATIONS, Operation, ToolText
from service.version import VERSION

Compute: TypeAlias = Callable[[str, Mapping[str, Any], Any], Awaitable[dict[str, Any]]]
"""Function that answers a request. Its arguments are the operation, the body and the HTTP request (None over stdio)."""

VALIDITY_LIMITS = (
    "The projectile is rigid: it neither bends nor erodes. Noses of steel erode above some 800 m/s.",
    "The target is plain concrete: reinforcement, aggregate and friction are left out.",
    "A front crater and a rear plug are left out unless the request has them.",
    "The usual strength factor was fitted to finite element runs up to 45 degrees; critical angles mostly lie beyond.",
    "It belongs to concrete of 39 MPa struck by a projectile of 80 mm.",
    "Walls hold more in the model than in tests: its thicknesses are not conservative.",
    "No test of the critical ricochet angle of a rigid body on concrete is known in the open literature.",
)
"""Limits of validity that apply to every answer. Limits of a single strike are among its warnings."""
INSTRUCTIONS = (
    "Oblique impact of rigid projectiles on concrete. Quantities are in SI units, angles in degrees from the inward "
    "normal of the face: 0 is normal impact. No tool assumes a quantity that its schema requires: a missing one is "
    "refused with a pointer to its field, and is to be requested from the user. An object that a schema shows by "
    "examples alone is described by an earlier tool or by the contract, `/openapi.json` of a service. Repeat the "
    "warnings and the validity limits of an answer with its numbers."
)


class ToolError(Exception):
    """The request of a tool call was refused or failed.

    Parameters
    ----------
    problem
        Problem document (RFC 9457).
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        super().__init__(problem.get("detail") or problem.get("title"))
        self.problem = dict(problem)


@dataclass(frozen=True, slots=True)
class ToolOperations:
    """A tool and its operations.

    Parameters
    ----------
    text
        Name, title and description.
    operations
        Operations, keyed by the field of the arguments that holds the request. If the key is empty, the arguments
        themselves are the request.
    """

    text: ToolText
    operations: Mapping[str, Operation]

    def to_tool(self, listed: set[str]) -> Tool:
        """Return the tool as it is listed, and add the models that it describes to `listed`.

        The list is part of the context of a language model, so its schemas are shortened by `brief`.
        """
        if "" in self.operations:
            inputs = brief(self.operations[""].request.model_json_schema(), listed)
        else:
            inputs = {
                "type": "object",
                "description": "One of these.",
                "properties": {
                    field: brief(operation.request.model_json_schema(), listed)
                    for field, operation in self.operations.items()
                },
                "minProperties": 1,
                "maxProperties": 1,
            }
        routes = " or ".join(f"`POST {operation.path}`" for operation in self.operations.values())
        outputs = {
            "type": "object",
            "properties": {
                "answer": {"type": "object", "description": f"Answer of {routes}."},
                "validity_limits": {"type": "array", "items": {"type": "string"}},
            },
            "required": ["answer", "validity_limits"],
        }
        return Tool(
            name=self.text.name,
            title=self.text.title,
            description=self.text.description,
            input_schema=inputs,
            output_schema=outputs,
            annotations=ToolAnnotations(read_only_hint=True, idempotent_hint=True, open_world_hint=False),
        )

    def request_in(self, arguments: Mapping[str, Any]) -> tuple[str, str, Any]:
        """Return the operation, the pointer to its request in the arguments, and the request.

        Raises
        ------
        InvalidBodyError
            If the arguments do not have exactly one request.
        """
        if "" in self.operations:
            return self.operations[""].name, "", arguments
        if len(arguments) != 1 or not arguments.keys() <= self.operations.keys():
            names = " or ".join(f"`{name}`" for name in self.operations)
            raise InvalidBodyError([{"pointer": "", "detail": f"must have one field, {names}"}])
        ((name, request),) = arguments.items()
        return self.operations[name].name, f"/{name}", request


def tools_of(operations: Iterable[Operation]) -> dict[str, ToolOperations]:
    """Return the tools of the given operations, keyed by name."""
    found: dict[str, dict[str, Operation]] = {}
    texts: dict[str, ToolText] = {}
    for operation in operations:
        if (text := operation.tool) is not None:
            texts.setdefault(text.name, text)
            found.setdefault(text.name, {})[text.field] = operation
    return {name: ToolOperations(text, found[name]) for name, text in texts.items()}


# Language models can convert SI units themselves, and the list of tools should stay short.
NOT_LISTED = frozenset({"units"})
"""Fields of requests that the list of tools does not show."""
KEPT = ("type", "const", "enum", "required")
"""Keywords of a schema that are copied to the list of tools unchanged."""
REMARK = re.compile(r"(?<=\.) (?=[A-Z`]).*?(?= \[[^\]]+\]$)|(?<=\]) .*", re.DOTALL)
"""Pattern of the sentences after the first one in the description of a quantity, which explain its bounds."""


def brief(
    node: Mapping[str, Any], listed: set[str], definitions: Mapping[str, Any] | None = None, *, full: bool = True
) -> dict[str, Any]:
    """Return a shortened schema without references, titles, bounds or defaults.

    Optional objects, unions and objects described before are shown by examples only, and each model is described only
    once. That is enough to write a request, since errors are answered with a pointer to the field.

    Parameters
    ----------
    listed
        Names and descriptions of the models described so far, to which those described here are added.
    definitions
        Schemas that references point to, by default the definitions of the node itself.
    full
        Describe an object field by field if it has not been described before.
    """
    definitions = node.get("$defs", {}) if definitions is None else definitions
    name = node.get("$ref", "").rpartition("/")[2]
    node = {**definitions.get(name, {}), **node}
    short = {key: node[key] for key in KEPT if key in node}
    text = REMARK.sub("", node.get("description", ""))
    if text and not (name and text in listed):
        short["description"] = text
    if "items" in node:
        short["items"] = brief(node["items"], listed, definitions)
    if "oneOf" in node:
        kinds = [definitions[kind["$ref"].rpartition("/")[2]] for kind in node["oneOf"]]
        short |= {"type": "object", "examples": [kind["examples"][0] for kind in kinds]}
    elif "properties" in node and name in listed:
        short["examples"] = node["examples"][:1]
    elif "properties" in node and not full:
        short["examples"] = node["examples"]
    elif "properties" in node:
        short["properties"] = {
            field: brief(each, listed, definitions, full=field in node.get("required", ()))
            for field, each in node["properties"].items()
            if field not in NOT_LISTED
        }
    if name:
        listed.add(text)
    if name and "properties" in node:
        listed.add(name)
    return short


def server_of(compute: Compute) -> Server[Any]:
    """Return an SDK server with all tools.

    Parameters
    ----------
    compute
        Function that answers requests, or raises ToolError.
    """
    # The tools share the set, so that each model is described only once in the whole list.
    described: set[str] = set()
    tools = tools_of(OPERATIONS.values())
    listed = ListToolsResult(tools=[tool.to_tool(described) for tool in tools.values()])

    async def list_tools(_: ServerRequestContext[Any], __: PaginatedRequestParams | None) -> ListToolsResult:
        return listed

    async def call_tool(context: ServerRequestContext[Any], params: CallToolRequestParams) -> CallToolResult:
        if params.name not in tools:
            # A refusal is a result rather than a protocol error, because language models see only results.
            return refusal(ProblemType.of_status(HTTPStatus.NOT_FOUND).content(f"there is no tool {params.name!r}"))
        before = ""
        try:
            operation, before, request = tools[params.name].request_in(params.arguments or {})
            answer = await compute(operation, request, context.request)
        except InvalidBodyError as error:
            return refusal(problem_of(error), before)
        except ToolError as error:
            return refusal(error.problem, before)
        return to_result(operation, answer)

    return Server(
        "ricochet",
        version=VERSION,
        title="Critical ricochet angles of projectiles on concrete",
        instructions=INSTRUCTIONS,
        on_list_tools=list_tools,
        on_call_tool=call_tool,
    )


def to_result(operation: str, answer: dict[str, Any]) -> CallToolResult:
    """Return an answer as the result of a tool, with a summary as text.

    The columns of a history are removed: thousands of numbers would fill the context of a language model.
    """
    for motion in (answer, answer.get("trajectory", {})):
        # The answer belongs to this call alone and may be changed.
        motion.pop("history", None)
    lines = [
        operation.replace("_", " of "),
        *(f"{name}: {value}" for name, value in summarize(answer).items() if value != ""),
    ]
    warnings, standing = (
        [f"- {each['detail']}" for each in answer["warnings"] if each.get("standing", False) is kind]
        for kind in (False, True)
    )
    lines += ["", "Warnings:", *(warnings or ["- none"])]
    lines += ["", "Standing notes:", *standing] if standing else []
    lines += ["", "Validity limits:"]
    lines += [f"- {limit}" for limit in VALIDITY_LIMITS]
    return CallToolResult(
        content=[TextContent(text="\n".join(lines))],
        structured_content={"answer": answer, "validity_limits": list(VALIDITY_LIMITS)},
    )


def refusal(problem: Mapping[str, Any], before: str = "") -> CallToolResult:
    """Return a problem as the result of a tool; `before` is prepended to its pointers."""
    errors = [{**error, "pointer": before + error["pointer"]} for error in problem.get("errors", ())]
    lines = [": ".join(filter(None, (problem.get("title"), None if errors else problem.get("detail"))))]
    lines += [f"{error['pointer'] or '/'}: {error['detail']}" for error in errors]
    document = orjson.dumps({**problem, "errors": errors} if errors else problem).decode()
    return CallToolResult(content=[TextContent(text="\n".join(lines)), TextContent(text=document)], is_error=True)
