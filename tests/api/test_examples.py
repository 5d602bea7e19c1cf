"""Examples in the contract: requests are accepted, and answers match the answers of the service."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from service.api.examples import first_request, shortened
from service.api.health import Version
from service.operations import OPERATIONS, Operation
from service.schemas import answers
from service.schemas.quantities import Part
from service.schemas.strike import PAPER, PAPER_AT_45
from tests.conftest import ROOT

from .test_golden_answers import as_text, differences

CONTRACT = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))
SCHEMAS: dict[str, dict[str, Any]] = CONTRACT["components"]["schemas"]
REQUESTS = {
    "TrajectoryRequest": ("/trajectory", PAPER_AT_45),
    "CriticalAngleRequest": ("/cra", PAPER),
    "FormulasRequest": ("/formulas", {name: PAPER[name] for name in ("projectile", "target", "impact")}),
}


def places(name: str, steps: tuple[str, ...] = ()) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield a schema and every schema nested in it, by name, with the path to it."""
    schema = SCHEMAS[name]
    yield name, steps
    for variant in schema.get("oneOf", ()):
        yield from places(variant["$ref"].rpartition("/")[2], steps)
    for field, content in schema.get("properties", {}).items():
        if "$ref" in content:
            yield from places(content["$ref"].rpartition("/")[2], (*steps, field))


def put(body: Any, steps: tuple[str, ...], value: Any) -> Any:
    """Return a copy of the body with this value at this path."""
    if not steps:
        return value
    changed = {**body, steps[0]: put(body.get(steps[0], {}), steps[1:], value)}
    if value == {"shape": "sphere"} and steps == ("nose",):  # For a sphere the length equals the diameter.
        changed["length_m"] = changed["diameter_m"]
    return changed


SENT = [
    pytest.param(path, put(usual, steps, example), id=f"{name}-{number}-{path}")
    for request, (path, usual) in REQUESTS.items()
    for name, steps in places(request)
    for number, example in enumerate(SCHEMAS[name].get("examples", ()))
]
VELOCITIES = {"field": "impact.velocity_m_s", "values": [238.0]}
MANY: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "TrajectoryCase": ("/trajectory/batch", lambda example: {"cases": [example]}),
    "BatchOutput": ("/trajectory/batch", lambda example: {"cases": [PAPER_AT_45 | {"output": example}]}),
    "TrajectoryBase": ("/trajectory/sweep", lambda example: {"base": example, "axes": [VELOCITIES]}),
    "CriticalAngleCase": ("/cra/batch", lambda example: {"cases": [example]}),
    "ThicknessCase": ("/thickness/batch", lambda example: {"cases": [example]}),
    "LimitSpeedCase": ("/limit-speed/batch", lambda example: {"cases": [example]}),
    "Approach": ("/limit-speed", lambda example: SCHEMAS["LimitSpeedRequest"]["examples"][0] | {"impact": example}),
    "Axis": ("/cra/sweep", lambda example: {"base": PAPER, "axes": [example]}),
}
"""Parts that `REQUESTS` lacks, each with a path and a function that puts an example of the part into a body."""
TESTS = SCHEMAS["DepthCalibrationRequest"]["examples"][0]
MOTION = SCHEMAS["MotionCalibrationRequest"]["examples"][0]
POINTS = SCHEMAS["ObliquityCalibrationRequest"]["examples"][0]
CALIBRATIONS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "DepthTest": ("/calibration/depth", lambda example: TESTS | {"tests": [example, example]}),
    "CalibrationResistance": ("/calibration/depth", lambda example: TESTS | {"resistance": example}),
    "MotionRecord": ("/calibration/motion", lambda example: MOTION | {"history": example}),
    "MotionWeights": ("/calibration/motion", lambda example: MOTION | {"weights": example}),
    "ObliquityPoint": ("/calibration/obliquity", lambda example: {"points": [example], "order": 0}),
}
"""Like `MANY`, for each part that only calibrations have."""
WHOLE: dict[str, tuple[str, Callable[[Any], Any]]] = {
    operation["post"]["requestBody"]["content"]["application/json"]["schema"]["$ref"].rpartition("/")[2]: (path, dict)
    for path, operation in CONTRACT["paths"].items()
    if path.endswith(("/batch", "/sweep", "/thickness", "/limit-speed")) or path.startswith("/calibration")
}
"""Like `MANY`, for each example that is a whole request."""
OTHERS = WHOLE | MANY | CALIBRATIONS
SENT += [
    pytest.param(path, body(example), id=f"{name}-{number}-{path}")
    for name, (path, body) in OTHERS.items()
    for number, example in enumerate(SCHEMAS[name]["examples"])
]
IN_REQUESTS = OTHERS.keys() | {name for request in REQUESTS for name, _ in places(request)}
IN_ANSWERS = SCHEMAS.keys() - IN_REQUESTS


