"""The job manager with a real pool, a real cache and real files."""

import asyncio
import os
import random
import shutil
import signal
import sqlite3
import time
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing
from pathlib import Path

import pytest

from service.cache.record import CaseResult
from service.errors import IdempotencyBusyError, IdempotencyConflictError, QueueFullError, StorageError
from service.jobs.manager import JobManager
from service.jobs.models import Idempotency, JobCase
from service.workers.process_pool import ProcessPool
from tests.service.questions import Question, runs, workers
from tests.service.squares import (
    accepted,
    all_results,
    case,
    cases,
    collect,
    ended,
    follow,
    running,
    sliced,
    squares,
    until_done,
)

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]


@pytest.fixture
async def manager(pool: ProcessPool, tmp_path: Path) -> AsyncIterator[JobManager]:
    async with running(tmp_path, pool) as running_manager:
        yield running_manager


async def test_every_case_of_a_job_is_answered_in_order_with_its_id(manager: JobManager, log: Path) -> None:
    job = await accepted(manager, cases(range(450), log))
    state = await ended(manager, job)
    assert (state.status, state.total, state.done, state.cached, state.failed) == ("successful", 450, 450, 0, 0)
    assert state.started is not None
    assert state.finished is not None
    assert state.created <= state.started <= state.finished
    results = await all_results(manager, job)
    assert [result.number for result in results] == list(range(450))
    assert [result.custom_id for result in results] == [f"case {i}" for i in range(450)]
    assert squares(results) == [i**2 for i in range(450)]
    assert runs(log) == dict.fromkeys(range(450), 1)
    assert [result.number for result in await all_results(manager, job, start=190, limit=33)] == list(range(190, 223))
    assert (manager.queued_cases, manager.running_chunks) == (0, 0)
    assert manager.rate > 0.0


