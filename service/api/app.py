"""The application: settings in, routes, handlers and what lives as long as it runs out."""

import asyncio
import logging
import shutil
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

from anyio import CapacityLimiter
from fastapi import FastAPI
from pydantic.json_schema import models_json_schema
from starlette.datastructures import MutableHeaders
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import heap, telemetry
from service.api import (
    batches,
    health,
    jobs,
    mcp,
    page,
    queries,
    reports,
    results,
    umbridge,
    uncertainty,
)
from service.api.body import KnownBodies
from service.api.connection import BodyTimeoutMiddleware
from service.api.contract import problems
from service.api.results import DOWNLOADS, HDF5
from service.api.services import READING_THREADS, Metrics, Services, executor_for
from service.api.tables import PARQUET
from service.auth.api_keys import ApiKeyStore
from service.auth.dependencies import ConcurrencyLimit, authorize_unrouted
from service.auth.middleware import AuditLog, AuthMiddleware
from service.auth.quotas import QuotaStore
from service.cache.cache import ResultCache
from service.errors import OwnerQueriesError, OwnerStreamsError, StreamsFullError
from service.jobs.manager import JobManager
from service.jobs.store import JobStore
from service.operations import OPERATIONS, SCHEMA_VERSION
from service.problems import MEDIA_TYPE, install_problem_handlers
from service.queries import QueryService
from service.schemas import (
    CriticalAngleRequest,
    CriticalAngleUncertaintyRequest,
    DepthCalibrationRequest,
    FormulasRequest,
    JobChange,
    LimitSpeedRequest,
    MotionCalibrationRequest,
    ObliquityCalibrationRequest,
    ReportRequest,
    ThicknessRequest,
    TrajectoryRequest,
    TrajectoryUncertaintyRequest,
)
from service.schemas.quantities import Part
from service.settings import Settings

DESCRIPTION = """
Critical ricochet angles of rigid projectiles on concrete.

Angles are in degrees from the inward normal of the face: 0° is normal impact. Depth is positive inside the target.
Fields are named with their units and never null: what is not given is absent.
"""
POOL_SECONDS = 1
"""For the workers to end after the last request."""
TRACES_SECONDS = 0.5
"""For the last traces to be sent, when all else has ended."""
STOP_SECONDS = POOL_SECONDS + 1
"""Part of the grace time for jobs and workers to end after the last request has been answered or given up."""
GZIP_BYTES, GZIP_LEVEL = 8 * 1024, 1
"""Least answer that is compressed, and how hard: level 6 takes four times as long and saves 3 % more."""
RESOURCES = (queries, batches, uncertainty, reports, umbridge, results, jobs, health, page)
"""Routers in the order in which they are searched."""
BODIES: tuple[type[Part], ...] = (
    TrajectoryRequest,
    CriticalAngleRequest,
    *(model for many in batches.MANY_CASES for model in (many.batch, many.sweep)),
    DepthCalibrationRequest,
    MotionCalibrationRequest,
    ObliquityCalibrationRequest,
    ThicknessRequest,
    FormulasRequest,
    LimitSpeedRequest,
    CriticalAngleUncertaintyRequest,
    TrajectoryUncertaintyRequest,
    ReportRequest,
    JobChange,
)
"""Models of the bodies that routes read piece by piece, which FastAPI does not get to see."""
CORS: dict[str, Any] = {
    "allow_methods": ["GET", "HEAD", "POST", "PATCH", "DELETE"],
    "allow_headers": ["Authorization", "Content-Type", "Idempotency-Key", "If-None-Match", "Last-Event-ID", "Prefer"],
    "expose_headers": ["Cache-Status", "Content-Location", "ETag", "Location", "Preference-Applied", "Retry-After"],
}
"""What pages of the origins that are allowed may send and see."""

log = logging.getLogger(__name__)


class Application(FastAPI):
    """FastAPI, with errors declared as the problems they are answered as."""

    def openapi(self) -> dict[str, Any]:
        """Return the contract."""
        if self.openapi_schema is None:
            contract = super().openapi()
            declare_bodies(contract["components"]["schemas"])
            for operations in contract["paths"].values():
                for operation in operations.values():
                    declare_access(operation)
                    declare_problems(operation["responses"])
                    declare_events(operation["responses"])
        return super().openapi()

    def build_middleware_stack(self) -> ASGIApp:
        """Return the application with its middleware; all of it outside of FastAPI's, to see answers to failures."""
        services: Services = self.state.services
        settings = services.settings
        inner: ASGIApp = BodyTimeoutMiddleware(HeadMiddleware(super().build_middleware_stack()), settings)
        if services.traces is not None:
            inner = telemetry.LinkedTrace(inner)
        inner = AuthMiddleware(inner, settings, services.keys, services.quotas, services.audit)
        if settings.cors_origins:
            inner = CORSMiddleware(inner, settings.cors_origins, **CORS)
        if settings.gzip:
            inner = CompressionMiddleware(inner)
        return telemetry.RequestLog(inner, services.metrics.observe, settings.log_level)


