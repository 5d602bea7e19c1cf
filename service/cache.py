"""Results on disk, one HDF5 file to a key, and the latest of them in memory.

    results/<first two digits>/<key>.h5   results
    results/.partial/                     being written; what is left there after a crash is removed at the next start
    damaged/<key>.h5                      files that were not what had been written, set aside

A folder belongs to one running service.
"""

import itertools
import logging
import os
import re
import shutil
import threading
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path

from service.hdf5 import DamagedFileError, from_hdf5, to_hdf5
from service.record import Record

NOT_CACHED = "result_not_cached"
KEY = re.compile(r"[0-9a-f]{64}")
PROBE = bytes(65_536)
"""Enough for a full disk to refuse it."""

log = logging.getLogger(__name__)


class RecentRecords:
    """The records used last, up to a number of bytes."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._records: OrderedDict[str, tuple[Record, int]] = OrderedDict()
        self._nbytes = 0
        self._lock = threading.Lock()

    def get(self, key: str) -> Record | None:
        """Record of this key, which becomes the latest."""
        with self._lock:
            if key not in self._records:
                return None
            self._records.move_to_end(key)
            return self._records[key][0]

    def put(self, record: Record) -> None:
        """Keep the record, if it fits at all, and drop as many of those used longest ago as it takes."""
        nbytes = record.nbytes
        with self._lock:
            _, replaced = self._records.pop(record.key, (None, 0))
            self._nbytes -= replaced
            if nbytes > self._limit:
                return
            self._records[record.key] = (record, nbytes)
            self._nbytes += nbytes
            while self._nbytes > self._limit:
                _, (_, dropped) = self._records.popitem(last=False)
                self._nbytes -= dropped


class ResultCache:
    """Keeps records.

    Parameters
    ----------
    folder
        Data folder of the service; made if it is not there.
    memory_bytes
        Memory for the latest records.

    Notes
    -----
    Nothing here raises for a disk that is full, read-only or gone: results are answered all the same, and `trouble`
    says what is wrong. Only `recall` is meant for the event loop, all else may wait for the disk.
    """

    def __init__(self, folder: Path, *, memory_bytes: int) -> None:
        self.trouble: str | None = None
        self._results = folder / "results"
        self._partial = self._results / ".partial"
        self._damaged = folder / "damaged"
        self._recent = RecentRecords(memory_bytes)
        self._numbers = itertools.count()
        shutil.rmtree(self._partial, ignore_errors=True)
        self.writable()

    def recall(self, key: str) -> Record | None:
        """Record of this key if it is in memory."""
        return self._recent.get(key)

    def get(self, key: str) -> Record | None:
        """Record of this key, from memory or from disk."""
        record = self._recent.get(key) or self._read(key)
        if record is not None:
            self._recent.put(record)
        return record

    def put(self, record: Record) -> Record:
        """Keep the record; return it as it is to be answered, with a warning if it could not be written."""
        if not self._write(self._path(record.key), to_hdf5(record)):
            record = record.with_warning(NOT_CACHED, f"this result was not stored: {self.trouble}")
        self._recent.put(record)
        return record

    def writable(self) -> bool:
        """Try whether results can be written now."""
        probe = self._partial / "probe"
        written = self._write(probe, PROBE)
        with suppress(OSError):
            probe.unlink(missing_ok=True)
        return written

    def _path(self, key: str) -> Path:
        return self._results / key[:2] / f"{key}.h5"

    def _read(self, key: str) -> Record | None:
        if KEY.fullmatch(key) is None:  # it may come from an address
            return None
        path = self._path(key)
        try:
            record = from_hdf5(path.read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            self._note(error)
            return None
        except DamagedFileError as error:
            self._set_aside(path, str(error))
            return None
        if record.key != key:
            self._set_aside(path, "it holds another result")
            return None
        return record

    def _write(self, path: Path, content: bytes) -> bool:
        """Write the file whole or not at all.

        No fsync: what a power cut leaves of the file fails its checksum and is computed again, which costs less than
        waiting for the disk at every result.
        """
        partial = self._partial / f"{path.stem}-{os.getpid()}-{next(self._numbers)}"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._partial.mkdir(parents=True, exist_ok=True)
            partial.write_bytes(content)
            partial.replace(path)
        except OSError as error:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            self._note(error)
            return False
        self._note(None)
        return True

    def _set_aside(self, path: Path, reason: str) -> None:
        log.warning("%s set aside: %s", path, reason)
        try:
            self._damaged.mkdir(parents=True, exist_ok=True)
            path.replace(self._damaged / path.name)
        except OSError as error:
            self._note(error)

    def _note(self, error: OSError | None) -> None:
        trouble = None if error is None else error.strerror or type(error).__name__
        if trouble != self.trouble:
            log.warning("cache folder %s: %s", self._results, error or "written again")
        self.trouble = trouble
