"""Look-up, sharing and storing, over a real pool and a real folder. `os.mkdir` tells whether a task ran twice."""

import asyncio
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cache import NOT_CACHED, ResultCache
from service.engine import Engine, Operation
from service.executor import PoolExecutor
from service.lane import WorkerCrashedError
from service.record import FloatColumns
from solver.arrays import FloatArray

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]


@dataclass
class Question:
    folder: Path
    number: int = 0

    def canonical(self) -> dict[str, Any]:
        return {"number": self.number}


def count(question: Question, result: object) -> tuple[dict[str, Any], None]:
    return {"number": question.number, "result": result, "warnings": []}, None


def draw(question: Question, result: FloatArray) -> tuple[dict[str, Any], FloatColumns]:
    return {"number": question.number}, {f"column_{i}": result for i in range(12)}


OPERATIONS = {
    "once": Operation(call=lambda asked: (os.mkdir, (asked.folder / "ran",)), answer=count),
    "slow": Operation(call=lambda _: (time.sleep, (0.3,)), answer=count),
    "deadly": Operation(call=lambda _: (signal.raise_signal, (signal.SIGKILL,)), answer=count),
    "trajectory": Operation(call=lambda asked: (np.linspace, (asked.number, asked.number + 1, 5000)), answer=draw),
}


@pytest.fixture
def engine(pool: PoolExecutor, tmp_path: Path) -> Engine:
    return engine_on(tmp_path, pool)


def engine_on(folder: Path, pool: PoolExecutor) -> Engine:
    return Engine(ResultCache(folder / "data", memory_bytes=100_000_000), pool, OPERATIONS)


async def test_equal_requests_underway_run_once(engine: Engine, tmp_path: Path) -> None:
    answers = await asyncio.gather(*(engine.answer("once", Question(tmp_path)) for _ in range(20)))
    assert {status for _, status in answers} == {"miss"}
    assert len({id(record) for record, _ in answers}) == 1


async def test_second_request_is_a_hit_from_memory_and_after_a_restart_from_disk(
    engine: Engine, pool: PoolExecutor, tmp_path: Path
) -> None:
    first, miss = await engine.answer("once", Question(tmp_path))
    second, hit = await engine.answer("once", Question(tmp_path))
    third, restarted = await engine_on(tmp_path, pool).answer("once", Question(tmp_path))
    assert (miss, hit, restarted) == ("miss", "hit", "hit")
    assert first.json == second.json == third.json
    assert (await engine_on(tmp_path, pool).result(first.key) or first).json == first.json
    assert await engine.result("0" * 64) is None


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
