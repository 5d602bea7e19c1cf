"""The cache of results on disk and in memory, with real files and real faults."""

import gc
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from service.cache.cache import NOT_CACHED, ResultCache
from service.cache.record import Record
from service.cache.segments import DecodedSegment, digest_of, to_segment
from service.errors import FolderInUseError
from tests.service.records import critical_angle, critical_angle_with_motion, full_disk, key_of, made, same, trajectory

pytestmark = pytest.mark.timeout(60)

WRITER = Path(__file__).with_name("cache_writer.py")
MEGABYTE = 1_000_000
PLENTY = 1000 * MEGABYTE


def cache_in(folder: Path, *, memory_bytes: int = 50 * MEGABYTE, disk_bytes: int = PLENTY) -> ResultCache:
    return ResultCache(folder, memory_bytes=memory_bytes, disk_bytes=disk_bytes)


def path_of(folder: Path, *records: Record) -> Path:
    name = digest_of(to_segment(*records))
    return folder / "results" / "segments" / name[:2] / f"{name}.h5"


def index_of(folder: Path) -> Path:
    return folder / "results" / "index.sqlite"


def segments_in(folder: Path) -> list[str]:
    """Return the names of all segments. `Path.rglob` would raise an error if a folder disappeared."""
    return sorted(name for _, _, names in os.walk(folder / "results" / "segments") for name in names)


def indexed(folder: Path) -> tuple[set[str], set[str]]:
    """Return the names of the segments and the keys of the results in the index."""
    with closing(sqlite3.connect(index_of(folder))) as connection:
        names = {f"{name}.h5" for (name,) in connection.execute("SELECT name FROM segments")}
        return names, {key.hex() for (key,) in connection.execute("SELECT key FROM results")}


def stored(folder: Path, *batches: Iterable[Record]) -> None:
    with cache_in(folder) as cache:
        for batch in batches:
            cache.put_many(list(batch))


