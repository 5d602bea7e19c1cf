"""Files that a page offers."""

import csv
from pathlib import Path

from playwright.sync_api import Locator, Page


def saved(page: Page, button: Locator, path: Path) -> str:
    """Save what a button offers in this file; return the name that the page suggests."""
    with page.expect_download() as download:
        button.click()
    download.value.save_as(path)
    return download.value.suggested_filename


def data_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file below its header of comments."""
    return list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("# ")))
