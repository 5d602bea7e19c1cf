"""Speed of the page: reload with a warm cache on a slow line, layout shift, slider, verdict on a wall, and map.

    python -m benchmarks.page

Measured in Chromium, against a service with two workers on the same machine. Takes about a minute.
"""

from time import perf_counter

from playwright.sync_api import Page, expect

from benchmarks.machine import print_machine, print_table
from benchmarks.servers import service
from benchmarks.slider import chromium

SLOW_LINE = {"offline": False, "latency": 400, "downloadThroughput": 50_000, "uploadThroughput": 50_000}
"""Network conditions of the slow line in Chromium: latency 400 ms, 400 kbit/s."""
OBSERVE = """
window.shift = 0;
window.tasks = [];
const seen = (type, add) =>
    new PerformanceObserver((list) => list.getEntries().forEach(add)).observe({type, buffered: true});
seen("layout-shift", (entry) => { if (!entry.hadRecentInput) window.shift += entry.value; });
seen("longtask", (entry) => window.tasks.push(entry.duration));
"""
SHOWN = """() => [".angle:not([aria-busy=true] *)", ".outcome"].every(
    (part) => document.querySelector(part)?.textContent)"""
SLIDE = """async (value) => {
    const slider = document.querySelector('[aria-label="Speed, slider"]');
    slider.value = value;
    slider.dispatchEvent(new Event("input", {bubbles: true}));
    await new Promise((next) => setTimeout(next, 400));
}"""
PROBABILITY = """(speed) => document.querySelector('#field-impact-velocity_m_s')?.value === speed
    && /probability/.test(document.querySelector(".outcome:not([aria-busy=true] *)")?.textContent)"""
WALL = "/#/explore?target.thickness_m=0.5&impact.velocity_m_s="
MAP = "/#/map?x=impact.velocity_m_s,100,400,60&y=projectile.mass_kg,8,20,60"


def reloaded(page: Page) -> float:
    """Return the time from a reload on a slow line until the page shows the angle and the verdict. [s]"""
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    session.send("Network.emulateNetworkConditions", SLOW_LINE)
    page.reload(wait_until="commit")
    page.wait_for_function(SHOWN)
    seconds: float = page.evaluate("performance.now() / 1000")
    session.send("Network.emulateNetworkConditions", {**SLOW_LINE, "latency": 0, "downloadThroughput": -1})
    return seconds


def longest_task(page: Page) -> float:
    """Return the duration of the page's longest task since the last call. [ms]"""
    found: float = page.evaluate("Math.max(0, ...window.tasks.splice(0))")
    return found


def main() -> None:
    print_machine()
    with service() as server, chromium() as browser:
        page = browser.new_page(base_url=server.url, viewport={"width": 1440, "height": 900})
        page.add_init_script(OBSERVE)
        page.goto("/#/explore")
        page.wait_for_load_state("networkidle")
        shift = page.evaluate("window.shift")
        rows = [["warm reload, 400 kbit/s and 400 ms", f"{reloaded(page):.2f} s", "2 s"]]
        rows.append(["layout shift of a first load", f"{shift:.3f}", "0.05"])
        page.wait_for_load_state("networkidle")
        longest_task(page)
        for number in range(20):
            page.evaluate(SLIDE, 150.0 + 7.0 * number)
        rows.append(["longest task of 20 steps of a slider", f"{longest_task(page):.0f} ms", "100 ms"])
        times = []
        for number in range(3):
            page.goto(f"{WALL}{231 + number}")
            begun = perf_counter()
            page.wait_for_function(PROBABILITY, arg=str(231 + number), timeout=120_000)
            times.append(perf_counter() - begun)
        rows.append(["probability of a wall, slowest of 3", f"{max(times):.1f} s", "5 s"])
        page.goto(MAP)
        longest_task(page)
        page.get_by_role("button", name="Run").click()
        begun = perf_counter()
        expect(page.locator("#map-progress")).to_have_text("All 3600 cases are computed.", timeout=300_000)
        rows.append(["map of 60 by 60", f"{perf_counter() - begun:.1f} s", "15 s"])
        rows.append(["its longest task", f"{longest_task(page):.0f} ms", "200 ms"])
    print_table(["page", "measured", "aim"], rows)


if __name__ == "__main__":
    main()
