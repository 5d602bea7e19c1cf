"""The TypeScript client that `make clients` builds from the contract, used as its users would."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.blocks import blocks

pytestmark = pytest.mark.system  # In the default run, only the Python client is tested.

ROOT = Path(__file__).parents[2]
CONTRACT = ROOT / "openapi" / "openapi.json"
CLIENT = ROOT / "clients" / "typescript"
CONVERSATION = ROOT / "tests" / "clients" / "typescript"
PARTS = ("findOneAngle", "findSomeAtOnce", "sweepTwoAxes", "calibrate", "followAJob", "cancelAJob", "getProblems")

OLDEST_NODE = 20
LIMIT_S = 90.0  # Limit for one command; all of them together take about 15 s on two cores.
OUT_OF_REACH = re.compile(
    r"\b(E(NOTFOUND|AI_AGAIN|CONN\w+|TIMEDOUT|NETUNREACH|HOSTUNREACH|40[137]|5\d\d)|ERR_SOCKET\w+)\b"
)
"""Error codes of npm if its registry cannot be reached."""

ENVIRONMENT = os.environ | {
    # Node.js may have been installed beside the Python that runs the tests.
    "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    "NO_PROXY": f"{os.environ.get('NO_PROXY', '')},127.0.0.1",
}


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which(command[0], path=ENVIRONMENT["PATH"])
    if program is None:
        pytest.skip(f"there is no {command[0]} here")
    return subprocess.run(
        [program, *command[1:]],
        cwd=folder,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the client, with its locked packages installed and its types checked by the compiler."""
    folder = tmp_path_factory.mktemp("typescript")
    version = run(folder, "node", "--version").stdout.strip()
    if int(version.lstrip("v").partition(".")[0]) < OLDEST_NODE:
        pytest.skip(f"Node.js {OLDEST_NODE} or later is needed, here is {version}")
    for source in (CLIENT, CONVERSATION):
        shutil.copytree(source, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("node_modules"))
    shutil.copy(CONTRACT, folder / "contract.json")
    patience = ("--prefer-offline", "--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--fetch-timeout=20000")
    installed = run(folder, "npm", "ci", "--ignore-scripts", *patience)
    if installed.returncode and (reason := OUT_OF_REACH.search(installed.stderr)):
        pytest.skip(f"npm cannot reach its registry: {reason[0]}")
    assert installed.returncode == 0, installed.stdout + installed.stderr
    for command in (["npm", "run", "build"], ["npx", "tsc", "--project", "tsconfig.conversation.json"]):
        built = run(folder, *command)
        assert built.returncode == 0, built.stdout + built.stderr
    packed = json.loads(run(folder, "npm", "pack", "--dry-run", "--json").stdout)
    assert {"dist/index.js", "dist/index.d.ts", "dist/contract.d.ts"} <= {file["path"] for file in packed[0]["files"]}
    return folder


def test_typescript_client_sends_requests_and_follows_jobs(built: Path, live_url: str) -> None:
    talked = run(built, "node", "out/conversation.js", live_url)
    assert (talked.returncode, talked.stdout.split()) == (0, list(PARTS)), talked.stdout + talked.stderr


def test_blocks_of_the_manual_compile_and_run(built: Path, live_url: str) -> None:
    page = ROOT / "docs" / "how-to" / "clients.md"
    marked = [block for block in blocks(page) if block.language == "ts"]
    assert len(marked) == 2
    assert all(block.runs for block in marked)
    settings = json.loads((built / "tsconfig.conversation.json").read_text(encoding="utf-8"))
    names = [f"block-{number}.ts" for number in range(len(marked))]
    for name, block in zip(names, marked, strict=True):
        (built / name).write_text(block.text.replace("http://localhost:8000", live_url), encoding="utf-8")
    (built / "tsconfig.blocks.json").write_text(json.dumps(settings | {"files": names}), encoding="utf-8")
    compiled = run(built, "npx", "tsc", "--project", "tsconfig.blocks.json")
    assert compiled.returncode == 0, compiled.stdout + compiled.stderr
    for name in names:
        done = run(built, "node", f"out/{Path(name).stem}.js")
        assert done.returncode == 0, done.stdout + done.stderr
        assert 0.0 < float(done.stdout.split()[-1]) < 90.0


def test_body_of_the_readme_has_the_types_of_the_contract(built: Path) -> None:
    """The body compiles with the types that openapi-typescript generates by default, and a misspelt field does not."""
    found = re.search(r"localhost:8000/cra .*? -d '(\{.*?\})'", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert found
    settings = json.loads((built / "tsconfig.conversation.json").read_text(encoding="utf-8"))
    (built / "tsconfig.readme.json").write_text(json.dumps(settings | {"files": ["readme.ts"]}), encoding="utf-8")
    kind = 'import type { components } from "./contract.js";\nexport const body: components["schemas"]'
    for body, valid in ((found[1], True), (found[1].replace("velocity_m_s", "velocity"), False)):
        (built / "readme.ts").write_text(f'{kind}["CriticalAngleRequest"] = {body};\n', encoding="utf-8")
        compiled = run(built, "npx", "tsc", "--project", "tsconfig.readme.json")
        assert (compiled.returncode == 0) == valid, compiled.stdout


def test_lock_checks_every_package_and_names_no_registry() -> None:
    lock = (CLIENT / "package-lock.json").read_text(encoding="utf-8")
    assert "registry" not in lock
    assert '"resolved"' not in lock
    packages = re.findall(r'^    "node_modules/', lock, re.MULTILINE)
    assert len(packages) == len(re.findall(r'^      "integrity": "sha512-', lock, re.MULTILINE)) > 0
