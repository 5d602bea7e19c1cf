"""Statements in docs/operating.md about upgrades, power failures and changes of the clock."""

import shutil
import time
from pathlib import Path

import pytest

from service.clock import Clock
from service.jobs import store
from service.workers.in_thread import InThreadExecutor
from service.workers.process_pool import ProcessPool
from solver import ENGINE_VERSION
from tests.service.questions import runs
from tests.service.squares import accepted, all_results, cases, collect, ended, running, squares, until_done

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]
EARLIER = "0"


def downgrade(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the service report an earlier engine version."""
    monkeypatch.setattr("service.operations.ENGINE_VERSION", EARLIER)
    monkeypatch.setattr("service.cache.record.ENGINE_VERSION", EARLIER)
    monkeypatch.setattr(store, "VERSIONS", f"{EARLIER} 1")
    monkeypatch.setattr("service.jobs.scheduler.VERSIONS", f"{EARLIER} 1")
    monkeypatch.setattr("service.jobs.reader.VERSIONS", f"{EARLIER} 1")


async def test_upgraded_service_does_not_answer_with_results_of_the_older_engine(
    pool: ProcessPool, thread: InThreadExecutor, tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as earlier:
        downgrade(earlier)
        async with running(tmp_path, thread) as manager:
            old = [result.record for result in await collect(manager, cases(range(20), log))]
    async with running(tmp_path, pool) as manager:
        new = [result.record for result in await collect(manager, cases(range(20), log))]
        assert {record.engine_version for record in new if record} == {ENGINE_VERSION}
        assert runs(log) == dict.fromkeys(range(20), 2)
        for record in old:
            assert record is not None
            kept = manager._queries.cache.get(record.key)
            assert kept is not None
            assert (kept.engine_version, kept.json) == (EARLIER, record.json)


async def test_job_interrupted_by_an_upgrade_has_results_of_one_engine(
    pool: ProcessPool, thread: InThreadExecutor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as earlier:
        downgrade(earlier)
        async with running(tmp_path, thread) as manager:
            job = await accepted(manager, cases(range(300), seconds=0.005))
            await until_done(manager, job, 20)
    async with running(tmp_path, pool) as manager:
        state = await ended(manager, job)
        results = await all_results(manager, job)
    assert (state.status, state.done) == ("successful", 300)
    assert squares(results) == [i**2 for i in range(300)]
    assert {result.record.engine_version for result in results if result.record} == {ENGINE_VERSION}


async def test_finished_job_keeps_its_results_after_an_upgrade(
    pool: ProcessPool, thread: InThreadExecutor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as earlier:
        downgrade(earlier)
        async with running(tmp_path, thread) as manager:
            job = await accepted(manager, cases(range(50)))
            await ended(manager, job)
    async with running(tmp_path, pool) as manager:
        kept = await all_results(manager, job)
        assert {result.record.engine_version for result in kept if result.record} == {EARLIER}
    shutil.rmtree(tmp_path / "data" / "results")
    async with running(tmp_path, pool) as manager:
        again = await all_results(manager, job)
    assert {result.record.engine_version for result in again if result.record} == {ENGINE_VERSION}
    assert squares(again) == squares(kept) == [i**2 for i in range(50)]


async def test_finished_case_whose_segment_was_lost_in_a_power_cut_is_recomputed(
    pool: ProcessPool, tmp_path: Path, log: Path
) -> None:
    async with running(tmp_path, pool) as manager:
        job = await accepted(manager, cases(range(100), log))
        await ended(manager, job)
    for number, path in enumerate(sorted((tmp_path / "data" / "results" / "segments").rglob("*.h5"))):
        # This simulates a power cut before all blocks of the files were written.
        path.write_bytes(b"" if number % 2 else path.read_bytes()[:4096] + bytes(4096))
    async with running(tmp_path, pool) as manager:
        assert squares(await all_results(manager, job)) == [i**2 for i in range(100)]
    assert runs(log) == dict.fromkeys(range(100), 2)


@pytest.mark.parametrize("jump", [-30 * 86_400.0, 30 * 86_400.0])
async def test_setting_the_clock_affects_only_the_expiry_of_jobs(
    jump: float, pool: ProcessPool, tmp_path: Path
) -> None:
    jumped = 0.0
    clock = Clock(now=lambda: time.time() + jumped)
    async with running(tmp_path, pool, clock=clock) as manager:
        before = await accepted(manager, cases(range(100)))
        await ended(manager, before)
        under_way = await accepted(manager, cases(range(1000, 1300), seconds=0.002))
        await until_done(manager, under_way, 10)
        jumped = jump
        state = await ended(manager, under_way)
        assert (state.status, state.done) == ("successful", 300)
        assert squares(await all_results(manager, under_way)) == [i**2 for i in range(1000, 1300)]
    async with running(tmp_path, pool, clock=clock) as manager:  # Expired jobs are deleted at the start.
        assert (await manager.job(before.id) is None) == (jump > 0)
        assert await manager.job(under_way.id) is not None
        assert [result.cached for result in await collect(manager, cases(range(100)))] == [True] * 100
