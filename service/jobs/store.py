"""Durable store of jobs. An accepted job survives crashes and restarts.

    jobs.sqlite   jobs, requests for sweeps, cases in blocks (table `slices`), states of cases, progress of studies

A job has the status `accepting`, and is invisible, until all its cases are stored.
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
    BLOCK_COLUMNS,
    BLOCK_SIZE,
    COLUMNS,
    DAMAGE,
    KEY_BYTES,
    CaseBlock,
    CaseRow,
    CaseState,
    Charge,
    Idempotency,
    JobState,
    Status,
    StoredSweep,
    damaged_case,
    join_keys,
    read_block,
    read_job,
    read_problem,
    split_requests,
    title_of,
)
from service.operations import OPERATIONS, SCHEMA_VERSION, result_key
from solver import ENGINE_VERSION

DAY = 86_400.0  # [s]
VERSIONS = f"{ENGINE_VERSION} {SCHEMA_VERSION}"
"""Versions of solver and contract that are hashed into the keys of new jobs."""
OWNER_BYTES = 2**30
"""Default limit on the disk space for the jobs of one owner [bytes]. It holds ten to twenty million cases."""
JOB_BYTES = 10_000
"""Size charged for a job in addition to its cases [bytes]. It is more than a job takes, so an owner has at most some
100,000 jobs."""
CASE_BYTES, PROBLEM_BYTES = 100, 300
"""Approximate sizes of a stored case, used for jobs whose size was not recorded, and of a stored problem [bytes]."""
TAKEN = f"coalesce(bytes, {JOB_BYTES} + {CASE_BYTES} * total) + {PROBLEM_BYTES} * failed"
"""SQL expression for the disk space of a job. [bytes]"""
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
"""SQL query for the jobs of an owner that do not fit into the disk limit, and whether they have ended. Its parameters
are the number of a job of the owner and the limit. Unfinished jobs are counted first, then the others from the most
recently ended one on."""
STATUSES = frozenset(get_args(Status))
LARGEST = 2**63 - 1
"""Largest integer that SQLite can store."""
SELECT = f"SELECT {COLUMNS} FROM jobs LEFT JOIN sweeps ON sweeps.job = jobs.number"  # noqa: S608 (of the package)


class JobStore:
    """Store of jobs. All methods are thread-safe, wait for the disk, and raise `StorageError` if it fails.

    Parameters
    ----------
    folder
        Data folder of the service.
    job_days
        Time for which a job is kept after its end. [days]
    owner_bytes
        Disk space for the jobs of one owner. The jobs that ended first are removed to make room for a new job. [bytes]
    check_folder
        Function called before each transaction that writes; raises StorageError if the folder must not be written to.
    operations
        Names of the operations that jobs can have.
    clock
        Clock for the dates of jobs.
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
        """Upper bounds on the disk space of each owner's jobs [bytes]. Exact sizes are summed only at an owner's first
        job and when the bound exceeds the limit."""

    def expire(self, *, at_start: bool = False) -> int:
        """Remove expired jobs and, at the start, jobs that were never accepted; return the number of jobs removed."""
        with self._database.writing() as database:
            removed = database.execute("DELETE FROM jobs WHERE expires < ?", (self._clock.now(),)).rowcount
            if at_start:
                removed += database.execute("DELETE FROM jobs WHERE status = 'accepting'").rowcount
        return removed

    def create(
        self, operation: str, owner: str, sweep: StoredSweep | None = None, *, traceparent: str | None = None
    ) -> int:
        """Create a job, which is invisible until `accept` is called, and return its number."""
        columns = "id, owner, operation, versions, status, created, title, traceparent"
        title = None if sweep is None else title_of(sweep)
        # The id is random, so that a client cannot guess the job of another.
        row = (secrets.token_hex(16), owner, operation, VERSIONS, "accepting", self._clock.now(), title, traceparent)
        with self._database.writing() as database:
            statement = f"INSERT INTO jobs ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"  # noqa: S608 (of this file)
            number = database.execute(statement, row).lastrowid or 0
            if sweep is not None:
                database.execute("INSERT INTO sweeps VALUES (?, ?)", (number, sweep.pack()))
            return number

    def sweep(self, job: int) -> StoredSweep | None:
        """Return the request for a sweep; None for other jobs, and for a damaged sweep (its job is `damaged`)."""
        with self._database.reading() as database:
            row = database.execute("SELECT sweep FROM sweeps WHERE job = ?", (job,)).fetchone()
        try:
            return StoredSweep.unpack(row[0]) if row else None
        except DAMAGE:
            return None

    def append(self, job: int, number: int, cases: CaseBlock) -> None:
        """Add a block of cases. All blocks but the last one must be full."""
        with self._database.writing() as database:
            row = (job, number, cases.keys, cases.requests, cases.custom_ids)
            database.execute("INSERT INTO slices VALUES (?, ?, ?, ?, ?)", row)
            database.execute("INSERT INTO states VALUES (?, ?, ?)", (job, number, bytes(cases.count)))

    def accept(self, job: int, total: int, idempotency: Idempotency | None, charge: Charge | None = None) -> JobState:
        """Make a job visible. From here on it will be finished, even after a crash.

        Raises
        ------
        JobsTooLargeError
            If the unfinished jobs of its owner would exceed their disk space.
        """
        with self._database.writing() as database:
            # Older jobs are removed in the same transaction, so that none is removed for a job that is refused.
            self._make_room(database, job, total)
            if idempotency is not None:
                statement = "INSERT INTO idempotency SELECT owner, ?, ?, number FROM jobs WHERE number = ?"
                database.execute(statement, (idempotency.token, idempotency.whole_digest, job))
            changes = "status = 'accepted', total = ?, revision = 1, created = ?, charge = ?"
            text = None if charge is None else orjson.dumps(list(charge)).decode()
            state = self._changed(database, job, changes, (total, self._clock.now(), text))
            return state if total else self._end(database, job, "successful", None)

    def discard(self, job: int) -> None:
        """Remove a job with its cases, problems and idempotency key."""
        with self._database.writing() as database:
            database.execute("DELETE FROM jobs WHERE number = ?", (job,))

    def begin(self, job: int) -> JobState:
        """Mark a job as running, and return its new state."""
        with self._database.writing() as database:
            changes = "status = 'running', started = coalesce(started, ?), revision = revision + 1"
            return self._changed(database, job, changes, (self._clock.now(),))

    def mark(
        self, job: int, states: Mapping[int, CaseState], problems: Mapping[int, dict[str, Any]] | None = None
    ) -> JobState:
        """Mark cases as finished, by number. The job ends when its last case is marked."""
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
                    # After a crash or a retry a case may be marked twice, and must be counted once.
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
        """Set the progress of a study, and its partial answer unless that is None."""
        values = (orjson.dumps(progress).decode(), None if partial is None else orjson.dumps(partial).decode())
        with self._database.writing() as database:
            changes = "progress = ?, partial = coalesce(?, partial), revision = revision + 1"
            return self._changed(database, job, changes, values)

    def rename(self, job: int, title: str) -> JobState:
        """Change the title of a job, and return its new state."""
        with self._database.writing() as database:
            return self._changed(database, job, "title = ?", (title,))

    def partial(self, job: int) -> dict[str, Any] | None:
        """Return the latest partial answer of a study, if there is one."""
        with self._database.reading() as database:
            row = database.execute("SELECT partial FROM jobs WHERE number = ?", (job,)).fetchone()
        try:
            return orjson.loads(row[0]) if row and row[0] else None
        except DAMAGE:  # The next partial answer replaces the damaged one.
            return None

    def end(self, job: int, status: Status, problem: dict[str, Any] | None = None) -> JobState:
        """Set the final status of a job, unless it has already ended."""
        with self._database.writing() as database:
            return self._end(database, job, status, problem)

    def token(self, owner: str, token: str) -> tuple[str, JobState] | None:
        """Return the digest and the job of an idempotency key, or None."""
        with self._database.reading() as database:
            statement = "SELECT digest, job FROM idempotency WHERE owner = ? AND token = ?"
            row = database.execute(statement, (owner, token)).fetchone()
        found = self._jobs("number = ?", row[1]) if row else []
        return (row[0], found[0]) if found else None

    def job(self, name: str) -> JobState | None:
        """Return the job with this id, or None."""
        found = self._jobs("id = ? AND status != 'accepting'", name)
        return found[0] if found else None

    def jobs(self, owner: str | None, *, before: int = 0, limit: int | None = None) -> list[JobState]:
        """Return the jobs of an owner, or of all owners if it is None, the newest first.

        Parameters
        ----------
        before
            Number of a job, which may have been removed; only older ones are returned. 0 begins with the newest.
        limit
            Largest number of jobs; None for all.
        """
        # A page begins below a number rather than at an offset, so that new and removed jobs do not shift the pages.
        condition = "number < ? AND status != 'accepting' ORDER BY number DESC LIMIT ?"
        values = (before or LARGEST, -1 if limit is None else limit)
        if owner is None:
            return self._jobs(condition, *values)
        return self._jobs(f"owner = ? AND {condition}", owner, *values)

    def tally(self, others: Collection[str] = ()) -> Counter[Status]:
        """Return the numbers of jobs by status, without the jobs whose ids are in `others`."""
        statement = (
            "SELECT status, count(*) FROM jobs WHERE status != 'accepting' "
            "AND id NOT IN (SELECT value FROM json_each(?)) GROUP BY status"
        )
        with self._database.reading() as database:
            found = database.execute(statement, (orjson.dumps(list(others)).decode(),)).fetchall()
        counts: Counter[Status] = Counter()
        for status, count in found:
            # A status that this version does not know is shown as `damaged`, as in `read_job`.
            counts[status if status in STATUSES else "damaged"] += count
        return counts

    def unfinished(self) -> list[JobState]:
        """Return the unfinished jobs in the order of arrival."""
        return self._jobs("status IN ('accepted', 'running') ORDER BY number")

    def waiting(self, job: JobState, first: int, count: int) -> list[CaseRow]:
        """Return the unfinished cases in `count` blocks, from block `first` on.

        Raises
        ------
        DamagedCasesError
            If a block is damaged.
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
        """Return up to `limit` cases in order, from case `start` on. Damaged cases have a problem."""
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
        """Return the canonical requests of the given cases as JSON.

        Raises
        ------
        DamagedCasesError
            If a block that contains one of them is damaged.
        """
        found: dict[int, bytes] = {}
        with self._database.reading() as database:
            for number, group in itertools.groupby(sorted(cases), key=lambda case: case // BLOCK_SIZE):
                lines = _requests_of(database, job, number)
                found |= {case: lines[case % BLOCK_SIZE] for case in group}
        return found

    def renew_keys(self, job: int) -> None:
        """Replace the keys of a job that an earlier version accepted with keys of the current versions."""
        operation = self._jobs("number = ?", job)[0].operation
        with self._database.reading() as database:
            numbers = database.execute("SELECT slice FROM slices WHERE job = ?", (job,)).fetchall()
        # Each block has its own transaction, so that other jobs are not held up. If the service crashes in between, the
        # job still has its earlier versions, and all its keys are replaced after the restart.
        for (number,) in numbers:
            with self._database.reading() as database:
                requests = _requests_of(database, job, number)
            keys = join_keys(result_key(operation, orjson.loads(line)) for line in requests)
            with self._database.writing() as database:
                database.execute("UPDATE slices SET keys = ? WHERE job = ? AND slice = ?", (keys, job, number))
        with self._database.writing() as database:
            self._changed(database, job, "versions = ?", (VERSIONS,))

    def check(self) -> None:
        """Check that the open file is still the one at its path; see `Database.check`."""
        self._database.check()

    @property
    def was_missing(self) -> bool:
        """True if the file of the jobs was missing, empty or damaged when it was first opened."""
        return self._database.was_missing

    def checkpoint(self) -> None:
        """Move the write-ahead log into the file."""
        self._database.checkpoint()

    def close(self) -> None:
        """Move the write-ahead log into the file, and close the file. The next use opens it again."""
        self._database.close()

    def _make_room(self, database: sqlite3.Connection, job: int, total: int) -> None:
        """Record the size of a new job, and remove the ended jobs for which its owner has no more space."""
        [(owner, size)] = database.execute(
            f"UPDATE jobs SET bytes = {JOB_BYTES} + (SELECT coalesce(sum(length(keys) + length(requests) "  # noqa: S608 (of this file)
            "+ coalesce(length(custom_ids), 0)), 0) FROM slices WHERE job = ?) WHERE number = ? RETURNING owner, bytes",
            (job, job),
        ).fetchall()
        # Each case may still fail and have a problem stored, so the space for it is counted in advance.
        most = size + PROBLEM_BYTES * total
        # The exact sum takes time proportional to the number of jobs. It is computed only if the upper bound, which
        # includes jobs that have been removed since, exceeds the limit.
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
        # The expiry counts from the end of a job, because the job itself may take long.
        values = (status, now, now + self._kept_seconds, text)
        changes = "status = ?, finished = ?, expires = ?, problem = ?, revision = revision + 1"
        return self._changed(database, job, changes, values, "AND status IN ('accepted', 'running')")

    def _changed(
        self, database: sqlite3.Connection, job: int, changes: str, values: tuple[object, ...], condition: str = ""
    ) -> JobState:
        """Update a job, and return its new state."""
        database.execute(f"UPDATE jobs SET {changes} WHERE number = ? {condition}", (*values, job))  # noqa: S608 (of this file)
        row = database.execute(f"{SELECT} WHERE number = ?", (job,)).fetchone()
        if row is None:
            raise JobGoneError("the job has been deleted")
        return read_job(row, self._operations)

    def _jobs(self, condition: str, *values: object) -> list[JobState]:
        with self._database.reading() as database:
            return [read_job(row, self._operations) for row in database.execute(f"{SELECT} WHERE {condition}", values)]

    def _blocks(self, job: int, numbers: range) -> dict[int, tuple[Any, ...] | None]:
        """Return the values of `BLOCK_COLUMNS` of the given blocks, with None for missing blocks."""
        statement = (
            f"SELECT slice, {BLOCK_COLUMNS} FROM slices JOIN states USING (job, slice) "  # noqa: S608 (of the package)
            "WHERE job = ? AND slice >= ? AND slice < ?"
        )
        with self._database.reading() as database:
            found = {row[0]: row[1:] for row in database.execute(statement, (job, numbers.start, numbers.stop))}
        return {number: found.get(number) for number in numbers}

    def _cases_in(self, job: int) -> int:
        """Return the number of cases of a job from its blocks, since the number in a damaged row may be wrong."""
        statement = (
            f"SELECT coalesce(max(slice * {BLOCK_SIZE} + length(keys) / {KEY_BYTES}), 0) FROM slices WHERE job = ?"  # noqa: S608
        )
        with self._database.reading() as database:
            count: int = database.execute(statement, (job,)).fetchone()[0]
        return count


def _requests_of(database: sqlite3.Connection, job: int, number: int) -> tuple[bytes, ...]:
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
