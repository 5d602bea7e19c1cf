"""Small work, answered while the client waits: before all jobs, and as it finishes."""

import asyncio
import math
from collections import defaultdict
from collections.abc import AsyncGenerator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

from service.admission import Rate
from service.batches.pace import Pace
from service.batches.turns import Slots
from service.engine import Engine, Wanted
from service.errors import ComputationCancelled, PoolUnavailableError, QueueFullError, case_problem
from service.jobs.slices import Case
from service.keys import result_key
from service.results.record import Record

CHUNK_SECONDS = 0.1
"""Of work in a chunk: the client sees the first results soon."""
RETRY_SECONDS = 0.1
"""Before a case that another was computing and gave up is tried again."""
THREADS = 1
"""It parses, and waits for the disk."""


@dataclass(frozen=True, slots=True)
class CaseResult:
    """What became of a case of a batch.

    Parameters
    ----------
    number
        In the order of the request, from 0.
    record, problem
        One of them. A problem lacks its `instance`; its pointers are into the request of the case.
    cached
        Whether nothing was computed for it.
    """

    number: int
    custom_id: str | None
    record: Record | None
    problem: dict[str, Any] | None
    cached: bool


@dataclass(frozen=True, slots=True)
class Outcome:
    """Answer of all cases with one key."""

    key: str
    record: Record | None
    problem: dict[str, Any] | None
    own: bool


class SmallWork:
    """Runs a few cases for someone who waits for them.

    Parameters
    ----------
    slots
        Places in the pool, shared with the jobs.
    rate
        Told of every case that is done.
    """

    def __init__(self, engine: Engine, slots: Slots, rate: Rate) -> None:
        self.queued = 0
        self._engine = engine
        self._slots = slots
        self._rate = rate
        self._paces: dict[str, Pace] = defaultdict(lambda: Pace(CHUNK_SECONDS))
        self._threads = CapacityLimiter(THREADS)

    async def run(self, operation: str, cases: Sequence[Case]) -> AsyncGenerator[CaseResult, None]:
        """Yield the result of every case as it finishes; closed, it stops the work.

        Raises
        ------
        PoolUnavailableError
            If no worker can take the cases.
        """
        left, work = len(cases), set[asyncio.Task[list[Outcome]]]()
        self.queued += left
        try:
            numbers, wanted, known = await run_sync(self._look_up, operation, cases, limiter=self._threads)
            finished = [Outcome(key, record, None, own=False) for key, record in known.items()]
            work |= self._begin(operation, wanted)
            while True:
                for outcome in finished:
                    for number in numbers[outcome.key]:
                        left -= 1
                        self.queued -= 1
                        cached = not outcome.own or number != numbers[outcome.key][0]
                        yield CaseResult(number, cases[number].custom_id, outcome.record, outcome.problem, cached)
                if not work:
                    return
                done, work = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
                finished = [outcome for chunk in done for outcome in chunk.result()]
                self._rate.add(sum(len(numbers[outcome.key]) for outcome in finished))
        finally:
            self.queued -= left
            for chunk in work:
                chunk.cancel()
            if work:
                await asyncio.wait(work)

    def _look_up(
        self, name: str, cases: Sequence[Case]
    ) -> tuple[dict[str, list[int]], list[Wanted | Outcome], Mapping[str, Record]]:
        """Group equal cases by their key; what of them is to be computed; what is in the cache."""
        numbers: dict[str, list[int]] = defaultdict(list)
        canonical = [case.request.canonical() for case in cases]
        for number, content in enumerate(canonical):
            numbers[result_key(name, content)].append(number)
        known = self._engine.cache.get_many(list(numbers))
        wanted: list[Wanted | Outcome] = []
        operation = self._engine.operations[name]
        for key, (first, *_) in numbers.items():
            if key not in known:
                request = cases[first].request
                try:
                    wanted.append(Wanted(key, canonical[first], request, operation.call(request)))
                except Exception as error:  # noqa: BLE001 (of this case alone)
                    wanted.append(Outcome(key, None, case_problem(error), own=True))
        return numbers, wanted, known

    def _begin(self, operation: str, wanted: Sequence[Wanted | Outcome]) -> set["asyncio.Task[list[Outcome]]"]:
        share = math.ceil(len(wanted) / self._engine.width)
        size = max(1, min(self._paces[operation].cases, share))
        chunks = [wanted[i : i + size] for i in range(0, len(wanted), size)]
        work = {asyncio.create_task(self._compute(operation, chunk)) for chunk in chunks}
        for task in work:  # seen, even if nobody waits for it any more
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
        return work

    async def _compute(self, operation: str, chunk: Sequence[Wanted | Outcome]) -> list[Outcome]:
        outcomes = [case for case in chunk if isinstance(case, Outcome)]
        left = {case.key: case for case in chunk if isinstance(case, Wanted)}
        while left:
            for outcome in await self._try(operation, list(left.values())):
                del left[outcome.key]
                outcomes.append(outcome)
            if left:
                await asyncio.sleep(RETRY_SECONDS)
        return outcomes

    async def _try(self, operation: str, wanted: Sequence[Wanted]) -> list[Outcome]:
        """Compute these cases; what was given up by another is left out."""
        place = await self._slots.take(urgent=True)
        chunk = self._engine.begin(operation, wanted, place.leave)
        answers = {**chunk.own, **chunk.shared}
        try:
            await asyncio.wait([chunk.kept])
            if chunk.shared:
                await asyncio.wait(chunk.shared.values())
        except asyncio.CancelledError:
            chunk.stop()
            raise
        outcomes, nbytes = [], 0
        for key, future in answers.items():
            error = None if future.cancelled() else future.exception()
            if future.cancelled() or isinstance(error, ComputationCancelled | QueueFullError):
                continue
            if isinstance(error, PoolUnavailableError) or not isinstance(error, Exception | None):
                raise error
            record = None if error else future.result()[0]
            nbytes += len(record.json) if record else 0
            outcomes.append(Outcome(key, record, case_problem(error) if error else None, own=key in chunk.own))
        self._paces[operation].note([finished.seconds for finished in chunk.pool.result()], nbytes)
        return outcomes
