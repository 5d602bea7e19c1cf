"""Behaviour that every executor must have; Dask runs as a cluster of real processes."""

import asyncio
import hashlib
import operator
import os
import signal
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TypeAlias

import numpy as np
import orjson
import pytest

from service.errors import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.operations import compute_critical_angle, compute_trajectory
from service.schemas import CriticalAngleRequest, TrajectoryRequest
from service.schemas.strike import PAPER, PAPER_AT_45
from service.workers import Call, worker_process
from service.workers.dask_executor import DaskExecutor
from service.workers.executor import Executor, dumps, loads
from service.workers.in_thread import InThreadExecutor
from service.workers.process_pool import ProcessPool
from service.workers.worker import answer, compute_case, compute_single
from tests.service.squares import until

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(120)]
DASK = pytest.param("dask", marks=pytest.mark.system)

USUAL_SECONDS = 60.0
DEADLY: Call = (signal.raise_signal, (signal.SIGKILL,))
ENDLESS: Call = (hashlib.pbkdf2_hmac, ("sha256", b"", b"", 10**9))
"""Stands for compiled code, which ignores signals and therefore does not end when it is cancelled."""

Make: TypeAlias = Callable[..., Awaitable[Executor]]
with_processes = pytest.mark.parametrize("kind", ["pool", DASK], indirect=True)
"""Runs a test with the executors that have processes which a test can kill."""


