"""Jobs over HTTP: queue, progress, results in every format, events and cancellation."""

import csv
import io
import json
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import h5py
import httpx
import pytest

from service.api.job_models import Job, JobResults, Jobs
from service.schemas.strike import PAPER
from tests.conftest import RunService, Service, until

from .many import ASYNC, JSONL, LINES, TOO_SHORT, finished, items_of, lines, rows_at, searches, slow_strikes, strikes


@pytest.fixture(scope="module")
def job(client: httpx.Client) -> dict[str, Any]:
    """A finished job of 260 searches, one of which has a problem."""
    cases = [case | {"custom_id": f"case {number}"} for number, case in enumerate(searches(260))]
    cases[7] = TOO_SHORT
    return finished(client, client.post("/cra/batch", content=lines(cases), headers=LINES).json())


@pytest.fixture(scope="module")
def items(client: httpx.Client, job: dict[str, Any]) -> list[dict[str, Any]]:
    return items_of(client.get(job["links"]["results"], headers={"Accept": JSONL}))


def test_finished_job_has_times_and_counts(client: httpx.Client, job: dict[str, Any]) -> None:
    told = Job.model_validate(job)
    assert job["counts"] == {"total": 260, "done": 260, "cached": 0, "failed": 1}
    assert told.started is not None
    assert job["created"] <= job["started"] <= job["finished"] < job["expires"]
    assert "problem" not in job
    assert client.get("/jobs").json()["jobs"][0]["created"] >= job["created"]
    assert job in client.get("/jobs", params={"limit": 1000}).json()["jobs"]


def test_queued_job_reports_its_place_and_expected_end(client: httpx.Client) -> None:
    """A small job overtakes the large jobs of its owner, so its `Retry-After` does not include their time."""
    sent = [client.post("/trajectory/batch", json={"cases": slow_strikes(n)}, headers=ASYNC) for n in (400, 600, 2)]
    jobs = [answer.json() for answer in sent]
    try:
        large, largest, small = (job["queue"] for job in jobs)
        assert (large["jobs_ahead"], largest["jobs_ahead"], small["jobs_ahead"]) == (0, 1, 0)
        assert small["remaining_s"] < large["remaining_s"] < largest["remaining_s"]
        assert sent[2].headers["Retry-After"] == str(small["remaining_s"])
        place = client.get(jobs[1]["links"]["self"]).json()["queue"]
        assert place["jobs_ahead"] >= 1
        listed = {job["id"]: job for job in client.get("/jobs").json()["jobs"]}
        assert listed[jobs[1]["id"]]["queue"]["remaining_s"] >= 1
    finally:
        ended = [client.post(f"{job['links']['self']}/cancel").json() for job in jobs]
    assert all("queue" not in job for job in ended)


def test_pages_contain_every_result_once(
    client: httpx.Client, job: dict[str, Any], items: list[dict[str, Any]]
) -> None:
    found, cursor = [], ""
    while True:
        page = client.get(job["links"]["results"], params={"limit": 100, "cursor": cursor}).json()
        JobResults.model_validate(page)
        found += page["results"]
        if "next" not in page:
            break
        cursor = page["next"]
    assert found == items
    assert [item["index"] for item in found] == list(range(260))
    assert "problem" in found[7]
    usual = client.get(job["links"]["results"]).json()
    assert len(usual["results"]) == 200


def test_pages_of_jobs_contain_every_job_once(client: httpx.Client) -> None:
    """This holds even if jobs are submitted and deleted between the requests for two pages."""
    made = [client.post("/cra/batch", json={"cases": searches(1)}, headers=ASYNC).json()["id"] for _ in range(5)]
    page = client.get("/jobs", params={"limit": 2}).json()
    client.delete(f"/jobs/{made[3]}")
    client.post("/cra/batch", json={"cases": searches(1)}, headers=ASYNC)
    found = page["jobs"]
    while "next" in page:
        page = client.get("/jobs", params={"limit": 2, "cursor": page["next"]}).json()
        Jobs.model_validate(page)
        assert len(page["jobs"]) == 2 or "next" not in page
        found += page["jobs"]
    ids = [job["id"] for job in found]
    assert ids[:5] == made[::-1]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("cursor", ["x", "!", "MQ==", "LTE", "999", "MTAwMDAwMDAwMDAwMA", "MDE", "\u00e9"])