class CompressionMiddleware:
    """Compresses large answers, in threads.

    A strong ETag becomes a weak one: these bytes are others (RFC 9110, section 8.8.1).
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = GZipMiddleware(
            app,
            minimum_size=GZIP_BYTES,
            compresslevel=GZIP_LEVEL,
            thread_minimum_size=GZIP_BYTES,
            exclude_content_types=(*DEFAULT_EXCLUDED_CONTENT_TYPES, HDF5, PARQUET),
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""

        async def send_weak(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                if "content-encoding" in headers and headers.get("etag", "").startswith('"'):
                    headers["etag"] = "W/" + headers["etag"]
            await send(message)

        await self._app(scope, receive, send_weak)


class HeadMiddleware:
    """Lets `HEAD` reach the routes of `GET`; the server sends the head of their answer alone."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        inner, sent = {**scope, "method": "GET"}, asyncio.Event()

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                scope["route"] = inner.get("route")
                await send(message)
            elif not sent.is_set():
                sent.set()
                await send({"type": "http.response.body", "body": b""})

        async def receive_until_sent() -> Message:
            await sent.wait()  # then a stream that would go on ends
            return {"type": "http.disconnect"}

        await self._app(inner, receive_until_sent, send_head)


def declare_bodies(schemas: dict[str, Any]) -> None:
    """Add the models of the bodies that FastAPI does not get to see."""
    _, found = models_json_schema(
        [(model, "validation") for model in BODIES], ref_template="#/components/schemas/{model}"
    )
    for name, schema in found["$defs"].items():
        schemas.setdefault(name, schema)


def declare_access(operation: dict[str, Any]) -> None:
    """Declare that a key is optional, as a service may be open, and how an operation is refused without one."""
    if "security" not in operation:
        return
    operation["security"].insert(0, {})
    refused = problems(400, 401, 403, *([408] if "requestBody" in operation else []))
    for status, response in refused.items():
        declared = {name: value for name, value in response.items() if name != "model"}
        content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
        operation["responses"].setdefault(str(status), {**declared, "content": content})
    operation["responses"] = dict(sorted(operation["responses"].items()))


def declare_events(responses: dict[str, Any]) -> None:
    """Declare server-sent events in words: what FastAPI says of them is of a later OpenAPI."""
    content = responses.get("200", {}).get("content", {})
    if "text/event-stream" in content:
        content["text/event-stream"] = {"schema": {"description": "Server-sent events."}}


def declare_problems(responses: dict[str, Any]) -> None:
    """Give the errors among these responses their media type, which FastAPI takes from the route."""
    for status, response in responses.items():
        if status >= "400":
            (content,) = response["content"].values()
            response["content"] = {MEDIA_TYPE: content}


def create_app(settings: Settings | None = None) -> FastAPI:
    """Build the application; nothing runs until it is started.

    Raises
    ------
    MissingExtraError
        If traces are enabled, and what sends them is not installed.
    """
    settings = settings or Settings()
    traces = telemetry.tracer_provider() if settings.telemetry else None
    app = Application(
        title="ricochet",
        version=SCHEMA_VERSION,
        summary="Critical ricochet angles of rigid projectiles on concrete",
        description=DESCRIPTION,
        license_info={"name": "BSD-3-Clause", "identifier": "BSD-3-Clause"},
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
        telemetry=telemetry.tracing_config(traces),
    )
    app.state.services = Services(
        settings=settings,
        metrics=Metrics(),
        keys=ApiKeyStore(settings.data_dir, log.error, settings.audit_log),
        quotas=QuotaStore(settings.data_dir),
        audit=AuditLog(settings.audit_log),
        streams=ConcurrencyLimit(settings.max_owner_streams, OwnerStreamsError, settings.max_streams, StreamsFullError),
        owner_queries=ConcurrencyLimit(settings.max_owner_queries, OwnerQueriesError),
        bodies=KnownBodies(settings.memory_cache_bytes),
        traces=traces,
    )
    install_problem_handlers(app)
    for resource in RESOURCES:
        app.include_router(resource.router)
    if mcp.is_installed():
        app.include_router(mcp.router)
    app.router.default = authorize_unrouted
    app.mount("/docs/assets", page.DOCS_ASSETS)
    app.mount("/page", page.ASSETS)
    app.mount("/manual", page.Manual(settings.manual_dir))
    return app


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Start what the routes work with, and end it at last."""
    services: Services = app.state.services
    settings = services.settings
    services.stopping = asyncio.Event()
    services.reading = CapacityLimiter(READING_THREADS)
    services.parsing = asyncio.Lock()
    async with AsyncExitStack() as stack:
        services.audit.open()
        stack.callback(services.audit.close)
        await stack.enter_async_context(services.quotas.saved_regularly())
        await stack.enter_async_context(heap.kept_small())
        if services.traces is not None:
            stack.push_async_callback(telemetry.finish_traces, services.traces, TRACES_SECONDS)
        services.cache = stack.enter_context(
            ResultCache(settings.data_dir, memory_bytes=settings.memory_cache_bytes, disk_bytes=settings.cache_bytes)
        )
        shutil.rmtree(settings.data_dir / DOWNLOADS, ignore_errors=True)
        services.executor = executor_for(settings)
        await services.executor.start()
        stack.push_async_callback(services.executor.stop, POOL_SECONDS)
        services.queries = QueryService(
            services.cache,
            services.executor,
            OPERATIONS,
            max_waiting=settings.max_waiting_queries,
            count=services.metrics.count,
        )
        services.jobs = JobManager(
            services.queries,
            JobStore(settings.data_dir, job_days=settings.job_days),
            max_queued_cases=settings.max_queued_cases,
            count=services.metrics.count,
            give_back=services.quotas.give_back,
            tracer=telemetry.tracer(services.traces),
        )
        await services.jobs.start()
        stack.push_async_callback(services.jobs.stop)
        tools = mcp.McpServer(settings.max_body_bytes)
        services.mcp = tools.handle
        stack.push_async_callback(tools.stop)
        yield
