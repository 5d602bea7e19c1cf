"""Results of single queries are written to a journal at once, and later moved to a segment together."""

import os
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from service.cache.cache import JOURNAL_BYTES, JOURNAL_RECORDS, NOT_CACHED, ResultCache
from service.cache.index import Journal
from service.cache.maintenance import stat
from service.cache.record import Record
from service.cache.segments import Segment, encode_segments
from tests.service.records import critical_angle, full_disk, key_of, obliquity_fit, trajectory

ROOT = Path(__file__).parents[2]
WRITER = """
import sys
from pathlib import Path
from service.cache.cache import ResultCache
from tests.service.records import full_disk, critical_angle

cache = ResultCache(Path(sys.argv[1]), memory_bytes=0, disk_bytes=10**9)
number = 0
while True:
    cache.put(critical_angle(number))
    print(number, flush=True)
    number += 1
"""


def cache_in(folder: Path) -> ResultCache:
    return ResultCache(folder, memory_bytes=0, disk_bytes=10**9)


def journal_of(folder: Path) -> Path:
    return folder / "results" / "journal.sqlite"


def made_journal(folder: Path) -> Path:
    """Make the folder of a journal; return the path of the journal."""
    path = journal_of(folder)
    path.parent.mkdir(parents=True)
    return path


def keys_in_journal(folder: Path) -> set[str]:
    with closing(sqlite3.connect(journal_of(folder))) as connection, connection:
        return {key for (key,) in connection.execute("SELECT key FROM results")}


def test_single_results_are_readable_at_once_and_later_form_one_segment(tmp_path: Path) -> None:
    records = [critical_angle(number) for number in range(JOURNAL_RECORDS)]
    with cache_in(tmp_path / "single") as cache:
        for record in records[:-1]:
            assert cache.put(record) is record
        assert cache.statistics().segments == 0
        assert cache.known([record.key for record in records]) == {record.key for record in records[:-1]}
        assert cache.get(records[0].key) is records[0]
        assert keys_in_journal(tmp_path / "single") == {record.key for record in records[:-1]}
        assert stat(tmp_path / "single").cases == JOURNAL_RECORDS - 1
        cache.put(records[-1])
        cache.flush()  # This waits for the transfer that the last result has started.
        single = cache.statistics()
        assert keys_in_journal(tmp_path / "single") == set()
        found = cache.get_many([record.key for record in records])
        assert [found[record.key].json for record in records] == [record.json for record in records]
    with cache_in(tmp_path / "batch") as cache:
        cache.put_many(records)
        assert single == cache.statistics()


