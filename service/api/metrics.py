"""What the service has done and how it is, for Prometheus."""

from collections import Counter as Tally
from typing import get_args

from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Info,
    disable_created_metrics,
    generate_latest,
)

from service.api.contract import problems
from service.auth.dependencies import READ
from service.cache.cache import ResultCache
from service.jobs.manager import JobManager
from service.jobs.models import Status
from service.operations import SCHEMA_VERSION
from service.workers import Executor
from solver import ENGINE_VERSION

router = APIRouter(tags=["health"], dependencies=[READ])

SECONDS = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Bounds of the histogram: a cached answer takes well under a millisecond, the longest query a minute."""


class Metrics:
    """Counts what is done; the rest is looked up for each answer."""

    def __init__(self) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call] # they would be a series more for each of the others
        self.registry = registry = CollectorRegistry()
        labels = ("operation", "outcome", "cache")
        self._cases = Counter("ricochet_cases", "Cases answered, by how they ended", labels, registry=registry)
        self._seconds = Histogram(
            "ricochet_request_seconds",
            "Time from a request to the end of its answer",
            ("method", "route", "status"),
            buckets=SECONDS,
            registry=registry,
        )
        self._gauges = {
            name: Gauge(f"ricochet_{name}", text, registry=registry)
            for name, text in {
                "queued_queries": "Single queries that wait for a worker",
                "queued_cases": "Cases of batches and jobs that wait or are being computed",
                "running_chunks": "Chunks of jobs being made, computed or kept",
                "chunk_width": "Chunks that can be computed at the same time, here or on the cluster",
                "workers": "Worker processes that are up",
                "cache_bytes": "Size of the results on the disk",
                "cache_segments": "Files of results",
                "cache_cases": "Results on the disk",
            }.items()
        }
        self._restarts = Counter(
            "ricochet_worker_restarts", "Worker processes that had to be replaced since the start", registry=registry
        )
        self._restarts_counted = 0
        self._jobs = Gauge("ricochet_jobs", "Jobs that are kept", ("status",), registry=registry)
        build = {"engine_version": ENGINE_VERSION, "schema_version": SCHEMA_VERSION}
        Info("ricochet_build", "Versions of the service", registry=registry).info(build)

    def observe(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request."""
        self._seconds.labels(method, route, status).observe(seconds)

    def count(self, operation: str, outcome: str, cache: str, count: int) -> None:
        """Count cases that have been answered, computed (`miss`) or from the cache (`hit`)."""
        self._cases.labels(operation, outcome, cache).inc(count)

    def look_up(self, manager: JobManager, executor: Executor, cache: ResultCache, jobs: Tally[Status]) -> None:
        """Note how things are now; `jobs` by status."""
        stored = cache.statistics()
        values = {
            "queued_queries": executor.queued,
            "queued_cases": manager.queued_cases,
            "running_chunks": manager.running_chunks,
            "chunk_width": executor.capacity,
            "workers": len(executor.worker_pids),
            "cache_bytes": stored.bytes,
            "cache_segments": stored.segments,
            "cache_cases": stored.cases,
        }
        for name, value in values.items():
            self._gauges[name].set(value)
        self._restarts.inc(executor.restarts - self._restarts_counted)
        self._restarts_counted = executor.restarts
        for status in get_args(Status):
            self._jobs.labels(status).set(jobs[status])


@router.get("/metrics", response_class=PlainTextResponse, response_description="The metrics.", responses=problems(500))
async def metrics(request: Request) -> Response:
    """Return what the service has done and how it is, in the text format of Prometheus."""
    services = request.app.state.services
    services.metrics.look_up(services.jobs, services.executor, services.cache, await services.jobs.tally())
    content = await run_sync(generate_latest, services.metrics.registry)  # thousands of lines of a busy service
    return Response(content, media_type=CONTENT_TYPE_LATEST)
