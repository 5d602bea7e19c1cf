"""How long does a step of a slider in the page take, from the event to the new picture, in Chromium?

    python benchmarks/slider.py [--quick] [--steps 100]

The page times itself: each step is a `performance.measure`. All values differ, so none is cached by the service. About
a minute; `--quick` is ten steps.
"""

import argparse
import os
import shutil
import statistics

from playwright.sync_api import Page, expect, sync_playwright

from benchmarks.machine import print_machine, print_table
from benchmarks.servers import service

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
WARM_UP = 10
STEP_M_S = 3.0
PAUSE_MS = 400
"""Between two steps, in which the histories of the step before arrive."""
MEASURES = "performance.getEntriesByName('ricochet: side view').map(entry => entry.duration)"
SLIDE = """async value => {
    const seen = performance.getEntriesByName('ricochet: side view').length;
    const slider = document.querySelector('[aria-label="Speed, slider"]');
    slider.value = value;
    slider.dispatchEvent(new Event('input', {bubbles: true}));
    while (performance.getEntriesByName('ricochet: side view').length === seen) {
        await new Promise(requestAnimationFrame);
    }
}"""


def measure(page: Page, steps: int) -> list[float]:
    """Durations of the steps. [ms]"""
    page.goto("/#/explore")
    expect(page.locator(".side-view .main-svg").first).to_be_visible(timeout=60_000)
    page.wait_for_load_state("networkidle")
    for number in range(WARM_UP + steps):
        page.evaluate(SLIDE, 150.0 + STEP_M_S * number)
        page.wait_for_timeout(PAUSE_MS)
    found: list[float] = page.evaluate(MEASURES)
    return found[-steps:]


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure a step of a slider in the page.")
    parser.add_argument("--quick", action="store_true", help="ten steps")
    parser.add_argument("--steps", type=int, default=100)
    options = parser.parse_args()
    executable = next(filter(None, map(shutil.which, BROWSERS)), None)
    if executable is None:
        raise SystemExit("no browser found: install Chromium")
    print_machine()
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []  # it does not start as root otherwise
    with service() as server, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=executable, args=[OFFLINE, *sandbox])
        page = browser.new_page(base_url=server.url, viewport={"width": 1440, "height": 900})
        times = measure(page, 10 if options.quick else options.steps)
        version = browser.version
        browser.close()
    p95 = statistics.quantiles(times, n=20, method="inclusive")[-1]
    row = [len(times), *(f"{each:.0f} ms" for each in (statistics.median(times), p95, min(times), max(times)))]
    print_table([f"steps, Chromium {version}", "median", "95th percentile", "fastest", "slowest"], [row])


if __name__ == "__main__":
    main()
