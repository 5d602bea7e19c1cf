"""The choice of units also applies to texts from the service: reports and sentences."""

import re

import httpx
from playwright.sync_api import Page, expect

from service.schemas.strike import PAPER
from solver.units import PSI
from tests.quantities_in_texts import SI

from .conftest import NewPage

COARSE = "search.lower_deg=44&search.upper_deg=54&search.tolerance_deg=0.5"


def test_report_uses_the_units_of_the_page(page: Page) -> None:
    page.goto(f"/#/explore?{COARSE}&impact.oblique_angle_deg=50&target.thickness_m=1")
    page.get_by_label("Units").select_option("US")
    expect(page.locator("[data-outcome]")).to_be_visible()
    with page.expect_popup() as opened:
        page.get_by_role("button", name="Report", exact=True).click()
    report = opened.value
    expect(report).to_have_title(re.compile("Ricochet assessment, 780.8 ft/s, 5656 psi, 50°, 39.37 in"))
    expect(report.locator(".design caption")).to_have_text("Design values of the wall [in]")
    assert SI.findall(report.locator("main").inner_text()) == []


def test_sentences_and_warnings_use_the_units_shown(page: Page, client: httpx.Client) -> None:
    page.goto("/#/walls?impact.oblique_angle_deg=30&target.thickness_m=0.4")
    page.get_by_label("Units").select_option("US")
    body = PAPER | {
        "target": PAPER["target"] | {"thickness_m": 0.4},
        "impact": PAPER["impact"] | {"oblique_angle_deg": 30.0},
        "units": "us",
    }
    expect(page.locator(".outcome")).to_contain_text(client.post("/wall", json=body).json()["sentence"])
    expect(page.locator("[aria-busy=true]")).to_have_count(0)
    warnings = page.locator(".warnings li").all_text_contents()
    assert any("formulas within their range require" in each for each in warnings)
    texts = [*warnings, page.locator("main .pictures").inner_text()]
    assert [found for each in texts for found in SI.findall(each)] == []


def test_verdict_on_a_strike_uses_the_units_shown(page: Page) -> None:
    page.goto(f"/#/explore?{COARSE}&impact.oblique_angle_deg=55")
    page.get_by_label("Units").select_option("US")
    expect(page.locator(".outcome")).to_contain_text("Lands about")
    expect(page.locator(".outcome")).to_contain_text(" ft at any elevation")
    assert SI.findall(page.get_by_role("region", name="Verdict").inner_text()) == []


def test_default_in_an_empty_field_uses_the_units_shown(page: Page) -> None:
    page.goto("/#/explore")
    field = page.get_by_label("Yield strength of the body")
    expect(field).to_have_attribute("placeholder", "1200")
    page.get_by_label("Units").select_option("US")
    expect(field).to_have_attribute("placeholder", f"{1.2e9 / PSI:.0f}")


def test_link_keeps_the_units_of_its_sender(new_page: NewPage) -> None:
    page = new_page()
    page.goto("/#/walls?target.thickness_m=0.4")
    page.get_by_label("Units").select_option("US")
    expect(page).to_have_url(re.compile("units=us"))
    other = new_page()
    other.goto(page.url)
    expect(other.get_by_label("Units")).to_have_value("us")
    expect(other.locator(".outcome")).to_contain_text("Wall of 15.75 in")
    expect(other.locator(".unread")).to_have_count(0)
    other.get_by_label("Units").select_option("SI")
    expect(other.locator(".outcome")).to_contain_text("Wall of 400 mm")
    assert "units" not in other.url
    other.goto(f"{page.url.replace('units=us', 'units=imperial')}")
    expect(other.locator(".unread")).to_contain_text("units=imperial")
