"""The example notebook runs from start to end."""

import subprocess
import sys
from pathlib import Path

from tests.cli.commands import LIMIT_S, ROOT, environment


def test_every_cell_of_the_notebook_runs(tmp_path: Path) -> None:
    example = ROOT / "examples" / "notebook.py"
    command = [sys.executable, "-W", "error", str(example)]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "ricochet after 3.5" in done.stdout
    assert done.stdout.count("converged") == 9
    assert (tmp_path / "critical_angle.svg").read_text().startswith("<?xml")
