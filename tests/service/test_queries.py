"""Queries: cache lookup, shared computation, storing and the queue, with a real pool and folder.

Some calls create a folder, so that they fail if they run twice.
"""

import asyncio
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from service.cache.cache import NOT_CACHED, ResultCache
from service.errors import ComputationCancelled, QueriesWaitingError, WorkerCrashedError
from service.operations import Answer, KeyedRequest, Operation
from service.queries import Answered, QueryService
from service.schemas.quantities import Part
from service.workers import Call, CallResult
from service.workers.executor import Executor
from service.workers.process_pool import ProcessPool
from tests.faults.data_folder import keys_of, segments
from tests.service.opened import closed_later

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]


@dataclass
class Question:
    folder: Path | str
    number: int = 0

    def canonical(self) -> dict[str, Any]:
        return {"folder": str(self.folder), "number": self.number}


def question(request: bytes) -> Question:
    return Question(**orjson.loads(request))


def once(request: bytes) -> Answer:
    (Path(question(request).folder) / "ran").mkdir()
    return {"number": question(request).number, "result": None, "warnings": []}, None


def slow(request: bytes) -> Answer:
    time.sleep(0.2)
    return {"number": question(request).number, "result": None, "warnings": []}, None


def slower(request: bytes) -> Answer:
    time.sleep(0.5)
    return slow(request)


def deadly(_: bytes) -> Answer:
    signal.raise_signal(signal.SIGKILL)
    raise AssertionError


def draw(request: bytes) -> Answer:
    number = question(request).number
    column = np.linspace(number, number + 1, 5000)
    return {"number": number}, {f"column_{i}": column for i in range(12)}


def implausible(request: bytes) -> Answer:
    warning = {"code": "implausible", "detail": "no such strike exists"}
    return {"number": question(request).number, "result": None, "warnings": [warning]}, None


OPERATIONS = {
    "implausible": Operation("implausible", compute=implausible, request=Part),
    "once": Operation("once", compute=once, request=Part),
    "slow": Operation("slow", compute=slow, request=Part),
    "slower": Operation("slower", compute=slower, request=Part),
    "deadly": Operation("deadly", compute=deadly, request=Part),
    "trajectory": Operation("trajectory", compute=draw, request=Part),
}


@pytest.fixture
def service(pool: ProcessPool, tmp_path: Path) -> QueryService:
    return queries_on(tmp_path, pool)


def cache_in(folder: Path) -> ResultCache:
    return closed_later(ResultCache(folder / "data", memory_bytes=100_000_000, disk_bytes=10**9))


def queries_on(folder: Path, pool: Executor, max_waiting: int = 1000) -> QueryService:
    cache = cache_in(folder)
    return QueryService(cache, pool, OPERATIONS, max_waiting=max_waiting)


async def ask(service: QueryService, operation: str, folder: Path, number: int = 0) -> Answered:
    return await service.answer(operation, KeyedRequest.of(operation, Question(folder, number)))


async def test_equal_concurrent_requests_are_computed_once(service: QueryService, tmp_path: Path) -> None:
    answers = await asyncio.gather(*(ask(service, "once", tmp_path) for _ in range(20)))
    assert {status for _, status in answers} == {"miss"}
    assert len({id(record) for record, _ in answers}) == 1


async def test_repeated_request_is_a_cache_hit_also_after_a_restart(
    service: QueryService, pool: ProcessPool, tmp_path: Path
) -> None:
    first, miss = await ask(service, "once", tmp_path)
    second, hit = await ask(service, "once", tmp_path)
    service.cache.close()
    restarted = queries_on(tmp_path, pool)
    third, found = await ask(restarted, "once", tmp_path)
    assert (miss, hit, found) == ("miss", "hit", "hit")
    assert first.json == second.json == third.json
    assert (await restarted.result(first.key) or second).json == first.json
    assert await restarted.result("0" * 64) is None


