"""Maintenance of a folder of results: statistics, verification, rebuilding the index and eviction."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.cache.cache import ResultCache
from service.cache.maintenance import evict, rebuild, stat, verify
from service.cache.segments import digest_of, to_segment
from service.errors import UnusableFolderError
from tests.service.records import critical_angle, key_of

pytestmark = pytest.mark.timeout(60)

WRITER = Path(__file__).with_name("cache_writer.py")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folder with three segments of ten results each."""
    with ResultCache(tmp_path, memory_bytes=0, disk_bytes=10**9) as cache:
        for first in (0, 10, 20):
            cache.put_many([critical_angle(number) for number in range(first, first + 10)])
    return tmp_path


def segment(folder: Path, first: int) -> Path:
    name = digest_of(to_segment(*(critical_angle(number) for number in range(first, first + 10))))
    return folder / "results" / "segments" / name[:2] / f"{name}.h5"


def test_stat_reports_the_contents_even_beside_a_running_service(folder: Path) -> None:
    size = sum(segment(folder, first).stat().st_size for first in (0, 10, 20))
    for _ in range(2):
        assert (stat(folder).bytes, stat(folder).segments, stat(folder).cases) == (size, 3, 30)
    with ResultCache(folder, memory_bytes=0, disk_bytes=10**9) as cache:
        cache.put_many([critical_angle(99)])
        assert stat(folder).cases == 31


def test_verify_sets_damaged_segments_aside_and_indexes_the_others(folder: Path) -> None:
    os.truncate(segment(folder, 10), 3000)
    (folder / "results" / "index.sqlite").unlink()
    found = verify(folder)
    assert found.statistics.cases == 20
    assert (folder / "damaged" / segment(folder, 10).name).exists()
    assert verify(folder).damaged == []
    content = bytearray(segment(folder, 20).read_bytes())
    content[-7] ^= 1
    segment(folder, 20).write_bytes(content)
    assert verify(folder).damaged == [segment(folder, 20).stem]
    assert stat(folder).cases == 10


def test_rebuild_finds_every_result(folder: Path) -> None:
    before = stat(folder)
    (folder / "results" / "index.sqlite").write_bytes(b"no database")
    assert rebuild(folder) == before
    assert rebuild(folder) == before
    with ResultCache(folder, memory_bytes=0, disk_bytes=10**9) as cache:
        assert len(cache.known([key_of(number) for number in range(30)])) == 30


def test_evicting_frees_space(folder: Path) -> None:
    left = evict(folder, stat(folder).bytes - 1)
    assert (left.segments, left.cases) == (2, 20)
    assert not segment(folder, 0).exists()
    assert evict(folder, 0).segments == 0


def test_folder_without_results_or_with_a_service_is_refused(tmp_path: Path) -> None:
    for command in (stat, verify, rebuild):
        with pytest.raises(UnusableFolderError, match="no results"):
            command(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()
    with subprocess.Popen([sys.executable, str(WRITER), str(tmp_path), str(10**9)], stdout=subprocess.PIPE) as service:
        assert service.stdout
        service.stdout.readline()
        for command in (verify, rebuild):
            with pytest.raises(UnusableFolderError, match="in use"):
                command(tmp_path)
        assert stat(tmp_path).cases >= 5
        service.kill()
