"""The folder to which damaged files are moved."""

import logging
import time
from contextlib import suppress
from pathlib import Path

from service.private_files import make_private_folder

log = logging.getLogger(__name__)


def set_aside(path: Path, folder: Path, reason: str) -> None:
    """Move a damaged file into a folder, with its log if it is a database: it may hold what is worth saving.

    Raises
    ------
    OSError
        If it cannot be done.
    """
    aside = folder / path.name
    if aside.exists():
        aside = folder / f"{path.stem}-{time.time_ns()}{path.suffix}"
    log.warning("%s set aside as %s: %s", path, aside, reason)
    make_private_folder(folder)
    path.replace(aside)
    with suppress(FileNotFoundError):
        Path(f"{path}-wal").replace(f"{aside}-wal")
    Path(f"{path}-shm").unlink(missing_ok=True)
