"""`/umbridge`: the protocol UM-Bridge 1.0 (Seelinger et al., 2023)."""

import json
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER, PAPER_AT_45


def call(client: httpx.Client, endpoint: str, **content: Any) -> Any:
    response = client.post(f"/umbridge/{endpoint}", json=content)
    assert response.status_code == 200, response.text
    return response.json()


def evaluate(client: httpx.Client, name: str, values: list[float], **config: Any) -> list[float]:
    output = call(client, "Evaluate", name=name, input=[values], config=config)["output"]
    assert len(output) == 1
    return list(output[0])


def error_of(client: httpx.Client, endpoint: str, content: Any) -> tuple[str, str]:
    response = client.post(f"/umbridge/{endpoint}", json=content)
    assert response.status_code == 400, response.text
    assert response.json().keys() == {"error"}
    error = response.json()["error"]
    assert error.keys() == {"type", "message"}
    return error["type"], error["message"]


def test_umbridge_describes_the_models(client: httpx.Client) -> None:
    assert client.get("/umbridge/Info").json() == {"protocolVersion": 1.0, "models": ["cra", "trajectory"]}
    support = {"Evaluate": True, "Gradient": False, "ApplyJacobian": False, "ApplyHessian": False}
    for name, size in (("cra", 2), ("trajectory", 4)):
        assert call(client, "ModelInfo", name=name) == {"support": support}
        assert call(client, "InputSizes", name=name) == {"inputSizes": [2]}
        assert call(client, "OutputSizes", name=name, config={}) == {"outputSizes": [size]}


def test_umbridge_angle_equals_the_angle_of_a_search(client: httpx.Client) -> None:
    body = PAPER | {"impact": {"velocity_m_s": 230.5}, "target": PAPER["target"] | {"compressive_strength_pa": 41.5e6}}
    angle = client.post("/cra", json=body).json()["critical_angle_deg"]
    assert evaluate(client, "cra", [230.5, 41.5]) == [angle, 0.0]


def test_umbridge_angle_is_finite_where_there_is_no_critical_angle(client: httpx.Client) -> None:
    assert evaluate(client, "cra", [238.0, 39.0], search={"lower_deg": 5.0, "upper_deg": 30.0}) == [90.0, 1.0]
    assert evaluate(client, "cra", [238.0, 39.0], search={"lower_deg": 70.0, "upper_deg": 80.0}) == [0.0, 2.0]


def test_umbridge_trajectory_equals_the_trajectory_of_a_strike(client: httpx.Client) -> None:
    embedded = client.post("/trajectory", json=PAPER_AT_45).json()
    assert embedded["outcome"] == "embedded"
    assert evaluate(client, "trajectory", [238.0, 39.0]) == [0.0, embedded["maximum_depth_m"], 0.0, 0.0]
    impact = {"velocity_m_s": 238.0, "oblique_angle_deg": 60.0}
    final = client.post("/trajectory", json=PAPER | {"impact": impact}).json()["final"]
    outcome, _, speed, angle = evaluate(client, "trajectory", [238.0, 39.0], impact=impact)
    assert outcome == 1.0
    assert speed == pytest.approx((final["depth_velocity_m_s"] ** 2 + final["lateral_velocity_m_s"] ** 2) ** 0.5)
    assert 0.0 < angle < 90.0


def test_strike_through_a_wall_has_its_residual_speed(client: httpx.Client) -> None:
    wall = PAPER["target"] | {"thickness_m": 0.2}
    impact = {"velocity_m_s": 238.0, "oblique_angle_deg": 20.0}
    outcome, _, speed, angle = evaluate(client, "trajectory", [238.0, 39.0], target=wall, impact=impact)
    assert (outcome, angle) == (3.0, 0.0)
    assert speed == pytest.approx(92.8, abs=0.5)  # The value is from an independent program.


