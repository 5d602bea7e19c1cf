"""Shared state of a running application, and its metrics."""

import asyncio
from collections import Counter as Tally
from collections.abc import Coroutine
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any, TypeVar, get_args

from anyio import CapacityLimiter
from fastapi import HTTPException, Request
from opentelemetry.trace import TracerProvider
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Info, disable_created_metrics
from starlette.types import ASGIApp

from service.api.downloads import Downloads
from service.auth.api_keys import ApiKeyStore
from service.auth.audit_log import AuditLog
from service.auth.dependencies import ConcurrencyLimit
from service.auth.quotas import QuotaStore
from service.cache.cache import ResultCache
from service.clock import Clock
from service.errors import PoolUnavailableError, TaskTimeoutError
from service.jobs.manager import JobManager
from service.jobs.models import Status
from service.operations import SCHEMA_VERSION
from service.queries import QueryService
from service.settings import Settings
from service.workers.executor import Executor
from service.workers.in_thread import InThreadExecutor
from service.workers.process_pool import ProcessPool
from solver import ENGINE_VERSION

Result = TypeVar("Result")

READING_THREADS = 1
"""Number of threads that validate cases. More would not be faster, and would compete with the event loop for the
interpreter lock."""
HISTOGRAM_SECONDS = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Bucket bounds of the request histogram [s]: a cached answer takes well under 1 ms, the longest query a minute."""

LABELS = {
    "ricochet_cases": ("operation", "outcome", "cache"),
    "ricochet_request_seconds": ("method", "route", "status"),
    "ricochet_chunk_width": ("place",),
    "ricochet_jobs": ("status",),
}
"""Names of the labels of metrics. Metrics that are not listed have no labels."""


class Metrics:
    """Metrics for Prometheus. Requests and cases are counted as they occur; other values are read at each scrape."""

    def __init__(self) -> None:
        # By default each counter has a second series with its creation time, which nobody reads.
        disable_created_metrics()  # type: ignore[no-untyped-call]
        self.registry = registry = CollectorRegistry()
        self._cases = Counter(
            "ricochet_cases", "Cases answered, by outcome", LABELS["ricochet_cases"], registry=registry
        )
        self._seconds = Histogram(
            "ricochet_request_seconds",
            "Time from the arrival of a request to the end of its response",
            LABELS["ricochet_request_seconds"],
            buckets=HISTOGRAM_SECONDS,
            registry=registry,
        )
        self._gauges = {
            name: Gauge(f"ricochet_{name}", text, registry=registry)
            for name, text in {
                "queued_queries": "Single queries that wait for a worker",
                "queued_cases": "Cases of batches and jobs that wait or run",
                "running_chunks": "Chunks of jobs being prepared, computed or stored",
                "workers": "Worker processes running",
                "cache_bytes": "Size of the results on disk",
                "cache_segments": "Result files on disk",
                "cache_cases": "Results on disk",
            }.items()
        }
        self._width = Gauge(
            "ricochet_chunk_width",
            "Chunks that can be computed at the same time, by the pool or by the cluster",
            LABELS["ricochet_chunk_width"],
            registry=registry,
        )
        self._restarts = Counter(
            "ricochet_worker_restarts", "Worker processes replaced since the start", registry=registry
        )
        self._restarts_counted = 0
        self._start_failures = Counter(
            "ricochet_worker_start_failures", "Worker processes that could not be started", registry=registry
        )
        self._start_failures_counted = 0
        self._implausible = Counter(
            "ricochet_implausible",
            "Answers computed since the start with the warning `implausible`; each shows a fault of the program",
            registry=registry,
        )
        self._implausible_counted = 0
        self._jobs = Gauge("ricochet_jobs", "Jobs stored, by status", LABELS["ricochet_jobs"], registry=registry)
        build = {"engine_version": ENGINE_VERSION, "schema_version": SCHEMA_VERSION}
        Info("ricochet_build", "Versions of the service", registry=registry).info(build)

    def observe(self, method: str, route: str, status: int, seconds: float) -> None:
        """Add the duration of a request to the histogram. [s]"""
        self._seconds.labels(method, route, status).observe(seconds)

    def count(self, operation: str, outcome: str, cache: str, count: int) -> None:
        """Count answered cases, computed (`miss`) or from the cache (`hit`)."""
        self._cases.labels(operation, outcome, cache).inc(count)

    def look_up(self, manager: JobManager, queries: QueryService, jobs: Tally[Status]) -> None:
        """Update the gauges and the fault counters; `jobs` has the number of jobs of each status."""
        stored, executor = queries.cache.statistics(), queries.executor
        values = {
            "queued_queries": queries.queued,
            "queued_cases": manager.queued_cases,
            "running_chunks": manager.running_chunks,
            "workers": len(executor.worker_pids),
            "cache_bytes": stored.bytes,
            "cache_segments": stored.segments,
            "cache_cases": stored.cases,
        }
        for name, value in values.items():
            self._gauges[name].set(value)
        for place, used in (("pool", not executor.on_cluster), ("cluster", executor.on_cluster)):
            self._width.labels(place).set(executor.capacity if used else 0)
        # The executor and the queries keep their own totals; the counters are advanced by the difference.
        self._restarts.inc(executor.restarts - self._restarts_counted)
        self._restarts_counted = executor.restarts
        self._start_failures.inc(executor.start_failures - self._start_failures_counted)
        self._start_failures_counted = executor.start_failures
        self._implausible.inc(queries.implausible - self._implausible_counted)
        self._implausible_counted = queries.implausible
        for status in get_args(Status):
            self._jobs.labels(status).set(jobs[status])


@dataclass
class Services:
    """Shared state of a running application, in `app.state.services`.

    The fields after `clock` are set by the lifespan, because they need the event loop or the data folder.
    """

    settings: Settings
    metrics: Metrics
    keys: ApiKeyStore
    quotas: QuotaStore
    audit: AuditLog
    streams: ConcurrencyLimit
    owner_queries: ConcurrencyLimit
    traces: TracerProvider | None
    clock: Clock

    cache: ResultCache = field(init=False)
    downloads: Downloads = field(init=False)
    executor: Executor = field(init=False)
    queries: QueryService = field(init=False)
    jobs: JobManager = field(init=False)
    stopping: asyncio.Event = field(init=False)
    ending: "asyncio.Future[None]" = field(init=False)
    """Future that is done once unfinished requests are to be refused, near the end of the grace period."""
    reading: CapacityLimiter = field(init=False)
    parsing: asyncio.Lock = field(init=False)
    mcp: ASGIApp = field(init=False)
    """ASGI application that answers messages of the Model Context Protocol."""


def services_of(request: Request) -> Services:
    """Return the shared state of the application that received a request."""
    services: Services = request.app.state.services
    return services


async def unless_left(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """Return the result of a coroutine, and cancel it if the client leaves or the service stops.

    Raises
    ------
    HTTPException
        400 if the client has left. Nobody receives it, but the log and the metrics record it.
    PoolUnavailableError
        If the service refuses unfinished requests, near the end of its grace period.
    """
    working = asyncio.ensure_future(work)
    left = asyncio.ensure_future(disconnected(request))
    try:
        events: tuple[asyncio.Future[Any], ...] = (working, left, services_of(request).ending)
        await asyncio.wait(events, return_when=asyncio.FIRST_COMPLETED)
    finally:
        left.cancel()
        if not working.done():
            working.cancel()
            await asyncio.wait([working])
    if not working.cancelled():
        return working.result()
    if left.done() and not left.cancelled():
        raise HTTPException(HTTPStatus.BAD_REQUEST, "the client has left")
    raise PoolUnavailableError("the service is stopping")


async def in_time(work: Coroutine[Any, Any, Result], seconds: float) -> Result:
    """Return the result of a coroutine, which may take `seconds` at most.

    Raises
    ------
    TaskTimeoutError
        If the coroutine has not finished in time.
    """
    try:
        async with asyncio.timeout(seconds):
            return await work
    except TimeoutError:
        raise TaskTimeoutError(f"not finished after {seconds:g} s") from None


async def disconnected(request: Request) -> None:
    """Wait until the client closes the connection. The body must have been read before."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def executor_for(settings: Settings) -> Executor:
    """Return the executor that the settings select; it is not started."""
    if settings.executor == "in-process":
        return InThreadExecutor(task_seconds=settings.task_seconds)
    if settings.executor == "dask":
        from service.workers.dask_executor import DaskExecutor  # noqa: PLC0415 (an extra that few have installed)

        return DaskExecutor(
            address=settings.dask_scheduler, workers=settings.workers, task_seconds=settings.task_seconds
        )
    return ProcessPool(workers=settings.workers, task_seconds=settings.task_seconds)
