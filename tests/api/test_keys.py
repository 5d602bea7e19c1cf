"""Random requests that the contract allows: validation changes no value, and equal requests have equal keys."""

import copy
import json
import math
import random
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from service.operations import result_key
from service.schemas import CriticalAngleRequest, TrajectoryRequest
from service.schemas.quantities import degrees
from service.schemas.strike import PAPER
from solver import ParameterError
from tests.conftest import ROOT

CONTRACT = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))
SCHEMAS: dict[str, dict[str, Any]] = CONTRACT["components"]["schemas"]
MODELS: dict[str, type[TrajectoryRequest | CriticalAngleRequest]] = {
    "TrajectoryRequest": TrajectoryRequest,
    "CriticalAngleRequest": CriticalAngleRequest,
}


def drawn_from(schema: dict[str, Any]) -> st.SearchStrategy[Any]:
    """Return a Hypothesis strategy for values that a schema of the contract accepts."""
    if "$ref" in schema:
        return drawn_from(SCHEMAS[schema["$ref"].rpartition("/")[2]])
    if "oneOf" in schema:
        return st.one_of([drawn_from(variant) for variant in schema["oneOf"]])
    if "enum" in schema or "const" in schema:
        return st.sampled_from(schema.get("enum", [schema.get("const")]))
    return DRAWN_FROM_TYPE[schema["type"]](schema)


def objects(schema: dict[str, Any]) -> st.SearchStrategy[Any]:
    fields = {name: drawn_from(field) for name, field in schema["properties"].items()}
    required = {name: fields.pop(name) for name in schema.get("required", ())}
    return st.fixed_dictionaries(required, optional=fields)


def arrays(schema: dict[str, Any]) -> st.SearchStrategy[Any]:
    return st.lists(drawn_from(schema["items"]), min_size=schema["minItems"], max_size=min(schema["maxItems"], 4))


def numbers(schema: dict[str, Any]) -> st.SearchStrategy[float]:
    lower, upper = (schema.get(name, schema.get(f"exclusive{name.title()}")) for name in ("minimum", "maximum"))
    return st.floats(lower, upper, exclude_min="minimum" not in schema, exclude_max="maximum" not in schema)


DRAWN_FROM_TYPE: dict[str, Callable[[dict[str, Any]], st.SearchStrategy[Any]]] = {
    "object": objects,
    "array": arrays,
    "number": numbers,
    "integer": lambda schema: st.integers(schema["minimum"], schema["maximum"]),
    "boolean": lambda _: st.booleans(),
}

requests = st.sampled_from(list(MODELS)).flatmap(
    lambda name: st.tuples(st.just(MODELS[name]), drawn_from({"$ref": f"#/{name}"}))
)


def key_of(model: type[TrajectoryRequest | CriticalAngleRequest], body: dict[str, Any]) -> str:
    return result_key(model.__name__, model.model_validate(body).canonical())


