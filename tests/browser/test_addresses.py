"""Addresses that are shared and reopened."""

import re

from playwright.sync_api import Page, expect

from .conftest import NewPage
from .side_view import IDLE


def test_explored_case_is_reopened_from_its_address(new_page: NewPage) -> None:
    page = new_page()
    page.goto("/#/explore")
    page.get_by_role("slider", name="Speed").fill("300")
    expect(page).to_have_url(re.compile("velocity_m_s=300"))
    page.wait_for_function(IDLE)
    expect(page.locator("[data-outcome]")).to_contain_text("90 % range")
    words = page.locator("[data-outcome]").inner_text()
    assert "48.6" not in words  # that of the speed before
    other = new_page(theme="dark")
    other.goto(page.url)
    expect(other.get_by_role("slider", name="Speed")).to_have_value("300")
    expect(other.locator("[data-outcome]")).to_have_text(words)


def test_critical_angle_is_reopened_from_its_address(new_page: NewPage) -> None:
    page = new_page()
    page.goto("/#/critical-angle?impact.velocity_m_s=300&target.compressive_strength_pa=50000000")
    angle = page.locator("strong.angle").first
    expect(angle).to_have_text(re.compile(r"^\d\d\.\d°$"))
    other = new_page()
    other.goto(page.url)
    expect(other.locator("strong.angle").first).to_have_text(angle.inner_text())
    assert angle.inner_text() != "48.6°"


def test_map_is_reopened_from_its_address_without_being_run(new_page: NewPage) -> None:
    page = new_page()
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3&target.density_kg_m3=2300")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-progress")).to_have_text("All 6 cases are computed.")
    expect(page).to_have_url(re.compile("job=[0-9a-f]{32}"))
    other = new_page()
    posts: list[str] = []
    other.on("request", lambda request: posts.append(request.url) if request.method == "POST" else None)
    other.goto(page.url)
    expect(other.locator("#map-progress")).to_have_text("All 6 cases are computed.")
    expect(other.locator("#map-counts")).to_have_text(page.locator("#map-counts").inner_text())
    read = "() => document.querySelector('.map .drawing').data[1].z.map(row => [...row])"
    assert other.evaluate(read) == page.evaluate(read)
    assert other.url == page.url
    assert [each for each in posts if "sweep" in each or "batch" in each] == [], "the card alone is computed"


def test_map_is_found_again_among_the_jobs(page: Page) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-progress")).to_have_text("All 6 cases are computed.")
    expect(page).to_have_url(re.compile("job=[0-9a-f]{32}"))
    address = page.url
    page.get_by_role("link", name="Jobs").click()
    page.get_by_role("link", name="as a map").first.click()
    expect(page).to_have_url(address)
    expect(page.locator("#map-progress")).to_have_text("All 6 cases are computed.")


def test_address_of_no_view_leads_to_explore(page: Page) -> None:
    page.goto("/#/elsewhere")
    expect(page).to_have_url(re.compile("#/explore"))
    expect(page.get_by_role("heading", level=1)).to_contain_text("Explore")


def test_back_leads_from_a_case_to_its_map(page: Page) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-progress")).to_have_text("All 6 cases are computed.")
    expect(page).to_have_url(re.compile("job=[0-9a-f]{32}"))
    page.get_by_role("link", name="Open in Explore").click()
    expect(page).to_have_url(re.compile("#/explore"))
    page.go_back()
    expect(page.locator("#map-progress")).to_have_text("All 6 cases are computed.")


def test_parameters_that_cannot_be_read_are_named(page: Page) -> None:
    page.goto("/#/explore?impact.velocity_m_s=fast&speed=3&projectile.mass_kg=15")
    note = page.get_by_role("alert").filter(has_text="Not understood in the address")
    expect(note).to_have_text("Not understood in the address, and left out: impact.velocity_m_s=fast, speed=3.")
    expect(page.get_by_label("Mass")).to_have_value("15")
    page.goto("/#/explore?projectile.mass_kg=14")
    expect(page.get_by_label("Mass")).to_have_value("14")
    expect(note).to_have_count(0)
