"""API keys: their tokens, and the store of a data folder, `auth.sqlite`.

A token is `ricochet_5f0c21d9_pV3v1k...`: prefix, id, secret. The id is public: it stands in lists and in the audit log.
Of the token only a hash is stored. A fast hash is enough, and lets thousands of requests a second be checked: slow ones
protect passwords that people choose, not 256 random bits.
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
from typing import Any, BinaryIO, Literal, TypeAlias, get_args

import orjson

Scope: TypeAlias = Literal["read", "run", "admin"]
SCOPES: tuple[Scope, ...] = get_args(Scope)
"""`read`: results, one's own jobs, metrics; `run`: make and end work; `admin`: both, and the jobs of all owners."""
LOCAL = "local"
"""Owner of jobs made without a key."""

PREFIX = "ricochet_"
"""Prefix of a token: tools that search repositories and logs for secrets can find it."""
ID_BYTES, SECRET_BYTES = 4, 32
TOKEN = re.compile(PREFIX + r"([0-9a-f]{8})_[A-Za-z0-9_-]{43}")
UNKNOWN_DIGEST = "0" * 64
"""Compared with if there is no such key, so that this takes as long."""

FILE, LOCK = "auth.sqlite", "auth.lock"
OLD_FILE, OLD_QUOTAS, MIGRATED = "keys.json", "usage.json", ".migrated"
"""Files of older versions, and the suffix that they get once their content is in `auth.sqlite`."""
TRACES = (LOCK, f"{FILE}-journal", "keys.lock", f"{OLD_FILE}.new", f"{OLD_FILE}{MIGRATED}", OLD_QUOTAS)
"""Files that exist only if there have been keys."""
RELOAD_SECONDS = 0.2
"""Between two checks of the file: a revoked key is accepted for no longer than this."""
BUSY_SECONDS = 5.0
"""For the lock of another process, which holds it for milliseconds."""
HEADER_BYTES = 100
"""Header of a SQLite file; it holds a counter of the changes."""
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
    """The file of the keys exists and cannot be used; the text gives the reason.

    It is defined here, not in `service.errors`: the command line manages keys without importing the solver.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiKey:
    """An API key as it is stored.

    Parameters
    ----------
    digest
        SHA-256 of the token, hexadecimal.
    cases_per_hour
        Most cases within an hour; None if there is no limit.
    created, expires, revoked
        Seconds since 1970; None if it never was or will be. [s]
    """

    id: str
    owner: str
    scopes: frozenset[Scope]
    digest: str = field(repr=False)
    cases_per_hour: int | None = None
    created: float
    expires: float | None = None
    revoked: float | None = None

    @property
    def usable(self) -> bool:
        """Whether the key is accepted now."""
        return self.revoked is None and (self.expires is None or time.time() < self.expires)

    def may(self, scope: str) -> bool:
        """Return whether the key has this scope."""
        return scope in self.scopes or "admin" in self.scopes

    def fits(self, token: str) -> bool:
        """Return whether this is the token of the key."""
        return hmac.compare_digest(self.digest, digest_of(token))


def make_key(
    owner: str, scopes: frozenset[Scope], *, cases_per_hour: int | None = None, days: float | None = None
) -> tuple[ApiKey, str]:
    """Return a new key and its token, which is stored nowhere."""
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
    """Return the stored hash of a token."""
    return hashlib.sha256(token.encode()).hexdigest()


class ApiKeyStore:
    """The keys in force, as a running service sees them.

    Once there has been a file, one that is gone or damaged means that no key is valid, never that none is required.
    This holds over restarts as well, as long as anything else in the folder shows that there were keys.

    Parameters
    ----------
    folder
        Data folder of the service.
    on_error
        Called with the reason, once, when the keys cannot be read.
    audit_log
        File of the audit log, if it has one.

    Raises
    ------
    KeysUnreadableError
        If there is a file and it cannot be read.
    """

    def __init__(self, folder: Path, on_error: Callable[[str], None], audit_log: Path | None = None) -> None:
        self._folder = folder
        self._on_error = on_error
        migrate(folder)
        self._seen = _stamp(folder / FILE)
        self._checked = time.monotonic()
        self._failed = False
        self._keys: Mapping[str, ApiKey] = read_keys(folder)
        self.lost = "" if self._keys else trace_of_keys(folder, audit_log)
        """File that shows that there were keys, if there are none."""
        self.required = bool(self._keys or self.lost)
        """Whether there are keys, or were; revoked ones count."""

    @property
    def usable(self) -> bool:
        """Whether any key is valid."""
        return any(key.usable for key in self._keys.values())

    def reload(self) -> None:
        """Read the keys again if the file has changed."""
        now = time.monotonic()
        if now - self._checked < RELOAD_SECONDS:
            return
        self._checked = now
        stamp = _stamp(self._folder / FILE)
        if stamp == self._seen and not self._failed:
            return
        self._seen = stamp
        try:
            self._keys, self._failed = read_keys(self._folder), False
        except KeysUnreadableError as error:
            if not self._failed:
                self._on_error(f"all keys are refused: {error}")
            self._keys, self._failed, self.required = {}, True, True
        self.required = self.required or bool(self._keys)

    def find(self, token: str) -> ApiKey | None:
        """Return the key with this token, if it is valid now."""
        self.reload()
        match = TOKEN.fullmatch(token)
        key = self._keys.get(match[1]) if match else None
        if key is None:
            hmac.compare_digest(UNKNOWN_DIGEST, digest_of(token))
            return None
        return key if key.fits(token) and key.usable else None

    def holds(self, key: ApiKey) -> bool:
        """Return whether a key that was valid still is."""
        self.reload()
        found = self._keys.get(key.id)
        return found is not None and found.usable


def read_keys(folder: Path) -> dict[str, ApiKey]:
    """Return all keys by their id, also those that are no longer valid.

    Raises
    ------
    KeysUnreadableError
        If there is a file and it cannot be read.
    """
    migrate(folder)
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
        If it cannot be stored.
    """
    migrate(folder)
    _insert(folder, [_to_row(key)])


