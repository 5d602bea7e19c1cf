"""The process that runs jobs is killed repeatedly, or its disk becomes full."""

import asyncio
import random
import subprocess
import sys
from pathlib import Path

import pytest

from service.cache.cache import ResultCache
from service.errors import StorageError
from service.jobs.store import JobStore
from service.workers.process_pool import ProcessPool
from tests.service.job_manager_process import CASES
from tests.service.questions import Question, runs
from tests.service.records import full_disk
from tests.service.squares import accepted, all_results, case, cases, collect, ended, running, squares, until_done

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(120)]

ROOT = Path(__file__).parents[2]
SECONDS = 2.0
"""Approximate time that two workers take for all cases. [s]"""


def stored(folder: Path) -> set[float]:
    """Return the numbers of cases whose results are on disk."""
    jobs = JobStore(folder / "data", job_days=7.0, operations={"square"})
    with ResultCache(folder / "data", memory_bytes=0, disk_bytes=10**9) as cache:
        rows = [row for job in jobs.jobs("local") for row in jobs.rows(job, 0, CASES)]
        known = cache.known([row.key for row in rows])
    jobs.close()
    return {row.number for row in rows if row.key in known}


@pytest.mark.timeout(600)
@pytest.mark.parametrize("kills", [2, pytest.param(40, marks=pytest.mark.slow)])
async def test_killed_process_answers_every_case_once_and_repeats_no_stored_one(
    kills: int, pool: ProcessPool, tmp_path: Path
) -> None:
    (tmp_path / "log").mkdir()
    instants = random.Random(kills)  # noqa: S311
    command = [sys.executable, "-m", "tests.service.job_manager_process", str(tmp_path)]
    kept, before = set[float](), dict[float, int]()
    for _ in range(kills):
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:  # noqa: ASYNC220
            assert process.stdout is not None
            await asyncio.to_thread(process.stdout.readline)
            await asyncio.sleep(instants.uniform(0.0, 2.0 * SECONDS / kills))
            process.kill()
        kept, before = stored(tmp_path), runs(tmp_path / "log")
    async with running(tmp_path, pool) as manager:
        [job] = await manager.jobs() or [await accepted(manager, cases(range(CASES), tmp_path / "log", seconds=0.01))]
        state = await ended(manager, job)
        results = await all_results(manager, job)
    assert (state.status, state.total, state.done, state.failed) == ("successful", CASES, CASES, 0)
    assert [result.number for result in results] == list(range(CASES))
    assert squares(results) == [i**2 for i in range(CASES)]
    after = runs(tmp_path / "log")
    assert {number: after[number] for number in kept} == {number: before[number] for number in kept}
    assert not [path for path in (tmp_path / "data").rglob(".partial/*") if path.is_file()]
    assert not (tmp_path / "data" / "damaged").exists()


async def test_job_on_a_full_disk_fails_with_a_reason_and_resumes_at_the_next_start(
    pool: ProcessPool, tmp_path: Path
) -> None:
    async with running(tmp_path, pool) as manager:
        job = await accepted(manager, cases(range(400), seconds=0.005))
        await until_done(manager, job, 4)
        with full_disk():
            state = await ended(manager, job)
            with pytest.raises(StorageError):
                await accepted(manager, cases(range(1000)))
            assert state.status == "failed"
            assert state.problem is not None
            assert state.problem["type"] == "urn:ricochet:problem:storage-full"
            assert str(tmp_path) not in str(state.problem)
            assert await manager.job(job.id) == state
            assert await manager.jobs() == [state]
            assert len(squares(await all_results(manager, job))) == state.done > 0
            assert squares(await collect(manager, cases([5000]))) == [5000**2]
        assert (await ended(manager, await accepted(manager, cases(range(5000, 5010))))).done == 10
        manager._scheduler.unwritten.clear()  # This has the effect of a kill at this point.
    async with running(tmp_path, pool) as manager:
        assert (await ended(manager, job)).status == "successful"
        assert squares(await all_results(manager, job)) == [i**2 for i in range(400)]


async def test_end_of_a_job_is_written_once_there_is_space(pool: ProcessPool, tmp_path: Path) -> None:
    async with running(tmp_path, pool) as manager:
        job = await accepted(manager, [case(Question(i, seconds=0.01)) for i in range(400)])
        await until_done(manager, job, 4)
        with full_disk():
            cancelled = await manager.cancel(job.id)
        assert cancelled is not None
    async with running(tmp_path, pool) as manager:
        state = await manager.job(job.id)
        assert state is not None
        assert state.status == cancelled.status == "dismissed"
        assert state.done == cancelled.done
