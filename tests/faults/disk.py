"""A disk that a test can fill and free."""

import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

DISK_BYTES = 24 * 1024 * 1024
FILE_BYTES = 4096
"""Limit on file sizes, used where no small disk can be mounted; less than any database or file of results. [bytes]"""


@dataclass(frozen=True, slots=True)
class Disk:
    """A disk that can be filled and freed.

    Parameters
    ----------
    data
        Data folder on it.
    mounted
        Whether it is a real file system, full for every process. Otherwise one process has a limit on file sizes.
    fill, free
        Functions that make the disk full or free again for the process with the given id.
    """

    data: Path
    mounted: bool
    fill: Callable[[int], None]
    free: Callable[[int], None]


@contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    """Make a tmpfs that a ballast file can fill or, without the right to mount one, use a limit on file sizes."""
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
    """Limit the size of files that a process may write; do nothing for process 0."""
    if pid:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]))
