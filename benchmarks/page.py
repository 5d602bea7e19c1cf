"""A step of a slider in the page, from the event to the new picture, in a real browser: `make slider`.

Writes page.json. The page measures itself: each step is a ``performance.measure``. Values are all different, so that
none is known to the service.
"""

import json
import statistics
from datetime import UTC, datetime
from pathlib import Path

from playwright.sync_api import Page, expect

from benchmarks.machine import machine, versions
from benchmarks.stress.servers import service
from tests.browser.chromium import executable, running_chromium

HERE = Path(__file__).parent
MEASURE = "performance.getEntriesByName('ricochet: side view')"
WARM_UP, STEPS = 10, 100
STEP_M_S = 3.0
SLIDE = """async value => {
    const seen = performance.getEntriesByName('ricochet: side view').length;
    const slider = document.querySelector('[aria-label="Speed, slider"]');
    slider.value = value;
    slider.dispatchEvent(new Event('input', {bubbles: true}));
    while (performance.getEntriesByName('ricochet: side view').length === seen) {
        await new Promise(requestAnimationFrame);
    }
}"""


def steps(page: Page) -> list[float]:
    """Durations of the steps. [ms]"""
    page.goto("/#/explore")
    expect(page.locator(".side-view .main-svg").first).to_be_visible(timeout=60_000)
    page.wait_for_load_state("networkidle")
    for number in range(WARM_UP + STEPS):
        page.evaluate(SLIDE, 150.0 + STEP_M_S * number)
        page.wait_for_timeout(400)  # histories follow; whoever moves a slider step by step waits for them
    found: list[float] = page.evaluate(f"{MEASURE}.map(entry => entry.duration)")
    return found[-STEPS:]


def main() -> None:
    if executable() is None:
        raise SystemExit("no browser here: install Chromium")
    about = {"measured_at": datetime.now(UTC).isoformat(timespec="seconds"), "machine": machine()}
    with service() as server, running_chromium() as browser:
        page = browser.new_page(base_url=f"http://127.0.0.1:{server.port}", viewport={"width": 1440, "height": 900})
        durations = steps(page)
        about["versions"] = versions() | {"browser": browser.version}
    found = {
        "steps": len(durations),
        "median_ms": round(statistics.median(durations), 1),
        "p95_ms": round(statistics.quantiles(durations, n=20)[-1], 1),
        "fastest_ms": round(min(durations), 1),
        "slowest_ms": round(max(durations), 1),
    }
    print(json.dumps(found, indent=1))
    (HERE / "page.json").write_text(json.dumps(about | {"slider_step": found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
