"""Limits in the settings: requests within a limit are answered, and others refused with a problem that states it."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from service.auth.dependencies import ConcurrencyLimit
from service.errors import OwnerQueriesError
from service.queries import CASE_SECONDS, Rate
from service.schemas.problems import Problem
from service.schemas.strike import PAPER, PAPER_AT_45
from tests.conftest import RunService, until

from .many import ASYNC, LINES, ROUGH, items_of, lines, searches, slow_strikes, strikes
from .refused import TEXT, problem_of

BODY_BYTES, BODY_DEPTH = 4096, 12
QUEUED, PANEL_STEPS = 300, 1e8


@pytest.fixture(scope="module")
def tight(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    settings = {
        "max_body_bytes": BODY_BYTES,
        "max_body_depth": BODY_DEPTH,
        "max_batch_bytes": 2 * BODY_BYTES,
        "max_jsonl_bytes": 200 * BODY_BYTES,
        "max_queued_cases": 2 * QUEUED,  # One owner may use half of the queue.
        "max_panel_steps": PANEL_STEPS,
        "task_seconds": 2.0,
    }
    folder = tmp_path_factory.mktemp("tight")
    with (
        service_on(folder, **{name: str(value) for name, value in settings.items()}) as service,
        httpx.Client(base_url=service.url, timeout=60.0, trust_env=False) as client,
    ):
        yield client


def padded(body: dict[str, Any], length: int) -> bytes:
    content = json.dumps(body).encode()
    return content + b" " * (length - len(content))


def test_body_may_be_as_long_as_the_limit(tight: httpx.Client) -> None:
    assert tight.post("/cra", content=padded(PAPER, BODY_BYTES), headers=TEXT).status_code == 200
    found = problem_of(tight.post("/cra", content=padded(PAPER, BODY_BYTES + 1), headers=TEXT), 413)
    assert str(BODY_BYTES) in found.detail


def test_batch_may_be_as_long_as_the_limit(tight: httpx.Client) -> None:
    body = {"cases": [PAPER | {"search": ROUGH}]}
    assert tight.post("/cra/batch", content=padded(body, 2 * BODY_BYTES), headers=TEXT).status_code == 200
    problem_of(tight.post("/cra/batch", content=padded(body, 2 * BODY_BYTES + 1), headers=TEXT), 413)


def test_line_may_be_as_long_as_a_body(tight: httpx.Client) -> None:
    right, long = padded(PAPER, BODY_BYTES) + b"\n", padded(PAPER, BODY_BYTES + 1) + b"\n"
    assert tight.post("/cra/batch", content=right, headers=LINES).status_code == 200
    assert "/0" in problem_of(tight.post("/cra/batch", content=long, headers=LINES), 422).errors[0].pointer


@pytest.mark.parametrize(("opening", "closing"), [(b'{"a":', b"}"), (b"[", b"]")])
@pytest.mark.parametrize("path", ["/cra", "/cra/batch", "/cra/sweep", "/calibration/depth"])
def test_body_may_be_nested_as_deep_as_the_limit(
    tight: httpx.Client, path: str, opening: bytes, closing: bytes
) -> None:
    def nested(depth: int) -> bytes:
        return b'{"a":' + opening * (depth - 1) + b"1" + closing * (depth - 1) + b"}"

    # The body is parsed, but is not a valid request.
    problem_of(tight.post(path, content=nested(BODY_DEPTH), headers=TEXT), 422)
    found = problem_of(tight.post(path, content=nested(BODY_DEPTH + 1), headers=TEXT), 400)
    assert f"{BODY_DEPTH} deep" in found.detail
    problem_of(tight.post(path, content=nested(500), headers=TEXT), 400)  # At this depth the parser itself fails.


def test_line_may_be_nested_as_deep_as_the_limit(tight: httpx.Client) -> None:
    def nested(depth: int) -> bytes:
        return b"[" * depth + b"]" * depth

    read = problem_of(tight.post("/cra/batch", content=nested(BODY_DEPTH), headers=LINES), 422)
    refused = problem_of(tight.post("/cra/batch", content=nested(BODY_DEPTH + 1), headers=LINES), 422)
    assert "deep" not in read.errors[0].detail
    assert f"{BODY_DEPTH} deep" in refused.errors[0].detail


def test_consecutive_brackets_are_not_nesting(tight: httpx.Client) -> None:
    cases = {"cases": [{**PAPER, "search": ROUGH}] * (2 * BODY_DEPTH // 10)}
    text = json.dumps(cases).encode()
    assert text.count(b"{") > BODY_DEPTH
    assert tight.post("/cra/batch", content=text, headers=TEXT).status_code == 200


def test_batch_may_have_as_many_cases_as_the_limit(client: httpx.Client) -> None:
    def batch(count: int) -> dict[str, Any]:
        return {"cases": [{**PAPER, "search": ROUGH}] * count}

    assert client.post("/cra/batch", json=batch(1000)).status_code in {200, 202}
    assert problem_of(client.post("/cra/batch", json=batch(1001)), 422).errors[0].pointer == "/cases"


def test_queue_accepts_cases_up_to_the_limit(tight: httpx.Client) -> None:
    jobs = [tight.post("/trajectory/batch", content=lines(slow_strikes(150)), headers=LINES | ASYNC) for _ in range(2)]
    assert [job.status_code for job in jobs] == [202, 202]
    try:
        refused = tight.post("/trajectory/batch", content=lines(strikes(150)), headers=LINES | ASYNC)
        assert problem_of(refused, 429).type == "urn:ricochet:problem:queue-full"
        assert int(refused.headers["Retry-After"]) > 0
    finally:
        for job in jobs:
            tight.delete(job.json()["links"]["self"])


def test_retry_time_lasts_until_there_is_room_for_the_whole_request(tight: httpx.Client) -> None:
    def seconds_until(refused: httpx.Response) -> int:
        assert problem_of(refused, 429).type == "urn:ricochet:problem:queue-full"
        return int(refused.headers["Retry-After"])

    def seconds_for(count: int) -> int:
        return seconds_until(tight.post("/trajectory/batch", content=lines(strikes(count)), headers=LINES | ASYNC))

    job = tight.post("/trajectory/batch", content=lines(slow_strikes(250)), headers=LINES | ASYNC)
    try:
        until(lambda: bool(tight.get(job.json()["links"]["self"]).json()["counts"]["done"]))
        few, many = seconds_for(300), seconds_for(2000)  # These are 250 and 1,950 cases more than may be queued.
        assert few >= 1
        assert many > 3 * few
        axis = {"field": "impact.velocity_m_s", "start": 200.0, "stop": 300.0, "count": 100_000}
        sweep = {"base": PAPER_AT_45, "axes": [axis]}
        assert seconds_until(tight.post("/trajectory/sweep", json=sweep, headers=ASYNC)) > 60
    finally:
        tight.delete(job.json()["links"]["self"])


@pytest.mark.parametrize("path", ["/trajectory", "/trajectory/batch", "/trajectory/sweep", "lines"])
def test_panels_times_steps_are_limited_on_every_route(tight: httpx.Client, path: str) -> None:
    def answer(panels: int) -> httpx.Response:
        numerics = {"method": "panels", "panels": panels, "termination_time_s": 1.0, "time_step_s": 1e-5}
        case = PAPER_AT_45 | {"numerics": numerics, "output": {"history": False}}
        if path == "lines":
            return tight.post("/trajectory/batch", content=lines([case]), headers=LINES)
        axes = [{"field": "impact.velocity_m_s", "values": [240.0]}]
        bodies = {"/trajectory": case, "/trajectory/batch": {"cases": [case]}}
        return tight.post(path, json=bodies.get(path, {"base": case, "axes": axes}))

    assert answer(1000).status_code == 200
    found = problem_of(answer(1001), 422)
    assert found.errors[0].pointer.endswith("/numerics/panels")
    assert f"must be at most {PANEL_STEPS:g}, ".replace("e+0", "e") in found.detail


def test_search_by_the_paper_procedure_counts_its_panels(tight: httpx.Client) -> None:
    body = PAPER | {"search": {"method": "bisection"}, "numerics": {"panels": 100_000, "time_step_s": 1e-6}}
    assert problem_of(tight.post("/cra", json=body), 422).errors[0].pointer == "/numerics/panels"


def test_case_beyond_the_time_limit_fails_alone_and_in_a_batch(tight: httpx.Client) -> None:
    numerics = {"method": "panels", "panels": 100_000, "termination_time_s": 0.01, "time_step_s": 1e-5}
    search = {"method": "outcome", "tolerance_deg": 1e-6}
    endless = PAPER | {"numerics": numerics, "search": search}
    with ThreadPoolExecutor() as threads:
        alone = threads.submit(tight.post, "/cra", json=endless)
        cases = [*searches(2), endless | {"custom_id": "endless"}]
        items = items_of(tight.post("/cra/batch", json={"cases": cases}))
    assert problem_of(alone.result(), 422).type == "urn:ricochet:problem:timeout"
    assert tight.post("/cra", json=PAPER).status_code == 200
    assert ["result" in item for item in items] == [True, True, False]
    problem = Problem.model_validate(items[2]["problem"])
    assert (problem.type, problem.instance) == ("urn:ricochet:problem:timeout", "/cra/batch")
    assert items[2]["custom_id"] == "endless"


def test_single_queries_of_an_owner_are_limited() -> None:
    queries = ConcurrencyLimit(2, OwnerQueriesError)
    with queries.held("anna"), queries.held("anna"), queries.held("bert"):
        refused = queries.held("anna")
        with pytest.raises(OwnerQueriesError):
            refused.__enter__()
    with queries.held("anna"), queries.held("anna"):
        pass


@pytest.mark.parametrize(("count", "weight", "seconds"), [(0, 1, 1), (1200, 1, 12), (1200, 20, 240)])
def test_expected_wait_follows_from_the_cost_of_cases_until_a_rate_is_measured(
    count: int, weight: int, seconds: int
) -> None:
    assert CASE_SECONDS == 0.02
    assert Rate(lambda: 2).seconds_for(count, weight) == seconds


def test_idle_time_does_not_lower_a_rate() -> None:
    """Otherwise a service that is idle most of the time would announce minutes for a job that takes seconds."""
    now = 100.0
    rate = Rate(lambda: 1, clock=lambda: now)
    now += 60.0
    with rate.working():
        now += 0.1
        rate.add(4)
        assert rate.per_second == pytest.approx(40.0)
    now += 25.0
    assert rate.per_second == pytest.approx(40.0)
    with rate.working(), rate.working():
        now += 0.9
        rate.add(36)
        assert rate.seconds_for(400) == 10
        now += 40.0
        # Without work in the last half minute the rate is unknown, and a default is used instead.
        assert rate.per_second == 0.0


def test_probes_accept_unknown_query_parameters(client: httpx.Client) -> None:
    assert client.get("/livez?time=1").status_code == 200
