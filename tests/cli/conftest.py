"""A folder with a strike in it."""

from pathlib import Path

import pytest

from tests.cli.commands import STRIKE_TOML


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "strike.toml").write_text(STRIKE_TOML)
    return tmp_path
