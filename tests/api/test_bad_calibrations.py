"""Whatever is sent to be calibrated, the answer is a problem that names what is wrong, never a 500."""

import json
from copy import deepcopy
from typing import Any

import httpx
import pytest

from service.schemas.calibration_depth import TABLE_1, TABLE_2
from service.schemas.calibration_motion import AT_30
from service.schemas.strike import PAPER

from .refused import TEXT, changed, problem_of, refused_at

SHARED = {"projectile": PAPER["projectile"], "target": PAPER["target"]}
CALIBRATIONS: dict[str, dict[str, Any]] = {
    "/calibration/depth": SHARED | {"tests": TABLE_1},
    "/calibration/motion": SHARED | {"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 30.0}, "history": AT_30},
    "/calibration/obliquity": {"points": TABLE_2},
}
EQ_9 = {"model": "obliquity_polynomial", "coefficients": [8.469, 0.0149, -0.0013]}
MATRIX = [[0.05, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-8]]


@pytest.mark.parametrize(
    ("pointer", "value", "named"),
    [
        ("", MATRIX[:2], ""),
        ("/2", [0.0, 0.0], "/2"),
        ("/1/1", -1e-4, ""),
        ("/0/1", 0.01, ""),
        ("/0/2", 1.0, ""),
        ("", [], ""),
        ("/1", [], "/1"),
        ("/1/2", "0", "/1/2"),
        ("/1/2", 1e7, "/1/2"),
    ],
)
def test_covariance_that_is_none_is_named(client: httpx.Client, pointer: str, value: Any, named: str) -> None:
    matrix = changed({"m": MATRIX}, f"/m{pointer}", value)["m"]
    if pointer == "/0/2":
        matrix[2][0] = value
    place = "/resistance/strength_factor"
    case = changed(PAPER, place, EQ_9 | {"covariance": matrix})
    refused_at(client.post("/cra", json=case), f"{place}/covariance{named}")
    refused_at(client.post("/cra/batch", json={"cases": [case]}), f"/cases/0{place}/covariance{named}")


@pytest.mark.parametrize(
    ("path", "pointer", "value", "named"),
    [
        ("depth", "/tests", [], "/tests"),
        ("depth", "/tests", TABLE_1 * 251, "/tests"),
        ("depth", "/tests", ..., "/tests"),
        ("depth", "/tests/3/velocity_m_s", 0.0, "/tests/3/velocity_m_s"),
        ("depth", "/tests/3/velocity_m_s", -238.0, "/tests/3/velocity_m_s"),
        ("depth", "/tests/2/depth_m", 0.0, "/tests/2/depth_m"),
        ("depth", "/tests/2/depth_m", 450.0, "/tests/2/depth_m"),
        ("depth", "/tests/1/mass_kg", 0.0, "/tests/1/mass_kg"),
        ("depth", "/tests/1/weight", 0.0, "/tests/1/weight"),
        ("depth", "/tests/1/velocity", 275.7, "/tests/1/velocity"),
        ("depth", "/tests/0/group", "one", "/tests/1/group"),
        ("depth", "/tests/0/group", "", "/tests/0/group"),
        ("depth", "/projectile/length_m", 0.1, "/projectile/length_m"),
        ("depth", "/target", ..., "/target"),
        ("depth", "/resistance", {"strength_factor": EQ_9}, "/resistance/strength_factor"),
        ("depth", "/resistance", {"crater": {"depth_diameters": 0.0}}, "/resistance/crater/depth_diameters"),
        ("depth", "/numerics", {"method": "panels", "panels": 10}, "/numerics/panels"),
        ("depth", "/numerics", {"method": "panels", "panels": 100_000, "time_step_s": 1e-7}, "/numerics/panels"),
        ("depth", "/confidence_level", 1.0, "/confidence_level"),
        ("depth", "/compare_strength_factors", [0.0], "/compare_strength_factors/0"),
        ("depth", "/compare_strength_factors", [8.0] * 21, "/compare_strength_factors"),
        ("depth", "/target/compressive_strength_pa", 1e5, "/tests"),
        ("motion", "/history", {"time_s": [0.0, 0.001]}, "/history"),
        ("motion", "/history/time_s", ..., "/history/time_s"),
        ("motion", "/history/time_s", [0.0], "/history/time_s"),
        ("motion", "/history/time_s/3", 0.0005, "/history/time_s/3"),
        ("motion", "/history/time_s/3", 0.001, "/history/time_s/3"),
        ("motion", "/history/time_s/0", -0.001, "/history/time_s/0"),
        ("motion", "/history/rotation_deg", [0.0, 1.0, 2.0], "/history/rotation_deg"),
        ("motion", "/history/rotation_deg/3", "11", "/history/rotation_deg/3"),
        ("motion", "/history/rotation_deg/3", 1100.0, "/history/rotation_deg/3"),
        ("motion", "/history/depth_displacement_m/3", 226.0, "/history/depth_displacement_m/3"),
        ("motion", "/history/lateral_displacement_m", [0.0] * 20_001, "/history/lateral_displacement_m"),
        ("motion", "/history/velocity_m_s", [0.0] * 6, "/history/velocity_m_s"),
        ("motion", "/impact/oblique_angle_deg", ..., "/impact/oblique_angle_deg"),
        ("motion", "/impact/velocity_m_s", 0.0, "/impact/velocity_m_s"),
        ("motion", "/until_s", 0.0, "/until_s"),
        ("motion", "/until_s", 1e-4, "/until_s"),
        ("motion", "/until_greatest_depth", 1, "/until_greatest_depth"),
        ("motion", "/weights", {"depth": 0.0, "lateral": 0.0, "rotation": 0.0}, "/weights"),
        ("motion", "/weights/depth", -1.0, "/weights/depth"),
        ("obliquity", "/points", [], "/points"),
        ("obliquity", "/points", TABLE_2[:2], "/points"),
        ("obliquity", "/points", TABLE_2[:1] * 5, "/points"),
        ("obliquity", "/points/1/oblique_angle_deg", 90.0, "/points/1/oblique_angle_deg"),
        ("obliquity", "/points/1/strength_factor", 0.0, "/points/1/strength_factor"),
        ("obliquity", "/points/1/standard_error", 0.0, "/points/1/standard_error"),
        ("obliquity", "/points/0/standard_error", 0.1, "/points/1/standard_error"),
        ("obliquity", "/points", [TABLE_2[i] | {"oblique_angle_deg": i * 1e-9} for i in range(3)], "/points"),
        ("obliquity", "/order", 4, "/points"),
        ("obliquity", "/order", 10, "/order"),
        ("obliquity", "/order", -1, "/order"),
        ("obliquity", "/order", 1.5, "/order"),
    ],
)
def test_calibration_problem_names_the_field(
    client: httpx.Client, path: str, pointer: str, value: Any, named: str
) -> None:
    path = f"/calibration/{path}"
    refused_at(client.post(path, json=changed(CALIBRATIONS[path], pointer, value)), named)


RUN = {"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 30.0}, "history": AT_30}
TWO_ENDS = {"until_s": 0.001, "until_greatest_depth": True}
ROTATION = {name: AT_30[name] for name in ("time_s", "rotation_deg")}


@pytest.mark.parametrize(
    ("pointer", "value", "named"),
    [
        ("", {"runs": []}, "/runs"),
        ("", {"runs": [RUN] * 21}, "/runs"),
        ("", {"runs": [RUN], "history": AT_30}, "/history"),
        ("", {"runs": [RUN], "impact": RUN["impact"]}, "/impact"),
        ("", {}, "/impact"),
        ("", {"impact": RUN["impact"]}, "/history"),
        ("", {"runs": [RUN], "until_s": 1e-4}, "/runs/0/until_s"),
        ("", {"runs": [RUN | TWO_ENDS]}, "/runs/0/until_greatest_depth"),
        ("", RUN | TWO_ENDS, "/until_greatest_depth"),
        ("", RUN | {"history": ROTATION, "until_greatest_depth": True}, "/history/depth_displacement_m"),
        ("/runs/1/impact", ..., "/runs/1/impact"),
        ("/runs/1/history/time_s/3", 0.0005, "/runs/1/history/time_s/3"),
        ("/runs/1/history/rotation_deg/3", 1100.0, "/runs/1/history/rotation_deg/3"),
        ("/runs/1/history/depth_displacement_m/3", 226.0, "/runs/1/history/depth_displacement_m/3"),
        ("/runs/1/weights", {"depth": 0.0, "lateral": 0.0, "rotation": 0.0}, "/runs/1/weights"),
        ("/runs/1/until_s", 1e-4, "/runs/1/until_s"),
        ("/runs/1/velocity_m_s", 238.0, "/runs/1/velocity_m_s"),
        ("/target/compressive_strength_pa", 1e5, "/runs"),
    ],
)
def test_problem_of_a_run_names_its_place(client: httpx.Client, pointer: str, value: Any, named: str) -> None:
    body = SHARED | value if pointer == "" else changed(SHARED | {"runs": [RUN, deepcopy(RUN)]}, pointer, value)
    refused_at(client.post("/calibration/motion", json=body), named)


@pytest.mark.parametrize("path", CALIBRATIONS)
@pytest.mark.parametrize(
    ("content", "status", "pointer"),
    [
        (b"", 422, ""),
        (b"null", 422, ""),
        (b"[]", 422, ""),
        (b"{", 400, ""),
        (b"[" * 10_000 + b"]" * 10_000, 400, ""),
        (b" " * 5_000_000, 413, ""),
        (json.dumps(dict.fromkeys(map(str, range(100_000)), 1)).encode(), 400, ""),
        (json.dumps(dict.fromkeys(map(str, range(31)), 1)).encode(), 422, ""),
        (json.dumps({"a": [0, {"b/c": dict.fromkeys(map(str, range(31)), 1)}]}).encode(), 422, "/a/1/b~1c"),
    ],
    ids=lambda value: repr(value[:16]) if isinstance(value, bytes) else str(value),
)
def test_body_that_is_no_calibration_is_refused_whole(
    client: httpx.Client, path: str, content: bytes, status: int, pointer: str
) -> None:
    found = problem_of(client.post(path, content=content, headers=TEXT), status)
    assert [error.pointer for error in found.errors] == [pointer]


def test_columns_full_of_mistakes_are_reported_by_their_first(client: httpx.Client) -> None:
    body = CALIBRATIONS["/calibration/motion"] | {"history": {name: ["x"] * 20_000 for name in AT_30}}
    refused_at(client.post("/calibration/motion", json=body), *(f"/history/{name}/0" for name in AT_30))


@pytest.mark.parametrize("path", CALIBRATIONS)
def test_calibration_takes_json_alone(client: httpx.Client, path: str) -> None:
    problem_of(client.post(path, content=b"{}", headers={"Content-Type": "text/csv"}), 415)
    assert client.get(path).headers["Allow"] == "POST"
