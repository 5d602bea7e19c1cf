"""Fixtures that run commands in a folder with the file of a strike."""

from pathlib import Path

import pytest

from tests.cli.commands import STRIKE_TOML


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "strike.toml").write_text(STRIKE_TOML)
    return tmp_path


@pytest.fixture
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with the file of a strike, as the working directory; commands compute locally."""
    monkeypatch.chdir(folder)
    for name in ("RICOCHET_URL", "RICOCHET_DATA_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("NO_PROXY", "*")
    return folder


@pytest.fixture
def served(here: Path, live_url: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with the file of a strike, as the working directory; commands use the shared service."""
    monkeypatch.setenv("RICOCHET_URL", live_url)
    return here
