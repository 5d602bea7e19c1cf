"""Guarantees of the HTTP contract, tested against a running service."""

import hashlib
import math
import re
from typing import Any

import httpx
import pytest
from pydantic import TypeAdapter

from service.api.job_models import Result
from service.operations import OPERATIONS, SCHEMA_VERSION
from service.schemas import CriticalAngleAnswer, TrajectoryAnswer
from service.schemas.strike import HEMISPHERE, PAPER, PAPER_AT_45
from solver import ENGINE_VERSION

from .many import file_at, rows_at
from .refused import changed

JSON = {"Content-Type": "application/json"}
CSV, HDF5 = {"Accept": "text/csv"}, {"Accept": "application/x-hdf5"}
SINGLE: list[tuple[str, dict[str, Any]]] = [
    (each.path, each.request.model_json_schema()["examples"][0]) for each in OPERATIONS.values() if each.study is None
]
"""Path and first example of each operation that is answered at once."""


@pytest.fixture(scope="module")
def trajectory(client: httpx.Client) -> dict[str, Any]:
    answer: dict[str, Any] = client.post("/trajectory", json=PAPER_AT_45).raise_for_status().json()
    return answer


@pytest.fixture(scope="module")
def search(client: httpx.Client) -> dict[str, Any]:
    answer: dict[str, Any] = client.post("/cra", json=PAPER).raise_for_status().json()
    return answer


def test_critical_angle_of_the_paper(search: dict[str, Any]) -> None:
    answer = CriticalAngleAnswer.model_validate(search)
    assert answer.status == "converged"
    assert answer.critical_angle_deg == pytest.approx(48.63, abs=0.05)
    assert answer.engine_version == ENGINE_VERSION
    assert answer.bracket_deg == [pytest.approx(answer.critical_angle_deg, abs=0.01), answer.critical_angle_deg]
    assert answer.critical_angle_deg in [trial.oblique_angle_deg for trial in answer.iterations]
    assert "trajectory" not in search


def test_history_runs_from_first_contact_to_the_final_instant(trajectory: dict[str, Any]) -> None:
    answer = TrajectoryAnswer.model_validate(trajectory)
    assert answer.outcome == "embedded"
    history = trajectory["history"]
    assert list(history) == [*trajectory["final"], "axial_acceleration_g", "transverse_acceleration_g"]
    assert len({len(column) for column in history.values()}) == 1
    assert (history["time_s"][0], history["center_of_gravity_lateral_m"][0]) == (0.0, 0.0)
    assert history["axis_angle_deg"][0] == pytest.approx(45.0, rel=1e-15)
    assert {name: history[name][-1] for name in trajectory["final"]} == pytest.approx(trajectory["final"], rel=1e-12)


def test_accelerations_are_the_resistance_divided_by_the_weight(trajectory: dict[str, Any]) -> None:
    history = trajectory["history"]
    axial, transverse = history["axial_acceleration_g"], history["transverse_acceleration_g"]
    forces = map(math.hypot, history["depth_force_n"], history["lateral_force_n"])
    assert list(map(math.hypot, axial, transverse)) == pytest.approx([force / (13.0 * 9.80665) for force in forces])
    assert -2e4 < min(axial) < -5e3


def test_history_is_given_as_requested(client: httpx.Client, trajectory: dict[str, Any]) -> None:
    without = client.post("/trajectory", json=PAPER_AT_45 | {"output": {"history": False}}).json()
    assert "history" not in without
    assert without["final"] == trajectory["final"]
    coarse = client.post("/trajectory", json=PAPER_AT_45 | {"output": {"sample_interval_s": 1e-3}}).json()
    assert coarse["history"]["time_s"] == pytest.approx([0.0, 1e-3, 2e-3, 3e-3, trajectory["final"]["time_s"]])


def test_trajectory_at_the_critical_angle_is_a_ricochet(client: httpx.Client) -> None:
    answer = client.post("/cra", json=HEMISPHERE).json()
    assert answer["trajectory"]["outcome"] == "ricochet"
    assert answer["trajectory"]["history"]["axis_angle_deg"][0] == pytest.approx(answer["critical_angle_deg"])


def test_search_without_a_critical_angle_is_answered(client: httpx.Client) -> None:
    for lower, upper, status in ((10.0, 20.0, "no_ricochet"), (60.0, 70.0, "always_ricochet")):
        search = {"lower_deg": lower, "upper_deg": upper}
        response = client.post("/cra", json=PAPER | {"search": search, "output": {"history": True}})
        answer = CriticalAngleAnswer.model_validate(response.json())
        assert answer.status == status
        assert not {"critical_angle_deg", "bracket_deg", "trajectory"} & response.json().keys()


