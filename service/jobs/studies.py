"""Studies of uncertainty. Each sample is a case like those of a batch: cached, and computed by the same executor."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.cache.record import CaseResult, Record
from service.errors import InvalidBodyError
from service.jobs.models import JobCase
from service.operations import OPERATIONS, KeyedRequest, StudyOperation, study_of
from service.queries import Answered, QueryService

PART = 320
"""Number of samples handed to the runner at a time: about a second of work, after which progress is reported."""
PARTIAL = ("probability", "outcomes", "convergence")
"""Fields of an answer that are also in its partial answers, where they exist."""

RunCases: TypeAlias = Callable[[str, Sequence[JobCase], int], AsyncGenerator[CaseResult, None]]
"""Function that computes cases and yields their results as they finish. Its arguments are the operation, the cases, and
the number of cases that may follow."""
Report: TypeAlias = Callable[[dict[str, Any], dict[str, Any] | None], Awaitable[None]]
"""Function that receives the progress of a study, and its partial answer if that has changed."""


@dataclass(eq=False)
class RunningStudy:
    """A study in flight, shared by all equal requests."""

    urgent: bool
    reports: list[Report]
    done: "asyncio.Future[Record | None]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())
    """Future of the record of the study; None if it ended without one."""
    latest: tuple[dict[str, Any], dict[str, Any] | None] | None = None
    """Latest progress and partial answer."""

    async def report(self, progress: dict[str, Any], partial: dict[str, Any] | None) -> None:
        """Record the progress, and report it to all requests and jobs that follow the study."""
        before = self.latest[1] if self.latest else None
        self.latest = progress, partial or before
        for report in list(self.reports):
            await report(progress, partial)


class StudyService:
    """Answers studies. Equal studies in flight share one computation.

    Parameters
    ----------
    queries
        Query service with the cache.
    """

    def __init__(self, queries: QueryService) -> None:
        self._queries = queries
        self._in_flight: dict[str, RunningStudy] = {}

    async def answer(
        self,
        operation: str,
        request: KeyedRequest,
        run: RunCases,
        *,
        study: Any = None,
        urgent: bool = True,
        take: Callable[[int], None] = lambda _: None,
        report: Report | None = None,
        limiter: CapacityLimiter | None = None,
    ) -> Answered:
        """Return the record of a study, and whether it came from the cache or from an equal study in flight.

        If an equal study in flight ends without an answer, for example because it is cancelled or its client's quota is
        used up, the study is computed here. An urgent study never waits for one that is not urgent.

        Parameters
        ----------
        study
            Validated request, if the caller has it.
        run, take, report, limiter
            As for `run_study`.
        """
        key, reports = request.key, [report] if report is not None else []
        # The loop checks again after each wait: after a study ended without an answer, another request may have started
        # the study anew.
        while (other := self._in_flight.get(key)) is not None and (other.urgent or not urgent):
            record = await self._follow(other, reports)
            if record is not None:
                return record, "hit"
        own = self._in_flight[key] = RunningStudy(urgent, reports)
        record = None
        try:
            record = await self._queries.result(key)  # The result may have been stored since the caller looked it up.
            if record is not None:
                return record, "hit"
            study = study or await run_sync(OPERATIONS[operation].request.model_validate_json, request.json)
            found = await run_study(operation, study, run, take=take, report=own.report, limiter=limiter)
            record = await run_sync(self._queries.cache.put, Record(key, operation, request.json, found))
            return record, "miss"
        finally:
            if self._in_flight.get(key) is own:
                del self._in_flight[key]
            # Followers are woken even after a failure. The first of them then computes the study itself.
            own.done.set_result(record)

    async def _follow(self, other: RunningStudy, reports: Sequence[Report]) -> Record | None:
        """Wait for another computation of the study, and report its progress."""
        if other.latest is not None:
            for report in reports:
                await report(*other.latest)
        other.reports += reports
        try:
            await asyncio.wait([other.done])
        finally:
            other.reports = [each for each in other.reports if each not in reports]
        return other.done.result()


async def run_study(
    operation: str,
    study: Any,
    run: RunCases,
    *,
    take: Callable[[int], None],
    report: Report,
    limiter: CapacityLimiter | None,
) -> dict[str, Any]:
    """Compute a study, and return its answer without key and versions.

    Parameters
    ----------
    study
        Validated request.
    run
        Function that computes samples.
    take
        Function called with the cost of samples before they are computed. [ordinary cases]
    report
        Function called after each part of the samples, and with a partial answer at the end of each round.
    limiter
        Limiter of the threads in which samples are validated.
    """
    found = study_of(operation)
    sample = await run_sync(found.sampler, study)
    steps = (await run_sync(study.study)).steps()
    batch, answer = await run_sync(advance, steps, None)
    done = 0
    while answer is None:
        partial = None if batch.so_far is None else await run_sync(partial_answer, found, batch.so_far)
        if partial is not None:
            await report(progress_of(study, done, partial), partial)
        results: list[Any] = []
        for begin in range(0, len(batch.points), PART):
            points = batch.points[begin : begin + PART]
            # `list` makes the lazy `map` validate the samples in the thread.
            requests = await run_sync(list, map(sample, points), limiter=limiter)
            cases = {number: JobCase(each) for number, each in enumerate(requests) if each is not None}
            take(sum(case.request.work for case in cases.values()))
            done += len(points)
            results += await _findings(found, len(points), cases, study.sampling.max_samples - done, run)
            await report(progress_of(study, done, partial), None)
        batch, answer = await run_sync(advance, steps, results)
    content = await run_sync(found.answer, answer)
    await report(progress_of(study, done, content), None)
    return content


async def _findings(
    operation: StudyOperation, count: int, cases: Mapping[int, JobCase], more: int, run: RunCases
) -> list[Any]:
    """Compute samples, and return the results that the study needs. Samples without a case get `operation.outside`."""
    found, numbers = [operation.outside] * count, list(cases)
    async with aclosing(run(operation.sample, list(cases.values()), more)) as results:
        async for result in results:
            found[numbers[result.number]] = _finding(operation, result)
    return found


def _finding(operation: StudyOperation, result: CaseResult) -> Any:
    """Return the result that the study needs from a sample."""
    if result.record is not None:
        return operation.finding(result.record.answer)
    invalid = (result.problem or {}).get("type") == InvalidBodyError.type
    return operation.outside if invalid else operation.failed


def advance(steps: Generator[Any, Any, Any], found: Sequence[Any] | None) -> tuple[Any, Any]:
    """Return the next batch of samples and None or, when the study is complete, None and its answer."""
    try:
        return (next(steps) if found is None else steps.send(found)), None
    except StopIteration as end:
        return None, end.value


def partial_answer(operation: StudyOperation, so_far: Any) -> dict[str, Any]:
    """Return the partial answer of a study: curve or outcomes so far, and the history of the sampling."""
    answer = operation.answer(so_far)
    return {name: answer[name] for name in PARTIAL if name in answer}


def progress_of(study: Any, samples: int, answer: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the progress of a study: samples taken and allowed, half width requested and, once known, reached."""
    sampling = study.sampling
    progress = {"samples": samples, "max_samples": sampling.max_samples, "requested_half_width": sampling.half_width}
    return progress if answer is None else progress | {"half_width": answer["convergence"]["half_width"][-1]}
