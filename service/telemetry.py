"""Log entries and traces of requests.

Every request has a log entry with its id. Traces are optional and use OpenTelemetry; requests are traced by FastAPI's
own hook. OpenTelemetry's environment variables, such as `OTEL_EXPORTER_OTLP_ENDPOINT` and `OTEL_TRACES_SAMPLER`,
configure the collector and the sampling.
"""

import logging
import os
import re
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import orjson
import structlog
from anyio.to_thread import run_sync
from fastapi.telemetry import TelemetryConfig
from opentelemetry import trace
from opentelemetry.trace import NoOpTracer
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import MissingExtraError
from service.settings import missing_package
from service.version import VERSION

BEGUN = "ricochet.begun"
"""Key in the ASGI scope of a request for its start time on the performance counter. [s]"""
SANE_ID = re.compile(rb"[0-9A-Za-z._:-]{1,128}")
"""Pattern of request ids accepted from clients. It excludes characters that could forge a line or field of the log."""
UNKNOWN = "unknown"
"""Label of requests without a route. A label for each such path would let clients fill the metrics."""

Observe = Callable[[str, str, int, float], None]
"""Function called after each request with its method, route, status and duration [s]."""


def configure_log(level: str) -> None:
    """Send the log entries of the service and its libraries to standard error, as text on a terminal, else as JSON."""
    terminal = sys.stderr.isatty()
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        timestamp(terminal=terminal),
    ]
    render: list[structlog.typing.Processor] = (
        [text_renderer()] if terminal else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer()]
    )
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[structlog.stdlib.PositionalArgumentsFormatter(), *shared],
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *render],
    )
    handler = logging.StreamHandler()
    handler.setFormatter(formatter)
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    if terminal:  # `ricochet serve` prints the address itself, so uvicorn's lines at the start would repeat it.
        logging.getLogger("uvicorn.error").setLevel(logging.WARNING)


def request_logger(level: str) -> structlog.typing.FilteringBoundLogger:
    """Return the logger of requests. It bypasses `logging`, which is too slow for thousands of entries a second."""
    terminal = sys.stderr.isatty()
    logger: structlog.typing.FilteringBoundLogger = structlog.wrap_logger(
        structlog.WriteLogger(sys.stderr) if terminal else structlog.BytesLogger(sys.stderr.buffer),
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            timestamp(terminal=terminal),
            text_renderer()
            if terminal
            else structlog.processors.JSONRenderer(serializer=lambda event, **_: orjson.dumps(event)),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        cache_logger_on_first_use=True,
    )
    return logger.bind()


def timestamp(*, terminal: bool) -> structlog.processors.TimeStamper:
    """Return the processor that adds the time: local time on a terminal, else ISO 8601 in UTC."""
    return structlog.processors.TimeStamper(fmt="%H:%M:%S" if terminal else "iso", utc=not terminal)


def text_renderer() -> structlog.dev.ConsoleRenderer:
    """Return the processor that renders a log entry as a line of text."""
    return structlog.dev.ConsoleRenderer(
        colors=not os.environ.get("NO_COLOR"),
        sort_keys=False,
        pad_event_to=0,
        exception_formatter=structlog.dev.plain_traceback,
    )


class RequestLog:
    """Outermost middleware: assigns an id to each request, and logs the request once it has been answered.

    Parameters
    ----------
    app
        ASGI application to wrap.
    observe
        Function called after each request.
    level
        Lowest severity that is logged.
    secret
        Prefix of API keys. An id that contains it is replaced, since a client may have sent its key in the wrong
        header.
    """

    def __init__(self, app: ASGIApp, observe: Observe, level: str, secret: str) -> None:
        self._app = app
        self._observe = observe
        self._log = request_logger(level)
        self._secret = secret.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, with its id bound to the log and added to the response."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = scope[BEGUN] = time.perf_counter()
        request_id = id_of(scope, self._secret)
        structlog.contextvars.bind_contextvars(request_id=request_id.decode())
        status = 500  # Logged if the application fails before it sends a status.

        async def send_with_id(message: Message) -> None:
            if message["type"] == "http.response.start":
                nonlocal status
                status = message["status"]
                message["headers"] = [*message.get("headers", ()), (b"x-request-id", request_id)]
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        finally:
            seconds, route = time.perf_counter() - begun, route_of(scope)
            self._observe(scope["method"], route, status, seconds)
            self._log.info(
                "request", method=scope["method"], route=route, status=int(status), duration_s=round(seconds, 6)
            )