@pytest.mark.parametrize(("path", "body"), SENT)
def test_example_of_a_request_is_answered(client: httpx.Client, path: str, body: dict[str, Any]) -> None:
    response = client.post(path, json=body)
    assert response.status_code == 200, response.text


def models(root: type[Part] = Part) -> Iterator[tuple[str, type[Part]]]:
    for model in root.__subclasses__():
        yield model.__name__, model
        yield from models(model)


@pytest.mark.parametrize(
    ("name", "example"),
    [(name, example) for name in sorted(IN_ANSWERS) for example in SCHEMAS[name].get("examples", ())],
)
def test_example_of_an_answer_is_valid(name: str, example: Any) -> None:
    dict(models())[name].model_validate(example)


def test_example_of_a_trajectory_matches_the_paper_strike(client: httpx.Client) -> None:
    answer = client.post("/trajectory", json=PAPER_AT_45).json()
    example = SCHEMAS["TrajectoryAnswer"]["examples"][0]
    assert example["outcome"] == answer["outcome"]
    assert example["maximum_depth_m"] == pytest.approx(answer["maximum_depth_m"], rel=0.01)
    final, expected = dict(example["final"]), dict(answer["final"])
    moment = final.pop("moment_n_m") - expected.pop("moment_n_m")
    assert final == pytest.approx(expected, rel=0.05)
    largest = max(map(abs, answer["history"]["moment_n_m"]))
    assert abs(moment) < 0.005 * largest  # The moment on a body at rest is rounding error.
    assert answers.WARNING["code"] in {warning["code"] for warning in answer["warnings"]}


def test_example_of_a_critical_angle_matches_the_paper_strike(client: httpx.Client) -> None:
    answer = client.post("/cra", json=PAPER).json()
    example = SCHEMAS["CriticalAngleAnswer"]["examples"][0]
    assert example["status"] == answer["status"]
    assert example["critical_angle_deg"] == pytest.approx(answer["critical_angle_deg"], abs=0.02)
    assert example["bracket_deg"] == pytest.approx(answer["bracket_deg"], abs=0.02)


@pytest.mark.parametrize("kind", ["Depth", "Motion", "Obliquity"])
def test_example_of_a_calibration_gets_its_example_answer(client: httpx.Client, kind: str) -> None:
    request, example = (SCHEMAS[f"{kind}Calibration{part}"]["examples"][0] for part in ("Request", "Answer"))
    answer = client.post(f"/calibration/{kind.lower()}", json=request).json()
    told, shown = dict(leaves(answer)), dict(leaves(example))
    assert told.keys() == shown.keys()
    for place, value in shown.items():
        if isinstance(value, float):
            assert told[place] == pytest.approx(value, rel=0.02, abs=5e-3), place


def leaves(value: Any, steps: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield every value that is not a container, with the path to it."""
    if isinstance(value, dict | list):
        for step, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*steps, step))
    else:
        yield steps, value


@pytest.mark.parametrize(
    "operation", [each for each in OPERATIONS.values() if each.study is None], ids=lambda each: each.name
)
def test_example_answer_is_the_answer_to_the_example_request(client: httpx.Client, operation: Operation) -> None:
    """The contract shows the same example, which `make openapi` computes, for a single case and for a batch."""
    answer = client.post(operation.path, json=first_request(operation)).json()
    example = SCHEMAS[operation.answer.__name__]["examples"][0]
    assert differences(as_text(example), as_text(shortened(answer))) == []
    if operation.many is not None:
        assert SCHEMAS[operation.many.models.results.__name__]["examples"][0]["results"][0]["result"] == example


def test_example_of_a_problem_is_a_real_answer(client: httpx.Client) -> None:
    answer = client.post("/cra", json=put(PAPER, ("projectile", "length_m"), 0.1)).json()
    assert answer == SCHEMAS["Problem"]["examples"][0]
    assert answer["errors"] == SCHEMAS["ProblemError"]["examples"]


def test_example_of_versions_names_libraries_in_use(client: httpx.Client) -> None:
    versions = Version.model_validate(client.get("/version").json())
    assert SCHEMAS["Version"]["examples"][0]["libraries"].keys() <= versions.libraries.keys()
