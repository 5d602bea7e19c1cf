"""Helpers that read the side view: its shapes in metres, from the SVG, and its labels."""

from playwright.sync_api import Page

READY = ".side-view svg .moving"
IDLE = """() => document.querySelector('.verdict [data-outcome]')
    && !document.querySelector('.sides > :last-child > :not(details) :is([aria-busy=true]):not(details:not([open]) *)')
    && !document.querySelector('.sides > :last-child > [aria-busy=true]')"""
POINTS = """(drawing, [name, at]) => {
    const d = drawing.querySelectorAll('.' + name)[at].getAttribute('d');
    return [...d.matchAll(/[ML]([^MLZ]+)/g)].map(([, pair]) => pair.trim().split(' ').map(Number));
}"""


def open_explore(page: Page, query: str = "") -> None:
    """Open Explore with this query and wait until every part is up to date."""
    page.goto(f"/#/explore{query}")
    page.wait_for_function(IDLE)


def points(page: Page, name: str, at: int = 0) -> list[list[float]]:
    """Return the coordinates of a shape along the face, and its depths. [m]"""
    pairs: list[list[float]] = page.locator(".side-view .drawing").first.evaluate(POINTS, [name, at])
    return [list(each) for each in zip(*pairs, strict=True)]


def words(page: Page) -> list[str]:
    """Return the labels in the side view, one for each line of text."""
    return page.locator(".side-view .mark tspan").all_text_contents()


def transform(page: Page) -> list[float]:
    """Return the position of the point of contact in the drawing (two numbers), and the scale. [px, px/m]"""
    found: list[float] = page.locator(".side-view .metres").evaluate(
        "drawing => drawing.getAttribute('transform').match(/-?[\\d.]+/g).map(Number)"
    )
    return found
