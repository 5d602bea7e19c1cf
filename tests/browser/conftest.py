"""Fixtures that open pages of the shared service in a real browser, the installed Chromium."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from .chromium import NAMES, executable, running_chromium

HERE = Path(__file__).parent
WAIT_MS = 180_000
"""Time limit for each expected change of a page, long enough for a loaded machine. [ms]"""
FOLDER = HERE.parents[1] / "service" / "page"
NewPage = Callable[..., Page]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium for the tests of one file; other files may run an event loop in the same thread."""
    if executable() is None:
        pytest.skip(f"no browser here: none of {', '.join(NAMES)}")
    expect.set_options(timeout=WAIT_MS)
    with running_chromium() as chromium:
        yield chromium


@pytest.fixture
def faults() -> list[str]:
    """Errors recorded in the pages of a test; the test removes those it expects, and fails if any are left."""
    return []


@pytest.fixture
def new_page(browser: Browser, live_url: str, faults: list[str]) -> Iterator[NewPage]:
    """Return a function that opens a page in a new browser session and records its errors until the test ends.

    A new page is blank; `page.goto("/")` opens the service.
    """
    contexts = []

    def open_page(
        *, width: int = 1440, height: int = 900, theme: Literal["light", "dark"] = "light", address: str = live_url
    ) -> Page:
        context = browser.new_context(
            base_url=address,
            viewport={"width": width, "height": height},
            color_scheme=theme,
            reduced_motion="reduce",
        )
        contexts.append(context)
        context.set_default_timeout(WAIT_MS)
        page = context.new_page()
        watch(page, address, faults)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not faults, "\n".join(faults)


@pytest.fixture
def page(new_page: NewPage) -> Page:
    """A blank page in a wide window, with light colours preferred."""
    return new_page()


def expected(faults: list[str], text: str) -> None:
    """Check that there are recorded errors and that all of them contain this text; then clear them."""
    assert faults
    assert all(text in fault for fault in faults), faults
    faults.clear()


def unfold(page: Page) -> None:
    """Unfold the section "Laws" of the form, unless it is open because a law differs from the paper's."""
    summary = page.get_by_text("Laws", exact=True)
    summary.wait_for()
    if page.locator("details[data-name=Laws]").get_attribute("open") is None:
        summary.click()


def run_map(page: Page, query: str, count: int) -> None:
    """Open a map with this query, run it, and wait until all of its `count` cases are computed."""
    page.goto(f"/#/map?{query}")
    page.get_by_role("button", name="Run").click()
    all_computed(page, count)


def all_computed(page: Page, count: int) -> None:
    """Wait until the map reports that all of its `count` cases are computed."""
    expect(page.locator("#map-progress")).to_have_text(f"All {count} cases are computed.")


def watch(page: Page, address: str, faults: list[str]) -> None:
    """Record every error of the page, and every request to another server."""

    def hear(message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            faults.append(f"console {message.type}: {message.text} ({message.location['url']})")

    page.on("console", hear)
    page.on("pageerror", lambda error: faults.append(f"page error: {error}"))
    page.on("request", lambda request: faults.extend(left(request.url, address)))


def left(url: str, address: str) -> list[str]:
    """Return a list with an error if a request goes to another server, otherwise an empty list."""
    inside = url.startswith((f"{address}/", "data:", "blob:"))
    return [] if inside else [f"request that leaves the service: {url}"]
