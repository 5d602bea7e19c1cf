"""Limits on size and structure of a body are checked before validation, on every route that takes a body."""

import json
from collections.abc import Callable, Iterator
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from fastapi import HTTPException

from service.api.body import MAX_FIELDS, BodyLimits, count_fields, parse_json
from service.errors import MAX_ERRORS, MAX_SUGGESTIONS, InvalidBodyError
from service.schemas.strike import PAPER, PAPER_AT_45
from service.settings import Settings

from .many import LINES
from .refused import TEXT, problem_of, refused_at

CONTRACT = json.loads((Path(__file__).parents[2] / "openapi" / "openapi.json").read_text(encoding="utf-8"))
CALL = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "critical_angle", "arguments": PAPER}}
MODEL = {"name": "cra", "input": [[238.0, 39.0]], "config": {"target": PAPER["target"]}}
SETTINGS = Settings()
FIELDS, VALUES = 100_001, 250_001
"""Numbers of fields and of values that exceed the limits of every route."""
SHORT = 100_000
"""Size of a body that every route accepts. [bytes]"""


class Route(NamedTuple):
    """A route that takes a body, and a valid body for it."""

    method: str
    path: str
    media_type: str
    body: Any

    def send(self, client: httpx.Client, content: Any) -> httpx.Response:
        """Send bytes unchanged, and any other content as JSON."""
        data = content if isinstance(content, bytes) else json.dumps(content, separators=(",", ":")).encode()
        headers = {"Content-Type": self.media_type, "Accept": "application/json, text/event-stream"}
        path = self.path.replace("{job_id}", "0" * 32)
        return client.request(self.method, path, content=data, headers=headers)


def routes() -> Iterator[Route]:
    """Yield every route with a body, including MCP and UM-Bridge, which are not in the contract."""
    for path, methods in CONTRACT["paths"].items():
        for method, operation in methods.items():
            for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
                name = content["schema"].get("$ref", "").rpartition("/")[2]
                example = CONTRACT["components"]["schemas"][name]["examples"][0] if name else PAPER_AT_45
                yield Route(method.upper(), path, media_type, example)
    yield Route("POST", "/mcp", "application/json", CALL)
    yield Route("POST", "/umbridge/Evaluate", "application/json", MODEL)


ROUTES = list(routes())
JSON_ROUTES = [route for route in ROUTES if route.media_type == "application/json"]


def route_id(route: Route) -> str:
    return f"{route.path} {route.media_type.rpartition('/')[2]}"


each_route = pytest.mark.parametrize("route", ROUTES, ids=route_id)