def test_malformed_cursor_is_refused(client: httpx.Client, job: dict[str, Any], cursor: str) -> None:
    assert client.get(job["links"]["results"], params={"cursor": cursor}).status_code == 422
    assert client.get("/jobs", params={"cursor": cursor}).status_code == 422


@pytest.mark.parametrize("limit", ["0", "1001", "-1", "x"])
def test_limit_out_of_range_is_refused(client: httpx.Client, job: dict[str, Any], limit: str) -> None:
    assert client.get(job["links"]["results"], params={"limit": limit}).status_code == 422
    assert client.get("/jobs", params={"limit": limit}).status_code == 422


def test_lines_and_tables_start_at_the_cursor(
    client: httpx.Client, job: dict[str, Any], items: list[dict[str, Any]]
) -> None:
    cursor = client.get(job["links"]["results"], params={"limit": 250}).json()["next"]
    page = {"cursor": cursor}
    assert items_of(client.get(job["links"]["results"], params=page, headers={"Accept": JSONL})) == items[250:]
    some = client.get(job["links"]["results"], params=page | {"limit": "3"}, headers={"Accept": JSONL})
    assert items_of(some) == items[250:253]


def test_table_has_one_row_per_case(client: httpx.Client, job: dict[str, Any], items: list[dict[str, Any]]) -> None:
    response = client.get(job["links"]["results"], headers={"Accept": "text/csv"})
    assert response.headers["Content-Type"] == "text/csv; charset=utf-8"
    rows = list(csv.DictReader(io.StringIO(response.text)))
    assert len(rows) == 260
    row, result = rows[3], items[3]["result"]
    assert (row["index"], row["custom_id"], row["key"], row["status"]) == (
        "3",
        "case 3",
        result["key"],
        result["status"],
    )
    assert float(row["critical_angle_deg"]) == result["critical_angle_deg"]
    assert [float(row["bracket_low_deg"]), float(row["bracket_high_deg"])] == result["bracket_deg"]
    assert row["warnings"].split() == [warning["code"] for warning in result["warnings"]]
    assert (rows[7]["key"], rows[7]["problem"]) == ("", "urn:ricochet:problem:invalid-request")


