"""Which result is in which segment, and the journal of results that are in none yet; both in SQLite.

The segments hold all that the index has: it can be made anew.
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
"""Keys looked up in one query: a few milliseconds, during which storing waits."""
FLUSH_SECONDS = 60.0
"""Longest delay before the time of last use is written [s]; losing it in a crash hardly matters."""

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

# The driver gives the interpreter lock up and takes it again at every row it reads or writes, and has to wait each
# time while others are busy. So keys go in as one blob, and what is found comes back as one JSON text.
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
    """What the segments amount to."""

    bytes: int
    segments: int
    cases: int


class Index:
    """The index; safe from several threads, one of which is served at a time.

    Parameters
    ----------
    path
        Path of its file, made if it is not there, and made anew if it is damaged; None to keep it in memory.

    Raises
    ------
    FolderLayoutError
        If the file has the layout of another version.
    sqlite3.Error, OSError
        If the disk does not let it be; also by all methods.
    """

    def __init__(self, path: Path | None) -> None:
        self._lock = threading.Lock()
        self._used: dict[str, float] = {}
        self._flushed = time.monotonic()
        self._connection = _opened(path, INDEX_TABLES)
        self._statistics = self._amount(AMOUNT)

    @property
    def statistics(self) -> Statistics:
        """What all segments amount to."""
        return self._statistics

    def find(self, keys: Sequence[str]) -> dict[str, Location]:
        """Return the locations of results; keys without a result are left out."""
        found = {}
        for start in range(0, len(keys), KEYS_AT_ONCE):
            some = keys[start : start + KEYS_AT_ONCE]
            with self._lock:
                text = self._connection.execute(FIND, (bytes.fromhex("".join(some)), len(some))).fetchone()[0]
            found.update({some[number]: Location(name, row) for number, name, row in orjson.loads(text)})
        return found

    def add(self, segment: str, keys: Sequence[str], size: int, used: float) -> None:
        """Enter a segment with its results, row by row, or what has become of it."""
        with self._changing() as connection:
            before = self._amount(AMOUNT_OF, _json([segment]))
            [(number,)] = connection.execute(ADD_SEGMENT, (segment, size, len(keys), used)).fetchall()
            connection.execute(ADD_RESULTS, (bytes.fromhex("".join(keys)), len(keys), number))
        self._grow(size - before.bytes, 1 - before.segments, len(keys) - before.cases)

    def drop(self, segments: Iterable[str]) -> None:
        """Forget these segments and the results in them."""
        names = _json(list(segments))
        with self._changing() as connection:
            gone = self._amount(AMOUNT_OF, names)
            connection.execute(DROP, (names,))
        self._grow(-gone.bytes, -gone.segments, -gone.cases)

    def use(self, segments: Iterable[str]) -> None:
        """Note that these are used now; written now and then only."""
        now = time.time()
        with self._lock:
            self._used.update(dict.fromkeys(segments, now))
        if time.monotonic() > self._flushed + FLUSH_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write when segments were used last."""
        if not self._used:
            return
        with self._changing() as connection:
            connection.execute(USE, (_json(self._used),))
            self._used = {}
            self._flushed = time.monotonic()

    def oldest(self, count: int, *, but: str) -> list[tuple[str, int]]:
        """Names and sizes of the segments used longest ago, but for one."""
        with self._lock:
            return self._connection.execute(OLDEST, (but, count)).fetchall()

    def names(self) -> set[str]:
        """Names of all segments."""
        with self._lock:
            return {name for (name,) in self._connection.execute("SELECT name FROM segments")}

    def close(self) -> None:
        """Write what is left and let go of the file."""
        try:
            self.flush()
        finally:
            with self._lock:
                self._connection.close()

    @contextmanager
    def _changing(self) -> Iterator[sqlite3.Connection]:
        with self._lock, self._connection as connection:  # which ends the transaction one way or the other
            connection.execute("BEGIN IMMEDIATE")
            yield connection

    def _amount(self, query: str, *values: str) -> Statistics:
        return Statistics(*self._connection.execute(query, values).fetchone())

    def _grow(self, size: int, segments: int, cases: int) -> None:
        with self._lock:
            old = self._statistics
            self._statistics = Statistics(old.bytes + size, old.segments + segments, old.cases + cases)


def read_statistics(path: Path) -> Statistics:
    """What an index says, also while a service has it open.

    Raises
    ------
    sqlite3.Error
        If there is no index, or none that can be read.
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
    """Results of single queries until there are enough of them for a segment; safe from several threads, one at a time.

    A file of one result takes twelve times the room that it has in a file of many, and twenty times the work. What is
    written here survives a process that is killed. A power cut may take the latest, which are then computed again, as
    those of segments are.

    Parameters
    ----------
    path
        Path of its file; made if it is not there. One that is damaged is set aside.

    Raises
    ------
    FolderLayoutError
        If the file has the layout of another version.
    sqlite3.Error, OSError
        If the disk does not let it be; also by all methods.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._connection = _opened(path, JOURNAL_TABLES, path.parent.parent / "damaged")

    def add(self, record: Record) -> None:
        """Write a result, whole or not at all."""
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
        """Remove results that are in a segment."""
        with self._lock, self._connection as connection:  # which ends the transaction one way or the other
            connection.execute("BEGIN IMMEDIATE")
            connection.executemany("DELETE FROM results WHERE key = ?", [(key,) for key in keys])

    def take_over(self) -> tuple[list[Record], int]:
        """Return the results that an earlier process has left; remove damaged ones, and return their number too."""
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
        """Let go of the file."""
        with self._lock:
            self._connection.close()


def count_results(path: Path) -> int:
    """Return how many results a journal has, also while a service has it open; 0 if there is none.

    Raises
    ------
    sqlite3.Error
        If it cannot be read.
    """
    if not path.exists():
        return 0
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        found: int = connection.execute("SELECT count(*) FROM results").fetchone()[0]
    return found


def digest(*row: str | bytes) -> bytes:
    """Hash of a row, without which a damaged result would be answered."""
    found = hashlib.sha256()
    for value in row:
        found.update(value.encode() if isinstance(value, str) else value)
        found.update(b"\0")
    return found.digest()


def discard_database(path: Path) -> None:
    """Remove the file of an index or a journal that nobody has open."""
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)


def _opened(path: Path | None, tables: str, aside: Path | None = None) -> sqlite3.Connection:
    """Open a file with these tables, made anew if it is damaged.

    A damaged file that holds what nothing else has is kept in the folder `aside`.
    """
    try:
        return _connected(path, tables)
    except sqlite3.OperationalError:
        raise
    except sqlite3.DatabaseError as error:  # it is no database, or no longer one
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
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA synchronous = NORMAL")  # a power cut may cost the last segments their entries
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
