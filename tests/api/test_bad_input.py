"""Any invalid input is answered with a problem that names what is wrong, never with 500."""

import json
from typing import Any

import httpx
import pytest

from service.operations import OPERATIONS, Operation
from service.schemas.strike import PAPER, PAPER_AT_45

from .refused import LITERALS, TEXT, changed, problem_of, refused_at

CALIBRATIONS = ("/calibration/depth", "/calibration/motion", "/calibration/obliquity")
USUAL = {each.path: each.request.model_json_schema()["examples"][0] for each in OPERATIONS.values()}
"""Valid request of each operation, by path."""


@pytest.mark.parametrize("literal", LITERALS, ids=[literal[:10] for literal in LITERALS])
@pytest.mark.parametrize(
    ("path", "pointer"),
    [
        ("/trajectory", "/projectile/mass_kg"),
        ("/trajectory", "/projectile/nose/caliber_radius_head"),
        ("/trajectory", "/impact/oblique_angle_deg"),
        ("/cra", "/target/poissons_ratio"),
        ("/cra", "/search/tolerance_deg"),
        ("/calibration/depth", "/tests/3/depth_m"),
        ("/calibration/motion", "/history/rotation_deg/2"),
        ("/calibration/obliquity", "/points/2/strength_factor"),
    ],
)
def test_value_that_is_not_a_finite_number_is_named(
    client: httpx.Client, path: str, pointer: str, literal: str
) -> None:
    body = json.dumps(changed(USUAL[path], pointer, "HERE"))
    answer = client.post(path, content=body.replace('"HERE"', literal), headers=TEXT)
    # For optional fields, null means absent and is accepted.
    if literal == "null" and pointer.endswith(("poissons_ratio", "tolerance_deg")):
        assert answer.json() == client.post(path, json=PAPER).json()
        return
    refused_at(answer, pointer)


PAPER_TEXT = json.dumps(PAPER).encode()


def test_long_body_without_a_declared_length_is_refused(client: httpx.Client) -> None:
    problem_of(client.post("/cra", content=(b" " * 65_536 for _ in range(80)), headers=TEXT), 413)


def test_content_type_is_parsed_as_the_standard_says(client: httpx.Client) -> None:
    headers = {"Content-Type": 'Application/JSON ; charset="utf-8"'}
    assert client.post("/cra", content=PAPER_TEXT, headers=headers).status_code == 200


@pytest.mark.parametrize("key", ["0" * 64, "0", "x" * 64, "..%2F..%2Fetc%2Fpasswd", "%00", "%FF", "A" * 5000])
def test_unknown_key_is_not_found(client: httpx.Client, key: str) -> None:
    problem_of(client.get(f"/results/{key}"), 404)


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("GET", "/cra", "POST"),
        ("DELETE", "/trajectory", "POST"),
        ("POST", "/results/" + "0" * 64, "GET, HEAD"),
        ("PUT", "/livez", "GET, HEAD"),
        ("POST", "/version", "GET, HEAD"),
        ("PATCH", "/cra", "POST"),
    ],
)
def test_refused_method_is_answered_with_the_allowed_ones(
    client: httpx.Client, method: str, path: str, allowed: str
) -> None:
    response = client.request(method, path)
    problem_of(response, 405)
    assert response.headers["Allow"] == allowed


@pytest.mark.parametrize("body_encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
@pytest.mark.parametrize("path", ["/trajectory", "/trajectory/batch"])
def test_encoding_not_allowed_in_json_is_named(client: httpx.Client, path: str, body_encoding: str) -> None:
    text = json.dumps(PAPER_AT_45)
    lines = {"Content-Type": "application/jsonl"} if path.endswith("batch") else TEXT
    problem = problem_of(
        client.post(path, content=text.encode(body_encoding), headers=lines), 422 if "batch" in path else 400
    )
    assert "byte order mark" in problem.detail or "UTF-16" in problem.detail
    assert "send UTF-8" in problem.detail


def with_nulls(schema: dict[str, Any], node: dict[str, Any], part: Any) -> Any:
    """Return part of a request with null for each omitted optional field, as some generated clients send it."""
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    if isinstance(part, list):
        return [with_nulls(schema, node.get("items", {}), each) for each in part]
    if not isinstance(part, dict):
        return part
    if "discriminator" in node:
        tag = node["discriminator"]
        node = schema["$defs"][tag["mapping"][part[tag["propertyName"]]].rpartition("/")[2]]
    fields = node.get("properties", {})
    absent = dict.fromkeys(fields.keys() - part.keys())
    return {**absent, **{name: with_nulls(schema, fields.get(name, {}), value) for name, value in part.items()}}


@pytest.mark.parametrize("operation", OPERATIONS.values(), ids=lambda each: each.name)
def test_null_in_an_optional_field_means_absent(operation: Operation) -> None:
    schema = operation.request.model_json_schema()
    for example in schema["examples"]:
        filled = with_nulls(schema, schema, example)
        assert operation.request.model_validate(filled) == operation.request.model_validate(example)


def test_null_in_the_base_of_a_sweep_means_absent(client: httpx.Client) -> None:
    axes = [{"field": "resistance.inertia_factor", "values": [1.0, 1.1]}]
    bases = (PAPER_AT_45, PAPER_AT_45 | {"resistance": None, "numerics": None, "output": None})
    with_null, without = (client.post("/trajectory/sweep", json={"base": base, "axes": axes}) for base in bases)
    assert with_null.raise_for_status().json() == without.json()


@pytest.mark.parametrize("path", CALIBRATIONS)
@pytest.mark.parametrize(
    ("content", "status", "pointer"),
    [
        (json.dumps(dict.fromkeys(map(str, range(100_000)), 1)).encode(), 400, ""),
        (json.dumps({"a": [0, {"b/c": dict.fromkeys(map(str, range(31)), 1)}]}).encode(), 422, "/a/1/b~1c"),
    ],
    ids=["100,000 fields", "31 fields of a part"],
)
def test_body_with_too_many_fields_is_refused_with_one_error(
    client: httpx.Client, path: str, content: bytes, status: int, pointer: str
) -> None:
    found = problem_of(client.post(path, content=content, headers=TEXT), status)
    assert [error.pointer for error in found.errors] == [pointer]
