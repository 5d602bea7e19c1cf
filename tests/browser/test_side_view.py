"""The side view: turning the projectile by dragging or by keys, and the labels."""

import math
import re
from itertools import combinations

import pytest
from playwright.sync_api import Locator, Page, expect

from .conftest import NewPage
from .side_view import IDLE, open_explore, points, transform, words

PAPER_ANGLE_DEG = 48.63


def handle(page: Page) -> Locator:
    return page.get_by_role("slider", name="Oblique angle, in the side view")


def centre(part: Locator) -> tuple[float, float]:
    box = part.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def contact(page: Page) -> tuple[float, float]:
    """Return the position in the window where the projectile touches the face. [px]"""
    box = page.locator(".side-view .drawing").bounding_box()
    assert box is not None
    along, down, _ = transform(page)
    return box["x"] + along, box["y"] + down


def drag(page: Page, degrees: float, distance: float = 150.0) -> None:
    """Move the pointer to a point at this angle from the normal and this distance from the point of contact. [°, px]"""
    x, y = contact(page)
    angle = math.radians(degrees)
    page.mouse.move(x - distance * math.sin(angle), y - distance * math.cos(angle), steps=3)


def test_projectile_can_be_dragged_through_the_critical_angle(page: Page) -> None:
    open_explore(page)
    outcome = page.locator("[data-outcome]")
    expect(outcome).to_have_attribute("data-outcome", "embedded")
    handle(page).scroll_into_view_if_needed()
    page.mouse.move(*centre(handle(page)))
    page.mouse.down()
    before = transform(page)
    for degrees in (47.0, 50.0, 60.0):
        drag(page, degrees)
        field = page.get_by_label("Oblique angle", exact=True)
        expect(field).to_have_value(re.compile(rf"^{degrees - 0.5:.0f}\.[5-9]|^{degrees:.0f}(\.[0-5])?$"))
        is_above = float(field.input_value()) > PAPER_ANGLE_DEG
        expect(outcome).to_have_attribute("data-outcome", "ricochet" if is_above else "embedded")
        assert transform(page) == before, "the picture stays below the pointer"
    page.mouse.up()
    page.wait_for_function(IDLE)
    expect(handle(page)).to_have_attribute("aria-valuetext", re.compile(r"° from the normal: ricochet"))
    expect(page).to_have_url(re.compile("oblique_angle_deg="))
    x, y = contact(page)
    at = centre(handle(page))
    angle = float(handle(page).get_attribute("aria-valuenow") or "")
    assert abs(math.degrees(math.atan2(x - at[0], y - at[1])) - angle) < 0.5
    assert angle == float(page.get_by_label("Oblique angle, slider").input_value())


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
def test_picture_does_not_move_while_the_projectile_is_dragged(new_page: NewPage, size: tuple[int, int]) -> None:
    page = new_page(width=size[0], height=size[1])
    open_explore(page)
    handle(page).scroll_into_view_if_needed()
    page.mouse.move(*centre(handle(page)))
    page.mouse.down()
    before = contact(page)
    for degrees in (46.0, 60.0, 75.0):
        drag(page, degrees, distance=60.0)
        page.wait_for_function(IDLE)  # The verdict may now take more or fewer lines.
        assert contact(page) == before
    page.mouse.up()
    for part in page.locator(".verdict > *").all():
        expect(part).not_to_have_attribute("style", re.compile("height"))
        assert part.evaluate("element => element.scrollHeight <= element.clientHeight"), "no word is cut off"


def test_keys_turn_the_projectile(page: Page) -> None:
    open_explore(page)
    handle(page).focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowLeft")
    expect(page.get_by_label("Oblique angle", exact=True)).to_have_value("45.9")
    page.keyboard.press("PageUp")
    expect(page.locator("[data-outcome]")).to_have_attribute("data-outcome", "ricochet")
    page.keyboard.press("End")
    expect(page.get_by_label("Oblique angle", exact=True)).to_have_value("89.9")
    expect(page.locator("[data-outcome]")).to_contain_text("At 89.9°")
    expect(handle(page)).to_be_focused()
    page.keyboard.press("Home")
    expect(page.locator("[data-outcome]")).to_have_attribute("data-outcome", "embedded")


def test_angles_faces_and_exit_are_labelled(page: Page) -> None:
    open_explore(page, "?impact.oblique_angle_deg=55&impact.angle_of_attack_deg=3")
    assert {"θ = 55°", "φ = 58°", "δ = 3°", "face"} <= set(words(page))
    critical = page.locator(".angle").inner_text()
    assert f"critical {critical}" in words(page)
    assert any(re.fullmatch(r"exit \d+ m/s", each) for each in words(page))
    assert any(re.fullmatch(r"[\d.]+° from the face", each) for each in words(page))
    page.get_by_label("Angle of attack").fill("0")
    page.wait_for_function(IDLE)
    assert "θ = φ = 55°" in words(page)
    assert "rear face" not in words(page)