async def test_client_that_disconnects_does_not_affect_others_that_wait(service: QueryService, tmp_path: Path) -> None:
    first = asyncio.ensure_future(ask(service, "slow", tmp_path))
    await asyncio.sleep(0.05)
    second = asyncio.ensure_future(ask(service, "slow", tmp_path))
    await asyncio.sleep(0.05)
    first.cancel()
    record, _ = await second
    assert record.answer["number"] == 0
    assert first.cancelled()


async def test_running_work_of_disconnected_clients_answers_a_repeated_query(
    service: QueryService, tmp_path: Path
) -> None:
    first = asyncio.ensure_future(ask(service, "once", tmp_path))
    await asyncio.sleep(0)
    first.cancel()
    record, _ = await ask(service, "once", tmp_path)  # A second run would raise FileExistsError.
    assert record.answer["result"] is None


async def test_failure_reaches_all_waiting_clients_and_is_not_cached(service: QueryService, tmp_path: Path) -> None:
    (tmp_path / "ran").mkdir()
    failures = await asyncio.gather(*(ask(service, "once", tmp_path) for _ in range(3)), return_exceptions=True)
    assert [type(failure) for failure in failures] == [FileExistsError] * 3
    (tmp_path / "ran").rmdir()
    _, status = await ask(service, "once", tmp_path)
    assert status == "miss"


async def test_request_that_kills_workers_fails_alone(service: QueryService, tmp_path: Path) -> None:
    others = [asyncio.ensure_future(ask(service, "slow", tmp_path, number)) for number in range(6)]
    with pytest.raises(WorkerCrashedError):
        await ask(service, "deadly", tmp_path)
    assert [record.answer["number"] for record, _ in await asyncio.gather(*others)] == list(range(6))


async def test_answers_have_a_warning_if_the_folder_cannot_be_written(service: QueryService, tmp_path: Path) -> None:
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "data").write_text("a file where the folder should be")
    service = queries_on(blocked, service.executor)
    record, status = await ask(service, "once", tmp_path)
    assert (status, record.answer["warnings"][0]["code"]) == ("miss", NOT_CACHED)
    _, status = await ask(service, "once", tmp_path)
    assert status == "hit"


def keyed(name: str, questions: list[Question]) -> list[KeyedRequest]:
    return [KeyedRequest.of(name, question) for question in questions]


async def test_chunk_shares_cases_that_are_being_computed(service: QueryService, tmp_path: Path) -> None:
    (tmp_path / "failing" / "ran").mkdir(parents=True)
    failing = Question(tmp_path / "failing", 1)
    single = asyncio.ensure_future(ask(service, "once", tmp_path))
    await asyncio.sleep(0)
    left: list[int] = []
    known, new = keyed("once", [Question(tmp_path), failing])
    assert set(service.in_flight([known.key, new.key])) == {known.key}
    chunk = asyncio.ensure_future(service.compute("once", [new], begun=lambda: left.append(1)))
    await asyncio.sleep(0)
    shared = service.in_flight([known.key, new.key])
    record, _ = await single
    assert (await shared[record.key])[0] is record
    for future in (shared[new.key], (await chunk).answers[new.key]):
        with pytest.raises(FileExistsError):
            await future
    assert left == [1]
    assert service.cache.known([record.key, new.key]) == {record.key}


async def test_single_query_survives_cancellation_of_the_chunk_it_shares(service: QueryService, tmp_path: Path) -> None:
    requests = keyed("slow", [Question(tmp_path, i) for i in range(8)])
    chunk = asyncio.ensure_future(service.compute("slow", requests))
    await asyncio.sleep(0.1)
    [given_up] = service.in_flight([requests[7].key]).values()
    single = asyncio.ensure_future(ask(service, "slow", tmp_path, 7))
    await asyncio.sleep(0.05)
    chunk.cancel()
    record, status = await single
    assert (record.answer["number"], status) == (7, "miss")
    with pytest.raises(ComputationCancelled):
        await given_up


