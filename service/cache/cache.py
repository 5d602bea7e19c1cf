"""Cache of results: many in each segment on disk, and the most recent ones in memory.

    results/journal.sqlite   results of single queries that are in no segment yet; see `service.cache.index`
    results/index.sqlite     segment and row of each result; rebuilt from the segments if it is lost
    results/segments/        see `service.cache.segments`

A folder belongs to one running service.
"""

import logging
import re
import sqlite3
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

from cachetools import LRUCache

from service.cache.folder_lock import FolderLock
from service.cache.index import Index, Journal, Location, Statistics, discard_database
from service.cache.record import Record
from service.cache.segments import DecodedSegment, Segment, Segments, digest_of, discard, encode_segments
from service.errors import DamagedFileError, FolderReplacedError, storage_reason
from service.private_files import make_private_folder

NOT_CACHED = "result_not_cached"
KEY = re.compile(r"[0-9a-f]{64}")
PROBE = bytes(65_536)
"""Data written to test the disk, large enough for a full disk to refuse it."""
JOURNAL_RECORDS, JOURNAL_BYTES = 200, 2 * 1024 * 1024
"""Number and size of results in the journal at which they are written to segments, which takes a thread tens of
milliseconds [1, bytes]. The size also limits the memory of the results in the journal."""
EVICTED_SHARE = 0.1
"""Fraction of the limit freed by one eviction, so that not every new result causes one; chosen by judgement."""
EVICTED_AT_ONCE = 64
"""Largest number of segments evicted in one step. A result to be stored waits for a step, not for a whole eviction."""

log = logging.getLogger(__name__)