def places_of_objects(part: Any, steps: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if isinstance(part, dict):
        yield steps
    if isinstance(part, dict | list):
        for step, each in part.items() if isinstance(part, dict) else enumerate(part):
            yield from places_of_objects(each, (*steps, step))


def at(part: Any, steps: tuple[str | int, ...]) -> Any:
    return reduce(lambda found, step: found[step], steps, part)


def refusal_text(response: httpx.Response) -> str:
    """Check that a body was refused with a short answer; return its text."""
    assert response.status_code in {400, 413, 422}, response.text
    assert len(response.content) < 5_000
    return response.text


@each_route
def test_too_many_fields_are_refused_at_once(client: httpx.Client, route: Route) -> None:
    spread = {"objects": [{"a": 0}] * FIELDS}
    answer = route.send(client, spread)
    assert "long at most" in refusal_text(answer) or "fields and" in refusal_text(answer)
    crowd = dict(route.body) | {f"f{number}": 0 for number in range(SHORT // 10)}
    answer = route.send(client, crowd)
    assert "fields" in refusal_text(answer)


@each_route
def test_too_many_values_are_refused_at_once(client: httpx.Client, route: Route) -> None:
    items: tuple[Any, ...] = (0, "a", None, [], {})
    for item in items:
        answer = route.send(client, dict(route.body) | {"list": [item] * VALUES})
        assert "long at most" in refusal_text(answer) or "values at most" in refusal_text(answer)


@each_route
def test_repeated_field_is_refused(client: httpx.Client, route: Route) -> None:
    text = json.dumps(route.body)
    name = next(iter(route.body))
    twice = [f'{{"{name}":1,{text[1:]}'.encode(), f'{text[:-1]},"a":{{"b":{{"x":"1:2","x":3}}}}}}'.encode()]
    for content, field in zip(twice, (name, "x"), strict=True):
        assert f"has the field '{field}' twice" in refusal_text(route.send(client, content))


@pytest.mark.parametrize("route", JSON_ROUTES, ids=route_id)
def test_object_with_too_many_fields_is_named_wherever_it_is(client: httpx.Client, route: Route) -> None:
    for steps in places_of_objects(route.body):
        body = json.loads(json.dumps(route.body))
        at(body, steps).update({f"f{number}": number for number in range(MAX_FIELDS)})
        pointer = "".join(f"/{step}" for step in steps)
        answer = route.send(client, body)
        assert f"has {len(at(body, steps))} fields, most of them unknown" in refusal_text(answer)
        if "problem" in answer.headers["Content-Type"]:
            refused_at(answer, pointer)


@pytest.mark.parametrize("route", JSON_ROUTES, ids=route_id)
def test_no_refusal_lists_more_than_a_hundred_errors(client: httpx.Client, route: Route) -> None:
    """Every object in the example body in turn is filled with invalid values."""
    for steps in places_of_objects(route.body):
        kinds: tuple[Any, ...] = ("a", [], {"velocty_m_s": 1}, {"a": 1, "b": 2})
        for wrong in ([kind] * 900 for kind in kinds):
            body = json.loads(json.dumps(route.body))
            for name in at(body, steps):
                at(body, steps)[name] = wrong if len(json.dumps(wrong)) * len(at(body, steps)) < SHORT else wrong[:90]
            answer = route.send(client, body)
            assert answer.status_code < 500, answer.text
            if "problem" in answer.headers["Content-Type"]:
                assert 0 < len(answer.json()["errors"]) <= MAX_ERRORS


def test_thousand_wrong_points_give_a_hundred_errors(client: httpx.Client) -> None:
    nose = {"shape": "profile", "points": [["a", "b"]] * 1000}
    body = PAPER | {"projectile": PAPER["projectile"] | {"nose": nose}}
    assert len(problem_of(client.post("/cra", json=body), 422).errors) == MAX_ERRORS


def test_suggestions_are_made_for_the_first_unknown_fields(client: httpx.Client) -> None:
    body = PAPER | {"impact": PAPER["impact"] | {f"velocty_m_s{number}": 1 for number in range(MAX_FIELDS - 1)}}
    details = [each.detail for each in problem_of(client.post("/cra", json=body), 422).errors]
    assert len(details) == MAX_FIELDS - 1
    assert sum("did you mean" in detail for detail in details) == MAX_SUGGESTIONS


@pytest.mark.parametrize(
    "text",
    [b'{"a":1,"a":2}', b'[{"x":{"b":[],"b":{}}}]', b'{"":0,"":0}', b'{"a":1,"\\u0061":1}', b'{"t":"::","a":1,"a":1}'],
)
def test_repeated_field_is_found_whatever_its_spelling(text: bytes) -> None:
    with pytest.raises(HTTPException, match="twice"):
        parse_json(text, BodyLimits.of_one(SETTINGS))


@pytest.mark.parametrize("text", ['{"a":"x:y","b":":"}', '{"a:b":1,"c":{"a:b":1}}', '{"a":1,"b":[{"a":1},{"a":1}]}'])
def test_colons_in_strings_and_equal_fields_of_other_objects_are_accepted(text: str) -> None:
    assert parse_json(text.encode(), BodyLimits.of_one(SETTINGS)) == json.loads(text)


@pytest.mark.parametrize("limits", [BodyLimits.of_one, BodyLimits.of_series, BodyLimits.of_batch])
def test_limits_are_exact(limits: Callable[[Settings], BodyLimits]) -> None:
    bound = limits(SETTINGS)
    most = json.dumps([{"a": 0}] * bound.fields).encode()
    assert count_fields(parse_json(most, bound), bound.depth) == bound.fields
    with pytest.raises(HTTPException, match="fields and"):
        parse_json(json.dumps([{"a": 0}] * (bound.fields + 1)).encode(), bound)
    assert len(parse_json(b"[%b1]" % (b"1," * bound.values), bound)) == bound.values + 1
    with pytest.raises(HTTPException, match="values at most"):
        parse_json(b"[%b1]" % (b"1," * (bound.values + 1)), bound)
    crowd = {f"f{number}": 0 for number in range(MAX_FIELDS + 1)}
    with pytest.raises(InvalidBodyError):
        parse_json(json.dumps([[crowd]]).encode(), bound)


def test_largest_bodies_of_the_contract_are_within_the_limits() -> None:
    shots = [{"velocity_m_s": 238.1, "depth_m": 0.3}] * 1000
    points = [[0.001 * number, 0.04] for number in range(1000)]
    strike = {"projectile": {"nose": {"shape": "profile", "points": points}}, "resistance": {"shots": shots}}
    cases = [{"a": {"b": {"shots": shots[:40]}}, "custom_id": "a:b"}] * 1000
    column = [number / 1000 for number in range(3000)]
    runs = [dict.fromkeys(("time_s", "depth_displacement_m", "lateral_displacement_m", "rotation_deg"), column)] * 20
    bodies: list[tuple[BodyLimits, Any]] = [
        (BodyLimits.of_one(SETTINGS), strike),
        (BodyLimits.of_batch(SETTINGS), {"cases": cases}),
        (BodyLimits.of_series(SETTINGS), {"runs": runs}),
        (BodyLimits.of_series(SETTINGS), {"base": strike, "axes": [{"field": "a.b", "values": [0.5] * 100_000}]}),
    ]
    for limits, body in bodies:
        text = json.dumps(body, separators=(",", ":")).encode()
        assert len(text) <= limits.length
        assert parse_json(text, limits) == body


def test_line_with_a_repeated_field_is_named(client: httpx.Client) -> None:
    text = json.dumps(PAPER_AT_45)
    content = f'{text}\n{text[:-1]},"target":1}}\n'.encode()
    found = refused_at(client.post("/trajectory/batch", content=content, headers=LINES), "/1")
    assert "line 2" in found.detail


def test_body_with_a_repeated_field_is_not_answered_from_the_cache(client: httpx.Client) -> None:
    text = json.dumps(PAPER)
    assert client.post("/cra", content=text, headers=TEXT).status_code == 200
    for _ in range(2):
        twice = f'{text[:-1]},"target":{json.dumps(PAPER["target"])}}}'
        problem_of(client.post("/cra", content=twice, headers=TEXT), 400)
