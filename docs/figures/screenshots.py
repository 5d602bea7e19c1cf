"""Start a service and take screenshots of its page: every view, wide and narrow, light and dark.

They are written to build/screenshots. The views in `SHOWN` are also written to docs/figures.
"""

from pathlib import Path
from typing import Literal

from playwright.sync_api import Browser, Page, expect

from benchmarks.servers import service
from tests.browser.chromium import executable, running_chromium

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / "screenshots"
SHOWN = {
    "explore-1440-light": ("explore.png", 1440),
    "walls-1440-light": ("walls.png", 1240),
    "map-outcomes-1440-light": ("map.png", 1320),
}
"""Screenshots for README and manual: file name, and height of the part that is shown. [px]"""
SIZES = {1440: 900, 390: 844}
THEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
MAP = "x=impact.velocity_m_s,150,450,30&y=target.compressive_strength_pa,20000000,60000000,30"
OUTCOMES = "operation=trajectory&x=impact.oblique_angle_deg,20,75,23&y=impact.velocity_m_s,100,500,21"
PROBABILITY = "operation=probability&x=impact.velocity_m_s,150,450,9&y=impact.oblique_angle_deg,30,70,9"
WALL = (
    "projectile.nose.caliber_radius_head=2.5&projectile.diameter_m=0.155&projectile.length_m=0.7&projectile.mass_kg=43"
    "&impact.velocity_m_s=300&impact.oblique_angle_deg=45&target.compressive_strength_pa=38000000"
    "&target.characteristic_strength_pa=30000000&target.thickness_m=0.5"
)
VIEWS = {
    "explore": "explore",
    "critical-angle": "critical-angle",
    "how-sure": "how-sure",
    "walls": f"walls?{WALL}",
    "compare": "explore?impact.oblique_angle_deg=55&pin=&pin=projectile.mass_kg%3D16",
    "map": f"map?{MAP}",
    "map-outcomes": f"map?{OUTCOMES}",
    "map-probability": f"map?{PROBABILITY}",
    "jobs": "jobs",
}
WAIT_MS = 180_000


def fill(page: Page, view: str) -> None:
    """Start the computation of a view, if it has a button for that, and wait until the view is complete."""
    if view.startswith("map"):
        page.get_by_role("button", name="Run").click()
        expect(page.locator("#map-progress")).to_contain_text("cases are computed")
    if view == "how-sure":
        expect(page.locator("#study-progress")).to_have_text("Done.")
    last = "table" if view in ("jobs", "walls") else ".drawing .main-svg"
    expect(page.locator(last).first).to_be_visible()
    expect(page.locator(".sides > :last-child [aria-busy=true]:visible")).to_have_count(0)
    if view == "map-outcomes":  # The range of the critical angle takes longer than the cells.
        expect(page.locator("#status")).to_contain_text("shows the 90 % range")
    page.wait_for_load_state("networkidle")
    page.wait_for_timeout(1000)  # The last plot is still being drawn.


def take(browser: Browser, address: str, width: int, theme: Literal["light", "dark"]) -> None:
    """Take a screenshot of each view with this width [px] and theme."""
    context = browser.new_context(
        base_url=address,
        viewport={"width": width, "height": SIZES[width]},
        color_scheme=theme,
        reduced_motion="reduce",
        locale="en-GB",
        timezone_id="UTC",
    )
    context.set_default_timeout(WAIT_MS)
    for view, place in VIEWS.items():
        page = context.new_page()
        page.goto(f"/#/{place}")
        fill(page, view)
        name = f"{view}-{width}-{theme}"
        page.screenshot(path=FOLDER / f"{name}.png", full_page=True)
        if name in SHOWN:
            file, height = SHOWN[name]
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_timeout(500)
            page.screenshot(path=Path(__file__).with_name(file))
        page.close()
        print(f"took {name}", flush=True)
    context.close()


def main() -> None:
    if executable() is None:
        raise SystemExit("no browser here: install Chromium")
    FOLDER.mkdir(parents=True, exist_ok=True)
    expect.set_options(timeout=WAIT_MS)
    with service() as server, running_chromium() as browser:
        for width in SIZES:
            for theme in THEMES:
                take(browser, server.url, width, theme)


if __name__ == "__main__":
    main()
