"""Schemathesis asks a live service whatever its contract allows, and much that it does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SECONDS = 35
"""Of which some 20 go to examples, edge cases and fuzzing; chains of requests take the rest."""


@pytest.mark.timeout(180)
def test_service_keeps_its_contract_whatever_it_is_asked(hurried_url: str, tmp_path: Path) -> None:
    command = [str(Path(sys.executable).with_name("schemathesis")), "run", f"{hurried_url}/openapi.json"]
    command += ["--max-time", str(SECONDS), "--max-examples", "50", "--workers", "2", "--generation-deterministic"]
    # A request may fit the schema and still be of no use: a nose longer than its body is refused with a 422.
    command += ["--checks", "all", "--exclude-checks", "positive_data_acceptance"]
    command += ["--continue-on-failure", "--no-color"]
    environment = os.environ | {"NO_PROXY": "*"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Tested: 17" in done.stdout, done.stdout
