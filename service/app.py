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
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp

from service import heap, telemetry
from service.access.audit import AuditLog
from service.access.gate import Gate
from service.access.keyring import KeyRing
from service.access.places import Queries, Streams
from service.access.rules import scope_for
from service.access.usage import Usages
from service.batches.runner import Runner
from service.engine import Engine
from service.executors.choice import executor_for
from service.keys import SCHEMA_VERSION
from service.logs import RequestLog
from service.problems import MEDIA_TYPE, install_problem_handlers
from service.results.cache import ResultCache
from service.routes import batch, calibration, cra, docs, health, jobs, metrics, page, results, sweep, trajectory
from service.routes.contract import problems
from service.routes.download import FOLDER as DOWNLOADS
from service.routes.hot import HotAnswers, HotPath
from service.schemas import (
    CriticalAngleBatch,
    CriticalAngleSweep,
    DepthCalibrationRequest,
    MotionCalibrationRequest,
    ObliquityCalibrationRequest,
    TrajectoryBatch,
    TrajectorySweep,
)
from service.settings import Settings

DESCRIPTION = """
Critical ricochet angles of rigid projectiles on concrete.

Angles are in degrees from the inward normal of the face: 0° is normal impact. Depth is positive inside the target.
Fields are named with their units and never null: what is not given is absent.
"""
POOL_SECONDS = 1
"""For the workers to end once nothing is asked of them any more."""
TRACES_SECONDS = 0.5
"""For the last traces to be sent, when all else has ended."""
STOP_SECONDS = POOL_SECONDS + 1
"""Of the grace time, for jobs and workers to end after the last request has been answered or given up."""
OPERATIONS = {"trajectory": trajectory.TRAJECTORY, "cra": cra.CRITICAL_ANGLE} | calibration.OPERATIONS
RESOURCES = (batch, sweep, trajectory, cra, calibration, results, jobs, health, metrics, docs, page)
BODIES = (
    TrajectoryBatch,
    CriticalAngleBatch,
    TrajectorySweep,
    CriticalAngleSweep,
    DepthCalibrationRequest,
    MotionCalibrationRequest,
    ObliquityCalibrationRequest,
)
"""Models of the bodies that routes read piece by piece, which FastAPI does not get to see."""
KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "A key of `ricochet keys add`, where the service asks for one. Reading takes the scope `read`, all "
    "else `run`; with `admin`, the jobs of all owners are there.",
}
CORS: dict[str, Any] = {
    "allow_methods": ["GET", "POST", "DELETE"],
    "allow_headers": ["Authorization", "Content-Type", "Idempotency-Key", "If-None-Match", "Last-Event-ID", "Prefer"],
    "expose_headers": ["Cache-Status", "Content-Location", "ETag", "Location", "Preference-Applied", "Retry-After"],
}
"""What pages of the origins that are allowed may send and see."""
READING_THREADS = 1
"""They validate cases: more would only take the interpreter lock from the event loop more often."""

log = logging.getLogger(__name__)


class Application(FastAPI):
    """FastAPI, with errors declared as the problems they are answered as."""

    def openapi(self) -> dict[str, Any]:
        """Return the contract."""
        if self.openapi_schema is None:
            contract = super().openapi()
            declare_bodies(contract["components"]["schemas"])
            contract["components"]["securitySchemes"] = {"key": KEY}
            for path, operations in contract["paths"].items():
                for method, operation in operations.items():
                    declare_access(method, path, operation)
                    declare_problems(operation["responses"])
                    declare_events(operation["responses"])
        return super().openapi()

    def build_middleware_stack(self) -> ASGIApp:
        """Return what answers requests. Outside all that FastAPI does, so that what it answers to a failure is seen."""
        counts: metrics.Metrics = self.state.metrics
        settings: Settings = self.state.settings
        hot = HotPath(super().build_middleware_stack(), lambda: getattr(self.state, "hot", None), counts.count_hit)
        answering = hot if self.state.traces is None else telemetry.LinkedTrace(hot)
        gate: ASGIApp = Gate(answering, settings, self.state.keys, self.state.usages, self.state.audit)
        if settings.cors_origins:
            gate = CORSMiddleware(gate, settings.cors_origins, **CORS)
        return RequestLog(gate, counts.observe, settings.log_level)


def declare_bodies(schemas: dict[str, Any]) -> None:
    """Add the models of the bodies that FastAPI does not get to see."""
    _, found = models_json_schema(
        [(model, "validation") for model in BODIES], ref_template="#/components/schemas/{model}"
    )
    for name, schema in found["$defs"].items():
        schemas.setdefault(name, schema)


def declare_access(method: str, path: str, operation: dict[str, Any]) -> None:
    """Tell whether an operation may take a key, and how it is refused for want of one."""
    if scope_for(method.upper(), path) is None:
        return
    operation["security"] = [{}, {"key": []}]
    refused = problems(400, 401, 403, *([408] if "requestBody" in operation else []))
    for status, response in refused.items():
        told = {name: value for name, value in response.items() if name != "model"}
        content = {"application/json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
        operation["responses"].setdefault(str(status), {**told, "content": content})
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
        If traces are asked for, and what sends them is not installed.
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
        telemetry=telemetry.config(traces),
    )
    app.state.settings, app.state.traces = settings, traces
    app.state.metrics = metrics.Metrics()
    app.state.keys = KeyRing(settings.data_dir, log.error, settings.audit_log)
    app.state.usages = Usages(settings.data_dir)
    app.state.audit = AuditLog(settings.audit_log)
    app.state.streams = Streams(settings.max_streams, settings.max_owner_streams)
    app.state.queries = Queries(settings.max_owner_queries)
    install_problem_handlers(app)
    for resource in RESOURCES:
        app.include_router(resource.router)
    app.mount("/docs/assets", docs.ASSETS)
    app.mount("/page", page.ASSETS)
    return app


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Bring up what answers requests, and end it at last."""
    state, settings = app.state, app.state.settings
    counts: metrics.Metrics = state.metrics
    operations = {name: counts.counting(name, operation) for name, operation in OPERATIONS.items()}
    state.stopping = asyncio.Event()
    state.reading = CapacityLimiter(READING_THREADS)
    state.turn = asyncio.Lock()
    async with AsyncExitStack() as stack:
        state.audit.open()
        stack.callback(state.audit.close)
        await stack.enter_async_context(state.usages.kept())
        await stack.enter_async_context(heap.kept_small())
        if state.traces is not None:
            stack.push_async_callback(telemetry.finish, state.traces, TRACES_SECONDS)
        state.cache = stack.enter_context(
            ResultCache(settings.data_dir, memory_bytes=settings.memory_cache_bytes, disk_bytes=settings.cache_bytes)
        )
        shutil.rmtree(settings.data_dir / DOWNLOADS, ignore_errors=True)
        state.executor = executor_for(settings)
        await state.executor.start()
        stack.push_async_callback(state.executor.stop, POOL_SECONDS)
        state.engine = Engine(state.cache, state.executor, operations, most_waiting=settings.max_waiting_queries)
        state.hot = HotAnswers(state.engine, memory_bytes=settings.memory_cache_bytes)
        stored = metrics.CountedJobs(settings.data_dir, counts, job_days=settings.job_days)
        state.runner = Runner(state.engine, stored, max_queued_cases=settings.max_queued_cases)
        await state.runner.start()
        stack.push_async_callback(state.runner.stop)
        yield
