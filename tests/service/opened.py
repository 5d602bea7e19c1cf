"""Stores and caches that a test opens without closing them; they are closed when it ends.

From Python 3.13 on, sqlite3 warns of connections that are left open.
"""

from typing import Protocol, TypeVar


class Closable(Protocol):
    def close(self) -> None: ...


T = TypeVar("T", bound=Closable)
_opened: list[Closable] = []


def closed_later(store: T) -> T:
    """Return a store, which is closed at the end of the test."""
    _opened.append(store)
    return store


def close_all() -> None:
    while _opened:
        _opened.pop().close()
