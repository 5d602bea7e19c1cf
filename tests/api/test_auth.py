"""Access control: keys, scopes, owners, quotas and the audit log."""

import json
import os
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from service import cli
from service.api.app import create_app
from service.auth.api_keys import ApiKey, ApiKeyStore, KeysUnreadableError, add_key, make_key, read_keys, revoke_key
from service.auth.dependencies import RequestContext
from service.auth.quotas import STEP, WINDOW, Quota, QuotaStore
from service.cli.arguments import CommandError
from service.cli.serve import check_access
from service.clock import Clock, ClockWatch
from service.errors import (
    PoolUnavailableError,
    QueriesWaitingError,
    QuotaError,
    QuotaTooSmallError,
    TaskTimeoutError,
    WorkerCrashedError,
)
from service.jobs.store import JobStore
from service.schemas.strike import PAPER, PAPER_AT_45
from service.settings import Settings
from solver import ParameterError
from tests.conftest import ROOT, RunService, until

from .attacks import Target
from .many import ASYNC, LINES, ROUGH, SPEED, finished, lines, searches, slow_strikes
from .owners import Guarded, bearer, guarded_service, holder, is_known, key_in
from .refused import problem_of

START_SECONDS = 60.0


@pytest.fixture(scope="module")
def guarded(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    folder = tmp_path_factory.mktemp("guarded")
    first = key_in(folder / "data", "first")
    settings = {"audit_log": str(folder / "audit.log"), "max_owner_streams": "3", "max_streams": "4"}
    with service_on(folder, **settings) as service, guarded_service(service.url, folder / "data") as keyed:
        yield keyed
    assert first not in (folder / "log").read_text() + (folder / "audit.log").read_text()


def job_of(client: httpx.Client, count: int = 3, **headers: str) -> dict[str, Any]:
    answer = client.post("/cra/batch", content=lines(searches(count)), headers=LINES | ASYNC | headers)
    assert answer.status_code == 202, answer.text
    job: dict[str, Any] = answer.json()
    return job


def test_key_gives_access_to_protected_paths(guarded: Guarded) -> None:
    with holder(guarded.url) as nobody:
        for path in ("/jobs", "/results/" + "0" * 64, "/metrics", "/nothing"):
            found = nobody.get(path)
            problem_of(found, 401)
            assert found.headers["WWW-Authenticate"].startswith("Bearer")
        problem_of(nobody.post("/cra", json=PAPER), 401)
        for path in ("/livez", "/readyz", "/version", "/docs", "/openapi.json"):
            assert nobody.get(path).status_code == 200, path
    assert guarded.anna.post("/cra", json=PAPER).status_code == 200
    assert guarded.anna.get("/metrics").status_code == 200


def test_cached_query_requires_a_key_too(guarded: Guarded) -> None:
    body = {"content": json.dumps(PAPER), "headers": {"Content-Type": "application/json"}}
    assert [guarded.anna.post("/cra", **body).status_code for _ in range(3)] == [200] * 3  # type: ignore[arg-type]
    with holder(guarded.url) as nobody:
        problem_of(nobody.post("/cra", **body), 401)  # type: ignore[arg-type]


def test_job_of_another_owner_is_not_found(guarded: Guarded) -> None:
    job = job_of(guarded.anna)
    path = job["links"]["self"]
    for end in ("", "/results", "/events"):
        refused = guarded.bert.get(path + end)
        assert problem_of(refused, 404).detail == problem_of(guarded.bert.get(f"/jobs/nothing{end}"), 404).detail
    problem_of(guarded.bert.post(f"{path}/cancel"), 404)
    problem_of(guarded.bert.delete(path), 404)
    assert job["id"] not in {each["id"] for each in guarded.bert.get("/jobs").json()["jobs"]}
    assert job["id"] in {each["id"] for each in guarded.anna.get("/jobs").json()["jobs"]}
    assert finished(guarded.anna, job)["status"] == "successful"
    assert guarded.anna.get(path + "/results").status_code == 200


def test_admin_sees_and_cancels_the_jobs_of_all_owners(guarded: Guarded) -> None:
    jobs = [job_of(guarded.anna), job_of(guarded.bert)]
    seen = {job["id"] for job in guarded.chief.get("/jobs").json()["jobs"]}
    assert {job["id"] for job in jobs} <= seen
    for job in jobs:
        assert guarded.chief.get(job["links"]["self"]).status_code == 200
        assert guarded.chief.delete(job["links"]["self"]).status_code == 204
    problem_of(guarded.anna.get(jobs[0]["links"]["self"]), 404)


def test_keys_of_one_owner_share_the_jobs(guarded: Guarded) -> None:
    job = job_of(guarded.anna)
    with guarded.with_key("anna", "read") as other:
        assert other.get(job["links"]["self"]).status_code == 200


def test_idempotency_key_belongs_to_its_owner(guarded: Guarded) -> None:
    body, headers = lines(searches(2)), LINES | ASYNC | {"Idempotency-Key": "the same"}
    first, again, others = (
        client.post("/cra/batch", content=body, headers=headers).json()["id"]
        for client in (guarded.anna, guarded.anna, guarded.bert)
    )
    assert first == again != others


def test_key_permits_only_what_its_scopes_allow(guarded: Guarded) -> None:
    with guarded.with_key("reader", "read") as reader, guarded.with_key("runner", "run") as runner:
        assert reader.get("/jobs").status_code == 200
        assert "`run`" in problem_of(reader.post("/cra", json=PAPER), 403).detail
        answer = runner.post("/cra", json=PAPER)
        assert answer.status_code == 200
        assert "`read`" in problem_of(runner.get("/results/" + answer.json()["key"]), 403).detail
        assert reader.get("/results/" + answer.json()["key"]).status_code == 200


def test_revoked_key_is_refused_at_once(guarded: Guarded) -> None:
    with guarded.with_key("dora") as dora:
        assert dora.get("/jobs").status_code == 200
        (mine,) = [key for key in read_keys(guarded.folder).values() if key.owner == "dora"]
        job = job_of(dora, 1)
        revoke_key(guarded.folder, mine.id)
        until(lambda: not is_known(dora))
        problem_of(dora.get("/jobs"), 401)
        problem_of(dora.get(job["links"]["self"]), 401)


def test_event_stream_ends_when_its_key_is_revoked(guarded: Guarded) -> None:
    with guarded.with_key("emil") as emil:
        (mine,) = [key for key in read_keys(guarded.folder).values() if key.owner == "emil"]
        body = lines(slow_strikes(200))
        job = emil.post("/trajectory/batch", content=body, headers=LINES | ASYNC).json()
        with emil.stream("GET", job["links"]["events"]) as stream:
            events = stream.iter_lines()
            assert next(events)
            revoke_key(guarded.folder, mine.id)
            for _ in events:
                pass  # The stream ends although the job has not ended.
        assert guarded.chief.get(job["links"]["self"]).json()["status"] == "running"
        guarded.chief.delete(job["links"]["self"])


def test_expired_key_is_refused(guarded: Guarded) -> None:
    with guarded.with_key("fred", days=1e-5) as fred:  # This is about 0.9 s.
        until(lambda: not is_known(fred))
        problem_of(fred.get("/jobs"), 401)


def test_cases_per_hour_of_a_key_are_limited(guarded: Guarded) -> None:
    with guarded.with_key("gina", cases_per_hour=10) as gina:
        assert gina.post("/cra/batch", json={"cases": searches(6)}).status_code == 200
        answer = gina.post("/cra/batch", json={"cases": searches(5)})
        assert problem_of(answer, 429).type == "urn:ricochet:problem:quota"
        assert WINDOW - STEP <= int(answer.headers["Retry-After"]) <= WINDOW + STEP
        problem_of(gina.post("/cra/batch", content=lines(searches(5)), headers=LINES | ASYNC), 429)
        known = {"content": json.dumps(PAPER | {"search": ROUGH}), "headers": {"Content-Type": "application/json"}}
        statuses = [gina.post("/cra", **known).status_code for _ in range(6)]  # type: ignore[arg-type]
        assert statuses == [200] * 4 + [429] * 2  # Refused requests do not count, cached answers do.
        assert gina.get("/jobs").json() == {"jobs": []}
        assert guarded.anna.post("/cra", json=PAPER).status_code == 200


def test_panel_steps_count_as_cases_in_the_quota(guarded: Guarded) -> None:
    """1,000 panels for 50,000 steps count as 50 ordinary cases, in a query, a batch, a sweep and over UM-Bridge."""
    numerics = {"method": "panels", "panels": 1000, "time_step_s": 1e-6, "termination_time_s": 0.05}
    strike = PAPER_AT_45 | {"numerics": numerics, "output": {"history": False}}
    scattered = PAPER_AT_45 | {"numerics": numerics, "uncertain": [SPEED]}
    call = {"name": "trajectory", "input": [[238.0, 39.0]], "config": {"numerics": numerics}}
    bodies = {
        "/trajectory": strike,
        "/trajectory/batch": {"cases": [strike]},
        "/trajectory/sweep": {"base": strike, "axes": [{"field": "impact.velocity_m_s", "values": [240.0]}]},
        "/umbridge/Evaluate": call,
    }
    for number, (path, body) in enumerate(bodies.items()):
        with guarded.with_key(f"hilda {number}", cases_per_hour=99) as hilda:
            statuses = [hilda.post(path, json=body).status_code for _ in range(2)]
            assert (path, statuses) == (path, [200, 429])
    with guarded.with_key("ida", cases_per_hour=300) as ida:
        for headers in ({}, ASYNC):
            problem_of(ida.post("/trajectory/uncertainty", json=scattered, headers=headers), 403)


def test_studies_of_a_sweep_count_as_their_most_samples(guarded: Guarded) -> None:
    """The samples are charged when the sweep is accepted, even if its studies end with fewer."""

    def submit(client: httpx.Client, *speeds: float, headers: dict[str, str] | None = None) -> httpx.Response:
        base = PAPER_AT_45 | {"uncertain": [SPEED], "sampling": {"max_samples": 300, "half_width": 0.5}}
        axes = [{"field": "impact.velocity_m_s", "values": list(speeds)}]
        return client.post("/trajectory/uncertainty/sweep", json={"base": base, "axes": axes}, headers=headers)

    with guarded.with_key("jana", cases_per_hour=1000) as jana:
        problem_of(submit(jana, 201.0, 202.0, 203.0, 204.0, headers=ASYNC), 403)
        [item] = submit(jana, 201.0).json()["results"]
        assert item["result"]["samples"] == 256
        problem_of(submit(jana, 202.0, 203.0, 204.0), 429)
        job = submit(jana, 202.0, 203.0, headers=ASYNC)
        assert finished(jana, job.json())["status"] == "successful"
        problem_of(submit(jana, 204.0), 429)  # The quota of 1,000 has 100 left.


class SetClock:
    """A clock that shows the time set by a test."""

    def __init__(self) -> None:
        self.date, self.passed = 1.8e9, 1000.0
        self.clock = Clock(now=lambda: self.date, monotonic=lambda: self.passed)


@pytest.mark.parametrize("jump", [-7200.0, 7200.0])
def test_setting_the_clock_does_not_change_a_quota(jump: float, tmp_path: Path) -> None:
    key_in(tmp_path, "anna")
    machine = SetClock()
    quota = QuotaStore(tmp_path, machine.clock).quota("5f0c21d9", 10)
    quota.take(10)
    machine.date += jump
    with pytest.raises(QuotaError) as refused:
        quota.take(1)
    assert WINDOW - STEP <= refused.value.retry_after <= WINDOW + STEP
    machine.passed += WINDOW + STEP
    quota.take(10)


def test_key_expires_by_the_date_and_not_by_elapsed_time(tmp_path: Path) -> None:
    machine = SetClock()
    key, token = make_key("anna", frozenset({"read"}))
    add_key(tmp_path, replace(key, expires=machine.date + 86_400.0))
    store = ApiKeyStore(tmp_path, print, machine.clock)
    machine.passed += 30 * 86_400.0
    assert store.find(token) is not None
    machine.date += 86_401.0
    assert store.find(token) is None


@pytest.mark.parametrize(("jump", "words"), [(7200.0, "forward by 7200 s"), (-90.0, "back by 90 s"), (5.0, "")])
def test_jump_of_the_clock_is_logged_once(jump: float, words: str, caplog: pytest.LogCaptureFixture) -> None:
    machine = SetClock()
    watch = ClockWatch(machine.clock)
    for _ in range(3):
        machine.date += 60.0
        machine.passed += 60.0
        watch.compare()
    assert caplog.text == ""
    machine.date += jump
    for _ in range(3):
        watch.compare()
    assert len(caplog.records) == bool(words)
    assert words in caplog.text


def test_refused_query_does_not_count_in_the_quota(guarded: Guarded) -> None:
    short = PAPER["projectile"] | {"length_m": 0.1}  # The body is shorter than its nose, which only a worker detects.
    call = {"name": "cra", "input": [[238.0, 39.0]], "config": {"projectile": short}}
    with guarded.with_key("gwen", cases_per_hour=2) as gwen:
        for _ in range(3):
            assert problem_of(gwen.post("/cra", json=PAPER | {"projectile": short}), 422).errors
            assert gwen.post("/umbridge/Evaluate", json=call).status_code == 400
        assert [gwen.post("/cra", json=PAPER).status_code for _ in range(3)] == [200, 200, 429]


@pytest.mark.parametrize(
    ("error", "counted"),
    [
        (QueriesWaitingError(7), 0),
        (PoolUnavailableError(), 0),
        (ParameterError("mass", "above 0"), 0),
        (TaskTimeoutError(), 3),
        (WorkerCrashedError(), 3),
    ],
    ids=lambda value: type(value).__name__,
)
def test_cases_count_in_the_quota_unless_they_are_refused(error: Exception, counted: int, tmp_path: Path) -> None:
    key, token = make_key("anna", frozenset({"run"}), cases_per_hour=10)
    add_key(tmp_path, key)
    context = RequestContext(ApiKeyStore(tmp_path, print), quotas := QuotaStore(tmp_path), key_required=True)
    context.authorize(token, ["run"])
    context.take(1)
    with pytest.raises(type(error)), context.taking(3):
        raise error
    assert context.cases == 1 + counted
    assert sum(cases for _, cases in quotas.quota(key.id, 10).entries) == 1 + counted


def study(**sampling: Any) -> dict[str, Any]:
    return PAPER | {"uncertain": [SPEED], "sensitivity": False, "sampling": sampling}


def test_ended_study_counts_only_the_samples_it_took(guarded: Guarded) -> None:
    def submit(client: httpx.Client, **sampling: Any) -> httpx.Response:
        return client.post("/cra/uncertainty", json=study(**sampling), headers=ASYNC)

    with guarded.with_key("iris", cases_per_hour=2000) as iris:
        first = submit(iris, max_samples=1900, half_width=0.02)
        assert first.status_code == 202, first.text
        problem_of(submit(iris, max_samples=1900, half_width=0.2), 429)
        job = finished(iris, first.json())
        assert job["progress"]["samples"] == 256
        again = submit(iris, max_samples=1744, half_width=0.02)  # The quota is 2,000; 256 samples have been counted.
        problem_of(iris.post("/cra", json=PAPER), 429)
        assert finished(iris, again.json())["progress"]["samples"] == 256
        same = submit(iris, max_samples=1400, half_width=0.02)  # Now 512 samples have been counted.
        assert finished(iris, same.json())["status"] == "successful"
        endless = submit(iris, max_samples=1200, half_width=1e-4, method="direct", seed=5)
        assert endless.status_code == 202
        problem_of(submit(iris, max_samples=900), 429)
        taken = iris.post(endless.json()["links"]["cancel"]).json().get("progress", {"samples": 1})["samples"]
        assert submit(iris, max_samples=2000 - 3 * 256 - taken, half_width=0.02).status_code == 202


def test_job_cancelled_after_a_restart_frees_its_quota(tmp_path: Path) -> None:
    token = key_in(tmp_path, "anna", cases_per_hour=5000)
    settings = Settings(data_dir=tmp_path, executor="in-process")
    body = study(max_samples=5000, half_width=1e-4, method="direct")
    with TestClient(create_app(settings), headers=bearer(token)) as anna:
        job = anna.post("/cra/uncertainty", json=body, headers=ASYNC).json()
    with TestClient(create_app(settings), headers=bearer(token)) as anna:
        assert anna.post("/cra", json=PAPER).status_code == 429
        assert anna.post(job["links"]["cancel"]).json()["status"] == "dismissed"
        assert anna.post("/cra", json=PAPER).status_code == 200


def test_repeated_request_with_an_idempotency_key_counts_once(guarded: Guarded) -> None:
    with guarded.with_key("hans", cases_per_hour=8) as hans:
        body, headers = lines(searches(4)), LINES | ASYNC | {"Idempotency-Key": "once"}
        assert [hans.post("/cra/batch", content=body, headers=headers).status_code for _ in range(2)] == [202] * 2
        assert hans.post("/cra/batch", json={"cases": searches(4)}).status_code == 200
        problem_of(hans.post("/cra", json=PAPER), 429)


def audited(log: Path, request_id: str) -> str:
    """Wait until the audit log has the line of a request, which is written after the answer; return the log."""
    until(lambda: log.exists() and request_id in log.read_text())
    return log.read_text()


def test_audit_log_records_owner_request_and_result(guarded: Guarded) -> None:
    log = guarded.folder.parent / "audit.log"
    job = job_of(guarded.anna, 4, **{"X-Request-ID": "audited-job"})
    guarded.bert.post(f"{job['links']['self']}/cancel", headers={"X-Request-ID": "audited-cancel"})
    with holder(guarded.url) as nobody:
        nobody.post("/cra", json=PAPER, headers={"X-Request-ID": "audited-nobody"})
    found = {line["request_id"]: line for line in map(json.loads, audited(log, "audited-nobody").splitlines())}
    made = found["audited-job"]
    (key,) = [key for key in read_keys(guarded.folder).values() if key.owner == "anna" and "run" in key.scopes]
    assert made | {"timestamp": ...} == {
        "event": "audit",
        "timestamp": ...,
        "request_id": "audited-job",
        "owner": "anna",
        "key": key.id,
        "client": "127.0.0.1",
        "method": "POST",
        "route": "/cra/batch",
        "cases": 4,
        "job": job["id"],
        "status": 202,
    }
    assert (found["audited-cancel"]["owner"], found["audited-cancel"]["status"]) == ("bert", 404)
    assert "owner" not in found["audited-nobody"]
    assert found["audited-nobody"]["status"] == 401
    assert stat.S_IMODE(log.stat().st_mode) == 0o600


def test_audit_log_names_the_owner_whose_key_lacks_a_scope(guarded: Guarded) -> None:
    log = guarded.folder.parent / "audit.log"
    requests = [("POST", "/cra"), ("POST", "/cra/batch"), ("DELETE", "/jobs/1"), ("POST", "/mcp"), ("POST", "/nothing")]
    with guarded.with_key("carl", "read") as reads:
        token = reads.headers["Authorization"].removeprefix("Bearer ")
        for number, (method, path) in enumerate(requests):
            told = reads.request(method, path, json=PAPER, headers={"X-Request-ID": f"audited-scope-{number}"})
            assert told.status_code == 403
        text = audited(log, f"audited-scope-{len(requests) - 1}")
    found = {line.get("request_id"): line for line in map(json.loads, text.splitlines())}
    for number in range(len(requests)):
        entry = found[f"audited-scope-{number}"]
        assert (entry["owner"], entry["key"], entry["status"]) == ("carl", token.split("_")[1], 403)
    assert token not in text


def test_key_in_the_wrong_header_is_not_logged(guarded: Guarded) -> None:
    log = guarded.folder.parent / "audit.log"
    token = guarded.anna.headers["Authorization"].removeprefix("Bearer ")
    assert guarded.anna.post("/cra", json=PAPER, headers={"X-Request-ID": token}).status_code == 200
    assert guarded.anna.post("/cra", json=PAPER, headers={"X-Request-ID": "behind-the-token"}).status_code == 200
    assert token not in audited(log, "behind-the-token")


def test_audit_log_continues_in_a_new_file_after_it_is_moved(guarded: Guarded) -> None:
    log = guarded.folder.parent / "audit.log"
    moved = log.with_suffix(".old")
    guarded.anna.post("/cra", json=PAPER)
    log.rename(moved)
    guarded.anna.post("/cra", json=PAPER, headers={"X-Request-ID": "after-the-move"})
    assert "after-the-move" in audited(log, "after-the-move")
    assert "after-the-move" not in moved.read_text()
    log.write_text(moved.read_text() + log.read_text())


def test_event_streams_of_an_owner_are_limited(guarded: Guarded) -> None:
    body = lines(slow_strikes(100))
    job = guarded.anna.post("/trajectory/batch", content=body, headers=LINES | ASYNC).json()
    path, open_ones = job["links"]["events"], list[httpx.Response]()
    try:
        for _ in range(3):
            stream = guarded.anna.send(guarded.anna.build_request("GET", path), stream=True)
            assert stream.status_code == 200
            open_ones.append(stream)
        over = guarded.anna.get(path)
        assert problem_of(over, 429).type == "urn:ricochet:problem:owner-streams"
        assert int(over.headers["Retry-After"]) > 0
        open_ones.append(stream := guarded.chief.send(guarded.chief.build_request("GET", path), stream=True))
        assert stream.status_code == 200
        assert problem_of(guarded.chief.get(path), 503).type == "urn:ricochet:problem:streams-full"
    finally:
        for stream in open_ones:
            stream.close()
    until(
        lambda: accepts_event_stream(guarded.anna, path)
    )  # The server notices a closed stream when it next writes to it.
    guarded.anna.delete(job["links"]["self"])


def accepts_event_stream(client: httpx.Client, path: str) -> bool:
    """Return whether the service accepts another event stream."""
    with client.stream("GET", path) as stream:
        return stream.status_code == 200


@pytest.mark.parametrize(
    ("method", "path", "scope"),
    [
        ("GET", "/livez", None),
        ("GET", "/docs/assets/swagger-ui.css", None),
        ("GET", "/page/main.js", None),
        ("GET", "/page/contract.json", None),
        ("GET", "/metrics", "read"),
        ("GET", "/page", "read"),
        ("GET", "/livez/", "read"),
        ("GET", "//livez", "read"),
        ("GET", "/jobs", "read"),
        ("POST", "/cra", "run"),
        ("DELETE", "/jobs/1", "run"),
        ("PURGE", "/anything", "run"),
    ],
)
def test_every_path_but_the_open_ones_requires_a_key(
    guarded: Guarded, method: str, path: str, scope: str | None
) -> None:
    """Requests are sent over a socket, because clients would normalise the path."""
    target, line = Target.of(guarded.url), f"{method} {path} HTTP/1.1".encode()
    assert target.send(line)[0] == (200 if scope is None else 401)
    if scope is not None:
        with guarded.with_key("reader", "run" if scope == "read" else "read") as lacking:
            status, answer = target.send(line, f"Authorization: {lacking.headers['Authorization']}".encode())
        assert status == 403
        assert f"`{scope}`".encode() in answer


def test_contract_declares_the_scope_of_every_operation_that_is_not_open(guarded: Guarded) -> None:
    paths = guarded.anna.get("/openapi.json").json()["paths"]
    declared = {f"{method} {path}": operation for path, each in paths.items() for method, operation in each.items()}
    open_ones = {name for name, operation in declared.items() if operation["security"] == []}
    assert open_ones == {"get /livez", "get /readyz", "get /version"}
    for name in declared.keys() - open_ones:
        assert declared[name]["security"] == [{}, {"key": []}], name
        scope = "read" if name.startswith("get ") else "run"
        assert f"the scope `{scope}`" in declared[name]["responses"]["403"]["description"], name


def test_start_on_all_addresses_without_a_key_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path))
    monkeypatch.setattr("service.telemetry.configure_log", lambda _: None)  # Keep the logging of this process as it is.
    assert cli.main(["serve", "--host", "0.0.0.0"]) == 3  # noqa: S104
    told = capsys.readouterr().err
    assert "ricochet keys add" in told
    assert "RICOCHET_ACCESS=open" in told


