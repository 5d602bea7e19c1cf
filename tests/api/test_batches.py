"""Batches over HTTP: JSON and JSON lines in requests and answers, and refusals."""

import json
from typing import Any

import httpx
import pytest

from service.api.job_models import Job
from service.schemas.problems import Problem
from service.schemas.strike import PAPER

from .many import ASYNC, JSONL, LINES, TOO_SHORT, check_results, finished, items_of, lines, searches, strikes
from .refused import refused_at


@pytest.mark.parametrize("accept", ["application/json", JSONL])
@pytest.mark.parametrize("as_lines", [False, True])
def test_batch_answers_each_case_like_a_single_query(client: httpx.Client, accept: str, as_lines: bool) -> None:
    cases = searches(7)
    named = [case | {"custom_id": f"№ {number}"} if number % 2 else case for number, case in enumerate(cases)]
    body: dict[str, Any] = {"content": lines(named)} if as_lines else {"json": {"cases": named}}
    headers = {"Accept": accept} | (LINES if as_lines else {})
    response = client.post("/cra/batch", headers=headers, **body)
    assert response.headers["Content-Type"] == accept
    assert response.headers["Vary"] == "Prefer, Accept, Accept-Encoding"
    items = items_of(response)
    assert sorted(item["index"] for item in items) == list(range(7))
    for item in items:
        assert item.get("custom_id") == named[item["index"]].get("custom_id")
        alone = client.post("/cra", json=cases[item["index"]])
        assert alone.headers["Cache-Status"] == "ricochet; hit"
        assert alone.json() == item["result"]
    check_results("cra", items)


def test_json_answer_keeps_the_order_of_the_request_and_names_cache_hits(client: httpx.Client) -> None:
    cases = searches(5)
    first = client.post("/cra/batch", json={"cases": cases})
    second = client.post("/cra/batch", json={"cases": cases[::-1]})
    assert [item["index"] for item in items_of(first)] == [item["index"] for item in items_of(second)] == [*range(5)]
    assert [item["result"] for item in items_of(second)] == [item["result"] for item in items_of(first)][::-1]
    assert first.headers["Cache-Status"] == "ricochet; fwd=miss"
    assert second.headers["Cache-Status"] == "ricochet; hit"


def test_only_cases_that_request_a_history_get_one(client: httpx.Client) -> None:
    quiet, told = strikes(2)
    items = items_of(client.post("/trajectory/batch", json={"cases": [quiet, told | {"output": {"history": True}}]}))
    assert "history" not in items[0]["result"]
    assert items[1]["result"]["history"]["time_s"][0] == 0.0
    check_results("trajectory", items)
    alone = client.post("/trajectory", json=quiet | {"output": {"history": False}})
    assert alone.headers["Cache-Status"] == "ricochet; hit"
    assert alone.json() == items[0]["result"]


def test_line_refused_only_by_the_solver_is_a_result_with_a_problem(client: httpx.Client) -> None:
    items = items_of(client.post("/cra/batch", content=lines([*searches(1), TOO_SHORT]), headers=LINES))
    problem = Problem.model_validate(items[1]["problem"])
    assert (problem.type, problem.errors[0].pointer) == ("urn:ricochet:problem:invalid-request", "/projectile/length_m")


def test_up_to_a_hundred_invalid_cases_are_named(client: httpx.Client) -> None:
    missing = (f"/cases/1/{name}" for name in ("projectile", "target", "impact"))
    problem = refused_at(client.post("/cra/batch", json={"cases": [PAPER, {}]}), *missing)
    assert "(and more)" in problem.detail
    found = client.post("/cra/batch", json={"cases": [PAPER | {"extra": 1}] * 500}).json()
    assert len(found["errors"]) == 100


LINE = json.dumps(PAPER).encode()


@pytest.mark.parametrize("end", [b"", b"\n", b"\r\n"])
def test_line_ends_of_any_platform_are_accepted(client: httpx.Client, end: bytes) -> None:
    body = LINE + (end or b"\n") + LINE + end
    assert len(items_of(client.post("/cra/batch", content=body, headers=LINES))) == 2


def test_too_many_lines_are_refused(client: httpx.Client) -> None:
    body = (line for line in [LINE + b"\n"] * 200 + [b"{}\n" * 100_000])
    answer = client.post("/cra/batch", content=body, headers=LINES)
    refused_at(answer, "/200/projectile", "/200/target", "/200/impact")


def test_large_work_becomes_a_job_with_every_result(client: httpx.Client) -> None:
    cases = searches(150)
    response = client.post("/cra/batch", content=lines(cases), headers=LINES)
    assert response.status_code == 202
    assert response.headers["Location"] == response.json()["links"]["self"]
    assert int(response.headers["Retry-After"]) >= 1
    assert "Preference-Applied" not in response.headers
    job = Job.model_validate(response.json())
    assert (job.operation, job.counts.total) == ("cra", 150)
    assert finished(client, response.json())["status"] == "successful"
    results = items_of(client.get(f"/jobs/{job.id}/results", headers={"Accept": JSONL}))
    assert [item["index"] for item in results] == list(range(150))
    assert results[42]["result"] == client.post("/cra", json=cases[42]).json()


def test_respond_async_turns_a_small_batch_into_a_job(client: httpx.Client) -> None:
    response = client.post("/cra/batch", json={"cases": searches(1)}, headers=ASYNC)
    assert response.status_code == 202
    assert response.headers["Preference-Applied"] == "respond-async"
    assert finished(client, response.json())["counts"] == {"total": 1, "done": 1, "cached": 0, "failed": 0}


@pytest.mark.parametrize("accept", ["application/json", JSONL])
def test_client_that_waits_gets_results_instead_of_a_job(client: httpx.Client, accept: str) -> None:
    headers = [("Prefer", "Respond-Async"), ("Prefer", "wait=20"), ("Accept", accept)]
    response = client.post("/cra/batch", json={"cases": searches(3)}, headers=headers)
    assert response.headers["Preference-Applied"] == "respond-async, wait=20"
    assert [item["index"] for item in items_of(response)] == [0, 1, 2]
    assert client.get(response.headers["Content-Location"]).json()["results"]


def test_same_idempotency_key_and_body_give_the_same_job(client: httpx.Client) -> None:
    body, headers = lines(searches(2)), LINES | ASYNC | {"Idempotency-Key": "again and again"}
    first = client.post("/cra/batch", content=body, headers=headers)
    again = client.post("/cra/batch", content=body, headers=headers)
    assert first.json()["id"] == again.json()["id"]
    assert again.headers["Location"] == first.headers["Location"]
    refused_at(client.post("/cra/batch", content=body + lines(searches(1)), headers=headers))
    other = client.post(
        "/cra/sweep",
        json={"base": PAPER, "axes": [{"field": "impact.velocity_m_s", "values": [9.0]}]},
        headers=ASYNC | {"Idempotency-Key": "again and again"},
    )
    assert other.json()["type"] == "urn:ricochet:problem:idempotency-conflict"
