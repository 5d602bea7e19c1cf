"""Helpers for tests of the job manager with jobs that square numbers, in a real folder."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from service.cache.cache import ResultCache
from service.cache.record import CaseResult
from service.clock import SYSTEM, Clock
from service.jobs.manager import JobManager
from service.jobs.models import JobCase, JobState
from service.jobs.store import JobStore
from service.operations import KeyedRequest, Operation
from service.queries import QueryService
from service.workers.executor import Executor
from tests.service.questions import SQUARE, Question


@asynccontextmanager
async def running(
    folder: Path,
    executor: Executor,
    operations: Mapping[str, Operation] | None = None,
    clock: Clock = SYSTEM,
    **settings: Any,
) -> AsyncIterator[JobManager]:
    """Run a job manager with these operations, by default only the operation of `questions`."""
    with ResultCache(folder / "data", memory_bytes=50_000_000, disk_bytes=10**9) as cache:
        queries = QueryService(cache, executor, operations or {"square": SQUARE})
        jobs = JobStore(folder / "data", job_days=7.0, operations=queries.operations, clock=clock)
        manager = JobManager(queries, jobs, **{"max_queued_cases": 100_000} | settings)
        await manager.start()
        try:
            yield manager
        finally:
            await manager.stop()


def case(question: Question, custom_id: str | None = None) -> JobCase:
    return JobCase(KeyedRequest.of("square", question), custom_id)


def cases(
    numbers: Iterable[float], folder: Path | str = "", how: str = "square", seconds: float = 0.0
) -> list[JobCase]:
    return [case(Question(number, str(folder), how, seconds), f"case {number:g}") for number in numbers]


async def sliced(whole: Sequence[JobCase], size: int = 200) -> AsyncIterator[Sequence[JobCase]]:
    for i in range(0, len(whole), size):
        yield whole[i : i + size]


async def accepted(manager: JobManager, whole: Sequence[JobCase], owner: str = "local") -> JobState:
    state, new = await manager.accept("square", sliced(whole), owner=owner)
    assert new
    assert state.status == "accepted"
    return state


async def until(claim: Callable[[], bool]) -> None:
    """Wait until a condition holds; fail after two minutes."""
    async with asyncio.timeout(120.0):
        while not claim():  # noqa: ASYNC110 (other processes set no event)
            await asyncio.sleep(0.02)


async def follow(manager: JobManager, job: JobState) -> JobState:
    state = job
    async for state in manager.changes(job.id):  # noqa: B007
        pass
    return state


async def ended(manager: JobManager, job: JobState) -> JobState:
    state = await follow(manager, job)
    assert state.final
    return state


async def until_done(manager: JobManager, job: JobState, count: int) -> None:
    while ((await manager.job(job.id)) or job).done < count:  # noqa: ASYNC110 (there may be no change left to wait for)
        await asyncio.sleep(0.02)


async def all_results(manager: JobManager, job: JobState, start: int = 0, limit: int | None = None) -> list[CaseResult]:
    found = []
    async for results in manager.results(job.id, list, start=start, limit=limit):
        assert 0 < len(results) <= 200
        found += results
    return found


def squares(results: Sequence[CaseResult]) -> list[float]:
    return [result.record.answer["square"] for result in results if result.record is not None]


async def collect(manager: JobManager, whole: Sequence[JobCase]) -> list[CaseResult]:
    return [result async for result in manager.run_now("square", whole)]
