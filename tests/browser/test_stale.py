"""No number stands beside inputs that it does not belong to, unless it is marked."""

import json
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, Route, expect

from service.schemas.strike import PAPER

from .side_view import IDLE

SPEEDS = (260.0, 310.0, 345.5, 238.0)
WATCH = """() => {
    window.seen = [];
    window.watch = setInterval(() => {
        const angle = document.querySelector('.angle');
        const outcome = document.querySelector('.side-view svg') && document.querySelector('[aria-label=Outcome]');
        const isMarked = (part) => Boolean(part.closest('[aria-busy=true]'));
        const speed = document.getElementById('field-impact-velocity_m_s').value;
        if (angle) window.seen.push([speed, 'angle', angle.textContent, isMarked(angle)]);
        if (outcome) window.seen.push([speed, 'outcome', outcome.textContent, isMarked(outcome)]);
    }, 20);
}"""


def open_view(page: Page, view: str = "explore") -> None:
    page.goto(f"/#/{view}")
    page.wait_for_function(IDLE)


def speed(page: Page) -> Any:
    return page.get_by_label("Speed", exact=True)


def test_number_that_is_not_of_the_inputs_shown_is_marked(page: Page, client: httpx.Client) -> None:
    open_view(page)
    page.evaluate(WATCH)
    for value in SPEEDS:
        speed(page).fill(str(value))
        page.wait_for_timeout(60)  # the second half of them changes before the answer is there
    page.wait_for_function(IDLE)
    for value in SPEEDS[:2]:
        speed(page).fill(str(value))
        page.wait_for_function(IDLE)
        page.wait_for_timeout(60)
    seen = page.evaluate("() => { clearInterval(window.watch); return window.seen; }")
    angles = {}
    for value in SPEEDS:
        body = PAPER | {"impact": {"velocity_m_s": value}}
        angles[value] = f"{client.post('/cra', json=body).json()['critical_angle_deg']:.1f}°"
    unmarked = {(float(value), text) for value, what, text, marked in seen if what == "angle" and not marked}
    assert unmarked <= {(value, angles[value]) for value in SPEEDS}
    assert len(unmarked) >= 3
    outcomes: dict[str, set[str]] = {}
    for value, what, text, marked in seen:
        if what == "outcome" and not marked:
            outcomes.setdefault(value, set()).add(text)
    assert len(outcomes) >= 3
    assert all(len(texts) == 1 for texts in outcomes.values()), outcomes
    assert any(marked for *_, marked in seen)


def test_field_that_is_not_accepted_takes_the_numbers_away(page: Page) -> None:
    open_view(page)
    speed(page).fill("-5")
    expect(page.locator(".angle")).to_have_count(0)
    expect(page.locator("[data-outcome]")).to_have_count(0)
    picture = page.locator(".side-view.cleared[aria-busy=true]")  # of the inputs before
    expect(picture.locator(".drawing")).to_be_visible()
    expect(page.locator("#status")).to_have_text("A field is not accepted. Nothing is computed.")
    speed(page).fill("250")
    page.wait_for_function(IDLE)
    expect(picture).to_have_count(0)
    expect(page.locator(".side-view .drawing")).to_be_visible()
    expect(page.get_by_label("Instant")).to_be_visible()
    expect(page.locator("#status")).to_have_text("Up to date.")


def test_lost_service_is_said_beside_the_picture_and_tried_again(page: Page, faults: list[str]) -> None:
    open_view(page)
    before = page.locator(".angle").inner_text()
    lost = [0]

    def lose(route: Route) -> None:
        lost[0] += 1
        route.abort()

    for path in ("**/cra", "**/verdict", "**/trajectory"):
        page.route(path, lose)
    speed(page).fill("300")
    panel = page.locator(".panel", has=page.locator(".side-view"))
    expect(panel.get_by_role("alert")).to_contain_text("The service does not answer.")
    expect(page.locator("[aria-busy=true]").filter(has=page.locator(".angle"))).to_have_count(1)
    for path in ("**/cra", "**/verdict", "**/trajectory"):
        page.unroute(path)
    expect(page.locator(".angle")).not_to_have_text(before)
    page.wait_for_function(IDLE)
    expect(panel.get_by_role("alert")).to_have_count(0)
    assert lost[0] >= 2
    assert faults
    assert all("ERR_FAILED" in fault for fault in faults)
    faults.clear()  # browsers put each into the console


@pytest.mark.parametrize("path", ["**/verdict", "**/trajectory", "**/cra"])
def test_message_on_a_lost_request_goes_with_its_answer(page: Page, faults: list[str], path: str) -> None:
    open_view(page)
    page.get_by_text("Under other laws").click()
    expect(page.get_by_role("table", name="Under other laws")).to_be_visible()
    page.route(path, lambda route: route.abort())
    speed(page).fill("300")
    lost = page.get_by_role("alert").filter(has_text="The service does not answer. Trying again.")
    expect(lost).to_be_visible()
    page.unroute(path)
    expect(lost).to_have_count(0)
    page.wait_for_function(IDLE)
    expect(page.locator("[aria-busy=true]")).to_have_count(0)
    assert all("ERR_FAILED" in fault for fault in faults)
    faults.clear()


def test_papers_searches_wait_until_they_are_opened_and_end_with_the_inputs(page: Page) -> None:
    requested: list[str] = []

    def method(request: Any) -> str:
        is_search = request.method == "POST" and request.url.endswith("/cra")
        return str(json.loads(request.post_data).get("search", {}).get("method", "")) if is_search else ""

    page.on("request", lambda request: requested.append(method(request)))
    open_view(page, "critical-angle")
    assert "outcome" in requested
    assert "bisection" not in requested
    held: list[Route] = []

    def hold_first(route: Route) -> None:
        if method(route.request) == "bisection" and not held:
            held.append(route)  # without an answer until the page gives it up
        else:
            route.continue_()

    page.route("**/cra", hold_first)
    with page.expect_request(lambda request: method(request) == "bisection"):
        page.get_by_text("How it was found").click()
    with page.expect_event("requestfailed", lambda request: method(request) == "bisection"):
        speed(page).fill("301")
    expect(page.get_by_role("table", name="Secant (paper)")).to_be_visible()
    assert requested.count("bisection") == 2
    assert requested.count("secant") == 1, "those of the inputs before are given up"
