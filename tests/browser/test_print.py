"""Printing: every view is black on white, complete and without controls. The report opens in a new tab."""

import re
import shutil
import subprocess
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, ViewportSize, expect

from service.schemas.strike import PAPER
from tests.api.many import ASYNC, LINES, finished, lines, searches

from .conftest import NewPage

VIEWS = ("explore", "critical-angle", "how-sure", "walls", "map", "jobs")
SHEET: ViewportSize = {"width": 703, "height": 1030}
"""Printable area of A4 with margins of 12 mm. [CSS pixels]"""
OVERHANG = """() => [...document.querySelectorAll(".drawing svg, table, .panel")]
  .filter((each) => each.getBoundingClientRect().width > 0)
  .map((each) => [each.className.baseVal ?? each.className, each.getBoundingClientRect().right])
  .filter(([, right]) => right > innerWidth + 1)"""
WIDER = """() => [...document.querySelectorAll("table")]
  .map((each) => [each, each.parentElement].map((part) => part.getBoundingClientRect().right).concat(each.innerText))
  .filter(([right, end]) => right > end + 0.5)"""
"""Tables of a report that are wider than their columns, with the right ends of both. [CSS pixels]"""
DPI = 60
MARGIN_PX = int(11 / 25.4 * DPI)
STUDY = "how-sure?scatter=impact.velocity_m_s,normal,coefficient_of_variation:0.02&sampling.max_samples=512"
FILLED = {
    "explore": ("explore?pin=impact.velocity_m_s%3D300", ".histories .main-svg"),
    "critical-angle": ("critical-angle", ".curves .main-svg"),
    "how-sure": (STUDY, ".tornado .main-svg"),
    "walls": ("walls", "table"),
    "map": ("map", ".map .main-svg"),
    "jobs": ("jobs", "table"),
}
"""Address at which each view has all its parts, and a selector of the part that appears last."""
COLOUR = "() => [document.documentElement, document.body].map((each) => getComputedStyle(each).color)"


