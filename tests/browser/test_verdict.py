"""The verdict is visible beside the form, states each fact once, labels its strip, and takes one line on the map."""

import json
import re
from collections.abc import Iterator
from itertools import combinations
from typing import Any
from urllib.parse import urlencode

import httpx
import pytest
from playwright.sync_api import Locator, Page, Route, expect

from tests.api.calibrations import answered
from tests.odd_strikes import KINDS, odd_strikes

from .conftest import NewPage, expected

SIZES = ((1440, 900), (1024, 768), (768, 1024), (390, 844))
WALL = "target.thickness_m=0.5&impact.velocity_m_s=300&impact.oblique_angle_deg=50"
HEAD = ".verdict > .head"
NARROW_PX = 960
"""Width of the window up to which only one line of the verdict stays at its upper edge. [px]"""
LINE_PX = 60
"""Upper limit of the height of one framed line of text. [px]"""


def judged(page: Page) -> Locator:
    """Return the head of the verdict once it shows the answer of the service."""
    head = page.locator(HEAD)
    expect(head).to_contain_text("90 % range")
    expect(page.locator(".verdict [aria-busy=true]")).to_have_count(0)
    return head


def boxes(parts: Locator) -> list[dict[str, float]]:
    """Return the bounding boxes of parts, relative to the window. [px]"""
    found: list[dict[str, float]] = parts.evaluate_all("all => all.map(each => each.getBoundingClientRect().toJSON())")
    return found


@pytest.mark.parametrize("view", ["explore", "critical-angle", "how-sure", "walls", "map"])
def test_verdict_stays_visible_at_every_width(page: Page, view: str) -> None:
    page.goto(f"/#/{view}?{WALL}")
    head = page.locator(HEAD)
    expect(head.locator(".outcome")).to_contain_text("50° from the normal")
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        is_narrow = width <= NARROW_PX
        staying = page.locator(".verdict > .sticky") if is_narrow and view != "map" else head
        for share in (0.3, 0.6):
            page.evaluate("share => scrollTo(0, share * (document.documentElement.scrollHeight - innerHeight))", share)
            expect(staying).to_be_in_viewport(ratio=1.0)
        assert boxes(staying)[0]["height"] < (LINE_PX if is_narrow else 0.4 * height)
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_verdict_states_each_fact_once(page: Page) -> None:
    page.goto(f"/#/explore?{WALL}")
    card, strip = judged(page).locator(".outcome"), page.locator(f"{HEAD} .strip")
    words, angle = card.inner_text().replace("\N{NO-BREAK SPACE}", " "), page.locator(".angle").inner_text()
    for fact in (angle, "probability", "Critical angle", "90 % range", "Wall of 500 mm"):
        assert words.count(fact) == 1, f"{fact}: {words}"
    expect(strip).not_to_contain_text(angle)
    strong, rest = card.locator("strong").first, card.locator(".rest")
    assert boxes(rest)[0]["top"] >= boxes(strong)[0]["bottom"] - 1


def test_bold_line_is_the_verdict_on_the_wall(page: Page) -> None:
    held: list[Route] = []
    page.route("**/verdict", lambda route: route.continue_() if held else held.append(route))
    page.goto(f"/#/explore?{WALL}")
    bold = page.locator(".outcome > strong")
    expect(bold).to_have_text(
        re.compile(r"^At 50° from the normal, with the inputs as given: .*; the wall is not judged yet\.$")
    )
    while not held:  # The verdict is requested last.
        page.wait_for_timeout(50)
    held[0].continue_()
    expect(bold).to_have_text(re.compile(r"^Wall of 500\smm at 50° from the normal: not enough against scabbing"))
    expect(page.locator(".outcome .rest")).to_have_text(re.compile("^At 50° from the normal.*Critical angle"))
    expect(page.locator(".notes > p").first).to_have_text(re.compile("^Design value against scabbing"))


def with_few_angles(route: Route) -> None:
    """Answer a request for a verdict as if a quarter of the samples had no critical angle."""
    answer = route.fetch()
    found = answer.json() | {"share_without_angle": 0.25}
    found["sentence"] = found["sentence"].replace(", 90 %", ", 25 % of the samples without one from 5° to 85°, 90 %")
    found["sentence"] = found["sentence"].replace("90 % range", "90 % range of the others")
    route.fulfill(response=answer, json=found)


