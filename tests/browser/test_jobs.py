"""The table of jobs."""

import csv
import io
import json
from pathlib import Path

import h5py
import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.api.many import ASYNC, LINES, finished, lines, searches, slow_strikes


def row_of(page: Page, job: dict[str, str]) -> Locator:
    return page.get_by_role("row").filter(has=page.get_by_text(job["id"][:8], exact=True))


def test_job_is_seen_to_run_and_can_be_cancelled(page: Page, client: httpx.Client) -> None:
    page.goto("/#/jobs")
    job = client.post("/trajectory/batch", content=lines(slow_strikes(200)), headers=LINES | ASYNC).json()
    page.goto("/#/explore")
    page.goto("/#/jobs")
    row = row_of(page, job)
    expect(row).to_contain_text("running")
    before = row.get_by_role("progressbar").get_attribute("value")
    expect(row.get_by_role("progressbar")).not_to_have_attribute("value", before or "")
    row.get_by_role("button", name="Cancel").click()
    expect(row).to_contain_text("cancelled")
    expect(row.get_by_role("button", name="Cancel")).to_be_hidden()
    assert client.get(f"/jobs/{job['id']}").json()["status"] == "dismissed"


def test_table_has_the_jobs_of_all_pages(page: Page, client: httpx.Client) -> None:
    jobs = [client.post("/cra/batch", json={"cases": searches(1)}, headers=ASYNC).json() for _ in range(3)]
    page.route("**/jobs?*", lambda route: route.continue_(url=route.request.url.replace("limit=1000", "limit=2")))
    page.goto("/#/jobs")
    for job in jobs:
        expect(row_of(page, job)).to_have_count(1)


@pytest.mark.parametrize("form", ["CSV", "JSONL", "HDF5"])
def test_results_are_downloaded(page: Page, client: httpx.Client, tmp_path: Path, form: str) -> None:
    job = client.post("/cra/batch", content=lines(searches(4)), headers=LINES | ASYNC).json()
    assert finished(client, job)["status"] == "successful"
    page.goto("/#/jobs")
    with page.expect_download() as download:
        row_of(page, job).get_by_role("button", name=form).click()
    path = tmp_path / "results"
    download.value.save_as(path)
    assert count_of(path, form) == 4


def count_of(path: Path, form: str) -> int:
    """Cases in a file."""
    if form == "HDF5":
        with h5py.File(path) as file:
            return int(file["summary"].shape[0])
    text = path.read_text()
    return len(list(csv.DictReader(io.StringIO(text)))) if form == "CSV" else len([*map(json.loads, text.splitlines())])


def test_job_is_deleted_only_once_that_is_confirmed(page: Page, client: httpx.Client) -> None:
    job = client.post("/cra/batch", content=lines(searches(1)), headers=LINES | ASYNC).json()
    finished(client, job)
    page.goto("/#/jobs")
    delete = row_of(page, job).get_by_role("button", name="Delete")
    delete.click()
    page.keyboard.press("Escape")
    expect(delete).to_be_focused()
    assert client.get(f"/jobs/{job['id']}").is_success
    delete.click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(row_of(page, job)).to_have_count(0)
    assert client.get(f"/jobs/{job['id']}").status_code == 404
