"""A runner that squares numbers, over a real pool and a real folder."""

import asyncio
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from service.cache.cache import ResultCache
from service.jobs.manager import JobManager
from service.jobs.models import Case, CaseResult, JobState
from service.jobs.store import JobStore
from service.operations import KeyedRequest
from service.queries import QueryService
from service.workers.base import Executor
from tests.service.questions import SQUARE, Question


@asynccontextmanager
async def running(folder: Path, executor: Executor, max_queued_cases: int = 100_000) -> AsyncIterator[JobManager]:
    with ResultCache(folder / "data", memory_bytes=50_000_000, disk_bytes=10**9) as cache:
        queries = QueryService(cache, executor, {"square": SQUARE})
        jobs = JobStore(folder / "data", job_days=7.0)
        runner = JobManager(queries, jobs, max_queued_cases=max_queued_cases)
        await runner.start()
        try:
            yield runner
        finally:
            await runner.stop()


def case(question: Question, custom_id: str | None = None) -> Case:
    return Case(KeyedRequest.of("square", question), custom_id)


def cases(numbers: Iterable[float], folder: Path | str = "", how: str = "square", seconds: float = 0.0) -> list[Case]:
    return [case(Question(number, str(folder), how, seconds), f"case {number:g}") for number in numbers]


async def sliced(whole: Sequence[Case], size: int = 200) -> AsyncIterator[Sequence[Case]]:
    for i in range(0, len(whole), size):
        yield whole[i : i + size]


async def accepted(runner: JobManager, whole: Sequence[Case], owner: str = "local") -> JobState:
    state, new = await runner.accept("square", sliced(whole), owner=owner)
    assert new
    assert state.status == "accepted"
    return state


async def follow(runner: JobManager, job: JobState) -> JobState:
    state = job
    async for state in runner.changes(job.id):  # noqa: B007
        pass
    return state


async def ended(runner: JobManager, job: JobState) -> JobState:
    state = await follow(runner, job)
    assert state.final
    return state


async def until_done(runner: JobManager, job: JobState, count: int) -> None:
    while ((await runner.job(job.id)) or job).done < count:  # noqa: ASYNC110 (there may be no change left to wait for)
        await asyncio.sleep(0.02)


async def all_results(runner: JobManager, job: JobState, start: int = 0, limit: int | None = None) -> list[CaseResult]:
    found = []
    async for results in runner.results(job.id, start=start, limit=limit):
        assert 0 < len(results) <= 200
        found += results
    return found


def squares(results: Sequence[CaseResult]) -> list[float]:
    return [result.record.answer["square"] for result in results if result.record is not None]


async def collect(runner: JobManager, whole: Sequence[Case]) -> list[CaseResult]:
    return [result async for result in runner.run_now("square", whole)]
