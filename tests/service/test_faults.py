"""Regression tests for errors in jobs that the tests in `tests/faults` found."""

import asyncio
from pathlib import Path

import pytest

from service.errors import StorageError
from service.jobs.models import JobState
from service.workers.process_pool import ProcessPool
from tests.service.squares import accepted, all_results, cases, ended, running, squares, until_done

pytestmark = [pytest.mark.system, pytest.mark.anyio]


async def half_done(folder: Path, pool: ProcessPool) -> JobState:
    async with running(folder, pool) as manager:
        job = await accepted(manager, cases(range(400), seconds=0.005))
        await until_done(manager, job, 20)
    return job


async def test_jobs_unreadable_at_the_start_resume_later(pool: ProcessPool, tmp_path: Path) -> None:
    job = await half_done(tmp_path, pool)
    file, elsewhere = tmp_path / "data" / "jobs.sqlite", tmp_path / "jobs.sqlite"
    file.replace(elsewhere)
    file.mkdir()
    async with running(tmp_path, pool) as manager:
        with pytest.raises(StorageError):
            await accepted(manager, cases(range(1000, 1010)))
        file.rmdir()
        elsewhere.replace(file)
        other = await accepted(manager, cases(range(1000, 1010)))
        assert (await ended(manager, other)).done == 10
        assert (await ended(manager, job)).status == "successful"
        assert squares(await all_results(manager, job)) == [i**2 for i in range(400)]


async def test_damaged_job_database_is_set_aside_and_results_are_kept(pool: ProcessPool, tmp_path: Path) -> None:
    job = await half_done(tmp_path, pool)
    file = tmp_path / "data" / "jobs.sqlite"
    content = file.read_bytes()
    file.write_bytes(content[:4096] + b"\xff" * 4096 + content[8192:])
    async with running(tmp_path, pool) as manager:
        assert await manager.job(job.id) is None
        again = await ended(manager, await accepted(manager, cases(range(400), seconds=0.005)))
        assert (again.status, again.done) == ("successful", 400)
        assert again.cached >= 20
    assert any(path.name == "jobs.sqlite" for path in (tmp_path / "data" / "damaged").iterdir())


@pytest.mark.parametrize("pause", [0.0, 0.001, 0.005])
async def test_job_deleted_during_its_cancellation_is_removed(pause: float, pool: ProcessPool, tmp_path: Path) -> None:
    async with running(tmp_path, pool) as manager:
        for _ in range(5):
            job = await accepted(manager, cases(range(400), seconds=0.005))
            await until_done(manager, job, 4)

            async def later(name: str = job.id) -> None:
                await asyncio.sleep(pause)
                await manager.cancel(name)

            deleted, *_ = await asyncio.gather(manager.delete(job.id), later(), later())
            assert deleted
            assert await manager.job(job.id) is None
            assert await manager.jobs() == []
