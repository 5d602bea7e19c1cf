"""What the side view shows: shapes in metres, as its SVG has them, and words."""

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
    """Show a strike and wait until all of it is there."""
    page.goto(f"/#/explore{query}")
    page.wait_for_function(IDLE)


def points(page: Page, name: str, at: int = 0) -> list[list[float]]:
    """Places of a shape along the face and in depth, each a list. [m]"""
    pairs: list[list[float]] = page.locator(".side-view .drawing").first.evaluate(POINTS, [name, at])
    return [list(each) for each in zip(*pairs, strict=True)]


def words(page: Page) -> list[str]:
    """Texts of what is marked, line by line."""
    return page.locator(".side-view .mark tspan").all_text_contents()


def transform(page: Page) -> list[float]:
    """Place of the contact in the drawing, and the scale. [px, px/m]"""
    found: list[float] = page.locator(".side-view .metres").evaluate(
        "drawing => drawing.getAttribute('transform').match(/-?[\\d.]+/g).map(Number)"
    )
    return found
