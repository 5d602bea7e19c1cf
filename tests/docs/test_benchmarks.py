"""The scripts in benchmarks/ run; tests and benchmarks do not import each other."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
QUICK = {
    "call_path": [],
    "cluster": ["--quick"],
    "growth": ["--quick"],
    "hostile": ["--requests", "100"],
    "http_load": ["--quick"],
    "routes": ["--quick"],
    "scaling": ["--quick"],
    "slider": ["--quick"],
    "soak": ["--minutes", "0.3"],
    "startup": ["--quick"],
    "work_precision": ["--quick"],
}
"""Arguments with which each benchmark takes only seconds, by the name of its script."""
LONGEST = {"cluster", "growth", "scaling", "slider"}


def imported_by(path: Path) -> set[str]:
    """Return the top-level packages in the absolute imports of a file."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.partition(".")[0] for name in names}


@pytest.mark.parametrize(("folder", "other"), [("tests", "benchmarks"), ("benchmarks", "tests")])
def test_tests_and_benchmarks_are_independent(folder: str, other: str) -> None:
    files = list((ROOT / folder).rglob("*.py"))
    assert files
    assert [path for path in files if other in path.read_text(encoding="utf-8") and other in imported_by(path)] == []


@pytest.mark.system
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONGEST else name for name in QUICK]
)
def test_script_prints_a_table(name: str) -> None:
    command = [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *QUICK[name]]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if "no browser found" in done.stderr:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| --- |" in done.stdout
