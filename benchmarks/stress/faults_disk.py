"""The disk is full in the middle of a batch: no answer is lost, and nothing stays of it once there is room again."""

import random
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.stress.faults_cases import lines, searches
from benchmarks.stress.faults_folder import faults_of
from benchmarks.stress.faults_found import Found, rounds_until
from benchmarks.stress.faults_victim import Victim

CASES = 200
DISK_BYTES = 24 * 1024 * 1024
FILE_BYTES = 4096
"""Largest file where no small disk can be mounted: then nothing can be written either."""
KINDS = ("killed while full", "started while full", "stopped when there is room", "not restarted")
STORAGE_FULL = "urn:ricochet:problem:storage-full"


@dataclass(frozen=True, slots=True)
class Disk:
    """A disk that can be filled.

    Parameters
    ----------
    data
        Folder on it for the service.
    how
        It is filled.
    fill, free
        Given the process that is to find it so.
    """

    data: Path
    how: str
    fill: Callable[[int], None]
    free: Callable[[int], None]


@contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    """A small disk, in memory, with a ballast file; where it cannot be mounted, a limit on the size of files."""
    place = folder / "disk"
    place.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(place)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True, check=False).returncode:
        yield Disk(place / "data", "files limited to 4 kB", lambda pid: limit(pid, FILE_BYTES), limit)
        return
    ballast = place / "ballast"
    try:
        yield Disk(place / "data", "tmpfs filled by ballast", lambda _: fill(ballast), lambda _: ballast.unlink())
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)  # noqa: S607


def fill(ballast: Path) -> None:
    """Write to this file until nothing more can be written."""
    with suppress(OSError), ballast.open("ab", buffering=0) as file:
        for size in (1 << 20, 1 << 12, 1):
            with suppress(OSError):
                while file.write(bytes(size)) == size:
                    pass


def limit(pid: int, size: int = resource.RLIM_INFINITY) -> None:
    """Limit the files this process may write."""
    if pid:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]))


def fill_disks(folder: Path, rounds: int, deadline: float, seed: int = 0) -> Found:
    """Fill the disk in each of these rounds, when some cases are done."""
    found, instants = Found(), random.Random(seed)  # noqa: S311 (nothing is to be kept secret)
    with (
        small_disk(folder) as disk,
        Victim(folder / "undisturbed") as undisturbed,
        Victim(folder / "filled", data=disk.data) as victim,
    ):
        undisturbed.start()
        victim.start()
        for number in rounds_until(rounds, deadline):
            kind = KINDS[number % len(KINDS)]
            found.kinds[f"{kind} ({disk.how})"] += 1
            body = lines(searches(CASES, first=number * CASES))
            job = victim.until_done(victim.submit(body), instants.randrange(CASES // 2))
            disk.fill(victim.pid)
            told = see_it_through(victim, job, number, found)
            restart(victim, disk, kind, found)
            ended = victim.finished(victim.job(told))
            expected = undisturbed.finished(undisturbed.submit(body))
            see_the_results(victim, ended, undisturbed.results(expected), found)
            again = victim.finished(victim.submit(body))
            found.claim(victim.results(again) == undisturbed.results(expected), "other results than with room")
            for fault in faults_of(victim.data):
                found.claim(None, fault)
        found.claim(victim.stop() == 0, "the server did not end well")
    return found


def see_it_through(victim: Victim, job: dict[str, Any], number: int, found: Found) -> dict[str, Any]:
    """See what the service tells while nothing can be written; return the job at its end."""
    job = victim.finished(job)
    refused = victim.client.post(
        "/cra/batch", content=lines(searches(CASES, first=500_000)), headers={"Content-Type": "application/jsonl"}
    )
    found.claim(refused.status_code == 507, f"a job was answered {refused.status_code} though it cannot be stored")
    found.claim(job["status"] in {"successful", "failed"}, f"the job ended {job['status']}")
    found.note("failed", job["status"] == "failed")
    found.note("done", job["counts"]["done"])
    if job["status"] == "failed":
        found.claim(job["problem"]["type"] == STORAGE_FULL, f"the job tells {job['problem']}")
        found.claim(str(victim.data) not in job["problem"]["detail"], "the problem tells of a path")
    results = victim.results(job)
    told = len(results), sum(b'"result":' in line for line in results)
    found.claim(told == (job["counts"]["done"],) * 2, f"{told} results of {job['counts']['done']}")
    [case] = searches(1, first=600_000 + number)
    found.claim(victim.client.post("/cra", json=case).status_code == 200, "a query was not answered")
    found.claim(victim.client.get("/livez").status_code == 200, "the service does not live")
    for form in ("text/csv", "application/x-hdf5"):
        status = victim.client.get(job["links"]["results"], headers={"Accept": form}).status_code
        found.claim(status == 200 or (status == 507 and "hdf5" in form), f"{form} was answered {status}")
    return job


def restart(victim: Victim, disk: Disk, kind: str, found: Found) -> None:
    """Make room again, and start the service anew."""
    if kind == "not restarted":
        disk.free(victim.pid)
    elif kind == "stopped when there is room":
        disk.free(victim.pid)
        found.claim(victim.stop() == 0, "the server did not end well")
        victim.start()
    else:
        victim.kill()
        if kind == "started while full" and "tmpfs" in disk.how:
            victim.spawn()
            victim.wait_until("/livez")
            found.claim(victim.client.get("/readyz").status_code == 503, "ready, though nothing can be written")
            disk.free(victim.pid)
            victim.wait_until("/readyz")
        else:
            disk.free(0)
            victim.start()


def see_the_results(victim: Victim, job: dict[str, Any], expected: list[bytes], found: Found) -> None:
    """See that what the job has is what it should have."""
    found.claim(job["status"] in {"successful", "failed"}, f"with room again, the job is {job['status']}")
    results = victim.results(job)
    if job["status"] == "successful":
        found.claim(results == expected, "other results than with room, of the job itself")
    else:
        found.claim(dict.fromkeys(results).keys() <= set(expected), "wrong results of a failed job")
    found.claim(len(results) == job["counts"]["done"], "not every case that is done has a result")
