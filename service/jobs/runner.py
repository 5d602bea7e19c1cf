"""Runs cases: chunks of them take turns in the executor, those of batches answered at once and those of jobs."""

import asyncio
import math
from collections import Counter, defaultdict
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from anyio.to_thread import run_sync

from service.cache.record import Record
from service.errors import ComputationCancelled, PoolUnavailableError, QueueFullError, case_problem
from service.fairness import ChunkSizer, FairSemaphore, Permit
from service.jobs.models import CaseResult, JobCase
from service.operations import KeyedRequest
from service.queries import Answered, QueryService, Rate

CHUNK_SECONDS = 0.1
"""Time that one chunk takes: short, so that a client sees the first results soon."""
RETRY_SECONDS = 0.1
"""Pause before a case that other work was computing and gave up is tried again."""
TEMPORARY = (ComputationCancelled, PoolUnavailableError, QueueFullError)
"""Errors that do not come from the case itself: it is tried again."""


@dataclass(frozen=True, slots=True)
class CaseAnswer:
    """Answer to all cases with one key: a record or a problem.

    `own` says whether it was computed here rather than by other work in flight.
    """

    key: str
    record: Record | None
    problem: dict[str, Any] | None
    own: bool


@dataclass(slots=True)
class ChunkAnswers:
    """What a chunk has brought so far."""

    found: list[CaseAnswer] = field(default_factory=list)
    again: list[str] = field(default_factory=list)
    """Keys of cases without an answer for a reason that is not their own: they are tried again."""
    refused: Exception | None = None
    """Why no worker took some of them, if that is the reason."""

    @classmethod
    def of(cls, futures: Mapping[str, "asyncio.Future[Answered]"], *, own: bool) -> "ChunkAnswers":
        """Sort the answers of a chunk; one that is not there yet counts as given up."""
        answers = cls()
        for key, future in futures.items():
            error = future.exception() if future.done() and not future.cancelled() else ComputationCancelled()
            if error is None:
                answers.found.append(CaseAnswer(key, future.result()[0], None, own))
            elif isinstance(error, TEMPORARY) or not isinstance(error, Exception):
                answers.again.append(key)
                if isinstance(error, PoolUnavailableError | QueueFullError):
                    answers.refused = error
            else:
                answers.found.append(CaseAnswer(key, None, case_problem(error), own))
        return answers


Wait: TypeAlias = Callable[["asyncio.Future[Any]", Callable[[], object], float | None], Awaitable[bool]]
"""Waits for work, which its second argument gives up; returns whether it ended within so many seconds, if limited."""


async def wait_for(work: "asyncio.Future[Any]", stop: Callable[[], object], seconds: float | None) -> bool:
    """Wait for the work of a chunk, and give it up when cancelled."""
    try:
        done, _ = await asyncio.wait([work], timeout=seconds)
    except asyncio.CancelledError:
        stop()
        raise
    return bool(done)


