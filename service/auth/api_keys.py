"""API keys: tokens, and their store `auth.sqlite` in the data folder.

A token such as `ricochet_5f0c21d9_pV3v1k...` consists of prefix, id and secret. The id is public and appears in lists
and in the audit log. Only a hash of the token is stored. A fast hash is sufficient and allows thousands of requests a
second: slow hashes are meant for passwords that people choose, not for 256 random bits.
"""

import contextlib
import fcntl
import hashlib
import hmac
import os
import re
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from service.clock import SYSTEM, Clock
from service.private_files import make_private, make_private_folder, open_private

Scope: TypeAlias = Literal["read", "run", "admin"]
SCOPES: tuple[Scope, ...] = get_args(Scope)
"""Scopes of keys. `read`: results, jobs of the owner, metrics; `run`: start and cancel work; `admin`: both, and the
jobs of all owners."""
LOCAL = "local"
"""Owner of jobs that were created without a key."""

PREFIX = "ricochet_"
"""Prefix of a token, by which programs that scan repositories and logs for secrets can find it."""
ID_BYTES, SECRET_BYTES = 4, 32
"""Numbers of random bytes in the id and in the secret. Four tell the keys of one service apart; 32 cannot be
guessed."""
TOKEN = re.compile(PREFIX + r"([0-9a-f]{8})_[A-Za-z0-9_-]{43}")
UNKNOWN_DIGEST = "0" * 64
"""Digest compared with the token of an unknown key, so that response times do not reveal which keys exist."""

FILE, LOCK = "auth.sqlite", "auth.lock"
RELOAD_SECONDS = 0.2
"""Interval between checks of the file [s]: a revoked key is accepted for no longer than this."""
BUSY_SECONDS = 5.0
"""Timeout for the database lock of another process, which holds it for milliseconds [s]."""
HEADER_BYTES = 100
"""Length of the header of a SQLite file, which contains a change counter [bytes]."""
LAYOUT = 1
TABLES = """
CREATE TABLE IF NOT EXISTS api_keys (
    id TEXT PRIMARY KEY,
    owner TEXT NOT NULL,
    scopes TEXT NOT NULL,
    digest TEXT NOT NULL,
    cases_per_hour INTEGER,
    created REAL NOT NULL,
    expires REAL,
    revoked REAL
);
CREATE TABLE IF NOT EXISTS quotas (
    key TEXT NOT NULL,
    began INTEGER NOT NULL,
    cases INTEGER NOT NULL,
    PRIMARY KEY (key, began)
) WITHOUT ROWID;
"""
INSERT = """
INSERT OR IGNORE INTO api_keys VALUES (:id, :owner, :scopes, :digest, :cases_per_hour, :created, :expires, :revoked)
"""