def id_of(scope: Scope, secret: bytes) -> bytes:
    """Return the `X-Request-ID` of the client if it is acceptable, else a new id."""
    for name, value in scope["headers"]:
        if name == b"x-request-id" and SANE_ID.fullmatch(value) and secret not in value.lower():
            return bytes(value)
    return secrets.token_hex(16).encode()


def route_of(scope: Scope) -> str:
    """Return the path template of a request, such as `/jobs/{job_id}`, or `UNKNOWN` without a route."""
    path: str = getattr(scope.get("route"), "path", UNKNOWN)
    return path


def path_of(scope: Scope) -> str:
    """Return the path of a request without the prefix under which a proxy publishes the service."""
    path: str = scope["path"]
    return path.removeprefix(scope.get("root_path", ""))


UNTRACED = frozenset({"/livez", "/readyz", "/metrics"})
"""Paths without traces: monitors poll them every few seconds."""
REQUEST_ID = "ricochet.request_id"
"""Span attribute that holds the request id, as in the log and in `X-Request-ID` of the response."""
NO_TRACER: trace.Tracer = NoOpTracer()
"""Tracer in use while traces are disabled."""
TRACEPARENT = "traceparent"
PROPAGATOR = TraceContextTextMapPropagator()


def tracer_provider() -> trace.TracerProvider:
    """Return a tracer provider that sends spans to the collector in batches.

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
    logging.getLogger("opentelemetry.util.re").addFilter(hide_header)
    # `OTEL_RESOURCE_ATTRIBUTES` and `OTEL_SERVICE_NAME` take precedence over these names.
    named = Resource({"service.name": "ricochet", "service.version": VERSION})
    provider = TracerProvider(resource=named.merge(OTELResourceDetector().detect()), shutdown_on_exit=False)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider


def hide_header(record: logging.LogRecord) -> bool:
    """Replace OpenTelemetry's warning about a malformed header, because it repeats the header with its key."""
    record.msg, record.args = "OTEL_EXPORTER_OTLP_HEADERS: an entry is not NAME=VALUE, URL encoded; it is left out", ()
    return True


def tracing_config(provider: trace.TracerProvider | None) -> TelemetryConfig:
    """Return the settings of FastAPI's telemetry hook: a span per request if traces are enabled, else none."""
    return {
        "tracing": provider is not None,
        "tracer_provider": provider,
        "metrics": False,  # Prometheus reads `/metrics` instead.
        "logs": False,  # `RequestLog` writes them.
        "operation_spans": False,
        "auto_configure": False,
        "exclude": lambda scope: path_of(scope) in UNTRACED,
    }


def tracer(provider: trace.TracerProvider | None) -> trace.Tracer:
    """Return the tracer for jobs; it does nothing while traces are disabled."""
    return NO_TRACER if provider is None else provider.get_tracer("ricochet")


def current_traceparent() -> str | None:
    """Return the `traceparent` (W3C Trace Context) of the current span; None if nothing is traced."""
    carrier: dict[str, str] = {}
    PROPAGATOR.inject(carrier)
    return carrier.get(TRACEPARENT)


@contextmanager
def span_within(
    tracer: trace.Tracer, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
) -> Iterator[None]:
    """Trace a part of a job as a child of the span of the request that submitted the job."""
    parent = PROPAGATOR.extract({TRACEPARENT: traceparent} if traceparent else {})
    with tracer.start_as_current_span(name, context=parent, attributes=attributes):
        yield


async def finish_traces(provider: trace.TracerProvider, seconds: float) -> None:
    """Send the remaining spans, waiting at most `seconds`. [s]"""
    # The thread is a daemon so that a collector that does not answer cannot keep the process alive.
    sending = threading.Thread(target=getattr(provider, "shutdown"), daemon=True)  # noqa: B009 (a method of the SDK)
    sending.start()
    await run_sync(sending.join, seconds)


class LinkedTrace:
    """Middleware that links the span of a request and its log entry: each carries the id of the other.

    Parameters
    ----------
    app
        ASGI application to wrap.

    Notes
    -----
    The middleware also names the span after the route, which FastAPI does not do for responses that bypass its routes.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, with the request id added to its span and the trace id added to its log entry."""
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