def test_angles_are_returned_as_they_were_sent(client: httpx.Client) -> None:
    for lower, upper in ((47.1, 50.3), (48.3, 48.7)):
        search = {"lower_deg": lower, "upper_deg": upper, "tolerance_deg": 0.1}
        answer = client.post("/cra", json=PAPER | {"search": search}).json()
        tried = [trial["oblique_angle_deg"] for trial in answer["iterations"]]
        assert (min(tried), max(tried)) == (lower, upper)


@pytest.mark.parametrize(("path", "body"), SINGLE)
def test_second_answer_is_a_cache_hit_and_equals_the_stored_result(
    client: httpx.Client, path: str, body: dict[str, Any]
) -> None:
    has_target = path not in {"/calibration/obliquity", "/flight"}
    fresh = changed(body, "/target/density_kg_m3", 2251.0) if has_target else body
    first, second = client.post(path, json=fresh), client.post(path, json=fresh)
    if fresh is not body:
        assert first.headers["Cache-Status"] == "ricochet; fwd=miss"
    assert second.headers["Cache-Status"] == "ricochet; hit"
    assert first.content == second.content
    assert client.get(f"/results/{first.json()['key']}").json() == first.json()


def test_equal_requests_in_other_notation_share_a_result(client: httpx.Client, search: dict[str, Any]) -> None:
    text = """{"impact": {"angular_velocity_rad_s": -0.0, "velocity_m_s": 238}, "search": {"upper_deg": 85},
               "numerics": {"panels": 12e3}, "target": {"density_kg_m3": 2.25e3, "compressive_strength_pa": 39000000},
               "projectile": {"mass_kg": 13, "length_m": 0.53, "diameter_m": 8e-2,
                              "nose": {"caliber_radius_head": 3, "shape": "ogive"}}}"""
    response = client.post("/cra", content=text, headers=JSON)
    assert response.json() == search
    assert response.headers["Cache-Status"] == "ricochet; hit"
    assert "validate;dur=" in response.headers["Server-Timing"]


def test_stored_result_equals_the_answer(
    client: httpx.Client, trajectory: dict[str, Any], search: dict[str, Any]
) -> None:
    for answer in (trajectory, search):
        response = client.get(f"/results/{answer['key']}")
        assert response.headers["Content-Type"] == "application/json"
        assert response.json() == answer
        TypeAdapter(Result).validate_python(answer)


def table_of(client: httpx.Client, key: str) -> dict[str, list[str]]:
    rows = rows_at(client, f"/results/{key}")
    return {name: [row[name] for row in rows] for name in rows[0]}


def test_csv_of_a_trajectory_lists_its_history(client: httpx.Client, trajectory: dict[str, Any]) -> None:
    table = table_of(client, trajectory["key"])
    assert {name: [float(cell) for cell in column] for name, column in table.items()} == trajectory["history"]


def test_csv_of_a_trajectory_without_history_has_its_final_state(client: httpx.Client) -> None:
    answer = client.post("/trajectory", json=PAPER_AT_45 | {"output": {"history": False}}).json()
    table = table_of(client, answer["key"])
    assert {name: [float(cell) for cell in column] for name, column in table.items()} == {
        name: [value] for name, value in answer["final"].items()
    }


def test_csv_of_a_search_lists_its_trials(client: httpx.Client, search: dict[str, Any]) -> None:
    table = table_of(client, search["key"])
    assert list(table) == ["oblique_angle_deg", "final_position_m", "outcome", "fine"]
    assert table["outcome"] == [trial["outcome"] for trial in search["iterations"]]


def test_hdf5_file_of_a_result_can_be_read(client: httpx.Client, trajectory: dict[str, Any]) -> None:
    with file_at(client, f"/results/{trajectory['key']}") as file:
        assert file["history"]["time_s"][()].tolist() == trajectory["history"]["time_s"]


@pytest.mark.parametrize(
    ("accept", "media_type"),
    [
        (None, "application/json"),
        ("", "application/json"),
        ("*/*", "application/json"),
        ("text/*", "text/csv"),
        ("application/*", "application/json"),
        ("application/*;q=0.1, application/x-hdf5", "application/x-hdf5"),
        ("text/html, application/xhtml+xml, */*;q=0.8", "application/json"),
        ("TEXT/CSV;q=0.9, application/json;q=0.2", "text/csv"),
        ("application/json;q=0, */*", "text/csv"),
    ],
)
def test_accept_header_chooses_the_format(
    client: httpx.Client, search: dict[str, Any], accept: str | None, media_type: str
) -> None:
    request = client.build_request("GET", f"/results/{search['key']}")
    del request.headers["Accept"]
    if accept is not None:
        request.headers["Accept"] = accept
    assert client.send(request).headers["Content-Type"].partition(";")[0] == media_type


