"""Look-up, sharing and storing, over a real pool and a real folder. `os.mkdir` tells whether a task ran twice."""

import asyncio
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from service.admission import QueriesWaitingError
from service.engine import AbandonedError, Engine, Operation, Wanted
from service.executors.face import Executor
from service.keys import result_key
from service.pool.executor import PoolExecutor
from service.pool.lane import WorkerCrashedError
from service.results.cache import NOT_CACHED, ResultCache
from service.results.record import FloatColumns
from solver.arrays import FloatArray
from tests.faults.data_folder import keys_of, segments

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]


@dataclass
class Question:
    folder: Path
    number: int = 0

    def canonical(self) -> dict[str, Any]:
        return {"number": self.number}


def never(text: bytes) -> NoReturn:
    """Stored requests are the runner's."""
    raise AssertionError(text)


def count(question: Question, result: object) -> tuple[dict[str, Any], None]:
    return {"number": question.number, "result": result, "warnings": []}, None


def draw(question: Question, result: FloatArray) -> tuple[dict[str, Any], FloatColumns]:
    return {"number": question.number}, {f"column_{i}": result for i in range(12)}


OPERATIONS = {
    "once": Operation(call=lambda asked: (os.mkdir, (asked.folder / "ran",)), answer=count, parse=never),
    "slow": Operation(call=lambda _: (time.sleep, (0.3,)), answer=count, parse=never),
    "deadly": Operation(call=lambda _: (signal.raise_signal, (signal.SIGKILL,)), answer=count, parse=never),
    "trajectory": Operation(
        call=lambda asked: (np.linspace, (asked.number, asked.number + 1, 5000)), answer=draw, parse=never
    ),
}


@pytest.fixture
def engine(pool: PoolExecutor, tmp_path: Path) -> Engine:
    return engine_on(tmp_path, pool)


def engine_on(folder: Path, pool: Executor, most_waiting: int = 1000) -> Engine:
    cache = ResultCache(folder / "data", memory_bytes=100_000_000, disk_bytes=10**9)
    return Engine(cache, pool, OPERATIONS, most_waiting=most_waiting)


async def test_equal_requests_underway_run_once(engine: Engine, tmp_path: Path) -> None:
    answers = await asyncio.gather(*(engine.answer("once", Question(tmp_path)) for _ in range(20)))
    assert {status for _, status in answers} == {"miss"}
    assert len({id(record) for record, _ in answers}) == 1


async def test_second_request_is_a_hit_from_memory_and_after_a_restart_from_disk(
    engine: Engine, pool: PoolExecutor, tmp_path: Path
) -> None:
    first, miss = await engine.answer("once", Question(tmp_path))
    second, hit = await engine.answer("once", Question(tmp_path))
    engine.cache.close()
    restarted = engine_on(tmp_path, pool)
    third, found = await restarted.answer("once", Question(tmp_path))
    assert (miss, hit, found) == ("miss", "hit", "hit")
    assert first.json == second.json == third.json
    assert (await restarted.result(first.key) or second).json == first.json
    assert await restarted.result("0" * 64) is None


async def test_asker_who_leaves_takes_nothing_from_those_who_wait(engine: Engine, tmp_path: Path) -> None:
    first = asyncio.ensure_future(engine.answer("slow", Question(tmp_path)))
    await asyncio.sleep(0.05)
    second = asyncio.ensure_future(engine.answer("slow", Question(tmp_path)))
    await asyncio.sleep(0.05)
    first.cancel()
    record, _ = await second
    assert record.answer["number"] == 0
    assert first.cancelled()


async def test_work_everyone_has_left_is_kept_for_who_comes_back(engine: Engine, tmp_path: Path) -> None:
    asker = asyncio.ensure_future(engine.answer("once", Question(tmp_path)))
    await asyncio.sleep(0)
    asker.cancel()
    record, _ = await engine.answer("once", Question(tmp_path))  # a second run would raise FileExistsError
    assert record.answer["result"] is None


async def test_failure_reaches_all_who_wait_and_is_not_kept(engine: Engine, tmp_path: Path) -> None:
    (tmp_path / "ran").mkdir()
    failures = await asyncio.gather(
        *(engine.answer("once", Question(tmp_path)) for _ in range(3)), return_exceptions=True
    )
    assert [type(failure) for failure in failures] == [FileExistsError] * 3
    (tmp_path / "ran").rmdir()
    _, status = await engine.answer("once", Question(tmp_path))
    assert status == "miss"


async def test_deadly_request_fails_and_those_beside_it_do_not(engine: Engine, tmp_path: Path) -> None:
    others = [asyncio.ensure_future(engine.answer("slow", Question(tmp_path, number))) for number in range(6)]
    with pytest.raises(WorkerCrashedError):
        await engine.answer("deadly", Question(tmp_path))
    assert [record.answer["number"] for record, _ in await asyncio.gather(*others)] == list(range(6))


