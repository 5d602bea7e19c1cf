"""A bit flips in the log of a database of a service that was killed: what SQLite then passes over is not lost in
silence."""

import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.cache.cache import ResultCache
from service.jobs.models import CaseBlock
from service.jobs.store import JobStore
from tests.service.records import critical_angle, key_of
from tests.service.squares import cases

pytestmark = pytest.mark.timeout(60)
HEAD = range(32)
FLIPS = 40


def flipped(folder: Path, name: str, copies: Path) -> Iterator[Path]:
    """Copies of a folder, as a kill leaves it, each with one bit changed in this file: of its head, then anywhere."""
    choice = random.Random(0)  # noqa: S311
    size = (folder / name).stat().st_size
    assert size > 10_000
    for number, place in enumerate([*HEAD, *(choice.randrange(size) for _ in range(FLIPS))]):
        copy = copies / str(number)
        shutil.copytree(folder, copy)
        content = bytearray((copy / name).read_bytes())
        content[place] ^= 1 << choice.randrange(8)
        (copy / name).write_bytes(content)
        yield copy


def stored_jobs(store: JobStore) -> int:
    return len(store.jobs(None))


def test_commits_lost_by_a_flipped_bit_in_the_log_of_the_jobs_are_never_lost_in_silence(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store, jobs = JobStore(tmp_path / "data", job_days=1.0), 4
    for _ in range(jobs):
        number = store.create("square", "local")
        store.append(number, 0, CaseBlock.of(cases(range(20))))
        store.accept(number, 20, None)
    lost = 0
    for folder in flipped(tmp_path / "data", "jobs.sqlite-wal", tmp_path / "copies"):
        caplog.clear()
        damaged = JobStore(folder, job_days=1.0)
        if stored_jobs(damaged) < jobs:
            lost += 1
            assert "jobs.sqlite set aside" in caplog.text
            assert {path.suffix for path in (folder / "damaged").iterdir()} == {".sqlite", ".sqlite-wal"}
        damaged.close()
        kept = JobStore(folder, job_days=1.0)  # the next start has nothing more to say
        assert stored_jobs(kept) < jobs or not (folder / "damaged").exists()
        kept.close()
        shutil.rmtree(folder)
    store.close()
    assert lost > FLIPS / 2


def test_results_lost_by_a_flipped_bit_in_the_log_of_the_journal_are_never_lost_in_silence(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    keys = {key_of(number) for number in range(4)}
    with ResultCache(tmp_path / "data", memory_bytes=0, disk_bytes=10**9) as cache:
        for number in range(4):
            cache.put(critical_angle(number))
        for folder in flipped(tmp_path / "data", "results/journal.sqlite-wal", tmp_path / "copies"):
            caplog.clear()
            with ResultCache(folder, memory_bytes=0, disk_bytes=10**9) as damaged:
                assert damaged.known(list(keys)) == keys or "journal.sqlite set aside" in caplog.text
            shutil.rmtree(folder)


@pytest.mark.parametrize("size", [0.3, 0.7, 0.99])
def test_commit_that_a_crash_has_cut_off_is_no_damage(size: float, tmp_path: Path) -> None:
    store = JobStore(tmp_path / "data", job_days=1.0)
    store.create("square", "local")
    log = tmp_path / "data" / "jobs.sqlite-wal"
    before = log.stat().st_size
    number = store.create("square", "local")
    store.append(number, 0, CaseBlock.of(cases(range(200))))
    shutil.copytree(tmp_path / "data", tmp_path / "copy")
    store.close()
    with (tmp_path / "copy" / log.name).open("r+b") as file:
        file.truncate(before + round(size * (file.seek(0, 2) - before)))
    JobStore(tmp_path / "copy", job_days=1.0).expire(at_start=True)
    assert not (tmp_path / "copy" / "damaged").exists()
