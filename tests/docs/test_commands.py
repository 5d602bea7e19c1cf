"""Commands and programs in the documentation work.

Blocks marked `sh run` or `python run` are run unchanged, all of a page one after another in one empty folder. For a
page with a block marked `server`, a service is started: its address replaces `localhost:8000`, its data folder is
`data`, and curl fails for a status of 400 or more. Blocks marked `ts run` are run by
tests/api/test_typescript_client.py. Any other command has to be in `NOT_RUN`.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from .blocks import COMMAND_LINE, COMMANDS, PAGES, ROOT, Block, blocks, name_of

NOT_RUN = {
    "make demo": "CI runs it",
    "make test": "CI runs it, and these tests are part of it",
    "make setup": "every other target runs it first",
    "make check": "CI runs it",
    "make sbom": "tests/supply/test_bill_of_materials.py runs it",
    "make clients": "tests/api/test_generated_client.py and test_typescript_client.py build the same",
    "make serve": "runs until it is stopped; `server` blocks have a service",
    ". .venv/bin/activate": "done for every block that runs",
    "pip install ": "`make setup` installs the same from the lock",
    "npm install ": "tests/api/test_typescript_client.py installs the same from the lock",
    "npx openapi-typescript ": "tests/api/test_typescript_client.py generates the same types",
    "npx openapi-ts ": "tests/clients/test_generators.py generates the same functions",
    "npx openapi-generator-cli ": "downloads its generator, which runs on Java",
    "datamodel-codegen ": "tests/clients/test_generators.py generates the same models",
    "curl -s localhost:8000/openapi.json > contract.json": "tests/clients/test_generators.py uses the same contract",
    "from models import ": "tests/clients/test_generators.py runs it",
    "ricochet calibrate depth tests.csv --case strike.toml --uncertain": "tests/cli/test_uncertainty.py runs the same",
    "ricochet uncertainty strike.toml": "tests/cli/test_uncertainty.py runs the same",
    "dask ": "tests/service/dask_cluster.py starts the same",
    "RICOCHET_EXECUTOR=dask ": "needs a scheduler; tests/service/dask_cluster.py starts one",
    "docker ": "needs a container engine; tests/container runs the steps",
    **dict.fromkeys(
        ("systemctl ", "mv /var/lib/", "cp -pR /var/", "chown -R ricochet", "chmod 700 /var/", "runuser -u ricochet "),
        "tests/deploy/test_back_up.py runs the same with other paths",
    ),
    "import umbridge ": "the package is not installed; tests/api/test_umbridge.py sends the same queries",
    "config = {": "continues the block that imports umbridge",
}
"""Beginnings of commands and Python programs that are not run here, with the reason."""
MOST_S = 240.0
TOLERANCE_DEG = 0.02
"""Tolerance of printed angles, twice the tolerance of the search because the README rounds. [°]"""
BIN = Path(sys.executable).parent


def environment(folder: Path) -> dict[str, str]:
    """Return the environment of a user who has installed the package and set no variables."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("RICOCHET_", "OTEL_", "PYTHON"))}
    (folder / ".curlrc").write_text("fail-with-body\nshow-error\nnoproxy = *\n")
    return kept | {"PATH": f"{BIN}:{os.environ['PATH']}", "CURL_HOME": str(folder), "NO_PROXY": "*"}


def run(block: Block, folder: Path, url: str) -> subprocess.CompletedProcess[str]:
    """Run a block, which must succeed; return its result."""
    text = block.text.replace("localhost:8000", url.removeprefix("http://")) if block.uses_service else block.text
    command = {"sh": ["bash", "-euo", "pipefail", "-c", text], "python": [str(BIN / "python"), "-c", text]}
    done = subprocess.run(
        command[block.language],
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=MOST_S,
        check=False,
    )
    assert done.returncode == 0, f"{block} ended in {done.returncode}\n{text}\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture
def run_page(tmp_path: Path, service_on: Callable[..., Any]) -> Iterator[Callable[[Path], dict[str, str]]]:
    """Return a function that runs the blocks of a page and returns the output of each by its position."""
    with ExitStack() as stack:

        def run_all(page: Path) -> dict[str, str]:
            marked = [block for block in blocks(page) if block.runs and block.language != "ts"]
            url = ""
            if any(block.uses_service for block in marked):
                url = stack.enter_context(service_on(tmp_path)).url
            return {str(block): run(block, tmp_path, url).stdout for block in marked}

        yield run_all


@pytest.mark.parametrize("page", PAGES, ids=name_of)
@pytest.mark.system
@pytest.mark.timeout(3 * MOST_S)
def test_every_block_marked_run_works(page: Path, run_page: Callable[[Path], dict[str, str]]) -> None:
    printed = run_page(page)
    if page.name == "README.md":
        python, commands, cra = printed.values()
        assert f"Critical angle {float(python.split()[-1]):.1f}° from the normal, 90 % range " in commands
        text = page.read_text(encoding="utf-8")
        [said] = re.findall(r'"critical_angle_deg": ([0-9.]+)\.\.\.', text)
        assert f"prints `embedded converged {said}...`" in text
        assert json.loads(cra)["critical_angle_deg"] == pytest.approx(float(said), abs=TOLERANCE_DEG)
        assert float(python.split()[-1]) == pytest.approx(float(said), abs=TOLERANCE_DEG)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_of_commands_is_run_or_listed_as_not_run(page: Path) -> None:
    for block in blocks(page):
        if block.language not in COMMANDS or block.runs:
            continue
        lines = [line.removeprefix("$ ") for line in block.text.splitlines() if line and not line.startswith(" ")]
        if block.language == "python":
            lines = lines[:1]
        for line in lines:
            assert line.startswith(tuple(NOT_RUN)), (
                f"{block}: mark it `sh run`, or give a reason why `{line}` is not run"
            )


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_block_of_another_language_contains_a_command(page: Path) -> None:
    """Blocks marked `text`, for example, are for output and drawings."""
    for block in blocks(page):
        if block.language not in COMMANDS:
            lines = [line for line in block.text.splitlines() if COMMAND_LINE.match(line)]
            assert lines == [], f"{block}: mark it `sh run`, or `sh` with a reason on the list"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_marks_of_blocks_are_known(page: Path) -> None:
    for block in blocks(page):
        assert set(block.info[1:]) <= {"run", "server"}, block
        assert not block.runs or block.language in {"sh", "python", "ts"}, block


def test_pages_keep_their_number_of_blocks_marked_run() -> None:
    counts = {name_of(page): sum(block.runs for block in blocks(page)) for page in PAGES}
    assert counts["README.md"] >= 3
    assert counts["docs/how-to/clients.md"] >= 4
    assert counts["docs/operating.md"] >= 2
    assert counts["docs/how-to/back-up.md"] >= 2
    assert counts["docs/tutorial/first-map.md"] >= 4
    assert counts["docs/tutorial/assessment.md"] >= 5
    assert counts["docs/tutorial/danger-zone.md"] >= 3


def test_links_between_pages_have_targets() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.relative_to(ROOT)} links to {target}"


def test_main_path_of_the_manual_is_short() -> None:
    """README, tutorials and how-to pages have at most 12,000 words. They once had 23,000, too many for newcomers."""
    pages = [ROOT / "README.md", *(ROOT / "docs" / "tutorial").glob("*.md"), *(ROOT / "docs" / "how-to").glob("*.md")]
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in pages) <= 12_000
