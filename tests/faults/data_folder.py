"""Checks of the files in a data folder."""

import sqlite3
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import h5py

SEGMENTS = Path("results", "segments")
INDEX = Path("results", "index.sqlite")
JOURNAL = Path("results", "journal.sqlite")
JOBS = Path("jobs.sqlite")
EXPECTED = {"lock"} | {f"{path}{end}" for path in (INDEX, JOURNAL, JOBS) for end in ("", "-wal", "-shm")}


@dataclass(frozen=True, slots=True)
class Segment:
    """A file of results. Two segments are equal if they are the same file and it has not been changed."""

    path: Path
    inode: int
    modified_ns: int
    keys: tuple[str, ...]


def segments(data: Path) -> dict[Path, Segment]:
    """Read all files of results, each of which must be complete; return them by path."""
    found = {}
    for path in sorted((data / SEGMENTS).rglob("*.h5")):
        status = path.stat()
        with h5py.File(BytesIO(path.read_bytes())) as file:
            keys = tuple(key.decode() for key in file["key"])
        found[path] = Segment(path, status.st_ino, status.st_mtime_ns, keys)
    return found


def keys_of(stored: dict[Path, Segment]) -> Counter[str]:
    """Count how often the files contain each result, by key."""
    return Counter(key for segment in stored.values() for key in segment.keys)


def journaled(data: Path) -> Counter[str]:
    """Count how often the journal contains each result, by key."""
    with closing(sqlite3.connect(f"{(data / JOURNAL).resolve().as_uri()}?mode=ro", uri=True, timeout=10.0)) as file:
        return Counter(key for (key,) in file.execute("SELECT key FROM results"))


def faults_of(data: Path, indexed: str) -> list[str]:
    """Return a line for each error in the data folder of a service that has finished its jobs.

    `indexed` is the output of `ricochet cache stat`, with the numbers of results and files in the index.
    """
    stored = segments(data)
    faults = []
    keys = keys_of(stored) + journaled(data)
    if not indexed.startswith(f"{keys.total()} results, {len(stored)} files,"):
        faults.append(f"{keys.total()} results in {len(stored)} files, but the index has {indexed}")
    faults += [f"stored {count} times: {key}" for key, count in keys.items() if count > 1]
    expected = EXPECTED | {str(path.relative_to(data)) for path in stored}
    expected |= {
        str(path.relative_to(data)) for ending in ("h5", "parquet") for path in data.glob(f"downloads/*.{ending}")
    }
    files = {str(path.relative_to(data)) for path in data.rglob("*") if path.is_file()}
    faults += [f"stray file {name}" for name in sorted(files - expected)]
    for name in (INDEX, JOURNAL, JOBS):
        with closing(sqlite3.connect(f"{(data / name).resolve().as_uri()}?mode=ro", uri=True, timeout=10.0)) as file:
            for check in ("PRAGMA integrity_check", "PRAGMA foreign_key_check"):
                faults += [f"{name}: {row}" for row in file.execute(check) if row != ("ok",)]
    return faults
