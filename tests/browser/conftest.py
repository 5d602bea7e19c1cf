"""A real browser, the distribution's Chromium, in front of the service that the tests share."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from .chromium import NAMES, executable, running_chromium

HERE = Path(__file__).parent
WAIT_MS = 180_000
"""For what a test expects to see; a loaded machine takes its time."""
FOLDER = HERE.parents[1] / "service" / "page"
NewPage = Callable[..., Page]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium, for one file: tests of others have event loops of their own."""
    if executable() is None:
        pytest.skip(f"no browser here: none of {', '.join(NAMES)}")
    expect.set_options(timeout=WAIT_MS)
    with running_chromium() as chromium:
        yield chromium


@pytest.fixture
def faults() -> list[str]:
    """What went wrong in the pages of a test; it takes out what it expects, the rest fails it."""
    return []


@pytest.fixture
def new_page(browser: Browser, live_url: str, faults: list[str]) -> Iterator[NewPage]:
    """Open pages, each with a session of its own, that are watched until the test has ended.

    They start at no address; `page.goto("/")` leads to the service.
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
    """A page of a wide window in light colours."""
    return new_page()


def expected(faults: list[str], text: str) -> None:
    """Take out what went wrong as a test expects: all of it has this text, and there is some."""
    assert faults
    assert all(text in fault for fault in faults), faults
    faults.clear()


def unfold(page: Page) -> None:
    """Open the laws of the form, which stand open already where they differ from the paper's."""
    summary = page.get_by_text("Laws", exact=True)
    summary.wait_for()
    if page.locator("details[data-name=Laws]").get_attribute("open") is None:
        summary.click()


def run_map(page: Page, query: str, count: int) -> None:
    """Run a map at this address, and wait for its cases."""
    page.goto(f"/#/map?{query}")
    page.get_by_role("button", name="Run").click()
    all_computed(page, count)


def all_computed(page: Page, count: int) -> None:
    """Wait for so many cases of a map."""
    expect(page.locator("#map-progress")).to_have_text(f"All {count} cases are computed.")


def watch(page: Page, address: str, faults: list[str]) -> None:
    """Record every error of the page, and every request that leaves the service."""

    def hear(message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            faults.append(f"console {message.type}: {message.text} ({message.location['url']})")

    page.on("console", hear)
    page.on("pageerror", lambda error: faults.append(f"page error: {error}"))
    page.on("request", lambda request: faults.extend(left(request.url, address)))


def left(url: str, address: str) -> list[str]:
    """Return the fault of a request to another place than the service."""
    inside = url.startswith((f"{address}/", "data:", "blob:"))
    return [] if inside else [f"request that leaves the service: {url}"]
