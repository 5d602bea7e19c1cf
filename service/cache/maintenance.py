"""Maintenance of the results in a data folder, for `ricochet cache`."""

import sqlite3
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from service.cache.cache import ResultCache
from service.cache.index import Statistics, count_results, read_statistics
from service.errors import UnusableFolderError


@dataclass(frozen=True, slots=True)
class Verified:
    """Result of a check of the segments."""

    statistics: Statistics
    damaged: list[str]
    """Names of the damaged segments, which have been moved to the folder `damaged`."""


def stat(folder: Path) -> Statistics:
    """Return the size of the segments, and the number of results in them and in the journal. The folder may be in use.

    Raises
    ------
    UnusableFolderError
        If there are no results, or they cannot be read.
    """
    try:
        indexed = read_statistics(_index_of(folder))
        return replace(indexed, cases=indexed.cases + count_results(_index_of(folder).with_name("journal.sqlite")))
    except sqlite3.Error as error:
        raise UnusableFolderError(f"the index or the journal of the results cannot be read: {error}") from error


def verify(folder: Path) -> Verified:
    """Read all segments, and set damaged ones aside, so that their results are computed again.

    Raises
    ------
    UnusableFolderError
        If there are no results, the disk fails, a running service holds the folder, or another version has written it.
        `rebuild` and `evict` raise it for the same reasons.
    """
    with _results_of(folder) as cache:
        damaged = cache.verify()
        return Verified(cache.statistics(), damaged)


def rebuild(folder: Path) -> Statistics:
    """Rebuild the index from the segments."""
    with _results_of(folder) as cache:
        cache.rebuild()
        return cache.statistics()


def evict(folder: Path, limit: int) -> Statistics:
    """Evict the least recently used segments until the remaining ones take at most `limit` bytes."""
    with _results_of(folder) as cache:
        cache.evict(limit)
        return cache.statistics()


def _index_of(folder: Path) -> Path:
    results = folder / "results"
    if not results.is_dir():
        raise UnusableFolderError(f"there are no results in {folder}")
    return results / "index.sqlite"


@contextmanager
def _results_of(folder: Path) -> Iterator[ResultCache]:
    _index_of(folder)
    with ResultCache(folder, memory_bytes=0, disk_bytes=sys.maxsize) as cache:
        yield cache
    if cache.last_error:
        raise UnusableFolderError(cache.last_error)
