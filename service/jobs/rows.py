"""The one place that reads what is stored of a job: its row, and its cases in blocks.

What a disk or a hand has damaged is found here: a job is `damaged` then, and cases have a problem.
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
"""Columns of a `JobState`, of `jobs` and `sweeps`; the last is read for `axes`."""
BLOCK_COLUMNS = "keys, states, requests, custom_ids"
UNKNOWN = "unknown"
"""Operation of a job whose own cannot be read."""
DAMAGE = (LookupError, OSError, OverflowError, TypeError, ValueError, zlib.error)
"""Errors of reading what is not what was written."""
JOB = TypeAdapter(JobState)
VERSIONS_KEPT = 2
"""Versions that a job is stored with: those of the solver and of the contract."""

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
"""Functions that read what is not stored as it is."""
WITHOUT: Mapping[str, Any] = {
    **dict.fromkeys(("id", "owner", "versions"), ""),
    **dict.fromkeys(("total", "done", "cached", "failed", "revision"), 0),
    "operation": UNKNOWN,
    "created": _date(0.0),
    "axes": (),
}
"""Values in place of those that cannot be read; None for the others."""


def read_job(row: Sequence[Any], operations: Container[str]) -> JobState:
    """Return the job of a row of `COLUMNS`; a damaged one has what can be read of it.

    Parameters
    ----------
    operations
        Names of what jobs compute.
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
    if not wrong and not 0 <= max(job.cached, job.failed) <= job.done <= job.total:
        wrong.add("done")
    if not wrong:
        return job
    log.error("job %s is damaged: %s cannot be read", job.id, ", ".join(sorted(wrong)))
    return replace(job, status="damaged", problem=problem_of(DamagedJobError(sorted(wrong))))


def _validated(found: dict[str, Any], wrong: set[str]) -> JobState:
    """Return the job of these fields; those that cannot be what was written are left out, and noted as wrong."""
    try:
        return JOB.validate_python(found)
    except ValidationError as error:
        bad = {str(each["loc"][0]) for each in error.errors()}
    wrong |= bad
    return JobState(**{**found, **{name: WITHOUT.get(name) for name in bad}})


def read_block(number: int, count: int, row: Sequence[Any] | None) -> list[CaseRow]:
    """Return the cases of a block, without problems, from a row of `BLOCK_COLUMNS`.

    Parameters
    ----------
    number, count
        Number of the block, and of its cases.

    Raises
    ------
    DamagedCasesError
        If they are not what was written, or not there at all.
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
    """Return a case of which nothing can be read."""
    return CaseRow(number, CaseState.FAILED, "", None, None, problem_of(DamagedCasesError(number, number)))


def read_problem(number: int, text: Any) -> dict[str, Any]:
    """Return the problem of a case, that of a damaged one if it cannot be read."""
    try:
        return _problem(text)
    except DAMAGE:
        return problem_of(DamagedCasesError(number, number))


def _lines(requests: bytes, count: int) -> Sequence[bytes | None]:
    """Return the requests of a block; None for each if they cannot be read, as results are found without them."""
    try:
        return split_requests(requests)
    except DAMAGE:
        return [None] * count


def is_of(operation: str, request: bytes, key: str) -> bool:
    """Return whether a key is that of the result of a request."""
    try:
        return result_key(operation, orjson.loads(request)) == key
    except DAMAGE:
        return False
