"""Damaged columns of one job: the service starts, and all other jobs can be read."""

import csv
import io
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import orjson
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.api.job_models import Job, JobResults, Jobs
from service.jobs.database import TABLES
from service.schemas.strike import PAPER
from service.settings import Settings

pytestmark = pytest.mark.timeout(180)

BATCH, SWEEP, STUDY = "batch", "sweep", "study"
COUNTS = {BATCH: 230, SWEEP: 6, STUDY: 1}
"""Number of cases of each job; the batch is stored in two slices."""
FAILED = 3
"""Index of the case of the batch that has a problem instead of a result."""
JUNK = b"\xff\x00{junk"
STRIKE = PAPER | {"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 55.0}}
ASYNC = {"Prefer": "respond-async"}


def strike(speed: float) -> dict[str, Any]:
    return STRIKE | {"impact": {"velocity_m_s": speed, "oblique_angle_deg": 55.0}}


@contextmanager
def service_in(folder: Path) -> Iterator[TestClient]:
    """Run a service with this data folder in this process; yield a client."""
    settings = Settings(data_dir=folder, executor="in-process", access="open")
    with TestClient(create_app(settings)) as client:
        yield client


def ended(client: TestClient, name: str) -> dict[str, Any]:
    """Wait until a job has ended; return the job."""
    while True:
        job: dict[str, Any] = client.get(f"/jobs/{name}").raise_for_status().json()
        if job["status"] not in {"accepted", "running"}:
            return job
        time.sleep(0.05)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """Return a folder with a finished batch, sweep and study, and the ids of these jobs."""
    folder = tmp_path_factory.mktemp("whole") / "data"
    with service_in(folder) as client:
        cases = [strike(200.0 + number) | {"custom_id": f"№ {number}"} for number in range(COUNTS[BATCH])]
        sweep = {"base": STRIKE, "axes": [{"field": "impact.velocity_m_s", "start": 200, "stop": 250, "count": 6}]}
        speed = {"type": "normal", "mean": 238.0, "coefficient_of_variation": 0.02}
        uncertain = [{"field": "impact.velocity_m_s", "distribution": speed}]
        study = STRIKE | {"uncertain": uncertain, "sampling": {"max_samples": 256}}
        bodies = {
            BATCH: ("/trajectory/batch", {"cases": cases}),
            SWEEP: ("/trajectory/sweep", sweep),
            STUDY: ("/trajectory/uncertainty", study),
        }
        ids = {}
        for kind, (path, body) in bodies.items():
            answer = client.post(path, json=body, headers=ASYNC)
            assert answer.status_code == 202, answer.text
            ids[kind] = answer.json()["id"]
        for name in ids.values():
            assert ended(client, name)["status"] == "successful"
    with opened(folder) as jobs:
        jobs.execute("UPDATE jobs SET failed = 1 WHERE id = ?", (ids[BATCH],))
        place = "WHERE slice = 0 AND job = (SELECT number FROM jobs WHERE id = ?)"
        states = bytearray(jobs.execute(f"SELECT states FROM states {place}", (ids[BATCH],)).fetchone()[0])  # noqa: S608
        states[FAILED] = 3
        jobs.execute(f"UPDATE states SET states = ? {place}", (states, ids[BATCH]))  # noqa: S608
        problem = {"type": "urn:ricochet:problem:timeout", "title": "t", "status": 422, "detail": "d", "errors": []}
        statement = "INSERT INTO problems SELECT number, ?, ? FROM jobs WHERE id = ?"
        jobs.execute(statement, (FAILED, orjson.dumps(problem).decode(), ids[BATCH]))
    return folder, ids


@contextmanager
def opened(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open the database of jobs; changes are committed at the end of the block."""
    with closing(sqlite3.connect(folder / "jobs.sqlite")) as database, database:
        yield database


def columns() -> list[tuple[str, str, str]]:
    """Return the table, column and job of each case of damage: every column except `number`, `job` and `slice`."""
    with closing(sqlite3.connect(":memory:")) as database:
        database.executescript(TABLES)
        found = []
        for table, jobs in {
            "jobs": (BATCH, SWEEP, STUDY),
            "sweeps": (SWEEP,),
            "slices": (BATCH, STUDY),
            "states": (BATCH, STUDY),
            "problems": (BATCH,),
        }.items():
            names = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            found += [(table, name, job) for name in names if name not in {"number", "job", "slice"} for job in jobs]
    return found


HARMLESS = {"bytes", "partial", "owner"}
"""Columns of `jobs` that are not needed to read a job."""


def lines_of(client: TestClient, job: str) -> list[dict[str, Any]]:
    """Return all results of a job; the stream must end without an error."""
    answer = client.get(f"/jobs/{job}/results", headers={"Accept": "application/jsonl"})
    assert answer.status_code == 200, answer.text
    assert answer.text.endswith("\n")
    return [orjson.loads(line) for line in answer.text.splitlines()]


def check_others(client: TestClient, ids: dict[str, str], damaged: str) -> None:
    """Check that the list of jobs and all other jobs can be read."""
    listed = Jobs.model_validate_json(client.get("/jobs").raise_for_status().content)
    assert len(listed.jobs) == 3
    for kind in set(ids) - {damaged}:
        assert client.get(f"/jobs/{ids[kind]}").json()["status"] == "successful"
        assert [line["index"] for line in lines_of(client, ids[kind])] == list(range(COUNTS[kind]))
    assert client.get("/readyz").status_code == 200
    assert client.get("/metrics").status_code == 200
    assert client.post("/trajectory", json=STRIKE).status_code == 200


@pytest.mark.parametrize("junk", [JUNK, "junk", b"", -1], ids=["bytes", "text", "empty", "number"])
@pytest.mark.parametrize(("table", "column", "kind"), columns())
def test_damaged_column_affects_only_its_own_job(
    table: str, column: str, kind: str, junk: object, whole: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    folder, ids = tmp_path / "data", whole[1]
    shutil.copytree(whole[0], folder)
    place = "id = ?" if table == "jobs" else "job = (SELECT number FROM jobs WHERE id = ?)"
    if table in {"slices", "states"}:
        place += " AND slice = 0"
    with opened(folder) as database:
        changed = database.execute(f"UPDATE {table} SET {column} = ? WHERE {place}", (junk, ids[kind])).rowcount  # noqa: S608
    assert changed == 1
    with service_in(folder) as client:
        if (column, junk) == ("expires", -1):  # This is a valid date.
            assert len(client.get("/jobs").json()["jobs"]) == 2
            return
        check_others(client, ids, kind)
        name = ids[kind] if column != "id" else client.get("/jobs").json()["jobs"][2 - list(ids).index(kind)]["id"]
        if column == "id":
            assert client.get(f"/jobs/{ids[kind]}").status_code == 404
            return
        job = Job.model_validate_json(client.get(f"/jobs/{name}").raise_for_status().content)
        if table == "sweeps" or (table == "jobs" and column not in HARMLESS and junk == JUNK):
            assert (job.status, job.problem.type) == ("damaged", "urn:ricochet:problem:damaged")  # type: ignore[union-attr]
        else:
            assert job.status in {"successful", "damaged"}
        lines = lines_of(client, name)
        if (table, column) != ("states", "states"):
            assert [line["index"] for line in lines] == list(range(COUNTS[kind]))
        assert all(("result" in line) != ("problem" in line) for line in lines)
        table_text = client.get(f"/jobs/{name}/results", headers={"Accept": "text/csv"}).raise_for_status().text
        assert len(list(csv.DictReader(io.StringIO(table_text)))) == len(lines)
        file = client.get(f"/jobs/{name}/results", headers={"Accept": "application/x-hdf5"})
        assert file.raise_for_status().content[:4] == b"\x89HDF"
        page = JobResults.model_validate_json(client.get(f"/jobs/{name}/results?limit=1000").content)
        assert len(page.results) == len(lines)
        assert client.delete(f"/jobs/{name}").status_code == 204
        assert len(client.get("/jobs").json()["jobs"]) == 2


def test_case_with_a_wrong_key_is_reported_as_damaged(whole: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    """Two keys of the batch are exchanged, and one bit of a third is flipped: none of them fits its result."""
    folder, ids = tmp_path / "data", whole[1]
    shutil.copytree(whole[0], folder)
    place = "WHERE slice = 0 AND job = (SELECT number FROM jobs WHERE id = ?)"
    with opened(folder) as database:
        [(keys,)] = database.execute(f"SELECT keys FROM slices {place}", (ids[BATCH],)).fetchall()  # noqa: S608
        split = [keys[i : i + 32] for i in range(0, len(keys), 32)]
        split[10], split[20] = split[20], split[10]
        split[30] = bytes([split[30][0] ^ 1]) + split[30][1:]
        database.execute(f"UPDATE slices SET keys = ? {place}", (b"".join(split), ids[BATCH]))  # noqa: S608
    with service_in(folder) as client:
        lines = lines_of(client, ids[BATCH])
        found = client.get(f"/results/{split[30].hex()}")
    problems = {line["index"]: line["problem"]["type"].rpartition(":")[2] for line in lines if "problem" in line}
    assert problems == {FAILED: "timeout", 10: "damaged", 20: "damaged", 30: "damaged"}
    assert [line["custom_id"] for line in lines] == [f"№ {number}" for number in range(COUNTS[BATCH])]
    assert found.status_code == 404, "nothing is kept under a key that is not its own"


def test_key_damaged_before_its_computation_is_reported_as_damaged(
    whole: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    folder, ids = tmp_path / "data", whole[1]
    shutil.copytree(whole[0], folder)
    shutil.rmtree(folder / "results")
    with opened(folder) as database:
        number = database.execute("SELECT number FROM jobs WHERE id = ?", (ids[BATCH],)).fetchone()[0]
        statement = "UPDATE jobs SET status = 'running', done = 0, cached = 0, failed = 0 WHERE number = ?"
        database.execute(statement, (number,))
        database.execute("UPDATE states SET states = zeroblob(length(states)) WHERE job = ?", (number,))
        database.execute("DELETE FROM problems")
        database.execute(
            "UPDATE slices SET keys = CAST(zeroblob(32) || substr(keys, 33) AS BLOB) WHERE job = ?", (number,)
        )
    with service_in(folder) as client:
        job = ended(client, ids[BATCH])
        assert (job["status"], job["counts"]["failed"]) == ("successful", 2)
        lines = lines_of(client, ids[BATCH])
        assert client.get(f"/results/{'0' * 64}").status_code == 404
    assert [line["index"] for line in lines if "problem" in line] == [0, 200]