@pytest.mark.parametrize(
    ("host", "access", "key", "starts"),
    [
        ("127.0.0.1", "auto", False, True),
        ("::1", "auto", False, True),
        ("127.0.0.1", "keys", False, False),
        ("0.0.0.0", "auto", False, False),  # noqa: S104
        ("::", "auto", False, False),
        ("example.org", "auto", False, False),
        ("0.0.0.0", "auto", True, True),  # noqa: S104
        ("0.0.0.0", "open", False, True),  # noqa: S104
        ("127.0.0.1", "keys", True, True),
    ],
)
def test_start_requires_a_key_unless_access_is_open(
    tmp_path: Path, host: str, access: Any, key: bool, starts: bool
) -> None:
    if key:
        key_in(tmp_path, "anna")
    with nullcontext() if starts else pytest.raises(CommandError, match="requires an API key"):
        check_access(Settings(host=host, access=access, data_dir=tmp_path), ApiKeyStore(tmp_path, print))


def test_revoking_the_last_key_does_not_open_the_service(tmp_path: Path) -> None:
    key, _ = make_key("anna", frozenset({"read"}))
    add_key(tmp_path, key)
    revoke_key(tmp_path, key.id)
    assert ApiKeyStore(tmp_path, print).required
    assert not ApiKeyStore(tmp_path, print).usable


