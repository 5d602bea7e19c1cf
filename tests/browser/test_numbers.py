"""Numbers typed into fields, and the format of numbers shown."""

import re

import pytest
from playwright.sync_api import Page, expect

from .side_view import IDLE, open_explore

NOISE = re.compile(r"\d[eE][-−+]?\d|[-−]0(\.0+)?(?![\d.])|\d\.\d*?(0000|9999)\d")


@pytest.mark.parametrize(("typed", "shown"), [("2,500", "2500"), ("1,200", "1200"), ("1,200 mm", "1200")])
def test_comma_before_three_digits_separates_thousands_with_a_note(page: Page, typed: str, shown: str) -> None:
    open_explore(page)
    thickness = page.get_by_label("Thickness")
    thickness.fill(typed)
    group = page.locator(".field", has=thickness)
    bare = typed.removesuffix(" mm")
    expect(group.locator(".understood")).to_have_text(
        f"{bare} is read as {shown}; for a fraction type {bare.replace(',', '.')}"
    )
    expect(page).to_have_url(re.compile(f"thickness_m={float(shown) / 1000:g}"))
    thickness.press("Tab")
    expect(thickness).to_have_value(shown)
    thickness.fill("250,5")
    expect(group.locator(".understood")).to_have_text("")
    expect(page).to_have_url(re.compile("thickness_m=0.2505"))


@pytest.mark.parametrize(
    ("label", "field", "word"),
    [("Thickness", "target.thickness_m", "∞"), ("Crater depth", "resistance.crater.depth_diameters", "None")],
)
def test_placeholder_of_an_empty_field_may_be_typed(page: Page, label: str, field: str, word: str) -> None:
    open_explore(page, f"?{field}=0.9")
    page.get_by_label(label).fill(word)
    page.wait_for_function(IDLE)
    expect(page.get_by_label(label)).not_to_have_attribute("aria-invalid", "true")
    expect(page).not_to_have_url(re.compile(re.escape(field)))
    page.get_by_label(label).press("Tab")
    expect(page.get_by_label(label)).to_have_value("")


BROKEN = """() => {
    const texts = document.createTreeWalker(document.querySelector('main'), NodeFilter.SHOW_TEXT);
    const found = [];
    while (texts.nextNode())
        if (!texts.currentNode.parentElement.closest('svg, pre')) found.push(texts.currentNode.data);
    return found.filter((text) => /\\d (%|°|kg|m\\/s|([km]?m|m?s|[MG]?Pa|k?N|k?J|in|ft|[pk]si)\\b)/.test(text));
}"""
"""Script that returns the texts in which a line may break between a number and its unit, except in pictures and in code
to copy."""


@pytest.mark.parametrize("view", ["explore", "critical-angle", "how-sure", "walls"])
def test_numbers_stay_on_one_line_with_their_units(page: Page, view: str) -> None:
    page.goto(f"/#/{view}?target.thickness_m=0.3&impact.oblique_angle_deg=56")
    expect(page.locator(".verdict")).to_contain_text("Wall of 300 mm")
    expect(page.locator(".verdict [aria-busy=true]")).to_have_count(0)
    assert page.evaluate(BROKEN) == []


def test_rounding_errors_are_not_shown(page: Page) -> None:
    for angle in ("0", "45", "89.9"):
        open_explore(page, f"?impact.oblique_angle_deg={angle}")
        page.locator(".histories .scatterlayer .trace").first.wait_for()
        words = page.locator("main").inner_text()
        ticks = page.locator(".histories [class^='y'][class$='tick'] text").all_text_contents()
        assert ticks
        assert [each for each in [*words.splitlines(), *ticks] if NOISE.search(each)] == []
