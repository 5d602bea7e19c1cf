"""Jobs and their cases, in memory and as they are stored.

Stored values may be damaged by the disk or by manual changes. A job with a damaged row has the status `damaged`. The
cases of a damaged block count as failed, with a problem that states the damage.
"""

import itertools
import logging
import math
import zlib
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import IntEnum
from functools import lru_cache
from threading import Lock
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import orjson
from cachetools import LRUCache, cached
from pydantic import Field, TypeAdapter, ValidationError

from service.errors import DamagedCasesError, DamagedJobError, problem_of
from service.names import QUANTITIES, TITLES, named
from service.operations import KeyedRequest, is_study, result_key
from service.schemas.problems import Problem
from service.schemas.uncertainty_answers import StudyProgress

Status: TypeAlias = Literal["accepted", "running", "successful", "failed", "dismissed", "damaged"]
FINAL = frozenset({"successful", "failed", "dismissed", "damaged"})
Natural: TypeAlias = Annotated[int, Field(ge=0)]
BLOCK_SIZE = 200
"""Number of cases in a stored block: few enough that preparing one does not hold the interpreter lock for long, and
enough to be compressed well."""
KEY_BYTES = 32
"""Length of the key of a result, a SHA-256 digest [bytes]."""
FASTEST = 1
"""Compression level of zlib. The slowest level would save a tenth to a third, and take twice as long."""

log = logging.getLogger(__name__)


class CaseState(IntEnum):
    """State of a case, stored as one byte."""

    WAITING = 0
    DONE = 1
    CACHED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class JobCase:
    """A validated case of a batch or a sweep, or a sample of a study."""

    request: KeyedRequest
    custom_id: str | None = None


