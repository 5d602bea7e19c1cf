"""Lock on a data folder, held by the service that uses it."""

import fcntl
import os
from pathlib import Path

from service.errors import FolderInUseError, FolderReplacedError
from service.private_files import make_private, make_private_folder


class FolderLock:
    """Exclusive lock on a data folder. The kernel releases it when the process ends, even by SIGKILL.

    Parameters
    ----------
    folder
        Data folder, created if it is missing.

    Raises
    ------
    FolderInUseError
        If another service holds the lock.
    FolderReplacedError
        If the folder is replaced while it is being locked.
    OSError
        If the lock file cannot be created or locked.
    """

    def __init__(self, folder: Path) -> None:
        make_private_folder(folder)
        self._path = folder / "lock"
        make_private(self._path)
        self._file: int | None = os.open(self._path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.check()
        except BlockingIOError:
            self.release()
            raise FolderInUseError(f"the data folder {folder} is in use by another service") from None
        except (OSError, FolderReplacedError):
            self.release()
            raise

    def check(self) -> None:
        """Check that the path still leads to the locked folder.

        If the folder were replaced, another service could lock the new one, and both would write to it.

        Raises
        ------
        FolderReplacedError
            If the folder has been removed or replaced.
        """
        if self._file is not None:
            try:
                same = os.path.samestat(os.fstat(self._file), self._path.stat())
            except FileNotFoundError:
                same = False
            if not same:
                raise FolderReplacedError("the data folder has been removed or replaced; start the service again")

    def release(self) -> None:
        """Release the lock."""
        if self._file is not None:
            os.close(self._file)
        self._file = None
