"""Durable jobs: what has been accepted is finished, whatever happens to the process meanwhile.

    jobs.sqlite   jobs, the requests of sweeps, cases in blocks (table `slices`), how far each case or study is

A job is `accepting`, and seen by nobody, until all its cases are there.
"""

import itertools
import secrets
import sqlite3
from collections import Counter
from collections.abc import Callable, Collection, Container, Mapping
from pathlib import Path
from typing import Any, get_args

import orjson

from service.clock import SYSTEM, Clock
from service.errors import DamagedCasesError, JobGoneError, JobsTooLargeError
from service.jobs.database import Database
from service.jobs.models import (
    BLOCK_SIZE,
    KEY_BYTES,
    CaseBlock,
    CaseRow,
    CaseState,
    Charge,
    Idempotency,
    JobState,
    Status,
    StoredSweep,
    join_keys,
    split_requests,
    title_of,
)
from service.jobs.rows import (
    BLOCK_COLUMNS,
    COLUMNS,
    DAMAGE,
    damaged_case,
    read_block,
    read_job,
    read_problem,
)
from service.operations import OPERATIONS, SCHEMA_VERSION, result_key
from solver import ENGINE_VERSION

DAY = 86_400.0  # [s]
VERSIONS = f"{ENGINE_VERSION} {SCHEMA_VERSION}"
"""Versions with which the keys of a job were made."""
OWNER_BYTES = 2**30
"""Disk space for the jobs of one owner [bytes]."""
JOB_BYTES = 10_000
"""Size charged for a job beside its cases [bytes]: more than it takes, so that an owner has at most 100,000 jobs."""
CASE_BYTES, PROBLEM_BYTES = 100, 300
"""Approximate size of a case of a job without a noted size, and of a problem."""
TAKEN = f"coalesce(bytes, {JOB_BYTES} + {CASE_BYTES} * total) + {PROBLEM_BYTES} * failed"
"""Space that a job takes."""
BEYOND = f"""
SELECT number, finished IS NOT NULL FROM (
    SELECT number, finished,
        sum({TAKEN})
            OVER (ORDER BY finished IS NOT NULL, finished DESC, number DESC) AS taken
    FROM jobs
    WHERE owner = (SELECT owner FROM jobs WHERE number = ?)
)
WHERE taken > ?
"""  # noqa: S608 (of this file)
"""Selects the jobs of the owner of a job that exceed so many bytes, and whether they have ended; unfinished jobs and
those that ended last stay."""
STATUSES = frozenset(get_args(Status))
LARGEST = 2**63 - 1
"""Largest integer of SQLite."""
SELECT = f"SELECT {COLUMNS} FROM jobs LEFT JOIN sweeps ON sweeps.job = jobs.number"  # noqa: S608 (of the package)


