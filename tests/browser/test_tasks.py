"""The number of actions (clicks, choices, filled fields) that common tasks take."""

import math
import re
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from .conftest import all_computed
from .side_view import IDLE


class Actions:
    """Performs actions of a user on a page, and counts them."""

    def __init__(self) -> None:
        self.count = 0

    def click(self, part: Locator) -> None:
        self.count += 1
        part.click()

    def fill(self, part: Locator, text: str) -> None:
        self.count += 1
        part.fill(text)

    def choose(self, part: Locator, label: str) -> None:
        self.count += 1
        part.select_option(label=label)


@pytest.fixture
def act() -> Actions:
    return Actions()


@pytest.fixture
def explore(page: Page) -> Page:
    """The start page, fully loaded."""
    page.goto("/")
    page.wait_for_function(IDLE)
    return page


def test_critical_angle_of_a_new_body_takes_at_most_six_inputs(explore: Page, act: Actions) -> None:
    act.click(explore.get_by_role("link", name="Cone"))
    values = {"Speed": "250", "Cone height over diameter": "2", "Diameter": "60", "Length": "400", "Mass": "7.2"}
    for label, text in values.items():
        act.fill(explore.get_by_label(label, exact=True), text)
    explore.wait_for_function(IDLE)
    expect(explore.locator(".angle")).to_have_text(re.compile(r"^\d\d\.\d°$"))
    for label, text in values.items():
        expect(explore.get_by_label(label, exact=True)).to_have_value(text)
    assert act.count <= 6


def test_map_of_speed_and_strength_with_downloads_takes_at_most_ten_actions(
    explore: Page, act: Actions, tmp_path: Path
) -> None:
    act.click(explore.get_by_role("link", name="Map", exact=True))
    for side, end in (("Horizontal axis", "300"), ("Vertical axis", "50")):
        axis = explore.get_by_role("group", name=side)
        act.fill(axis.get_by_label("To"), end)
        act.fill(axis.get_by_label("Values"), "12")
    act.click(explore.get_by_role("button", name="Run"))
    all_computed(explore, 144)
    expect(explore.locator("#map-counts")).to_contain_text("144 ")
    for name in ("Download the data of the plot as CSV", "Download the plot as PNG"):
        with explore.expect_download() as download:
            act.click(explore.get_by_role("button", name=name))
        download.value.save_as(tmp_path / download.value.suggested_filename)
    csv, png = sorted(tmp_path.iterdir())
    assert len(csv.read_text().splitlines()) == 3 + 1 + 144
    assert png.read_bytes().startswith(b"\x89PNG")
    assert act.count <= 10


def test_verdict_on_half_a_metre_takes_one_input(explore: Page, act: Actions) -> None:
    explore.get_by_role("link", name="Walls", exact=True).click()
    act.fill(explore.get_by_label("Thickness", exact=True), "500")
    expect(explore.locator(".outcome")).to_contain_text(
        re.compile(r"^Wall of 500\smm at .*: (not )?enough.*Design value against ")
    )
    assert act.count == 1


def test_verdict_on_half_a_metre_against_a_155_mm_body_takes_at_most_four_inputs(explore: Page, act: Actions) -> None:
    act.click(explore.get_by_role("link", name="155 mm body"))
    act.click(explore.get_by_role("link", name="Walls", exact=True))
    act.choose(explore.get_by_label("Concrete class"), "C30/37")
    act.fill(explore.get_by_label("Thickness", exact=True), "500")
    verdict = explore.locator(".outcome")
    expect(verdict).to_contain_text(re.compile(r"^Wall of 500\smm at .*: not enough.*scabbing.*perforation"))
    expect(verdict).to_contain_text("with the characteristic strength of 30 MPa")
    expect(explore.get_by_label("Compressive strength", exact=True)).to_have_value("38")
    assert act.count <= 4


def test_verdict_on_a_wall_against_a_steel_sphere_takes_at_most_four_inputs(explore: Page, act: Actions) -> None:
    act.click(explore.get_by_role("link", name="Steel sphere"))
    act.click(explore.get_by_role("link", name="Walls", exact=True))
    act.fill(explore.get_by_label("Thickness", exact=True), "150")
    expect(explore.locator(".outcome")).to_contain_text(re.compile(r"^Wall of 150\smm at "))
    assert act.count <= 4


