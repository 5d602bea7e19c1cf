"""What is recorded of requests: an entry of the log for each, with its id, and traces if they are enabled.

Traces go to OpenTelemetry, those of requests through FastAPI's own hook. OpenTelemetry's variables set the collector
and the sampling, such as `OTEL_EXPORTER_OTLP_ENDPOINT` and `OTEL_TRACES_SAMPLER`.
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
"""Key in the scope of a request: its start time on the performance counter [s]."""
SANE_ID = re.compile(rb"[0-9A-Za-z._:-]{1,128}")
"""Ids of others that are taken over: nothing that could be more than an id where it is printed."""
UNKNOWN = "unknown"
"""Stands for every path that is no route: a label for each would fill the metrics."""

Observe = Callable[[str, str, int, float], None]
"""Called for every request with its method, route, status and seconds."""


def configure_log(level: str) -> None:
    """Write all log entries, also those of libraries, to standard error: as text on a terminal, as JSON elsewhere."""
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
    if terminal:  # `ricochet serve` prints the address itself
        logging.getLogger("uvicorn.error").setLevel(logging.WARNING)


def request_logger(level: str) -> structlog.typing.FilteringBoundLogger:
    """Return the logger of requests. It bypasses the logging library, because there are thousands a second."""
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
    """Return the processor that adds the time: local on a terminal, ISO 8601 in UTC elsewhere."""
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
    """Middleware, outside all others: gives each request an id, and logs it when it has been answered.

    Parameters
    ----------
    app
        What answers.
    observe
        Called for every request.
    level
        Least weight of what is logged.
    secret
        Prefix of API keys: an id with it is replaced, as a client may have put its key into the wrong header.
    """

    def __init__(self, app: ASGIApp, observe: Observe, level: str, secret: str) -> None:
        self._app = app
        self._observe = observe
        self._log = request_logger(level)
        self._secret = secret.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = scope[BEGUN] = time.perf_counter()
        request_id = id_of(scope, self._secret)
        structlog.contextvars.bind_contextvars(request_id=request_id.decode())
        status = 500

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
    """Return the id the client has given the request, or a new one."""
    for name, value in scope["headers"]:
        if name == b"x-request-id" and SANE_ID.fullmatch(value) and secret not in value.lower():
            return bytes(value)
    return secrets.token_hex(16).encode()


def route_of(scope: Scope) -> str:
    """Return the path of a request with the names of its parameters in place of their values."""
    path: str = getattr(scope.get("route"), "path", UNKNOWN)
    return path


def path_of(scope: Scope) -> str:
    """Return the path of a request at this service, without the prefix of a proxy."""
    path: str = scope["path"]
    return path.removeprefix(scope.get("root_path", ""))


UNTRACED = frozenset({"/livez", "/readyz", "/metrics"})
"""Polled every few seconds by monitors; not worth a trace."""
REQUEST_ID = "ricochet.request_id"
"""Attribute of a span: the id of its request in the log and in the answer."""
NO_TRACER: trace.Tracer = NoOpTracer()
"""Traces nothing."""
TRACEPARENT = "traceparent"
PROPAGATOR = TraceContextTextMapPropagator()


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
    logging.getLogger("opentelemetry.util.re").addFilter(hide_header)
    named = Resource({"service.name": "ricochet", "service.version": VERSION})
    provider = TracerProvider(resource=named.merge(OTELResourceDetector().detect()), shutdown_on_exit=False)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider


def hide_header(record: logging.LogRecord) -> bool:
    """Take the header out of the library's complaint about it: it holds the key of the collector."""
    record.msg, record.args = "OTEL_EXPORTER_OTLP_HEADERS: an entry is not NAME=VALUE, URL encoded; it is left out", ()
    return True


def tracing_config(provider: trace.TracerProvider | None) -> TelemetryConfig:
    """Return the settings of FastAPI's hook: a span for each request, or nothing at all."""
    return {
        "tracing": provider is not None,
        "tracer_provider": provider,
        "metrics": False,  # there is /metrics
        "logs": False,  # and the log
        "operation_spans": False,
        "auto_configure": False,
        "exclude": lambda scope: path_of(scope) in UNTRACED,
    }


def tracer(provider: trace.TracerProvider | None) -> trace.Tracer:
    """Return what traces the work of jobs; nothing does where traces are not enabled."""
    return NO_TRACER if provider is None else provider.get_tracer("ricochet")


def current_traceparent() -> str | None:
    """Return the span that is current as W3C Trace Context writes it; None if nothing is traced."""
    carrier: dict[str, str] = {}
    PROPAGATOR.inject(carrier)
    return carrier.get(TRACEPARENT)


@contextmanager
def span_within(
    tracer: trace.Tracer, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
) -> Iterator[None]:
    """Trace a part of the work of a job, as a child of the request that made it, also after a restart."""
    parent = PROPAGATOR.extract({TRACEPARENT: traceparent} if traceparent else {})
    with tracer.start_as_current_span(name, context=parent, attributes=attributes):
        yield


async def finish_traces(provider: trace.TracerProvider, seconds: float) -> None:
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
