"""Scripts, Makefile, Dockerfile and nginx.conf have LF line ends in a clone, whatever the settings of git."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHEBANG = b"#!"


def git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout  # noqa: S607


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone")
def test_scripts_have_lf_line_ends_in_every_clone() -> None:
    listed = git("ls-files").splitlines()
    scripts = [name for name in listed if (ROOT / name).read_bytes()[:2] == SHEBANG]
    scripts = [name for name in scripts if not name.endswith(".py")] + ["Makefile", "Dockerfile", "deploy/nginx.conf"]
    assert "entry-point.sh" in scripts
    said = git("check-attr", "eol", "--", *scripts).splitlines()
    assert [line.rpartition(": ")[2] for line in said] == ["lf"] * len(scripts)
