"""The SQLite database of jobs, including killed writers and full disks."""

import shutil
import sqlite3
import subprocess
import sys
import threading
import time
import tracemalloc
import zlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import orjson
import pytest

from service.errors import FolderLayoutError, QueueFullError, StorageError
from service.jobs import store as module
from service.jobs.models import (
    BLOCK_SIZE,
    DECODED_BYTES,
    CaseBlock,
    CaseState,
    Idempotency,
    JobCase,
    JobState,
    StoredSweep,
    split_custom_ids,
    split_keys,
    split_requests,
)
from service.jobs.store import JobStore
from service.operations import result_key
from tests.service.opened import closed_later
from tests.service.questions import PROBLEM, Question
from tests.service.records import full_disk
from tests.service.squares import case

pytestmark = pytest.mark.timeout(60)

ROOT = Path(__file__).parents[2]


def store_in(folder: Path, job_days: float = 7.0) -> JobStore:
    return closed_later(JobStore(folder, job_days=job_days, operations={"square"}))


def cases(count: int, first: int = 0) -> list[JobCase]:
    return [case(Question(i), f"name {i}" if i % 3 == 0 else None) for i in range(first, first + count)]


def stored_job(store: JobStore, count: int = 450, owner: str = "local", token: Idempotency | None = None) -> JobState:
    job = store.create("square", owner)
    for number, first in enumerate(range(0, count, BLOCK_SIZE)):
        store.append(job, number, CaseBlock.of(cases(min(BLOCK_SIZE, count - first), first)))
    return store.accept(job, count, token)


def test_disk_space_for_the_jobs_of_an_owner_is_limited(tmp_path: Path) -> None:
    """A new job deletes the jobs that ended first; if all are unfinished, it is refused."""
    # The limit is space for three jobs.
    store = closed_later(JobStore(tmp_path, job_days=7.0, owner_bytes=100_000, operations={"square"}))
    other = stored_job(store, owner="bert")
    first, second, third = (stored_job(store, owner="anna") for _ in range(3))
    for job in (other, second, first, third):
        store.end(job.number, "dismissed")
    unfinished = [stored_job(store, owner="anna")]
    assert [job.id for job in store.jobs("anna")] == [unfinished[0].id, third.id, first.id]
    unfinished += [stored_job(store, owner="anna") for _ in range(2)]
    with pytest.raises(QueueFullError):
        stored_job(store, owner="anna")
    assert [job.id for job in store.jobs("anna")] == [job.id for job in reversed(unfinished)]
    assert [job.id for job in store.jobs("bert")] == [other.id]


def test_packed_block_of_cases_can_be_unpacked() -> None:
    packed = CaseBlock.of(cases(200))
    assert packed.count == 200
    assert split_custom_ids(packed.custom_ids, 200) == [case.custom_id for case in cases(200)]
    assert split_custom_ids(CaseBlock.of([case(Question(1))]).custom_ids, 1) == [None]
    assert list(split_requests(packed.requests)) == [case.request.json for case in cases(200)]
    assert split_keys(packed.keys) == [case.request.key for case in cases(200)]
    assert len(packed.requests) < 20 * 200