async def test_damaged_block_ends_its_job_and_its_cases_are_named(
    pool: ProcessPool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with running(tmp_path, pool) as manager:
        job = await accepted(manager, cases(range(450), seconds=0.02))
        await until_done(manager, job, 10)
    with sqlite3.connect(tmp_path / "data" / "jobs.sqlite") as database:
        database.execute("UPDATE slices SET requests = substr(requests, 9) WHERE slice = 1")
    database.close()
    async with running(tmp_path, pool) as manager:
        state = await ended(manager, job)
        results = await all_results(manager, job)
    assert (state.status, state.problem and state.problem["type"]) == ("failed", "urn:ricochet:problem:damaged")
    assert all("cases 200 to 399" in text for text in (str(state.problem), caplog.text))
    assert squares(results) == [result.number**2 for result in results]
    assert 10 <= len(results) == state.done <= 250


async def test_repeated_batch_is_answered_from_the_cache(manager: JobManager, log: Path) -> None:
    first = await accepted(manager, cases(range(450), log))
    await ended(manager, first)
    again = await accepted(manager, cases(range(100, 700), log))
    state = await ended(manager, again)
    assert (state.done, state.cached) == (600, 350)
    assert runs(log) == dict.fromkeys(range(700), 1)
    results = await all_results(manager, again)
    assert [result.cached for result in results] == [True] * 350 + [False] * 250
    assert squares(results) == [i**2 for i in range(100, 700)]


async def test_equal_cases_run_once_across_jobs_and_queries(manager: JobManager, log: Path) -> None:
    twins = cases([1, 2, 1, 3, 1], log, seconds=0.2)
    jobs = [await accepted(manager, twins, owner) for owner in ("one", "two")]
    await asyncio.sleep(0.05)
    single, small = await asyncio.gather(
        manager._queries.answer("square", twins[0].request), collect(manager, twins[:2])
    )
    states = [await ended(manager, job) for job in jobs]
    assert runs(log) == {1: 1, 2: 1, 3: 1}
    assert single[0].answer["square"] == 1
    assert sorted(squares(small)) == [1, 4]
    assert [state.done for state in states] == [5, 5]
    assert sum(state.total - state.cached for state in states) == 3
    for job in jobs:
        assert squares(await all_results(manager, job)) == [1, 4, 1, 9, 1]


async def test_case_without_an_answer_is_a_result_with_a_problem(manager: JobManager, log: Path) -> None:
    whole = cases(range(30), log)
    for number, how in {3: "wrong", 7: "deadly", 11: "broken", 15: "refused"}.items():
        whole[number] = case(Question(number, str(log), how))
    job = await accepted(manager, whole)
    state = await ended(manager, job)
    small = sorted(await collect(manager, whole), key=lambda result: result.number)
    assert (state.status, state.done, state.failed) == ("successful", 30, 4)
    for results in (await all_results(manager, job), small):
        assert squares(results) == [i**2 for i in range(30) if i not in {3, 7, 11, 15}]
        problems = {result.number: result.problem for result in results if result.problem is not None}
        assert {number: problem["type"].rpartition(":")[2] for number, problem in problems.items()} == {
            3: "invalid-request",
            7: "worker-crashed",
            11: "internal-error",
            15: "invalid-request",
        }
        assert problems[3]["errors"] == [{"pointer": "/impact/velocity_m_s", "detail": "must be positive"}]
        assert problems[15]["errors"][0]["pointer"] == "/search/lower_deg"
        assert problems[7]["status"] == 500
        assert "secret" not in str(problems[11])


async def test_cancelling_takes_effect_at_once_and_keeps_results(manager: JobManager, log: Path) -> None:
    job = await accepted(manager, cases(range(8), log, seconds=0.05) + cases(range(8, 60), log, seconds=0.5))
    await until_done(manager, job, 4)
    state = await manager.cancel(job.id)
    assert state is not None
    assert state.status == "dismissed"
    assert state.expires is not None
    assert 4 <= state.done <= 8
    assert len(squares(await all_results(manager, job))) == state.done
    assert await manager.cancel(job.id) == await manager.job(job.id) == state
    await asyncio.sleep(0.5)
    count = len(runs(log))
    await asyncio.sleep(0.6)  # No case takes as long as this.
    assert len(runs(log)) == count < 15
    assert manager.queued_cases == 0
    assert squares(await collect(manager, cases([77]))) == [77**2]  # The pool is free again.


async def test_unexpectedly_slow_cases_are_redistributed(
    manager: JobManager, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.runner.OVERLONG_SECONDS", 0.3)
    job = await accepted(manager, cases(range(100), seconds=0.001) + cases(range(100, 120), log, seconds=0.2))
    assert (await ended(manager, job)).done == 120
    assert max(runs(log).values()) <= 6
    shares = sorted(Counter(workers(log)).values(), reverse=True)
    assert shares[1] >= 4  # Sized by the time of fast cases, they would be a single chunk.


async def test_finished_job_can_be_deleted_but_not_cancelled(manager: JobManager) -> None:
    job = await accepted(manager, cases(range(3)))
    state = await ended(manager, job)
    assert await manager.cancel(job.id) == state
    assert await manager.cancel(job.id, "someone else") is None
    assert not await manager.delete(job.id, "someone else")
    assert await manager.jobs() == [state]
    assert await manager.delete(job.id)
    assert not await manager.delete(job.id)
    assert await manager.cancel(job.id) is await manager.job(job.id) is None
    assert await manager.jobs() == []
    assert await all_results(manager, job) == []
    assert [state async for state in manager.changes(job.id)] == []


async def test_running_job_can_be_deleted(manager: JobManager) -> None:
    job = await accepted(manager, cases(range(10), seconds=3.0))
    followed = asyncio.ensure_future(ended(manager, job))
    await asyncio.sleep(0.3)
    assert await manager.delete(job.id)
    assert await manager.jobs() == []
    with pytest.raises(AssertionError):  # The follower sees no end, because the job no longer exists.
        await asyncio.wait_for(followed, 30.0)


async def test_small_work_is_answered_incrementally_and_overtakes_jobs(manager: JobManager) -> None:
    job = await accepted(manager, cases(range(100), seconds=0.1))
    await until_done(manager, job, 4)
    whole = cases([500, 501]) + cases([502], seconds=0.6)
    finished = [result.number async for result in manager.run_now("square", whole)]
    assert sorted(finished) == [0, 1, 2]
    assert finished[-1] == 2  # This is the slow case.
    state = await manager.job(job.id)
    assert state is not None
    assert state.done < 70
    assert [result.cached async for result in manager.run_now("square", whole)] == [True] * 3


async def test_small_work_stops_when_its_results_are_closed(manager: JobManager, log: Path) -> None:
    async with aclosing(manager.run_now("square", cases(range(100), log, seconds=0.1))) as results:
        await anext(results)
        assert manager.queued_cases == 99
    assert manager.queued_cases == 0
    await asyncio.sleep(0.3)
    count = len(runs(log))
    await asyncio.sleep(0.3)
    assert len(runs(log)) == count < 50


async def test_owners_take_turns(manager: JobManager) -> None:
    first = await accepted(manager, cases(range(200), seconds=0.03), "one")
    second = await accepted(manager, cases(range(200, 400), seconds=0.03), "one")
    await asyncio.sleep(0.3)
    other = await accepted(manager, cases(range(400, 420), seconds=0.03), "two")
    await ended(manager, other)
    states = [await manager.job(job.id, "one") for job in (first, second)]
    assert [state.status for state in states if state] == ["running", "accepted"]
    assert states[0] is not None
    assert 0 < states[0].done < 120
    assert [state.id for state in await manager.jobs("one")] == [second.id, first.id]


async def test_repeated_request_gives_the_same_job(manager: JobManager) -> None:
    whole = cases(range(3))
    job, new = await manager.accept("square", sliced(whole), idempotency=Idempotency("key", "digest"))
    same, again = await manager.accept("square", sliced(whole), idempotency=Idempotency("key", "digest"))
    read = []

    async def reading() -> AsyncIterator[Sequence[JobCase]]:
        async for part in sliced(whole, 1):
            read.append(part)
            yield part

    late = Idempotency("key", lambda: "digest" if len(read) == 3 else "too early")
    third, _ = await manager.accept("square", reading(), idempotency=late)
    assert (new, again) == (True, False)
    assert job.id == same.id == third.id
    with pytest.raises(IdempotencyConflictError):
        await manager.accept("square", sliced(whole), idempotency=Idempotency("key", "other"))
    other, new = await manager.accept("square", sliced(whole), owner="b", idempotency=Idempotency("key", "other"))
    assert new
    assert len(await manager.jobs()) == 1
    await ended(manager, other)


async def test_job_is_invisible_while_its_request_is_received(manager: JobManager) -> None:
    go_on = asyncio.Event()

    async def halting() -> AsyncIterator[Sequence[JobCase]]:
        yield cases(range(200))
        await go_on.wait()
        yield cases(range(200, 300))

    receiving = asyncio.ensure_future(manager.accept("square", halting(), idempotency=Idempotency("key", "digest")))
    await asyncio.sleep(0.2)
    assert await manager.jobs() == []
    assert manager.queued_cases == 200
    with pytest.raises(IdempotencyBusyError):
        await manager.accept("square", sliced([]), idempotency=Idempotency("key", "digest"))
    go_on.set()
    job, _ = await receiving
    assert (await ended(manager, job)).done == 300


@pytest.mark.parametrize("leaves", [ValueError("line 201 is wrong"), asyncio.CancelledError()], ids=["error", "left"])
async def test_interrupted_request_leaves_no_job(manager: JobManager, leaves: BaseException) -> None:
    async def breaking() -> AsyncIterator[Sequence[JobCase]]:
        yield cases(range(200))
        raise leaves

    for _ in range(2):
        with pytest.raises(type(leaves)):
            await manager.accept("square", breaking(), idempotency=Idempotency("key", "digest"))
    assert await manager.jobs() == []
    assert manager.queued_cases == 0
    with manager._jobs._database.reading() as database:
        assert database.execute("SELECT count(*) FROM jobs").fetchone() == (0,)
        assert database.execute("SELECT count(*) FROM slices").fetchone() == (0,)


async def test_cases_beyond_the_queue_limit_are_refused_with_a_time(pool: ProcessPool, tmp_path: Path) -> None:
    """The time includes all cases of the request; two workers finish at most 40 a second, at 0.05 s each."""
    async with running(tmp_path, pool, max_queued_cases=1000) as manager:
        job = await accepted(manager, cases(range(300), seconds=0.05))
        while not manager.rate:  # noqa: ASYNC110 (it sets no event)
            await asyncio.sleep(0.05)
        with pytest.raises(QueueFullError) as caught:
            await manager.accept("square", sliced(cases(range(1000, 1800))))
        assert 1 <= caught.value.retry_after < 60
        with pytest.raises(QueueFullError) as caught:
            await manager.accept("square", sliced(cases(range(1000, 1800))), count=100_000)
        assert caught.value.retry_after > 1000
        with pytest.raises(QueueFullError):
            manager.run_now("square", cases(range(400)))
        assert len(await manager.jobs()) == 1
        await manager.cancel(job.id)
        await accepted(manager, cases(range(400)))


async def test_small_job_of_an_owner_overtakes_a_large_one(pool: ProcessPool, tmp_path: Path) -> None:
    async with running(tmp_path, pool) as manager:
        large = await accepted(manager, cases(range(2000), seconds=0.02))
        await until_done(manager, large, 4)
        small = await ended(manager, await accepted(manager, cases(range(5000, 5010), seconds=0.02)))
        state = await manager.job(large.id)
        assert small.done == 10
        assert state is not None
        assert state.done < 500
        await manager.cancel(large.id)


async def test_place_and_wait_of_a_job_include_the_work_before_it(pool: ProcessPool, tmp_path: Path) -> None:
    """A small job overtakes large jobs of its owner and, as owners take turns, waits only briefly for other owners."""
    async with running(tmp_path, pool) as manager:
        sizes = (("anna", 4000), ("anna", 2000), ("bert", 4000), ("anna", 20))
        jobs = []
        for number, (owner, size) in enumerate(sizes):
            first = 10_000 * number
            jobs.append(await accepted(manager, cases(range(first, first + size), seconds=0.02), owner))
        assert [manager.jobs_ahead(job) for job in jobs] == [2, 1, 0, 0]
        large, medium, other, small = map(manager.seconds_until_done, jobs)
        assert small < medium / 10
        assert medium < other < large
        for job in jobs:
            await manager.cancel(job.id, job.owner)
        assert [manager.jobs_ahead(job) for job in jobs] == [0] * len(jobs)


async def test_no_owner_can_fill_the_whole_queue(pool: ProcessPool, tmp_path: Path) -> None:
    """An owner may use half of the space that others leave, so that there is space for the next owner."""
    async with running(tmp_path, pool, max_queued_cases=800) as manager:
        jobs = [await accepted(manager, cases(range(400), seconds=0.2), "anna")]
        with pytest.raises(QueueFullError):
            await manager.accept("square", sliced(cases(range(400, 450))), owner="anna")
        jobs.append(await accepted(manager, cases(range(1000, 1200), seconds=0.2), "bert"))
        with pytest.raises(QueueFullError):
            manager.run_now("square", cases(range(1200, 1250)), owner="bert")
        found = await collect(manager, cases(range(2000, 2100)))  # Results come in the order in which they finish.
        assert sorted(squares(found)) == [i**2 for i in range(2000, 2100)]
        for job in jobs:
            await manager.cancel(job.id, job.owner)


async def test_results_are_readable_while_the_job_runs(manager: JobManager) -> None:
    job = await accepted(manager, cases(range(10)) + cases(range(10, 60), seconds=0.02))
    found: list[CaseResult] = []
    while len(found) < 60:
        new = await all_results(manager, job, start=len(found))
        assert [result.number for result in new] == list(range(len(found), len(found) + len(new)))
        found += new
        await asyncio.sleep(0.05)
    assert squares(found) == [i**2 for i in range(60)]


async def test_evicted_result_is_computed_again_when_it_is_read(
    manager: JobManager, pool: ProcessPool, tmp_path: Path, log: Path
) -> None:
    job = await accepted(manager, cases(range(250), log))
    before = await ended(manager, job)
    results = await all_results(manager, job)
    await manager.stop()
    manager._queries.cache.close()
    shutil.rmtree(tmp_path / "data" / "results")
    async with running(tmp_path, pool) as other:
        again = await all_results(other, job, start=10)
        assert [result.record.json for result in again if result.record] == [
            result.record.json for result in results[10:] if result.record
        ]
        assert [(result.number, result.custom_id, result.cached) for result in again] == [
            (result.number, result.custom_id, result.cached) for result in results[10:]
        ]
        assert runs(log) == dict.fromkeys(range(10), 1) | dict.fromkeys(range(10, 250), 2)
        assert len(await all_results(other, job, start=10)) == 240
        assert sum(runs(log).values()) == 490
        assert await other.job(job.id) == before


async def test_changes_of_a_job_are_sent_at_most_five_times_a_second(manager: JobManager) -> None:
    job = await accepted(manager, cases(range(100), seconds=0.02))
    began = time.monotonic()
    states = [state async for state in manager.changes(job.id)]
    seconds = time.monotonic() - began
    assert 3 < len(states) < 5 * seconds + 3
    assert [state.revision for state in states] == sorted({state.revision for state in states})
    assert [state.final for state in states] == [False] * (len(states) - 1) + [True]
    assert [state async for state in manager.changes(job.id)] == states[-1:]


async def test_jobs_resume_at_the_next_start_of_the_service(pool: ProcessPool, tmp_path: Path, log: Path) -> None:
    async with running(tmp_path, pool) as manager:
        job = await accepted(manager, cases(range(60), log, seconds=0.02))
        following = asyncio.ensure_future(follow(manager, job))
        await until_done(manager, job, 10)
        before = await manager.job(job.id)
        assert before is not None
    assert not (await following).final
    async with running(tmp_path, pool) as manager:
        state = await ended(manager, job)
        assert (state.status, state.done, state.id) == ("successful", 60, job.id)
        assert squares(await all_results(manager, job)) == [i**2 for i in range(60)]
    # The other cases were running when the service stopped.
    assert list(runs(log).values()).count(1) >= before.done >= 10


async def test_job_survives_repeated_kills_of_workers(manager: JobManager, pool: ProcessPool, log: Path) -> None:
    job = await accepted(manager, cases(range(280), log, seconds=0.01))
    following = asyncio.ensure_future(ended(manager, job))
    chance = random.Random(0)  # noqa: S311
    for kill in range(4):
        await until_done(manager, job, 40 * kill)
        await asyncio.sleep(chance.uniform(0.1, 0.4))
        killed = chance.choice(pool.worker_pids)
        os.kill(killed, signal.SIGKILL)
        begun = runs(log).keys()
        # A case that ends two workers fails: wait until every case that this kill may have hit is answered.
        answered: set[float] = set()
        while killed in pool.worker_pids or not begun <= answered:
            await asyncio.sleep(0.02)
            answered = {result.number for result in await all_results(manager, job)}
    state = await following
    assert (state.status, state.done, state.failed) == ("successful", 280, 0)
    assert squares(await all_results(manager, job)) == [i**2 for i in range(280)]


async def test_manager_without_a_folder_refuses_jobs_but_not_small_work(pool: ProcessPool, tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    async with running(tmp_path, pool) as manager:
        assert sorted(squares(await collect(manager, cases(range(5))))) == [0, 1, 4, 9, 16]
        with pytest.raises(StorageError):
            await manager.accept("square", sliced(cases(range(5))))
        (tmp_path / "data").unlink()
        assert (await ended(manager, await accepted(manager, cases(range(5))))).done == 5
