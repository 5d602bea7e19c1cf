"""Metrics, log lines and headers that describe the work of the service."""

import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.api.app import create_app
from service.api.services import Metrics
from service.schemas.strike import PAPER
from service.settings import Settings
from solver import ENGINE_VERSION
from tests.conftest import ROOT, RunService, until

from .many import ASYNC, finished, searches

ENDINGS = {"counter": ("_total",), "histogram": ("_bucket", "_count", "_sum"), "info": ("_info",)}


def metrics(client: httpx.Client) -> dict[tuple[str, ...], float]:
    response = client.get("/metrics")
    assert response.headers["Content-Type"].startswith("text/plain")
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }


class SeparateService(NamedTuple):
    """Client and log of a separate service, where no jobs of other tests run."""

    client: httpx.Client
    log: Path


@pytest.fixture(scope="module")
def separate(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SeparateService]:
    folder = tmp_path_factory.mktemp("separate")
    with (
        service_on(folder, log_level="info") as service,
        httpx.Client(base_url=service.url, timeout=60.0, trust_env=False) as client,
    ):
        yield SeparateService(client, folder / "log")


def test_cases_are_counted_by_outcome(separate: SeparateService) -> None:
    client = separate.client
    before = metrics(client)
    single, *several = searches(4)
    for _ in range(3):
        client.post("/cra", json=single)
    client.post("/cra/batch", json={"cases": [single, several[0]]})
    axes = [{"field": "projectile.length_m", "values": [0.1]}]
    client.post("/cra/sweep", json={"base": PAPER, "axes": axes})
    finished(client, client.post("/cra/batch", json={"cases": several}, headers=ASYNC).json())
    finished(client, client.post("/cra/sweep", json={"base": PAPER, "axes": axes}, headers=ASYNC).json())
    after = metrics(client)

    def grown(*names: str) -> float:
        return after[names] - before.get(names, 0.0)

    assert grown("ricochet_cases_total", "miss", "cra", "converged") == 4
    assert grown("ricochet_cases_total", "hit", "cra", "converged") == 3
    assert grown("ricochet_cases_total", "hit", "cra", "stored") == 1
    assert grown("ricochet_cases_total", "miss", "cra", "invalid-request") == 2
    assert grown("ricochet_request_seconds_count", "POST", "/cra", "200") == 3
    assert after["ricochet_queued_cases",] == after["ricochet_running_chunks",] == 0
    assert after["ricochet_workers",] == 2
    assert after["ricochet_cache_bytes",] > 0
    assert after["ricochet_cache_segments",] > 0
    assert grown("ricochet_jobs", "successful") == 2
    assert any(name == "ricochet_build_info" and ENGINE_VERSION in rest for name, *rest in after)


def test_requests_are_counted_by_route(client: httpx.Client) -> None:
    client.get("/results/" + "0" * 64)
    client.get("/some/secret/path")
    names = metrics(client).keys()
    assert ("ricochet_request_seconds_count", "GET", "/results/{key}", "404") in names
    assert ("ricochet_request_seconds_count", "GET", "unknown", "404") in names
    assert not any("secret" in label for name in names for label in name)


@pytest.mark.parametrize("given", ["mine-1", "0" * 128, "a.b:c_d"])
def test_request_id_of_the_client_is_used(client: httpx.Client, given: str) -> None:
    assert client.get("/livez", headers={"X-Request-ID": given}).headers["X-Request-ID"] == given


@pytest.mark.parametrize("given", ["", "0" * 129, 'x"y', "<script>", "a b"])
def test_invalid_request_id_is_replaced(client: httpx.Client, given: str) -> None:
    answers = [client.get("/nothing", headers={"X-Request-ID": given}).headers["X-Request-ID"] for _ in range(2)]
    assert all(re.fullmatch("[0-9a-f]{32}", answer) for answer in answers)
    assert answers[0] != answers[1]


def test_answer_states_how_long_it_took(client: httpx.Client) -> None:
    (case,) = searches(1)
    computed, known = client.post("/cra", json=case), client.post("/cra", json=case)
    for answer in (computed, known):
        parts = dict(part.split(";dur=") for part in answer.headers["Server-Timing"].split(", "))
        assert list(parts) == ["validate", "compute", "total"]
        assert float(parts["validate"]) + float(parts["compute"]) == pytest.approx(float(parts["total"]), abs=0.02)
        assert float(parts["total"]) < 1e3 * answer.elapsed.total_seconds()


def test_log_has_one_json_line_per_request(separate: SeparateService) -> None:
    for _ in range(2):  # The second request is answered from the cache.
        separate.client.post("/cra", json=PAPER, headers={"X-Request-ID": "traced"})
    separate.client.get(f"/results/{'1' * 64}")
    until(lambda: "/results/{key}" in separate.log.read_text())  # The line is written after the answer.
    lines = [json.loads(line) for line in separate.log.read_text().splitlines()]
    requests = [line for line in lines if line["event"] == "request"]
    traced = [line for line in requests if line["request_id"] == "traced"]
    assert [(line["method"], line["route"], line["status"], line["level"]) for line in traced] == [
        ("POST", "/cra", 200, "info")
    ] * 2
    assert all(0.0 < line["duration_s"] < 60.0 and line["timestamp"] for line in traced)
    assert "/results/{key}" in {line["route"] for line in requests}
    names = {"event", "level", "timestamp", "request_id", "method", "route", "status", "duration_s"}
    assert all(line.keys() == names for line in requests)


@pytest.mark.anyio
async def test_metrics_are_written_outside_the_event_loop_without_reading_jobs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: set[int] = set()

    class Collector:
        def collect(self) -> Iterator[Any]:
            threads.add(threading.get_ident())
            return iter(())

    app = create_app(Settings(data_dir=tmp_path, workers=1, executor="in-process"))
    app.state.services.metrics.registry.register(Collector())
    threads.clear()
    async with app.router.lifespan_context(app):
        monkeypatch.setattr("service.jobs.store.read_job", lambda *_: pytest.fail("a job was read"))
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://127.0.0.1") as client:
            assert (await client.get("/metrics")).is_success
    assert threads
    assert threading.get_ident() not in threads


def test_names_of_metrics_follow_the_conventions_of_prometheus() -> None:
    """Units are base units, only counters end in `_total`, and there are no rates, which Prometheus computes itself."""
    for family in Metrics().registry.collect():
        name = family.name
        assert re.fullmatch(r"ricochet(_[a-z]+)+", name)
        # These suffixes belong to samples, not to families.
        assert not name.endswith(("_total", "_count", "_sum", "_bucket", "_info"))
        assert not re.search(r"_(ms|milliseconds|minutes|hours|kb|mb|percent|ratio_percent|per_second)$", name)
        if "size" in family.documentation.lower():
            assert name.endswith("_bytes")
        if "time" in family.documentation.lower().split():
            assert name.endswith("_seconds")
        if family.documentation.endswith("since the start"):
            assert family.type == "counter"
    dashboard = (ROOT / "docs" / "grafana.json").read_text(encoding="utf-8")
    declared = {
        name
        for family in Metrics().registry.collect()
        for name in (family.name, *(family.name + ending for ending in ENDINGS.get(family.type, ())))
    }
    assert set(re.findall(r"ricochet_[a-z_]+", dashboard)) <= declared
