"""Package names and installation commands in documentation and messages."""

import re
import tomllib
from pathlib import Path

import pytest

from service.assessment import EXTRA
from service.settings import missing_package

from .blocks import PAGES, ROOT, name_of

SIZING = (ROOT / "docs" / "sizing.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_page_installs_a_package_of_another_project(page: Path) -> None:
    """On the package index, the name `ricochet` belongs to another project."""
    assert not re.search(r"pip install [\"']?ricochet(\[|\s|$)", Path(page).read_text(encoding="utf-8"))


def test_readme_installs_the_package_from_the_repository() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    name = project["name"]
    assert "ricochet" in project["scripts"]
    assert "\npip install ." in text
    assert "`import solver`" in text
    assert f"called `{name}`" in text
    assert name != "ricochet"
    assert "`ricochet` on the package index is another project" in " ".join(text.split())
    assert "solver.warm_up(print)" in text
    assert "on a slow machine" in " ".join(text.split())


@pytest.mark.parametrize("package", ["service", "solver"])
def test_no_message_installs_a_package_of_another_project(package: str) -> None:
    sources = [*(ROOT / package).rglob("*.py"), *(ROOT / package).rglob("*.js")]
    assert sources
    named = [path for path in sources if re.search(r"install [\"'`]?ricochet\b", path.read_text(encoding="utf-8"))]
    assert named == []


def test_message_about_a_missing_package_names_the_extra_of_the_repository() -> None:
    text = missing_package("Parquet", "pyarrow", "parquet")
    assert text.startswith("Parquet needs pyarrow, which is not installed: ")
    assert 'pip install -e ".[parquet]"' in text


def test_plots_and_reports_are_part_of_every_installation() -> None:
    """The README uses plots and reports after `make demo`, which installs requirements/run.txt."""
    for name in ("run", "cluster", "full"):
        locked = (ROOT / "requirements" / f"{name}.txt").read_text("utf-8")
        assert [package for package in EXTRA if f"\n{package}==" not in locked] == []


def test_every_hint_to_install_an_extra_keeps_a_checkout_editable() -> None:
    files = [*PAGES, *(ROOT / "service").rglob("*.py"), *(ROOT / "solver").rglob("*.py"), *ROOT.glob("*.md")]
    hints = [line for path in files for line in Path(path).read_text("utf-8").splitlines() if '".[' in line]
    assert len(hints) >= 3
    assert [line for line in hints if 'pip install -e ".[' not in line] == []


def test_warning_about_dask_precedes_its_commands() -> None:
    warning = SIZING.index("can run anything there")
    assert warning < SIZING.index("dask scheduler")
    assert warning < SIZING.index("docker compose up")
    assert SIZING.count("can run anything there") == 1