def test_steel_sphere_needs_only_another_diameter(explore: Page, act: Actions) -> None:
    act.click(explore.get_by_role("link", name="Steel sphere"))
    expect(explore.get_by_label("Diameter", exact=True)).to_have_value("20")
    expect(explore.get_by_label("Length", exact=True)).to_have_count(0)
    act.fill(explore.get_by_label("Diameter", exact=True), "50")
    mass = explore.get_by_label("Mass", exact=True)
    assert float(mass.input_value()) == pytest.approx(7850.0 * math.pi / 6 * 0.05**3, rel=0.005)
    explore.wait_for_function(IDLE)
    expect(explore).to_have_url(re.compile(r"diameter_m=0\.05&projectile\.length_m=0\.05&projectile\.mass_kg=0\.514&"))
    assert act.count <= 2
    mass.fill("0.6")  # not of steel
    explore.get_by_label("Diameter", exact=True).fill("60")
    expect(mass).to_have_value("0.6")
    explore.wait_for_function(IDLE)
    for _ in range(2):
        explore.get_by_role("button", name="Undo").click()
    expect(explore.get_by_label("Diameter", exact=True)).to_have_value("50")
    expect(mass).to_have_value("0.514")


def test_mass_of_a_steel_sphere_follows_its_diameter_in_us_units(explore: Page) -> None:
    explore.get_by_role("link", name="Steel sphere").click()
    explore.get_by_label("Units").select_option("us")
    explore.get_by_role("button", name="Steel", exact=True).click()
    explore.get_by_label("Diameter", exact=True).fill("2 in")
    mass = float(explore.get_by_label("Mass", exact=True).input_value())
    assert mass == pytest.approx(7850.0 * math.pi / 6 * 0.0508**3 / 0.45359237, rel=0.005)


def test_any_body_becomes_a_sphere_of_its_diameter(explore: Page, act: Actions) -> None:
    act.choose(explore.get_by_label("Nose", exact=True), "Sphere")
    explore.wait_for_function(IDLE)
    expect(explore.get_by_label("Length", exact=True)).to_have_count(0)
    act.choose(explore.get_by_label("Nose", exact=True), "Flat")
    expect(explore.get_by_label("Length", exact=True)).to_have_value("80")


def test_choosing_steel_fills_in_the_mass(explore: Page) -> None:
    explore.get_by_role("link", name="Flat rod").click()
    explore.get_by_label("Length", exact=True).fill("100")
    explore.get_by_role("button", name="Steel", exact=True).click()
    mass = float(explore.get_by_label("Mass", exact=True).input_value())
    assert mass == pytest.approx(7850.0 * math.pi * 0.01**2 * 0.1, rel=0.005)
    explore.wait_for_function(IDLE)
    explore.get_by_role("button", name="Undo").click()
    expect(explore.get_by_label("Mass", exact=True)).to_have_value("0.49")


def test_comparison_of_two_strikes_takes_at_most_three_actions(explore: Page, act: Actions) -> None:
    act.click(explore.get_by_role("button", name="Pin to compare"))
    act.fill(explore.get_by_label("Oblique angle", exact=True), "55")
    comparison = explore.get_by_role("region", name="Comparison")
    expect(comparison.get_by_role("row", name="Oblique angle [°] 55 45")).to_be_visible()
    expect(comparison.get_by_role("row", name="Outcome ricochet embedded")).to_be_visible()
    assert act.count <= 3


def test_spread_for_ten_per_cent_in_the_strength_factor_takes_at_most_two_actions(explore: Page, act: Actions) -> None:
    act.click(explore.get_by_role("link", name="How sure, input by input"))
    factor = explore.get_by_role("group", name="Factor on the strength factor")
    with explore.expect_request(lambda request: request.url.endswith("/cra/uncertainty")):  # No click is needed.
        act.fill(factor.get_by_label("Scale"), "0.1")
    expect(explore.locator("#study-progress")).to_have_text("Done.")
    expect(explore.locator(".range")).to_have_text(re.compile(r"\d"))
    assert act.count <= 2


def test_three_hundred_cases_from_a_table_take_at_most_three_actions(page: Page, act: Actions) -> None:
    page.goto("/#/jobs")
    rows = [f"{200 + i},{30 + i % 7 * 5}" for i in range(300)]
    act.fill(page.get_by_label("Cases, pasted or dropped as CSV"), "\n".join(["velocity_m_s,oblique_angle_deg", *rows]))
    act.click(page.get_by_role("button", name="Compute"))
    row = page.get_by_role("row").filter(has_text="300 ×").first
    expect(row).to_contain_text("300 of 300")
    with page.expect_download() as download:
        act.click(row.get_by_role("button", name="CSV"))
    assert len(download.value.path().read_text().splitlines()) == 1 + 300
    assert act.count <= 3


def test_report_takes_at_most_one_action(page: Page, act: Actions) -> None:
    page.goto("/#/explore?search.lower_deg=44&search.upper_deg=54&search.tolerance_deg=0.5")
    with page.expect_popup() as opened:
        act.click(page.get_by_role("button", name="Report", exact=True))
    expect(opened.value.get_by_role("heading", name="Answer")).to_be_visible()
    assert act.count <= 1