def test_inputs_follow_the_order_of_the_configuration(client: httpx.Client) -> None:
    fields = [("projectile.mass_kg", 1.0), ("impact.velocity_m_s", 10.0), ("resistance.strength_residual", 1.0)]
    inputs = [{"field": field, "scale": scale} for field, scale in fields]
    assert call(client, "InputSizes", name="cra", config={"inputs": inputs}) == {"inputSizes": [3]}
    found = evaluate(client, "cra", [13.5, 22.0, 1.0], inputs=inputs)
    body = PAPER | {"projectile": PAPER["projectile"] | {"mass_kg": 13.5}, "impact": {"velocity_m_s": 220.0}}
    assert found[0] == pytest.approx(client.post("/cra", json=body).json()["critical_angle_deg"], abs=1e-6)
    stronger = evaluate(client, "cra", [13.5, 22.0, 1.2], inputs=inputs)
    assert stronger[0] < found[0]


def test_body_is_read_whatever_its_content_type(client: httpx.Client) -> None:
    content = json.dumps({"name": "cra", "input": [[238, 39]], "config": {}})
    for headers in ({}, {"Content-Type": "application/x-www-form-urlencoded"}, {"Content-Type": "text/plain"}):
        response = client.post("/umbridge/Evaluate", content=content, headers=headers)
        assert response.json()["output"][0][0] == pytest.approx(48.63, abs=0.05)


def test_unknown_models_and_features_have_errors_of_the_protocol(client: httpx.Client) -> None:
    for endpoint in ("ModelInfo", "InputSizes", "OutputSizes", "Evaluate"):
        assert error_of(client, endpoint, {"name": "wrong"}) == ("ModelNotFound", "name must be one of cra, trajectory")
    for endpoint in ("Gradient", "ApplyJacobian", "ApplyHessian"):
        assert error_of(client, endpoint, {"name": "cra"})[0] == "UnsupportedFeature"


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ({}, "input"),
        ({"input": [[238.0]]}, "one list of 2 numbers"),
        ({"input": [[238.0, 39.0, 1.0]]}, "one list of 2 numbers"),
        ({"input": [[238.0], [39.0]]}, "one list of 2 numbers"),
        ({"input": [[238.0, "39"]]}, "/input/0/1"),
        ({"input": [[238.0, True]]}, "/input/0/1"),
        ({"input": [[-1.0, 39.0]]}, "velocity_m_s"),
        ({"input": [[238.0, 1e9]]}, "compressive_strength_pa"),
        ({"input": [[238.0, 39.0]], "config": []}, "config"),
        ({"input": [[238.0, 39.0]], "config": {"target": 3}}, "target"),
        ({"input": [[238.0, 39.0]], "config": {"projectil": {}}}, "projectil"),
        ({"input": [[238.0, 39.0]], "config": {"inputs": [{"field": "impact.velocity"}] * 2}}, "config.inputs.0.field"),
        ({"input": [[238.0, 39.0]], "config": {"inputs": [{"field": "impact.velocity_m_s"}] * 2}}, "config.inputs.1"),
        ({"input": [[238.0, 39.0]], "config": {"inputs": []}}, "/config/inputs"),
        ({"input": [[1.0]], "config": {"inputs": [{"field": "resistance.free_surface.model"}]}}, "config.inputs.0"),
    ],
    ids=str,
)
def test_invalid_input_is_named(client: httpx.Client, content: dict[str, Any], named: str) -> None:
    kind, message = error_of(client, "Evaluate", {"name": "cra", **content})
    assert kind == "InvalidInput"
    assert named in message


def test_body_that_is_not_an_object_is_refused(client: httpx.Client) -> None:
    for content in (b"", b"[]", b"{", b"3", b'{"name": 3}', b"[" * 5000):
        response = client.post("/umbridge/Evaluate", content=content)
        assert response.status_code == 400
        assert response.json()["error"]["type"] in {"InvalidInput", "ModelNotFound"}


def test_allowed_method_is_named(client: httpx.Client) -> None:
    response = client.get("/umbridge/Evaluate")
    assert response.status_code == 405
    assert response.headers["Allow"] == "POST"
