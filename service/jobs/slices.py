"""Cases of a batch as they are stored, two hundred to a slice.

The requests of a slice are alike and compressed together: some 15 bytes a case instead of 800.
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any, Protocol

import orjson

from service.keys import result_key

SLICE = 200
"""Cases: few enough that preparing them leaves the interpreter lock to others, and enough to compress well."""
KEY_BYTES = 32
FASTEST = 1
"""Level of zlib. The slowest one saves no more than a tenth."""


class Request(Protocol):
    """A validated request."""

    def canonical(self) -> dict[str, Any]:
        """Every field as JSON, defaults filled in."""
        ...


class CaseState(IntEnum):
    """How far a case is; a byte each."""

    WAITING = 0
    DONE = 1
    CACHED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class Case:
    """One case of a batch, validated."""

    request: Request
    custom_id: str | None = None


@dataclass(frozen=True, slots=True)
class Slice:
    """Cases in order: their keys one after the other, their canonical requests as compressed lines of JSON."""

    keys: bytes
    requests: bytes
    custom_ids: bytes | None

    @property
    def count(self) -> int:
        """Number of cases."""
        return len(self.keys) // KEY_BYTES


def pack(operation: str, cases: Sequence[Case]) -> Slice:
    """Return the cases as they are stored."""
    canonical = [case.request.canonical() for case in cases]
    lines = b"\n".join(orjson.dumps(request) for request in canonical)
    ids = [case.custom_id for case in cases]
    return Slice(
        keys=join_keys(result_key(operation, request) for request in canonical),
        requests=zlib.compress(lines, FASTEST),
        custom_ids=zlib.compress(orjson.dumps(ids), FASTEST) if any(name is not None for name in ids) else None,
    )


def join_keys(keys: Iterator[str]) -> bytes:
    """Return keys as they are stored."""
    return b"".join(map(bytes.fromhex, keys))


def split_keys(keys: bytes) -> list[str]:
    """Return the keys that were stored."""
    return [keys[i : i + KEY_BYTES].hex() for i in range(0, len(keys), KEY_BYTES)]


@lru_cache(maxsize=16)
def split_requests(requests: bytes) -> tuple[bytes, ...]:
    """Return the canonical requests that were stored, each as JSON; those of the latest slices are at hand."""
    return tuple(zlib.decompress(requests).split(b"\n"))


def split_custom_ids(custom_ids: bytes | None, count: int) -> list[str | None]:
    """Return the names that were stored, as many as there are cases."""
    if custom_ids is None:
        return [None] * count
    names: list[str | None] = orjson.loads(zlib.decompress(custom_ids))
    return names
