"""The page without a pointer."""

import re

from playwright.sync_api import Locator, Page, expect

MOST_TABS = 80


def tab_to(page: Page, target: Locator) -> None:
    """Go on to an element, key by key."""
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        if target.evaluate("element => element === document.activeElement"):
            return
    raise AssertionError(f"{target} cannot be reached")


def test_skip_link_leads_to_the_view(page: Page) -> None:
    page.goto("/#/explore")
    expect(page.locator(".drawing .main-svg").first).to_be_visible()
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the view")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
    expect(page).to_have_url(re.compile("#/explore$"))


def test_slider_answers_to_arrow_keys(page: Page) -> None:
    page.goto("/#/explore")
    slider = page.get_by_role("slider", name="Speed")
    tab_to(page, slider)
    page.keyboard.press("ArrowRight")
    expect(page).to_have_url(re.compile("impact.velocity_m_s=239"))


def test_map_is_run_read_and_opened_by_keys_alone(page: Page) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,2")
    tab_to(page, page.get_by_role("group", name="Vertical axis").get_by_label("Values"))
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("3")
    expect(page.locator("#map-size")).to_have_text("6 cases")
    tab_to(page, page.get_by_role("button", name="Run"))
    page.keyboard.press("Enter")
    expect(page.locator("#map-progress")).to_have_text("All 6 cases are computed.")
    cell = page.get_by_role("region", name="One case")
    tab_to(page, cell.get_by_label("Speed"))
    page.keyboard.type("238")
    tab_to(page, cell.get_by_label("Mass"))
    page.keyboard.type("13 ")
    expect(cell.get_by_role("status")).to_contain_text("turned away from 48.6")
    tab_to(page, cell.get_by_role("link", name="Open in Critical angle"))
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("#/critical-angle"))