def revoke_key(folder: Path, key_id: str) -> ApiKey | None:
    """Make a key invalid from now on; return it, None if there is no such key.

    Raises
    ------
    KeysUnreadableError, OSError
        If it cannot be done.
    """
    if key_id not in read_keys(folder):
        return None
    with _readable(), connected(folder) as connection:
        connection.execute("UPDATE api_keys SET revoked = coalesce(revoked, ?) WHERE id = ?", (time.time(), key_id))
    return read_keys(folder).get(key_id)


def trace_of_keys(folder: Path, audit_log: Path | None = None) -> str:
    """Return the name of a file that shows that the folder has had keys; empty if none does."""
    for name in (FILE, *TRACES):
        if (folder / name).exists():
            return name
    if _has_jobs_of_keys(folder / "jobs.sqlite"):
        return "jobs.sqlite"
    if audit_log is not None and audit_log.resolve().is_relative_to(folder.resolve()) and _names_keys(audit_log):
        return audit_log.name
    return ""


def migrate(folder: Path) -> None:
    """Move keys and quotas of an older version, `keys.json` and `usage.json`, into `auth.sqlite`.

    Keys that are there already stay as they are, so that this can be done again after it was interrupted. The old files
    are kept under another name.

    Raises
    ------
    KeysUnreadableError, OSError
        If there is a file of keys and it cannot be read, or the keys cannot be stored.
    """
    old = folder / OLD_FILE
    if not old.exists():
        return
    try:
        content = orjson.loads(old.read_bytes())
        if content["layout"] != 1:
            raise ValueError(f"it has layout {content['layout']}, this version knows 1")
        keys = [_to_row(ApiKey(**{**row, "scopes": frozenset(row["scopes"])})) for row in content["keys"]]
    except FileNotFoundError:  # another process was faster
        return
    except OSError as error:
        raise KeysUnreadableError(f"{OLD_FILE} cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise KeysUnreadableError(f"{OLD_FILE} is damaged: {error}") from error
    quotas: list[tuple[str, int, int]] = []
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):  # one hour's counts may be lost
        counts = orjson.loads((folder / OLD_QUOTAS).read_bytes())
        quotas = [(key, int(began), int(cases)) for key, entries in counts.items() for began, cases in entries]
    _insert(folder, keys, quotas)
    for name in (OLD_FILE, OLD_QUOTAS):
        with contextlib.suppress(FileNotFoundError):
            (folder / name).replace(folder / f"{name}{MIGRATED}")


