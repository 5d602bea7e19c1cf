"""A new operation needs only its models and an entry in the table: routes, jobs, tools and command follow from it."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import orjson
import pytest
from fastapi.testclient import TestClient

from service.api.app import create_app
from service.cli import main
from service.cli.local import compute_sweep
from service.operations import OPERATIONS, Many, Operation, ToolText
from service.schemas import CaseModels
from service.schemas.quantities import Num, Part, with_examples
from service.schemas.requests import CriticalAngleBase
from service.schemas.strike import PAPER
from service.settings import Settings
from tests.conftest import until


class EnergyRequest(CriticalAngleBase):
    """Request for the kinetic energy of a strike."""

    model_config = with_examples(PAPER)


class EnergyAnswer(Part):
    """Kinetic energy of a strike."""

    model_config = with_examples({"kinetic_energy_j": 368186.0})

    kinetic_energy_j: Num
    """Kinetic energy at first contact. [J]"""


def compute_energy(request: bytes) -> tuple[dict[str, Any], None]:
    """Return the kinetic energy at first contact."""
    strike = EnergyRequest.model_validate_json(request)
    return {"kinetic_energy_j": 0.5 * strike.projectile.mass_kg * strike.impact.velocity_m_s**2, "warnings": []}, None


MODELS = CaseModels.of(
    "Energy",
    EnergyRequest,
    EnergyAnswer,
    one="energy",
    many="energies",
    verb="compute",
    example=PAPER,
    custom_id="paper",
    axes=[{"field": "impact.velocity_m_s", "values": [100.0, 200.0]}],
    result={"kinetic_energy_j": 368186.0},
)
ENERGY = Operation(
    "energy",
    compute_energy,
    EnergyRequest,
    EnergyAnswer,
    route="compute_energy",
    description="Compute the kinetic energy at first contact.",
    tag="energy",
    many=Many(MODELS, ("compute_energies", "Compute energies"), ("sweep_energies", "Compute the energy")),
    tool=ToolText("energy", "Kinetic energy", "Compute the kinetic energy at first contact."),
)
JOULES = 0.5 * 13.0 * 238.0**2


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[TestClient]:
    """A client of a service with the new operation."""
    monkeypatch.setitem(OPERATIONS, ENERGY.name, ENERGY)
    settings = Settings(data_dir=tmp_path / "data", executor="in-process", workers=1)
    with TestClient(create_app(settings)) as session:
        yield session


def test_new_operation_is_answered_by_every_interface(
    client: TestClient, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    single = client.post("/energy", json=PAPER)
    assert single.json()["kinetic_energy_j"] == pytest.approx(JOULES)
    many = client.post("/energy/batch", json={"cases": [PAPER]}).json()["results"]
    assert many[0]["result"] == single.json()
    axes = [{"field": "impact.velocity_m_s", "values": [238.0]}]
    swept = client.post("/energy/sweep", json={"base": PAPER, "axes": axes}).json()["results"]
    assert swept[0]["result"] == single.json()
    call = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "energy", "arguments": PAPER}}
    headers = {"Accept": "application/json, text/event-stream"}
    told = client.post("/mcp", json=call, headers=headers).json()["result"]["structuredContent"]
    assert told["answer"]["key"] == single.json()["key"]
    case = tmp_path / "case.json"
    case.write_bytes(orjson.dumps(PAPER))
    capfdbinary.readouterr()
    assert main(["energy", str(case)]) == 0
    assert orjson.loads(capfdbinary.readouterr().out) == single.json()
    assert next(compute_sweep("energy", {"base": PAPER, "axes": axes}))["result"] == single.json()
    assert {"/energy", "/energy/batch", "/energy/sweep"} <= client.get("/openapi.json").json()["paths"].keys()


def test_tables_of_a_new_operation_have_the_fields_of_its_answer(client: TestClient) -> None:
    key = client.post("/energy", json=PAPER).json()["key"]
    single = client.get(f"/results/{key}", headers={"Accept": "text/csv"}).text
    assert [float(row["kinetic_energy_j"]) for row in csv.DictReader(single.splitlines())] == [pytest.approx(JOULES)]
    axes = [{"field": "impact.velocity_m_s", "values": [119.0, 238.0]}]
    job = client.post("/energy/sweep", json={"base": PAPER, "axes": axes}, headers={"Prefer": "respond-async"}).json()
    until(lambda: client.get(job["links"]["self"]).json()["status"] not in {"accepted", "running"})
    lines = client.get(job["links"]["results"], headers={"Accept": "text/csv"}).text.splitlines()
    energies = [pytest.approx(JOULES / 4.0), pytest.approx(JOULES)]
    assert [float(row["kinetic_energy_j"]) for row in csv.DictReader(lines)] == energies
    content = client.get(job["links"]["results"], headers={"Accept": "application/x-hdf5"}).content
    with h5py.File(io.BytesIO(content)) as file:
        summary = file["summary"]
        assert summary["kinetic_energy_j"][()].tolist() == energies
        attributes = summary["kinetic_energy_j"].attrs
        assert (attributes["units"], attributes["description"]) == ("J", "kinetic energy at first contact")
