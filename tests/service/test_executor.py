"""The process pool, including kills of its processes.

`hashlib.pbkdf2_hmac` stands for compiled code, which ignores signals, and `os.mkdir` for a call that must not run
twice.
"""

import asyncio
import hashlib
import operator
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from service.errors import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.workers import Call
from service.workers.executor import loads
from service.workers.process_pool import ProcessPool
from service.workers.work_queue import Kind, Work, WorkQueue
from service.workers.worker_process import WorkerProcess
from tests.service.squares import until

pytestmark = [pytest.mark.anyio, pytest.mark.timeout(60)]

FOREVER = ("sha256", b"", b"", 10**9)
ENDLESS: Call = (hashlib.pbkdf2_hmac, FOREVER)
DEADLY: Call = (signal.raise_signal, (signal.SIGKILL,))
PARENT = Path(__file__).with_name("pool_parent.py")
linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def nap(seconds: float) -> Call:
    return time.sleep, (seconds,)


def folders(inside: Path, count: int) -> list[Call]:
    return [(os.mkdir, (inside / str(number),)) for number in range(count)]


def made(inside: Path) -> list[Path]:
    return list(inside.iterdir())


def processes() -> dict[int, int]:
    """Return the process group of every process that is not a zombie, by process id."""
    groups = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if state != "Z":
            groups[int(folder.name)] = int(group)
    return groups


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


async def test_calls_run_on_all_workers_at_once(pool: ProcessPool, tmp_path: Path) -> None:
    """A named pipe transfers bytes only if two calls run at the same time."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writing = asyncio.ensure_future(pool.submit(pipe.write_bytes, b"met"))
    assert await pool.submit(pipe.read_bytes) == b"met"
    assert await writing == 3
    assert len(set(pool.worker_pids)) == 2
    assert await pool.submit(os.getpid) in pool.worker_pids


async def test_twenty_queries_survive_the_death_of_a_worker(pool: ProcessPool) -> None:
    queries = [asyncio.ensure_future(pool.submit(time.sleep, 0.1)) for _ in range(20)]
    await asyncio.sleep(0.25)
    os.kill(pool.worker_pids[0], signal.SIGKILL)
    assert await asyncio.gather(*queries) == [None] * 20


async def test_kill_of_a_worker_at_any_instant_loses_no_result(pool: ProcessPool) -> None:
    """Each result has a size of 20 MB, so that many kills happen while one is being sent."""
    instants = random.Random(0)  # noqa: S311
    for _ in range(12):
        queries = [asyncio.ensure_future(pool.submit(np.ones, 2_500_000)) for _ in range(2)]
        await asyncio.sleep(instants.uniform(0.0, 0.05))
        for pid in pool.worker_pids[:1]:
            os.kill(pid, signal.SIGKILL)
        assert [result.sum() for result in await asyncio.gather(*queries)] == [2.5e6, 2.5e6]


async def test_task_that_kills_its_workers_fails_alone(pool: ProcessPool) -> None:
    others = [asyncio.ensure_future(pool.submit(time.sleep, 0.05)) for _ in range(10)]
    with pytest.raises(WorkerCrashedError):
        await pool.submit(signal.raise_signal, signal.SIGKILL)
    assert await asyncio.gather(*others) == [None] * 10


async def test_killed_idle_worker_is_replaced(pool: ProcessPool) -> None:
    before = set(pool.worker_pids)
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    await until(lambda: len(pool.worker_pids) == 2 and before.isdisjoint(pool.worker_pids))


async def test_query_sent_to_dead_workers_is_sent_to_others(pool: ProcessPool, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []
    send = WorkerProcess.send

    def send_late(worker: WorkerProcess, calls: Sequence[Call]) -> None:
        sent.append(worker.pid)
        if len(sent) <= 2:
            os.kill(worker.pid, signal.SIGKILL)
            time.sleep(0.2)
        send(worker, calls)

    monkeypatch.setattr(WorkerProcess, "send", send_late)
    assert await pool.submit(operator.add, 1, 2) == 3
    assert len(sent) == 3


@linux
async def test_pool_recovers_from_the_death_of_its_template(pool: ProcessPool) -> None:
    [template] = {parent_of(pid) for pid in pool.worker_pids}
    for pid in (template, *pool.worker_pids):
        os.kill(pid, signal.SIGKILL)
    assert await asyncio.gather(*(pool.submit(operator.add, 1, i) for i in range(4))) == [1, 2, 3, 4]


async def test_workers_can_be_replaced_after_the_temporary_folder_was_emptied(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """`systemd-tmpfiles --clean` empties that folder, for example."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    program = f"""
import asyncio, os, shutil, signal
from service.workers.process_pool import ProcessPool