class KeysUnreadableError(Exception):
    """The file of the keys exists but cannot be used; the message gives the reason.

    It is not in `service.errors`, because `ricochet keys` must not wait for the imports of that module.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiKey:
    """An API key as it is stored.

    Parameters
    ----------
    digest
        SHA-256 of the token, hexadecimal.
    cases_per_hour
        Quota in cases per hour; None for no limit.
    created, expires, revoked
        Times in seconds since 1970; None if the key does not expire or is not revoked. [s]
    """

    id: str
    owner: str
    scopes: frozenset[Scope]
    digest: str = field(repr=False)
    cases_per_hour: int | None = None
    created: float
    expires: float | None = None
    revoked: float | None = None

    def usable_at(self, now: float) -> bool:
        """Return True if the key is valid at the time `now`. [s since 1970]"""
        return self.revoked is None and (self.expires is None or now < self.expires)

    def may(self, scope: str) -> bool:
        """Return True if the key has a scope; `admin` includes all."""
        return scope in self.scopes or "admin" in self.scopes

    def fits(self, token: str) -> bool:
        """Return True if this is the token of the key. The comparison takes the same time for every wrong token."""
        return hmac.compare_digest(self.digest, digest_of(token))


def make_key(
    owner: str, scopes: frozenset[Scope], *, cases_per_hour: int | None = None, days: float | None = None
) -> tuple[ApiKey, str]:
    """Return a new key and its token. Only the hash of the token is ever stored."""
    key_id, now = secrets.token_hex(ID_BYTES), time.time()
    token = f"{PREFIX}{key_id}_{secrets.token_urlsafe(SECRET_BYTES)}"
    key = ApiKey(
        id=key_id,
        owner=owner,
        scopes=scopes,
        digest=digest_of(token),
        cases_per_hour=cases_per_hour,
        created=now,
        expires=None if days is None else now + 86_400.0 * days,
    )
    return key, token


def digest_of(token: str) -> str:
    """Return the SHA-256 of a token, hexadecimal."""
    return hashlib.sha256(token.encode()).hexdigest()


class ApiKeyStore:
    """Keys of a running service, reloaded when the file changes.

    If the file is lost or damaged, every key is refused; the service never falls back to requiring no key. This holds
    across restarts as long as the lock file exists.

    Parameters
    ----------
    folder
        Data folder of the service.
    on_error
        Function called once with the reason when the keys become unreadable.
    clock
        Clock by which keys expire.

    Raises
    ------
    KeysUnreadableError
        If the file exists but cannot be read.
    """

    def __init__(self, folder: Path, on_error: Callable[[str], None], clock: Clock = SYSTEM) -> None:
        self._folder = folder
        self._clock = clock
        self._on_error = on_error
        self._seen = _stamp(folder / FILE)
        self._checked = clock.monotonic()
        self._failed = False
        self._keys: Mapping[str, ApiKey] = read_keys(folder)
        self.lost = not (folder / FILE).exists() and (folder / LOCK).exists()
        """True if the file of the keys is missing although the lock file shows that there were keys."""
        self.required = self.lost or (folder / FILE).exists()
        """True if keys are or were configured, revoked ones included."""

    @property
    def usable(self) -> bool:
        """True if any key is valid."""
        return any(key.usable_at(self._clock.now()) for key in self._keys.values())

    def reload(self) -> None:
        """Read the keys again if the file has changed, which is checked at most once per `RELOAD_SECONDS`."""
        now = self._clock.monotonic()
        # Every request calls this, up to thousands of times a second, which is too often to look at the file.
        if now - self._checked < RELOAD_SECONDS:
            return
        self._checked = now
        # The file is polled because another process, `ricochet keys`, changes it.
        stamp = _stamp(self._folder / FILE)
        if stamp == self._seen and not self._failed:
            return
        self._seen = stamp
        try:
            self._keys, self._failed = read_keys(self._folder), False
        except KeysUnreadableError as error:
            if not self._failed:
                self._on_error(f"all keys are refused: {error}")
            # An unreadable file must not open the service to everyone.
            self._keys, self._failed, self.required = {}, True, True
        # Keys stay required even if all of them are removed from the file.
        self.required = self.required or bool(self._keys)

    def find(self, token: str) -> ApiKey | None:
        """Return the valid key with this token, or None."""
        self.reload()
        match = TOKEN.fullmatch(token)
        key = self._keys.get(match[1]) if match else None
        if key is None:
            # The result is ignored. The comparison only makes the refusal take as long as with a known key.
            hmac.compare_digest(UNKNOWN_DIGEST, digest_of(token))
            return None
        return key if key.fits(token) and key.usable_at(self._clock.now()) else None

    def holds(self, key: ApiKey) -> bool:
        """Return True if a key is still valid. Event streams call this, since they may last longer than their key."""
        self.reload()
        found = self._keys.get(key.id)
        return found is not None and found.usable_at(self._clock.now())


def read_keys(folder: Path) -> dict[str, ApiKey]:
    """Return all keys by id, including expired and revoked ones.

    Raises
    ------
    KeysUnreadableError
        If the file exists but cannot be read.
    """
    if not (folder / FILE).exists():
        return {}
    with _readable(), connected(folder) as connection:
        rows = connection.execute("SELECT * FROM api_keys ORDER BY created").fetchall()
        return {row["id"]: ApiKey(**{**row, "scopes": frozenset(row["scopes"].split())}) for row in rows}


def add_key(folder: Path, key: ApiKey) -> None:
    """Store a key.

    Raises
    ------
    KeysUnreadableError, OSError
        If the key cannot be stored.
    """
    _insert(folder, key)


def revoke_key(folder: Path, key_id: str) -> ApiKey | None:
    """Revoke a key, and return it, or None if there is no such key.

    Raises
    ------
    KeysUnreadableError, OSError
        If the file cannot be read or written.
    """
    if key_id not in read_keys(folder):
        return None
    with _readable(), connected(folder) as connection:
        # The first revocation counts: a repeated revocation must not change its date.
        connection.execute("UPDATE api_keys SET revoked = coalesce(revoked, ?) WHERE id = ?", (time.time(), key_id))
    return read_keys(folder).get(key_id)


@contextlib.contextmanager
def connected(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open the existing `auth.sqlite` for one transaction.

    `mode=rw` keeps SQLite from creating the file: an empty one would look like a store without keys.
    """
    uri = f"{(folder / FILE).resolve().as_uri()}?mode=rw"
    with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=BUSY_SECONDS)) as connection:
        connection.row_factory = _to_dict
        with connection:
            check_layout(connection)
            yield connection