@pytest.mark.parametrize("accept", ["text/html", "image/png, application/xml;q=0.5", "*/*;q=0", "text/csv;q=none"])
def test_unsupported_format_is_not_acceptable(client: httpx.Client, search: dict[str, Any], accept: str) -> None:
    asked = [("GET", f"/results/{search['key']}", None), *(("POST", path, body) for path, body in SINGLE)]
    for method, path, body in asked:
        response = client.request(method, path, json=body, headers={"Accept": accept})
        assert response.status_code == 406, path
        assert response.headers["Content-Type"] == "application/problem+json"


@pytest.mark.parametrize(("path", "body"), SINGLE)
@pytest.mark.parametrize("form", [CSV, HDF5], ids=lambda form: form["Accept"])
def test_answers_have_the_formats_of_stored_results(
    client: httpx.Client, path: str, body: dict[str, Any], form: dict[str, str]
) -> None:
    answer = client.post(path, json=body, headers=form)  # The first answer is computed, the next are cached.
    for accepted in (form, {"Accept": f"{form['Accept']}, */*;q=0.1"}):
        answer = client.post(path, json=body, headers=accepted).raise_for_status()
        assert answer.headers["Content-Type"].partition(";")[0] == form["Accept"]
        assert "accept" in answer.headers["Vary"].lower()
    key = client.post(path, json=body).json()["key"]
    result = client.get(f"/results/{key}", headers=form)
    assert answer.content == result.content or form is HDF5  # HDF5 files contain the time of writing.


@pytest.mark.parametrize("form", [{"Accept": "application/json"}, CSV, HDF5], ids=lambda form: form["Accept"])
def test_etag_avoids_sending_what_the_client_has(
    client: httpx.Client, trajectory: dict[str, Any], form: dict[str, str]
) -> None:
    path = f"/results/{trajectory['key']}"
    form = form | {"Accept-Encoding": "identity"}  # Entity tags of compressed answers are weak.
    whole = client.get(path, headers=form)
    etag, vary = whole.headers["ETag"], whole.headers["Vary"]
    assert re.fullmatch(r'"[0-9a-f]+"', etag)
    assert vary == "Accept, Accept-Encoding"
    for tags in (etag, f'"other", {etag}', f"W/{etag}", "*"):
        response = client.get(path, headers=form | {"If-None-Match": tags})
        assert (response.status_code, response.content, response.headers["ETag"]) == (304, b"", etag)
        assert response.headers["Vary"] == vary, "as with 200 (RFC 9110, 15.4.5)"
    assert client.get(path, headers=form | {"If-None-Match": '"other"'}).status_code == 200


def test_each_format_of_a_result_has_its_own_tag(client: httpx.Client, search: dict[str, Any]) -> None:
    forms = ({"Accept": "application/json"}, CSV, HDF5)
    responses = [client.get(f"/results/{search['key']}", headers=form) for form in forms]
    assert len({response.headers["ETag"] for response in responses}) == 3
    assert len({hashlib.sha256(response.content).digest() for response in responses}) == 3


def test_service_reports_health_and_versions(client: httpx.Client) -> None:
    assert client.get("/livez").json() == {"status": "ok"}
    assert client.get("/readyz").json() == {"status": "ok", "chunks_on": "pool"}
    places = ('{place="pool"} 2.0', '{place="cluster"} 0.0')
    assert all(f"ricochet_chunk_width{place}" in client.get("/metrics").text for place in places)
    versions = client.get("/version").json()
    assert (versions["engine_version"], versions["schema_version"]) == (ENGINE_VERSION, SCHEMA_VERSION)
    assert {"ricochet", "numpy"} <= versions["libraries"].keys()


def test_docs_refer_to_no_other_host(client: httpx.Client) -> None:
    page = client.get("/docs")
    assert page.headers["Content-Type"].startswith("text/html")
    assert "//" not in re.sub(r"<!--.*?-->", "", page.text)
    assert "default-src 'self'" in page.headers["Content-Security-Policy"]
    addresses = re.findall(r'(?:href|src)="([^"]+)"', page.text) + re.findall(r"url: '([^']+)'", page.text)
    for address in addresses:
        if not address.startswith("data:"):
            assert client.get(httpx.URL("/docs").join(address)).status_code == 200, address
    assert {"docs/assets/swagger-ui-bundle.js", "openapi.json"} <= set(addresses)