async def main():
    pool = ProcessPool(workers=2, task_seconds=60.0)
    await pool.start()
    for path in os.scandir({str(tmp_path)!r}):
        shutil.rmtree(path) if path.is_dir() else os.remove(path)
    for pid in pool.worker_pids:
        os.kill(pid, signal.SIGKILL)
    async with asyncio.timeout(30.0):
        print(await asyncio.gather(*(pool.submit(pow, 2, number) for number in range(4))))
    await pool.stop(1.0)

if __name__ == "__main__":
    asyncio.run(main())
"""
    file = tmp_path.with_suffix(".py")
    file.write_text(program)
    command = [sys.executable, str(file)]
    done = await asyncio.to_thread(lambda: subprocess.run(command, capture_output=True, text=True, check=False))
    assert done.stdout == "[1, 2, 4, 8]\n", done.stderr


async def test_answer_to_earlier_calls_is_not_mistaken_for_the_last_one() -> None:
    worker = WorkerProcess()
    await worker.start()
    worker.send([(pow, (2, 10))])
    await asyncio.sleep(0.2)
    worker.send([(pow, (3, 2))])
    reply = await worker.receive()
    worker.close()
    assert reply is not None
    assert loads(reply).value == 9


async def test_only_the_task_beyond_its_time_limit_is_ended() -> None:
    pool = ProcessPool(workers=2, task_seconds=0.5)
    await pool.start()
    endless = asyncio.ensure_future(pool.submit(hashlib.pbkdf2_hmac, *FOREVER))
    others = [asyncio.ensure_future(pool.submit(time.sleep, 0.2)) for _ in range(6)]
    started = time.monotonic()
    with pytest.raises(TaskTimeoutError):
        await endless
    assert time.monotonic() - started >= 0.5
    assert await asyncio.gather(*others) == [None] * 6
    await pool.stop(2.0)


@linux
async def test_stop_ends_busy_workers_within_the_grace_time(pool: ProcessPool) -> None:
    workers = pool.worker_pids
    queries = [asyncio.ensure_future(pool.submit(hashlib.pbkdf2_hmac, *FOREVER)) for _ in range(4)]
    await asyncio.sleep(0.2)
    await pool.stop(1.5)
    for query in queries:
        with pytest.raises(PoolUnavailableError):
            await query
    await until(lambda: processes().keys().isdisjoint(workers))


async def test_stop_finishes_running_work_and_refuses_more(pool: ProcessPool) -> None:
    queries = [asyncio.ensure_future(pool.submit(time.sleep, 0.1)) for _ in range(6)]
    await asyncio.sleep(0)
    await pool.stop(20.0)
    assert await asyncio.gather(*queries) == [None] * 6
    with pytest.raises(PoolUnavailableError):
        await pool.submit(os.getpid)


@linux
async def test_killed_parent_leaves_no_process_behind() -> None:
    """Neither a busy nor an idle worker survives its parent."""
    command = [sys.executable, str(PARENT)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as parent:  # noqa: ASYNC220
        assert parent.stdout is not None
        workers = [int(pid) for pid in (await asyncio.to_thread(parent.stdout.readline)).split()]
        family = [parent.pid, *workers, parent_of(workers[0])]
        assert len(set(family) & processes().keys()) == 4  # They are parent, template and two workers.
        parent.kill()
    await until(lambda: processes().keys().isdisjoint(family))


async def test_task_cancelled_in_the_queue_never_runs(pool: ProcessPool, tmp_path: Path) -> None:
    busy = [asyncio.ensure_future(pool.submit(time.sleep, 0.3)) for _ in range(2)]
    await asyncio.sleep(0.1)
    waiting = asyncio.ensure_future(pool.submit(os.mkdir, tmp_path / "ran"))
    await asyncio.sleep(0.05)
    waiting.cancel()
    await asyncio.gather(*busy)
    await pool.submit(os.getpid)
    assert not (tmp_path / "ran").exists()


async def test_probe_overtakes_waiting_tasks_and_detects_a_stuck_pool(pool: ProcessPool) -> None:
    queries = [asyncio.ensure_future(pool.submit(time.sleep, 0.05)) for _ in range(30)]
    await asyncio.sleep(0)  # All queries have been submitted, and none has had time to end.
    assert await pool.probe(seconds=30.0)
    assert sum(query.done() for query in queries) < 10
    await asyncio.gather(*queries)
    stuck = [asyncio.ensure_future(pool.submit(hashlib.pbkdf2_hmac, *FOREVER)) for _ in range(2)]
    await asyncio.sleep(0.1)
    assert not await pool.probe(seconds=0.2)
    await pool.stop(0.6)
    assert not await pool.probe(seconds=0.2)
    await asyncio.gather(*stuck, return_exceptions=True)


async def test_call_whose_worker_was_killed_is_retried_once(pool: ProcessPool, tmp_path: Path) -> None:
    unlucky = f"import os; os.path.exists({str(tmp_path / 'x')!r}) or (os.mkdir({str(tmp_path / 'x')!r}), os._exit(1))"
    finished = await pool.run([*folders(tmp_path, 2), (exec, (unlucky,)), (os.mkdir, (tmp_path / "after",))])
    assert [outcome.error for outcome in finished] == [None] * 4


async def test_every_deadly_call_of_a_chunk_is_found(pool: ProcessPool) -> None:
    finished = await pool.run([DEADLY, (operator.add, (1, 2)), DEADLY, DEADLY, (operator.add, (3, 4)), DEADLY])
    assert [number for number, outcome in enumerate(finished) if outcome.error is not None] == [0, 2, 3, 5]
    assert [finished[1].value, finished[4].value] == [3, 7]


async def test_chunks_finish_despite_killed_workers(pool: ProcessPool) -> None:
    instants = random.Random(1)  # noqa: S311
    sums: list[Call] = [(operator.add, (number, 1)) for number in range(20)]
    chunks = [asyncio.ensure_future(pool.run([nap(0.005), *sums])) for _ in range(200)]
    for kills in range(1, 7):
        await asyncio.sleep(instants.uniform(0.03, 0.1))  # The call hit by the last kill ends; two kills would fail it.
        os.kill(pool.worker_pids[kills % 2], signal.SIGKILL)
        await until(lambda: pool.restarts == kills)  # noqa: B023 (called at once)
    for chunk in chunks:
        assert [outcome.value for outcome in await chunk] == [None, *range(1, 21)]


@linux
async def test_frozen_worker_is_replaced() -> None:
    pool = ProcessPool(workers=1, task_seconds=0.4)
    await pool.start()
    [stopped] = pool.worker_pids
    os.kill(stopped, signal.SIGSTOP)
    await until(lambda: pool.worker_pids not in ([], [stopped]))
    big: list[Call] = [(len, (bytes(100_000),))] * 5  # They exceed the buffer of a socket.
    finished = await pool.run(big)
    assert [outcome.value for outcome in finished] == [100_000] * 5
    stopping: Call = (exec, ("import os, signal; os.kill(os.getpid(), signal.SIGSTOP)",))
    with pytest.raises(PoolUnavailableError):
        await pool.run([stopping, nap(0.0)])
    assert [outcome.error for outcome in await pool.run([nap(0.0)] * 2)] == [None, None]
    await pool.stop(2.0)


async def test_cancelled_chunk_stops_after_a_short_call_and_keeps_its_worker(lone: ProcessPool, tmp_path: Path) -> None:
    running = asyncio.ensure_future(lone.run([nap(0.3), *folders(tmp_path, 3)]))
    await asyncio.sleep(0.1)
    running.cancel()
    await lone.run([nap(0.0)])
    assert running.cancelled()
    assert not made(tmp_path)
    assert lone.restarts == 0


async def test_cancelled_chunk_in_a_long_call_is_ended_with_its_worker(lone: ProcessPool) -> None:
    (pid,) = lone.worker_pids
    running = asyncio.ensure_future(lone.run([ENDLESS, ENDLESS]))
    await asyncio.sleep(0.1)
    running.cancel()
    await until(lambda: lone.worker_pids != [pid])
    assert await lone.submit(operator.add, 2, 3) == 5


async def test_single_call_and_probe_overtake_a_chunk_without_repeating_its_calls(
    lone: ProcessPool, tmp_path: Path
) -> None:
    steps = [call for folder in folders(tmp_path, 40) for call in (folder, nap(0.02))]
    chunk = asyncio.ensure_future(lone.run(steps))
    behind = asyncio.ensure_future(lone.run([nap(0.0)], remaining=1000.0))
    for _ in range(5):
        await asyncio.sleep(0.05)
        assert await lone.submit(operator.add, 2, 3) == 5
        assert await lone.probe(seconds=30.0)
    assert not chunk.done()
    assert not behind.done()
    assert [outcome.error for outcome in await chunk] == [None] * 80
    await behind


async def test_overtaken_chunk_can_be_cancelled(lone: ProcessPool, tmp_path: Path) -> None:
    chunk = asyncio.ensure_future(lone.run([nap(0.2), *folders(tmp_path, 3)]))
    await asyncio.sleep(0.05)
    single = asyncio.ensure_future(lone.submit(time.sleep, 0.4))
    await asyncio.sleep(0.3)
    chunk.cancel()
    await single
    await lone.run([nap(0.0)])
    assert not made(tmp_path)


async def test_only_single_calls_are_counted_as_waiting(lone: ProcessPool) -> None:
    calls = [asyncio.ensure_future(lone.submit(time.sleep, 0.05)) for _ in range(4)]
    chunk = asyncio.ensure_future(lone.run([nap(0.0)] * 3))
    await asyncio.sleep(0.02)
    assert lone.queue.singles == 3
    await asyncio.gather(*calls, chunk)
    assert lone.queue.singles == 0
    assert lone.restarts == 0


async def test_stop_finishes_or_abandons_chunks(pool: ProcessPool) -> None:
    short = asyncio.ensure_future(pool.run([nap(0.05)] * 4))
    long = asyncio.ensure_future(pool.run([nap(0.05), ENDLESS]))
    waiting = [asyncio.ensure_future(pool.run([ENDLESS])) for _ in range(2)]
    await asyncio.sleep(0)
    await pool.stop(1.2)
    assert [outcome.error for outcome in await short] == [None] * 4
    for chunk in (long, *waiting):
        with pytest.raises(PoolUnavailableError):
            await chunk
    with pytest.raises(PoolUnavailableError):
        await pool.run([nap(0.0)])


async def test_cancelled_start_leaves_no_worker_and_no_failed_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    failures: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", failures.append)
    pool = ProcessPool(workers=2, task_seconds=60.0)
    starting = asyncio.create_task(pool.start())
    async with asyncio.timeout(60.0):
        # No pause is needed: forked workers are ready within a few milliseconds.
        while not pool.worker_pids:  # noqa: ASYNC110
            await asyncio.sleep(0)
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    await until(lambda: not pool.worker_pids)
    await until(lambda: not any(thread.name == "ricochet-supervisor" for thread in threading.enumerate()))
    assert failures == []


async def test_worker_with_the_largest_share_of_free_places_is_served_first() -> None:
    queue, given = WorkQueue(), list[str]()

    async def serve(worker: str, places: int) -> None:
        await queue.get(worker=worker, places=places)
        given.append(worker)

    servers = [
        asyncio.create_task(serve(name, places)) for name, places in {"a": 4, "b": 2}.items() for _ in range(places)
    ]
    await asyncio.sleep(0.0)
    for _ in range(3):
        queue.put(Work(Kind.CHUNK, [nap(0.0)]))
    await until(lambda: len(given) == 3)
    assert sorted(given) == ["a", "a", "b"]
    for server in servers:
        server.cancel()