async def test_without_a_folder_to_write_answers_come_with_a_warning(engine: Engine, tmp_path: Path) -> None:
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "data").write_text("a file where the folder should be")
    engine = engine_on(blocked, engine._executor)
    record, status = await engine.answer("once", Question(tmp_path))
    assert (status, record.answer["warnings"][0]["code"]) == ("miss", NOT_CACHED)
    _, status = await engine.answer("once", Question(tmp_path))
    assert status == "hit"


def wanted(engine: Engine, name: str, questions: list[Question]) -> list[Wanted]:
    cases = [(asked.canonical(), asked) for asked in questions]
    return [Wanted(result_key(name, can), can, asked, OPERATIONS[name].call(asked)) for can, asked in cases]


async def test_chunk_computes_what_is_not_underway_and_shares_the_rest(engine: Engine, tmp_path: Path) -> None:
    (tmp_path / "failing" / "ran").mkdir(parents=True)
    failing = Question(tmp_path / "failing", 1)
    single = asyncio.ensure_future(engine.answer("once", Question(tmp_path)))
    await asyncio.sleep(0)
    left: list[int] = []
    chunk = engine.begin("once", wanted(engine, "once", [Question(tmp_path), failing]), lambda: left.append(1))
    other = engine.begin("once", wanted(engine, "once", [failing]), lambda: left.append(2))
    assert [len(part) for part in (chunk.own, chunk.shared, other.own, other.shared)] == [1, 1, 0, 1]
    record, _ = await single
    assert (await chunk.shared[record.key])[0] is record
    [failed] = chunk.own
    for future in (chunk.own[failed], other.shared[failed]):
        with pytest.raises(FileExistsError):
            await future
    await chunk.kept
    assert sorted(left) == [1, 2]
    assert engine.cache.known([record.key, failed]) == {record.key}


async def test_single_query_outlives_the_chunk_it_waited_for(engine: Engine, tmp_path: Path) -> None:
    chunk = engine.begin("slow", wanted(engine, "slow", [Question(tmp_path, i) for i in range(8)]), lambda: None)
    await asyncio.sleep(0.1)
    single = asyncio.ensure_future(engine.answer("slow", Question(tmp_path, 7)))
    await asyncio.sleep(0.05)
    chunk.stop()
    record, status = await single
    assert (record.answer["number"], status) == (7, "miss")
    await chunk.kept
    with pytest.raises(AbandonedError):
        await chunk.own[record.key]


async def test_no_more_single_queries_wait_than_may(pool: PoolExecutor, tmp_path: Path) -> None:
    engine = engine_on(tmp_path, pool, most_waiting=3)
    await engine.answer("slow", Question(tmp_path, 99))
    queries = [asyncio.ensure_future(engine.answer("slow", Question(tmp_path, i))) for i in range(2)]
    await asyncio.sleep(0.1)
    queries += [asyncio.ensure_future(engine.answer("slow", Question(tmp_path, i))) for i in range(2, 10)]
    outcomes = await asyncio.gather(*queries, return_exceptions=True)
    refused = [outcome for outcome in outcomes if isinstance(outcome, QueriesWaitingError)]
    assert len(refused) == 5
    assert all(1 <= error.retry_after < 60 for error in refused)
    hit = await engine.answer("slow", Question(tmp_path, 99))
    assert hit[1] == "hit"


async def test_event_loop_stays_free_while_histories_are_made_and_kept(engine: Engine, tmp_path: Path) -> None:
    """The best of three: other programs on the machine make it wait too."""

    async def longest_wait(first: int) -> float:
        asked = (engine.answer("trajectory", Question(tmp_path, first + i)) for i in range(100))
        queries, longest = asyncio.gather(*asked), 0.0
        while not queries.done():
            before = time.monotonic()
            await asyncio.sleep(0.005)
            longest = max(longest, time.monotonic() - before)
        assert all(len(record.json) > 1_000_000 for record, _ in await queries)
        return longest

    assert min([await longest_wait(first) for first in (0, 100, 200)]) < 0.1


async def test_result_that_another_kept_after_the_look_up_is_not_kept_twice(engine: Engine, tmp_path: Path) -> None:
    wanted = [
        Wanted(
            result_key("trajectory", asked.canonical()), asked.canonical(), asked, OPERATIONS["trajectory"].call(asked)
        )
        for asked in (Question(tmp_path, number) for number in range(3))
    ]
    await engine.begin("trajectory", wanted[:2], lambda: None).kept
    late = engine.begin("trajectory", wanted[1:], lambda: None)
    await late.kept
    answers = {key: future.result()[0].answer["number"] for key, future in late.own.items()}
    assert answers == {case.key: number for number, case in enumerate(wanted) if number}
    assert keys_of(segments(tmp_path / "data")) == {case.key: 1 for case in wanted}