@pytest.mark.parametrize(
    "record",
    [trajectory(), critical_angle(), critical_angle_with_motion()],
    ids=["trajectory", "cra", "cra with motion"],
)
def test_record_read_from_disk_is_identical_to_the_written_one(record: Record, tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        assert cache.put(record) is record
    with cache_in(tmp_path) as cache:
        assert cache.recall(record.key) is None
        found = cache.get(record.key)
        assert same(found, record)
        assert same(cache.recall(record.key), record)


def test_batch_is_stored_in_one_segment_with_access_to_each_result(tmp_path: Path) -> None:
    records = [critical_angle(number) for number in range(50)]
    others = [trajectory(number) for number in range(100, 110)]
    stored(tmp_path, records, others)
    assert segments_in(tmp_path) == sorted([path_of(tmp_path, *records).name, path_of(tmp_path, *others).name])
    with cache_in(tmp_path) as cache:
        assert cache.statistics().cases == 60
        assert same(cache.get(records[49].key), records[49])
        wanted = [record.key for record in [*records[10:20], *others]]
        found = cache.get_many([*wanted, key_of(999)])
        assert set(found) == set(wanted)
        assert all(same(found[record.key], record) for record in [*records[10:20], *others])


def test_batches_do_not_displace_single_results_from_memory(tmp_path: Path) -> None:
    single, batch = trajectory(1), [trajectory(number) for number in range(2, 20)]
    with cache_in(tmp_path, memory_bytes=single.nbytes * 2) as cache:
        cache.put(single)
        cache.put_many(batch)
        cache.get_many([record.key for record in batch])
        assert same(cache.recall(single.key), single)


def test_very_large_histories_are_split_over_several_segments(tmp_path: Path) -> None:
    column = np.zeros(800_000)
    records = [made(key_of(number), "trajectory", {}, {}, {"time_s": column}) for number in range(5)]
    stored(tmp_path, records)
    assert len(segments_in(tmp_path)) == 3
    with cache_in(tmp_path) as cache:
        assert all(same(cache.get(record.key), record) for record in records)


def test_known_returns_the_keys_that_can_be_read(tmp_path: Path) -> None:
    batches = [[critical_angle(number) for number in range(first, first + 10)] for first in (0, 10, 20)]
    stored(tmp_path, *batches)
    gone, cut, _ = (path_of(tmp_path, *batch) for batch in batches)
    gone.unlink()
    os.truncate(cut, cut.stat().st_size - 1)
    keys = [key_of(number) for number in range(40)]
    with cache_in(tmp_path) as cache:
        assert cache.known(keys) == {key_of(number) for number in range(20, 30)}
        assert set(cache.get_many(keys)) == {key_of(number) for number in range(20, 30)}
        assert cache.statistics().cases == 10
        cache.put_many(batches[1])
        assert cache.known(keys) == {key_of(number) for number in range(10, 30)}
    assert (tmp_path / "damaged" / cut.name).exists()


def test_changed_segment_is_checked_again(tmp_path: Path) -> None:
    record = critical_angle()
    with cache_in(tmp_path) as cache:
        cache.put_many([record])
        assert cache.known([record.key])
        path = path_of(tmp_path, record)
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(content)
        assert not cache.known([record.key])


def test_damaged_segment_is_a_cache_miss_and_set_aside(tmp_path: Path) -> None:
    record = trajectory()
    stored(tmp_path, [record])
    path = path_of(tmp_path, record)
    good = path.read_bytes()
    places = random.Random(0).sample(range(len(good)), 10)  # noqa: S311
    flipped = [good[:i] + bytes([good[i] ^ 1 << i % 8]) + good[i + 1 :] for i in [0, len(good) // 2, *places]]
    for bad in [*flipped, b"", good[:-1], good + b"\0"]:
        path.write_bytes(bad)
        with cache_in(tmp_path) as cache:
            assert cache.get(record.key) is None
            assert not path.exists()
            assert bad in {aside.read_bytes() for aside in (tmp_path / "damaged").iterdir()}
            cache.put_many([record])
        with cache_in(tmp_path) as cache:
            assert same(cache.get(record.key), record)


def test_segment_under_a_wrong_name_is_a_cache_miss(tmp_path: Path) -> None:
    stored(tmp_path, [trajectory(1)], [trajectory(2)])
    wrong = path_of(tmp_path, trajectory(2))
    path_of(tmp_path, trajectory(1)).replace(wrong)
    with cache_in(tmp_path) as cache:
        assert cache.get(trajectory(2).key) is None
    assert not wrong.exists()


def test_wrong_index_is_corrected_from_the_segment(tmp_path: Path) -> None:
    records = [critical_angle(number) for number in range(3)]
    stored(tmp_path, records)
    with closing(sqlite3.connect(index_of(tmp_path))) as connection, connection:
        connection.execute("UPDATE results SET row = (row + 1) % 3")
    with cache_in(tmp_path) as cache:
        cache.get_many([record.key for record in records])
        assert all(same(cache.get(record.key), record) for record in records)
    assert not (tmp_path / "damaged").exists()


@pytest.mark.parametrize("key", ["", "../../../etc/passwd", "A" * 64, "0" * 63, "0" * 64 + "\n", "f" * 64])
def test_unknown_or_malformed_key_is_a_cache_miss(key: str, tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        assert cache.get(key) is None
        assert not cache.known([key])
        assert cache.last_error is None


def test_lost_or_damaged_index_is_rebuilt(tmp_path: Path) -> None:
    records = [critical_angle(number) for number in range(40)]
    stored(tmp_path, records[:30], [records[30]], records[31:])
    for damage in (None, Path.unlink, lambda path: path.write_bytes(os.urandom(20_000)), spoil):
        if damage:
            damage(index_of(tmp_path))
        with cache_in(tmp_path) as cache:
            assert cache.known([record.key for record in records]) == {record.key for record in records}
            assert (cache.statistics().segments, cache.statistics().cases) == (3, 40)
            assert same(cache.get(records[5].key), records[5])
            assert cache.last_error is None


def spoil(path: Path) -> None:
    """Overwrite the second half of a file with random bytes; its header remains valid."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] + os.urandom(len(content) - len(content) // 2))


def test_index_is_reconciled_with_the_files_at_the_start(tmp_path: Path) -> None:
    kept, unlisted, lost = [critical_angle(1)], [critical_angle(2)], [critical_angle(3)]
    stored(tmp_path, kept, unlisted, lost)
    with closing(sqlite3.connect(index_of(tmp_path))) as connection:
        connection.execute("PRAGMA foreign_keys = ON")
        with connection:
            connection.execute("DELETE FROM segments WHERE name = ?", (path_of(tmp_path, *unlisted).stem,))
    path_of(tmp_path, *lost).unlink()
    (tmp_path / "results" / ".partial" / "left-over").write_bytes(b"half a result")
    with cache_in(tmp_path) as cache:
        assert cache.known([key_of(number) for number in (1, 2, 3)]) == {key_of(1), key_of(2)}
        assert cache.statistics().segments == 2
    assert indexed(tmp_path)[0] == set(segments_in(tmp_path))
    assert not list((tmp_path / "results" / ".partial").iterdir())


def test_second_service_on_a_folder_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    command = [sys.executable, str(WRITER), str(tmp_path), str(PLENTY)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as first:
        assert first.stdout
        first.stdout.readline()
        with pytest.raises(FolderInUseError, match="in use by another service"):
            cache_in(tmp_path)
        first.kill()
    cache_in(tmp_path).close()
    with cache_in(tmp_path), pytest.raises(FolderInUseError):
        cache_in(tmp_path)


def test_oldest_segments_are_evicted_above_the_limit(tmp_path: Path) -> None:
    records = [trajectory(number) for number in range(40)]
    with cache_in(tmp_path, memory_bytes=0) as cache:
        for record in records[:20]:
            cache.put_many([record])
        size = cache.statistics().bytes // 20
        assert cache.get(records[0].key)  # Now it is the most recently used.
    limit = 21 * size
    with cache_in(tmp_path, memory_bytes=0, disk_bytes=limit) as cache:
        for record in records[20:]:
            cache.put_many([record])
            assert cache.statistics().bytes <= limit
            assert cache.known([record.key]), "the latest stays"
        assert cache.statistics().bytes >= 0.85 * limit
        there = cache.known([record.key for record in records])
    assert records[1].key not in there
    assert {record.key for record in records[25:]} <= there
    assert indexed(tmp_path)[0] == set(segments_in(tmp_path))
    assert indexed(tmp_path)[1] == there


def test_lowered_limit_is_applied_at_the_start(tmp_path: Path) -> None:
    stored(tmp_path, *([trajectory(number)] for number in range(10)))
    with cache_in(tmp_path, disk_bytes=5 * path_of(tmp_path, trajectory(0)).stat().st_size) as cache:
        assert 3 <= cache.statistics().segments <= 5
        assert cache.known([key_of(9)])
    assert indexed(tmp_path)[0] == set(segments_in(tmp_path))


def test_recently_used_segments_are_evicted_last(tmp_path: Path) -> None:
    records = [trajectory(number) for number in range(10)]
    with cache_in(tmp_path, memory_bytes=0) as cache:
        for record in records:
            cache.put_many([record])
        assert cache.get(records[0].key)
        assert cache.known([records[1].key])
        cache.evict(cache.statistics().bytes // 2)
        there = cache.known([record.key for record in records])
    assert {records[0].key, records[1].key, records[9].key} <= there
    assert not {records[2].key, records[3].key, records[4].key} & there


def test_latest_segment_is_kept_whatever_its_size(tmp_path: Path) -> None:
    with cache_in(tmp_path, disk_bytes=1) as cache:
        for number in range(3):
            cache.put_many([trajectory(number)])
            assert cache.known([key_of(i) for i in range(3)]) == {key_of(number)}
        assert cache.last_error is None


def test_read_only_folder_prevents_storing_but_no_answer(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("a file where the folder should be")
    with cache_in(tmp_path) as cache:
        assert not cache.writable()
        assert cache.last_error
        answered = cache.put(trajectory())
        assert [warning["code"] for warning in answered.answer["warnings"]] == ["strength_fit_range", NOT_CACHED]
        assert str(tmp_path) not in answered.json.decode()
        assert same(cache.recall(answered.key), answered)
        (tmp_path / "results").unlink()
        assert cache.writable()
        assert cache.last_error is None
        assert same(cache.put(trajectory(1)), trajectory(1))
        assert cache.known([key_of(1)])
    with cache_in(tmp_path) as cache:
        assert same(cache.get(key_of(1)), trajectory(1))


def test_truncated_write_leaves_only_the_earlier_files(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        old, new, batch = cache.put(trajectory(1)), trajectory(2), [trajectory(3), trajectory(4)]
        with full_disk():
            answers = [cache.put(old), cache.put(new), *cache.put_many(batch)]
            assert not cache.writable()
        assert [answer.answer["warnings"][-1]["code"] for answer in answers] == [NOT_CACHED] * 4
        assert segments_in(tmp_path) == []
        assert not list((tmp_path / "results" / ".partial").iterdir())
        assert same(cache.get(new.key), answers[1])
        assert cache.put(new) is new
    with cache_in(tmp_path) as cache:
        assert cache.known([key_of(number) for number in range(5)]) == {old.key, new.key}


def test_segment_missing_from_the_index_is_removed(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        cache.put_many([critical_angle(1)])
        size = index_of(tmp_path).stat().st_size + Path(f"{index_of(tmp_path)}-wal").stat().st_size
        with full_disk(size):
            answers = [cache.put_many([critical_angle(number)])[0] for number in range(2, 60)]
        refused = [answer.key for answer in answers if answer.answer["warnings"][-1]["code"] == NOT_CACHED]
        assert refused
        assert not cache.known(refused)
        assert cache.known([answer.key for answer in answers]) == {a.key for a in answers} - set(refused)
        assert len(segments_in(tmp_path)) == 1 + len(answers) - len(refused)
        assert same(cache.put(critical_angle(99)), critical_angle(99))
    assert indexed(tmp_path)[0] == set(segments_in(tmp_path))


@pytest.mark.parametrize("disk_bytes", [PLENTY, 2 * MEGABYTE], ids=["storing", "evicting"])
def test_killed_writer_leaves_complete_segments_and_a_correct_index(disk_bytes: int, tmp_path: Path) -> None:
    chance = random.Random(1)  # noqa: S311
    for _ in range(3):
        command = [sys.executable, str(WRITER), str(tmp_path), str(disk_bytes)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            assert writer.stdout
            for _ in range(15):
                writer.stdout.readline()
            time.sleep(0.03 * chance.random())
            writer.send_signal(signal.SIGKILL)
        with cache_in(tmp_path, memory_bytes=0) as cache:
            paths = [path for path in (tmp_path / "results" / "segments").rglob("*") if path.is_file()]
            keys = {path.name: DecodedSegment(path.read_bytes()).keys for path in paths}
            everything = {key for some in keys.values() for key in some}
            assert len(keys) >= 10
            assert cache.known(list(everything)) == everything
            assert cache.statistics().segments == len(paths)
            assert cache.statistics().bytes == sum(path.stat().st_size for path in paths)
            assert cache.last_error is None
        assert indexed(tmp_path) == (set(keys), everything)
        assert not list((tmp_path / "results" / ".partial").iterdir())
    assert not (tmp_path / "damaged").exists()


def test_memory_is_limited_and_contains_the_latest_results(tmp_path: Path) -> None:
    one = trajectory(rows=1000)
    with cache_in(tmp_path, memory_bytes=10 * one.nbytes + one.nbytes // 2) as cache:
        for number in range(50):
            cache.put(trajectory(number, rows=1000))
            cache.recall(trajectory(0).key)  # It remains recently used.
        kept = [number for number in range(50) if cache.recall(key_of(number))]
        assert kept == [0, *range(41, 50)]
        cache.put(trajectory(99, rows=20_000))  # It is larger than the cache, and must not evict anything.
        assert len([number for number in range(50) if cache.recall(key_of(number))]) == 10


def test_counted_memory_of_results_is_their_real_memory(tmp_path: Path) -> None:
    limit = 2 * MEGABYTE
    with cache_in(tmp_path, memory_bytes=limit) as cache:
        cache.put(critical_angle(0))
        cache.flush()
        tracemalloc.start()
        try:
            for number in range(1, 1200):
                record = cache.put(critical_angle(number))
                recalled = cache.recall(record.key)
                assert recalled is not None
                assert recalled.answer == record.answer  # This parses the record.
                del record, recalled
            cache.flush()
            gc.collect()
            taken = tracemalloc.get_traced_memory()[0]
        finally:
            tracemalloc.stop()
    assert 0.7 * limit < taken < 1.3 * limit


def test_recent_result_is_read_without_the_disk(tmp_path: Path) -> None:
    with cache_in(tmp_path) as cache:
        record = cache.put(trajectory())
        shutil.rmtree(tmp_path)
        assert same(cache.recall(record.key), record)
        assert same(cache.get(record.key), record)


def test_threads_can_read_write_and_evict_concurrently(tmp_path: Path) -> None:
    size = 40_000

    with cache_in(tmp_path, memory_bytes=0, disk_bytes=12 * size) as cache:

        def work(number: int) -> bool:
            cache.put_many([trajectory(number % 20), trajectory(20 + number % 7)])
            found = cache.get_many([key_of(number * 7 % 20), key_of(20)])
            cache.known([key_of(i) for i in range(30)])
            return all(
                record.json == trajectory(i).json for i in range(30) for record in [found.get(key_of(i))] if record
            )

        with ThreadPoolExecutor(8) as threads:
            assert all(threads.map(work, range(120)))
        assert cache.last_error is None
        names = segments_in(tmp_path)
        assert cache.statistics().segments == len(names)
    assert indexed(tmp_path)[0] == set(names)
    assert not (tmp_path / "damaged").exists()


def test_twenty_thousand_cases_can_be_looked_up_in_one_call(tmp_path: Path) -> None:
    record = critical_angle()
    keys = [key_of(number) for number in range(20_000)]
    with cache_in(tmp_path) as cache:
        for start in range(0, 20_000, 250):
            some = keys[start : start + 250]
            cache.put_many([made(key, "cra", record.request, record.answer) for key in some])
    with cache_in(tmp_path) as cache:
        assert len(cache.known(keys)) == len(keys)
