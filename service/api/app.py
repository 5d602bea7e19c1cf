"""Application factory: routes, middleware, error handlers and lifespan."""

import asyncio
import importlib
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from threading import Lock
from typing import Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp

from service import telemetry
from service.api import downloads, health, jobs, mcp, operations, page, queries, studies, umbridge
from service.api.contract import (
    declare_access,
    declare_answers,
    declare_bodies,
    declare_defaults,
    declare_events,
    declare_formats,
    declare_problems,
)
from service.api.examples import declare_examples
from service.api.middleware import (
    AuthMiddleware,
    CompressionMiddleware,
    HeaderLimits,
    HeadMiddleware,
    RefusalMiddleware,
)
from service.api.services import READING_THREADS, Metrics, Services, executor_for
from service.auth.api_keys import PREFIX, ApiKeyStore
from service.auth.audit_log import AuditLog
from service.auth.dependencies import ConcurrencyLimit, authorize_unrouted
from service.auth.quotas import QuotaStore
from service.cache.cache import ResultCache
from service.clock import SYSTEM, Clock
from service.errors import OwnerQueriesError, OwnerStreamsError, StreamsFullError
from service.jobs.manager import JobManager
from service.jobs.store import JobStore
from service.operations import OPERATIONS, SCHEMA_VERSION
from service.problems import install_problem_handlers
from service.queries import QueryService
from service.schemas.explanations import known_fields
from service.settings import Settings
from service.workers.executor import Executor

DESCRIPTION = """
Critical ricochet angles of rigid projectiles on concrete.

Angles are in degrees from the inward normal of the face: 0° is normal impact. Depth is positive inside the target.
Names of quantities end with the unit. No field is null: a field without a value is absent.
"""
TAGS = [
    {"name": "critical ricochet angle", "description": "Smallest oblique angles at which a projectile ricochets."},
    {"name": "trajectory", "description": "Motions of single strikes, and probabilities of their outcomes."},
    {"name": "walls", "description": "Least thicknesses of walls, limit speeds, and verdicts on walls."},
    {"name": "formulas", "description": "Empirical formulas for penetration, scabbing and perforation."},
    {"name": "flight", "description": "Flight of a body after it leaves the target."},
    {"name": "calibration", "description": "Strength factors that fit tests and finite element runs."},
    {"name": "results", "description": "Stored results, by their keys."},
    {"name": "jobs", "description": "Batches, sweeps and studies that are computed after the response."},
    {"name": "health", "description": "State, versions and metrics of the service."},
]
POOL_SECONDS = 1
"""Time allowed for workers to stop after the last request [s]: half for calls to finish, half for processes to end."""
TRACES_SECONDS = 0.5
"""Time allowed for sending the last traces, after jobs, workers and cache have stopped [s]. A nearby collector takes
milliseconds, and one that does not answer must not delay the shutdown; the value is arbitrary."""
STOP_SECONDS = POOL_SECONDS + 1
"""Part of the grace period reserved for stopping jobs and workers after the last response [s]: `POOL_SECONDS` for the
workers, and one second, an arbitrary choice, for saving the progress of jobs and closing the caches."""
REFUSAL_SECONDS = 1
"""Part of the grace period in which unfinished requests are refused, just before jobs and workers are stopped [s]. The
refusals are sent within milliseconds; one second leaves a margin."""
RESOURCES = (studies, umbridge, queries, jobs, health, page)
"""Modules whose routers come after the routes of the operations, in the order in which routes are matched."""
CORS: dict[str, Any] = {
    "allow_methods": ["GET", "HEAD", "POST", "PATCH", "DELETE"],
    "allow_headers": ["Authorization", "Content-Type", "Idempotency-Key", "If-None-Match", "Last-Event-ID", "Prefer"],
    "expose_headers": [
        "Cache-Status",
        "Content-Location",
        "ETag",
        "Location",
        "Preference-Applied",
        "RateLimit",
        "RateLimit-Policy",
        "Retry-After",
    ],
}
"""Methods and request headers that pages of allowed origins may use, and response headers that they may read."""

log = logging.getLogger(__name__)


class Application(FastAPI):
    """FastAPI application whose contract declares errors as problem documents."""

    def __init__(self, **options: Any) -> None:
        self._making = Lock()
        super().__init__(**options)

    def openapi(self) -> dict[str, Any]:
        """Return the OpenAPI document. The first call builds it, which takes most of a second: call it in a thread."""
        with self._making:  # Without the lock, two threads could build and edit the same document at once.
            return self._openapi()

    def _openapi(self) -> dict[str, Any]:
        if self.openapi_schema is None:
            contract = super().openapi()
            declare_bodies(contract["components"]["schemas"], operations.bodies_of(OPERATIONS.values()))
            declare_defaults(contract["components"]["schemas"])
            declare_examples(contract["components"]["schemas"], OPERATIONS.values())
            declare_answers(contract)
            declare_formats(contract)
            for methods in contract["paths"].values():
                for operation in methods.values():
                    declare_access(operation)
                    declare_problems(operation["responses"])
                    declare_events(operation["responses"])
        return super().openapi()

    def build_middleware_stack(self) -> ASGIApp:
        """Return the application wrapped in middleware.

        `add_middleware` would place the middleware inside Starlette's error handler, so responses to unexpected
        failures would have neither security headers nor a log entry.
        """
        services: Services = self.state.services
        settings = services.settings
        inner: ASGIApp = super().build_middleware_stack()
        if services.traces is not None:
            inner = telemetry.LinkedTrace(inner)
        inner = AuthMiddleware(inner, settings, services.keys, services.quotas, services.audit)
        if settings.cors_origins:
            inner = CORSMiddleware(inner, settings.cors_origins, **CORS)
        if settings.gzip:
            inner = CompressionMiddleware(inner)
        inner = HeadMiddleware(inner)  # Wraps the compression, so that `HEAD` gets the same headers as `GET`.
        inner = RefusalMiddleware(HeaderLimits(inner))
        return telemetry.RequestLog(inner, services.metrics.observe, settings.log_level, secret=PREFIX)


