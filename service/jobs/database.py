"""SQLite file of the jobs: opened on first use, with one writer at a time and `StorageError` for every disk failure.

The write-ahead log is synchronised at each commit, so that after any crash a transaction is either complete or absent.
The log is moved into the file regularly, always as a whole. A damaged bit in the log then costs only transactions since
the last move, and those before the damage can still be applied to the file.
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
"""Timeout for a lock that another process, such as a backup, holds on the file; chosen by judgement [s]."""
CHECKPOINT_SECONDS = 0.1
"""Longest wait of a checkpoint for a reader [s], during which writers have to wait. A checkpoint that fails is repeated
later."""

# Requests for sweeps have a table of their own, because they can be large, and SQLite writes the whole row of `jobs`
# whenever the progress of a job changes.
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
    """A connection for writing and one for reading, each used by one thread at a time.

    Parameters
    ----------
    path
        Path of the file, which is created if it is missing. A damaged file is set aside.
    check
        Function called before each transaction that writes; raises StorageError if the folder must not be written to.
    """

    def __init__(self, path: Path, check: Callable[[], None] = lambda: None) -> None:
        self._path = path
        self._check = check
        self.was_missing = False
        """True if the file was missing, empty or damaged when it was first opened."""
        self._opened: os.stat_result | None = None
        self._checked = False
        self._written = True
        """True if the log may contain transactions. At the start it may contain transactions of an earlier process."""
        self._opening = threading.Lock()
        self._locks = {"write": threading.Lock(), "read": threading.Lock()}
        self._connections: dict[str, sqlite3.Connection] = {}

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Run the block as one transaction, which is on the disk when the block has ended.

        Raises
        ------
        StorageError
            If the transaction fails; it then changes nothing.
        """
        with self._connected("write") as connection:
            connection.execute("BEGIN IMMEDIATE")  # Takes the write lock now: no later statement can fail to get it.
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
        """Run the block on one snapshot of the file.

        Raises
        ------
        StorageError
            If the file cannot be read.
        """
        with self._connected("read") as connection:
            connection.execute("BEGIN")
            try:
                yield connection
            finally:
                connection.execute("COMMIT")

    def checkpoint(self) -> None:
        """Move the content of the log into the file, and empty the log.

        Raises
        ------
        StorageError
            If the disk fails; nothing is lost.
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
        """Close the file. It is opened again on the next use."""
        if self._connections:  # A file that could not be opened is not tried again.
            with suppress(StorageError):
                self.checkpoint()
        for kind, lock in self._locks.items():
            with lock:
                connection = self._connections.pop(kind, None)
                if connection is not None:
                    connection.close()
        self._opened = None

    def check(self) -> None:
        """Check that the open file is still the one at its path.

        Jobs written to a file that has been removed would be lost when this process ends.

        Raises
        ------
        StorageError
            If the file has been removed or replaced.
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
                raise storage_error(f"jobs cannot be {'stored' if kind == 'write' else 'read'}", error) from error

    def _open(self) -> sqlite3.Connection:
        make_private_folder(self._path.parent)
        make_private(self._path)
        try:
            return self._connect()
        except sqlite3.OperationalError:  # The disk or a lock failed, which does not mean that the file is damaged.
            raise
        except sqlite3.DatabaseError as error:
            set_aside(self._path, self._path.parent / "damaged", str(error))
            return self._connect()

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(
            self._path, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False, cached_statements=64
        )
        connection.text_factory = decode
        try:
            layout = check_layout(connection, self._path.name)
            connection.execute("PRAGMA journal_mode = WAL")  # Readers do not wait for the writer.
            connection.execute("PRAGMA synchronous = FULL")  # An accepted job must survive a power cut.
            connection.execute("PRAGMA foreign_keys = ON")  # Cases are deleted with their job.
            # `checkpoint` moves the whole log at intervals; an automatic checkpoint might move only a part of it.
            connection.execute("PRAGMA wal_autocheckpoint = 0")
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
