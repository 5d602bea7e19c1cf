"""Traces: the work of a job joins the trace of the request that made it, also after a restart."""

from collections.abc import Iterator
from contextlib import contextmanager

from opentelemetry.trace import NoOpTracer, SpanKind, Tracer
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from service.jobs.models import JobState

NO_TRACER: Tracer = NoOpTracer()
"""Traces nothing."""
TRACEPARENT = "traceparent"
PROPAGATOR = TraceContextTextMapPropagator()


def current_traceparent() -> str | None:
    """Return the span that is current as W3C Trace Context writes it; None if nothing is traced."""
    carrier: dict[str, str] = {}
    PROPAGATOR.inject(carrier)
    return carrier.get(TRACEPARENT)


@contextmanager
def span_of(tracer: Tracer, name: str, job: JobState, cases: int) -> Iterator[None]:
    """Trace a part of the work of a job, as a child of the request that made it."""
    parent = PROPAGATOR.extract({TRACEPARENT: job.traceparent} if job.traceparent else {})
    attributes: dict[str, str | int] = {
        "ricochet.job": job.id,
        "ricochet.operation": job.operation,
        "ricochet.cases": cases,
    }
    with tracer.start_as_current_span(name, context=parent, kind=SpanKind.INTERNAL, attributes=attributes):
        yield
