"""The choice of units holds for what the service writes too: reports and sentences."""

import re

from playwright.sync_api import Page, expect

from tests.quantities_in_texts import SI

COARSE = "search.lower_deg=44&search.upper_deg=54&search.tolerance_deg=0.5"


def test_report_is_in_the_units_of_the_page(page: Page) -> None:
    page.goto(f"/#/explore?{COARSE}&impact.oblique_angle_deg=50&target.thickness_m=1")
    page.get_by_label("Units").select_option("US")
    expect(page.locator("[data-outcome]")).to_be_visible()
    with page.expect_popup() as opened:
        page.get_by_role("button", name="Report", exact=True).click()
    report = opened.value
    expect(report).to_have_title(re.compile("Ricochet assessment, 780.8 ft/s, 5656 psi, 50°, 39.37 in"))
    expect(report.locator(".design caption")).to_have_text("Design values of the wall [in]")
    assert SI.findall(report.locator("main").inner_text()) == []
