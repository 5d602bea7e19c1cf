"""Files are lost or damaged while the service is stopped: only lost results are computed again."""

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from .cases import LONG, jsonl, searches
from .data_folder import INDEX, JOBS, Segment, journaled, segments
from .server import RestartableServer

CASES = 200
Loss = Callable[[RestartableServer, random.Random], int]
"""Function that removes or damages a file, and returns the number of lost results."""


def lose_index(server: RestartableServer, choice: random.Random) -> int:
    """Remove the index; its write-ahead log may remain."""
    return _remove(server.data / INDEX, choice)


def lose_jobs(server: RestartableServer, choice: random.Random) -> int:
    """Remove the database of jobs; its write-ahead log may remain."""
    return _remove(server.data / JOBS, choice)


def rebuild_index(server: RestartableServer, choice: random.Random) -> int:
    """Remove the index, and rebuild it with `ricochet cache rebuild`."""
    _remove(server.data / INDEX, choice)
    server.command("cache", "rebuild")
    return 0


def damage_index(server: RestartableServer, choice: random.Random) -> int:
    """Overwrite 4096 bytes of the index."""
    return _overwrite(server.data / INDEX, choice, 4096)


def damage_jobs(server: RestartableServer, choice: random.Random) -> int:
    """Overwrite half of the database of jobs."""
    return _overwrite(server.data / JOBS, choice, (server.data / JOBS).stat().st_size // 2)


def truncate_segment(server: RestartableServer, choice: random.Random) -> int:
    """Cut off the end of a file of results."""
    segment, lost = _any_segment(server, choice)
    os.truncate(segment.path, choice.randrange(segment.path.stat().st_size))
    return lost


def flip_bit(server: RestartableServer, choice: random.Random) -> int:
    """Change one bit of a file of results, but not its size or time."""
    segment, lost = _any_segment(server, choice)
    status, content = segment.path.stat(), bytearray(segment.path.read_bytes())
    content[choice.randrange(len(content))] ^= 1 << choice.randrange(8)
    segment.path.write_bytes(content)
    os.utime(segment.path, ns=(status.st_atime_ns, status.st_mtime_ns))
    return lost


def lose_segment(server: RestartableServer, choice: random.Random) -> int:
    """Remove a file of results."""
    segment, lost = _any_segment(server, choice)
    segment.path.unlink()
    return lost


LOSSES: tuple[Loss, ...] = (
    lose_index,
    truncate_segment,
    flip_bit,
    lose_jobs,
    rebuild_index,
    lose_segment,
    damage_index,
    damage_jobs,
)


@pytest.mark.parametrize("rounds", [len(LOSSES), LONG])
def test_lost_files_cost_only_their_own_results(rounds: int, tmp_path: Path) -> None:
    choice, body = random.Random(0), jsonl(searches(CASES))  # noqa: S311
    with RestartableServer(tmp_path) as server:
        server.start()
        job = server.finished(server.submit(body))
        assert job["status"] == "successful"
        expected = server.results(job)
        for number in range(rounds):
            lose = LOSSES[number % len(LOSSES)]
            if number % 2:
                server.kill()
            else:
                server.stop()
            lost = lose(server, choice)
            server.start()
            status = server.client.get(job["links"]["self"]).status_code
            assert status == (404 if lose in {lose_jobs, damage_jobs} else 200), lose
            if status == 200 and number % 3 == 0:  # Reading the results of a job computes lost ones.
                assert server.results(job) == expected, lose
            again = server.finished(server.submit(body))
            assert again["status"] == "successful", lose
            assert server.results(again) == expected, lose
            assert server.computed() == lost, lose
            shutil.rmtree(server.data / "damaged", ignore_errors=True)
            assert server.folder_faults() == [], lose
            job = again
        assert server.logged_errors() == []


def _any_segment(server: RestartableServer, choice: random.Random) -> tuple[Segment, int]:
    """Choose a file of results; return it with the number of its results that neither another file nor the journal has.

    A server that is killed while it merges files, or writes the journal to one, leaves results in both places.
    """
    files = list(segments(server.data).values())
    chosen = choice.choice(files)
    elsewhere = {key for each in files if each is not chosen for key in each.keys} | journaled(server.data).keys()
    return chosen, len(set(chosen.keys) - elsewhere)


def _remove(path: Path, choice: random.Random) -> int:
    path.unlink()
    for end in ("-wal", "-shm"):
        if choice.random() < 0.5:
            Path(f"{path}{end}").unlink(missing_ok=True)
    return 0


def _overwrite(path: Path, choice: random.Random, count: int) -> int:
    content = bytearray(path.read_bytes())
    start = choice.randrange(max(1, len(content) - count))
    content[start : start + count] = choice.randbytes(count)
    path.write_bytes(content)
    return 0
