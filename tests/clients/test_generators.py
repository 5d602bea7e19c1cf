"""The recipes of the manual for clients made by hey-api and models made by datamodel-code-generator work."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.blocks import ROOT, blocks

pytestmark = pytest.mark.system
PAGE = ROOT / "docs" / "how-to" / "clients.md"
OUT_OF_REACH = re.compile(
    r"\bE(NOTFOUND|AI_AGAIN|CONN\w+|TIMEDOUT|NETUNREACH|HOSTUNREACH)\b|Failed to establish|No matching distribution"
)
"""Messages of npm and pip that mean that a registry cannot be reached."""
LIMIT_S = 300.0
"""Time limit of a command, which spends most of its time on downloads. [s]"""


def run(folder: Path, *command: str) -> str:
    """Run a command, which must succeed; return its output."""
    done = subprocess.run(
        command,
        cwd=folder,
        # A process pool of another test may have set PYTHONSAFEPATH in this process.
        env=os.environ | {"NO_PROXY": f"{os.environ.get('NO_PROXY', '')},127.0.0.1", "PYTHONSAFEPATH": ""},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    if done.returncode and "install" in command and (reason := OUT_OF_REACH.search(done.stderr)):
        pytest.skip(f"{command[0]} cannot reach its registry: {reason[0]}")
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def block_with(text: str, url: str) -> str:
    """Return the block of the manual that begins with this text, with the address of a service filled in."""
    [found] = [block.text for block in blocks(PAGE) if block.text.startswith(text)]
    return found.replace("http://localhost:8000", url)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "openapi" / "openapi.json", tmp_path / "contract.json")
    return tmp_path


def test_functions_generated_by_hey_api_call_the_service(folder: Path, live_url: str) -> None:
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    run(folder, "npm", "install", "--no-audit", "--no-fund", "@hey-api/openapi-ts", "typescript@5.9")
    run(folder, "npx", "openapi-ts", "--input", "contract.json", "--output", "client")
    (folder / "block.ts").write_text(block_with("import { client }", live_url), encoding="utf-8")
    run(folder, "npx", "tsc", "--strict", "--target", "es2022", "--module", "commonjs", "--outDir", "out", "block.ts")
    angle, outcome, status = run(folder, "node", "out/block.js").split()
    assert float(angle) == pytest.approx(48.63, abs=0.05)
    assert (outcome, status) == ("ricochet", "200")


def test_models_generated_by_datamodel_code_generator_validate_requests_and_answers(
    folder: Path, live_url: str
) -> None:
    run(folder, sys.executable, "-m", "venv", "venv")
    python = str(folder / "venv" / "bin" / "python")
    run(folder, python, "-m", "pip", "install", "--quiet", "datamodel-code-generator", "httpx")
    contract = ("--input", "contract.json", "--input-file-type", "openapi")
    models = ("--output-model-type", "pydantic_v2.BaseModel", "--output", "models.py")
    run(folder, str(folder / "venv" / "bin" / "datamodel-codegen"), *contract, *models)
    (folder / "block.py").write_text(block_with("from models import", live_url), encoding="utf-8")
    angle, outcome, length = run(folder, python, "block.py").split()
    assert float(angle) == pytest.approx(48.63, abs=0.05)
    assert outcome == "ricochet"
    assert int(length) > 0
