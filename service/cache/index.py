"""SQLite files of the cache: the index, which locates results in segments, and the journal of the latest results.

The index can be rebuilt from the segments, with the modification times of their files as times of last use.
"""

import hashlib
import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from service.cache.damaged import set_aside
from service.cache.record import Record
from service.cache.sqlite import LAYOUT, check_layout, decode
from service.private_files import make_private

KEYS_AT_ONCE = 1000
"""Number of keys looked up in one query. It takes a few milliseconds, during which no result can be stored."""
FLUSH_SECONDS = 60.0
"""Shortest interval at which `Index.use` writes the times of last use [s]. Losing some in a crash only changes the
eviction order."""

INDEX_TABLES = """
CREATE TABLE segments (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    size INTEGER NOT NULL,
    cases INTEGER NOT NULL,
    used REAL NOT NULL
);
CREATE INDEX segments_by_use ON segments (used);
CREATE TABLE results (
    key BLOB PRIMARY KEY,
    segment INTEGER NOT NULL REFERENCES segments ON DELETE CASCADE,
    row INTEGER NOT NULL
) WITHOUT ROWID;
CREATE INDEX results_by_segment ON results (segment);
"""

# The sqlite3 module releases the interpreter lock at every row, and has to wait for it again while other threads are
# busy. So all keys are passed as one blob, 32 bytes for each, and all locations are returned as one JSON text.
FIND = """
WITH RECURSIVE wanted (number) AS (SELECT 0 UNION ALL SELECT number + 1 FROM wanted WHERE number + 1 < ?2)
SELECT json_group_array(json_array(wanted.number, segments.name, results.row)) FROM wanted
CROSS JOIN results ON results.key = substr(?1, 32 * wanted.number + 1, 32)
CROSS JOIN segments ON segments.id = results.segment
"""
ADD_SEGMENT = """
INSERT INTO segments (name, size, cases, used) VALUES (?1, ?2, ?3, ?4)
ON CONFLICT (name) DO UPDATE SET size = ?2, cases = ?3, used = max(used, ?4) RETURNING id
"""
ADD_RESULTS = """
WITH RECURSIVE added (number) AS (SELECT 0 UNION ALL SELECT number + 1 FROM added WHERE number + 1 < ?2)
INSERT OR REPLACE INTO results SELECT substr(?1, 32 * number + 1, 32), ?3, number FROM added
"""
USE = "UPDATE segments SET used = each.value FROM json_each(?) AS each WHERE name = each.key"
DROP = "DELETE FROM segments WHERE name IN (SELECT value FROM json_each(?))"
OLDEST = "SELECT name, size FROM segments WHERE name <> ? ORDER BY used LIMIT ?"
AMOUNT = "SELECT coalesce(sum(size), 0), count(*), coalesce(sum(cases), 0) FROM segments"
AMOUNT_OF = AMOUNT + " WHERE name IN (SELECT value FROM json_each(?))"  # noqa: S608 (constants)


@dataclass(frozen=True, slots=True)
class Location:
    """Segment and row that hold a result."""

    segment: str
    row: int


@dataclass(frozen=True, slots=True)
class Statistics:
    """Total size of the segments [bytes], number of segments, and number of results in them."""

    bytes: int
    segments: int
    cases: int