async def test_number_of_waiting_queries_is_limited(pool: ProcessPool, tmp_path: Path) -> None:
    service = queries_on(tmp_path, pool, max_waiting=3)
    await ask(service, "slow", tmp_path, 99)
    queries = [asyncio.ensure_future(ask(service, "slow", tmp_path, i)) for i in range(2)]
    await asyncio.sleep(0.1)
    queries += [asyncio.ensure_future(ask(service, "slow", tmp_path, i)) for i in range(2, 10)]
    outcomes = await asyncio.gather(*queries, return_exceptions=True)
    refused = [outcome for outcome in outcomes if isinstance(outcome, QueriesWaitingError)]
    assert len(refused) == 5
    assert all(1 <= error.retry_after < 60 for error in refused)
    hit = await ask(service, "slow", tmp_path, 99)
    assert hit[1] == "hit"


async def test_owner_with_the_most_waiting_queries_loses_one_to_another_owner(
    pool: ProcessPool, tmp_path: Path
) -> None:
    service = queries_on(tmp_path, pool, max_waiting=3)

    def ask_as(number: int, owner: str) -> "asyncio.Future[Answered]":
        request = KeyedRequest.of("slow", Question(tmp_path, number))
        return asyncio.ensure_future(service.answer("slow", request, owner))

    crowd = [ask_as(number, "anna") for number in range(5)]  # Two of them run.
    while service.queued < 3:  # noqa: ASYNC110 (it sets no event)
        await asyncio.sleep(0.01)
    others = [ask_as(10, "bert"), ask_as(11, "carla"), ask_as(12, "bert")]
    outcomes = await asyncio.gather(*crowd, *others, return_exceptions=True)
    refused = [number for number, outcome in enumerate(outcomes) if isinstance(outcome, QueriesWaitingError)]
    # This is one of bert's, whichever was queued later.
    assert [number for number in refused if number >= 5] in ([5], [7])
    assert len(refused) == 3  # The other two are anna's.


async def test_waiting_time_of_a_query_is_limited(pool: ProcessPool, tmp_path: Path) -> None:
    """The refusal states the time expected for the queued and running work, not a constant."""
    cache = cache_in(tmp_path)
    service = QueryService(cache, pool, OPERATIONS, queue_seconds=0.2)
    heavy = [replace(KeyedRequest.of("slower", Question(tmp_path, number)), work=5000) for number in range(2)]
    running = [asyncio.ensure_future(service.answer("slower", request)) for request in heavy]
    await asyncio.sleep(0.1)
    with pytest.raises(QueriesWaitingError) as refused:
        await ask(service, "once", tmp_path)
    assert refused.value.retry_after > 30
    assert not (tmp_path / "ran").exists()
    await asyncio.gather(*running)


async def test_retry_time_of_a_query_that_waited_in_vain_covers_the_queued_work(
    pool: ProcessPool, tmp_path: Path
) -> None:
    """The query waited for cheaper work of jobs, which its `retry_after` must include."""
    cache = cache_in(tmp_path)
    service = QueryService(cache, pool, OPERATIONS, queue_seconds=1.2)
    calls: list[Call] = [(time.sleep, (0.1,))] * 20
    chunks = [asyncio.ensure_future(pool.run(calls)) for _ in range(4)]
    larger = replace(KeyedRequest.of("once", Question(tmp_path, 0)), work=21)
    with pytest.raises(QueriesWaitingError) as refused:
        await service.answer("once", larger)
    assert refused.value.retry_after >= 2
    await asyncio.gather(*chunks)