def test_range_of_some_samples_is_named_so_everywhere(page: Page) -> None:
    shots = "resistance.strength_factor.model=own_tests&resistance.strength_factor.shots="
    page.route("**/verdict", with_few_angles)
    page.goto(f'/#/explore?{shots}[{{"velocity_m_s":250,"depth_m":0.31}}]')
    head = judged(page)
    expect(head.locator(".strip text.band")).to_have_text("90 % range of the others")
    label = re.compile("25 % of the samples without one, 90 % range of the others [0-9.]+° to")
    expect(head.get_by_role("img", name=label)).to_be_visible()
    expect(page.locator(".spread")).to_contain_text("25\N{NO-BREAK SPACE}% of the samples have no critical angle.")
    expect(page.locator(".spread")).to_contain_text("90\N{NO-BREAK SPACE}% range of the others: usual scatter")
    of_range = page.get_by_label("Own depth tests", exact=True).locator("tr", has_text="range")
    expect(of_range.locator("td").last).to_contain_text("% of the samples without one, of the others")
    page.unroute("**/verdict")
    page.route("**/verdict", lambda _: None)  # it stays without an answer, so the range is that of the previous angle
    page.get_by_label("Oblique angle", exact=True).fill("46")
    pending = re.compile(r"Critical angle [\d.]+°, 25\s% of the samples without one, 90\s% range of the others \d+° to")
    expect(page.locator(".outcome")).to_contain_text(pending)


@pytest.mark.parametrize("status", [500, 503])
@pytest.mark.parametrize(("case", "subject"), [("", "the strike"), (WALL, "the wall")])
def test_verdict_that_failed_says_why(page: Page, faults: list[str], status: int, case: str, subject: str) -> None:
    problem = {"title": "No verdict", "status": status, "detail": "The disk of the service is full."}
    page.route("**/verdict", lambda route: route.fulfill(status=status, json=problem))
    page.goto(f"/#/explore?{case}")
    bold = page.locator(".outcome > strong")
    expect(bold).to_have_text(re.compile(f"; {subject} could not be judged: The disk of the service is full\\.$"))
    expect(page.locator(".problem:visible").first).to_contain_text("The disk of the service is full.")
    expect(page.locator(".verdict [aria-busy=true]")).to_have_count(0)
    page.unroute("**/verdict")
    page.get_by_label("Oblique angle", exact=True).fill("51")
    judged(page)
    expect(page.locator(".outcome")).not_to_contain_text("could not be judged")
    expected(faults, str(status))


def test_theory_is_told_apart_from_the_same_decay_with_the_chosen_strength_factor(page: Page) -> None:
    page.goto("/#/explore")
    expect(judged(page).locator(".strip text.theory")).to_have_text(re.compile(r"^Mohr-Coulomb [\d.]+° with its S$"))
    page.get_by_text("Under other laws", exact=True).first.click()
    expect(page.locator(".laws-table")).to_contain_text("Mohr-Coulomb there has its own S over the angle")


def test_little_of_a_phone_is_covered_while_a_field_is_used(new_page: NewPage) -> None:
    page = new_page(width=390, height=844)
    page.goto(f"/#/explore?{WALL}")
    judged(page)
    worst = page.locator(".warnings > summary")
    assert worst.evaluate("each => each.scrollWidth <= each.clientWidth"), "the first warning is not cut"
    slider = page.get_by_label("Speed, slider")
    slider.focus()
    under = """y => document.elementFromPoint(200, y)?.closest('.verdict, .picture') !== null"""
    assert page.evaluate(under, 100), "the picture is in view"
    assert not page.evaluate(under, 0.4 * 844)
    page.get_by_label("Angular velocity").focus()
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")
    field, helped = boxes(page.locator(":focus"))[0], boxes(page.locator(".field:focus-within .help"))[0]
    assert field["bottom"] <= helped["top"]
    assert field["top"] >= boxes(page.locator(".verdict > .sticky"))[0]["bottom"]


def test_each_strength_factor_names_its_angle(page: Page) -> None:
    shots = '[{"velocity_m_s":250,"depth_m":0.31},{"velocity_m_s":300,"depth_m":0.42}]'
    page.goto(f"/#/explore?resistance.strength_factor.model=own_tests&resistance.strength_factor.shots={shots}")
    judged(page)
    page.get_by_text("What the range stands for").click()
    words = page.locator("main").inner_text()
    for place in ("this oblique angle", "the critical angle", "0°"):
        assert f"S at {place}" in words
    assert re.findall(r"(?:[Ss]trength factor|\bS)[: ]+\d[\d.]*", words) == []


