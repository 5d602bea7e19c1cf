"""Every format of sweep results has the values of the axes, and the job contains the request."""

import csv
import io
from typing import Any

import httpx
import orjson
import pandas as pd
import pytest

from service.schemas.strike import PAPER

from .many import ASYNC, file_at, finished

AXES: list[dict[str, Any]] = [
    {"field": "impact.velocity_m_s", "values": [231.0, 241.5]},
    {"field": "projectile.mass_kg", "start": 12.5, "stop": 13.5, "count": 3},
]
FIELDS = [axis["field"] for axis in AXES]
POINTS = [(velocity, mass) for velocity in (231.0, 241.5) for mass in (12.5, 13.0, 13.5)]
SWEEP: dict[str, Any] = {"base": PAPER, "axes": AXES}


@pytest.fixture(scope="module")
def job(client: httpx.Client) -> dict[str, Any]:
    return finished(client, client.post("/cra/sweep", json=SWEEP, headers=ASYNC).json())


def results(client: httpx.Client, job: dict[str, Any], accept: str) -> bytes:
    return client.get(f"/jobs/{job['id']}/results", headers={"Accept": accept}).raise_for_status().content


def table(text: str) -> tuple[dict[str, str], list[dict[str, str]]]:
    """Read CSV; return the fields of the base case, which must be equal in all rows, and the rows."""
    rows = list(csv.DictReader(io.StringIO(text)))
    bases = [{name: cell for name, cell in row.items() if "." in name and name not in FIELDS} for row in rows]
    assert all(base == bases[0] for base in bases)
    return bases[0], rows


BASE = {
    "projectile.nose.shape": "ogive",
    "projectile.nose.caliber_radius_head": "3.0",
    "projectile.diameter_m": "0.08",
    "projectile.length_m": "0.53",
    "target.compressive_strength_pa": "39000000.0",
    "target.density_kg_m3": "2250.0",
}
"""Fields of the paper's case that are not varied, as texts of the CSV table."""


def points(rows: list[dict[str, str]]) -> list[tuple[float, ...]]:
    return [tuple(float(row[field]) for field in FIELDS) for row in rows]


def test_job_of_a_sweep_has_its_request(client: httpx.Client, job: dict[str, Any]) -> None:
    whole = client.get(f"/jobs/{job['id']}").json()
    assert whole["request"] == SWEEP
    assert whole["axes"] == FIELDS
    listed = next(each for each in client.get("/jobs").json()["jobs"] if each["id"] == job["id"])
    assert listed["axes"] == FIELDS
    assert "request" not in listed
    batch = client.post("/cra/batch", json={"cases": [PAPER]}, headers=ASYNC).json()
    assert not {"axes", "request"} & client.get(f"/jobs/{batch['id']}").json().keys()


def test_json_of_a_sweep_has_the_point_of_each_case(client: httpx.Client, job: dict[str, Any]) -> None:
    expected = [dict(zip(FIELDS, point, strict=True)) for point in POINTS]
    page = orjson.loads(results(client, job, "application/json"))["results"]
    lines = [orjson.loads(line) for line in results(client, job, "application/jsonl").splitlines()]
    now = client.post("/cra/sweep", json=SWEEP).json()["results"]
    for items in (page, lines, now):
        assert [item["point"] for item in items] == expected


def test_table_of_a_sweep_has_a_column_for_each_axis_and_for_each_field_of_the_base(
    client: httpx.Client, job: dict[str, Any]
) -> None:
    content = results(client, job, "text/csv")
    base, rows = table(content.decode())
    assert base == BASE
    frame = pd.read_csv(io.BytesIO(content))
    assert [tuple(row) for row in frame[FIELDS].to_numpy()] == POINTS
    assert list(rows[0])[:4] == ["index", *FIELDS, "custom_id"]
    assert points(rows) == POINTS
    angles = [item["result"]["critical_angle_deg"] for item in orjson.loads(results(client, job, "*/*"))["results"]]
    assert [float(row["critical_angle_deg"]) for row in rows] == angles


def test_sweep_and_batch_are_answered_as_csv(client: httpx.Client, job: dict[str, Any]) -> None:
    now = client.post("/cra/sweep", json=SWEEP, headers={"Accept": "text/csv"})
    assert now.headers["Content-Type"].startswith("text/csv")
    assert now.content == results(client, job, "text/csv")
    waited = client.post("/cra/sweep", json=SWEEP, headers={"Accept": "text/csv", "Prefer": "respond-async, wait=20"})
    assert (waited.status_code, waited.content) == (200, now.content)
    batch = client.post("/cra/batch", json={"cases": [PAPER | {"custom_id": "one"}]}, headers={"Accept": "text/csv"})
    [row] = csv.DictReader(io.StringIO(batch.text))
    assert (row["index"], row["custom_id"], row["status"]) == ("0", "one", "converged")


def test_hdf5_file_of_a_sweep_has_its_axes_and_its_base(client: httpx.Client, job: dict[str, Any]) -> None:
    with file_at(client, job["links"]["results"]) as file:
        assert orjson.loads(file.attrs["base"]) == PAPER
        assert file.attrs["axes"].tolist() == FIELDS
        summary = file["summary"]
        assert list(zip(*(summary[field] for field in FIELDS), strict=True)) == POINTS
        assert [summary[field].attrs["units"] for field in FIELDS] == ["m/s", "kg"]


def test_base_too_long_for_a_small_attribute_is_stored_completely(client: httpx.Client) -> None:
    points_of_nose = [[0.13 * i / 900, 0.04 * (1 - (1 - i / 900) ** 1.5)] for i in range(901)]
    nose = {"shape": "profile", "points": points_of_nose}
    base = PAPER | {"projectile": PAPER["projectile"] | {"nose": nose, "length_m": 0.53}}
    sweep = {"base": base, "axes": [{"field": "impact.velocity_m_s", "values": [231.0]}]}
    job = finished(client, client.post("/cra/sweep", json=sweep, headers=ASYNC).raise_for_status().json())
    with file_at(client, job["links"]["results"]) as file:
        assert orjson.loads(file.attrs["base"]) == base


@pytest.mark.parametrize("path", ["/livez", "/version", "/", "/openapi.json", "/jobs", "/metrics", "/docs", "/nothing"])
def test_head_is_answered_like_get_without_the_body(client: httpx.Client, path: str) -> None:
    whole, head = client.get(path), client.head(path)
    assert (head.status_code, head.content) == (whole.status_code, b"")
    assert head.headers["Content-Type"] == whole.headers["Content-Type"]


def test_head_of_results_and_of_a_running_job_is_answered(client: httpx.Client, job: dict[str, Any]) -> None:
    key = orjson.loads(results(client, job, "*/*"))["results"][0]["result"]["key"]
    whole, head = client.get(f"/results/{key}"), client.head(f"/results/{key}")
    assert (head.headers["ETag"], head.headers["Content-Length"]) == (
        whole.headers["ETag"],
        whole.headers["Content-Length"],
    )
    assert client.head(f"/jobs/{job['id']}/results").status_code == 200
    slow = PAPER | {"numerics": {"method": "panels", "panels": 50_000}, "search": {"method": "outcome"}}
    axes = [{"field": "impact.velocity_m_s", "start": 300.0, "stop": 310.0, "count": 200}]
    running = client.post("/cra/sweep", json={"base": slow, "axes": axes}).json()
    assert client.head(f"/jobs/{running['id']}/events", timeout=5.0).status_code == 200
    assert client.head("/cra").status_code == 405
    client.delete(f"/jobs/{running['id']}")
