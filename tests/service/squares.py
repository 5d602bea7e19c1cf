"""A runner that squares numbers, over a real pool and a real folder."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from service.batches.runner import Case, CaseResult, JobState, Runner
from service.engine import Engine, Operation
from service.executors.face import Executor
from service.jobs.store import JobStore
from service.results.cache import ResultCache
from solver import ParameterError
from tests.service.questions import Question, work


def parse(text: bytes) -> Question:
    return Question(**json.loads(text))


def call(asked: Question) -> Any:
    if asked.how == "refused":
        raise ParameterError("search.lower", "must be below the upper end")
    return work, (asked,)


SQUARE = Operation(
    call=call,
    answer=lambda asked, result: ({"number": asked.number, "square": result, "warnings": []}, None),
    parse=parse,
)


@asynccontextmanager
async def running(folder: Path, executor: Executor, max_queued_cases: int = 100_000) -> AsyncIterator[Runner]:
    with ResultCache(folder / "data", memory_bytes=50_000_000, disk_bytes=10**9) as cache:
        engine = Engine(cache, executor, {"square": SQUARE})
        jobs = JobStore(folder / "data", job_days=7.0)
        runner = Runner(engine, jobs, max_queued_cases=max_queued_cases)
        await runner.start()
        try:
            yield runner
        finally:
            await runner.stop()


def cases(numbers: Iterable[float], folder: Path | str = "", how: str = "square", seconds: float = 0.0) -> list[Case]:
    return [Case(Question(number, str(folder), how, seconds), f"case {number:g}") for number in numbers]


async def sliced(whole: Sequence[Case], size: int = 200) -> AsyncIterator[Sequence[Case]]:
    for i in range(0, len(whole), size):
        yield whole[i : i + size]


async def accepted(runner: Runner, whole: Sequence[Case], owner: str = "local") -> JobState:
    state, new = await runner.accept("square", sliced(whole), owner=owner)
    assert new
    assert state.status == "accepted"
    return state


async def follow(runner: Runner, job: JobState) -> JobState:
    state = job
    async for state in runner.changes(job.id):  # noqa: B007
        pass
    return state


async def ended(runner: Runner, job: JobState) -> JobState:
    state = await follow(runner, job)
    assert state.final
    return state


async def until_done(runner: Runner, job: JobState, count: int) -> None:
    while ((await runner.job(job.id)) or job).done < count:  # noqa: ASYNC110 (there may be no change left to wait for)
        await asyncio.sleep(0.02)


async def all_results(runner: Runner, job: JobState, start: int = 0, limit: int | None = None) -> list[CaseResult]:
    found = []
    async for results in runner.results(job.id, start=start, limit=limit):
        assert 0 < len(results) <= 200
        found += results
    return found


def squares(results: Sequence[CaseResult]) -> list[float]:
    return [result.record.answer["square"] for result in results if result.record is not None]


async def collect(runner: Runner, whole: Sequence[Case]) -> list[CaseResult]:
    return [result async for result in runner.run_now("square", whole)]
