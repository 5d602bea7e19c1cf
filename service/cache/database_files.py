"""Files of SQLite that were damaged: commits that SQLite passes over without a word, and where damaged files go.

SQLite reads its write-ahead log up to the first frame whose checksum is wrong, as a crash leaves one at the end. It
takes one flipped bit in the middle for the same, and all later commits are gone. Only a callback in C says so, which
Python does not reach; so what stands in the log is compared with what SQLite has read of it.
"""

import logging
import shutil
import sqlite3
import struct
import time
from contextlib import suppress
from pathlib import Path

HEAD, FRAME_HEAD = 32, 24
"""Heads of the log and of each frame in it, a page each: https://sqlite.org/fileformat2.html#walformat. [bytes]"""
SHARED_READ = 16
"""Where the number of frames that SQLite has read stands in the memory that its connections share."""
BIG_ENDIAN, LITTLE_ENDIAN = 0x377F0683, 0x377F0682
"""First word of a log, by the order of bytes of its checksums."""

log = logging.getLogger(__name__)


def set_aside(path: Path, folder: Path, reason: str, *, keep: bool = False) -> None:
    """Move a damaged database and its log into a folder; with `keep`, copy them.

    Raises
    ------
    OSError
        If it cannot be done.
    """
    aside = folder / f"{path.stem}-{time.time_ns()}{path.suffix}"
    log.warning("%s set aside as %s: %s", path, aside, reason)
    folder.mkdir(parents=True, exist_ok=True)
    transfer = shutil.copy2 if keep else shutil.move
    try:
        transfer(path, aside)
        with suppress(FileNotFoundError):
            transfer(f"{path}-wal", f"{aside}-wal")  # it may hold what is worth saving
    except OSError:
        if keep:  # the disk is full, and this is tried again
            aside.unlink(missing_ok=True)
        raise
    if not keep:
        Path(f"{path}-shm").unlink(missing_ok=True)


def unread_commits(connection: sqlite3.Connection, path: Path) -> int:
    """Return how many commits stand in the log of a database behind the last that SQLite has read.

    To be called before anything is written. A crash leaves none: each commit is on the disk before the next begins.
    """
    connection.execute("PRAGMA user_version").fetchone()  # reads the log, if that is not done
    [(page_bytes,)] = connection.execute("PRAGMA page_size")
    try:
        content, shared = Path(f"{path}-wal").read_bytes(), Path(f"{path}-shm").read_bytes()
    except FileNotFoundError:
        return 0
    [read] = struct.unpack_from("=I", shared, SHARED_READ)
    starts = range(HEAD, len(content) - FRAME_HEAD - page_bytes + 1, FRAME_HEAD + page_bytes)
    frames = [struct.unpack_from(">4I", content, start) for start in starts]  # page, size after a commit, two salts
    if not frames:
        return 0
    salts = struct.unpack_from(">2I", content, 16) if _head_is_whole(content) else frames[0][2:]
    return sum(bool(size) and (first == salts[0] or second == salts[1]) for _, size, first, second in frames[read:])


def _head_is_whole(content: bytes) -> bool:
    """Return whether the head of a log has its checksum: otherwise SQLite reads nothing of the log."""
    magic, *_ = struct.unpack_from(">I", content)
    order = {BIG_ENDIAN: ">", LITTLE_ENDIAN: "<"}.get(magic)
    if order is None:
        return False
    first = second = 0
    for even, odd in struct.iter_unpack(f"{order}2I", content[: HEAD - 8]):
        first = (first + even + second) & 0xFFFFFFFF
        second = (second + odd + first) & 0xFFFFFFFF
    return (first, second) == struct.unpack_from(">2I", content, HEAD - 8)
