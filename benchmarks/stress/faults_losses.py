"""Files are lost or damaged while the service is stopped: what is there is found, and nothing else is computed."""

import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.stress.faults_cases import lines, searches
from benchmarks.stress.faults_folder import INDEX, JOBS, SEGMENTS, Segment, faults_of, segments
from benchmarks.stress.faults_found import Found, rounds_until
from benchmarks.stress.faults_victim import ROOT, Victim

CASES = 200


def lose_files(folder: Path, rounds: int, deadline: float, seed: int = 0) -> Found:
    """Lose or damage a file in each of these rounds, and ask for everything again."""
    found, dice = Found(), random.Random(seed)  # noqa: S311 (nothing is to be kept secret)
    body = lines(searches(CASES))
    with Victim(folder) as victim:
        victim.start()
        job = victim.finished(victim.submit(body))
        expected = victim.results(job)
        found.claim(job["status"] == "successful", f"the first job ended {job['status']}")
        for number in rounds_until(rounds, deadline):
            kind, lose = list(LOSSES.items())[number % len(LOSSES)]
            found.kinds[kind] += 1
            if number % 2:
                victim.kill()
            else:
                found.claim(victim.stop() == 0, "the server did not end well")
            lost = lose(victim.data, dice)
            victim.start()
            status = victim.client.get(job["links"]["self"]).status_code
            found.claim(status == (404 if "jobs" in kind else 200), f"the job of before was answered {status}")
            if status == 200 and number % 3 == 0:  # reading it computes what is lost
                found.claim(victim.results(job) == expected, "the job of before has other results")
            again = victim.finished(victim.submit(body))
            found.claim(again["status"] == "successful", f"the job ended {again['status']}")
            found.claim(victim.results(again) == expected, "other results than before")
            found.claim(victim.computed() == lost, f"{victim.computed()} computed though {lost} were lost")
            shutil.rmtree(victim.data / "damaged", ignore_errors=True)
            for fault in faults_of(victim.data):
                found.claim(None, fault)
            job = again
        found.faults += victim.complaints()
    return found


def lose_index(data: Path, dice: random.Random) -> int:
    """Remove the index; its log may stay behind."""
    return _remove(data / INDEX, dice)


def lose_jobs(data: Path, dice: random.Random) -> int:
    """Remove the jobs; likewise."""
    return _remove(data / JOBS, dice)


def rebuild_index(data: Path, dice: random.Random) -> int:
    """Remove the index, and have it made anew by command."""
    _remove(data / INDEX, dice)
    command = [sys.executable, "-m", "service.cli", "cache", "rebuild"]
    environment = os.environ | {"RICOCHET_DATA_DIR": str(data)}
    subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True)
    return 0


def damage_index(data: Path, dice: random.Random) -> int:
    """Write nonsense into the index."""
    _overwrite(data / INDEX, dice, 4096)
    return 0


def damage_jobs(data: Path, dice: random.Random) -> int:
    """Write nonsense over half of the jobs."""
    size = (data / JOBS).stat().st_size
    _overwrite(data / JOBS, dice, size // 2)
    return 0


def truncate_segment(data: Path, dice: random.Random) -> int:
    """Cut off the end of a segment."""
    path, segment = _one_of(data, dice)
    os.truncate(path, dice.randrange(path.stat().st_size))
    return len(segment.keys)


def flip_byte(data: Path, dice: random.Random) -> int:
    """Change one byte of a segment, and let it look untouched otherwise."""
    path, segment = _one_of(data, dice)
    status = path.stat()
    content = bytearray(path.read_bytes())
    content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
    path.write_bytes(content)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    return len(segment.keys)


def lose_segment(data: Path, dice: random.Random) -> int:
    """Remove a segment."""
    path, segment = _one_of(data, dice)
    path.unlink()
    return len(segment.keys)


LOSSES: dict[str, Callable[[Path, random.Random], int]] = {
    "index lost": lose_index,
    "segment cut short": truncate_segment,
    "byte flipped": flip_byte,
    "jobs lost": lose_jobs,
    "index lost and rebuilt by command": rebuild_index,
    "segment lost": lose_segment,
    "index damaged": damage_index,
    "jobs damaged": damage_jobs,
}
"""What is done to the folder; each tells how many results are lost by it."""


def _one_of(data: Path, dice: random.Random) -> tuple[Path, Segment]:
    segment = dice.choice(list(segments(data).values()))
    return data / SEGMENTS / segment.name[:2] / f"{segment.name}.h5", segment


def _remove(path: Path, dice: random.Random) -> int:
    path.unlink()
    for end in ("-wal", "-shm"):
        if dice.random() < 0.5:
            Path(f"{path}{end}").unlink(missing_ok=True)
    return 0


def _overwrite(path: Path, dice: random.Random, count: int) -> None:
    content = bytearray(path.read_bytes())
    start = dice.randrange(max(1, len(content) - count))
    content[start : start + count] = dice.randbytes(count)
    path.write_bytes(content)
