"""The SQLite file of the jobs: opened when it is needed, one writer at a time, every failure the same error.

Write-ahead log with a sync at each commit: a transaction is there whole after any crash, or not at all. The log
is emptied regularly, and only whole: a damaged bit costs what was written since, and what is before it fits the file.
"""

import os
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from service.cache.damaged import set_aside
from service.cache.sqlite import LAYOUT, check_layout, decode
from service.errors import FolderReplacedError, StorageError, storage_error
from service.private_files import make_private, make_private_folder

BUSY_SECONDS = 10.0
"""Timeout for a lock that another process holds on the file, such as a reader [s]."""
CHECKPOINT_SECONDS = 0.1
"""Longest wait of a checkpoint for a reader; one that another process prevents is done the next time."""

# Requests of sweeps are apart from `jobs`: they can be large, and every progress of a job writes its whole row anew.
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
    revision INTEGER NOT NULL DEFAULT 0,
    progress TEXT,
    partial TEXT,
    charge TEXT,
    traceparent TEXT,
    title TEXT,
    bytes INTEGER
);
CREATE INDEX jobs_by_owner ON jobs (owner, number);
CREATE TABLE sweeps (
    job INTEGER PRIMARY KEY REFERENCES jobs ON DELETE CASCADE,
    sweep BLOB NOT NULL
);
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


class Database:
    """One connection to write, one to read, each for one thread at a time.

    Parameters
    ----------
    path
        Path of the file; made if it is not there. A damaged one, or one that is not a database, is set aside.
    check
        Called before anything is written; raises StorageError if nothing may be.
    """

    def __init__(self, path: Path, check: Callable[[], None] = lambda: None) -> None:
        self._path = path
        self._check = check
        self.was_missing = False
        """Whether the file was missing or empty when it was first needed."""
        self._opened: os.stat_result | None = None
        self._checked = False
        self._written = True
        """Whether the log may hold anything: at first what an earlier process has left."""
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
            self._written = True
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

    def checkpoint(self) -> None:
        """Move what stands in the log into the file, and empty the log.

        Raises
        ------
        StorageError
            If it cannot be done; nothing is lost then.
        """
        if self._written:
            with self._connected("write") as connection:
                connection.execute(f"PRAGMA busy_timeout = {round(1000 * CHECKPOINT_SECONDS)}")
                try:
                    [(busy, _, _)] = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
                finally:
                    connection.execute(f"PRAGMA busy_timeout = {round(1000 * BUSY_SECONDS)}")
                self._written = bool(busy)

    def close(self) -> None:
        """Give up the file; it is opened again when it is needed."""
        with suppress(StorageError):
            self.checkpoint()
        for kind, lock in self._locks.items():
            with lock:
                connection = self._connections.pop(kind, None)
                if connection is not None:
                    connection.close()
        self._opened = None

    def check(self) -> None:
        """See that what is written goes to the file of this path, and not to one that was there before.

        Raises
        ------
        StorageError
            If it does not.
        """
        self._check()
        try:
            same = self._opened is None or os.path.samestat(self._opened, self._path.stat())
        except FileNotFoundError:
            same = False
        if not same:
            raise FolderReplacedError(f"{self._path.name} has been removed or replaced; start the service again")

    @contextmanager
    def _connected(self, kind: str) -> Iterator[sqlite3.Connection]:
        with self._locks[kind]:
            try:
                if kind == "write" or kind not in self._connections:
                    self.check()
                if kind not in self._connections:
                    with self._opening:
                        self._connections[kind] = self._open()
                        self._opened = self._path.stat()
                yield self._connections[kind]
            except (sqlite3.Error, OSError) as error:
                raise storage_error("jobs cannot be stored", error) from error

    def _open(self) -> sqlite3.Connection:
        make_private_folder(self._path.parent)
        make_private(self._path)
        try:
            return self._connect()
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError as error:  # The file is damaged, or not a database.
            set_aside(self._path, self._path.parent / "damaged", str(error))
            return self._connect()

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(
            self._path, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False, cached_statements=64
        )
        connection.text_factory = decode
        try:
            layout = check_layout(connection, self._path.name)
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute("PRAGMA wal_autocheckpoint = 0")  # An automatic one would copy only a part of the log.
            if layout == 0:
                self.was_missing = not self._checked
                connection.executescript(f"BEGIN IMMEDIATE; {TABLES} PRAGMA user_version = {LAYOUT}; COMMIT;")
            elif not self._checked and (said := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise sqlite3.DatabaseError(said)
            self._checked = True
        except BaseException:
            connection.close()
            raise
        return connection
