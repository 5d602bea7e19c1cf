"""A disk that a test fills up and frees again."""

import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

DISK_BYTES = 24 * 1024 * 1024
FILE_BYTES = 4096
"""Largest file where no small disk can be mounted: then nothing can be written either."""


@dataclass(frozen=True, slots=True)
class Disk:
    """A disk that can be filled.

    Parameters
    ----------
    data
        Data folder on it.
    mounted
        Whether it is a disk, full for every process; otherwise a limit on the files of one process.
    fill, free
        Take the id of the process that is to find the disk full, or free again.
    """

    data: Path
    mounted: bool
    fill: Callable[[int], None]
    free: Callable[[int], None]


@contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    """A tmpfs with a ballast file; without the right to mount one, a limit on the size of files."""
    place = folder / "disk"
    place.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(place)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True, check=False).returncode:
        yield Disk(place / "data", False, lambda pid: limit(pid, FILE_BYTES), limit)
        return
    ballast = place / "ballast"
    try:
        yield Disk(place / "data", True, lambda _: fill(ballast), lambda _: ballast.unlink())
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
    """Limit the files that this process may write; 0 is no process."""
    if pid:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]))
