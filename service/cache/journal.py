"""Results of single queries, in SQLite, until there are enough of them for a segment.

A file of one result takes twelve times the room that it has in a file of many, and twenty times the work. What is
written here survives a process that is killed. A power cut may take the latest, which are then computed again, as those
of segments are.
"""

import hashlib
import sqlite3
import threading
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import orjson

from service.cache.index import discard_index
from service.cache.record import Record

LAYOUT = 1
"""Raised when the table changes: a journal of another layout is made anew."""
TABLE = """
CREATE TABLE results (
    key TEXT PRIMARY KEY,
    operation TEXT NOT NULL,
    request BLOB NOT NULL,
    json BLOB NOT NULL,
    engine_version TEXT NOT NULL,
    schema_version TEXT NOT NULL,
    digest BLOB NOT NULL
) WITHOUT ROWID
"""


class Journal:
    """The journal; safe from several threads, one of which is served at a time.

    Parameters
    ----------
    path
        Of its file; made if it is not there, and made anew if it is damaged or of another layout.

    Raises
    ------
    sqlite3.Error, OSError
        If the disk does not let it be; also by all methods.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        try:
            self._connection = _opened(path)
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError:  # it is no database, or no longer one
            discard_index(path)
            self._connection = _opened(path)

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


def _opened(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    connection.text_factory = lambda text: text.decode(errors="replace")  # a damaged one differs from its digest then
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        [(layout,)] = connection.execute("PRAGMA user_version").fetchall()
        if layout == 0 and not connection.execute("SELECT 1 FROM sqlite_master").fetchall():
            connection.executescript(f"BEGIN; {TABLE}; PRAGMA user_version = {LAYOUT}; COMMIT;")
        elif layout != LAYOUT or connection.execute("PRAGMA quick_check(1)").fetchall() != [("ok",)]:
            raise sqlite3.DatabaseError("damaged, or of another layout")
    except BaseException:
        connection.close()
        raise
    return connection
