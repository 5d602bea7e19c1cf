"""Time that a step of a slider takes, from its event until Chromium shows the new picture and the right angle.

    python benchmarks/slider.py [--quick]

The times are measured in the page. All values differ, so the service has no answer cached. Takes about a minute;
`--quick` does ten steps.
"""

import argparse
import os
import shutil
import statistics
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
from playwright.sync_api import Browser, Page, expect, sync_playwright

from benchmarks.machine import print_machine, print_table
from benchmarks.servers import service
from service.schemas.strike import PAPER

OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
SLIDE = """async value => {
    const pictures = () => performance.getEntriesByName('ricochet: side view');
    const slider = document.querySelector('[aria-label="Speed, slider"]');
    const [seen, start, shown] = [pictures().length, performance.now(), []];
    slider.value = value;
    slider.dispatchEvent(new Event('input', {bubbles: true}));
    while (pictures().length === seen || !shown.length || performance.now() < start + 500) {
        const angle = document.querySelector('.angle:not([aria-busy=true] *)')?.textContent;
        if (angle && angle !== shown.at(-1)?.[0]) shown.push([angle, performance.now() - start]);
        await new Promise(requestAnimationFrame);
    }
    return [pictures().at(-1).duration, shown];
}"""


def step(page: Page, url: str, speed: float) -> tuple[float, float, int]:
    """Move the slider; return the times [ms] until picture and right angle, and the number of unmarked wrong angles."""
    picture, shown = page.evaluate(SLIDE, speed)
    answer = httpx.post(f"{url}/cra", json=PAPER | {"impact": {"velocity_m_s": speed}}, trust_env=False).json()
    times = [time for angle, time in shown if angle == f"{answer['critical_angle_deg']:.1f}°"]
    return picture, times[0], len(shown) - len(times)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run the browser during the block, without a window and without access to other machines."""
    executable = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if executable is None:
        raise SystemExit("no browser found: install Chromium")
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []  # As root, Chromium does not start with its sandbox.
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=executable, args=[OFFLINE, *sandbox])
        yield browser
        browser.close()


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the time of a step of a slider in the page.")
    parser.add_argument("--quick", action="store_true", help="measure ten steps")
    steps = 10 if parser.parse_args().quick else 100
    print_machine()
    with service() as server, chromium() as browser:
        page = browser.new_page(base_url=server.url, viewport={"width": 1440, "height": 900})
        page.goto("/#/explore")
        expect(page.locator(".side-view .drawing svg").first).to_be_visible(timeout=60_000)
        page.wait_for_load_state("networkidle")
        found = [step(page, server.url, 150.0 + 3.0 * number) for number in range(10 + steps)][10:]  # Ten warm up.
        head = [f"{steps} steps, Chromium {browser.version}", "median", "95th percentile", "slowest"]
    rows = []
    for name, times in zip(("side view", "right angle"), list(zip(*found, strict=True))[:2], strict=True):
        figures = statistics.median(times), statistics.quantiles(times, n=20, method="inclusive")[-1], max(times)
        rows.append([name, *(f"{each:.0f} ms" for each in figures)])
    print_table(head, rows)
    print(f"wrong angles without a mark: {sum(wrong for *_, wrong in found)}")


if __name__ == "__main__":
    main()
