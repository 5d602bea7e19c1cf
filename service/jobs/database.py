"""The SQLite file of the jobs: opened when it is needed, one writer at a time, every failure the same error.

Write-ahead log with a sync at each commit: a transaction is there whole after any crash, or not at all.
"""

import logging
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from service.errors import StorageError

LAYOUT = 1
"""Raised when the tables change."""
BUSY_SECONDS = 10.0
"""For another process to let go of the file, such as someone who looks into it."""
LOG_BYTES = 16 * 1024 * 1024
"""What is left of the write-ahead log after a large batch."""

TABLES = """
CREATE TABLE jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    owner TEXT NOT NULL,
    operation TEXT NOT NULL,
    versions TEXT NOT NULL,
    status TEXT NOT NULL,
    total INTEGER NOT NULL DEFAULT 0,
    done INTEGER NOT NULL DEFAULT 0,
    cached INTEGER NOT NULL DEFAULT 0,
    failed INTEGER NOT NULL DEFAULT 0,
    created REAL NOT NULL,
    started REAL,
    finished REAL,
    expires REAL,
    problem TEXT,
    revision INTEGER NOT NULL DEFAULT 0
);
CREATE INDEX jobs_by_owner ON jobs (owner, number);
CREATE TABLE slices (
    job INTEGER NOT NULL REFERENCES jobs ON DELETE CASCADE,
    slice INTEGER NOT NULL,
    keys BLOB NOT NULL,
    requests BLOB NOT NULL,
    custom_ids BLOB,
    PRIMARY KEY (job, slice)
);
CREATE TABLE states (
    job INTEGER NOT NULL REFERENCES jobs ON DELETE CASCADE,
    slice INTEGER NOT NULL,
    states BLOB NOT NULL,
    PRIMARY KEY (job, slice)
) WITHOUT ROWID;
CREATE TABLE problems (
    job INTEGER NOT NULL REFERENCES jobs ON DELETE CASCADE,
    number INTEGER NOT NULL,
    problem TEXT NOT NULL,
    PRIMARY KEY (job, number)
) WITHOUT ROWID;
CREATE TABLE idempotency (
    owner TEXT NOT NULL,
    token TEXT NOT NULL,
    digest TEXT NOT NULL,
    job INTEGER NOT NULL REFERENCES jobs ON DELETE CASCADE,
    PRIMARY KEY (owner, token)
) WITHOUT ROWID;
CREATE INDEX idempotency_by_job ON idempotency (job);
"""
ADDED = (
    """
CREATE TABLE IF NOT EXISTS sweeps (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    fields TEXT NOT NULL,
    sweep BLOB NOT NULL
)
""",
    """
CREATE TABLE IF NOT EXISTS studies (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    progress TEXT NOT NULL,
    partial TEXT
)
""",
    """
CREATE TABLE IF NOT EXISTS charges (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    key TEXT NOT NULL,
    cases INTEGER NOT NULL,
    began INTEGER NOT NULL
)
""",
    """
CREATE TABLE IF NOT EXISTS traces (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    traceparent TEXT NOT NULL
)
""",
    """
CREATE TABLE IF NOT EXISTS titles (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    title TEXT NOT NULL
)
""",
    """
CREATE TABLE IF NOT EXISTS sizes (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    bytes INTEGER NOT NULL
)
""",
)
"""Tables that files of this layout lack if an earlier version made them, and that such a version does not mind."""

log = logging.getLogger(__name__)


class Database:
    """One connection to write, one to read, each for one thread at a time.

    Parameters
    ----------
    path
        Path of the file; made if it is not there. One that is no database, or a damaged one, is set aside.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._checked = False
        self._opening = threading.Lock()
        self._locks = {"write": threading.Lock(), "read": threading.Lock()}
        self._connections: dict[str, sqlite3.Connection] = {}

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Make all that is done here one transaction, on disk when it ends.

        Raises
        ------
        StorageError
            If it cannot be; nothing has changed then.
        """
        with self._connected("write") as connection:
            connection.execute("BEGIN IMMEDIATE")
            try:
                yield connection
                connection.execute("COMMIT")
            except BaseException:
                if connection.in_transaction:
                    with suppress(sqlite3.Error):
                        connection.execute("ROLLBACK")
                raise

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Look at one state of the file.

        Raises
        ------
        StorageError
            If it cannot be read.
        """
        with self._connected("read") as connection:
            connection.execute("BEGIN")
            try:
                yield connection
            finally:
                connection.execute("COMMIT")

    def close(self) -> None:
        """Give up the file; it is opened again when it is needed."""
        for kind, lock in self._locks.items():
            with lock:
                connection = self._connections.pop(kind, None)
                if connection is not None:
                    connection.close()

    @contextmanager
    def _connected(self, kind: str) -> Iterator[sqlite3.Connection]:
        with self._locks[kind]:
            try:
                if kind not in self._connections:
                    with self._opening:
                        self._connections[kind] = self._open()
                yield self._connections[kind]
            except (sqlite3.Error, OSError) as error:
                raise StorageError(f"jobs cannot be stored: {reason(error)}") from error

    def _open(self) -> sqlite3.Connection:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        try:
            return self._connect()
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError as error:  # it is no database, or no longer one
            self._set_aside(error)
            return self._connect()

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(
            self._path, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False, cached_statements=64
        )
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute(f"PRAGMA journal_size_limit = {LOG_BYTES}")
            layout = connection.execute("PRAGMA user_version").fetchone()[0]
            if layout == 0:
                connection.executescript(f"BEGIN IMMEDIATE; {TABLES} PRAGMA user_version = {LAYOUT}; COMMIT;")
            elif layout != LAYOUT:
                raise sqlite3.OperationalError(f"jobs.sqlite has layout {layout}, this version knows {LAYOUT}")
            elif not self._checked and (said := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise sqlite3.DatabaseError(said)
            for table in ADDED:
                connection.execute(table)
            self._checked = True
        except BaseException:
            connection.close()
            raise
        return connection

    def _set_aside(self, error: sqlite3.DatabaseError) -> None:
        aside = self._path.parent / "damaged" / f"{self._path.stem}-{time.time_ns()}{self._path.suffix}"
        log.warning("%s set aside as %s: %s", self._path, aside, error)
        aside.parent.mkdir(exist_ok=True)
        self._path.replace(aside)
        with suppress(FileNotFoundError):
            Path(f"{self._path}-wal").replace(f"{aside}-wal")  # it may hold what is worth saving
        Path(f"{self._path}-shm").unlink(missing_ok=True)


def reason(error: sqlite3.Error | OSError) -> str:
    """Return what went wrong, without the path."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
