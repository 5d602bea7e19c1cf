"""Batches of new cases, and helpers that read the results of jobs."""

import csv
import io
import itertools
import json
import time
from typing import Any

import h5py
import httpx

from service.operations import OPERATIONS
from service.schemas.strike import PAPER, PAPER_AT_45

SPEED = {"field": "impact.velocity_m_s", "distribution": {"type": "normal", "mean": 238.0, "standard_deviation": 2.4}}
"""Scatter of the speed of the paper's strike: 1 %."""
JSONL = "application/jsonl"
LINES = {"Content-Type": JSONL}
ASYNC = {"Prefer": "respond-async"}
TOO_SHORT = PAPER | {"projectile": PAPER["projectile"] | {"length_m": 0.1}}
"""A case that passes validation and is refused by the solver."""
ROUGH = {"lower_deg": 40.0, "upper_deg": 80.0, "tolerance_deg": 1.0}
DEADLINE_S = 60.0

fresh = itertools.count(1)  # 0 would give 240 m/s, which other tests request.


def searches(count: int) -> list[dict[str, Any]]:
    """Return searches for a critical angle that no test has sent before."""
    return [
        PAPER | {"impact": {"velocity_m_s": 240.0 + 1e-4 * number}, "search": ROUGH}
        for number in itertools.islice(fresh, count)
    ]


def strikes(count: int) -> list[dict[str, Any]]:
    """Return strikes for `/trajectory` that no test has sent before."""
    return [
        PAPER_AT_45 | {"impact": {"velocity_m_s": 240.0 + 1e-4 * number, "oblique_angle_deg": 50.0}}
        for number in itertools.islice(fresh, count)
    ]


def slow_strikes(count: int) -> list[dict[str, Any]]:
    """Return new strikes for `/trajectory` that take about 0.2 s each."""
    return [strike | {"numerics": {"method": "panels", "panels": 20_000}} for strike in strikes(count)]


def lines(cases: list[dict[str, Any]]) -> bytes:
    return "".join(json.dumps(case) + "\n" for case in cases).encode()


def items_of(response: httpx.Response) -> list[dict[str, Any]]:
    """Return the items of a JSON or JSON lines answer."""
    assert response.status_code == 200, response.text
    if response.headers["Content-Type"] == JSONL:
        return [json.loads(line) for line in response.text.splitlines()]
    items: list[dict[str, Any]] = response.json()["results"]
    return items


def finished(client: httpx.Client, job: dict[str, Any]) -> dict[str, Any]:
    """Wait until a job has ended; return the job."""
    deadline = time.monotonic() + DEADLINE_S
    while job["status"] in {"accepted", "running"}:
        assert time.monotonic() < deadline, job
        time.sleep(0.05)
        job = client.get(job["links"]["self"]).raise_for_status().json()
    return job


def rows_at(client: httpx.Client, address: str) -> list[dict[str, str]]:
    """Request a URL as CSV; return the rows."""
    answer = client.get(address, headers={"Accept": "text/csv"})
    assert answer.headers["Content-Type"] == "text/csv; charset=utf-8", answer.text
    return list(csv.DictReader(io.StringIO(answer.text, newline="")))


def file_at(client: httpx.Client, address: str) -> h5py.File:
    """Request a URL as HDF5; return the open file."""
    answer = client.get(address, headers={"Accept": "application/x-hdf5"})
    assert answer.headers["Content-Type"] == "application/x-hdf5", answer.text
    return h5py.File(io.BytesIO(answer.content))


def check_results(operation: str, items: list[dict[str, Any]]) -> None:
    """Check the items of a batch answer against the model of the operation in the contract."""
    many = OPERATIONS[operation].many
    assert many is not None
    many.models.results.model_validate({"results": items})
