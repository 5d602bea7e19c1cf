"""Function that moves damaged files to another folder."""

import logging
import time
from contextlib import suppress
from pathlib import Path

from service.private_files import make_private_folder

log = logging.getLogger(__name__)


def set_aside(path: Path, folder: Path, reason: str) -> None:
    """Move a damaged file into a folder, with its write-ahead log if it is a database.

    The file is kept because parts of it may be worth saving.

    Raises
    ------
    OSError
        If the file cannot be moved.
    """
    aside = folder / path.name
    if aside.exists():
        aside = folder / f"{path.stem}-{time.time_ns()}{path.suffix}"
    log.warning("%s set aside as %s: %s", path, aside, reason)
    make_private_folder(folder)
    path.replace(aside)
    with suppress(FileNotFoundError):
        Path(f"{path}-wal").replace(f"{aside}-wal")
    Path(f"{path}-shm").unlink(missing_ok=True)  # SQLite rebuilds the shared memory file from the log.