@dataclass(frozen=True, slots=True)
class StoredSweep:
    """Request for a sweep over every combination of the values of its axes, the last axis fastest.

    Parameters
    ----------
    request
        Base and axes as the client sent them.
    fields, values
        Field and values of each axis.
    """

    request: dict[str, Any]
    fields: tuple[str, ...]
    values: tuple[Sequence[float], ...]

    def point(self, number: int) -> tuple[float, ...]:
        """Return the values of the axes for the case with this number."""
        # The step of an axis is the number of combinations of all axes after it.
        later = itertools.accumulate(map(len, reversed(self.values)), lambda total, count: total * count, initial=1)
        steps = list(later)[-2::-1] if self.values else []
        return tuple(axis[number // step % len(axis)] for axis, step in zip(self.values, steps, strict=True))

    @property
    def count(self) -> int:
        """Number of cases, one for each combination of values."""
        return math.prod(map(len, self.values))

    def pack(self) -> bytes:
        """Encode the sweep for the store, as compressed JSON."""
        content = orjson.dumps({"request": self.request, "fields": self.fields, "values": self.values})
        return zlib.compress(content, FASTEST)

    @classmethod
    def unpack(cls, packed: bytes) -> "StoredSweep":
        """Decode a stored sweep."""
        stored = orjson.loads(zlib.decompress(packed))
        return cls(stored["request"], tuple(stored["fields"]), tuple(stored["values"]))


@lru_cache(maxsize=64)
def fields_of(packed: bytes) -> tuple[str, ...]:
    """Return the fields of the axes of a stored sweep. They are cached, because every update of a job needs them."""
    return StoredSweep.unpack(packed).fields


TITLED = {"diameter_m": (1e3, "mm"), "mass_kg": (1.0, "kg")}
"""Quantities of the projectile in the title of a sweep, with the factor from SI and the unit."""


def title_of(sweep: StoredSweep) -> str:
    """Return the default title of a sweep: its axes, and diameter and mass of the projectile if they are fixed."""
    varied = " × ".join(map(name_of, sweep.fields))
    projectile = sweep.request["base"].get("projectile", {})
    fixed = {name: unit for name, unit in TITLED.items() if f"projectile.{name}" not in sweep.fields}
    return ", ".join([varied, *(shown(projectile, name, *unit) for name, unit in fixed.items() if name in projectile)])


def name_of(field: str) -> str:
    """Return the display name of a field."""
    return TITLES.get(field) or named(QUANTITIES, field).lower()


def shown(part: Mapping[str, Any], name: str, factor: float, unit: str) -> str:
    """Return a quantity as text with its unit."""
    return f"{part[name] * factor:.4g} {unit}"


@dataclass(frozen=True, slots=True)
class Idempotency:
    """Identity of a request that may be sent again.

    Parameters
    ----------
    token
        Idempotency key chosen by the client.
    digest
        Hash of path, media type and body, or a function that returns it once the body has been read.
    """

    token: str
    digest: str | Callable[[], str]

    @property
    def whole_digest(self) -> str:
        """Hash of path, media type and body. The whole body must have been read."""
        return self.digest if isinstance(self.digest, str) else self.digest()


class Charge(NamedTuple):
    """Cost of all samples that a study may take, charged to the quota of an API key until the study ends."""

    key_id: str
    cases: int
    began: int
    """Start of the time step in which the quota counts the cases. [s since 1970]"""


@dataclass(frozen=True, slots=True)
class JobState:
    """State of a job. `done` counts all finished cases, including `cached` and `failed` ones."""

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
    """Row number in the store. Later jobs have greater numbers."""
    owner: str = field(repr=False)
    versions: str = field(repr=False)
    axes: tuple[str, ...] = ()
    """Fields of the axes of a sweep; empty for a batch."""
    progress: dict[str, Any] | None = None
    """Progress of a study that has begun."""
    title: str | None = None
    """Title given by the client, or the default title of a sweep."""
    charge: Charge | None = field(default=None, repr=False)
    traceparent: str | None = field(default=None, repr=False)
    """Header `traceparent` (W3C) with the span of the request that created the job, if it was traced."""

    @property
    def final(self) -> bool:
        """True if the job has ended."""
        return self.status in FINAL

    @property
    def is_study(self) -> bool:
        """True if the job is one study of uncertainty, whose samples are computed and stored like cases.

        In a sweep, and in a batch of several studies, each case is a study, which a worker computes as a whole.
        """
        return is_study(self.operation) and not self.axes and self.total == 1

    @property
    def engine_version(self) -> str:
        """Version of the solver that computes the results."""
        return self.versions.split()[0]

    @property
    def unused_cases(self) -> int:
        """Number of cases that were charged and not used. An answer from the cache costs one case."""
        if self.charge is None:
            return 0
        if self.cached or self.progress is None:
            return self.charge.cases - 1
        # A study costs at least one case; so does an answer from the cache.
        taken, most = max(1, int(self.progress["samples"])), int(self.progress["max_samples"])
        return max(0, self.charge.cases * (most - taken) // most)


class CaseRow(NamedTuple):
    """Stored case with its state and, if it failed, its problem."""

    number: int
    state: CaseState
    key: str
    custom_id: str | None
    request: bytes | None
    """Canonical request as JSON; None if it is damaged."""
    problem: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class CaseBlock:
    """Stored block of cases in order: keys, canonical requests and, if any case has one, the `custom_id` of each case.

    Keys are concatenated; requests are compressed lines of JSON, and ids a compressed list. Requests of a batch are
    similar: compressed together, they take 12 to 30 bytes per case instead of 800.
    """

    keys: bytes
    requests: bytes
    custom_ids: bytes | None

    @classmethod
    def of(cls, cases: Sequence[JobCase]) -> "CaseBlock":
        """Encode cases as a block."""
        ids = [case.custom_id for case in cases]
        return cls(
            keys=join_keys(case.request.key for case in cases),
            requests=zlib.compress(b"\n".join(case.request.json for case in cases), FASTEST),
            custom_ids=zlib.compress(orjson.dumps(ids), FASTEST) if any(name is not None for name in ids) else None,
        )

    @property
    def count(self) -> int:
        """Number of cases in the block."""
        return len(self.keys) // KEY_BYTES


def join_keys(keys: Iterable[str]) -> bytes:
    """Concatenate hexadecimal keys, as bytes, for the store."""
    return b"".join(map(bytes.fromhex, keys))


def split_keys(keys: bytes) -> list[str]:
    """Split stored bytes into hexadecimal keys."""
    return [keys[i : i + KEY_BYTES].hex() for i in range(0, len(keys), KEY_BYTES)]


# A usual block has 0.2 MB, so all that are being read fit. The largest has 26 MB: 200 requests with the longest body.
DECODED_BYTES = 32 * 1024 * 1024
"""Size of the decoded blocks of requests that are cached. [bytes]"""


@cached(LRUCache[Any, tuple[bytes, ...]](DECODED_BYTES, getsizeof=lambda lines: sum(map(len, lines))), lock=Lock())
def split_requests(requests: bytes) -> tuple[bytes, ...]:
    """Decode stored canonical requests. Recent blocks are cached, because a block is read in several parts."""
    return tuple(zlib.decompress(requests).split(b"\n"))


def split_custom_ids(custom_ids: bytes | None, count: int) -> list[str | None]:
    """Decode the stored `custom_id` of each of `count` cases; None for cases without one."""
    if custom_ids is None:
        return [None] * count
    names: list[str | None] = orjson.loads(zlib.decompress(custom_ids))
    return names


COLUMNS = (
    "id, operation, status, total, done, cached, failed, created, started, finished, expires, problem, revision, "
    "number, owner, versions, progress, title, traceparent, charge, sweep"
)
"""Columns of the tables `jobs` and `sweeps` for the fields of a `JobState`. The last column is decoded to `axes`."""
BLOCK_COLUMNS = "keys, states, requests, custom_ids"
UNKNOWN = "unknown"
"""Operation of a job whose stored operation is damaged."""
DAMAGE = (LookupError, OSError, OverflowError, TypeError, ValueError, zlib.error)
"""Exceptions that decoding a damaged value may raise."""
JOB = TypeAdapter(JobState)
VERSIONS_KEPT = 2
"""Number of versions stored with a job: the versions of the solver and of the contract."""


def _date(timestamp: float) -> datetime:
    return datetime.fromtimestamp(timestamp, UTC)


def _problem(text: str) -> dict[str, Any]:
    content: dict[str, Any] = orjson.loads(text)
    Problem.model_validate({**content, "instance": ""})
    return content


def _progress(text: str) -> dict[str, Any]:
    content: dict[str, Any] = orjson.loads(text)
    StudyProgress.model_validate(content)
    return content


READ: Mapping[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("created", "started", "finished", "expires"), _date),
    "problem": _problem,
    "progress": _progress,
    "charge": lambda text: Charge(*orjson.loads(text)),
    "axes": fields_of,
}
"""Decoders of columns whose values are stored in another form."""
WITHOUT: Mapping[str, Any] = {
    **dict.fromkeys(("id", "owner", "versions"), ""),
    **dict.fromkeys(("total", "done", "cached", "failed", "revision"), 0),
    "operation": UNKNOWN,
    "created": _date(0.0),
    "axes": (),
}
"""Defaults for missing and damaged values, by column; None for other columns."""


def read_job(row: Sequence[Any], operations: Container[str]) -> JobState:
    """Decode a row of `COLUMNS`. A damaged job has the values that can be read, and defaults for the others.

    Parameters
    ----------
    operations
        Names of the operations that jobs can have.
    """
    *names, _ = COLUMNS.split(", ")
    found: dict[str, Any] = {}
    wrong: set[str] = set()
    for name, value in zip((*names, "axes"), row, strict=True):
        try:
            found[name] = WITHOUT.get(name) if value is None else READ.get(name, lambda stored: stored)(value)
        except DAMAGE:
            wrong.add(name)
    if found["operation"] not in operations:
        wrong.add("operation")
    if len(str(found["versions"]).split()) != VERSIONS_KEPT:
        wrong.add("versions")
    job = _validated({**found, **{name: WITHOUT.get(name) for name in wrong}}, wrong)
    # Each number can be valid on its own and yet contradict the others.
    if not wrong and not 0 <= max(job.cached, job.failed) <= job.done <= job.total:
        wrong.add("done")
    if not wrong:
        return job
    log.error("job %s is damaged: %s cannot be read", job.id, ", ".join(sorted(wrong)))
    return replace(job, status="damaged", problem=problem_of(DamagedJobError(sorted(wrong))))


def _validated(found: dict[str, Any], wrong: set[str]) -> JobState:
    """Validate the fields of a job. Invalid ones are replaced by defaults, and their names are added to `wrong`."""
    try:
        return JOB.validate_python(found)
    except ValidationError as error:
        bad = {str(each["loc"][0]) for each in error.errors()}
    wrong |= bad
    return JobState(**{**found, **{name: WITHOUT.get(name) for name in bad}})


def read_block(number: int, count: int, row: Sequence[Any] | None) -> list[CaseRow]:
    """Decode a row of `BLOCK_COLUMNS` into cases. The problems of cases are stored separately, and are None here.

    Parameters
    ----------
    number, count
        Number of the block, and number of its cases.

    Raises
    ------
    DamagedCasesError
        If the block is damaged or missing.
    """
    first = number * BLOCK_SIZE
    try:
        keys, states, requests, custom_ids = row or ()
        names = split_custom_ids(custom_ids, count)
        lines = _lines(requests, count)
        if len(keys) != KEY_BYTES * count or len(states) != count or len(names) != count:
            raise ValueError("not as many as there were")
        rows = zip(map(CaseState, states), split_keys(keys), names, lines, strict=True)
        return [CaseRow(first + i, *values, None) for i, values in enumerate(rows)]
    except DAMAGE as error:
        log.error("cases %d to %d of a job are damaged: %s", first, first + count - 1, error)
        raise DamagedCasesError(first, first + count - 1) from None


def damaged_case(number: int) -> CaseRow:
    """Return a case of a damaged block, with the damage as its problem."""
    return CaseRow(number, CaseState.FAILED, "", None, None, problem_of(DamagedCasesError(number, number)))


def read_problem(number: int, text: Any) -> dict[str, Any]:
    """Decode the problem of a case. If it is damaged, return the problem of a damaged case."""
    try:
        return _problem(text)
    except DAMAGE:
        return problem_of(DamagedCasesError(number, number))


def _lines(requests: bytes, count: int) -> Sequence[bytes | None]:
    """Decode the requests of a block, or return None for each if they are damaged: the keys suffice to find results."""
    try:
        return split_requests(requests)
    except DAMAGE:
        return [None] * count


def is_of(operation: str, request: bytes, key: str) -> bool:
    """Return True if `key` is the key of the request under the current versions; False if the request is damaged."""
    try:
        return result_key(operation, orjson.loads(request)) == key
    except DAMAGE:
        return False
