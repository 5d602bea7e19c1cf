"""Decoding of stored jobs and blocks of cases, with checks for damage by the disk or by manual changes.

A job with a damaged row has the status `damaged`; a damaged case has a problem.
"""

import logging
import zlib
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import orjson
from pydantic import TypeAdapter, ValidationError

from service.errors import DamagedCasesError, DamagedJobError, problem_of
from service.jobs.models import (
    BLOCK_SIZE,
    KEY_BYTES,
    CaseRow,
    CaseState,
    Charge,
    JobState,
    fields_of,
    split_custom_ids,
    split_keys,
    split_requests,
)
from service.operations import result_key
from service.schemas.problems import Problem
from service.schemas.uncertainty_answers import StudyProgress

COLUMNS = (
    "id, operation, status, total, done, cached, failed, created, started, finished, expires, problem, revision, "
    "number, owner, versions, progress, title, traceparent, charge, sweep"
)
"""Columns of the tables `jobs` and `sweeps` for the fields of a `JobState`. The last one is decoded to `axes`."""
BLOCK_COLUMNS = "keys, states, requests, custom_ids"
UNKNOWN = "unknown"
"""Operation of a job whose own operation is damaged."""
DAMAGE = (LookupError, OSError, OverflowError, TypeError, ValueError, zlib.error)
"""Exceptions that decoding a damaged value may raise."""
JOB = TypeAdapter(JobState)
VERSIONS_KEPT = 2
"""Number of versions stored with a job: that of the solver and that of the contract."""

log = logging.getLogger(__name__)


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
"""Values that replace damaged ones; None for other columns."""


def read_job(row: Sequence[Any], operations: Container[str]) -> JobState:
    """Decode a row of `COLUMNS`. A damaged job has the readable values, and defaults for the others.

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
    # Each number can be valid by itself and yet contradict the others.
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
    """Decode a row of `BLOCK_COLUMNS` into cases. Their problems are stored separately, and None here.

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
    """Decode the requests of a block; None for each if they are damaged. Results can be found by key without them."""
    try:
        return split_requests(requests)
    except DAMAGE:
        return [None] * count


def is_of(operation: str, request: bytes, key: str) -> bool:
    """Return True if this is the key of a request under the current versions."""
    try:
        return result_key(operation, orjson.loads(request)) == key
    except DAMAGE:
        return False