def create_app(settings: Settings | None = None, clock: Clock = SYSTEM) -> FastAPI:
    """Build the application; nothing runs until it is started.

    Parameters
    ----------
    clock
        Clock for the expiry of keys and jobs and for quotas.

    Raises
    ------
    KeysUnreadableError
        If the file of the keys exists but cannot be read.
    MissingExtraError
        If traces are enabled and the extra `telemetry` is not installed.
    """
    settings = settings or Settings()
    traces = telemetry.tracer_provider() if settings.telemetry else None
    app = Application(
        title="ricochet",
        version=SCHEMA_VERSION,
        summary="Critical ricochet angles of rigid projectiles on concrete",
        description=DESCRIPTION,
        contact={"name": "The ricochet authors"},
        servers=[{"url": settings.root_path or "/"}],
        openapi_tags=TAGS,
        license_info={"name": "BSD-3-Clause", "identifier": "BSD-3-Clause"},
        lifespan=lifespan,
        # `service/api/page.py` serves `/openapi.json` and Swagger UI, because FastAPI's pages load scripts from other
        # sites.
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        # With separate schemas, generated clients would have two classes for a model that is sent and received.
        separate_input_output_schemas=False,
        generate_unique_id_function=lambda route: route.name,
        telemetry=telemetry.tracing_config(traces),
    )
    app.state.services = Services(
        settings=settings,
        metrics=Metrics(),
        keys=ApiKeyStore(settings.data_dir, log.error, clock),
        quotas=QuotaStore(settings.data_dir, clock),
        clock=clock,
        audit=AuditLog(settings.audit_log),
        streams=ConcurrencyLimit(settings.max_owner_streams, OwnerStreamsError, settings.max_streams, StreamsFullError),
        owner_queries=ConcurrencyLimit(
            settings.max_owner_queries, lambda _: OwnerQueriesError(app.state.services.queries.seconds_until_done())
        ),
        traces=traces,
    )
    install_problem_handlers(app)
    operations.add_routes(app.router, OPERATIONS)
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
    """Start the cache, the workers and the job manager, and stop them in reverse order."""
    services: Services = app.state.services
    settings = services.settings
    services.stopping, services.ending = asyncio.Event(), asyncio.get_running_loop().create_future()
    services.reading = CapacityLimiter(READING_THREADS)
    services.parsing = asyncio.Lock()
    async with AsyncExitStack() as stack:
        services.audit.open()
        stack.callback(services.audit.close)
        await stack.enter_async_context(services.quotas.saved_regularly())
        if services.traces is not None:
            stack.push_async_callback(telemetry.finish_traces, services.traces, TRACES_SECONDS)
        for_downloads = round(downloads.SHARE * settings.cache_bytes)
        for_results = settings.cache_bytes - for_downloads
        services.cache = stack.enter_context(
            ResultCache(settings.data_dir, memory_bytes=settings.memory_cache_bytes, disk_bytes=for_results)
        )
        services.downloads = downloads.Downloads(
            settings.data_dir / downloads.FOLDER, for_downloads, services.cache.check_folder
        )
        services.downloads.clear()
        services.executor = executor_for(settings)
        await asyncio.gather(
            start_executor(services.executor, stack),
            # The next two calls take 0.1 to 0.2 s each. They are made now, in threads, because on first use they would
            # block the event loop for as long.
            run_sync(known_fields),
            run_sync(importlib.import_module, "scipy.special"),
        )
        services.queries = QueryService(
            services.cache,
            services.executor,
            OPERATIONS,
            max_waiting=settings.max_waiting_queries,
            queue_seconds=settings.queue_seconds,
            count=services.metrics.count,
        )
        services.jobs = JobManager(
            services.queries,
            JobStore(
                settings.data_dir,
                job_days=settings.job_days,
                owner_bytes=settings.owner_jobs_bytes,
                check_folder=services.cache.check_folder,
                clock=services.clock,
            ),
            clock=services.clock,
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


async def start_executor(executor: Executor, stack: AsyncExitStack) -> None:
    """Start the workers, and register their shutdown, so that it happens even if a later startup step fails."""
    await executor.start()
    stack.push_async_callback(executor.stop, POOL_SECONDS)