COMPUTED_BY_SPREADSHEETS = ["=1+1", "+A1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "\uff1d1"]


def test_only_tables_quote_texts_that_a_spreadsheet_would_evaluate(client: httpx.Client) -> None:
    names = [*COMPUTED_BY_SPREADSHEETS, "a=1", "'=1"]
    cases = [case | {"custom_id": name} for case, name in zip(strikes(len(names)), names, strict=True)]
    at_once = client.post("/trajectory/batch", json={"cases": cases}, headers={"Accept": "text/csv"})
    job = finished(client, client.post("/trajectory/batch", json={"cases": cases}, headers=ASYNC).json())
    at_once_rows = list(csv.DictReader(io.StringIO(at_once.text, newline="")))
    items = client.get(job["links"]["results"]).json()["results"]
    assert [item["custom_id"] for item in items] == names
    for rows in (at_once_rows, rows_at(client, job["links"]["results"])):
        assert [row["custom_id"] for row in rows] == [f"'{name}" for name in COMPUTED_BY_SPREADSHEETS] + names[-2:]
        velocities = [row["final_depth_velocity_m_s"] for row in rows]
        assert list(map(float, velocities)) == [item["result"]["final"]["depth_velocity_m_s"] for item in items]
        assert any(velocity.startswith("-") for velocity in velocities)


def test_table_of_trajectories_has_their_final_states(client: httpx.Client) -> None:
    job = finished(client, client.post("/trajectory/batch", json={"cases": strikes(2)}, headers=ASYNC).json())
    row = rows_at(client, job["links"]["results"])[1]
    result = client.get(job["links"]["results"]).json()["results"][1]["result"]
    assert {name: float(row[f"final_{name}"]) for name in result["final"]} == result["final"]
    assert (row["outcome"], float(row["maximum_depth_m"])) == (result["outcome"], result["maximum_depth_m"])


def test_hdf5_file_of_a_job_can_be_read(client: httpx.Client, job: dict[str, Any], items: list[dict[str, Any]]) -> None:
    response = client.get(job["links"]["results"], headers={"Accept": "application/x-hdf5"})
    assert response.headers["Content-Type"] == "application/x-hdf5"
    assert int(response.headers["Content-Length"]) == len(response.content)
    with h5py.File(io.BytesIO(response.content)) as file:
        angles = file["summary/critical_angle_deg"][()]
        assert len(angles) == 260
        assert angles[3] == items[3]["result"]["critical_angle_deg"]


def test_unsupported_format_is_not_acceptable(client: httpx.Client, job: dict[str, Any]) -> None:
    assert client.get(job["links"]["results"], headers={"Accept": "text/html"}).status_code == 406


def events_of(response: httpx.Response) -> list[tuple[int, dict[str, Any]]]:
    blocks = [
        dict(line.split(": ", 1) for line in block.splitlines()) for block in response.text.split("\n\n") if block
    ]
    return [(int(block["id"]), json.loads(block["data"])) for block in blocks if "data" in block]


def test_events_report_a_job_until_it_ends(client: httpx.Client) -> None:
    job = client.post("/cra/batch", json={"cases": searches(200)}).json()
    response = client.get(job["links"]["events"])
    assert response.headers["Content-Type"].startswith("text/event-stream")
    events = events_of(response)
    revisions = [revision for revision, _ in events]
    assert revisions == sorted(set(revisions))
    done = [state["counts"]["done"] for _, state in events]
    assert done == sorted(done)
    assert events[-1][1]["status"] == "successful"
    assert done[-1] == 200
    resumed = events_of(client.get(job["links"]["events"], headers={"Last-Event-ID": str(revisions[-1])}))
    assert resumed == events[-1:]


def test_events_already_received_are_not_sent_again(client: httpx.Client) -> None:
    job = client.post("/trajectory/batch", json={"cases": slow_strikes(12)}, headers=ASYNC).json()
    with client.stream("GET", job["links"]["events"]) as response:
        seen = next(line for line in response.iter_lines() if line.startswith("id: ")).removeprefix("id: ")
    events = events_of(client.get(job["links"]["events"], headers={"Last-Event-ID": seen}))
    assert min(revision for revision, _ in events) > int(seen)
    assert events[-1][1]["status"] == "successful"


def test_event_streams_of_an_address_are_limited_and_a_stop_does_not_wait_for_them(
    service_on: RunService, tmp_path: Path
) -> None:
    """The service stops without an error while a job is running and its events are being read."""
    with service_on(tmp_path, max_owner_streams="2", max_streams="3") as service, ExitStack() as opened:
        one, other = (
            opened.enter_context(
                httpx.Client(base_url=service.url, transport=httpx.HTTPTransport(local_address=address), timeout=60.0)
            )
            for address in ("127.0.0.1", "127.0.0.2")
        )
        job = one.post("/trajectory/batch", json={"cases": slow_strikes(200)}, headers=ASYNC).json()
        path = job["links"]["events"]
        for client in (one, one, other):
            if client is other:
                assert one.get(path).status_code == 429
            assert opened.enter_context(client.stream("GET", path)).status_code == 200
        assert other.get(path).status_code == 503
        service.process.terminate()
        assert service.process.wait(5.0) == 0


@pytest.mark.slow
def test_event_stream_of_an_unchanged_job_is_kept_alive(dedicated_service: Service) -> None:
    """The service sends a comment every 15 s, because proxies close idle connections."""
    numerics = {"method": "panels", "panels": 96_000, "time_step_s": 1e-6}
    with httpx.Client(base_url=dedicated_service.url, timeout=20.0, trust_env=False) as client:
        case = PAPER | {"numerics": numerics, "search": {"method": "outcome"}}
        job = client.post("/cra/batch", json={"cases": [case]}, headers=ASYNC).json()
        with client.stream("GET", job["links"]["events"]) as events:
            assert next(line for line in events.iter_lines() if line.startswith(":"))
        client.delete(job["links"]["self"])


def test_cancelled_job_keeps_its_results(client: httpx.Client) -> None:
    job = client.post("/trajectory/batch", json={"cases": slow_strikes(60)}, headers=ASYNC).json()
    until(lambda: bool(client.get(job["links"]["self"]).json()["counts"]["done"]))
    ended = client.post(job["links"]["cancel"])
    assert (ended.status_code, ended.json()["status"]) == (200, "dismissed")
    assert client.post(job["links"]["cancel"]).json() == ended.json() == client.get(job["links"]["self"]).json()
    page = client.get(job["links"]["results"]).json()
    assert len(page["results"]) == ended.json()["counts"]["done"] < 60
    assert "next" not in page
    assert events_of(client.get(job["links"]["events"]))[-1][1]["status"] == "dismissed"


def test_results_can_be_read_while_the_job_runs(client: httpx.Client) -> None:
    job = client.post("/trajectory/batch", json={"cases": slow_strikes(10)}, headers=ASYNC).json()
    found, cursor = [], ""
    while True:
        page = client.get(job["links"]["results"], params={"cursor": cursor, "limit": 3}).json()
        found += [item["index"] for item in page["results"]]
        if "next" not in page:
            break
        cursor = page["next"]
        time.sleep(0.02)
    assert found == list(range(10))


def test_deleting_a_job_leaves_its_results_in_the_cache(client: httpx.Client) -> None:
    cases = searches(2)
    job = finished(client, client.post("/cra/batch", json={"cases": cases}, headers=ASYNC).json())
    deleted = client.delete(job["links"]["self"])
    assert (deleted.status_code, deleted.content) == (204, b"")
    for path in job["links"].values():
        answer = client.post(path) if path.endswith("cancel") else client.get(path)
        assert answer.status_code == 404
        assert answer.headers["Content-Type"] == "application/problem+json"
    assert client.delete(job["links"]["self"]).status_code == 404
    assert client.post("/cra", json=cases[0]).headers["Cache-Status"] == "ricochet; hit"


@pytest.mark.timeout(120)
def test_job_deleted_during_a_change_is_not_found(client: httpx.Client) -> None:
    body = {"base": PAPER, "axes": [{"field": "impact.velocity_m_s", "values": [230.0]}]}
    found = set()
    with ThreadPoolExecutor() as pool:
        for _ in range(40):
            path = client.post("/cra/sweep", json=body, headers=ASYNC).json()["links"]["self"]
            changes = [pool.submit(client.patch, path, json={"title": f"{n}"}) for n in range(4)]
            deleted = client.delete(path)
            found |= {deleted.status_code, *(change.result().status_code for change in changes)}
    assert found <= {200, 204, 404}, found


def test_title_of_a_sweep_is_changed_by_patch(client: httpx.Client) -> None:
    axes = [{"field": "impact.velocity_m_s", "values": [238.0, 300.0]}]
    job = client.post("/cra/sweep", json={"base": PAPER, "axes": axes}, headers=ASYNC).json()
    path = f"/jobs/{job['id']}"
    assert job["title"] == "speed, 80 mm, 13 kg"
    assert client.patch(path, json={"title": " North wall "}).json()["title"] == "North wall"
    assert client.get(path).json()["title"] == "North wall"
    hidden = "\x1b[31m\u202eNor\u2066th\r\n \x85wa\u200ell\u061c\u2028\x7f"
    assert client.patch(path, json={"title": hidden}).json()["title"] == "[31mNorth wall"
    joined = "Wand \u05d0\u200d\u05d1"
    assert client.patch(path, json={"title": joined}).json()["title"] == joined
    assert client.patch(path, json={"title": " North wall "}).status_code == 200
    for body, pointer in (
        ({"title": ""}, "/title"),
        ({"title": "\u202e \n"}, "/title"),
        ({"title": "x" * 201}, "/title"),
        ({}, "/title"),
        ({"id": "1"}, "/id"),
    ):
        refused = client.patch(path, json=body)
        assert refused.status_code == 422
        assert pointer in {error["pointer"] for error in refused.json()["errors"]}
    assert client.patch(f"/jobs/{'0' * 32}", json={"title": "North wall"}).status_code == 404
