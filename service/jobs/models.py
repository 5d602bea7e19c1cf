"""Jobs and their cases, as the service has them in memory and in the store."""

import itertools
import math
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import IntEnum
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import orjson
from pydantic import Field

from service.names import QUANTITIES, TITLES, named
from service.operations import KeyedRequest

Status: TypeAlias = Literal["accepted", "running", "successful", "failed", "dismissed", "damaged"]
FINAL = frozenset({"successful", "failed", "dismissed", "damaged"})
Natural: TypeAlias = Annotated[int, Field(ge=0)]
BLOCK_SIZE = 200
"""Cases stored together: few enough that preparing them leaves the interpreter lock to others, and enough to compress
well."""
KEY_BYTES = 32
"""Length of the key of a result, a SHA-256 digest [bytes]."""
FASTEST = 1
"""Level of zlib. The slowest one saves no more than a tenth."""


class CaseState(IntEnum):
    """How far a case is; a byte each."""

    WAITING = 0
    DONE = 1
    CACHED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class JobCase:
    """One case of a batch, validated."""

    request: KeyedRequest
    custom_id: str | None = None


@dataclass(frozen=True, slots=True)
class StoredSweep:
    """The request of a sweep: every combination of the values of its axes, the last axis fastest.

    Parameters
    ----------
    request
        Base and axes, as they were sent.
    fields, values
        Field and values of each axis.
    """

    request: dict[str, Any]
    fields: tuple[str, ...]
    values: tuple[Sequence[float], ...]

    def point(self, number: int) -> tuple[float, ...]:
        """Return the values of the axes at a case."""
        later = itertools.accumulate(map(len, reversed(self.values)), lambda total, count: total * count, initial=1)
        steps = list(later)[-2::-1] if self.values else []
        return tuple(axis[number // step % len(axis)] for axis, step in zip(self.values, steps, strict=True))

    @property
    def count(self) -> int:
        """Number of cases."""
        return math.prod(map(len, self.values))

    def pack(self) -> bytes:
        """Return the sweep as it is stored."""
        content = orjson.dumps({"request": self.request, "fields": self.fields, "values": self.values})
        return zlib.compress(content, FASTEST)

    @classmethod
    def unpack(cls, packed: bytes) -> "StoredSweep":
        """Return the sweep that was stored."""
        stored = orjson.loads(zlib.decompress(packed))
        return cls(stored["request"], tuple(stored["fields"]), tuple(stored["values"]))


@lru_cache(maxsize=64)
def fields_of(packed: bytes) -> tuple[str, ...]:
    """Return the fields of the axes of a sweep that was stored; lists of jobs and every mark of a job ask for them."""
    return StoredSweep.unpack(packed).fields


TITLED = {"diameter_m": (1e3, "mm"), "mass_kg": (1.0, "kg")}
"""Quantities of the projectile in the title of a sweep: factor from SI, and unit."""


def title_of(sweep: StoredSweep) -> str:
    """Return the title of a sweep that has been given none."""
    varied = " × ".join(map(name_of, sweep.fields))
    projectile = sweep.request["base"].get("projectile", {})
    fixed = {name: unit for name, unit in TITLED.items() if f"projectile.{name}" not in sweep.fields}
    return ", ".join([varied, *(shown(projectile, name, *unit) for name, unit in fixed.items() if name in projectile)])


def name_of(field: str) -> str:
    """Return a field in words."""
    return TITLES.get(field) or named(QUANTITIES, field).lower()


def shown(part: Mapping[str, Any], name: str, factor: float, unit: str) -> str:
    """Return a value with its unit."""
    return f"{part[name] * factor:.4g} {unit}"


@dataclass(frozen=True, slots=True)
class Idempotency:
    """What identifies a request that is sent again.

    Parameters
    ----------
    token
        The client's key.
    digest
        Hash of the operation and the whole body; a function if the body is still being read, called at its end.
    """

    token: str
    digest: str | Callable[[], str]

    @property
    def whole_digest(self) -> str:
        """The digest, once the body has been read."""
        return self.digest if isinstance(self.digest, str) else self.digest()


class Charge(NamedTuple):
    """What a study counts as against the quota of an API key until it ends: all the samples it may take."""

    key_id: str
    cases: int
    began: int
    """Entry of the quota that has them: since 1970. [s]"""


@dataclass(frozen=True, slots=True)
class JobState:
    """A job at one instant. `done` counts every case that has its result: new ones, `cached` ones, `failed` ones."""

    id: str
    operation: str
    status: Status
    total: Natural
    done: Natural
    cached: Natural
    failed: Natural
    created: datetime
    started: datetime | None
    finished: datetime | None
    expires: datetime | None
    problem: dict[str, Any] | None
    revision: Natural
    number: int = field(repr=False)
    """Row in the store."""
    owner: str = field(repr=False)
    versions: str = field(repr=False)
    axes: tuple[str, ...] = ()
    """Fields of the axes of a sweep."""
    progress: dict[str, Any] | None = None
    """How far a study is, once it has begun."""
    title: str | None = None
    """What varies, if it is a sweep, or as it was given."""
    charge: Charge | None = field(default=None, repr=False)
    traceparent: str | None = field(default=None, repr=False)
    """Span of the request that made it, if that was traced."""

    @property
    def final(self) -> bool:
        """Whether nothing changes any more."""
        return self.status in FINAL

    @property
    def engine_version(self) -> str:
        """Version of the solver that its results are of."""
        return self.versions.split()[0]

    @property
    def unused_cases(self) -> int:
        """Cases that it was charged and has not taken; an answer that was there already counts as one."""
        if self.charge is None:
            return 0
        if self.cached or self.progress is None:
            return self.charge.cases - 1
        taken, most = max(1, int(self.progress["samples"])), int(self.progress["max_samples"])
        return max(0, self.charge.cases * (most - taken) // most)


class CaseRow(NamedTuple):
    """A case as it is stored."""

    number: int
    state: CaseState
    key: str
    custom_id: str | None
    request: bytes | None
    """Canonical request; None if it is damaged."""
    problem: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class CaseBlock:
    """Cases in order: their keys one after the other, their canonical requests as compressed lines of JSON.

    The requests are alike and compressed together: some 15 bytes a case instead of 800.
    """

    keys: bytes
    requests: bytes
    custom_ids: bytes | None

    @classmethod
    def of(cls, cases: Sequence[JobCase]) -> "CaseBlock":
        """Return the cases as they are stored."""
        ids = [case.custom_id for case in cases]
        return cls(
            keys=join_keys(case.request.key for case in cases),
            requests=zlib.compress(b"\n".join(case.request.json for case in cases), FASTEST),
            custom_ids=zlib.compress(orjson.dumps(ids), FASTEST) if any(name is not None for name in ids) else None,
        )

    @property
    def count(self) -> int:
        """Number of cases."""
        return len(self.keys) // KEY_BYTES


def join_keys(keys: Iterable[str]) -> bytes:
    """Return keys as they are stored."""
    return b"".join(map(bytes.fromhex, keys))


def split_keys(keys: bytes) -> list[str]:
    """Return the keys that were stored."""
    return [keys[i : i + KEY_BYTES].hex() for i in range(0, len(keys), KEY_BYTES)]


@lru_cache(maxsize=16)
def split_requests(requests: bytes) -> tuple[bytes, ...]:
    """Return the canonical requests that were stored, each as JSON; those of the latest blocks are at hand."""
    return tuple(zlib.decompress(requests).split(b"\n"))


def split_custom_ids(custom_ids: bytes | None, count: int) -> list[str | None]:
    """Return the names that were stored, as many as there are cases."""
    if custom_ids is None:
        return [None] * count
    names: list[str | None] = orjson.loads(zlib.decompress(custom_ids))
    return names
