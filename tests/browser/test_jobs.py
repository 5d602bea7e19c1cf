"""The view "Jobs": progress, results, titles and deletion of jobs, and cases from a table."""

import csv
import io
import json
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from service.schemas.strike import PAPER
from tests.api.many import ASYNC, LINES, finished, lines, searches, slow_strikes


def row_of(page: Page, job: dict[str, str]) -> Locator:
    return page.get_by_role("row").filter(has=page.get_by_text(job["id"][:8], exact=True))


def test_running_job_is_shown_and_can_be_cancelled(page: Page, client: httpx.Client) -> None:
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


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (
            "speed,oblique_angle_deg\n238,45",
            'Column "speed" is not a field of a case. Did you mean impact.velocity_m_s?',
        ),
        ("xyz,oblique_angle_deg\n238,45", 'Column "xyz" is not a field of a case.'),
        ("velocity_m_s;oblique_angle_deg\n238;45\n238,5;45", 'Case 2, impact.velocity_m_s: "238,5" is not valid.'),
        ("velocity_m_s\n238\n240,1", "Case 2 has 2 cells, the header 1."),
        ("velocity_m_s\n238\n-3", "Case 2, impact.velocity_m_s: "),
        ("velocity_m_s", "The table needs a header and a row for each case."),
    ],
)
def test_invalid_cell_of_a_table_is_named(page: Page, faults: list[str], table: str, problem: str) -> None:
    page.goto("/#/jobs")
    page.get_by_label("Cases, pasted or dropped as CSV").fill(table)
    page.get_by_role("button", name="Compute").click()
    expect(page.get_by_role("alert")).to_contain_text(problem)
    faults[:] = [fault for fault in faults if "422" not in fault]


def test_length_of_a_pasted_sphere_follows_its_diameter(page: Page) -> None:
    sphere = "projectile.nose.shape=sphere&projectile.diameter_m=0.02&projectile.mass_kg=0.0329"
    page.goto(f"/#/jobs?{sphere}")
    page.get_by_label("Cases, pasted or dropped as CSV").fill("diameter_m\n0.02\n0.03")
    with page.expect_response(lambda response: response.url.endswith("/trajectory/batch")) as response:
        page.get_by_role("button", name="Compute").click()
    content = response.value.request.post_data_json
    assert content is not None
    assert [case["projectile"]["length_m"] for case in content["cases"]] == [0.02, 0.03]
    assert response.value.ok


def test_cases_of_a_dropped_table_are_completed_from_the_current_case(page: Page, client: httpx.Client) -> None:
    page.goto("/#/jobs?projectile.mass_kg=15")
    expect(page.get_by_role("button", name="Compute")).to_be_visible()
    page.evaluate("""() => {
        const dataTransfer = new DataTransfer();
        dataTransfer.items.add(new File(["custom_id,velocity_m_s\\nfirst,238\\nsecond,\\n"], "cases.csv"));
        const drop = new DragEvent("drop", { dataTransfer, cancelable: true, bubbles: true });
        document.getElementById("cases").dispatchEvent(drop);
    }""")
    expect(page.get_by_label("Cases, pasted or dropped as CSV")).to_have_value(re.compile("second"))
    with page.expect_response(lambda response: response.url.endswith("/trajectory/batch")) as response:
        page.get_by_role("button", name="Compute").click()
    content = response.value.request.post_data_json
    assert content is not None
    sent = content["cases"]
    assert [case["custom_id"] for case in sent] == ["first", "second"]
    assert [case["impact"]["velocity_m_s"] for case in sent] == [238, 238]
    assert {case["projectile"]["mass_kg"] for case in sent} == {15}
    assert finished(client, response.value.json())["counts"]["total"] == 2


def test_running_job_shows_its_remaining_time_and_queued_job_its_position(page: Page, client: httpx.Client) -> None:
    """The answer of the service is replaced, so that both states occur however busy the machine is."""
    job = client.post("/cra/batch", content=lines(searches(1)), headers=LINES | ASYNC).raise_for_status().json()
    counts = {"total": 100, "done": 0, "cached": 0, "failed": 0}
    started = (datetime.now(UTC) - timedelta(seconds=60)).isoformat()
    waits = job | {"id": "a" * 32, "status": "accepted", "created": "2026-01-02T00:00:00Z", "counts": counts}
    waits["queue"] = {"jobs_ahead": 1, "remaining_s": 40}
    runs = job | {"id": "b" * 32, "status": "running", "created": "2026-01-01T00:00:00Z", "started": started}
    runs["counts"] = counts | {"done": 20}
    page.route("**/jobs?*", lambda route: route.fulfill(json={"jobs": [waits, runs]}))
    page.goto("/#/jobs")
    expect(row_of(page, waits)).to_contain_text("1 ahead")
    expect(row_of(page, runs)).to_contain_text(re.compile("20 of 100 cases, .* a second, about [45] min left"))


