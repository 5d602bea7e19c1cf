"""The Python client that `make clients` builds from the contract, used as its users would."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the unpacked wheel of the client."""
    folder = tmp_path_factory.mktemp("clients")
    command = [sys.executable, str(ROOT / "clients" / "build.py"), "--only", "python", "--output", str(folder)]
    subprocess.run(command, check=True)
    (wheel,) = folder.glob("*.whl")
    contract = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))
    assert wheel.name == f"ricochet_client-{contract['info']['version']}.0.0-py3-none-any.whl"
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


def test_generated_client_sends_requests_and_follows_jobs(installed: Path, live_url: str) -> None:
    command = [sys.executable, "-W", "error", str(ROOT / "tests" / "clients" / "python" / "conversation.py"), live_url]
    environment = os.environ | {"NO_PROXY": "*", "PYTHONPATH": str(installed)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[-1:]) == (0, ["ask_how_it_is"]), done.stdout + done.stderr