def leaves(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the container and the index of each value that is not itself a container."""
    for index, item in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(item, dict | list):
            yield from leaves(item)
        else:
            yield value, index


def shuffled(value: Any, order: random.Random) -> Any:
    """Return the same value with the fields of every object in random order."""
    if isinstance(value, list):
        return [shuffled(item, order) for item in value]
    if not isinstance(value, dict):
        return value
    return {name: shuffled(value[name], order) for name in order.sample(list(value), len(value))}


def rewritten(value: Any) -> Any:
    """Return an equal value in which whole floats and integers are interchanged, and zeros have the other sign."""
    if isinstance(value, dict):
        return {name: rewritten(item) for name, item in value.items()}
    if isinstance(value, list):
        return [rewritten(item) for item in value]
    if isinstance(value, float):
        return -value if value == 0.0 else int(value) if value.is_integer() else value
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


@given(requests, st.randoms(use_true_random=False))
def test_key_does_not_depend_on_spelling(request_: Any, order: random.Random) -> None:
    model, body = request_
    key = key_of(model, body)
    assert key_of(model, shuffled(body, order)) == key
    assert key_of(model, rewritten(body)) == key
    assert key_of(model, json.loads(json.dumps(body, indent=3))) == key


@given(requests, st.data())
def test_key_depends_on_every_value(request_: Any, data: st.DataObject) -> None:
    model, body = request_
    full = model.model_validate(body).canonical()
    other = copy.deepcopy(full)
    place, index = data.draw(st.sampled_from(list(leaves(other))))
    value = place[index]
    if isinstance(value, bool):
        place[index] = not value
    elif isinstance(value, int):
        place[index] = value + 1
    elif isinstance(value, float):
        place[index] = math.nextafter(value, data.draw(st.sampled_from([-math.inf, math.inf])))
        assume(place[index] != value)
    else:
        place[index] = f"{value}_other"
    assert result_key("cra", other) != result_key("cra", full)


@given(requests)
def test_round_trip_to_the_solver_is_exact_and_explicit_defaults_change_no_key(request_: Any) -> None:
    model, body = request_
    request = model.model_validate(body)
    full = request.canonical()
    again = model.model_validate_json(json.dumps(full))
    assert again.canonical() == full
    assert key_of(model, full) == key_of(model, body)
    # All fields are part of the key except `alternatives` and, if it is SI, `units`, which do not change the result.
    case = {name: item for name, item in body.items() if name != "alternatives" and (name, item) != ("units", "si")}
    assert given_values_are_kept(case, full)
    try:
        assert again.arguments() == request.arguments()
    except ParameterError:
        assume(False)


def given_values_are_kept(body: Any, canonical: Any) -> bool:
    if isinstance(body, dict):
        return all(given_values_are_kept(item, canonical[name]) for name, item in body.items())
    return bool(body == canonical)


@given(st.decimals(0, 90, places=13).map(float))
def test_degrees_with_fifteen_digits_survive_the_round_trip_to_radians(angle: float) -> None:
    assert degrees(math.radians(angle)) == angle


@given(st.floats(-math.pi, math.pi))
def test_degrees_agree_with_the_standard_conversion(angle: float) -> None:
    assert degrees(angle) == pytest.approx(math.degrees(angle), rel=1e-15, abs=0.0)


def test_operation_and_versions_are_part_of_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    key = result_key("cra", {"a": 1.0})
    assert result_key("trajectory", {"a": 1.0}) != key
    for version in ("ENGINE_VERSION", "SCHEMA_VERSION"):
        with monkeypatch.context() as patch:
            patch.setattr(f"service.operations.{version}", "another")
            assert result_key("cra", {"a": 1.0}) != key


PINNED = PAPER | {
    "numerics": {
        "method": "adaptive",
        "termination_time_s": 0.05,
        "panels": 12000,
        "time_step_s": 1e-5,
        "relative_tolerance": 1e-4,
    },
    "search": {
        "method": "outcome",
        "lower_deg": 5.0,
        "upper_deg": 85.0,
        "tolerance_deg": 0.01,
        "relative_tolerance": 0.01,
    },
}


def test_keys_equal_the_keys_of_earlier_releases(monkeypatch: pytest.MonkeyPatch) -> None:
    """If these keys changed, no stored result would be found: raise ENGINE_VERSION or SCHEMA_VERSION instead."""
    monkeypatch.setattr("service.operations.ENGINE_VERSION", "pinned")
    monkeypatch.setattr("service.operations.SCHEMA_VERSION", "pinned")
    plain = {"b": [1, -0.0, 0.1], "a": {"x": True, "y": "text"}}
    assert result_key("cra", plain) == "5f5498632e6d1553421c0d9445b4fa1c6f38e9e475617186e1895e417f57385d"
    request = CriticalAngleRequest.model_validate(PINNED).canonical()
    assert result_key("cra", request) == "082a229c01ef2fb0b1835dc1836c2cd86db6217dba0d07f2ce4060cd297065a1"
