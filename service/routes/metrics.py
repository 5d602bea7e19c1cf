"""What the service has done and how it is, for Prometheus."""

from collections import Counter as Tally
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

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

from service.batches.runner import Runner
from service.batches.small import CaseResult
from service.engine import Operation
from service.executors.face import Executor
from service.jobs.slices import CaseState
from service.jobs.store import JobState, JobStore, Status
from service.keys import SCHEMA_VERSION
from service.results.cache import ResultCache
from service.results.record import Record
from service.routes.contract import problems
from solver import ENGINE_VERSION

router = APIRouter(tags=["health"])

SECONDS = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Bounds of the histogram: a cached answer takes well under a millisecond, the longest query a minute."""
STORED = "stored"
"""Outcome of a case of a job whose result was there: nobody looked into it."""


class Metrics:
    """Counts what is done; the rest is looked up when it is asked for."""

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
                "cases_per_second": "Cases of batches and jobs done in a second, lately",
                "running_chunks": "Chunks of jobs being made, computed or kept",
                "chunk_width": "Chunks that can be computed at the same time, here or on the cluster",
                "workers": "Worker processes that are up",
                "worker_restarts": "Worker processes that had to be replaced since the start",
                "cache_bytes": "Size of the results on the disk",
                "cache_segments": "Files of results",
                "cache_cases": "Results on the disk",
            }.items()
        }
        self._jobs = Gauge("ricochet_jobs", "Jobs that are kept", ("status",), registry=registry)
        build = {"engine_version": ENGINE_VERSION, "schema_version": SCHEMA_VERSION}
        Info("ricochet_build", "Versions of the service", registry=registry).info(build)

    def observe(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request."""
        self._seconds.labels(method, route, status).observe(seconds)

    def count_hit(self, record: Record) -> None:
        """Count a result that was there."""
        self._cases.labels(record.operation, outcome_of(record.answer), "hit").inc()

    def count_problem(self, operation: str, problem: Mapping[str, Any], count: int = 1) -> None:
        """Count cases that have no answer."""
        self._cases.labels(operation, problem["type"].rpartition(":")[2], "miss").inc(count)

    def count_result(self, operation: str, result: CaseResult) -> None:
        """Count a case of a batch, unless it was counted when it was computed."""
        if result.problem is not None:
            self.count_problem(operation, result.problem)
        elif result.cached and result.record is not None:
            self.count_hit(result.record)

    def count_stored(self, operation: str, count: int) -> None:
        """Count cases of a job whose results were there."""
        self._cases.labels(operation, STORED, "hit").inc(count)

    def counting(self, name: str, operation: Operation) -> Operation:
        """Return the operation, whose answers are counted from now on as they are made."""

        def answer(request: Any, result: Any) -> Any:
            made = operation.answer(request, result)
            self._cases.labels(name, outcome_of(made[0]), "miss").inc()
            return made

        return replace(operation, answer=answer)

    def look_up(self, runner: Runner, executor: Executor, cache: ResultCache, jobs: list[JobState]) -> None:
        """Note how things are now."""
        stored = cache.statistics()
        values = {
            "queued_queries": executor.queued,
            "queued_cases": runner.queued_cases,
            "cases_per_second": runner.rate,
            "running_chunks": runner.running_chunks,
            "chunk_width": executor.width,
            "workers": len(executor.worker_pids),
            "worker_restarts": executor.restarts,
            "cache_bytes": stored.bytes,
            "cache_segments": stored.segments,
            "cache_cases": stored.cases,
        }
        for name, value in values.items():
            self._gauges[name].set(value)
        tally = Tally(job.status for job in jobs)
        for status in get_args(Status):
            self._jobs.labels(status).set(tally[status])


class CountedJobs(JobStore):
    """Jobs whose cases are counted as they are marked."""

    def __init__(self, folder: Path, metrics: Metrics, *, job_days: float) -> None:
        super().__init__(folder, job_days=job_days)
        self._metrics = metrics

    def mark(
        self, job: int, states: Mapping[int, CaseState], problems: Mapping[int, dict[str, Any]] | None = None
    ) -> JobState:
        """Note results of cases."""
        state = super().mark(job, states, problems)
        for problem in (problems or {}).values():
            self._metrics.count_problem(state.operation, problem)
        self._metrics.count_stored(state.operation, Tally(states.values())[CaseState.CACHED])
        return state


def outcome_of(answer: Mapping[str, Any]) -> str:
    """Return how a run or a search ended; a fit that has an answer was found."""
    outcome: str = answer.get("outcome") or answer.get("status") or "fitted"
    return outcome


@router.get("/metrics", response_class=PlainTextResponse, response_description="The metrics.", responses=problems(500))
async def metrics(request: Request) -> Response:
    """Tell what the service has done and how it is, in the text format of Prometheus."""
    state = request.app.state
    state.metrics.look_up(state.runner, state.executor, state.cache, await state.runner.jobs(None))
    return Response(generate_latest(state.metrics.registry), media_type=CONTENT_TYPE_LATEST)
