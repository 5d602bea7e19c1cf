"""Studies of uncertainty: each sample is a case like those of a batch, through the same cache and executor."""

from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Mapping, Sequence
from contextlib import aclosing
from typing import Any, TypeAlias

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.errors import InvalidBodyError
from service.jobs.models import Case, CaseResult
from service.operations import UNCERTAIN, StudyOperation

PART = 320
"""Samples handed over at a time: about a second of work, after which other work gets in and progress is reported."""
PARTIAL = ("probability", "outcomes", "convergence")
"""What a partial answer has of an answer."""

RunCases: TypeAlias = Callable[[str, Sequence[Case]], AsyncGenerator[CaseResult, None]]
"""Yields the result of every case of an operation as it finishes."""
Report: TypeAlias = Callable[[dict[str, Any], dict[str, Any] | None], Awaitable[None]]
"""Takes the progress of a study and, if it is another than before, its partial answer."""


async def run_study(
    operation: str,
    study: Any,
    run: RunCases,
    *,
    take: Callable[[int], None] = lambda _: None,
    report: Report | None = None,
    limiter: CapacityLimiter | None = None,
) -> dict[str, Any]:
    """Return the answer to a study without key and version.

    Parameters
    ----------
    study
        The validated request.
    run
        Computes samples.
    take
        Called with the number of samples before they are computed.
    report
        Called after every part of the samples.
    limiter
        Of the threads in which samples are validated.
    """
    found = UNCERTAIN[operation]
    steps = (await run_sync(study.study)).steps()
    batch, answer = await run_sync(advance, steps, None)
    done = 0
    while answer is None:
        partial = None if batch.so_far is None else await run_sync(partial_answer, found, batch.so_far)
        results: list[Any] = []
        for begin in range(0, len(batch.points), PART):
            points = batch.points[begin : begin + PART]
            requests = await run_sync(found.requests, study, points, limiter=limiter)
            cases = {number: Case(each) for number, each in enumerate(requests) if each is not None}
            take(len(cases))
            results += await _findings(found, len(points), cases, run)
            done += len(points)
            if report is not None:
                await report(progress_of(study, done, partial), partial if begin == 0 else None)
        batch, answer = await run_sync(advance, steps, results)
    content = await run_sync(found.answer, answer)
    if report is not None:
        await report(progress_of(study, done, content), None)
    return content


async def _findings(operation: StudyOperation, count: int, cases: Mapping[int, Case], run: RunCases) -> list[Any]:
    """Return what a study keeps of some samples, of which those without a case are outside the contract."""
    found, numbers = [operation.outside] * count, list(cases)
    async with aclosing(run(operation.sample, list(cases.values()))) as results:
        async for result in results:
            found[numbers[result.number]] = _finding(operation, result)
    return found


def _finding(operation: StudyOperation, result: CaseResult) -> Any:
    """Return what a study keeps of a sample."""
    if result.record is not None:
        return operation.finding(result.record.answer)
    invalid = (result.problem or {}).get("type") == InvalidBodyError.type
    return operation.outside if invalid else operation.failed


def advance(steps: Generator[Any, Any, Any], found: Sequence[Any] | None) -> tuple[Any, Any]:
    """Return the next batch of a study, or None and its answer."""
    try:
        return (next(steps) if found is None else steps.send(found)), None
    except StopIteration as end:
        return None, end.value


def partial_answer(operation: StudyOperation, so_far: Any) -> dict[str, Any]:
    """Return the curve or the outcomes so far, and the history of the sampling."""
    answer = operation.answer(so_far)
    return {name: answer[name] for name in PARTIAL if name in answer}


def progress_of(study: Any, samples: int, answer: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return how far a study is: samples done and at most, width reached (once there is one) and requested."""
    sampling = study.sampling
    progress = {"samples": samples, "max_samples": sampling.max_samples, "requested_half_width": sampling.half_width}
    return progress if answer is None else progress | {"half_width": answer["convergence"]["half_width"][-1]}
