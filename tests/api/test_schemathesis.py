"""Schemathesis asks a live service whatever its contract allows, and much that it does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.system
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    ("paths", "count", "seconds"),
    [("--exclude-path-regex", 17, 35), ("--include-path-regex", 3, 20)],
    ids=["others", "calibrations"],
)
def test_service_keeps_its_contract_whatever_it_is_asked(
    hurried_url: str, tmp_path: Path, paths: str, count: int, seconds: int
) -> None:
    # The fits apart: each takes as long as twenty other queries, and would leave these no time.
    command = [str(Path(sys.executable).with_name("schemathesis")), "run", f"{hurried_url}/openapi.json"]
    command += ["--max-time", str(seconds), "--max-examples", "50", "--workers", "2", "--generation-deterministic"]
    # A request may fit the schema and still be of no use: a nose longer than its body is refused with a 422.
    command += ["--checks", "all", "--exclude-checks", "positive_data_acceptance"]
    command += ["--continue-on-failure", "--no-color", paths, "^/calibration/"]
    environment = os.environ | {"NO_PROXY": "*"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"Tested: {count}" in done.stdout, done.stdout
