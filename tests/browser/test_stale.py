"""Numbers computed for earlier inputs are removed or marked as outdated."""

import json
import random
import re
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from .conftest import expected
from .side_view import IDLE, open_explore


def speed(page: Page) -> Any:
    return page.get_by_label("Speed", exact=True)


def test_invalid_field_removes_the_numbers(page: Page) -> None:
    open_explore(page)
    speed(page).fill("-5")
    expect(page.locator(".angle")).to_have_count(0)
    expect(page.locator("[data-outcome]")).to_have_count(0)
    picture = page.locator(".side-view.cleared[aria-busy=true]")  # It shows the previous inputs.
    expect(picture.locator(".drawing")).to_be_visible()
    expect(page.locator("#status")).to_have_text("A field is not accepted. Nothing is computed.")
    speed(page).fill("250")
    page.wait_for_function(IDLE)
    expect(picture).to_have_count(0)
    expect(page.locator(".side-view .drawing")).to_be_visible()
    expect(page.get_by_label("Instant")).to_be_visible()
    expect(page.locator("#status")).to_have_text("Up to date.")


@pytest.mark.parametrize("wrong", ["-3", "heavy"])
def test_buttons_that_need_a_valid_case_are_disabled_without_one(page: Page, wrong: str) -> None:
    open_explore(page)
    page.get_by_role("button", name="Pin to compare").click()
    page.get_by_label("Mass").fill("14")
    page.wait_for_function(IDLE)
    page.get_by_label("Mass").fill(wrong)
    acts = page.get_by_role("button", name=re.compile("^(Pin to|Report$|Copy |Download )"))
    assert acts.count() >= 11
    for act in acts.all():
        expect(act).to_be_disabled()
    picture = page.locator(".side-view.cleared[aria-busy=true]")
    expect(picture.locator(".drawing")).to_be_visible()
    expect(page.locator(".verdict")).to_contain_text("No result: a field is not accepted.")
    expect(page.locator(".verdict").get_by_text("No result")).to_have_count(1)
    page.get_by_label("Mass").fill("15")
    page.wait_for_function(IDLE)
    for act in acts.all():
        expect(act).to_be_enabled()


@pytest.mark.parametrize("edits", [25, pytest.param(300, marks=pytest.mark.slow)])
def test_random_edits_never_leave_outdated_results_unmarked(page: Page, faults: list[str], edits: int) -> None:
    """While a field is invalid, texts are gone, pictures grey and buttons disabled; a valid edit brings all back."""
    chance = random.Random(51)  # noqa: S311 (not for secrets)
    fields = {
        "Speed": (["238", "310.5", "120"], ["-5", "", "fast"]),
        "Oblique angle": (["0", "45", "55", "70"], ["95", "-1", "steep"]),
        "Mass": (["9", "13", "20"], ["-3", "0", "heavy"]),
        "Compressive strength": (["39", "60"], ["0", "3 kg"]),
    }
    open_explore(page)
    wrong: set[str] = set()
    acts = page.get_by_role("button", name=re.compile("^(Pin to|Report$|Copy |Download )"))
    for _ in range(edits):
        label = chance.choice([*sorted(wrong), *fields])
        is_wrong = chance.random() < 0.4
        text = chance.choice(fields[label][is_wrong])
        page.get_by_label(label, exact=True).fill(text)
        page.keyboard.press("Tab")
        wrong = wrong | {label} if is_wrong else wrong - {label}
        if wrong:
            expect(page.locator(".side-view.cleared[aria-busy=true]")).to_have_count(1)
            expect(page.locator(":is(.angle, [data-outcome])")).to_have_count(0)
            for act in acts.all():
                expect(act).to_be_disabled()
            continue
        page.wait_for_function(IDLE)
        expect(page.locator(".cleared")).to_have_count(0)
        angle = float(page.get_by_label("Oblique angle", exact=True).input_value())
        expect(page.locator("[data-outcome]").first).to_contain_text(f"{angle:g}°")
        page.wait_for_timeout(300)  # The address is updated after a delay.
        link = page.url
        for name, key in (("Speed", "impact.velocity_m_s"), ("Mass", "projectile.mass_kg")):
            shown, usual = page.get_by_label(name, exact=True).input_value(), {"Speed": "238", "Mass": "13"}[name]
            assert f"{key}={shown}" in link or (shown == usual and key not in link), (name, shown, link)
        for act in acts.all():
            expect(act).to_be_enabled()
    faults[:] = [fault for fault in faults if "422" not in fault]


def test_invalid_shots_remove_the_results_they_affect(page: Page) -> None:
    shots = '[{"velocity_m_s":250,"depth_m":0.31},{"velocity_m_s":300,"depth_m":0.42}]'
    open_explore(page, f"?resistance.strength_factor.model=own_tests&resistance.strength_factor.shots={shots}")
    changes = page.get_by_role("group", name="Own depth tests").locator("table")
    expect(changes).to_be_visible()
    page.get_by_label("Shots: speed, depth").fill("250, deep")
    expect(page.locator(".verdict")).to_contain_text("No result: a field is not accepted.")
    expect(changes).to_have_count(0)


def test_page_is_out_of_date_while_a_study_or_map_is_computed(page: Page) -> None:
    status = page.locator("#status")
    page.route("**/cra/uncertainty", lambda route: None)  # The request gets no answer.
    with page.expect_response("**/verdict"):
        page.goto("/#/how-sure?scatter=impact.velocity_m_s,normal,coefficient_of_variation:0.02&sampling.seed=4")
    expect(page.locator(".verdict [aria-busy=true]")).to_have_count(0)
    expect(status).not_to_have_text("Up to date.")
    page.route("**/cra/sweep", lambda route: None)
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,2")
    expect(page.locator(".verdict [data-outcome]")).to_be_visible()
    expect(page.locator(".verdict [aria-busy=true]")).to_have_count(0)
    expect(status).not_to_have_text("Up to date.")


def test_warning_about_another_angle_names_that_angle(page: Page) -> None:
    open_explore(page, "?target.thickness_m=0.5&impact.oblique_angle_deg=30")
    page.locator("details.warnings").evaluate("fold => { fold.open = true; }")
    for warning in page.locator(".verdict .warning").all_text_contents():
        angles = re.findall(r"([\d.]+)° from the normal", warning)
        assert all(angle == "30" for angle in angles) or warning.startswith("At the critical angle"), warning


def test_lost_service_is_reported_beside_the_picture_and_retried(page: Page, faults: list[str]) -> None:
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
def test_message_about_a_lost_request_disappears_after_its_answer(page: Page, faults: list[str], path: str) -> None:
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


def test_paper_searches_start_when_opened_and_stop_when_inputs_change(page: Page) -> None:
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
            held.append(route)  # Unanswered, it is pending until the page aborts it.
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
