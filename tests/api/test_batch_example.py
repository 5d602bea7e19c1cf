"""The example script that computes a sweep runs against a service."""

import os
import re
import subprocess
import sys
from pathlib import Path

from tests.conftest import free_port

EXAMPLE = Path(__file__).parents[2] / "examples" / "batch.py"


def run(address: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(EXAMPLE), address]
    environment = os.environ | {"NO_PROXY": "*"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)


def test_example_follows_its_job_and_prints_a_table(live_url: str) -> None:
    done = run(live_url)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "successful: 20 of 20" in done.stdout
    rows = re.findall(r"^ *(\d+) m/s((?: +\d\d\.\d\d){4})$", done.stdout, re.MULTILINE)
    assert [velocity for velocity, _ in rows] == ["240", "280", "320", "360", "400"]
    for _, angles in rows:
        weak, *_, strong = map(float, angles.split())
        assert 40.0 < strong < weak < 75.0


def test_example_says_that_there_is_no_service() -> None:
    done = run(f"http://127.0.0.1:{free_port()}")
    assert done.returncode == 1
    assert "make serve" in done.stderr
    assert "Traceback" not in done.stderr
