"""Use of the page with the keyboard only."""

import re

import httpx
from playwright.sync_api import Locator, Page, expect

from tests.api.many import ASYNC, LINES, finished, lines, searches

from .conftest import all_computed

MOST_TABS = 80


def tab_to(page: Page, target: Locator) -> None:
    """Press Tab until an element has the focus; fail if it cannot be reached."""
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        if target.evaluate("element => element === document.activeElement"):
            return
    raise AssertionError(f"{target} cannot be reached")


def test_skip_link_leads_to_the_view(page: Page) -> None:
    page.goto("/#/explore")
    # A busy browser that is still drawing may lose key presses.
    expect(page.locator("#status")).to_have_text("Up to date.")
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the view")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
    expect(page).to_have_url(re.compile("#/explore$"))


def test_arrow_keys_move_a_slider(page: Page) -> None:
    page.goto("/#/explore")
    slider = page.get_by_role("slider", name="Speed")
    tab_to(page, slider)
    page.keyboard.press("ArrowRight")
    expect(page).to_have_url(re.compile("impact.velocity_m_s=239"))


def test_map_can_be_run_read_and_opened_by_keyboard(page: Page) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,2")
    tab_to(page, page.get_by_role("group", name="Vertical axis").get_by_label("Values"))
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("3")
    expect(page.locator("#map-size")).to_have_text("6 cases")
    tab_to(page, page.get_by_role("button", name="Run"))
    page.keyboard.press("Enter")
    all_computed(page, 6)
    cell = page.get_by_role("region", name="One case")
    tab_to(page, cell.get_by_label("Speed"))
    page.keyboard.type("238")
    tab_to(page, cell.get_by_label("Mass"))
    page.keyboard.type("13 ")
    expect(cell.get_by_role("status")).to_contain_text("ricochet from 48.6")
    tab_to(page, cell.get_by_role("link", name="Open in Critical angle"))
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("#/critical-angle"))


def test_strikes_can_be_pinned_compared_and_removed_by_keyboard(page: Page) -> None:
    page.goto("/#/explore?target.thickness_m=2")
    expect(page.locator(".angle")).to_be_visible()
    tab_to(page, page.get_by_role("button", name="Pin to compare"))
    page.keyboard.press("Enter")
    expect(page.get_by_role("region", name="Comparison")).to_be_visible()
    page.get_by_label("Oblique angle", exact=True).focus()
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("55")
    expect(page.get_by_role("row", name="Outcome ricochet embedded")).to_be_visible()
    tab_to(page, page.get_by_role("link", name="Open A"))
    tab_to(page, page.get_by_role("button", name="Remove A"))
    page.keyboard.press("Enter")
    expect(page.get_by_role("region", name="Comparison")).to_be_hidden()


def test_sections_and_the_report_can_be_opened_by_keyboard(page: Page) -> None:
    page.goto("/#/critical-angle")
    expect(page.locator(".angle")).to_be_visible()
    for title in ("How it was found", "Under other laws"):
        fold = page.locator("details.fold", has=page.get_by_text(title, exact=True))
        tab_to(page, fold.locator("summary"))
        page.keyboard.press("Enter")
        expect(fold.get_by_role("table").first).to_be_visible()
    page.get_by_role("link", name="Skip to the view").focus()
    tab_to(page, page.get_by_role("button", name="Report", exact=True))
    page.route("**/report", lambda route: route.fulfill(body="<title>Made</title>", content_type="text/html"))
    with page.expect_popup() as opened:
        page.keyboard.press("Enter")
    expect(opened.value).to_have_title("Made")


def test_study_can_be_set_up_and_run_by_keyboard(page: Page) -> None:
    page.goto("/#/how-sure?scatter=impact.velocity_m_s,normal,coefficient_of_variation:0.02&sampling.max_samples=512")
    expect(page.locator("#study-progress")).to_have_text("Done.")
    tab_to(page, page.get_by_label("Coefficient of variation"))
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("3")
    tab_to(page, page.get_by_label("Another input"))
    page.keyboard.type("Mass")
    tab_to(page, page.get_by_role("button", name="Add", exact=True))
    page.keyboard.press("Enter")
    group = page.get_by_role("group", name="Mass")
    tab_to(page, group.get_by_role("button", name="Remove Mass"))
    page.keyboard.press("Enter")
    expect(group).to_have_count(0)
    tab_to(page, page.get_by_role("button", name="Run"))
    page.keyboard.press("Enter")
    expect(page.locator("#study-progress")).to_have_text("Done.")
    expect(page.locator(".range")).to_be_visible()


def test_job_can_be_renamed_and_deleted_by_keyboard(page: Page, client: httpx.Client) -> None:
    job = client.post("/cra/batch", content=lines(searches(1)), headers=LINES | ASYNC).json()
    finished(client, job)
    page.goto("/#/jobs")
    row = page.get_by_role("row").filter(has=page.get_by_text(job["id"][:8], exact=True))
    rename, delete = (row.get_by_role("button", name=name) for name in ("Rename", "Delete"))
    tab_to(page, rename)
    page.keyboard.press("Enter")
    page.keyboard.type("South wall")  # The old title is selected, and therefore replaced.
    page.keyboard.press("Enter")
    expect(row).to_contain_text("South wall")
    expect(rename).to_be_focused()
    tab_to(page, delete)
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_role("button", name="Keep")).to_be_focused()
    page.keyboard.press("Shift+Tab")
    expect(dialog.get_by_role("button", name="Delete")).to_be_focused()
    page.keyboard.press("Enter")
    expect(row).to_have_count(0)
    assert client.get(f"/jobs/{job['id']}").status_code == 404
