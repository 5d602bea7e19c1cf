"""Schemathesis sends requests to a running service: some that the contract allows, and some that it does not."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.schemas.strike import PAPER

LONG = "^/calibration/|/uncertainty|^/thickness|^/limit-speed|^/report$"
"""Paths left out of the general run, because each query takes as long as twenty to a thousand others: fits, studies,
walls and the report. All of them but `/report` are tested separately."""
METHODS = {"delete", "get", "head", "patch", "post", "put"}


def with_nulls(contract: dict[str, Any]) -> dict[str, Any]:
    """Return the contract with null allowed in bodies for every optional field, which the service treats as absent.

    Schemas of bodies are separate copies, because answers never contain null.
    """

    def sent(node: Any) -> Any:
        return json.loads(re.sub(r'"(#/components/schemas/[^"]+)"', r'"\1Sent"', json.dumps(node)))

    schemas = contract["components"]["schemas"]
    for name, schema in list(schemas.items()):
        schemas[f"{name}Sent"] = copy = sent(schema)
        fields = copy.get("properties", {})
        for field in fields.keys() - set(copy.get("required", [])):
            fields[field] = {"anyOf": [fields[field], {"type": "null"}]}
    for operation in (each for path in contract["paths"].values() for each in path.values()):
        if isinstance(operation, dict) and "requestBody" in operation:
            operation["requestBody"] = sent(operation["requestBody"])
    return contract


@pytest.mark.system
@pytest.mark.parametrize(
    ("option", "paths", "seconds"),
    [
        ("exclude", LONG, 60),
        ("include", "^/calibration/", 20),
        ("include", "/uncertainty", 90),
        ("include", "^/(thickness|limit-speed)", 60),
        pytest.param("exclude", LONG, 600, marks=pytest.mark.slow),
    ],
    ids=["others", "calibrations", "studies", "walls", "others for long"],
)
@pytest.mark.timeout(900)
def test_service_keeps_its_contract_for_any_request(
    hurried_url: str, tmp_path: Path, option: str, paths: str, seconds: int
) -> None:
    contract = httpx.get(f"{hurried_url}/openapi.json", timeout=60.0, trust_env=False).json()
    (tmp_path / "contract.json").write_text(json.dumps(with_nulls(contract)), encoding="utf-8")
    command = [str(Path(sys.executable).with_name("schemathesis")), "run", "contract.json", "--url", hurried_url]
    command += ["--max-time", str(seconds), "--max-examples", "50", "--workers", "2", "--generation-deterministic"]
    # A request that fits the schema may still be refused, such as one with a nose longer than its body (422).
    command += ["--checks", "all", "--exclude-checks", "positive_data_acceptance", "--max-response-time", "120"]
    command += ["--continue-on-failure", "--no-color", "--request-timeout", "120", f"--{option}-path-regex", paths]
    if option == "include":  # Links lead to paths that the pattern leaves out, so none is followed.
        command += ["--phases", "examples,coverage,fuzzing"]
    environment = os.environ | {"NO_PROXY": "*"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    chosen = [path for path in contract["paths"] if bool(re.search(paths, path)) == (option == "include")]
    count = sum(len(contract["paths"][path].keys() & METHODS) for path in chosen)
    if "🕛" not in done.stdout:  # This mark means that a phase ran out of time.
        assert f"Tested: {count}" in done.stdout, done.stdout
    assert " passed" in done.stdout, done.stdout
    with httpx.Client(base_url=hurried_url, timeout=60.0, trust_env=False) as client:
        answer = client.post("/cra", json=PAPER)
        assert answer.json()["critical_angle_deg"] == pytest.approx(48.63, abs=0.05)
        # Left running, the jobs would delay the expensive queries of other tests, because cheaper work goes first.
        for job in client.get("/jobs", params={"limit": 1000}).json()["jobs"]:
            client.post(f"/jobs/{job['id']}/cancel")
