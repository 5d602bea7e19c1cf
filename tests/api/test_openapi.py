"""The contract follows the rules that generated clients need, and the committed copy is up to date."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service import cli, operations
from service.api.app import create_app
from service.api.contract import components_in
from service.cli import serve
from service.schemas.problems import TAGGED

COMMITTED = Path(__file__).parents[2] / "openapi" / "openapi.json"
CONTRACT: dict[str, Any] = create_app().openapi()
SCHEMAS: dict[str, dict[str, Any]] = CONTRACT["components"]["schemas"]
OPERATIONS: dict[str, dict[str, Any]] = {
    f"{method.upper()} {path}": operation
    for path, methods in CONTRACT["paths"].items()
    for method, operation in methods.items()
}

MANY = [each for each in operations.OPERATIONS.values() if each.many is not None]


def nodes(value: Any, place: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the pointer of every object in a JSON document, and the object; examples are skipped."""
    if isinstance(value, dict):
        yield place, value
        for name, item in value.items():
            if name != "examples":
                yield from nodes(item, f"{place}/{name}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from nodes(item, f"{place}/{index}")


REQUESTED = components_in([operation.get("requestBody") for operation in OPERATIONS.values()], SCHEMAS)
"""Names of the schemas that requests use."""


def test_committed_contract_matches_the_application() -> None:
    assert json.loads(COMMITTED.read_text(encoding="utf-8")) == json.loads(serve.contract())
    assert COMMITTED.read_text(encoding="utf-8") == serve.contract(), "run `make openapi`"


def test_exporter_writes_and_checks_the_contract(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["openapi", "--check"]) == 1
    assert cli.main(["openapi"]) == 0
    assert cli.main(["openapi", "--check"]) == 0
    serve.CONTRACT.write_text("{}")
    assert cli.main(["openapi", "--check"]) == 1


def test_service_serves_its_contract(client: httpx.Client) -> None:
    assert client.get("/openapi.json").json() == json.loads(serve.contract())
    assert CONTRACT["openapi"].startswith("3.1")


def test_operation_ids_are_unique_function_names() -> None:
    ids = [operation["operationId"] for operation in OPERATIONS.values()]
    assert len(set(ids)) == len(ids)
    assert all(re.fullmatch("[a-z]+(_[a-z]+)*", name) for name in ids), ids


def test_nothing_is_nullable_nor_a_tuple() -> None:
    for place, node in nodes(CONTRACT):
        assert node.get("type") != "null", place
        assert None not in node.values(), place
        assert "prefixItems" not in node, place


def test_unions_are_named_and_their_discriminators_required_without_default() -> None:
    unions = {place: node for place, node in nodes(CONTRACT) if {"oneOf", "anyOf", "allOf"} & node.keys()}
    names = ("Nose", "StrengthFactor", "Result", "DistributionOf", "DiscreteValues", "InputValue", "JobRequest")
    assert set(unions) == {f"/components/schemas/{name}" for name in names}
    for node in unions.values():
        if "discriminator" in node:
            name = node["discriminator"]["propertyName"]
            for variant in node["discriminator"]["mapping"].values():
                schema = SCHEMAS[variant.rpartition("/")[2]]
                assert name in schema["required"]
                assert "default" not in schema["properties"][name]


def test_contract_follows_the_rules_of_linters_and_openapi_typescript() -> None:
    """The linters themselves run in `make check` if npm is installed."""
    assert CONTRACT["servers"] == [{"url": "/"}]
    assert CONTRACT["info"]["contact"]
    used = {tag for operation in OPERATIONS.values() for tag in operation["tags"]}
    assert {tag["name"] for tag in CONTRACT["tags"]} == used
    for operation in OPERATIONS.values():
        assert all(scopes == [] for scheme in operation["security"] for scopes in scheme.values())
    for name, schema in SCHEMAS.items():
        assert all("default" not in field for field in schema.get("properties", {}).values()), name


def test_tagged_lists_every_field_with_a_discriminated_union() -> None:
    tagged = {f"#/components/schemas/{name}" for name, schema in SCHEMAS.items() if "discriminator" in schema}
    fields = {
        name
        for schema in SCHEMAS.values()
        for name, field in schema.get("properties", {}).items()
        if field.get("$ref") in tagged
    }
    assert fields == TAGGED


def test_every_object_and_enumeration_is_a_component() -> None:
    for place, node in nodes(CONTRACT):
        if (node.get("type") == "object" and "properties" in node) or "enum" in node:
            assert re.fullmatch("/components/schemas/[A-Za-z]+", place)


def test_requests_refuse_unknown_fields_and_bound_every_number() -> None:
    for name in REQUESTED:
        schema = SCHEMAS[name]
        assert schema.get("type") != "object" or schema["additionalProperties"] is False, name
    for name, operation in OPERATIONS.items():
        # Discrete values of an uncertain input have no bounds.
        if "requestBody" not in operation or "/uncertainty" in name:
            continue
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        for place, node in nodes_of_component(schema["$ref"].rpartition("/")[2]):
            if node.get("type") in ("number", "integer"):  # not a field named `type`
                assert {"minimum", "exclusiveMinimum"} & node.keys(), place
                assert {"maximum", "exclusiveMaximum"} & node.keys(), place
            if node.get("type") == "array":
                assert "maxItems" in node, place


def test_recipes_for_go_and_java_use_the_names_in_the_contract() -> None:
    """openapi-generator names a class after each tag and a method after each operation."""
    page = (COMMITTED.parents[1] / "docs" / "how-to" / "clients.md").read_text(encoding="utf-8")
    operation = OPERATIONS["POST /cra"]
    tag, words = operation["tags"][0].title().replace(" ", ""), operation["operationId"].title().replace("_", "")
    body = operation["requestBody"]["content"]["application/json"]["schema"]["$ref"].rpartition("/")[2]
    assert "openapi-generator-cli generate -i contract.json -g go " in page
    assert "openapi-generator-cli generate -i contract.json -g java " in page
    assert f"client.{tag}API.{words}(ctx).{body}(strike).Execute()" in page
    assert f"new {tag}Api().{words[0].lower()}{words[1:]}({body}.fromJson(body))" in page


def test_answers_may_have_more_fields_than_a_client_knows() -> None:
    for name in SCHEMAS.keys() - REQUESTED:
        assert SCHEMAS[name].get("additionalProperties") is not False, name
    assert {"CriticalAngleAnswer", "Problem", "Job", "TrajectoryResults"}.isdisjoint(REQUESTED)


def test_every_number_has_a_format_of_64_bits() -> None:
    for place, node in nodes(CONTRACT):
        if node.get("type") in ("number", "integer"):  # not a field named `type`
            assert node["format"] == {"number": "double", "integer": "int64"}[node["type"]], place


@pytest.mark.parametrize("path", [f"{operation.path}/{kind}" for operation in MANY for kind in ("batch", "sweep")])
def test_contract_explains_preferences_of_many_cases(path: str) -> None:
    text = OPERATIONS[f"POST {path}"]["description"]
    most = "16,384 samples" if "uncertainty" in path else "100 cases"
    for words in (f"Up to {most} are answered at once with 200", "202", "respond-async", "wait=10"):
        assert words in text, words


def nodes_of_component(name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the pointer and the object for every object in a schema and in the schemas that it refers to."""
    for place, node in nodes(SCHEMAS[name], name):
        yield place, node
        if "$ref" in node:
            yield from nodes_of_component(node["$ref"].rpartition("/")[2])


def test_every_model_has_examples_and_every_field_a_description() -> None:
    for name, schema in SCHEMAS.items():
        if "properties" in schema:
            assert schema["examples"], name
            assert schema["description"], name


@pytest.mark.parametrize("path", [f"{operation.path}/batch" for operation in MANY])
def test_batches_are_declared_as_json_and_as_lines(path: str) -> None:
    operation = OPERATIONS[f"POST {path}"]
    assert list(operation["requestBody"]["content"]) == ["application/json", "application/jsonl"]
    assert set(operation["responses"]["200"]["content"]) == {"application/json", "application/jsonl", "text/csv"}


FILES = {"application/x-hdf5", "application/vnd.apache.parquet"}


def test_answers_are_described_and_typed() -> None:
    for name, operation in OPERATIONS.items():
        for status, response in operation["responses"].items():
            assert response["description"] not in {"", "Successful Response"}, (name, status)
            for media_type, content in response.get("content", {}).items():
                assert content.get("schema") or media_type in FILES, (name, status, media_type)


def test_headers_have_their_usual_spelling() -> None:
    headers = {
        parameter["name"]
        for operation in OPERATIONS.values()
        for parameter in operation.get("parameters", ())
        if parameter["in"] == "header"
    }
    assert headers == {"Idempotency-Key", "If-None-Match", "Last-Event-ID", "Prefer"}


def test_json_lines_are_sent_as_a_file() -> None:
    bodies = [operation["requestBody"]["content"] for operation in OPERATIONS.values() if "requestBody" in operation]
    lines = [content["application/jsonl"]["schema"] for content in bodies if "application/jsonl" in content]
    assert [(schema["type"], schema["format"]) for schema in lines] == [("string", "binary")] * len(MANY)


def test_every_reference_has_a_target() -> None:
    for place, node in nodes(CONTRACT):
        if "$ref" in node:
            assert node["$ref"].removeprefix("#/components/schemas/") in SCHEMAS, place


def test_errors_are_declared_as_problems() -> None:
    for name, operation in OPERATIONS.items():
        errors = {status: response for status, response in operation["responses"].items() if status >= "400"}
        assert "500" in errors, name
        for status, response in errors.items():
            assert list(response["content"]) == ["application/problem+json"], (name, status)
    assert {"400", "413", "415", "422", "503"} <= OPERATIONS["POST /cra"]["responses"].keys()
    for path in (f"{operation.path}/{kind}" for operation in MANY for kind in ("batch", "sweep")):
        assert {"202", "406", "409", "413", "415", "422", "429", "503"} <= OPERATIONS[f"POST {path}"][
            "responses"
        ].keys()
    for path in ("/calibration/depth", "/calibration/motion", "/calibration/obliquity"):
        assert OPERATIONS[f"POST {path}"]["responses"].keys() == OPERATIONS["POST /cra"]["responses"].keys()
    assert {"304", "404", "406"} <= OPERATIONS["GET /results/{key}"]["responses"].keys()
