"""Accessibility of every view: axe reports no serious or critical violation, and nothing needs sideways scrolling."""

import json
from typing import Any, Literal

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.api.many import ASYNC, LINES, lines, searches

from .conftest import NewPage, all_computed

SEVERE = {"serious", "critical"}
OPTIONS = {"resultTypes": ["violations"]}
COMPARED = "explore?impact.velocity_m_s=300&pin=&pin=projectile.mass_kg%3D16"
SMALL_MAP = "#/map?x=impact.velocity_m_s,150,240,3&y=target.compressive_strength_pa,39e6,60e6,3"
VIEWS = ("explore", COMPARED, "critical-angle", "how-sure", "walls", "map", "jobs")


@pytest.fixture(scope="module")
def job(client: httpx.Client) -> None:
    """Submit a job, so that the table of jobs has a row."""
    client.post("/cra/batch", content=lines(searches(2)), headers=LINES | ASYNC).raise_for_status()


def violations(page: Page) -> list[str]:
    """Return the violations that axe reports as serious or critical.

    The browser evaluates the script of axe, so the Content Security Policy of the page need not be relaxed.
    """
    found: list[dict[str, Any]] = Axe().run(page, options=OPTIONS).response["violations"]
    return [
        f"{fault['id']}: {fault['help']}: {json.dumps([node['html'][:200] for node in fault['nodes']])}"
        for fault in found
        if fault["impact"] in SEVERE
    ]


def open_view(page: Page, view: str) -> None:
    """Open a view and make every part of it visible."""
    page.goto(f"/{SMALL_MAP}" if view == "map" else f"/#/{view}")
    if view == "map":
        page.get_by_role("button", name="Run").click()
        all_computed(page, 9)
        page.get_by_text("The other fields").click()
    if view == "how-sure":
        page.get_by_role("button", name="Run").click()
        expect(page.locator("#study-progress")).to_have_text("Done.")
        page.get_by_text("Sampling", exact=True).click()
    if view == COMPARED:
        expect(page.get_by_role("group", name="Table of differences")).to_be_visible()
    if view in ("jobs", "walls"):
        expect(page.get_by_role("table")).to_be_visible()
    else:
        expect(page.locator(".drawing svg").first).to_be_visible()
    # Parts that are about to change are pale, which would count as low contrast.
    expect(page.locator("[aria-busy=true]:visible")).to_have_count(0)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(("theme", "width"), [("light", 1440), ("dark", 1440), ("light", 390), ("dark", 390)])
@pytest.mark.usefixtures("job")
def test_view_has_no_serious_accessibility_violation(
    new_page: NewPage, theme: Literal["light", "dark"], width: int, view: str
) -> None:
    page = new_page(theme=theme, width=width, height=844)
    open_view(page, view)
    assert violations(page) == []


def test_accessibility_violation_is_detected(page: Page) -> None:
    page.goto("/#/jobs")
    page.evaluate("document.getElementById('view').append(document.createElement('select'))")
    assert [fault.partition(":")[0] for fault in violations(page)] == ["select-name"]


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.usefixtures("job")
def test_narrow_window_needs_no_sideways_scrolling(new_page: NewPage, view: str) -> None:
    page = new_page(width=390, height=844)
    open_view(page, view)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
