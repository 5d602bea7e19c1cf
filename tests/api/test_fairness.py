"""Abandoned requests, or many requests of one client, do not delay other clients."""

import json
import select
import signal
import socket
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from service.schemas.strike import PAPER, PAPER_AT_45
from tests.conftest import RunService, until

pytestmark = pytest.mark.timeout(120)

PATIENCE_S = 60.0
MINUTE = {"method": "panels", "panels": 96_000, "time_step_s": 1e-6, "termination_time_s": 0.05}
"""Numerics of a search that takes about a minute."""
TENTH = {"method": "panels", "panels": 12_000, "time_step_s": 1e-5, "termination_time_s": 0.05}
"""Numerics of a trajectory that takes about 0.1 s."""


def search(number: int, **numerics: Any) -> dict[str, Any]:
    return PAPER | {"impact": {"velocity_m_s": 200.0 + number}} | ({"numerics": numerics} if numerics else {})


def run(number: int, **numerics: Any) -> dict[str, Any]:
    impact = PAPER_AT_45["impact"] | {"velocity_m_s": 200.0 + 0.1 * number}
    return PAPER_AT_45 | {"impact": impact, "numerics": numerics, "output": {"history": False}}


@contextmanager
def sent(url: str, path: str, bodies: Sequence[dict[str, Any]], address: str) -> Iterator[list[socket.socket]]:
    """Send each body on its own connection from this address; yield the connections, with all answers still unread."""
    with ExitStack() as open_:
        ends = []
        for content in bodies:
            body = json.dumps(content).encode()
            head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nConnection: close\r\n"
            end = socket.create_connection(("127.0.0.1", urlsplit(url).port or 0), PATIENCE_S, (address, 0))
            ends.append(open_.enter_context(end))
            end.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        yield ends


@contextmanager
def client_at(url: str, address: str) -> Iterator[httpx.Client]:
    transport = httpx.HTTPTransport(local_address=address)
    with httpx.Client(base_url=url, transport=transport, timeout=PATIENCE_S) as client:
        yield client


def gauge(client: httpx.Client, name: str) -> float:
    return float(client.get("/metrics").text.partition(f"\n{name} ")[2].split("\n")[0])


@pytest.fixture(scope="module")
def one_worker(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with service_on(tmp_path_factory.mktemp("one"), workers="1", probe_seconds="0.5") as service:
        yield service.url


@pytest.mark.parametrize("path", ["/cra", "/cra/batch"])
def test_work_of_a_disconnected_client_is_dropped(one_worker: str, path: str) -> None:
    """The 20 queued and running requests of a client that disconnects would take 20 minutes."""
    bodies = [search(number, **MINUTE) for number in range(20)]
    if path == "/cra/batch":
        bodies = [{"cases": [body]} for body in bodies]
    with client_at(one_worker, "127.0.0.3") as other:
        with sent(one_worker, path, bodies, "127.0.0.2"):
            until(lambda: sum(gauge(other, f"ricochet_queued_{kind}") for kind in ("queries", "cases")) >= 19)
        assert other.post("/cra", json=search(100 + len(path))).status_code == 200
        assert other.post("/cra/batch", json={"cases": [search(200 + len(path))]}).status_code == 200
        assert gauge(other, "ricochet_queued_queries") == gauge(other, "ricochet_queued_cases") == 0.0


def test_client_addresses_get_equal_shares_of_the_workers(one_worker: str) -> None:
    """A query of another client is answered before three quarters of the 24 queries sent earlier."""
    with (
        client_at(one_worker, "127.0.0.2") as crowd,
        client_at(one_worker, "127.0.0.3") as other,
        ThreadPoolExecutor(24) as threads,
    ):
        queries = [threads.submit(crowd.post, "/trajectory", json=run(number, **TENTH)) for number in range(24)]
        until(lambda: any(query.done() for query in queries))
        assert other.post("/trajectory", json=run(100, **TENTH)).status_code == 200
        assert sum(query.done() for query in queries) < 18
        assert [query.result().status_code for query in queries] == [200] * 24


def test_service_with_busy_workers_is_ready_and_reports_busy(one_worker: str) -> None:
    with client_at(one_worker, "127.0.0.3") as other:
        with sent(one_worker, "/cra", [search(50, **MINUTE), search(51, **MINUTE)], "127.0.0.2"):
            until(lambda: gauge(other, "ricochet_queued_queries") >= 1)
            answer = other.get("/readyz")
            assert (answer.status_code, answer.json()) == (200, {"status": "busy", "chunks_on": "pool"})
        until(lambda: bool(other.get("/readyz").json()["status"] == "ok"))


def test_shutdown_refuses_work_that_would_not_finish_in_time(service_on: RunService, tmp_path: Path) -> None:
    """Running and queued queries and batches are answered with 503; the fixture checks that no failure is logged."""
    with service_on(tmp_path, workers="1", grace_seconds="3") as service, client_at(service.url, "127.0.0.1") as client:
        bodies = [search(number, **MINUTE) for number in range(5)]
        with (
            sent(service.url, "/cra", bodies, "127.0.0.1") as ends,
            sent(service.url, "/cra/batch", [{"cases": [search(9, **MINUTE)]}], "127.0.0.1") as more,
        ):
            until(lambda: gauge(client, "ricochet_queued_queries") >= 4)
            service.process.send_signal(signal.SIGTERM)
            for end in (*ends, *more):
                head, _, body = b"".join(iter(lambda: end.recv(65536), b"")).partition(b"\r\n\r\n")  # noqa: B023
                assert head.startswith(b"HTTP/1.1 503 ")
                assert b"application/problem+json" in head
                assert b"retry-after" in head.lower()
                assert json.loads(body)["type"] == "urn:ricochet:problem:unavailable"
            assert service.process.wait(PATIENCE_S) == 0


def answers_begun(ends: Sequence[socket.socket]) -> int:
    """Return the number of connections on which an answer has begun."""
    return len(select.select(ends, [], [], 0.0)[0])


REPORTS = 30


@pytest.mark.timeout(400)
def test_reports_of_one_owner_do_not_delay_the_query_of_another(service_on: RunService, tmp_path: Path) -> None:
    """A query is answered before half of 30 reports, and reports of disconnected clients are abandoned."""
    with service_on(tmp_path, workers="1") as service, client_at(service.url, "127.0.0.3") as other:
        other.post("/report", json=PAPER, timeout=300.0).raise_for_status()  # Now all cases of the report are cached.
        with sent(service.url, "/report", [PAPER] * REPORTS, "127.0.0.2") as ends:
            until(lambda: gauge(other, "ricochet_queued_queries") > REPORTS / 2)
            assert other.post("/cra", json=search(1)).is_success
            assert answers_begun(ends) < REPORTS / 2
        until(lambda: gauge(other, "ricochet_queued_queries") == 0)


def test_study_beyond_its_time_limit_is_refused(service_on: RunService, tmp_path: Path) -> None:
    study = PAPER | {
        "uncertain": [
            {
                "field": "impact.velocity_m_s",
                "distribution": {"type": "normal", "mean": 238.0, "standard_deviation": 2.4},
            }
        ],
        "sampling": {"max_samples": 16_384, "half_width": 1e-4, "method": "direct"},
    }
    with (
        service_on(tmp_path, workers="1", study_seconds="0.5") as service,
        client_at(service.url, "127.0.0.1") as client,
    ):
        refused = client.post("/cra/uncertainty", json=study)
        assert refused.status_code == 422, refused.text
        assert refused.json()["type"] == "urn:ricochet:problem:timeout"
        assert "0.5 s" in refused.json()["detail"]
