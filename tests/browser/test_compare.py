"""Comparison of pinned strikes: in the picture, the plots, the table and the address."""

import re
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from service.schemas.strike import PAPER_AT_45

from .conftest import NewPage, expected
from .downloads import data_rows
from .side_view import IDLE, open_explore, points


def pin(page: Page) -> None:
    page.get_by_role("button", name="Pin to compare").click()


def speed(page: Page) -> Locator:
    return page.get_by_label("Speed", exact=True)


def table(page: Page) -> dict[str, list[str]]:
    rows = page.get_by_role("region", name="Comparison").locator("tbody tr")
    return {row.locator("th").inner_text(): row.locator("td").all_inner_texts() for row in rows.all()}


def traces(page: Page, plot: str) -> list[Any]:
    found: list[Any] = page.locator(f".{plot} .drawing").evaluate(
        "plot => plot.data.filter(({ meta }) => meta !== undefined).map(({ meta, name, y }) => [meta, name, [...y]])"
    )
    return found


def test_pinned_strike_is_compared_with_the_next_strike(page: Page, client: httpx.Client) -> None:
    open_explore(page)
    pin(page)
    speed(page).fill("300")
    comparison = page.get_by_role("region", name="Comparison")
    expect(comparison).to_contain_text("Speed [m/s]")
    page.wait_for_function(IDLE)

    angles, depths, tips = [], [], []
    for velocity in (300.0, 238.0):
        impact = PAPER_AT_45["impact"] | {"velocity_m_s": velocity}
        run = client.post("/trajectory", json=PAPER_AT_45 | {"impact": impact}).json()
        depths.append(1e3 * run["maximum_depth_m"])
        tips.append(1e3 * max(run["history"]["nose_tip_depth_m"]))
        searched = {name: part for name, part in PAPER_AT_45.items() if name != "impact"}
        found = client.post("/cra", json=searched | {"impact": {"velocity_m_s": velocity}}).json()
        angles.append(found["critical_angle_deg"])
    shown = table(page)
    assert shown["Speed [m/s]"] == ["300", "238"]
    assert "Mass [kg]" not in shown
    assert shown["Critical angle [°]"] == [f"{angles[0]:.2f}", f"{angles[1]:.2f} (−{angles[0] - angles[1]:.2f})"]
    assert shown["Greatest depth [mm]"] == [f"{depths[0]:.1f}", f"{depths[1]:.1f} (−{depths[0] - depths[1]:.1f})"]

    assert [1e3 * max(points(page, "path", at)[1]) for at in (0, 1)] == pytest.approx(tips, rel=1e-4)
    assert {meta for meta, *_ in traces(page, "histories")} == {0, 1}
    expect(page.locator(".side-view .legend")).to_have_text(["This strike", "A"])


def test_pinned_strike_stays_when_own_shots_are_entered(page: Page) -> None:
    open_explore(page)
    pin(page)
    page.get_by_role("link", name="Enter own shots").click()
    expect(page.get_by_label("Shots: speed, depth")).to_be_focused()
    page.keyboard.insert_text("238, 323")
    expect(page.get_by_role("region", name="Comparison")).to_contain_text("1 own shot:")
    assert len(table(page)["Outcome"]) == 2


def test_own_shots_are_compared_in_words_and_rounding_errors_as_zero(page: Page) -> None:
    own = "resistance.strength_factor.model=own_tests&resistance.strength_factor.shots="
    shots = '[{"velocity_m_s":250,"depth_m":0.012},{"velocity_m_s":300,"depth_m":0.015}]'
    sphere = "projectile.nose.shape=sphere&projectile.diameter_m=0.02&projectile.mass_kg=0.0329"
    page.goto(f"/#/explore?{sphere}&impact.oblique_angle_deg=0&target.thickness_m=0.1&{own}{quote(shots)}")
    pin(page)
    page.get_by_label("Shots: speed, depth").fill("250, 12")
    speed(page).fill("300")
    expect(page.get_by_role("region", name="Comparison")).to_contain_text("1 own shot:")
    rows = table(page)
    assert [" ".join(text.split()) for text in rows["Shots: speed, depth"]] == [
        "1 own shot: 250 m/s, 12 mm",
        "2 own shots: 250 m/s, 12 mm; 300 m/s, 15 mm",
    ]
    assert rows["Axis angle at the end [°]"] == ["0.0", "0.0 (+0.0)"]
    page.get_by_label("Strength factor", exact=True).select_option("obliquity_polynomial")
    page.get_by_label(re.compile("^Coefficients")).fill("8, 0.01")
    expect(page.get_by_role("row", name=re.compile("^Coefficients.* 8, 0.01 -"))).to_be_visible()


def test_pinned_strikes_are_stored_in_the_url(page: Page, new_page: NewPage) -> None:
    open_explore(page)
    for value in ("300", "260", "200"):
        pin(page)
        speed(page).fill(value)
    expect(page.get_by_role("button", name="Pinned: 3, the most")).to_be_disabled()
    page.wait_for_function(IDLE)
    expect(page).to_have_url(re.compile("(pin=.*){3}"))
    shown = table(page)
    assert shown["Speed [m/s]"] == ["200", "238", "300", "260"]
    other = new_page(theme="dark")
    other.goto(page.url)
    other.wait_for_function(IDLE)
    assert table(other) == shown
    expect(other.get_by_role("alert").filter(has_text="Not understood")).to_have_count(0)
    other.get_by_role("button", name="Remove B").click()
    other.wait_for_function(IDLE)
    assert table(other)["Speed [m/s]"] == ["200", "238", "260"]
    other.get_by_role("link", name="Open A").click()
    expect(speed(other)).to_have_value("238")
    other.wait_for_function(IDLE)
    assert table(other)["Speed [m/s]"] == ["238", "260", "200"]


def test_preset_is_compared_with_pinned_strikes(page: Page) -> None:
    open_explore(page)
    pin(page)
    page.get_by_role("link", name="155 mm body").click()
    expect(page.get_by_label("Diameter", exact=True)).to_have_value("155")
    page.wait_for_function(IDLE)
    assert table(page)["Diameter [mm]"] == ["155", "80"]


def test_downloads_of_a_comparison_contain_all_strikes(page: Page, tmp_path: Path) -> None:
    open_explore(page, "?impact.velocity_m_s=300&pin=")
    for plot in ("side-view", "histories"):
        with page.expect_download() as download:
            page.locator(f".{plot}").get_by_role("button", name="Download the data of the plot as CSV").click()
        assert "compared" in download.value.suggested_filename
        download.value.save_as(tmp_path / f"{plot}.csv")
        rows = data_rows(tmp_path / f"{plot}.csv")
        assert {row["run"] for row in rows} == {"This strike", "A"}
        assert "# A: {" in (tmp_path / f"{plot}.csv").read_text()


def test_unreadable_pinned_strike_is_named(page: Page) -> None:
    page.goto("/#/explore?pin=impact.velocity_m_s%3Dfast")
    expect(page.get_by_role("alert").filter(has_text="Not understood")).to_contain_text("pin=impact.velocity_m_s=fast")


def test_pinned_strike_refused_by_the_service_is_left_out(page: Page, faults: list[str]) -> None:
    page.goto("/#/explore?pin=projectile.length_m%3D0.05")
    words = page.get_by_text("A pinned strike was not accepted, and is left out")
    expect(words).to_have_count(1)
    page.wait_for_function(IDLE)
    assert "pin" not in page.url
    expected(faults, "422")
