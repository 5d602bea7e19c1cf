"""What the routes work with: one object, made with the application and completed when it starts."""

import asyncio
from dataclasses import dataclass, field

from anyio import CapacityLimiter
from fastapi import Request
from opentelemetry.trace import TracerProvider
from starlette.types import ASGIApp

from service.api.body import KnownBodies
from service.api.metrics import Metrics
from service.auth.api_keys import ApiKeyStore
from service.auth.dependencies import ConcurrencyLimit
from service.auth.middleware import AuditLog
from service.auth.quotas import QuotaStore
from service.cache.cache import ResultCache
from service.jobs.manager import JobManager
from service.queries import QueryService
from service.settings import Settings
from service.workers import Executor
from service.workers.process_pool import InThreadExecutor, ProcessPool

READING_THREADS = 1
"""Threads that validate cases: more would only take the interpreter lock from the event loop more often."""


@dataclass
class Services:
    """Everything of a running application, in `app.state.services`.

    The fields of the last group are set while the application starts.
    """

    settings: Settings
    metrics: Metrics
    keys: ApiKeyStore
    quotas: QuotaStore
    audit: AuditLog
    streams: ConcurrencyLimit
    owner_queries: ConcurrencyLimit
    bodies: KnownBodies
    traces: TracerProvider | None

    cache: ResultCache = field(init=False)
    executor: Executor = field(init=False)
    queries: QueryService = field(init=False)
    jobs: JobManager = field(init=False)
    stopping: asyncio.Event = field(init=False)
    reading: CapacityLimiter = field(init=False)
    parsing: asyncio.Lock = field(init=False)
    mcp: ASGIApp = field(init=False)
    """Answers messages of the Model Context Protocol."""


def services_of(request: Request) -> Services:
    """Return the services of the application that a request came to."""
    services: Services = request.app.state.services
    return services


def executor_for(settings: Settings) -> Executor:
    """Return the executor of the settings; nothing runs until it is started."""
    if settings.executor == "in-process":
        return InThreadExecutor(task_seconds=settings.task_seconds)
    if settings.executor == "dask":
        from service.dask.executor import DaskExecutor  # noqa: PLC0415 (an extra that few have installed)

        return DaskExecutor(
            address=settings.dask_scheduler, workers=settings.workers, task_seconds=settings.task_seconds
        )
    return ProcessPool(workers=settings.workers, task_seconds=settings.task_seconds)
