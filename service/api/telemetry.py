"""Traces of requests for OpenTelemetry, through FastAPI's own hook, and of jobs; only if they are enabled.

OpenTelemetry's variables set the collector and the sampling, such as `OTEL_EXPORTER_OTLP_ENDPOINT` and
`OTEL_TRACES_SAMPLER`.
"""

import threading
from importlib.metadata import version

import structlog
from anyio.to_thread import run_sync
from fastapi.telemetry import TelemetryConfig
from opentelemetry import trace
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import MissingExtraError
from service.jobs.models import NO_TRACER
from service.settings import missing_package

UNTRACED = frozenset({"/livez", "/readyz", "/metrics"})
"""Polled every few seconds by monitors; not worth a trace."""
REQUEST_ID = "ricochet.request_id"
"""Attribute of a span: the id of its request in the log and in the answer."""


def tracer_provider() -> trace.TracerProvider:
    """Return what makes spans and sends them to a collector, many at a time.

    Raises
    ------
    MissingExtraError
        If the extra `telemetry` is not installed.
    """
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415 (an extra)
        from opentelemetry.sdk.resources import OTELResourceDetector, Resource  # noqa: PLC0415
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise MissingExtraError(missing_package("RICOCHET_TELEMETRY", str(error.name), "telemetry")) from None
    named = Resource({"service.name": "ricochet", "service.version": version("ricochet")})
    provider = TracerProvider(resource=named.merge(OTELResourceDetector().detect()), shutdown_on_exit=False)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider


def config(provider: trace.TracerProvider | None) -> TelemetryConfig:
    """Return the settings of FastAPI's hook: a span for each request, or nothing at all."""
    return {
        "tracing": provider is not None,
        "tracer_provider": provider,
        "metrics": False,  # there is /metrics
        "logs": False,  # and the log
        "operation_spans": False,
        "auto_configure": False,
        "exclude": lambda scope: scope.get("path") in UNTRACED,
    }


def tracer(provider: trace.TracerProvider | None) -> trace.Tracer:
    """Return what traces the work of jobs; nothing does where traces are not enabled."""
    return NO_TRACER if provider is None else provider.get_tracer("ricochet")


async def finish(provider: trace.TracerProvider, seconds: float) -> None:
    """Send what has not been sent yet; a collector that does not answer holds nobody up for longer than this."""
    sending = threading.Thread(target=getattr(provider, "shutdown"), daemon=True)  # noqa: B009 (of the SDK alone)
    sending.start()
    await run_sync(sending.join, seconds)


class LinkedTrace:
    """Middleware that has the span of a request and its line in the log name each other.

    Parameters
    ----------
    app
        What answers.

    Notes
    -----
    It also names the span of an answer from memory, which no route of FastAPI has given.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        span = trace.get_current_span()
        if scope["type"] != "http" or not span.get_span_context().is_valid:
            await self._app(scope, receive, send)
            return
        span.set_attribute(REQUEST_ID, structlog.contextvars.get_contextvars()["request_id"])
        structlog.contextvars.bind_contextvars(trace_id=trace.format_trace_id(span.get_span_context().trace_id))

        async def send_with_route(message: Message) -> None:
            route = getattr(scope.get("route"), "path", None)
            if message["type"] == "http.response.start" and route is not None:
                span.update_name(f"{scope['method']} {route}")
                span.set_attribute("http.route", route)
            await send(message)

        await self._app(scope, receive, send_with_route)
