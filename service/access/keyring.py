"""The keys of a data folder: `keys.json`, replaced whole, readable by its owner alone, read again when it changes."""

import contextlib
import fcntl
import hmac
import os
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Literal

import orjson

from service.access.key import NOBODY, Key, digest_of, id_in

FILE, LOCK = "keys.json", "keys.lock"
TRACES = (LOCK, f"{FILE}.new", "usage.json")
"""Files that are there only if there have been keys."""
LOOK_SECONDS = 0.2
"""Between two looks at the file: a key that is revoked is good for no longer than this."""
LAYOUT = 1


LOCAL = "local"
"""Owner of jobs made without a key."""


class KeysUnreadableError(Exception):
    """There is a file of keys, and it cannot be used; the text says why."""


class KeyRing:
    """The keys in force, as a running service looks at them.

    Once there has been a file, one that is gone or damaged means that no key is good: it never means that none is
    needed. This holds over restarts as well, as long as anything else in the folder shows that there were keys.

    Parameters
    ----------
    folder
        Data folder of the service.
    complain
        Told why the keys cannot be read, once.
    audit_log
        File of the audit log, if it has one.

    Raises
    ------
    KeysUnreadableError
        If there is a file and it cannot be read.
    """

    def __init__(self, folder: Path, complain: Callable[[str], None], audit_log: Path | None = None) -> None:
        self._path = folder / FILE
        self._complain = complain
        self._seen = _stamp(self._path)
        self._looked = time.monotonic()
        self._keys: Mapping[str, Key] = read_keys(folder)
        self.lost = "" if self._keys else trace_of_keys(folder, audit_log)
        """What shows that there were keys, if there are none."""
        self.needed = bool(self._keys or self.lost)
        """Whether there are keys, or were; those that are revoked count."""

    @property
    def usable(self) -> bool:
        """Whether any key is good."""
        return any(key.usable for key in self._keys.values())

    def look(self) -> None:
        """Read the file again if it has changed."""
        now = time.monotonic()
        if now - self._looked < LOOK_SECONDS:
            return
        self._looked = now
        stamp = _stamp(self._path)
        if stamp == self._seen:
            return
        self._seen = stamp
        try:
            self._keys = read_keys(self._path.parent)
        except KeysUnreadableError as error:
            self._keys, self.needed = {}, True
            self._complain(f"nobody is let in: {error}")
        self.needed = self.needed or bool(self._keys)

    def find(self, token: str) -> Key | None:
        """Return the key with this token, if it is good now."""
        self.look()
        name = id_in(token)
        key = self._keys.get(name) if name is not None else None
        if key is None:
            hmac.compare_digest(NOBODY, digest_of(token))
            return None
        return key if key.fits(token) and key.usable else None

    def holds(self, key: Key) -> bool:
        """Tell whether a key that was good still is."""
        self.look()
        found = self._keys.get(key.id)
        return found is not None and found.usable


def read_keys(folder: Path) -> dict[str, Key]:
    """Return all keys by their id, those that are no longer good too.

    Raises
    ------
    KeysUnreadableError
        If there is a file and it cannot be read.
    """
    try:
        content = orjson.loads((folder / FILE).read_bytes())
        return {key.id: key for key in map(_to_key, _rows(content))}
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except OSError as error:
        raise KeysUnreadableError(f"{FILE} cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise KeysUnreadableError(f"{FILE} is damaged: {error}") from error


def trace_of_keys(folder: Path, audit_log: Path | None = None) -> str:
    """Return the name of a file that shows that the folder has had keys; empty if none does."""
    for name in TRACES:
        if (folder / name).exists():
            return name
    if _has_jobs_of_keys(folder / "jobs.sqlite"):
        return "jobs.sqlite"
    if audit_log is not None and audit_log.resolve().is_relative_to(folder.resolve()) and _names_keys(audit_log):
        return audit_log.name
    return ""


def _has_jobs_of_keys(path: Path) -> bool:
    """Tell whether a job belongs to the owner of a key."""
    try:
        with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as jobs:
            return jobs.execute("SELECT 1 FROM jobs WHERE owner <> ? LIMIT 1", (LOCAL,)).fetchone() is not None
    except sqlite3.Error:  # not there, or not readable: nothing of it is listed either
        return False


def _names_keys(audit_log: Path) -> bool:
    """Tell whether a line is about a key, or the want of one: the log may also be written without keys."""
    try:
        with audit_log.open("rb") as lines:
            return any(b'"key":' in line or b'"status":401' in line for line in lines)
    except OSError:
        return False


def add_key(folder: Path, key: Key) -> None:
    """Put a key to the others.

    Raises
    ------
    KeysUnreadableError, OSError
        If it cannot be.
    """
    with _changing(folder) as keys:
        keys[key.id] = key


def revoke_key(folder: Path, name: str) -> Key | None:
    """Make a key good for nothing from now on; return it, None if there is no such key.

    Raises
    ------
    KeysUnreadableError, OSError
        If it cannot be.
    """
    if name not in read_keys(folder):
        return None
    with _changing(folder) as keys:
        if name in keys and keys[name].revoked is None:
            keys[name] = replace(keys[name], revoked=time.time())
        return keys.get(name)


@contextlib.contextmanager
def _changing(folder: Path) -> Iterator[dict[str, Key]]:
    """Let the keys be changed by one at a time, and replace the file."""
    folder.mkdir(parents=True, exist_ok=True)
    with open_private(folder / LOCK, "ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        keys = read_keys(folder)
        yield keys
        rows = [_to_row(key) for key in keys.values()]
        staged = folder / f"{FILE}.new"
        staged.unlink(missing_ok=True)  # one that is left of a crash may be open to others
        with open_private(staged, "wb") as file:
            file.write(orjson.dumps({"layout": LAYOUT, "keys": rows}, option=orjson.OPT_INDENT_2))
            file.flush()
            os.fsync(file.fileno())
        staged.replace(folder / FILE)


def open_private(path: Path, mode: Literal["ab", "wb"]) -> BinaryIO:
    """Open a file to be written that nobody else may read."""
    return open(path, mode, opener=lambda name, flags: os.open(name, flags, 0o600))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """What changes whenever the file is replaced; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def _rows(content: Any) -> list[dict[str, Any]]:
    if content["layout"] != LAYOUT:
        raise ValueError(f"it has layout {content['layout']}, this version knows {LAYOUT}")
    rows: list[dict[str, Any]] = content["keys"]
    return rows


def _to_key(row: dict[str, Any]) -> Key:
    return Key(**{**row, "scopes": frozenset(row["scopes"])})


def _to_row(key: Key) -> dict[str, Any]:
    row = {name: getattr(key, name) for name in Key.__slots__}
    return {name: value for name, value in {**row, "scopes": sorted(key.scopes)}.items() if value is not None}