class CaseRunner:
    """Runs cases in chunks, for which owners take turns.

    Parameters
    ----------
    queries
        Computes the cases.
    rate
        Counts every case of `run` that is done.
    """

    def __init__(self, queries: QueryService, rate: Rate) -> None:
        self.queued: Counter[str] = Counter()
        """Cases of `run` that wait or are being computed, by owner."""
        self.permits = FairSemaphore(lambda: queries.chunk_limit)
        """For chunks in the executor: what a client waits for goes before jobs."""
        self._queries = queries
        self._rate = rate
        self._sizers: dict[str, ChunkSizer] = defaultdict(lambda: ChunkSizer(CHUNK_SECONDS))

    async def run(
        self, operation: str, cases: Sequence[JobCase], *, owner: str, urgent: bool = True
    ) -> AsyncGenerator[CaseResult, None]:
        """Yield the result of every case as it finishes; closed, it stops the work.

        Owners take turns; what is urgent goes before jobs.

        Raises
        ------
        PoolUnavailableError
            If no worker can take the cases.
        """
        left, work = len(cases), set[asyncio.Task[list[CaseAnswer]]]()
        self.queued[owner] += left
        try:
            numbers: dict[str, list[int]] = defaultdict(list)
            for number, case in enumerate(cases):
                numbers[case.request.key].append(number)
            known: Mapping[str, Record] = await run_sync(self._queries.cache.get_many, list(numbers))
            finished = [CaseAnswer(key, record, None, own=False) for key, record in known.items()]
            missing = [cases[same[0]].request for key, same in numbers.items() if key not in known]
            work |= self._begin(operation, missing, owner, urgent=urgent)
            while True:
                for answer in finished:
                    for number in numbers[answer.key]:
                        left -= 1
                        self.queued[owner] -= 1
                        cached = not answer.own or number != numbers[answer.key][0]
                        yield CaseResult(number, cases[number].custom_id, answer.record, answer.problem, cached)
                if not work:
                    return
                done, work = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
                finished = [answer for chunk in done for answer in chunk.result()]
                self._rate.add(sum(len(numbers[answer.key]) for answer in finished))
        finally:
            self.queued -= Counter({owner: left})  # The subtraction also forgets owners who have nothing queued.
            for chunk in work:
                chunk.cancel()
            if work:
                await asyncio.wait(work)

    def _begin(
        self, operation: str, missing: Sequence[KeyedRequest], owner: str, *, urgent: bool
    ) -> set["asyncio.Task[list[CaseAnswer]]"]:
        share = math.ceil(len(missing) / self._queries.executor.capacity)
        size = max(1, min(self._sizers[operation].cases, share))
        chunks = [missing[i : i + size] for i in range(0, len(missing), size)]
        work = {asyncio.create_task(self._compute(operation, chunk, owner, urgent=urgent)) for chunk in chunks}
        for task in work:  # Errors are retrieved, so that asyncio does not report them if nothing waits.
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return work

    async def _compute(
        self, operation: str, chunk: Sequence[KeyedRequest], owner: str, *, urgent: bool
    ) -> list[CaseAnswer]:
        """Compute these cases; those that were in flight elsewhere and given up there are tried again."""
        found: list[CaseAnswer] = []
        left = {case.key: case for case in chunk}
        while True:
            permit = await self.permits.acquire(owner, urgent=urgent)
            cases, sizer = list(left.values()), self._sizers[operation]
            async with aclosing(self.run_chunk(operation, cases, permit, sizer)) as parts:
                async for answers in parts:
                    if isinstance(answers.refused, PoolUnavailableError):
                        raise answers.refused
                    found += answers.found
                    for answer in answers.found:
                        del left[answer.key]
            if not left:
                return found
            await asyncio.sleep(RETRY_SECONDS)

    async def run_chunk(
        self,
        operation: str,
        cases: Sequence[KeyedRequest],
        permit: Permit,
        sizer: ChunkSizer,
        wait: Wait = wait_for,
        longest: float | None = None,
    ) -> AsyncGenerator[ChunkAnswers, None]:
        """Compute a chunk; yield the answers of the cases it computes, then those from other work in flight.

        Parameters
        ----------
        permit
            Released when the executor is done with the chunk.
        sizer
            Notes how long the cases took and how large their answers are.
        wait
            Waits for the work.
        longest
            A chunk of several cases that takes longer is given up, and the next ones are smaller. [s]
        """
        chunk = self._queries.begin(operation, cases, permit.release)
        if not await wait(chunk.kept, chunk.stop, longest if len(cases) > 1 else None):
            chunk.stop()
            sizer.shrink(len(cases))
            await asyncio.wait([chunk.kept])
        answers = ChunkAnswers.of(chunk.own, own=True)
        if not chunk.running.cancelled() and chunk.running.exception() is None:
            sizer.note(chunk.seconds, sum(len(answer.record.json) for answer in answers.found if answer.record))
        yield answers
        if chunk.shared:
            others = asyncio.ensure_future(asyncio.wait(chunk.shared.values()))
            await wait(others, others.cancel, None)
            yield ChunkAnswers.of(chunk.shared, own=False)
