"""What the documentation has an operator install and open."""

import re
from pathlib import Path

import pytest

from .blocks import PAGES, ROOT, name_of

SIZING = (ROOT / "docs" / "sizing.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_page_installs_by_a_name_that_is_another_projects(page: Path) -> None:
    """The package index has a ricochet, and it is not this one."""
    assert not re.search(r"pip install [\"']?ricochet(\[|\s|$)", Path(page).read_text(encoding="utf-8"))


def test_dask_is_warned_of_before_its_commands() -> None:
    warning = SIZING.index("can run anything there")
    assert warning < SIZING.index("dask scheduler")
    assert warning < SIZING.index("docker compose up")
    assert SIZING.count("can run anything there") == 1