class Index:
    """Index of results by key. It is thread-safe; a lock admits one thread at a time.

    Parameters
    ----------
    path
        Path of the file, which is created if it is missing and replaced if it is damaged; None for an index in memory.

    Raises
    ------
    FolderLayoutError
        If the file has the layout of another version.
    sqlite3.Error, OSError
        If the disk fails; all methods raise them too.
    """

    def __init__(self, path: Path | None) -> None:
        self._lock = threading.Lock()
        self._used: dict[str, float] = {}
        self._flushed = time.monotonic()
        self._connection = _opened(path, INDEX_TABLES)
        self._statistics = self._amount(AMOUNT)

    @property
    def statistics(self) -> Statistics:
        """Statistics of all segments, kept in memory because the time to compute them grows with the index."""
        return self._statistics

    def find(self, keys: Sequence[str]) -> dict[str, Location]:
        """Return the locations of results by key; missing keys are left out."""
        found = {}
        for start in range(0, len(keys), KEYS_AT_ONCE):
            some = keys[start : start + KEYS_AT_ONCE]
            with self._lock:
                text = self._connection.execute(FIND, (bytes.fromhex("".join(some)), len(some))).fetchone()[0]
            found.update({some[number]: Location(name, row) for number, name, row in orjson.loads(text)})
        return found

    def add(self, segment: str, keys: Sequence[str], size: int, used: float) -> None:
        """Insert or update a segment with the keys of its results, in the order of its rows."""
        with self._changing() as connection:
            before = self._amount(AMOUNT_OF, _json([segment]))
            [(number,)] = connection.execute(ADD_SEGMENT, (segment, size, len(keys), used)).fetchall()
            connection.execute(ADD_RESULTS, (bytes.fromhex("".join(keys)), len(keys), number))
        self._grow(size - before.bytes, 1 - before.segments, len(keys) - before.cases)

    def drop(self, segments: Iterable[str]) -> None:
        """Delete the entries of segments and of their results."""
        names = _json(list(segments))
        with self._changing() as connection:
            gone = self._amount(AMOUNT_OF, names)
            connection.execute(DROP, (names,))
        self._grow(-gone.bytes, -gone.segments, -gone.cases)

    def use(self, segments: Iterable[str]) -> None:
        """Record that segments are used now. The times are written at most once per `FLUSH_SECONDS`."""
        now = time.time()
        with self._lock:
            self._used.update(dict.fromkeys(segments, now))
        if time.monotonic() > self._flushed + FLUSH_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write the times of last use."""
        if not self._used:
            return
        with self._changing() as connection:
            connection.execute(USE, (_json(self._used),))
            self._used = {}
            self._flushed = time.monotonic()

    def oldest(self, count: int, *, but: str) -> list[tuple[str, int]]:
        """Return names and sizes of the least recently used segments, except for the segment `but`."""
        with self._lock:
            return self._connection.execute(OLDEST, (but, count)).fetchall()

    def names(self) -> set[str]:
        """Return the names of all segments in the index."""
        with self._lock:
            return {name for (name,) in self._connection.execute("SELECT name FROM segments")}

    def close(self) -> None:
        """Write the times of last use, and close the file."""
        try:
            self.flush()
        finally:
            with self._lock:
                self._connection.close()

    @contextmanager
    def _changing(self) -> Iterator[sqlite3.Connection]:
        with self._lock, self._connection as connection:  # The connection commits, or rolls back after an exception.
            connection.execute("BEGIN IMMEDIATE")
            yield connection

    def _amount(self, query: str, *values: str) -> Statistics:
        return Statistics(*self._connection.execute(query, values).fetchone())

    def _grow(self, size: int, segments: int, cases: int) -> None:
        with self._lock:
            old = self._statistics
            self._statistics = Statistics(old.bytes + size, old.segments + segments, old.cases + cases)


def read_statistics(path: Path) -> Statistics:
    """Return the statistics of an index, which may be in use by a service.

    Raises
    ------
    sqlite3.Error
        If the index is missing or cannot be read.
    """
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        return Statistics(*connection.execute(AMOUNT).fetchone())


JOURNAL_TABLES = """
CREATE TABLE results (
    key TEXT PRIMARY KEY,
    operation TEXT NOT NULL,
    request BLOB NOT NULL,
    json BLOB NOT NULL,
    engine_version TEXT NOT NULL,
    schema_version TEXT NOT NULL,
    digest BLOB NOT NULL
) WITHOUT ROWID;
"""


class Journal:
    """Journal that holds the results of single queries until there are enough of them for a segment. It is thread-safe.

    A result in a segment of its own takes twelve times the disk space that it takes in a segment of many, and twenty
    times the work. Results in the journal survive if the process is killed. A power cut may lose the latest ones, which
    are then computed again, like those of segments.

    Parameters
    ----------
    path
        Path of the file, which is created if it is missing. A damaged file is set aside.

    Raises
    ------
    FolderLayoutError
        If the file has the layout of another version.
    sqlite3.Error, OSError
        If the disk fails; all methods raise them too.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._connection = _opened(path, JOURNAL_TABLES, path.parent.parent / "damaged")

    def add(self, record: Record) -> None:
        """Write a result in its own transaction."""
        row = (
            record.key,
            record.operation,
            record.request_json,
            record.json,
            record.engine_version,
            record.schema_version,
        )
        with self._lock:
            self._connection.execute(
                "INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?, ?, ?, ?)", (*row, digest(*row))
            )

    def remove(self, keys: Iterable[str]) -> None:
        """Remove results that are now in a segment."""
        with self._lock, self._connection as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.executemany("DELETE FROM results WHERE key = ?", [(key,) for key in keys])

    def take_over(self) -> tuple[list[Record], int]:
        """Return the results that an earlier process has left, and the number of damaged ones, which are removed."""
        with self._lock, self._connection as connection:
            connection.execute("BEGIN IMMEDIATE")
            rows = connection.execute("SELECT * FROM results").fetchall()
            records = [
                Record(key, operation, request, json=json, engine_version=engine, schema_version=schema)
                for key, operation, request, json, engine, schema, written in rows
                if written == digest(key, operation, request, json, engine, schema)
            ]
            whole = orjson.dumps([record.key for record in records]).decode()
            connection.execute("DELETE FROM results WHERE key NOT IN (SELECT value FROM json_each(?))", (whole,))
        return records, len(rows) - len(records)

    def close(self) -> None:
        """Close the file. The next process takes over the results in it."""
        with self._lock:
            self._connection.close()