class JobStore:
    """Keeps jobs. Everything here waits for the disk, is safe from several threads and raises `StorageError`.

    Parameters
    ----------
    folder
        Data folder of the service.
    job_days
        How long a job is kept after its end.
    owner_bytes
        Disk for the jobs of one owner: those that ended first go when there is no room for a new one.
    check_folder
        Called before anything is written; raises StorageError if nothing may be.
    operations
        Names of what jobs compute.
    clock
        Its dates are those of jobs.
    """

    def __init__(
        self,
        folder: Path,
        *,
        job_days: float,
        owner_bytes: int = OWNER_BYTES,
        check_folder: Callable[[], None] = lambda: None,
        operations: Container[str] = OPERATIONS,
        clock: Clock = SYSTEM,
    ) -> None:
        self._operations = operations
        self._clock = clock
        self._database = Database(folder / "jobs.sqlite", check_folder)
        self._kept_seconds = job_days * DAY
        self._owner_bytes = owner_bytes
        self._most_taken: dict[str, int] = {}
        """Most that the jobs of an owner can take, so that they are added up only when there may be no room."""

    def expire(self, *, at_start: bool = False) -> int:
        """Remove what has expired, and at the start what was never accepted whole; return how many jobs."""
        with self._database.writing() as database:
            removed = database.execute("DELETE FROM jobs WHERE expires < ?", (self._clock.now(),)).rowcount
            if at_start:
                removed += database.execute("DELETE FROM jobs WHERE status = 'accepting'").rowcount
        return removed

    def create(
        self, operation: str, owner: str, sweep: StoredSweep | None = None, *, traceparent: str | None = None
    ) -> int:
        """Begin a job that nobody sees yet; return its number."""
        columns = "id, owner, operation, versions, status, created, title, traceparent"
        title = None if sweep is None else title_of(sweep)
        row = (secrets.token_hex(16), owner, operation, VERSIONS, "accepting", self._clock.now(), title, traceparent)
        with self._database.writing() as database:
            statement = f"INSERT INTO jobs ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"  # noqa: S608 (of this file)
            number = database.execute(statement, row).lastrowid or 0
            if sweep is not None:
                database.execute("INSERT INTO sweeps VALUES (?, ?)", (number, sweep.pack()))
            return number

    def sweep(self, job: int) -> StoredSweep | None:
        """Return the request of a job, if it is a sweep; None too if it is damaged, as the job is then."""
        with self._database.reading() as database:
            row = database.execute("SELECT sweep FROM sweeps WHERE job = ?", (job,)).fetchone()
        try:
            return StoredSweep.unpack(row[0]) if row else None
        except DAMAGE:
            return None

    def append(self, job: int, number: int, cases: CaseBlock) -> None:
        """Add the block of cases with this number, whole but for the last one."""
        with self._database.writing() as database:
            row = (job, number, cases.keys, cases.requests, cases.custom_ids)
            database.execute("INSERT INTO slices VALUES (?, ?, ?, ?, ?)", row)
            database.execute("INSERT INTO states VALUES (?, ?, ?)", (job, number, bytes(cases.count)))

    def accept(self, job: int, total: int, idempotency: Idempotency | None, charge: Charge | None = None) -> JobState:
        """Make the job known: from here on it will be finished.

        Raises
        ------
        JobsTooLargeError
            If the unfinished jobs of its owner would take more room than they may.
        """
        with self._database.writing() as database:
            self._make_room(database, job, total)
            if idempotency is not None:
                statement = "INSERT INTO idempotency SELECT owner, ?, ?, number FROM jobs WHERE number = ?"
                database.execute(statement, (idempotency.token, idempotency.whole_digest, job))
            changes = "status = 'accepted', total = ?, revision = 1, created = ?, charge = ?"
            text = None if charge is None else orjson.dumps(list(charge)).decode()
            state = self._changed(database, job, changes, (total, self._clock.now(), text))
            return state if total else self._end(database, job, "successful", None)

    def discard(self, job: int) -> None:
        """Remove the job and all that belongs to it."""
        with self._database.writing() as database:
            database.execute("DELETE FROM jobs WHERE number = ?", (job,))

    def begin(self, job: int) -> JobState:
        """Note that the job is being worked on."""
        with self._database.writing() as database:
            changes = "status = 'running', started = coalesce(started, ?), revision = revision + 1"
            return self._changed(database, job, changes, (self._clock.now(),))

    def mark(
        self, job: int, states: Mapping[int, CaseState], problems: Mapping[int, dict[str, Any]] | None = None
    ) -> JobState:
        """Note results of cases, by their number; the job ends with the last of them."""
        counts = dict.fromkeys(CaseState, 0)
        with self._database.writing() as database:
            for number, cases in itertools.groupby(sorted(states), key=lambda case: case // BLOCK_SIZE):
                place = (job, number)
                found = database.execute("SELECT states FROM states WHERE job = ? AND slice = ?", place).fetchone()
                if found is None:
                    raise JobGoneError("the job has been deleted")
                stored = bytearray(found[0])
                for case in cases:
                    if case % BLOCK_SIZE >= len(stored):
                        raise DamagedCasesError(case, case)
                    if stored[case % BLOCK_SIZE] == CaseState.WAITING:
                        stored[case % BLOCK_SIZE] = states[case]
                        counts[states[case]] += 1
                database.execute("INSERT OR REPLACE INTO states VALUES (?, ?, ?)", (*place, stored))
            rows = [(job, case, orjson.dumps(problem).decode()) for case, problem in (problems or {}).items()]
            database.executemany("INSERT OR IGNORE INTO problems VALUES (?, ?, ?)", rows)
            changes = "done = done + ?, cached = cached + ?, failed = failed + ?, revision = revision + 1"
            added = (sum(counts.values()), counts[CaseState.CACHED], counts[CaseState.FAILED])
            state = self._changed(database, job, changes, added)
            finished = state.done == state.total and not state.final
            return self._end(database, job, "successful", None) if finished else state

    def report(self, job: int, progress: dict[str, Any], partial: dict[str, Any] | None = None) -> JobState:
        """Note how far a study is; without another partial answer, that of before stays."""
        values = (orjson.dumps(progress).decode(), None if partial is None else orjson.dumps(partial).decode())
        with self._database.writing() as database:
            changes = "progress = ?, partial = coalesce(?, partial), revision = revision + 1"
            return self._changed(database, job, changes, values)

    def rename(self, job: int, title: str) -> JobState:
        """Give the job another title."""
        with self._database.writing() as database:
            return self._changed(database, job, "title = ?", (title,))

    def partial(self, job: int) -> dict[str, Any] | None:
        """Return the latest partial answer of a study, if there is one."""
        with self._database.reading() as database:
            row = database.execute("SELECT partial FROM jobs WHERE number = ?", (job,)).fetchone()
        try:
            return orjson.loads(row[0]) if row and row[0] else None
        except DAMAGE:  # the next one replaces it
            return None

    def end(self, job: int, status: Status, problem: dict[str, Any] | None = None) -> JobState:
        """End the job as it is; one that has ended stays as it was."""
        with self._database.writing() as database:
            return self._end(database, job, status, problem)

    def token(self, owner: str, token: str) -> tuple[str, JobState] | None:
        """Digest and job of an idempotency key."""
        with self._database.reading() as database:
            statement = "SELECT digest, job FROM idempotency WHERE owner = ? AND token = ?"
            row = database.execute(statement, (owner, token)).fetchone()
        found = self._jobs("number = ?", row[1]) if row else []
        return (row[0], found[0]) if found else None

    def job(self, name: str) -> JobState | None:
        """Job with this id."""
        found = self._jobs("id = ? AND status != 'accepting'", name)
        return found[0] if found else None

    def jobs(self, owner: str | None, *, before: int = 0, limit: int | None = None) -> list[JobState]:
        """Jobs of this owner, of all if it is None, the newest first.

        Parameters
        ----------
        before
            Number of a job, there or removed, that the jobs came before; 0 for the newest.
        limit
            How many at most; None for all.
        """
        condition = "number < ? AND status != 'accepting' ORDER BY number DESC LIMIT ?"
        values = (before or LARGEST, -1 if limit is None else limit)
        if owner is None:
            return self._jobs(condition, *values)
        return self._jobs(f"owner = ? AND {condition}", owner, *values)

    def tally(self, others: Collection[str] = ()) -> Counter[Status]:
        """Return how many jobs there are by status, but for those with these ids."""
        statement = (
            "SELECT status, count(*) FROM jobs WHERE status != 'accepting' "
            "AND id NOT IN (SELECT value FROM json_each(?)) GROUP BY status"
        )
        with self._database.reading() as database:
            found = database.execute(statement, (orjson.dumps(list(others)).decode(),)).fetchall()
        counts: Counter[Status] = Counter()
        for status, count in found:
            counts[status if status in STATUSES else "damaged"] += count
        return counts

    def unfinished(self) -> list[JobState]:
        """Jobs to go on with, in order of arrival."""
        return self._jobs("status IN ('accepted', 'running') ORDER BY number")

    def waiting(self, job: JobState, first: int, count: int) -> list[CaseRow]:
        """Return the cases in these blocks that have no result yet.

        Raises
        ------
        DamagedCasesError
            If a block cannot be read.
        """
        end = min(job.total, (first + count) * BLOCK_SIZE)
        blocks = self._blocks(job.number, range(first, -(-end // BLOCK_SIZE)))
        return [
            row
            for number, stored in blocks.items()
            for row in read_block(number, min(BLOCK_SIZE, end - number * BLOCK_SIZE), stored)
            if row.state == CaseState.WAITING
        ]

    def rows(self, job: JobState, start: int, limit: int) -> list[CaseRow]:
        """Return up to so many cases in order; those that cannot be read have a problem."""
        total = self._cases_in(job.number) if job.status == "damaged" else job.total
        end = min(start + limit, total)
        rows: list[CaseRow] = []
        for number, stored in self._blocks(job.number, range(start // BLOCK_SIZE, -(-end // BLOCK_SIZE))).items():
            first, last = number * BLOCK_SIZE, min((number + 1) * BLOCK_SIZE, total)
            try:
                block = read_block(number, last - first, stored)
            except DamagedCasesError:
                block = [damaged_case(case) for case in range(first, last)]
            rows += block[max(0, start - first) : end - first]
        with self._database.reading() as database:
            statement = "SELECT number, problem FROM problems WHERE job = ? AND number >= ? AND number < ?"
            problems = dict(database.execute(statement, (job.number, start, end)))
        return [
            row._replace(problem=read_problem(row.number, problems[row.number])) if row.number in problems else row
            for row in rows
        ]

    def requests(self, job: int, cases: Collection[int]) -> dict[int, bytes]:
        """Canonical requests of these cases, as JSON.

        Raises
        ------
        DamagedCasesError
            If what is stored of a block of them cannot be read.
        """
        found: dict[int, bytes] = {}
        with self._database.reading() as database:
            for number, group in itertools.groupby(sorted(cases), key=lambda case: case // BLOCK_SIZE):
                lines = _requests_of(database, job, number)
                found |= {case: lines[case % BLOCK_SIZE] for case in group}
        return found

    def renew_keys(self, job: int) -> None:
        """Make the keys of a job that an earlier engine has accepted anew: its cases are now another's results."""
        operation = self._jobs("number = ?", job)[0].operation
        with self._database.reading() as database:
            numbers = database.execute("SELECT slice FROM slices WHERE job = ?", (job,)).fetchall()
        for (number,) in numbers:
            with self._database.reading() as database:
                requests = _requests_of(database, job, number)
            keys = join_keys(result_key(operation, orjson.loads(line)) for line in requests)
            with self._database.writing() as database:
                database.execute("UPDATE slices SET keys = ? WHERE job = ? AND slice = ?", (keys, job, number))
        with self._database.writing() as database:
            self._changed(database, job, "versions = ?", (VERSIONS,))

    def check(self) -> None:
        """See that jobs would be stored where the next start looks for them."""
        self._database.check()

    @property
    def was_missing(self) -> bool:
        """Whether the file of the jobs was missing or empty when it was first needed."""
        return self._database.was_missing

    def checkpoint(self) -> None:
        """Move what stands in the log of the database into the file itself."""
        self._database.checkpoint()

    def close(self) -> None:
        """Let go of the file."""
        self._database.close()

    def _make_room(self, database: sqlite3.Connection, job: int, total: int) -> None:
        """Note the size of a new job, and remove what its owner has no room for any more."""
        [(owner, size)] = database.execute(
            f"UPDATE jobs SET bytes = {JOB_BYTES} + (SELECT coalesce(sum(length(keys) + length(requests) "  # noqa: S608 (of this file)
            "+ coalesce(length(custom_ids), 0)), 0) FROM slices WHERE job = ?) WHERE number = ? RETURNING owner, bytes",
            (job, job),
        ).fetchall()
        most = size + PROBLEM_BYTES * total
        if owner in self._most_taken and self._most_taken[owner] + most <= self._owner_bytes:
            self._most_taken[owner] += most
            return
        beyond = database.execute(BEYOND, (job, self._owner_bytes)).fetchall()
        if not all(ended for _, ended in beyond):
            raise JobsTooLargeError(self._owner_bytes)
        database.executemany("DELETE FROM jobs WHERE number = ?", [(number,) for number, _ in beyond])
        statement = f"SELECT sum({TAKEN} + {PROBLEM_BYTES} * (total - done)) FROM jobs WHERE owner = ?"  # noqa: S608
        self._most_taken[owner] = database.execute(statement, (owner,)).fetchone()[0] + PROBLEM_BYTES * total

    def _end(self, database: sqlite3.Connection, job: int, status: Status, problem: dict[str, Any] | None) -> JobState:
        now = self._clock.now()
        text = None if problem is None else orjson.dumps(problem).decode()
        values = (status, now, now + self._kept_seconds, text)
        changes = "status = ?, finished = ?, expires = ?, problem = ?, revision = revision + 1"
        return self._changed(database, job, changes, values, "AND status IN ('accepted', 'running')")

    def _changed(
        self, database: sqlite3.Connection, job: int, changes: str, values: tuple[object, ...], condition: str = ""
    ) -> JobState:
        """Change a job; return it as it is then."""
        database.execute(f"UPDATE jobs SET {changes} WHERE number = ? {condition}", (*values, job))  # noqa: S608 (of this file)
        row = database.execute(f"{SELECT} WHERE number = ?", (job,)).fetchone()
        if row is None:
            raise JobGoneError("the job has been deleted")
        return read_job(row, self._operations)

    def _jobs(self, condition: str, *values: object) -> list[JobState]:
        with self._database.reading() as database:
            return [read_job(row, self._operations) for row in database.execute(f"{SELECT} WHERE {condition}", values)]

    def _blocks(self, job: int, numbers: range) -> dict[int, tuple[Any, ...] | None]:
        """Return rows of `BLOCK_COLUMNS` of these blocks; None for one that is not there."""
        statement = (
            f"SELECT slice, {BLOCK_COLUMNS} FROM slices JOIN states USING (job, slice) "  # noqa: S608 (of the package)
            "WHERE job = ? AND slice >= ? AND slice < ?"
        )
        with self._database.reading() as database:
            found = {row[0]: row[1:] for row in database.execute(statement, (job, numbers.start, numbers.stop))}
        return {number: found.get(number) for number in numbers}

    def _cases_in(self, job: int) -> int:
        """Return how many cases a job has by its blocks."""
        statement = (
            f"SELECT coalesce(max(slice * {BLOCK_SIZE} + length(keys) / {KEY_BYTES}), 0) FROM slices WHERE job = ?"  # noqa: S608
        )
        with self._database.reading() as database:
            count: int = database.execute(statement, (job,)).fetchone()[0]
        return count


def _requests_of(database: sqlite3.Connection, job: int, number: int) -> tuple[bytes, ...]:
    """Canonical requests of a block."""
    statement = "SELECT requests, length(keys) FROM slices WHERE job = ? AND slice = ?"
    stored, length = database.execute(statement, (job, number)).fetchone() or (b"", BLOCK_SIZE * KEY_BYTES)
    count = length // KEY_BYTES
    try:
        lines = split_requests(stored)
        if len(lines) == count:
            return lines
    except DAMAGE:
        pass
    raise DamagedCasesError(number * BLOCK_SIZE, number * BLOCK_SIZE + count - 1)