@contextlib.contextmanager
def connected(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open `auth.sqlite`, which must exist, for one transaction."""
    uri = f"{(folder / FILE).resolve().as_uri()}?mode=rw"
    with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=BUSY_SECONDS)) as connection:
        connection.row_factory = _to_dict
        with connection:
            yield connection


def open_private(path: Path, mode: Literal["ab", "wb"]) -> BinaryIO:
    """Open a file for writing that nobody else may read."""
    return open(path, mode, opener=lambda name, flags: os.open(name, flags, 0o600))


def _insert(folder: Path, keys: list[dict[str, Any]], quotas: list[tuple[str, int, int]] | None = None) -> None:
    """Store keys, by one process at a time; the file and its lock are made if they do not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    with open_private(folder / LOCK, "ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        is_new = not (folder / FILE).exists() or (folder / OLD_FILE).exists()
        open_private(folder / FILE, "ab").close()
        (folder / FILE).chmod(0o600)  # also one that an interrupted migration or a restore has left
        with _readable(), connected(folder) as connection:
            connection.execute("BEGIN IMMEDIATE")
            if is_new:  # an empty file is damaged otherwise
                for statement in filter(str.strip, TABLES.split(";")):
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {LAYOUT}")
            connection.executemany(INSERT, keys)
            connection.executemany("INSERT OR IGNORE INTO quotas VALUES (?, ?, ?)", quotas or [])


@contextlib.contextmanager
def _readable() -> Iterator[None]:
    """Raise what SQLite reports as `KeysUnreadableError`."""
    try:
        yield
    except (sqlite3.Error, AttributeError, TypeError) as error:
        raise KeysUnreadableError(f"{FILE} is damaged or cannot be used: {error}") from error


def _to_row(key: ApiKey) -> dict[str, Any]:
    return {name: getattr(key, name) for name in ApiKey.__slots__} | {"scopes": " ".join(sorted(key.scopes))}


def _to_dict(cursor: sqlite3.Cursor, row: tuple[Any, ...]) -> dict[str, Any]:
    return {column[0]: value for column, value in zip(cursor.description, row, strict=True)}


def _stamp(path: Path) -> tuple[int, int, int, bytes] | None:
    """Return what differs after every change of the file; None if there is none."""
    try:
        with path.open("rb") as file:
            found = os.fstat(file.fileno())
            return found.st_ino, found.st_mtime_ns, found.st_size, file.read(HEADER_BYTES)
    except OSError:
        return None


def _has_jobs_of_keys(path: Path) -> bool:
    """Return whether a job belongs to the owner of a key."""
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as jobs:
            return jobs.execute("SELECT 1 FROM jobs WHERE owner <> ? LIMIT 1", (LOCAL,)).fetchone() is not None
    except sqlite3.Error:  # not there, or not readable: nothing of it is listed either
        return False


def _names_keys(audit_log: Path) -> bool:
    """Return whether a line is about a key, or a missing one: the log may also be written without keys."""
    try:
        with audit_log.open("rb") as lines:
            return any(b'"key":' in line or b'"status":401' in line for line in lines)
    except OSError:
        return False