def count_results(path: Path) -> int:
    """Return the number of results in a journal, which may be in use by a service; 0 if there is no journal.

    Raises
    ------
    sqlite3.Error
        If the journal cannot be read.
    """
    if not path.exists():
        return 0
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        found: int = connection.execute("SELECT count(*) FROM results").fetchone()[0]
    return found


def digest(*row: str | bytes) -> bytes:
    """Return the hash of a row. SQLite has no checksums by default, and would return damaged data without an error."""
    found = hashlib.sha256()
    for value in row:
        found.update(value.encode() if isinstance(value, str) else value)
        found.update(b"\0")
    return found.digest()


def discard_database(path: Path) -> None:
    """Remove a SQLite file that is not open, with its log and shared memory file."""
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)


def _opened(path: Path | None, tables: str, aside: Path | None = None) -> sqlite3.Connection:
    """Open a SQLite file with the given tables, and replace it if it is damaged.

    Parameters
    ----------
    aside
        Folder to which a damaged file is moved; None to delete a file that can be rebuilt.
    """
    try:
        return _connected(path, tables)
    except sqlite3.OperationalError:  # The disk or a lock failed, which does not mean that the file is damaged.
        raise
    except sqlite3.DatabaseError as error:
        if path is None:
            raise
        if aside is not None:
            set_aside(path, aside, str(error))
        discard_database(path)
        return _connected(path, tables)


def _connected(path: Path | None, tables: str) -> sqlite3.Connection:
    if path is not None:
        make_private(path)
    connection = sqlite3.connect(path or ":memory:", isolation_level=None, check_same_thread=False)
    connection.text_factory = decode
    try:
        layout = check_layout(connection, path.name if path else "")
        connection.execute("PRAGMA journal_mode = WAL")  # `ricochet cache stat` reads while the service writes.
        connection.execute("PRAGMA foreign_keys = ON")  # Results are deleted with their segment.
        # NORMAL does not synchronise at each commit, so a power cut may lose the last entries. They are added again
        # from the segments, or computed again.
        connection.execute("PRAGMA synchronous = NORMAL")
        if layout == 0:
            connection.executescript(f"BEGIN; {tables} PRAGMA user_version = {LAYOUT}; COMMIT;")
        elif connection.execute("PRAGMA quick_check(1)").fetchall() != [("ok",)]:
            raise sqlite3.DatabaseError("the file is damaged")
    except BaseException:
        connection.close()
        raise
    return connection


def _json(content: Any) -> str:
    return orjson.dumps(content).decode()
