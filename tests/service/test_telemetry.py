"""Traces of a running service, received by a collector over HTTP."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span

from service.schemas.strike import PAPER
from service.settings import Settings

ROOT = Path(__file__).parents[2]
TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"


class Collector:
    """A collector that keeps the traces it receives."""

    def __init__(self) -> None:
        self.received: list[ExportTraceServiceRequest] = []

    @property
    def spans(self) -> list[Span]:
        return [
            span
            for request in self.received
            for resource in request.resource_spans
            for scope in resource.scope_spans
            for span in scope.spans
        ]

    def resource(self) -> dict[str, str]:
        found = self.received[0].resource_spans[0].resource.attributes
        return {attribute.key: attribute.value.string_value for attribute in found}

    @contextmanager
    def listening(self) -> Iterator[str]:
        received = self.received

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if self.path == "/v1/traces":
                    received.append(ExportTraceServiceRequest.FromString(body))
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 (its name there)
                """Discard the log line that the base class would print."""

        with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
            threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
            try:
                yield f"http://127.0.0.1:{server.server_port}"
            finally:
                server.shutdown()


def attributes(span: Span) -> dict[str, Any]:
    return {
        attribute.key: getattr(attribute.value, attribute.value.WhichOneof("value") or "")
        for attribute in span.attributes
    }


@pytest.fixture(autouse=True)
def no_other_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("OTEL_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("NO_PROXY", "*")


def test_each_request_is_a_span_in_the_trace_of_its_client(
    tmp_path: Path, service_on: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Spans of the chunks of a job are children of the request that submitted it."""
    collector = Collector()
    cases = [PAPER | {"impact": {"velocity_m_s": 230.0 + each}} for each in range(3)]
    with collector.listening() as endpoint:
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", endpoint)
        monkeypatch.setenv("OTEL_RESOURCE_ATTRIBUTES", "deployment.environment.name=test")
        with (
            service_on(tmp_path, telemetry="true", log_level="info") as service,
            httpx.Client(base_url=service.url, timeout=60.0, trust_env=False) as client,
        ):
            headers = {"traceparent": f"00-{TRACE}-{PARENT}-01", "X-Request-ID": "computed"}
            assert client.post("/cra", json=PAPER, headers=headers).is_success
            assert client.post("/cra", json=PAPER, headers={"X-Request-ID": "known"}).is_success
            client.get("/results/" + "0" * 64, headers={"X-Request-ID": "missing"})
            headers |= {"X-Request-ID": "batch", "Prefer": "respond-async"}
            accepted = client.post("/cra/batch", json={"cases": cases}, headers=headers)
            assert accepted.status_code == 202
            job = accepted.json()
            # The span of this request ends with the job.
            client.get(job["links"]["events"], headers={"X-Request-ID": "events"})
            assert client.get(job["links"]["self"], headers={"X-Request-ID": "job"}).json()["status"] == "successful"
            for probe in ("/livez", "/readyz", "/metrics"):
                assert client.get(probe).is_success
        # The service sends all remaining spans before it ends.
    chunks = [span for span in collector.spans if span.name == "chunk"]
    requests = [span for span in collector.spans if span.name != "chunk"]
    by_id = {attributes(span)["ricochet.request_id"]: span for span in requests}
    assert sorted(by_id) == ["batch", "computed", "events", "job", "known", "missing"]
    assert len(requests) == 6  # Probes are not traced.
    computed, known, missing = by_id["computed"], by_id["known"], by_id["missing"]
    assert (computed.trace_id.hex(), computed.parent_span_id.hex()) == (TRACE, PARENT)
    assert known.trace_id != computed.trace_id
    assert (computed.name, known.name, missing.name) == ("POST /cra", "POST /cra", "GET /results/{key}")
    for span, status in ((computed, 200), (known, 200), (missing, 404)):
        found = attributes(span)
        assert (found["http.response.status_code"], found["http.route"]) == (status, span.name.split()[1])
        assert 0 < span.end_time_unix_nano - span.start_time_unix_nano < 60e9
        assert span.kind == Span.SPAN_KIND_SERVER
    assert collector.resource().items() >= {("service.name", "ricochet"), ("deployment.environment.name", "test")}
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    logged = {line["request_id"]: line["trace_id"] for line in lines if "trace_id" in line}
    assert logged == {name: span.trace_id.hex() for name, span in by_id.items()}
    assert chunks
    assert sum(attributes(chunk)["ricochet.cases"] for chunk in chunks) == len(cases)
    for chunk in chunks:
        assert (chunk.trace_id.hex(), chunk.parent_span_id) == (TRACE, by_id["batch"].span_id)
        assert (attributes(chunk)["ricochet.job"], attributes(chunk)["ricochet.operation"]) == (job["id"], "cra")
    assert by_id["batch"].parent_span_id.hex() == PARENT


def test_unreachable_collector_delays_neither_answers_nor_shutdown(
    tmp_path: Path, service_on: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The key of the collector is not logged either."""
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_HEADERS", "authorization: Bearer hush")
    with service_on(tmp_path, telemetry="true") as service:
        assert httpx.post(f"{service.url}/cra", json=PAPER, timeout=60.0, trust_env=False).is_success
        service.process.terminate()
        assert service.process.wait(Settings().grace_seconds + 1) == 0
    log = (tmp_path / "log").read_text()
    assert "OTEL_EXPORTER_OTLP_HEADERS" in log
    assert "hush" not in log


def test_traces_are_neither_loaded_nor_sent_unless_enabled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:9")
    program = (
        "import sys\nfrom service.api.app import create_app\nfrom service.settings import Settings\n"
        "app = create_app(Settings(telemetry=False))\n"
        "assert not app._native_telemetry.enabled()\n"
        "print([name for name in sys.modules if name.startswith(('opentelemetry.sdk', 'opentelemetry.exporter'))])"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ended.stdout == "[]\n"


def test_missing_extra_for_traces_is_named(tmp_path: Path) -> None:
    program = (
        "import sys; sys.modules['opentelemetry.exporter'] = None\n"
        "from service.cli import main\nsys.exit(main(['serve']))"
    )
    environment = os.environ | {"RICOCHET_TELEMETRY": "true", "RICOCHET_DATA_DIR": str(tmp_path)}
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert "RICOCHET_TELEMETRY needs opentelemetry.exporter" in ended.stderr
    assert "the extra telemetry" in ended.stderr
    assert "Traceback" not in ended.stderr