def test_large_results_are_moved_earlier_into_segments_of_their_operation(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        cache.put(critical_angle(1))
        large = [trajectory(number, rows=5000) for number in range(2, 10)]
        assert sum(len(record.json) for record in large) > JOURNAL_BYTES
        for record in large:
            cache.put(record)
        cache.flush()
        assert 2 <= cache.statistics().segments <= 5
    assert stat(tmp_path).cases == 9


def test_results_with_residuals_share_a_segment(tmp_path: Path) -> None:
    records = [obliquity_fit(number) for number in range(3)]
    with cache_in(tmp_path) as cache:
        for record in records:
            cache.put(record)
        cache.flush()
        assert cache.statistics().segments == 1
        found = cache.get_many([record.key for record in records])
        assert [found[record.key].answer for record in records] == [record.answer for record in records]


def test_concurrent_writers_of_the_journal_make_no_more_segments_than_one(tmp_path: Path) -> None:
    records = [critical_angle(number) for number in range(5 * JOURNAL_RECORDS)]
    with cache_in(tmp_path) as cache, ThreadPoolExecutor(8) as threads:
        assert list(threads.map(cache.put, records)) == records
    found = stat(tmp_path)
    assert found.cases == len(records)
    assert found.segments <= 5


def test_storing_a_result_does_not_wait_for_earlier_segments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def held_back(records: Sequence[Record]) -> list[Segment]:
        begun.set()
        assert may_end.wait(60.0)
        return encode_segments(records)

    monkeypatch.setattr("service.cache.cache.encode_segments", held_back)
    records = [critical_angle(number) for number in range(3 * JOURNAL_RECORDS)]
    with cache_in(tmp_path) as cache, ThreadPoolExecutor(1) as thread:
        answered = thread.submit(lambda: [cache.put(record) for record in records])
        try:
            assert begun.wait(60.0)
            assert answered.result(timeout=30.0) == records
            assert keys_in_journal(tmp_path) == {record.key for record in records}
            assert cache.statistics().segments == 0
        finally:
            may_end.set()
    assert (stat(tmp_path).cases, keys_in_journal(tmp_path)) == (len(records), set())


def test_result_unfit_for_a_segment_is_set_aside_and_others_are_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = [critical_angle(number) for number in range(3)]
    text = b'{"outcome":"embedded","history":{"time_s":["0.0"]},"key":"","engine_version":"1"}'
    unreadable = Record(key_of(9), "trajectory", b"{}", json=text)
    with pytest.raises(TypeError, match="conversion"):
        encode_segments([unreadable])
    with cache_in(tmp_path / "running") as cache:
        for record in (*whole, unreadable):
            assert cache.put(record) is record
        cache.flush()
        assert cache.known([record.key for record in (*whole, unreadable)]) == {record.key for record in whole}
        assert cache.last_error is None
    assert unreadable.key in caplog.text
    assert keys_in_journal(tmp_path / "running") == set()

    with closing(Journal(made_journal(tmp_path / "left"))) as journal:
        for record in (*whole, unreadable):
            journal.add(record)
    with cache_in(tmp_path / "left") as cache:
        assert cache.known([record.key for record in (*whole, unreadable)]) == {record.key for record in whole}
    assert (stat(tmp_path / "left").cases, stat(tmp_path / "left").segments) == (3, 1)


def test_shutdown_moves_the_journal_into_segments(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        cache.put(critical_angle(1))
    assert stat(tmp_path).cases == 1
    assert keys_in_journal(tmp_path) == set()


def test_answered_results_survive_a_kill_and_are_stored_once(tmp_path: Path) -> None:
    answered = 0
    for count in (90, 205, 321):
        command = [sys.executable, "-c", WRITER, str(tmp_path / str(count))]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as writer:
            assert writer.stdout
            for _ in range(count):
                answered = int(writer.stdout.readline())
            os.kill(writer.pid, signal.SIGKILL)
            rest = writer.stdout.read()
            answered = max([answered, *map(int, rest[: rest.rfind("\n") + 1].split())])
        with cache_in(tmp_path / str(count)) as cache:
            wanted = [key_of(number) for number in range(answered + 1)]
            assert cache.known(wanted) == set(wanted)
            found = cache.get_many(wanted)
            assert all(found[key_of(i)].json == critical_angle(i).json for i in range(answered + 1))
            # The last result may have been stored without being reported.
            assert cache.statistics().cases - (answered + 1) in {0, 1}
            assert cache.verify() == []


def test_result_already_in_a_segment_is_removed_from_the_journal_at_the_start(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        cache.put(critical_angle(1))
        with sqlite3.connect(journal_of(tmp_path)) as connection:
            rows = connection.execute("SELECT * FROM results").fetchall()
        cache.flush()
        connection.executemany("INSERT INTO results VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        connection.commit()
        connection.close()
    with cache_in(tmp_path) as cache:
        assert (cache.statistics().segments, cache.statistics().cases) == (1, 1)
        assert keys_in_journal(tmp_path) == set()


@pytest.mark.parametrize("damage", ["a row", "a text", "the file", "no database"])
def test_damage_to_the_journal_affects_only_damaged_results(damage: str, tmp_path: Path) -> None:
    cache = cache_in(tmp_path)
    for number in range(3):
        cache.put(critical_angle(number))
    with closing(sqlite3.connect(journal_of(tmp_path))) as connection, connection:
        rows = connection.execute("SELECT * FROM results").fetchall()
    cache.close()
    with closing(sqlite3.connect(journal_of(tmp_path))) as connection, connection:
        connection.executemany("INSERT INTO results VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        if damage == "a row":
            connection.execute("UPDATE results SET json = replace(json, '1', '2') WHERE key = ?", (key_of(1),))
        if damage == "a text":
            connection.execute("UPDATE results SET key = CAST(x'ff61' AS TEXT) WHERE key = ?", (key_of(1),))
    for path in (tmp_path / "results" / "segments").rglob("*.h5"):
        path.unlink()
    if damage in {"the file", "no database"}:
        size = journal_of(tmp_path).stat().st_size
        journal_of(tmp_path).write_bytes(b"nothing" if damage == "no database" else b"\xff" * size)
    with cache_in(tmp_path) as cache:
        left = {key_of(0), key_of(2)} if damage in {"a row", "a text"} else set()
        assert stat(tmp_path).cases == len(left)
        assert cache.known([key_of(number) for number in range(3)]) == left
        assert cache.put(critical_angle(5)).key == key_of(5)
        assert cache.last_error is None


def test_full_disk_causes_a_warning_but_loses_and_repeats_no_result(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        kept = [critical_angle(number) for number in range(20)]
        for record in kept:
            cache.put(record)
        with full_disk():
            refused = cache.put(critical_angle(99))
            cache.flush()
            assert cache.last_error
            assert cache.known([record.key for record in kept]) == {record.key for record in kept}
        assert refused.answer["warnings"][-1]["code"] == NOT_CACHED
        assert cache.put(critical_angle(100)).key == key_of(100)
        cache.flush()
        assert (cache.statistics().segments, cache.statistics().cases) == (1, 21)
    assert keys_in_journal(tmp_path) == set()