def test_damaged_keys_admit_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.auth.api_keys.RELOAD_SECONDS", 0.0)
    key, token = make_key("anna", frozenset({"read"}))
    add_key(tmp_path, key)
    told: list[str] = []
    store = ApiKeyStore(tmp_path, told.append)
    assert store.find(token) == key
    (tmp_path / "auth.sqlite").write_text("{")
    assert store.find(token) is None
    assert store.required
    assert "damaged" in told[0]
    with pytest.raises(KeysUnreadableError):
        ApiKeyStore(tmp_path, told.append)
    (tmp_path / "auth.sqlite").unlink()
    store.reload()
    assert store.required


def test_start_after_loss_of_the_keys_is_refused_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without keys, any user of this machine could list the jobs of all owners."""
    key_in(tmp_path, "anna")
    jobs_of("anna")(tmp_path)
    (tmp_path / "auth.sqlite").unlink()
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path))
    monkeypatch.setattr("service.telemetry.configure_log", lambda _: None)  # Keep the logging of this process as it is.
    assert cli.main(["serve"]) == 3
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("ricochet serve: ")]
    assert "auth.sqlite is missing" in line
    assert "restore it from a backup" in line
    assert "ricochet keys add" in line


def test_empty_key_file_counts_as_damaged(tmp_path: Path) -> None:
    (tmp_path / "auth.sqlite").touch()
    with pytest.raises(KeysUnreadableError):
        ApiKeyStore(tmp_path, print)


def test_several_processes_can_add_keys_at_once(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "service.cli", "keys", "add", "--owner"]
    environment = os.environ | {"RICOCHET_DATA_DIR": str(tmp_path)}
    adding = [
        subprocess.Popen([*command, f"owner{n}"], env=environment, cwd=ROOT, stdout=subprocess.DEVNULL)
        for n in range(4)
    ]
    assert [process.wait(START_SECONDS) for process in adding] == [0] * 4
    assert {key.owner for key in read_keys(tmp_path).values()} == {f"owner{n}" for n in range(4)}


def jobs_of(owner: str) -> Callable[[Path], None]:
    """Return a function that stores a job of this owner in a data folder."""

    def leave(folder: Path) -> None:
        with closing(JobStore(folder, job_days=7.0)) as jobs:
            jobs.create("cra", owner)

    return leave


@pytest.mark.parametrize("left", ["auth.lock", "", "audit.log", "jobs.sqlite"])
def test_lock_file_without_keys_shows_that_keys_were_lost(tmp_path: Path, left: str) -> None:
    if left:
        (tmp_path / left).touch()
    store = ApiKeyStore(tmp_path, print)
    assert store.required == store.lost == (left == "auth.lock")
    with pytest.raises(CommandError, match=r"auth\.sqlite is missing") if store.lost else nullcontext():
        check_access(Settings(data_dir=tmp_path), store)
    check_access(Settings(data_dir=tmp_path, access="open"), store)


def test_key_file_with_an_unknown_layout_is_refused_unchanged(tmp_path: Path) -> None:
    key_in(tmp_path, "anna")
    with closing(sqlite3.connect(tmp_path / "auth.sqlite")) as keys:
        keys.execute("PRAGMA user_version = 9")
    before = (tmp_path / "auth.sqlite").read_bytes()
    with pytest.raises(KeysUnreadableError, match="layout 9"):
        ApiKeyStore(tmp_path, print)
    assert (tmp_path / "auth.sqlite").read_bytes() == before


def test_new_key_gives_access_to_a_folder_that_lost_its_keys(tmp_path: Path) -> None:
    (tmp_path / "auth.lock").touch()
    token = key_in(tmp_path, "anna")
    store = ApiKeyStore(tmp_path, print)
    check_access(Settings(data_dir=tmp_path), store)
    assert store.required
    assert store.find(token) is not None


def test_revoking_an_unknown_key_writes_no_file(tmp_path: Path) -> None:
    assert revoke_key(tmp_path, "5f0c21d9") is None
    assert not list(tmp_path.iterdir())


def ricochet_keys(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert cli.main(["keys", *arguments]) == 0
    return capsys.readouterr().out.strip()


def test_token_is_shown_once_and_stored_as_a_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path))
    token = ricochet_keys(capsys, "add", "--owner", "anna", "--scope", "read", "--cases-per-hour", "1000")
    assert len(token) > 50
    for file in tmp_path.iterdir():
        assert token[-20:].encode() not in file.read_bytes()
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert ApiKeyStore(tmp_path, print).find(token) is not None
    listed = ricochet_keys(capsys, "list")
    assert "anna  read  1000 cases an hour" in listed
    assert token[-20:] not in listed
    ricochet_keys(capsys, "revoke", listed.split()[0])
    assert "revoked" in ricochet_keys(capsys, "list")
    assert ApiKeyStore(tmp_path, print).find(token) is None
    assert cli.main(["keys", "revoke", "nothing"]) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["--owner", ""],
        ["--owner", "a\nb"],
        ["--owner", "a", "--scope", "all"],
        ["--owner", "a", "--cases-per-hour", "0"],
        ["--owner", "a", "--expires", "-1"],
        ["--owner", "a", "--expires", "nan"],
    ],
)
def test_key_with_invalid_options_is_not_created(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path))
    assert cli.main(["keys", "add", *arguments]) == 2
    assert not read_keys(tmp_path)


def test_tokens_are_unique_and_match_only_their_own_key() -> None:
    made: list[tuple[ApiKey, str]] = [make_key("anna", frozenset({"read"})) for _ in range(100)]
    assert len({token for _, token in made}) == len({key.digest for key, _ in made}) == 100
    (key, token), (other, others) = made[:2]
    assert key.fits(token)
    assert not key.fits(others)
    assert not other.fits(token)
    assert not key.fits(token[:-1])
    assert not key.fits(token + "x")


def test_cases_of_an_hour_ago_no_longer_count_in_the_quota() -> None:
    now = 1_000_000.0
    quota = Quota(10, time=lambda: now)
    quota.take(6)
    now += 1800.0
    quota.take(4)
    with pytest.raises(QuotaError) as refused:
        quota.take(1)
    assert 0 < refused.value.retry_after <= WINDOW - 1800 + STEP
    now += refused.value.retry_after
    quota.take(6)
    with pytest.raises(QuotaError):
        quota.take(1)


def test_request_larger_than_the_quota_is_refused_with_its_size() -> None:
    with pytest.raises(QuotaTooSmallError, match="at least 11 cases, of which this key may have 10 an hour"):
        Quota(10).take(11)
    with pytest.raises(QuotaTooSmallError, match="at least 12 cases"):
        Quota(10).take(3, before=9)


def test_refusal_states_how_much_of_the_quota_is_left() -> None:
    quota = Quota(10)
    quota.take(7)
    with pytest.raises(QuotaError, match="5 cases exceed the 3 that are left of the 10 an hour"):
        quota.take(5)


def test_answer_states_the_quota_of_the_client(guarded: Guarded) -> None:
    with guarded.with_key("rita", cases_per_hour=10) as rita:
        for left in (9, 8):
            answer = rita.post("/cra", json=PAPER)
            assert answer.headers["RateLimit-Policy"] == f'"cases";q=10;w={WINDOW}'
            name, remaining, reset = answer.headers["RateLimit"].split(";")
            assert (name, remaining) == ('"cases"', f"r={left}")
            assert WINDOW - STEP <= int(reset.removeprefix("t=")) <= WINDOW + STEP
        assert rita.get("/jobs").headers["RateLimit"].startswith('"cases";r=8;')
    assert "RateLimit" not in guarded.anna.get("/jobs").headers


def test_request_larger_than_the_quota_has_no_retry_time(guarded: Guarded) -> None:
    with guarded.with_key("rosa", cases_per_hour=4) as rosa:
        for body in ({"json": {"cases": searches(5)}}, {"content": lines(searches(5)), "headers": LINES}):
            answer = rosa.post("/cra/batch", **body)
            assert problem_of(answer, 403).type == "urn:ricochet:problem:quota-too-small"
            assert "Retry-After" not in answer.headers
        assert rosa.post("/cra/batch", json={"cases": searches(4)}).status_code == 200


@pytest.mark.anyio
async def test_quota_counts_survive_a_restart(tmp_path: Path) -> None:
    key_in(tmp_path, "anna")
    before = QuotaStore(tmp_path)
    before.quota("5f0c21d9", 10).take(7)
    await before.save()
    after = QuotaStore(tmp_path).quota("5f0c21d9", 10)
    after.take(3)
    with pytest.raises(QuotaError):
        after.take(1)