SPHERE = "projectile.nose.shape=sphere&projectile.diameter_m=0.02&projectile.mass_kg=0.0329"


def test_stress_of_rounding_errors_is_not_marked(page: Page) -> None:
    straight = "impact.velocity_m_s=250&impact.oblique_angle_deg=0&target.thickness_m=0.1"
    open_explore(page, f"?{SPHERE}&{straight}")
    assert not any("bends" in word for word in words(page)), words(page)
    page.get_by_label("Oblique angle", exact=True).fill("30")
    page.wait_for_function(IDLE)
    assert any(re.fullmatch(r"bends most: \d+\sMPa", word) for word in words(page)), words(page)


def test_perforated_wall_has_a_hole_through_to_its_rear_face(page: Page) -> None:
    open_explore(page, "?target.thickness_m=0.2&impact.oblique_angle_deg=20&impact.velocity_m_s=300")
    assert {"face", "rear face"} <= set(words(page))
    along, depth = points(page, "hole")
    assert min(depth) == pytest.approx(0.0, abs=1e-12)
    assert max(depth) == pytest.approx(0.2)
    across = [x for x, y in zip(along, depth, strict=True) if abs(y - 0.2) < 1e-9]
    assert 0.08 < max(across) - min(across) < 0.16, "a shank of 80 mm went through at a slant"
    for thickness in ("", "5000"):  # The rear face is absent, or far outside the picture.
        page.get_by_label("Thickness").fill(thickness)
        page.wait_for_function(IDLE)
        assert "rear face" not in words(page)


def test_picture_stays_visible_while_a_slider_moves_on_a_phone(new_page: NewPage) -> None:
    page = new_page(width=390, height=844)
    open_explore(page)
    slider = page.get_by_label("Oblique angle, slider")
    slider.focus()
    box = slider.bounding_box()
    assert box is not None
    picture = page.locator(".side-view .drawing")
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + box["height"] / 2, steps=4)
    expect(picture).to_be_in_viewport(ratio=1.0)
    expect(picture).to_have_attribute("aria-label", re.compile("ricochet"))
    page.mouse.up()
    expect(picture).to_be_in_viewport(ratio=1.0)
    box_after = slider.bounding_box()
    assert box_after is not None
    assert abs(box_after["y"] - box["y"]) < 1, "the slider stays below the finger"


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
@pytest.mark.parametrize(
    "query", ["", "?impact.oblique_angle_deg=10", "?impact.oblique_angle_deg=60&target.thickness_m=0.5"]
)
def test_labels_of_force_and_bending_do_not_cover_the_body(
    new_page: NewPage, size: tuple[int, int], query: str
) -> None:
    page = new_page(width=size[0], height=size[1])
    open_explore(page, query)
    covered = page.locator(".side-view .drawing").evaluate(
        """(drawing) => {
            const body = drawing.querySelector('.moving');
            const toBody = body.getScreenCTM().inverse();
            const isCovered = ({ left, top, width, height }) => Array.from({ length: 33 }, (_, i) =>
                [left + (width * (i % 11)) / 10, top + (height * Math.floor(i / 11)) / 2])
                .some(([x, y]) => body.isPointInFill(new DOMPoint(x, y).matrixTransform(toBody)));
            const words = [...drawing.querySelectorAll('text.mark')];
            const loads = words.filter((each) => /^(force|bends)/.test(each.textContent));
            return loads.map((each) => [each.textContent, isCovered(each.getBoundingClientRect())]);
        }"""
    )
    assert covered
    assert not any(is_covered for _, is_covered in covered), covered


@pytest.mark.parametrize("query", ["explore", "explore?pin=impact.velocity_m_s%3D300", "critical-angle"])
def test_keys_of_the_colours_fit_a_phone_without_overlap(new_page: NewPage, query: str) -> None:
    page = new_page(width=390, height=844)
    page.goto(f"/#/{query}")
    pictures = page.locator(".side-view .drawing > svg")
    expect(pictures.locator(".moving").last).to_be_visible()
    for picture in pictures.all():
        texts = picture.locator(":is(.caption, .legend), .key")
        places = texts.evaluate_all("all => all.map(each => each.getBoundingClientRect().toJSON())")
        assert picture.locator(".key").count() == 2
        frame = picture.evaluate("each => each.getBoundingClientRect().toJSON()")
        assert all(each["left"] >= frame["left"] and each["right"] <= frame["right"] for each in places)
        for one, other in combinations(places, 2):
            beside = one["right"] <= other["left"] or other["right"] <= one["left"]
            assert beside or one["bottom"] <= other["top"] + 3 or other["bottom"] <= one["top"] + 3, (one, other)