class ResultCache:
    """Cache of records in memory and on disk. Used as a context manager, it is closed at the end of the block.

    Parameters
    ----------
    folder
        Data folder of the service, created if it is missing.
    memory_bytes
        Limit on the memory of the most recently used records. [bytes]
    disk_bytes
        Limit on the disk space of the segments. The least recently used ones are evicted first. [bytes]

    Raises
    ------
    FolderInUseError
        If the folder belongs to another running service.
    FolderLayoutError
        If the folder was written by another version of the program. Its results are left unchanged.

    Notes
    -----
    No method except `check_folder` raises an error if the disk is full, read-only or missing, so that requests are
    still answered; `last_error` has the reason. All methods except `recall` and `statistics` may wait for the disk, and
    must not be called on the event loop.
    """

    def __init__(self, folder: Path, *, memory_bytes: int, disk_bytes: int) -> None:
        self.last_error: str | None = None
        self._folder = folder
        self._disk_bytes = disk_bytes
        self._recent: LRUCache[str, Record] = LRUCache(memory_bytes, getsizeof=lambda record: record.nbytes)
        self._remembering = threading.Lock()
        """Lock of `_recent`."""
        self._segments = Segments(folder)
        self._index_path = folder / "results" / "index.sqlite"
        self._changing = threading.Lock()
        """Lock held while files and index change together."""
        self._evicting = threading.Lock()
        self._flushing = threading.Lock()
        self._flusher = ThreadPoolExecutor(1, "journal")
        self._flushed: Future[None] | None = None
        """Latest flush in the thread of `_flusher`; None before the first one."""
        self._pending: dict[str, Record] = {}
        """Results in the journal that are in no segment yet."""
        self._pending_bytes = 0
        """Approximate size of the answers in `_pending` [bytes]. Threads add to it without a lock, so an addition may
        be lost. Each flush computes the size anew."""
        self._lock: FolderLock | None = None
        with self._recording_errors():
            self._lock = FolderLock(folder)
        with ExitStack() as opened:
            opened.callback(self._release)
            self._index = self._open_index()  # Raises FolderLayoutError before a folder of another version is changed.
            opened.callback(self._index.close)
            self._segments.sweep()
            self.writable()
            self._reconcile()
            self._journal = self._open_journal()
            opened.pop_all()  # nothing failed, so the cache stays open
        self.found_results = bool(self._pending or self.statistics().cases)
        """True if there were results in the folder at the start."""
        self.flush()
        self._make_room()

    def __enter__(self) -> "ResultCache":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def recall(self, key: str) -> Record | None:
        """Return the record of a key if it is in memory.

        The record is a copy. A record keeps the content parsed from it, so the cached one would keep it in memory.
        """
        with self._remembering:
            record = self._recent.get(key)
        return None if record is None else record.compact()

    def get(self, key: str) -> Record | None:
        """Return the record of a key from memory or disk, and keep it in memory."""
        record = self.get_many([key]).get(key)
        if record is not None:
            self._remember(record)
        return record

    def get_many(self, keys: Sequence[str]) -> dict[str, Record]:
        """Return the records of the given keys; missing ones are left out.

        Records from disk are not kept in memory, since those of one batch would evict everything else.
        """
        found = {key: record for key in keys if (record := self.recall(key) or self._pending.get(key))}
        wanted: dict[str, dict[str, int]] = defaultdict(dict)
        for key, place in self._find([key for key in keys if key not in found]).items():
            wanted[place.segment][key] = place.row
        for segment, rows in wanted.items():
            found |= self._read(segment, rows)
        self._use(wanted)
        return found

    def known(self, keys: Sequence[str]) -> set[str]:
        """Return the keys whose records are stored, in the journal or in segments that have been checked."""
        pending = {key for key in keys if key in self._pending}
        places = self._find([key for key in keys if key not in pending])
        whole = {name for name in {place.segment for place in places.values()} if self._check(name)}
        self._use(whole)
        return pending | {key for key, place in places.items() if place.segment in whole}

    def put(self, record: Record) -> Record:
        """Store a record in the journal, and return it, with a warning if it could not be written.

        A full journal is written to segments in a thread, for which no caller waits.
        """
        if self._journal is None:
            [record] = self.put_many([record])
        elif not self._add_to_journal(self._journal, record):
            record = self._unstored(record)
        self._remember(record)
        if self._journal_is_full() and (self._flushed is None or self._flushed.done()):
            self._flushed = self._flusher.submit(self._flush_full_journal)
        return record

    def flush(self) -> None:
        """Write the results of the journal to segments, at least one for each operation and version."""
        with self._flushing:
            self._empty_journal()

    def put_many(self, records: Sequence[Record], segments: Sequence[Segment] = ()) -> list[Record]:
        """Store records of one operation in few segments, and return them, with a warning if they were not written.

        Parameters
        ----------
        segments
            Segments of some of these records, which a worker has already encoded.
        """
        stored = {key for keys, _ in segments for key in keys}
        rest = [record for record in records if record.key not in stored]
        more = encode_segments(rest) if rest else []
        lost: set[str] = set()
        for keys, content in (*segments, *more):
            if not self._store(keys, content):
                lost.update(keys)
        return [self._unstored(record) if record.key in lost else record for record in records]

    def _unstored(self, record: Record) -> Record:
        found = record.with_warning(NOT_CACHED, f"this result was not stored: {self.last_error}")
        found.stored = False
        return found

    def check_folder(self) -> None:
        """Check that the data folder is still the one that was opened.

        Raises
        ------
        FolderReplacedError
            If the folder has been removed or replaced.
        """
        if self._lock is not None:
            self._lock.check()

    def writable(self) -> bool:
        """Return True if results can be written. This is tested by writing and removing a file."""
        with self._recording_errors():
            self.check_folder()
            discard(self._segments.stage(PROBE))
            self._note(None)
            return True
        return False

    def set_aside(self) -> list[str]:
        """Return the names of the files in the folder `damaged`."""
        try:
            return sorted(path.name for path in (self._folder / "damaged").iterdir())
        except OSError:
            return []

    def statistics(self) -> Statistics:
        """Return the total size and number of the segments, and the number of results in them."""
        return self._index.statistics

    def evict(self, limit: int, *, keep: str = "") -> None:
        """Evict the least recently used segments until the total size is at most `limit`; `keep` is never evicted."""
        # The times of last use decide the order. A full disk may refuse to write them, but must not prevent the
        # eviction that makes room: hence two blocks.
        with self._recording_errors():
            self._index.flush()
        with self._recording_errors():
            self.check_folder()
            while self._index.statistics.bytes > limit:
                excess, names = self._index.statistics.bytes - limit, []
                for name, size in self._index.oldest(EVICTED_AT_ONCE, but=keep):
                    if excess > 0:
                        names.append(name)
                        excess -= size
                if not names:
                    return
                with self._changing:
                    self._segments.remove(names)
                    self._index.drop(names)

    def verify(self) -> list[str]:
        """Read every segment, and return the names of those that are damaged or cannot be read.

        Intact segments that are missing from the index are added to it, and damaged ones are set aside.
        """
        return [name for name in sorted(self._segments.names()) if not self._adopt(name)]

    def rebuild(self) -> None:
        """Rebuild the index from the segments. No other thread may use the cache at the same time."""
        with self._recording_errors():
            self._index.close()
            discard_database(self._index_path)
            self._index = self._open_index()
            self._reconcile()

    def close(self) -> None:
        """Write the journal to segments, close the files, and release the folder."""
        self._flusher.shutdown()
        self.flush()
        with self._recording_errors():
            if self._journal is not None:
                self._journal.close()
        with self._recording_errors():
            self._index.close()
        self._release()

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def _remember(self, record: Record) -> None:
        """Keep a record in memory, unless it is larger than the whole memory cache."""
        if record.nbytes <= self._recent.maxsize:
            with self._remembering:
                self._recent[record.key] = record.compact(exact=True)

    def _open_index(self) -> Index:
        with self._recording_errors():
            make_private_folder(self._index_path.parent)
            return Index(self._index_path)
        return Index(None)  # If the disk fails, `_reconcile` fills an index in memory from the segments.

    def _open_journal(self) -> Journal | None:
        """Open the journal, and load the results that a killed process has left in it."""
        with self._recording_errors():
            journal = Journal(self._index_path.with_name("journal.sqlite"))
            left, damaged = journal.take_over()
            if damaged:
                log.warning("cache folder %s: removed %d damaged results of the journal", self._folder, damaged)
            stored = self._find([record.key for record in left])
            journal.remove(stored)
            self._pending = {record.key: record for record in left if record.key not in stored}
            self._count_pending()
            return journal
        return None

    def _journal_is_full(self) -> bool:
        return len(self._pending) >= JOURNAL_RECORDS or self._pending_bytes >= JOURNAL_BYTES

    def _count_pending(self) -> None:
        self._pending_bytes = sum(len(record.json) for record in list(self._pending.values()))

    def _flush_full_journal(self) -> None:
        """Flush the journal, unless another flush has just emptied it."""
        with self._flushing:
            if self._journal_is_full():
                self._empty_journal()

    def _empty_journal(self) -> None:
        groups: dict[tuple[str, str, str], list[Record]] = defaultdict(list)
        for record in list(self._pending.values()):
            groups[record.operation, record.engine_version, record.schema_version].append(record)
        for records in groups.values():
            segments, rejected = _encodable_segments(records)
            lost = {key for keys, content in segments if not self._store(keys, content) for key in keys}
            done = [record.key for record in records if record.key not in lost]
            for key in done:
                del self._pending[key]
            for key, error in rejected.items():
                log.error("cache folder %s: result %s cannot be stored and is removed: %s", self._folder, key, error)
            with self._recording_errors():
                if self._journal is not None:
                    self._journal.remove(done)  # If this fails, the next start removes them: see `_open_journal`.
        self._count_pending()

    def _add_to_journal(self, journal: Journal, record: Record) -> bool:
        with self._recording_errors():
            self.check_folder()
            journal.add(record)
            self._pending[record.key] = record
            self._pending_bytes += len(record.json)
            self._note(None)
            return True
        return False

    def _reconcile(self) -> None:
        """Make the index match the files. A crash may have left one of the two changed and the other not."""
        with self._recording_errors():
            indexed, there = self._index.names(), self._segments.names()
            self._index.drop(indexed - there)
            new = there - indexed
            if new:
                log.info("%d segments are not in the index: reading them", len(new))
            for name in new:
                self._adopt(name)

    def _store(self, keys: Sequence[str], content: bytes) -> bool:
        name = digest_of(content)
        with self._recording_errors():
            self.check_folder()
            staged = self._segments.stage(content)
            with self._changing:
                self._segments.place(staged, name)
                self._enter(name, keys, len(content))
            self._note(None)
            self._make_room(name)
            return True
        return False

    def _enter(self, name: str, keys: Sequence[str], size: int) -> None:
        try:
            self._index.add(name, keys, size, time.time())
        except sqlite3.Error:
            places = self._index.find(keys).values()
            # A segment outside the index would take disk space without being found before the next start.
            if all(place.segment != name for place in places):
                self._segments.remove([name])
            raise

    def _make_room(self, latest: str = "") -> None:
        # Only one thread evicts. Other threads do not wait for it, so the total size may exceed the limit for a moment.
        if self.statistics().bytes > self._disk_bytes and self._evicting.acquire(blocking=False):
            try:
                self.evict(round(self._disk_bytes * (1.0 - EVICTED_SHARE)), keep=latest)
            finally:
                self._evicting.release()

    def _find(self, keys: Sequence[str]) -> dict[str, Location]:
        with self._recording_errors():
            # A key may come from a URL, where it can be any text.
            return self._index.find([key for key in keys if KEY.fullmatch(key)])
        return {}

    def _use(self, names: Iterable[str]) -> None:
        with self._recording_errors():
            self._index.use(names)

    def _read(self, name: str, rows: Mapping[str, int]) -> dict[str, Record]:
        """Return the results in the given rows of a segment."""
        with self._as_cache_miss(name):
            records = self._segments.decoded(name).records(rows.values())
            if [record.key for record in records] != list(rows):
                self._index.drop([name])  # The rows in the index are wrong; `_adopt` adds them again from the file.
                self._adopt(name)
            return {record.key: record for record in records if record.key in rows}
        return {}

    def _check(self, name: str) -> bool:
        with self._as_cache_miss(name):
            self._segments.check(name)
            return True
        return False

    def _adopt(self, name: str) -> bool:
        """Add a segment to the index if it is not damaged."""
        with self._as_cache_miss(name):
            content, used = self._segments.read(name), self._segments.path(name).stat().st_mtime
            self._index.add(name, DecodedSegment(content).keys, len(content), used)
            return True
        return False

    @contextmanager
    def _as_cache_miss(self, name: str) -> Iterator[None]:
        """Treat a missing or damaged segment as a cache miss, and remove it from the index."""
        with self._recording_errors():
            try:
                yield
            except FileNotFoundError:
                self.check_folder()
                with self._changing:
                    if not self._segments.path(name).exists():  # Another thread may have written it again.
                        self._index.drop([name])
            except DamagedFileError as error:
                self.check_folder()
                with self._changing:
                    self._segments.set_aside(name, str(error))
                    self._index.drop([name])

    @contextmanager
    def _recording_errors(self) -> Iterator[None]:
        """Record a disk error or a replaced folder instead of raising an exception, and continue after the block."""
        try:
            yield
        except (OSError, sqlite3.Error, FolderReplacedError) as error:
            self._note(error)

    def _note(self, error: Exception | None) -> None:
        last_error = None if error is None else storage_reason(error)
        if last_error != self.last_error:
            log.warning("cache folder %s: %s", self._folder, error or "writing works again")
        self.last_error = last_error


def _encodable_segments(records: Sequence[Record]) -> tuple[list[Segment], dict[str, Exception]]:
    """Return the segments of the records that can be encoded, and the errors of the other records by key.

    A record that cannot be encoded may come from the journal of another version.
    """
    try:
        return encode_segments(records), {}
    except Exception as error:  # noqa: BLE001 (logged with the key; the others are kept)
        if len(records) == 1:
            return [], {records[0].key: error}
    rejected: dict[str, Exception] = {}
    for record in records:
        rejected |= _encodable_segments([record])[1]
    rest = [record for record in records if record.key not in rejected]
    return encode_segments(rest) if rest else [], rejected
