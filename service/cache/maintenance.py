"""What can be done to the results of a data folder from outside."""

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
    """Findings of a check of the segments."""

    statistics: Statistics
    damaged: list[str]
    """Names of segments that were not what had been written; they are in the folder `damaged` now."""


def stat(folder: Path) -> Statistics:
    """Return what is stored, results of the journal too; a service may be running.

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
    """Read everything; set aside what is damaged, so that it is computed again.

    Raises
    ------
    UnusableFolderError
        If there are no results, the disk does not let it be, or a running service has the folder; so do the others.
    """
    with _results_of(folder) as cache:
        damaged = cache.verify()
        return Verified(cache.statistics(), damaged)


def rebuild(folder: Path) -> Statistics:
    """Make the index anew from the segments."""
    with _results_of(folder) as cache:
        cache.rebuild()
        return cache.statistics()


def evict(folder: Path, limit: int) -> Statistics:
    """Remove the results used longest ago until the rest takes no more than this many bytes."""
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
