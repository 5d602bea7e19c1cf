"""URLs of the page that are shared and reopened."""

import re

import pytest
from playwright.sync_api import Page, expect

from .conftest import NewPage, all_computed, run_map


def test_critical_angle_is_reopened_from_its_url(new_page: NewPage) -> None:
    page = new_page()
    page.goto("/#/critical-angle?impact.velocity_m_s=300&target.compressive_strength_pa=50000000")
    angle = page.locator("strong.angle").first
    expect(angle).to_have_text(re.compile(r"^\d\d\.\d°$"))
    other = new_page()
    other.goto(page.url)
    expect(other.locator("strong.angle").first).to_have_text(angle.inner_text())
    assert angle.inner_text() != "48.6°"


def test_map_is_reopened_from_its_url_or_from_the_jobs_without_a_new_run(new_page: NewPage) -> None:
    page = new_page()
    run_map(page, "x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3&target.density_kg_m3=2300", 6)
    expect(page).to_have_url(re.compile("job=[0-9a-f]{32}"))
    other = new_page()
    posts: list[str] = []
    other.on("request", lambda request: posts.append(request.url) if request.method == "POST" else None)
    other.goto(page.url)
    all_computed(other, 6)
    expect(other.locator("#map-counts")).to_have_text(page.locator("#map-counts").inner_text())
    read = "() => document.querySelector('.map .drawing').data[1].z.map(row => [...row])"
    assert other.evaluate(read) == page.evaluate(read)
    assert other.url == page.url
    assert [each for each in posts if "sweep" in each or "batch" in each] == [], "the card alone is computed"
    other.get_by_role("link", name="Jobs").click()
    other.get_by_role("link", name="as a map").first.click()
    expect(other).to_have_url(page.url)
    all_computed(other, 6)


def test_unknown_view_in_the_url_leads_to_explore(page: Page) -> None:
    page.goto("/#/elsewhere")
    expect(page).to_have_url(re.compile("#/explore"))
    expect(page.get_by_role("heading", level=1)).to_contain_text("Explore")


def test_back_button_returns_from_a_case_to_its_map(page: Page) -> None:
    run_map(page, "x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3", 6)
    expect(page).to_have_url(re.compile("job=[0-9a-f]{32}"))
    page.get_by_role("link", name="Open in Explore").click()
    expect(page).to_have_url(re.compile("#/explore"))
    page.go_back()
    all_computed(page, 6)


def test_unreadable_parameters_of_the_url_are_named(page: Page) -> None:
    page.goto("/#/explore?impact.velocity_m_s=fast&speed=3&projectile.mass_kg=15")
    note = page.get_by_role("alert").filter(has_text="Not understood in the address")
    expect(note).to_have_text("Not understood in the address, and left out: impact.velocity_m_s=fast, speed=3.")
    expect(page.get_by_label("Mass")).to_have_value("15")
    page.goto("/#/explore?projectile.mass_kg=14")
    expect(page.get_by_label("Mass")).to_have_value("14")
    expect(note).to_have_count(0)


@pytest.mark.parametrize(
    "part",
    ["projectile.nose.shape=bogus", "resistance.strength_factor.model=bogus", "resistance.free_surface.model=bogus"],
)
@pytest.mark.parametrize("view", ["explore", "critical-angle", "how-sure", "walls", "map"])
def test_unknown_variant_is_replaced_by_the_variant_of_the_paper(page: Page, view: str, part: str) -> None:
    page.goto(f"/#/{view}?{part}")
    note = page.get_by_role("alert").filter(has_text="Not understood in the address")
    expect(note).to_have_text(f"Not understood in the address, and left out: {part}.")
    page.locator("details").evaluate_all("folds => folds.forEach(fold => { fold.open = true; })")
    expect(page.get_by_label("Nose", exact=True)).to_have_value("ogive")
    expect(page.get_by_label("Caliber radius head ψ")).to_have_value("3")
    expect(page.get_by_role("heading", level=1)).to_have_count(1)


@pytest.mark.parametrize(
    ("view", "part"),
    [
        ("map", "x=impact.velocity_m_s,100,300,1000000000"),
        ("how-sure", "scatter=impact.velocity_m_s,bogus,mean:3"),
        ("critical-angle", "offset_deg=far"),
    ],
)
def test_view_ignores_unreadable_parameters(page: Page, view: str, part: str) -> None:
    page.goto(f"/#/{view}?{part}")
    note = page.get_by_role("alert").filter(has_text="Not understood in the address")
    expect(note).to_have_text(f"Not understood in the address, and left out: {part}.")
    expect(page.locator("main .panel").first).to_be_visible()


def test_variant_without_its_numbers_gets_the_numbers_of_its_example(page: Page) -> None:
    page.goto("/#/explore?projectile.nose.shape=conical")
    expect(page.get_by_label("Nose", exact=True)).to_have_value("conical")
    expect(page.locator(".angle")).to_be_visible()
    expect(page).to_have_url(re.compile(r"projectile\.nose\.length_to_diameter=1\.5"))