@pytest.fixture(params=["in-process", "pool", DASK])
def kind(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
async def make(kind: str, request: pytest.FixtureRequest) -> AsyncIterator[Make]:
    """Return a function that makes executors of this kind, with two workers."""
    async with AsyncExitStack() as stack:

        async def started(task_seconds: float = USUAL_SECONDS) -> Executor:
            executor: Executor
            if kind == "in-process":
                executor = InThreadExecutor(task_seconds=task_seconds)
            elif kind == "pool":
                executor = ProcessPool(workers=2, task_seconds=task_seconds)
            else:
                address = request.getfixturevalue("cluster").address
                executor = DaskExecutor(address=address, workers=1, task_seconds=task_seconds)
            await executor.start()
            stack.push_async_callback(executor.stop, 1.5)
            if isinstance(executor, DaskExecutor):
                await until(lambda: executor.cluster.capacity == 2)
            return executor

        yield started


@pytest.fixture
async def executor(make: Make) -> Executor:
    return await make()


def nap(seconds: float) -> Call:
    return time.sleep, (seconds,)


def folders(inside: Path, count: int) -> list[Call]:
    """Return calls that each create a folder, and would fail if they ran twice."""
    return [(os.mkdir, (inside / str(number),)) for number in range(count)]


def traced_patience(trace: Path) -> str:
    """Return Python code that creates a folder once it runs, and then waits for a signal."""
    return f"import os, time; os.mkdir({str(trace)!r}); time.sleep(1000.0)"


def traced_destructor(trace: Path) -> str:
    """Return the code of `traced_patience` in a destructor, where Python ignores even exceptions of signal handlers."""
    patience = traced_patience(trace)
    return f"class Patient:\n    def __del__(self): {patience}\nPatient()\nimport time; time.sleep(1000.0)"


def made(inside: Path) -> list[Path]:
    return list(inside.iterdir())


async def test_single_call_returns_or_raises(executor: Executor) -> None:
    assert await executor.submit(operator.add, 2, 3) == 5
    with pytest.raises(ValueError, match="invalid literal"):
        await executor.submit(int, "x")
    with pytest.raises(TypeError, match="pickle"):
        await executor.submit(threading.Lock)
    assert executor.queue.singles == 0


async def test_results_of_calls_are_in_order(executor: Executor) -> None:
    calls: list[Call] = [(operator.add, (1, 2)), (int, ("x",)), nap(0.2), (threading.Lock, ()), (operator.neg, (7,))]
    first, wrong, slow, unsendable, last = await executor.run(calls)
    assert (first.value, first.error, slow.error, last.value, last.error) == (3, None, None, -7, None)
    assert isinstance(wrong.error, ValueError)
    assert isinstance(unsendable.error, TypeError)
    assert slow.seconds >= 0.2
    assert first.seconds < slow.seconds
    assert await executor.run([]) == []


async def test_unpicklable_call_or_error_affects_no_other_call(executor: Executor) -> None:
    odd: Call = (eval, ("(_ for _ in ()).throw(type('Odd', (Exception,), {})())",))
    one_way: Call = (exec, ("import json; json.loads('{')\n",))
    calls: list[Call] = [(len, (threading.Lock(),)), odd, (lambda: 1, ()), one_way, (operator.add, (1, 2))]
    finished = await executor.run(calls)
    assert all(isinstance(outcome.error, Exception) for outcome in finished[:4])
    assert "pickle" in str(finished[0].error)
    assert finished[4].value == 3


async def test_concurrent_chunks_get_their_own_answers(executor: Executor) -> None:
    chunks = [[(operator.mul, (chunk, number)) for number in range(20)] for chunk in range(30)]
    for chunk, finished in enumerate(await asyncio.gather(*map(executor.run, chunks))):
        assert [outcome.value for outcome in finished] == [chunk * number for number in range(20)]


async def test_large_results_arrive_complete(executor: Executor) -> None:
    finished = await executor.run([(np.full, (1_000_000, number)) for number in range(3)])
    assert [outcome.value.sum() for outcome in finished] == [0.0, 1e6, 2e6]


async def test_answers_of_all_executors_are_identical(executor: Executor) -> None:
    calls: list[Call] = []
    for number in range(6):
        projectile = PAPER["projectile"] | {"mass_kg": 11.0 + 0.7 * number}
        search = PAPER | {"projectile": projectile, "impact": {"velocity_m_s": 200.0 + 31.0 * number}}
        run = PAPER_AT_45 | {"projectile": projectile}
        request = orjson.dumps(CriticalAngleRequest.model_validate(search).canonical())
        calls.append((compute_case, (compute_critical_angle, "cra", f"{number:064}", request, "chunk")))
        request = orjson.dumps(TrajectoryRequest.model_validate(run).canonical())
        calls.append((compute_single, (compute_trajectory, "trajectory", f"{number:064}", request)))
    expected = [loads(answer(dumps(call))).value for call in calls]
    finished = await executor.run(calls)
    assert [outcome.error for outcome in finished] == [None] * len(calls)
    assert [outcome.value for outcome in finished] == expected


async def test_only_the_call_beyond_its_time_limit_fails(make: Make) -> None:
    """The time limit of a call in a chunk is counted from the end of the previous call."""
    executor = await make(task_seconds=0.5)
    finished = await executor.run([nap(0.3), nap(0.3), nap(0.7), (operator.add, (1, 2))])
    assert [type(outcome.error) for outcome in finished] == [type(None), type(None), TaskTimeoutError, type(None)]
    assert finished[2].seconds == 0.5
    assert finished[3].value == 3
    with pytest.raises(TaskTimeoutError):
        await executor.submit(time.sleep, 0.7)


@with_processes
async def test_endless_call_is_ended(make: Make) -> None:
    executor = await make(task_seconds=0.5)
    finished = await executor.run([(operator.add, (1, 2)), ENDLESS, (operator.add, (3, 4))])
    assert [type(outcome.error) for outcome in finished] == [type(None), TaskTimeoutError, type(None)]
    assert [finished[0].value, finished[2].value] == [3, 7]


@with_processes
async def test_call_that_kills_two_workers_fails_alone(executor: Executor, tmp_path: Path) -> None:
    diary = tmp_path / "diary"
    noted: Call = (exec, (f"open({str(diary)!r}, 'a').write('x'); import os; os.kill(os.getpid(), 9)",))
    finished = await executor.run([*folders(tmp_path, 2), noted, (operator.add, (1, 2)), DEADLY])
    crash, fine = WorkerCrashedError, type(None)
    assert [type(outcome.error) for outcome in finished] == [fine, fine, crash, fine, crash]
    assert diary.read_text() == "xx"
    with pytest.raises(WorkerCrashedError):
        await executor.submit(*DEADLY[:1], *DEADLY[1])


async def test_cancelled_chunk_stops_after_its_current_call(executor: Executor, tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    later = tmp_path / "later"
    later.mkdir()
    running = [
        asyncio.ensure_future(executor.run([(os.makedirs, (begun / str(number),)), nap(0.4), *folders(later, 3)]))
        for number in range(executor.capacity)
    ]
    await until(begun.exists)
    for chunk in running:
        chunk.cancel()
    await asyncio.wait(running)
    assert all(chunk.cancelled() for chunk in running)
    await asyncio.gather(*(executor.run([nap(0.0)]) for _ in range(2 * executor.capacity)))
    await asyncio.sleep(0.5)
    assert not made(later)


@with_processes
async def test_cancelled_single_call_is_ended_early(executor: Executor) -> None:
    endless = [asyncio.ensure_future(executor.submit(*ENDLESS[:1], *ENDLESS[1])) for _ in range(2)]
    await asyncio.sleep(0.5)
    for call in endless:
        call.cancel()
    async with asyncio.timeout(USUAL_SECONDS / 2):
        assert await executor.submit(operator.add, 2, 3) == 5
    assert all(call.cancelled() for call in endless)
    assert executor.restarts > 0


@with_processes
@pytest.mark.parametrize("program", [traced_patience, traced_destructor])
async def test_cancelled_call_that_reacts_to_a_signal_keeps_its_worker(
    executor: Executor, program: Callable[[Path], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_process, "CANCEL_SECONDS", 30.0)  # A busy machine may take long to react.
    workers = executor.worker_pids
    count = executor.single_capacity
    patient = [asyncio.ensure_future(executor.submit(exec, program(tmp_path / str(n)))) for n in range(count)]
    await until(lambda: len(made(tmp_path)) == count)
    for call in patient:
        call.cancel()
    assert await executor.submit(operator.add, 2, 3) == 5
    assert all(call.cancelled() for call in patient)
    assert (executor.worker_pids, executor.restarts) == (workers, 0)


async def test_owners_share_workers_and_small_work_overtakes_large(executor: Executor) -> None:
    """A small call of an owner with a long queue, and a call of another owner, do not wait for the whole queue."""
    done: list[str] = []

    async def submit(name: str, owner: str, cost: float) -> None:
        await executor.submit(time.sleep, 0.1, owner=owner, cost=cost)
        done.append(name)

    busy = [submit(f"busy {number}", "anna", 10.0) for number in range(8)]
    async with asyncio.TaskGroup() as group:
        for call in busy:
            group.create_task(call)
        await asyncio.sleep(0.05)
        group.create_task(submit("small", "anna", 1.0))
        group.create_task(submit("other", "bert", 10.0))
    assert max(done.index("small"), done.index("other")) < 2 * executor.single_capacity + 2


async def test_chunk_cancelled_in_the_queue_never_runs(executor: Executor, tmp_path: Path) -> None:
    busy = [asyncio.ensure_future(executor.run([nap(0.5)])) for _ in range(executor.capacity)]
    await asyncio.sleep(0.1)
    waiting = asyncio.ensure_future(executor.run(folders(tmp_path, 3)))
    await asyncio.sleep(0.1)
    waiting.cancel()
    await asyncio.gather(*busy)
    await asyncio.gather(*(executor.run([nap(0.0)]) for _ in range(2 * executor.capacity)))
    assert waiting.cancelled()
    assert not made(tmp_path)


async def test_single_call_does_not_wait_for_a_chunk(executor: Executor) -> None:
    chunks = [asyncio.ensure_future(executor.run([nap(0.05)] * 40)) for _ in range(executor.capacity)]
    await asyncio.sleep(0.2)
    assert await executor.submit(operator.add, 2, 3) == 5
    assert await executor.probe(5.0)
    assert not any(chunk.done() for chunk in chunks)
    for chunk in chunks:
        chunk.cancel()
    await asyncio.wait(chunks)


async def test_running_work_finishes_after_a_stop_but_no_other_work_begins(executor: Executor) -> None:
    assert await executor.probe(5.0)
    chunk = asyncio.ensure_future(executor.run([nap(0.05), (operator.add, (1, 2))]))
    await asyncio.sleep(0.05)
    await executor.stop(10.0)
    assert [outcome.value for outcome in await chunk] == [None, 3]
    with pytest.raises(PoolUnavailableError):
        await executor.run([nap(0.0)])
    with pytest.raises(PoolUnavailableError):
        await executor.submit(os.getpid)
    assert not await executor.probe(0.5)
    assert executor.last_error


async def test_work_beyond_the_grace_time_is_abandoned(executor: Executor) -> None:
    chunks = [asyncio.ensure_future(executor.run([nap(0.5)] * 60)) for _ in range(executor.capacity + 1)]
    await asyncio.sleep(0.2)
    await executor.stop(0.8)
    for chunk in chunks:
        with pytest.raises(PoolUnavailableError):
            await chunk


async def test_executor_reports_its_capacity_and_processes(executor: Executor, kind: str) -> None:
    assert executor.capacity == (1 if kind == "in-process" else 2)
    assert executor.worker_pids
    assert executor.restarts == 0
    for pid in executor.worker_pids:
        os.kill(pid, 0)  # This raises an error if there is no such process.
