"""Results of a job as Parquet: the values of the CSV table with types and units, in several row groups."""

import csv
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import duckdb
import httpx
import pandas as pd
import pytest
from pyarrow import parquet

from service.api.results import GROUP_ROWS, ParquetTable
from service.cache.record import CaseResult
from service.jobs.models import JobState
from service.schemas.strike import PAPER
from solver import ENGINE_VERSION

from .many import ASYNC, LINES, finished, lines

PARQUET = {"Accept": "application/vnd.apache.parquet"}
STRENGTH, MASS = "target.compressive_strength_pa", "projectile.mass_kg"
SWEEP: dict[str, Any] = {
    "base": PAPER | {"search": {"tolerance_deg": 1.0}},
    "axes": [{"field": STRENGTH, "values": [31e6, 47e6]}, {"field": MASS, "values": [11.0, 13.0]}],
}
SHORT = PAPER | {"projectile": PAPER["projectile"] | {"length_m": 0.05}, "custom_id": "short"}


def written(client: httpx.Client, path: str, body: Any, folder: Path) -> tuple[Path, list[dict[str, str]]]:
    """Run a job; return its results as a Parquet file, and as rows of CSV without the fields of the base case."""
    text = lines(body) if isinstance(body, list) else json.dumps(body)
    headers = ASYNC | (LINES if isinstance(body, list) else {"Content-Type": "application/json"})
    job = finished(client, client.post(path, content=text, headers=headers).raise_for_status().json())
    response = client.get(job["links"]["results"], headers=PARQUET).raise_for_status()
    assert response.headers["Content-Type"] == PARQUET["Accept"]
    assert response.headers["Content-Disposition"] == f'attachment; filename="{job["id"]}.parquet"'
    (folder / "job.parquet").write_bytes(response.content)
    text = client.get(job["links"]["results"], headers={"Accept": "text/csv"}).text
    rows = list(csv.DictReader(text.splitlines()))
    return folder / "job.parquet", [{name: row[name] for name in row if not in_base(name)} for row in rows]


def in_base(name: str) -> bool:
    """Return whether a column has a field of the base case of a sweep, which a Parquet file has in its metadata."""
    return "." in name and name not in (STRENGTH, MASS)


def as_text(value: Any) -> str:
    """Return a value as text as in CSV, where missing values are empty."""
    return "" if pd.isna(value) else str(value)


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/cra/sweep", SWEEP),
        ("/cra/batch", [SHORT, PAPER]),
        ("/trajectory/batch", {"cases": [PAPER | {"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 30.0}}]}),
    ],
)
def test_pandas_and_duckdb_read_the_values_of_the_csv_table(
    client: httpx.Client, tmp_path: Path, path: str, body: Any
) -> None:
    file, rows = written(client, path, body, tmp_path)
    frame = pd.read_parquet(file)
    assert [{name: as_text(value) for name, value in row.items()} for row in frame.to_dict("records")] == rows
    found = duckdb.read_parquet(str(file))
    assert [dict(zip(found.columns, map(as_text, row), strict=True)) for row in found.fetchall()] == rows
    types = dict(zip(found.columns, map(str, found.types), strict=True))
    assert (types["index"], types["key"], types["strength_factor"]) == ("BIGINT", "VARCHAR", "DOUBLE")


def test_columns_have_their_units_and_the_file_its_base_and_engine(client: httpx.Client, tmp_path: Path) -> None:
    file, _ = written(client, "/cra/sweep", SWEEP, tmp_path)
    schema = parquet.read_schema(file)
    units = {name: schema.field(name).metadata[b"unit"] for name in schema.names}
    assert (units[STRENGTH], units[MASS], units["critical_angle_deg"], units["status"]) == (b"Pa", b"kg", b"deg", b"")
    assert b"smallest oblique angle" in schema.field("critical_angle_deg").metadata[b"description"]
    metadata = {name.decode(): text.decode() for name, text in schema.metadata.items()}
    assert json.loads(metadata["base"]) == SWEEP["base"]
    assert json.loads(metadata["axes"]) == [STRENGTH, MASS]
    assert (metadata["operation"], metadata["engine_version"]) == ("cra", ENGINE_VERSION)


def test_failed_case_has_its_problem_and_no_numbers(client: httpx.Client, tmp_path: Path) -> None:
    file, _ = written(client, "/cra/batch", [SHORT, PAPER], tmp_path)
    bad, good = duckdb.read_parquet(str(file)).select("custom_id", "problem", "critical_angle_deg").fetchall()
    assert bad == ("short", "urn:ricochet:problem:invalid-request", None)
    assert good[:2] == (None, None)
    assert good[2] == pytest.approx(48.64, abs=0.1)


def test_large_job_is_written_a_row_group_at_a_time(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    total = 2 * GROUP_ROWS + 100
    job = JobState(
        "a",
        "cra",
        "successful",
        total,
        total,
        0,
        total,
        now,
        now,
        now,
        None,
        None,
        1,
        number=1,
        owner="",
        versions="7 1",
    )
    table, sizes = ParquetTable(tmp_path / "job.parquet", job, None), []
    for start in range(0, total, 100):
        numbers = range(start, min(start + 100, total))
        table.write([CaseResult(number, None, None, {"type": "urn:x"}, cached=False) for number in numbers])
        sizes.append((tmp_path / "job.parquet").stat().st_size)
    table.close()
    assert len(set(sizes)) >= 3
    with parquet.ParquetFile(tmp_path / "job.parquet") as file:
        groups = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
        assert file.read(["index"])["index"].to_pylist() == list(range(total))
    assert sum(groups) == total
    assert max(groups) < GROUP_ROWS + 100
