"""What a service has left in its data folder."""

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from service.cache.hdf5 import read_keys

SEGMENTS = Path("results", "segments")
INDEX = Path("results", "index.sqlite")
JOBS = Path("jobs.sqlite")
USUAL = {"lock", "keys.json", "keys.lock", "usage.json"} | {
    f"{path}{end}" for path in (INDEX, JOBS) for end in ("", "-wal", "-shm")
}


@dataclass(frozen=True, slots=True)
class Segment:
    """A file of results; it is the same one if nothing here has changed."""

    name: str
    file: int
    changed: int
    keys: tuple[str, ...]


def segments(data: Path) -> dict[str, Segment]:
    """All files of results, which are whole at any instant."""
    found = {}
    for path in sorted((data / SEGMENTS).rglob("*.h5")):
        status = path.stat()
        found[path.stem] = Segment(path.stem, status.st_ino, status.st_mtime_ns, tuple(read_keys(path.read_bytes())))
    return found


def keys_of(stored: dict[str, Segment]) -> Counter[str]:
    """How often each result is there."""
    return Counter(key for segment in stored.values() for key in segment.keys)


def faults_of(data: Path) -> list[str]:
    """What should not be in the folder of a service that has started and finished its jobs."""
    stored = segments(data)
    faults = [f"{count} times on disk: {key}" for key, count in keys_of(stored).items() if count > 1]
    known = {f"{SEGMENTS / name[:2] / name}.h5" for name in stored} | USUAL
    files = {str(path.relative_to(data)) for path in data.rglob("*") if path.is_file()}
    faults += [f"stray file {name}" for name in sorted(files - known)]
    with opened(data / INDEX) as index:
        named = {name for (name,) in index.execute("SELECT name FROM segments")}
        entered = {key.hex() for (key,) in index.execute("SELECT key FROM results")}
    if named != stored.keys():
        faults.append(f"index and files differ by {len(named ^ stored.keys())} segments")
    if entered != keys_of(stored).keys():
        faults.append(f"index and files differ by {len(entered ^ keys_of(stored).keys())} results")
    with opened(data / JOBS) as jobs:
        if half := jobs.execute("SELECT count(*) FROM jobs WHERE status = 'accepting'").fetchone()[0]:
            faults.append(f"{half} jobs half accepted")
        tables = ("slices", "states", "problems", "idempotency")
        orphans = [f"SELECT count(*) FROM {table} WHERE job NOT IN (SELECT number FROM jobs)" for table in tables]  # noqa: S608
        if any(jobs.execute(query).fetchone()[0] for query in orphans):
            faults.append("cases of jobs that are gone")
        if jobs.execute("PRAGMA integrity_check").fetchall() != [("ok",)]:
            faults.append("the jobs are damaged")
    return faults


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """An SQLite file that a service may have open too, to read."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=10.0)) as connection:
        yield connection
