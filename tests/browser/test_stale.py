"""No number stands beside inputs that it does not belong to, unless it is marked."""

import json
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from .conftest import expected
from .side_view import IDLE, open_explore


def speed(page: Page) -> Any:
    return page.get_by_label("Speed", exact=True)


def test_field_that_is_not_accepted_takes_the_numbers_away(page: Page) -> None:
    open_explore(page)
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
    open_explore(page)
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
    expected(faults, "ERR_FAILED")


@pytest.mark.parametrize("path", ["**/verdict", "**/trajectory", "**/cra"])
def test_message_on_a_lost_request_goes_with_its_answer(page: Page, faults: list[str], path: str) -> None:
    open_explore(page)
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
    expected(faults, "ERR_FAILED")


def test_papers_searches_wait_until_they_are_opened_and_end_with_the_inputs(page: Page) -> None:
    requested: list[str] = []

    def method(request: Any) -> str:
        is_search = request.method == "POST" and request.url.endswith("/cra")
        return str(json.loads(request.post_data).get("search", {}).get("method", "")) if is_search else ""

    page.on("request", lambda request: requested.append(method(request)))
    page.goto("/#/critical-angle")
    page.wait_for_function(IDLE)
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
