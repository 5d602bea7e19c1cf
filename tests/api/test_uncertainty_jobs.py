"""Studies of uncertainty as jobs: progress, intermediate answers, result and cancellation."""

import json
from typing import Any

import httpx

from service.api.job_models import Job

from .many import ASYNC, SPEED, file_at, finished, rows_at
from .test_uncertainty import ATTACK, BODY, STRIKE

LONG = BODY | {
    "uncertain": [SPEED, ATTACK],
    "sensitivity": False,
    "sampling": {"half_width": 0.0001, "max_samples": 131_072, "method": "direct", "seed": 11},
}
"""A study that takes minutes."""


def seeded(body: dict[str, Any], seed: int, **sampling: Any) -> dict[str, Any]:
    return body | {"sampling": body["sampling"] | {"seed": seed} | sampling}


def test_answer_of_a_job_equals_the_immediate_answer(client: httpx.Client) -> None:
    body = seeded(BODY, 21)
    response = client.post("/cra/uncertainty", json=body, headers=ASYNC)
    assert response.status_code == 202, response.text
    assert response.headers["Location"] == response.json()["links"]["self"]
    job = finished(client, response.json())
    Job.model_validate(job)
    assert job["status"] == "successful"
    [item] = client.get(job["links"]["results"]).json()["results"]
    stored = client.get(f"/results/{item['result']['key']}")
    assert stored.json() == item["result"]
    assert job["progress"] == {
        "samples": item["result"]["samples"],
        "max_samples": 4096,
        "half_width": item["result"]["convergence"]["half_width"][-1],
        "requested_half_width": 0.03,
    }
    assert "partial" not in job
    assert job["request"]["uncertain"] == body["uncertain"]
    assert job["request"]["sampling"] == body["sampling"] | {"method": "auto"}
    again = client.post("/cra/uncertainty", json=job["request"])
    assert again.json()["key"] == item["result"]["key"]
    at_once = client.post("/cra/uncertainty", json=body)
    assert at_once.status_code == 200
    assert at_once.content == stored.content


def test_result_of_a_job_is_available_as_table_and_file(client: httpx.Client) -> None:
    job = finished(client, client.post("/trajectory/uncertainty", json=seeded(STRIKE, 22), headers=ASYNC).json())
    [item] = client.get(job["links"]["results"]).json()["results"]
    answer = item["result"]
    shares = {each["outcome"]: each["value"] for each in answer["outcomes"]}
    [row] = rows_at(client, job["links"]["results"])
    assert float(row["ricochet"]) == shares["ricochet"]
    with file_at(client, job["links"]["results"]) as file:
        assert file["summary"]["samples"][()].tolist() == [answer["samples"]]
    table = client.get(f"/results/{answer['key']}", headers={"Accept": "text/csv"}).text
    assert table.startswith("quantity,level,value,lower,upper")


def test_client_that_waits_gets_the_answer(client: httpx.Client) -> None:
    body = seeded(STRIKE, 23)
    response = client.post("/trajectory/uncertainty", json=body, headers={"Prefer": "respond-async, wait=25"})
    assert response.status_code == 200, response.text
    assert response.headers["Content-Location"] == f"/results/{response.json()['key']}"
    assert client.post("/trajectory/uncertainty", json=body).content == response.content


def test_running_study_shows_progress_and_the_curve_so_far(client: httpx.Client) -> None:
    response = client.post("/cra/uncertainty", json=LONG)
    assert response.status_code == 202, response.text
    job = response.json()
    reached: list[dict[str, Any]] = []
    state: dict[str, Any] = {}
    with client.stream("GET", job["links"]["events"]) as events:
        for line in events.iter_lines():
            if not line.startswith("data:"):
                continue
            state = json.loads(line.removeprefix("data:"))
            Job.model_validate(state)
            if "progress" in state:
                reached.append(state["progress"])
            if "partial" in state:
                break
    assert [each["samples"] for each in reached] == sorted(each["samples"] for each in reached)
    assert 256 <= reached[-1]["samples"] < reached[-1]["max_samples"] == 131_072
    assert reached[-1]["requested_half_width"] == 0.0001 < reached[-1]["half_width"]
    curve = state["partial"]["probability"]
    assert len(curve["lower"]) == len(curve["oblique_angle_deg"]) == 81
    assert curve["ricochet_probability"][0] < 0.1
    assert curve["ricochet_probability"][-1] > 0.9
    assert client.get(job["links"]["self"]).json()["partial"]["convergence"]["samples"][0] == 256
    ended = client.post(job["links"]["cancel"]).json()
    assert ended["status"] == "dismissed"
    assert client.get(job["links"]["results"]).json() == {"results": []}
    assert "partial" in client.get(job["links"]["self"]).json()
    assert client.delete(job["links"]["self"]).status_code == 204
    assert client.get(job["links"]["self"]).status_code == 404


def test_study_with_contradictory_inputs_does_not_become_a_job(client: httpx.Client) -> None:
    before = client.get("/jobs").json()
    response = client.post("/cra/uncertainty", json=BODY | {"uncertain": [SPEED, SPEED]}, headers=ASYNC)
    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"] == "/uncertain/1/field"
    assert client.get("/jobs").json() == before


def test_same_idempotency_key_gives_the_same_job(client: httpx.Client) -> None:
    headers = ASYNC | {"Idempotency-Key": "study"}
    body = seeded(STRIKE, 24)
    first, again = (client.post("/trajectory/uncertainty", json=body, headers=headers).json() for _ in range(2))
    assert first["id"] == again["id"]
    other = client.post("/trajectory/uncertainty", json=seeded(STRIKE, 25), headers=headers)
    assert other.status_code == 422
