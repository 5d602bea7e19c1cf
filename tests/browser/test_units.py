"""The choice of units also applies to texts from the service: reports and sentences."""

import re

import httpx
import pytest
from playwright.sync_api import Page, expect

from service.schemas.strike import PAPER
from solver.units import PSI
from tests.quantities_in_texts import SI

from .conftest import NewPage, expected

COARSE = "search.lower_deg=44&search.upper_deg=54&search.tolerance_deg=0.5"


def test_report_uses_the_units_of_the_page(page: Page) -> None:
    page.goto(f"/#/explore?{COARSE}&impact.oblique_angle_deg=50&target.thickness_m=1")
    page.get_by_label("Units").select_option("US")
    expect(page.locator("[data-outcome]")).to_be_visible()
    with page.expect_popup() as opened:
        page.get_by_role("button", name="Report", exact=True).click()
    report = opened.value
    expect(report).to_have_title(re.compile("Ricochet assessment, 780.8 ft/s, 5656 psi, 50°, 39.37 in"))
    expect(report.locator(".design caption")).to_have_text(
        "Design values of the wall [in], for the mean strength of 5656 psi"
    )
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


def test_results_have_no_more_digits_than_the_texts_of_the_service(page: Page) -> None:
    page.goto("/#/explore?enter=shots&units=us")
    example = page.get_by_label("Shots: speed, depth").get_attribute("placeholder")
    assert example == "none yet, as in\n820 ft/s, 12.2 in\n984 ft/s, 16.5 in"
    page.goto("/#/explore?units=us")
    mark = page.locator(".side-view text.mark", has_text="bends most")
    expect(mark).to_be_visible()
    shown = (mark.text_content() or "").removeprefix("bends most: ").replace(" ", "\N{NO-BREAK SPACE}")
    expect(page.locator(".warnings li[data-code=bends]")).to_contain_text(f"Its surface yields in bending: {shown},")


def test_default_in_an_empty_field_uses_the_units_shown(page: Page) -> None:
    page.goto("/#/explore")
    field = page.get_by_label("Yield strength of the body")
    expect(field).to_have_attribute("placeholder", "1200")
    page.get_by_label("Units").select_option("US")
    expect(field).to_have_attribute("placeholder", f"{1.2e9 / PSI:.0f}")


NOSE = 0.132665
"""Length of the nose of the paper's projectile. [m]"""
OUT_OF_RANGE = [
    ("Length", "mm", "50", rf"Length must be at least the length of the nose, {1e3 * NOSE:g}\smm, got 50\smm"),
    ("Length", "in", "2", rf"Length must be at least the length of the nose, {NOSE / 0.0254:.6g}\sin, got 2\sin"),
    ("Young's modulus", "GPa", "0.05", r"Young's modulus must be greater than 0.0585\sGPa .* got 0.05\sGPa"),
    ("Young's modulus", "ksi", "8", r"Young's modulus must be greater than 8.485\sksi .* got 8\sksi"),
    ("Compressive strength", "MPa", "2000", r"Compressive strength must be at most 1000\sMPa"),
    ("Compressive strength", "psi", "200000", r"Compressive strength must be at most 145,038\spsi"),
    ("Speed", "m/s", "20000", r"Speed must be at most 10,000\sm/s"),
    ("Speed", "ft/s", "50000", r"Speed must be at most 32,808.4\sft/s"),
]
"""Label, unit and invalid value of a field, and the message that the page or the service gives for it."""


@pytest.mark.parametrize(("label", "unit", "value", "words"), OUT_OF_RANGE)
def test_bounds_are_in_the_unit_of_their_field(
    page: Page, faults: list[str], label: str, unit: str, value: str, words: str
) -> None:
    is_us = unit in ("in", "ksi", "psi", "ft/s")
    page.goto(f"/#/explore?{COARSE}")
    page.get_by_label("Units").select_option("US" if is_us else "SI")
    expect(page.locator("[data-outcome]")).to_be_visible()
    field = page.get_by_label(label, exact=True)
    field.fill(value)
    expect(field).to_have_accessible_description(re.compile(words))
    problem = page.locator(".problem:visible")
    expect(problem).to_have_count(1)
    assert len(re.findall(re.escape(label), problem.inner_text())) == 1
    if is_us:
        assert SI.findall(problem.inner_text()) == []
    if faults:  # the page itself refuses what is outside the bounds of the contract
        expected(faults, "422")


@pytest.mark.parametrize(("system", "value", "words"), [("SI", "45", r"39\sMPa"), ("US", "6000", r"5656\.47\spsi")])
def test_bounds_of_distributions_are_in_the_unit_of_their_field(
    page: Page, faults: list[str], system: str, value: str, words: str
) -> None:
    page.goto(f"/#/how-sure?{COARSE}&scatter=target.compressive_strength_pa,truncated_normal")
    page.get_by_label("Units").select_option(system)
    expect(page.get_by_role("region", name="Verdict")).to_contain_text("90 % range")
    strength = page.get_by_role("group", name="Compressive strength")
    strength.get_by_label("Coefficient of variation").fill("12")
    strength.get_by_label("Lower").fill(value)
    page.get_by_role("button", name="Run").click()
    lower = strength.get_by_label("Lower")
    expect(lower).to_have_accessible_description(re.compile(rf"must be below the mean, {words}"))
    expected(faults, "422")


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
