"""A Python client made by openapi-python-client from the live contract, and used as its users would."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CLIENT = Path(__file__).parents[1] / "clients" / "python"
PARTS = [
    "find_one_angle",
    "compute_some_motions",
    "find_some_at_once",
    "calibrate",
    "follow_a_job",
    "cancel_a_job",
    "get_problems",
    "ask_how_it_is",
]


@pytest.fixture(scope="module")
def generated(live_url: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a package `ricochet_client`; its formatter is the ruff beside the Python that runs the tests."""
    folder = tmp_path_factory.mktemp("generated")
    scripts = Path(sys.executable).parent
    command = [str(scripts / "openapi-python-client"), "generate", "--url", f"{live_url}/openapi.json"]
    command += ["--output-path", "ricochet_client", "--meta", "none", "--fail-on-warning"]
    command += ["--config", str(CLIENT / "config.yml")]
    environment = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}", "NO_PROXY": "*"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_generated_client_asks_follows_reads_and_cancels(generated: Path, live_url: str) -> None:
    command = [sys.executable, "-W", "error", str(CLIENT / "conversation.py"), live_url]
    environment = os.environ | {"NO_PROXY": "*", "PYTHONPATH": str(generated)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, PARTS), done.stdout + done.stderr
