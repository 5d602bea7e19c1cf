"""What docs/command-line.md shows, run as it is in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from service import cli
from tests.command.commands import LIMIT_S, ROOT, environment

TEXT = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh run\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.split()[-1])
def test_block_runs(tmp_path: Path, block: str) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["/bin/sh", "-e"],
        input=block,
        cwd=tmp_path,
        env=environment(PATH=path),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout or list(tmp_path.iterdir())


def test_every_command_has_its_line() -> None:
    rows = re.findall(r"^\| (`.*?`) \| .* \| `.*?ricochet (\w+)", TEXT, re.MULTILINE)
    named = {name for names, _ in rows for name in re.findall(r"`(\w+)`", names)}
    assert {command.name for command in cli.COMMANDS} <= named
    assert all(example in names for names, example in rows)
