"""The first load over a slow line: words first, pictures later, nothing moves."""

from typing import Any

from playwright.sync_api import CDPSession, Page, expect

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


def test_answer_in_words_comes_before_the_plots_on_a_slow_line(page: Page) -> None:
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    throttle(session, SLOW_BYTES_PER_S)
    page.goto("/", wait_until="commit")
    expect(page.locator(".angle")).to_have_text("48.63°")
    expect(page.get_by_text("The projectile digs in and stays.")).to_be_visible()
    for part in (".angle", "[data-outcome]"):
        expect(page.locator("[aria-busy=true]").filter(has=page.locator(part))).to_have_count(0)
    assert page.locator(".drawing").count() == 0, "what draws the plots is not there yet"
    side, histories = page.locator(".side-view"), page.locator(".histories")
    before = [side.evaluate(TOP), histories.evaluate(TOP)]
    assert side.evaluate("part => part.clientHeight") > 250
    expect(page.get_by_role("group", name="Spread")).to_contain_text("searches")
    places = [side.evaluate(TOP), histories.evaluate(TOP)]
    throttle(session, -1)
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()
    after = [side.evaluate(TOP), histories.evaluate(TOP)]
    assert after[0] == places[0]
    assert abs((after[1] - after[0]) - (before[1] - before[0])) <= 60, "the row of buttons and the scrubber"


def test_second_load_fetches_nothing_anew(page: Page) -> None:
    page.goto("/")
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()
    statuses: dict[str, int] = {}
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    session.on(
        "Network.responseReceived",
        lambda event: statuses.update({event["response"]["url"]: event["response"]["encodedDataLength"]}),
    )
    page.reload()
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()
    files = {url: size for url, size in statuses.items() if "/page/" in url}
    assert any(url.endswith("contract.json") for url in files)
    assert any(url.endswith("plotly.min.js") for url in files)
    assert sum(files.values()) < 100_000, "headers alone"