@pytest.mark.parametrize("view", VIEWS)
def test_view_prints_black_on_white_without_controls(new_page: NewPage, view: str) -> None:
    page = new_page(theme="dark")
    page.goto(f"/#/{view}")
    expect(page.locator("h1")).to_be_visible()
    expect(page.locator("[aria-busy=true]:visible")).to_have_count(0)
    page.set_viewport_size(SHEET)
    page.emulate_media(media="print", color_scheme="dark")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(COLOUR) == ["rgb(0, 0, 0)"] * 2
    assert page.evaluate("getComputedStyle(document.documentElement).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    assert page.locator("button:visible, header nav:visible, input[type=range]:visible").count() == 0
    assert page.evaluate(OVERHANG) == []
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    printed = page.pdf(prefer_css_page_size=True)
    assert {
        (round(float(w)), round(float(h))) for w, h in re.findall(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", printed)
    } == {(595, 842)}


@pytest.mark.parametrize("view", ["explore", "critical-angle", "how-sure", "walls"])
def test_verdict_comes_before_the_inputs_on_paper(page: Page, view: str) -> None:
    page.goto(f"/#/{view}?target.thickness_m=0.3")
    expect(page.locator(".verdict .outcome")).to_contain_text("from the normal")
    page.set_viewport_size(SHEET)
    page.emulate_media(media="print")
    tops = "all => all.map(each => each.getBoundingClientRect()).filter(({ height }) => height).map(({ top }) => top)"
    verdict, forms = (page.locator(each).evaluate_all(tops) for each in (".verdict > *", "form .field, form.panel"))
    assert max(verdict) < min(forms)


@pytest.mark.parametrize("view", FILLED)
def test_printed_sheets_are_dark_on_white_within_their_margins(
    new_page: NewPage, client: httpx.Client, tmp_path: Path, view: str
) -> None:
    if shutil.which("pdftoppm") is None:
        pytest.skip("no pdftoppm here: install poppler-utils")
    job = client.post("/cra/batch", content=lines(searches(1)), headers=LINES | ASYNC).json()
    finished(client, job)
    address, last = FILLED[view]
    page = new_page(theme="dark")
    page.goto(f"/#/{address}")
    expect(page.locator(last).first).to_be_visible()
    expect(page.locator("[aria-busy=true]:visible")).to_have_count(0)
    page.pdf(path=tmp_path / "view.pdf", prefer_css_page_size=True)
    render = ["pdftoppm", "-r", str(DPI), "-gray", "-png", "view.pdf", "sheet"]
    subprocess.run(render, cwd=tmp_path, check=True)
    words = subprocess.check_output(["pdftotext", "view.pdf", "-"], cwd=tmp_path, text=True)  # noqa: S607
    controls = {"Start from", "Copy this case", "Pin to compare", "Theme", "Cases, pasted or dropped as CSV"}
    assert not controls & set(words.replace(":", "").splitlines())
    sheets = sorted(tmp_path.glob("sheet*.png"))
    assert 1 <= len(sheets) <= 6
    for number, sheet in enumerate(sheets, start=1):
        grey = np.asarray(Image.open(sheet))
        inside = grey[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
        outside = grey.astype(float)
        outside[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = 255
        assert outside.min() >= 250, "nothing is beyond the margins"
        assert np.median(grey) == 255, "the sheet is white"
        ink = np.mean(inside < 128)  # Text, lines and the colours of a map are dark.
        assert (0.002 if number < len(sheets) else 0.0) < ink < 0.35


@pytest.mark.parametrize(("address", "most"), [("walls?impact.oblique_angle_deg=90", 1), ("map", 3)])
def test_no_sheet_has_only_the_footer_or_part_of_a_picture(
    new_page: NewPage, faults: list[str], address: str, most: int
) -> None:
    page = new_page(width=390, height=844)
    page.goto(f"/#/{address}")
    expect(page.locator(".map .main-svg, .field .problem:visible").first).to_be_visible()
    expect(page.locator("[aria-busy=true]:visible")).to_have_count(0)
    assert len(re.findall(rb"/MediaBox", page.pdf(prefer_css_page_size=True))) <= most
    faults.clear()  # The service refuses an angle of 90°.


@pytest.mark.parametrize("units", ["si", "us"])
def test_no_table_of_a_report_on_a_wall_is_wider_than_its_column(
    new_page: NewPage, client: httpx.Client, units: str
) -> None:
    target = PAPER["target"] | {"thickness_m": 0.5, "characteristic_strength_pa": 30e6}
    body = PAPER | {"target": target, "impact": {"velocity_m_s": 300.0, "oblique_angle_deg": 30.0}, "units": units}
    report = client.post("/report", json=body).text
    for medium, width in (("print", 695), ("screen", 1440), ("screen", 1024), ("screen", 820)):
        page = new_page(width=width)
        page.emulate_media(media="print" if medium == "print" else "screen")
        page.set_content(report)
        expect(page.locator("table.design")).to_contain_text("not enough")
        assert page.evaluate(WIDER) == [], (medium, width)


def test_report_opens_in_a_new_tab_with_its_style(page: Page) -> None:
    page.goto("/#/explore?search.lower_deg=44&search.upper_deg=54&search.tolerance_deg=0.5&impact.oblique_angle_deg=50")
    expect(page.locator("[data-outcome]")).to_be_visible()
    with page.expect_popup() as opened:
        page.get_by_role("button", name="Report", exact=True).click()
    report = opened.value
    expect(report.get_by_role("heading", name="Answer")).to_be_visible()
    assert report.url.startswith("blob:")
    expect(report).to_have_title(re.compile("Ricochet assessment, 238 m/s, 39 MPa, 50°"))
    assert report.evaluate("getComputedStyle(document.querySelector('table')).borderCollapse") == "collapse"
    assert report.evaluate("[...document.images].every((each) => each.complete && each.naturalWidth > 0)")