def fields_of(part: dict[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and value of each field of a case, as in the address of a view."""
    for name, value in part.items():
        if isinstance(value, dict):
            yield from fields_of(value, f"{before}{name}.")
        else:
            yield before + name, value if isinstance(value, str) else json.dumps(value)


def check_sentence(page: Page, client: httpx.Client, body: dict[str, Any]) -> None:
    """Compare the verdict that the page shows on a strike with the sentence of the service."""
    found = answered(client, "/verdict", body)
    page.goto("about:blank")
    page.goto(f"/#/explore?{urlencode(dict(fields_of(body)))}")
    verdict = page.locator(".verdict")
    shown = verdict.locator(".outcome > strong, .outcome .rest, .notes > p:first-child")
    expect(verdict.locator(".spread")).to_contain_text("usual scatter of")
    expect(verdict.locator("[aria-busy=true]")).to_have_count(0)
    words = " ".join(filter(None, (each.strip() for each in shown.all_inner_texts())))
    assert words.replace("\N{NO-BREAK SPACE}", " ") == found["sentence"], body


OF_THE_PAGE = [kind for kind in KINDS if kind != "no_angle"]
"""Kinds of strikes that the page can show; it always has an oblique angle."""


@pytest.mark.timeout(900)
@pytest.mark.parametrize("kind", OF_THE_PAGE)
def test_sentence_equals_the_sentence_of_the_service(page: Page, client: httpx.Client, kind: str) -> None:
    check_sentence(page, client, odd_strikes(len(KINDS), seed=5)[KINDS.index(kind)])


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_sentence_on_odd_strikes_equals_the_sentence_of_the_service(
    page: Page, client: httpx.Client, faults: list[str]
) -> None:
    page.set_default_timeout(600_000)
    for number, body in enumerate(odd_strikes(60, seed=6)):
        if KINDS[number % len(KINDS)] in OF_THE_PAGE:
            check_sentence(page, client, body)
    # The page learns from a refusal how many instants a very slow strike may have, and requests it again.
    faults[:] = [each for each in faults if not ("422" in each and each.endswith("/trajectory)"))]


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("case", ["", "impact.oblique_angle_deg=48.6", "impact.oblique_angle_deg=5", WALL])
def test_labels_of_the_strip_do_not_overlap_or_overflow(new_page: NewPage, width: int, case: str) -> None:
    page = new_page(width=width)
    page.goto(f"/#/critical-angle?{case}")
    strip = judged(page).locator(".strip svg")
    labels, frame = boxes(strip.locator("text")), boxes(strip)[0]
    for one, other in combinations(labels, 2):
        beside = one["right"] <= other["left"] or other["right"] <= one["left"]
        above = one["bottom"] <= other["top"] + 3 or other["bottom"] <= one["top"] + 3
        assert beside or above, (one, other)
    beyond = [each for each in labels if each["left"] < frame["left"] - 1 or each["right"] > frame["right"] + 1]
    assert beyond == [], frame
    leaders = boxes(strip.locator("line.leader"))
    for leader, label in zip(leaders, labels[-len(leaders) :], strict=True):
        assert label["left"] - 4 < leader["left"] < label["right"] + 4, "each label touches its own leader"
    for leader in leaders:
        for each in labels:
            beside = not each["left"] + 1 < leader["left"] < each["right"] - 1
            assert beside or leader["bottom"] <= each["top"] + 3 or each["bottom"] <= leader["top"] + 3, (leader, each)


def test_verdict_line_on_the_map_begins_with_the_wall(page: Page) -> None:
    page.goto(f"/#/map?{WALL}")
    line = page.locator(f"{HEAD} .line")
    expect(line).to_have_text(re.compile(r"^Wall not enough against scabbing( and perforation)?; \w+ at 50° \("))


def test_verdict_line_on_the_map_begins_with_the_answer(page: Page) -> None:
    page.goto("/#/map")
    line = page.locator(f"{HEAD} .line")
    expect(line).to_have_text(re.compile(r"^Embedded at 45° \(ricochet \d+\s%\), critical angle 48\.\d+°$"))
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        answer_ends, line_ends = line.evaluate(
            """line => {
                const answer = document.createRange();
                answer.setStart(line.firstChild, 0);
                answer.setEnd(line.firstChild, line.textContent.indexOf(','));
                return [answer, line.parentElement].map((each) => each.getBoundingClientRect().right);
            }"""
        )
        assert answer_ends <= line_ends, "the answer is not cut"


def test_verdict_line_on_the_map_can_be_unfolded(page: Page) -> None:
    page.goto("/#/map")
    head = page.locator(HEAD)
    expect(head).to_contain_text("At 45° from the normal")
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        assert boxes(head)[0]["height"] < LINE_PX
    strip = head.locator(".strip svg[aria-label^='Your angle']")
    expect(strip).to_be_hidden()
    head.locator("summary").first.click()
    expect(strip).to_be_visible()
    expect(head.get_by_text("What the range stands for")).to_be_visible()
