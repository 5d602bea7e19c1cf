"""Downloads from a page."""

import csv
from pathlib import Path

from playwright.sync_api import Locator, Page


def saved(page: Page, button: Locator, path: Path) -> str:
    """Click a download button and save the file to `path`; return the file name that the page suggests."""
    with page.expect_download() as download:
        button.click()
    download.value.save_as(path)
    return download.value.suggested_filename


def data_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file that begins with comment lines."""
    return list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("# ")))
