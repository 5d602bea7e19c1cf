"""Spans of a job belong to the trace of the request that submitted it. OpenTelemetry exports them to memory here."""

from pathlib import Path

import pytest
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import Tracer

from service.workers.in_thread import InThreadExecutor
from tests.service.squares import accepted, cases, ended, running, until_done

pytestmark = pytest.mark.anyio


class Recorded:
    """A tracer and the spans that it has recorded."""

    def __init__(self) -> None:
        self._exporter = InMemorySpanExporter()
        provider = TracerProvider()
        provider.add_span_processor(SimpleSpanProcessor(self._exporter))
        self.tracer: Tracer = provider.get_tracer("tests")

    def spans(self, name: str) -> list[ReadableSpan]:
        return [span for span in self._exporter.get_finished_spans() if span.name == name]


async def test_job_resumed_after_a_restart_stays_in_its_trace(tmp_path: Path, thread: InThreadExecutor) -> None:
    recorded, later = Recorded(), Recorded()
    async with running(tmp_path, thread, tracer=recorded.tracer) as manager:
        with recorded.tracer.start_as_current_span("request"):
            job = await accepted(manager, cases(range(40), seconds=0.02))
        await until_done(manager, job, 1)
    async with running(tmp_path, thread, tracer=later.tracer) as manager:
        await ended(manager, job)
    [request] = recorded.spans("request")
    traces = {span.context.trace_id for span in later.spans("chunk") if span.context is not None}
    assert request.context is not None
    assert traces == {request.context.trace_id}


async def test_job_without_a_trace_begins_a_new_one(tmp_path: Path, thread: InThreadExecutor) -> None:
    recorded = Recorded()
    async with running(tmp_path, thread, tracer=recorded.tracer) as manager:
        await ended(manager, await accepted(manager, cases(range(3))))
    assert [span.parent for span in recorded.spans("chunk")] == [None]
