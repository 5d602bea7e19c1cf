"""The work of a job joins the trace of the request that made it, on the SDK's own exporter in memory."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import Tracer

from service.jobs.models import JobState
from service.workers.in_thread import InThreadExecutor
from tests.service.squares import accepted, cases, ended, running, until_done

pytestmark = pytest.mark.anyio


class Recorded:
    """A tracer, and the spans it has made."""

    def __init__(self) -> None:
        self._exporter = InMemorySpanExporter()
        provider = TracerProvider()
        provider.add_span_processor(SimpleSpanProcessor(self._exporter))
        self.tracer: Tracer = provider.get_tracer("tests")

    def spans(self, name: str) -> list[ReadableSpan]:
        return [span for span in self._exporter.get_finished_spans() if span.name == name]


@pytest.fixture
async def executor() -> AsyncIterator[InThreadExecutor]:
    thread = InThreadExecutor(task_seconds=60.0)
    await thread.start()
    yield thread
    await thread.stop(2.0)


def joined(recorded: Recorded, job: JobState) -> int:
    """Cases in the chunks of the job, each of which must be a child of the only request."""
    [request] = recorded.spans("request")
    chunks = recorded.spans("chunk")
    for chunk in chunks:
        assert chunk.context is not None
        assert request.context is not None
        assert chunk.parent is not None
        assert (chunk.context.trace_id, chunk.parent.span_id) == (request.context.trace_id, request.context.span_id)
        assert chunk.attributes is not None
        assert (chunk.attributes["ricochet.job"], chunk.attributes["ricochet.operation"]) == (job.id, "square")
    return sum(int(str((chunk.attributes or {})["ricochet.cases"])) for chunk in chunks)


async def test_chunks_are_children_of_the_request_that_made_the_job(tmp_path: Path, executor: InThreadExecutor) -> None:
    recorded = Recorded()
    async with running(tmp_path, executor, tracer=recorded.tracer) as manager:
        with recorded.tracer.start_as_current_span("request"):
            job = await accepted(manager, cases(range(300)))
        await ended(manager, job)
    assert joined(recorded, job) == 300


async def test_job_that_goes_on_after_a_restart_stays_in_its_trace(tmp_path: Path, executor: InThreadExecutor) -> None:
    recorded, later = Recorded(), Recorded()
    async with running(tmp_path, executor, tracer=recorded.tracer) as manager:
        with recorded.tracer.start_as_current_span("request"):
            job = await accepted(manager, cases(range(40), seconds=0.1))
        await until_done(manager, job, 1)
    async with running(tmp_path, executor, tracer=later.tracer) as manager:
        await ended(manager, job)
    [request] = recorded.spans("request")
    traces = {span.context.trace_id for span in later.spans("chunk") if span.context is not None}
    assert request.context is not None
    assert traces == {request.context.trace_id}


async def test_job_without_a_trace_begins_its_own(tmp_path: Path, executor: InThreadExecutor) -> None:
    recorded = Recorded()
    async with running(tmp_path, executor, tracer=recorded.tracer) as manager:
        await ended(manager, await accepted(manager, cases(range(3))))
    assert [span.parent for span in recorded.spans("chunk")] == [None]