async def test_announced_wait_is_bounded_by_the_time_limits_of_queries(tmp_path: Path) -> None:
    """Queries that are ended at the time limit do not count as finished work, however large their cost is."""
    executor = ProcessPool(workers=2, task_seconds=4.0)
    await executor.start()
    try:
        cache = cache_in(tmp_path)
        service = QueryService(cache, executor, OPERATIONS, max_waiting=4)
        heavy = [replace(KeyedRequest.of("slow", Question(tmp_path, number)), work=12_000) for number in range(6)]
        running = [asyncio.ensure_future(service.answer("slow", request)) for request in heavy]
        while service.queued < 4:  # noqa: ASYNC110 (it sets no event)
            await asyncio.sleep(0.01)
        with pytest.raises(QueriesWaitingError) as refused:
            await ask(service, "once", tmp_path)
        assert refused.value.retry_after == 12
        await asyncio.gather(*running, return_exceptions=True)
    finally:
        await executor.stop(1.0)


async def test_event_loop_is_not_blocked_by_large_histories(service: QueryService, tmp_path: Path) -> None:
    """The time of the event loop is compared with the time to parse the answers, so the limit holds on any machine."""
    requests = [KeyedRequest.of("trajectory", Question(tmp_path, number)) for number in range(40)]
    await ask(service, "trajectory", tmp_path, 99)  # The first call imports modules, and is not measured.
    begin = time.thread_time()
    found = await asyncio.gather(*(service.answer("trajectory", request) for request in requests))
    loop_seconds = time.thread_time() - begin
    answers = [record.json for record, _ in found]
    assert all(len(answer) > 1_000_000 for answer in answers)
    begin = time.thread_time()
    for answer in answers:
        orjson.dumps(orjson.loads(answer))
    assert loop_seconds < 0.7 * (time.thread_time() - begin)


async def test_result_stored_by_another_task_is_not_stored_twice(service: QueryService, tmp_path: Path) -> None:
    wanted = keyed("trajectory", [Question(tmp_path, number) for number in range(3)])
    await service.compute("trajectory", wanted[:2])
    late = await service.compute("trajectory", wanted[1:])
    answers = {key: future.result()[0].answer["number"] for key, future in late.answers.items()}
    assert answers == {case.key: number for number, case in enumerate(wanted) if number}
    assert keys_of(segments(tmp_path / "data")) == {case.key: 1 for case in wanted}


class LosesFirstChunk(ProcessPool):
    """Process pool that loses the results of its first chunk."""

    lost = False

    async def run(self, calls: Sequence[Call], **options: Any) -> list[CallResult]:
        results = await super().run(calls, **options)
        first, self.lost = not self.lost, True
        return [] if first else results


async def test_cases_of_a_lost_chunk_fail_and_succeed_when_repeated(
    tmp_path: Path,
) -> None:
    pool = LosesFirstChunk(workers=1, task_seconds=60.0)
    await pool.start()
    try:
        service = queries_on(tmp_path, pool)
        requests = keyed("slow", [Question(tmp_path, number) for number in range(3)])
        lost = await service.compute("slow", requests)
        assert [type(future.exception()) for future in lost.answers.values()] == [ValueError] * 3
        again = await service.compute("slow", requests)
        assert [future.result()[0].answer["number"] for future in again.answers.values()] == [0, 1, 2]
        assert (await service.answer("slow", requests[0]))[1] == "hit"
    finally:
        await pool.stop(2.0)


async def test_implausible_answers_are_logged_and_counted(
    service: QueryService, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Answers to queries and in chunks count once each; a repeated query does not count again."""
    single, *chunk = keyed("implausible", [Question(tmp_path, number) for number in range(3)])
    await service.answer("implausible", single)
    await service.answer("implausible", single)
    await service.compute("implausible", chunk)
    await service.answer("slow", keyed("slow", [Question(tmp_path)])[0])
    assert service.implausible == 3
    logged = [each.getMessage() for each in caplog.records if "implausible answer" in each.getMessage()]
    assert [query.key in text for query, text in zip([single, *chunk], logged, strict=True)] == [True] * 3