def test_job_is_invisible_until_it_is_accepted(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    job = store.create("square", "local")
    store.append(job, 0, CaseBlock.of(cases(5)))
    assert store.jobs("local") == store.unfinished() == []
    state = store.accept(job, 5, None)
    assert (state.status, state.total, state.done, state.final) == ("accepted", 5, 0, False)
    assert store.job(state.id) == store.jobs("local")[0] == store.unfinished()[0] == state
    assert store.jobs("someone else") == []
    assert len(state.id) == 32


def test_pages_of_jobs_are_complete_while_jobs_are_added_and_deleted(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    states = [stored_job(store, 1, owner=owner) for owner in ("local", "other", "local", "local", "local")]
    newest = store.jobs("local", limit=2)
    assert newest == [states[4], states[3]]
    store.discard(states[3].number)
    stored_job(store, 1)
    assert store.jobs("local", before=newest[-1].number, limit=2) == [states[2], states[0]]
    assert store.jobs("local", before=states[0].number) == []
    assert store.jobs(None, before=states[2].number, limit=1) == [states[1]]


def test_jobs_are_counted_by_status_without_the_excluded_ones(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    states = [stored_job(store, 1, owner=owner) for owner in ("local", "other", "local", "local")]
    store.begin(states[0].number)
    store.end(states[1].number, "dismissed")
    store.create("square", "local")  # The job is incomplete, and therefore not visible.
    assert store.tally() == {"running": 1, "dismissed": 1, "accepted": 2}
    assert store.tally([states[0].id, states[3].id]) == {"dismissed": 1, "accepted": 1}


def test_sweep_is_stored_and_deleted_with_its_job(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    sweep = StoredSweep({"base": {"x": 1.0}, "axes": []}, ("a.b", "c"), ([1.0, 2.0], [5.0, 6.0, 7.0]))
    number = store.create("square", "local", sweep)
    state = store.accept(number, 0, None)
    assert state.axes == store.jobs("local")[0].axes == ("a.b", "c")
    assert store.sweep(number) == sweep
    assert [sweep.point(case) for case in (0, 2, 3, 5)] == [(1.0, 5.0), (1.0, 7.0), (2.0, 5.0), (2.0, 7.0)]
    store.discard(number)
    assert store.sweep(number) is None


def test_cases_can_be_read_in_order_from_any_index(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    job = stored_job(store)
    for start, limit in [(0, 450), (199, 2), (200, 200), (37, 301), (449, 10), (450, 10)]:
        rows = store.rows(job, start, limit)
        expected = range(start, min(450, start + limit))
        assert [row.number for row in rows] == list(expected)
        assert [row.custom_id for row in rows] == [f"name {i}" if i % 3 == 0 else None for i in expected]
        assert [row.key for row in rows] == [result_key("square", Question(i).canonical()) for i in expected]
    assert store.requests(job.number, [3, 449]) == {i: orjson.dumps(Question(i).canonical()) for i in (3, 449)}


def test_marks_count_once_and_the_last_one_ends_the_job(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    job = stored_job(store).number
    state = store.begin(job)
    assert (state.status, state.started is not None) == ("running", True)
    marks = {0: CaseState.DONE, 199: CaseState.CACHED, 200: CaseState.FAILED}
    state = store.mark(job, marks, {200: PROBLEM})
    again = store.mark(job, marks, {200: PROBLEM})
    assert (state.done, state.cached, state.failed) == (again.done, again.cached, again.failed) == (3, 1, 1)
    assert again.revision > state.revision
    assert [row.number for row in store.waiting(state, 0, 2)] == [i for i in range(400) if i not in marks]
    assert [row.problem for row in store.rows(state, 199, 3)] == [None, PROBLEM, None]
    ended = store.mark(job, dict.fromkeys(range(450), CaseState.DONE))
    assert (ended.status, ended.done, ended.cached, ended.failed) == ("successful", 450, 1, 1)
    assert ended.finished is not None
    assert ended.expires is not None
    assert (ended.expires - ended.finished).days == 7
    assert store.unfinished() == []
    assert store.end(job, "dismissed") == ended


def test_marks_from_concurrent_threads_are_all_stored(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    job = stored_job(store, 400).number
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda i: store.mark(job, {i: CaseState.DONE}), range(400)))
    state = store.jobs("local")[0]
    assert (state.status, state.done) == ("successful", 400)


def test_expired_jobs_are_deleted_with_all_their_data(tmp_path: Path) -> None:
    store = store_in(tmp_path, job_days=0.0)
    stays, goes = (stored_job(store, 300, token=Idempotency(name, "digest")) for name in "ab")
    store.mark(goes.number, {250: CaseState.FAILED}, {250: PROBLEM})
    store.end(goes.number, "dismissed")
    time.sleep(0.01)
    assert store.expire() == 1
    assert [state.id for state in store.jobs("local")] == [stays.id]
    assert store.token("local", "b") is None
    with closing(sqlite3.connect(tmp_path / "jobs.sqlite")) as database, database:
        for table in ("slices", "states", "problems", "idempotency"):
            assert {row[0] for row in database.execute(f"SELECT job FROM {table}")} <= {stays.number}  # noqa: S608


def test_idempotency_token_finds_its_job_only_for_its_owner(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    state = stored_job(store, 3, token=Idempotency("token", lambda: "digest"))
    assert store.token("local", "token") == ("digest", state)
    assert store.token("other", "token") is None
    other = stored_job(store, 3, owner="other", token=Idempotency("token", "digest"))
    assert store.token("other", "token") == ("digest", other)
    store.discard(state.number)
    assert store.token("local", "token") is None


def test_job_of_an_earlier_engine_gets_new_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = store_in(tmp_path)
    with monkeypatch.context() as earlier:
        earlier.setattr("service.operations.ENGINE_VERSION", "0")
        earlier.setattr(module, "VERSIONS", "0 0")
        job = stored_job(store)
        old = [row.key for row in store.rows(job, 0, 450)]
    assert job.versions == "0 0"
    store.renew_keys(job.number)
    new = [row.key for row in store.rows(job, 0, 450)]
    assert new == [result_key("square", Question(i).canonical()) for i in range(450)]
    assert not set(old) & set(new)
    assert store.jobs("local")[0].versions == module.VERSIONS


def test_job_without_cases_has_ended(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    assert store.accept(store.create("square", "local"), 0, None).status == "successful"


@pytest.mark.parametrize("content", [b"no database", b"SQLite format 3\0" + bytes(4000)])
def test_file_that_is_not_a_database_is_set_aside(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "jobs.sqlite").write_bytes(content)
    store = store_in(tmp_path)
    state = stored_job(store)
    assert [path.read_bytes() for path in (tmp_path / "damaged").iterdir()] == [content]
    assert store_in(tmp_path).jobs("local") == [state]


@pytest.mark.parametrize("damaged", range(4))
def test_flipped_bit_in_the_log_affects_no_earlier_job(damaged: int, tmp_path: Path) -> None:
    log, ends, jobs = tmp_path / "data" / "jobs.sqlite-wal", [], []
    store = store_in(tmp_path / "data")
    store.jobs("local")  # This creates the tables.
    for _ in range(4):
        ends.append(log.stat().st_size)
        jobs.append(stored_job(store, 20).id)
    shutil.copytree(tmp_path / "data", tmp_path / "killed")
    store.close()
    content = bytearray((tmp_path / "killed" / log.name).read_bytes())
    content[(ends[damaged] + [*ends, len(content)][damaged + 1]) // 2] ^= 4
    (tmp_path / "killed" / log.name).write_bytes(content)
    assert [job.id for job in reversed(store_in(tmp_path / "killed").jobs("local"))] == jobs[:damaged]


def test_database_of_a_later_version_is_not_changed(tmp_path: Path) -> None:
    stored_job(store_in(tmp_path))
    database = sqlite3.connect(tmp_path / "jobs.sqlite")
    database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(FolderLayoutError, match="layout 99"):
        store_in(tmp_path).jobs("local")


def test_folder_that_cannot_be_made_is_reported_and_retried(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    store = store_in(tmp_path / "data")
    with pytest.raises(StorageError):
        store.expire(at_start=True)
    with pytest.raises(StorageError):
        store.jobs("local")
    (tmp_path / "data").unlink()
    assert store.jobs("local") == []


def test_full_disk_is_reported_and_writing_resumes_once_there_is_space(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    before = stored_job(store)
    largest = max(path.stat().st_size for path in tmp_path.iterdir())
    with full_disk(largest):
        with pytest.raises(StorageError):  # noqa: PT012 (it may fit a few times)
            for _ in range(100):
                job = store.create("square", "local")
                store.append(job, 0, CaseBlock.of(cases(200)))
        assert store.jobs("local") == [before]
    store.expire(at_start=True)
    after = stored_job(store)
    assert store_in(tmp_path).jobs("local") == [after, before]
    with closing(sqlite3.connect(tmp_path / "jobs.sqlite")) as database, database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("SELECT count(*) FROM jobs").fetchone() == (2,)


def test_killed_writer_leaves_only_complete_jobs(tmp_path: Path) -> None:
    """Every visible job has all its cases, and its counts agree with the marks of its cases."""
    command = [sys.executable, "-m", "tests.service.jobs_writer", str(tmp_path)]
    subprocess.run(command, check=True, cwd=ROOT)
    store = store_in(tmp_path)
    store.expire(at_start=True)
    states = store.jobs("local")
    assert len(states) > 10
    for state in states:
        rows = store.rows(state, 0, 10_000)
        assert len(rows) == state.total == 450
        assert sum(bool(row.state) for row in rows) == state.done
        assert (state.status == "successful") == (state.done == 450)
        assert sum(row.problem is not None for row in rows) == state.failed
    with closing(sqlite3.connect(tmp_path / "jobs.sqlite")) as database, database:
        numbers = {row[0] for row in database.execute("SELECT DISTINCT job FROM slices")}
        assert numbers == {state.number for state in states}
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_readers_do_not_wait_for_a_writer(tmp_path: Path) -> None:
    store = store_in(tmp_path)
    stored_job(store)
    inside, leave = threading.Event(), threading.Event()

    def write() -> None:
        with store._database.writing() as database:
            database.execute("UPDATE jobs SET revision = 77")
            inside.set()
            leave.wait(10.0)

    writer = threading.Thread(target=write)
    writer.start()
    assert inside.wait(10.0)
    assert store.jobs("local")[0].revision == 1
    assert writer.is_alive()
    leave.set()
    writer.join()
    assert store.jobs("local")[0].revision == 77


def test_decoded_blocks_of_large_requests_are_not_all_kept() -> None:
    """The memory of ten blocks of 8 MB is more than twice the limit."""
    tracemalloc.start()
    try:
        for number in range(10):
            split_requests(zlib.compress(bytes([number]) * 8_000_000, 1))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 1.1 * DECODED_BYTES
