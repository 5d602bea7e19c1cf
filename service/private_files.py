"""Files and folders that are readable by their owner only, regardless of the umask.

They hold the hashes of API keys and the requests of all clients.
"""

import logging
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Literal

log = logging.getLogger(__name__)

OTHERS = stat.S_IRWXG | stat.S_IRWXO
"""Permission bits of the group and of everybody else."""


def open_private(path: Path, mode: Literal["ab", "wb", "xb"]) -> BinaryIO:
    """Open a file for writing, and create it with mode 0600 if it is missing.

    The mode is given to `os.open`, since a `chmod` afterwards would leave the file readable for a moment.
    """
    return open(path, mode, opener=lambda name, flags: os.open(name, flags, 0o600))


def make_private(path: Path) -> None:
    """Create a file with mode 0600, or remove the permissions of others from an existing file.

    A file restored from a backup may be readable by others.
    """
    open_private(path, "ab").close()
    # A file of another owner, or on a file system without permissions, keeps its mode: see `warn_of_readers`.
    with suppress(OSError):
        if path.stat().st_mode & OTHERS:
            path.chmod(0o600)


def make_private_folder(path: Path) -> None:
    """Create a folder and its parents with mode 0700; existing folders keep their mode."""
    if not path.is_dir():
        make_private_folder(path.parent)
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)


def warn_of_readers(*paths: Path) -> None:
    """Log a warning for files that others can access, as on file systems without permissions."""
    for path in paths:
        with suppress(OSError):
            if path.stat().st_mode & OTHERS:
                log.warning(
                    "%s can be read by other users of the machine: its file system does not store permissions, or they "
                    "cannot be changed; use another file system",
                    path,
                )
