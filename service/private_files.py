"""Files and folders that nobody else on the machine may read, whatever the umask is."""

import logging
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Literal

log = logging.getLogger(__name__)

OTHERS = stat.S_IRWXG | stat.S_IRWXO
"""Permissions of the group and of everybody else."""


def open_private(path: Path, mode: Literal["ab", "wb", "xb"]) -> BinaryIO:
    """Open a file for writing that nobody else may read."""
    return open(path, mode, opener=lambda name, flags: os.open(name, flags, 0o600))


def make_private(path: Path) -> None:
    """Create a file, or take the permissions of others from one that is there, restored from a backup for instance."""
    open_private(path, "ab").close()
    with suppress(OSError):  # of another owner, or on a file system without permissions: see `warn_of_readers`
        if path.stat().st_mode & OTHERS:
            path.chmod(0o600)


def make_private_folder(path: Path) -> None:
    """Create a folder and those above it; one that is there stays as it is."""
    if not path.is_dir():
        make_private_folder(path.parent)
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)


def warn_of_readers(*paths: Path) -> None:
    """Name in the log the files that others may read all the same: some file systems keep no permissions."""
    for path in paths:
        with suppress(OSError):
            if path.stat().st_mode & OTHERS:
                log.warning(
                    "%s can be read by other users of the machine: its file system does not keep permissions, or they "
                    "cannot be changed; keep the data folder on another one",
                    path,
                )
