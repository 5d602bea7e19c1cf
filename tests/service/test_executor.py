"""The pool under real kills. `pow` of large numbers stands for compiled code: it never lets go of the interpreter."""

import asyncio
import multiprocessing.forkserver
import operator
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from service.executor import PoolExecutor
from service.lane import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]

FOREVER = (7, 10**8)
PARENT = Path(__file__).with_name("pool_parent.py")
linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


async def until(claim: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not claim() and time.monotonic() < deadline:  # noqa: ASYNC110 (other processes set no event)
        await asyncio.sleep(0.02)
    return claim()


def processes() -> dict[int, int]:
    """Process group of every process that is not merely waiting to be reaped."""
    groups = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if state != "Z":
            groups[int(folder.name)] = int(group)
    return groups


async def test_results_and_exceptions_of_tasks_come_back(pool: PoolExecutor) -> None:
    assert await pool.submit(operator.add, 2, 3) == 5
    with pytest.raises(ValueError, match="invalid literal"):
        await pool.submit(int, "x")
    with pytest.raises(TypeError, match="pickle"):
        await pool.submit(threading.Lock)  # a result that cannot be pickled
    assert await pool.submit(operator.add, 2, 3) == 5


async def test_every_worker_takes_part(pool: PoolExecutor) -> None:
    await asyncio.gather(*(pool.submit(time.sleep, 0.05) for _ in range(4)))
    pids = await asyncio.gather(*(pool.submit(os.getpid) for _ in range(50)))
    assert set(pids) <= set(pool.worker_pids)
    assert len(pool.worker_pids) == 2


async def test_twenty_queries_survive_the_death_of_a_worker(pool: PoolExecutor) -> None:
    queries = [asyncio.ensure_future(pool.submit(time.sleep, 0.1)) for _ in range(20)]
    await asyncio.sleep(0.25)
    os.kill(pool.worker_pids[0], signal.SIGKILL)
    assert await asyncio.gather(*queries) == [None] * 20


async def test_worker_killed_at_any_instant_loses_nothing(pool: PoolExecutor) -> None:
    """Results of 40 MB are underway for long enough that many a kill comes while one is being sent."""
    instants = random.Random(0)  # noqa: S311
    for _ in range(15):
        queries = [asyncio.ensure_future(pool.submit(np.ones, 5_000_000)) for _ in range(2)]
        await asyncio.sleep(instants.uniform(0.0, 0.1))
        for pid in pool.worker_pids[:1]:
            os.kill(pid, signal.SIGKILL)
        assert [result.sum() for result in await asyncio.gather(*queries)] == [5e6, 5e6]


async def test_task_that_kills_its_workers_fails_alone(pool: PoolExecutor) -> None:
    others = [asyncio.ensure_future(pool.submit(time.sleep, 0.05)) for _ in range(10)]
    with pytest.raises(WorkerCrashedError):
        await pool.submit(signal.raise_signal, signal.SIGKILL)
    assert await asyncio.gather(*others) == [None] * 10


async def test_idle_worker_that_dies_is_replaced(pool: PoolExecutor) -> None:
    before = set(pool.worker_pids)
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    assert await until(lambda: len(pool.worker_pids) == 2 and before.isdisjoint(pool.worker_pids), 5.0)


async def test_pool_recovers_from_the_death_of_its_fork_server(pool: PoolExecutor) -> None:
    server = multiprocessing.forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    for pid in (server, *pool.worker_pids):
        os.kill(pid, signal.SIGKILL)
    assert await asyncio.gather(*(pool.submit(operator.add, 1, i) for i in range(4))) == [1, 2, 3, 4]


async def test_task_past_its_time_is_ended_and_nothing_else() -> None:
    pool = PoolExecutor(workers=2, task_seconds=0.5)
    await pool.start()
    endless = asyncio.ensure_future(pool.submit(pow, *FOREVER))
    others = [asyncio.ensure_future(pool.submit(time.sleep, 0.2)) for _ in range(6)]
    started = time.monotonic()
    with pytest.raises(TaskTimeoutError):
        await endless
    assert 0.5 <= time.monotonic() - started < 2.0
    assert await asyncio.gather(*others) == [None] * 6
    await pool.stop(2.0)


@linux
async def test_stop_ends_busy_workers_within_the_grace_time(pool: PoolExecutor) -> None:
    workers = pool.worker_pids
    queries = [asyncio.ensure_future(pool.submit(pow, *FOREVER)) for _ in range(4)]
    await asyncio.sleep(0.2)
    started = time.monotonic()
    await pool.stop(1.5)
    assert time.monotonic() - started < 1.6
    for query in queries:
        with pytest.raises(PoolUnavailableError):
            await query
    assert await until(lambda: processes().keys().isdisjoint(workers), 0.5)


async def test_stop_lets_what_is_underway_finish_and_refuses_more(pool: PoolExecutor) -> None:
    queries = [asyncio.ensure_future(pool.submit(time.sleep, 0.1)) for _ in range(6)]
    await asyncio.sleep(0)
    started = time.monotonic()
    await pool.stop(20.0)
    assert time.monotonic() - started < 5.0
    assert await asyncio.gather(*queries) == [None] * 6
    with pytest.raises(PoolUnavailableError):
        await pool.submit(os.getpid)


@linux
@pytest.mark.parametrize("task", ["busy", "idle"])
async def test_parent_killed_leaves_no_process_behind(task: str) -> None:
    command = [sys.executable, str(PARENT), task]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as parent:  # noqa: ASYNC220
        assert parent.stdout is not None
        assert await asyncio.to_thread(parent.stdout.readline) == "started\n"
        await asyncio.sleep(0.2)
        family = [pid for pid, group in processes().items() if group == parent.pid]
        assert len(family) == 5  # parent, two workers, fork server, resource tracker
        parent.kill()
    assert await until(lambda: parent.pid not in processes().values(), 3.0)


async def test_cancelled_while_waiting_a_task_never_runs(pool: PoolExecutor, tmp_path: Path) -> None:
    busy = [asyncio.ensure_future(pool.submit(time.sleep, 0.3)) for _ in range(2)]
    await asyncio.sleep(0.1)
    waiting = asyncio.ensure_future(pool.submit(os.mkdir, tmp_path / "ran"))
    await asyncio.sleep(0.05)
    waiting.cancel()
    await asyncio.gather(*busy)
    await pool.submit(os.getpid)
    assert not (tmp_path / "ran").exists()


async def test_probe_overtakes_waiting_tasks_and_sees_a_stuck_pool(pool: PoolExecutor) -> None:
    queries = [asyncio.ensure_future(pool.submit(time.sleep, 0.1)) for _ in range(30)]
    await asyncio.sleep(0.05)
    assert await pool.probe(seconds=1.0)
    assert sum(query.done() for query in queries) < 10
    await asyncio.gather(*queries)
    stuck = [asyncio.ensure_future(pool.submit(pow, *FOREVER)) for _ in range(2)]
    await asyncio.sleep(0.1)
    assert not await pool.probe(seconds=0.2)
    await pool.stop(0.6)
    assert not await pool.probe(seconds=0.2)
    await asyncio.gather(*stuck, return_exceptions=True)