def test_table_shows_the_newest_jobs_and_loads_older_ones_on_demand(page: Page, client: httpx.Client) -> None:
    jobs = [client.post("/cra/batch", json={"cases": searches(1)}, headers=ASYNC).json() for _ in range(3)]
    requested: list[str] = []
    page.on("request", lambda request: requested.append(request.url) if "/jobs?" in request.url else None)
    page.route("**/jobs?*", lambda route: route.continue_(url=route.request.url.replace("limit=50", "limit=2")))
    page.goto("/#/jobs")
    for job, count in zip(jobs, (0, 1, 1), strict=True):
        expect(row_of(page, job)).to_have_count(count)
    expect(page.get_by_text("The newest 2 jobs. There are older ones.")).to_be_visible()
    assert not any("cursor" in url for url in requested)
    page.get_by_role("button", name="Load older jobs").click()
    expect(row_of(page, jobs[0])).to_have_count(1)
    expect(row_of(page, jobs[2])).to_have_count(1)


def test_sweep_is_titled_by_its_axes_and_can_be_renamed(page: Page, client: httpx.Client) -> None:
    axes = [
        {"field": "impact.velocity_m_s", "values": [238.0, 300.0]},
        {"field": "target.compressive_strength_pa", "start": 39e6, "stop": 49e6, "count": 3},
    ]
    job = client.post("/cra/sweep", json={"base": PAPER, "axes": axes}, headers=ASYNC).json()
    page.goto("/#/jobs")
    row = row_of(page, job)
    expect(row).to_contain_text("speed × strength, 80 mm, 13 kg")
    row.get_by_text("Base case").click()
    expect(row).to_contain_text("39 to 49 MPa, 3 values")
    expect(row).to_contain_text("2250 kg/m³")
    row.get_by_role("button", name="Rename").click()
    page.get_by_label("Title").fill("North wall")
    page.keyboard.press("Enter")
    expect(row).to_contain_text("North wall")
    assert client.get(f"/jobs/{job['id']}").json()["title"] == "North wall"


def test_cells_match_their_column_headings(page: Page, client: httpx.Client) -> None:
    job = client.post("/cra/batch", content=lines(searches(3)), headers=LINES | ASYNC).json()
    finished(client, job)
    page.goto("/#/jobs")
    row = row_of(page, job)
    expect(row).to_contain_text("done")
    heads = page.get_by_role("columnheader").all_inner_texts()
    cells = dict(zip(heads, row.get_by_role("cell").all_inner_texts(), strict=True))
    assert job["id"][:8] in cells["Job"]
    assert (cells["Computation"], cells["Status"], cells["Cases"].split(",")[0]) == (
        "critical angles",
        "done",
        "3 of 3 cases",
    )
    assert cells["Kept until"] > ""


@pytest.mark.parametrize("form", ["CSV", "JSONL", "HDF5"])
def test_results_of_a_job_can_be_downloaded(page: Page, client: httpx.Client, tmp_path: Path, form: str) -> None:
    job = client.post("/cra/batch", content=lines(searches(4)), headers=LINES | ASYNC).json()
    assert finished(client, job)["status"] == "successful"
    page.goto("/#/jobs")
    with page.expect_download() as download:
        row_of(page, job).get_by_role("button", name=form).click()
    ending = {"HDF5": "h5"}.get(form, form.lower())
    assert download.value.suggested_filename == f"ricochet-4-critical-angles.{ending}"
    path = tmp_path / "results"
    download.value.save_as(path)
    assert count_of(path, form) == 4


def count_of(path: Path, form: str) -> int:
    """Return the number of cases in a downloaded file."""
    if form == "HDF5":
        with h5py.File(path) as file:
            return int(file["summary/index"].shape[0])
    text = path.read_text()
    return len(list(csv.DictReader(io.StringIO(text)))) if form == "CSV" else len([*map(json.loads, text.splitlines())])


def test_job_is_deleted_only_after_confirmation(page: Page, client: httpx.Client) -> None:
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