def check_layout(connection: sqlite3.Connection) -> None:
    """Refuse a file that was written by another version.

    Raises
    ------
    sqlite3.DatabaseError
        If the layout number is neither that of this version nor 0, which a new file has.
    """
    layout = connection.execute("PRAGMA user_version").fetchone()["user_version"]
    if layout not in {0, LAYOUT}:
        raise sqlite3.DatabaseError(f"it has layout {layout}, this version knows {LAYOUT}")


def _insert(folder: Path, key: ApiKey) -> None:
    """Store a key, and create the file and its lock if they do not exist.

    The lock serialises processes while the file is created, before SQLite can lock it.
    """
    make_private_folder(folder)
    with open_private(folder / LOCK, "ab") as lock:
        # The lock file is never removed: it also shows that keys were once configured.
        fcntl.flock(lock, fcntl.LOCK_EX)
        is_new = not (folder / FILE).exists()
        # The file gets its permissions before SQLite writes hashes into it.
        make_private(folder / FILE)
        with _readable(), connected(folder) as connection:
            # The write lock is taken at once, because upgrading a read lock can fail while another process writes.
            connection.execute("BEGIN IMMEDIATE")
            if is_new:  # An existing file without tables is damaged, and must not be turned into a store without keys.
                for statement in filter(str.strip, TABLES.split(";")):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {LAYOUT}")
            connection.execute(INSERT, _to_row(key))


@contextlib.contextmanager
def _readable() -> Iterator[None]:
    """Convert errors of SQLite, and of rows with unexpected values, to `KeysUnreadableError`."""
    try:
        yield
    except (sqlite3.Error, AttributeError, TypeError) as error:
        raise KeysUnreadableError(f"{FILE} is damaged or cannot be used: {error}") from error


def _to_row(key: ApiKey) -> dict[str, Any]:
    return {name: getattr(key, name) for name in ApiKey.__slots__} | {"scopes": " ".join(sorted(key.scopes))}


def _to_dict(cursor: sqlite3.Cursor, row: tuple[Any, ...]) -> dict[str, Any]:
    return {column[0]: value for column, value in zip(cursor.description, row, strict=True)}


def _stamp(path: Path) -> tuple[int, int, int, bytes] | None:
    """Return a value that changes with every change of the file; None if there is no file.

    The header is included because two changes in quick succession may leave modification time and size the same.
    """
    try:
        with path.open("rb") as file:
            found = os.fstat(file.fileno())
            return found.st_ino, found.st_mtime_ns, found.st_size, file.read(HEADER_BYTES)
    except OSError:
        return None
