"""The first load over a slow line: text and side view come first, plots later, and nothing shifts."""

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import CDPSession, Page, Route, expect

from .conftest import FOLDER, NewPage
from .side_view import IDLE, READY

FORM = "form[aria-label=Case]"
PARTS = (".verdict .head", ".side-view .drawing")
SLOW_BYTES_PER_S = 400_000 / 8
TOP = "part => Math.round(part.getBoundingClientRect().top + scrollY)"


def throttle(session: CDPSession, speed: float) -> None:
    conditions: dict[str, Any] = {
        "offline": False,
        "latency": 40,
        "downloadThroughput": speed,
        "uploadThroughput": speed,
    }
    session.send("Network.emulateNetworkConditions", conditions)


def test_text_of_the_answer_appears_before_the_plots_on_a_slow_line(page: Page) -> None:
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    throttle(session, SLOW_BYTES_PER_S)
    page.goto("/", wait_until="commit")
    expect(page.locator(".angle")).to_have_text("48.6°")
    expect(page.locator("[data-outcome]")).to_contain_text("At 45° from the normal")
    expect(page.locator(READY)).to_be_visible()
    for part in (".angle", "[data-outcome]", READY):
        expect(page.locator("[aria-busy=true]").filter(has=page.locator(part))).to_have_count(0)
    assert page.locator(".histories .drawing").count() == 0, "what draws the plots is not there yet"
    side, histories = page.locator(".side-view"), page.locator(".histories")
    before = [side.evaluate(TOP), histories.evaluate(TOP)]
    assert side.evaluate("part => part.clientHeight") > 250
    expect(page.get_by_label("Spread", exact=True)).to_contain_text("usual scatter")
    places = [side.evaluate(TOP), histories.evaluate(TOP)]
    throttle(session, -1)
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()
    after = [side.evaluate(TOP), histories.evaluate(TOP)]
    assert after[0] == places[0]
    assert abs((after[1] - after[0]) - (before[1] - before[0])) <= 60, "the row of buttons and the scrubber"


def test_first_picture_needs_at_most_a_quarter_of_a_megabyte(page: Page) -> None:
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    sizes: list[float] = []
    session.on("Network.loadingFinished", lambda event: sizes.append(event["encodedDataLength"]))
    throttle(session, SLOW_BYTES_PER_S)  # Files that are not needed yet arrive later.
    page.goto("/", wait_until="commit")
    page.locator(READY).wait_for()
    assert sum(sizes) <= 250_000


def test_document_preloads_every_module_of_the_first_view() -> None:
    """The document names every module, because each level of nested imports would cost a round trip."""
    found: set[Path] = set()

    def follow(module: Path) -> None:
        if module in found:
            return
        found.add(module)
        for name in re.findall(r'from "(\.{1,2}/[\w/.-]+)"', module.read_text()):
            follow((module.parent / name).resolve())

    for module in (FOLDER / "main.js", FOLDER / "views" / "explore.js"):
        follow(module.resolve())
    named = re.findall(r'rel="modulepreload" href="page/([^"]+)"', (FOLDER / "index.html").read_text())
    assert {FOLDER.resolve() / name for name in named} == found - {FOLDER.resolve() / "main.js"}


@pytest.mark.parametrize(
    ("width", "height", "parts"),
    [
        (1440, 900, (*PARTS, FORM)),
        (390, 844, PARTS),
    ],
)
def test_verdict_and_picture_are_above_the_fold(
    new_page: NewPage, width: int, height: int, parts: tuple[str, ...]
) -> None:
    page = new_page(width=width, height=height)
    page.goto("/")
    page.wait_for_function(IDLE)
    for part in parts:
        ratio = 0.5 if part == FORM else 1.0  # The form is longer than any window.
        box = page.locator(part).first.bounding_box()
        assert box is not None
        assert box["y"] >= 0
        assert box["y"] + ratio * min(box["height"], height) <= height, part
    for slider in page.locator("form input[type=range]").all():
        slider.focus()
        expect(slider).to_be_in_viewport()
        expect(page.locator(".side-view .drawing")).to_be_in_viewport(ratio=1.0)


def test_second_load_revalidates_two_files_and_downloads_nothing(page: Page) -> None:
    page.goto("/")
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()
    sizes: dict[str, int] = {}
    kept: set[str] = set()
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")

    def note(event: dict[str, Any]) -> None:
        response = event["response"]
        if response["fromDiskCache"] or event["requestId"] in kept:
            return
        sizes[response["url"]] = response["encodedDataLength"]

    session.on("Network.requestServedFromCache", lambda event: kept.add(event["requestId"]))
    session.on("Network.responseReceived", note)
    page.reload()
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()
    files = {url.rpartition("/")[2]: size for url, size in sizes.items() if "/page/" in url}
    assert files.keys() <= {"contract.json", "plotly.min.js"}
    assert sum(files.values()) < 2000, "headers alone"


@pytest.mark.parametrize("late", ["", "trajectory", "cra", "verdict"])
@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_layout_does_not_shift_while_the_page_loads(new_page: NewPage, width: int, height: int, late: str) -> None:
    """Cumulative layout shift is below 0.05 whichever answer comes last; Core Web Vitals rate up to 0.1 as good."""
    page = new_page(width=width, height=height)
    page.add_init_script("""
        window.shift = 0;
        const add = (list) => list.getEntries().forEach((entry) => (window.shift += entry.value));
        new PerformanceObserver(add).observe({type: "layout-shift", buffered: true});
    """)
    held: list[Route] = []
    if late:
        page.route(f"**/{late}", lambda route: route.continue_() if held else held.append(route))
    page.goto("/")
    if late:
        page.wait_for_timeout(2000.0)  # On an idle machine the other answers arrive meanwhile.
        held[0].continue_()
    page.wait_for_function(IDLE)
    expect(page.get_by_label("Spread", exact=True)).to_contain_text("usual scatter")
    assert page.evaluate("window.shift") < 0.05
