"""Browser storage that is blocked, disabled or damaged."""

from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from . import firefox
from .side_view import IDLE, open_explore

BLOCKED = """for (const area of ["localStorage", "sessionStorage"]) {
    Object.defineProperty(window, area, { get() { throw new DOMException("blocked", "SecurityError"); } });
}"""
OFF = """for (const area of ["localStorage", "sessionStorage"]) Object.defineProperty(window, area, { value: null });"""
DAMAGED = """for (const name of ["cases", "units", "theme", "describe"]) {
    localStorage.setItem(`ricochet-${name}`, '{"half": 3, ');
}
sessionStorage.setItem("ricochet-key", "not\\na key");"""
VIEWS = ("explore", "critical-angle", "how-sure", "walls", "map", "jobs")


def save_case(page: Page, name: str) -> None:
    page.get_by_text("Saved cases").click()
    page.get_by_label("Name of the case").fill(name)
    page.get_by_role("button", name="Save", exact=True).click()


@pytest.mark.parametrize("script", [BLOCKED, OFF, DAMAGED], ids=["blocked", "off", "damaged"])
def test_every_view_works_with_any_state_of_the_storage(page: Page, script: str) -> None:
    page.add_init_script(script)
    open_explore(page)
    page.get_by_label("Units").select_option("US")
    page.wait_for_function(IDLE)
    expect(page.get_by_label("Mass")).to_have_value("28.6601")
    page.get_by_label("Theme").select_option("Dark")
    save_case(page, "Mine")
    expect(page.get_by_role("link", name="Mine")).to_be_visible()
    for view in VIEWS:
        page.goto(f"/#/{view}")
        expect(page.get_by_role("heading", level=1)).to_have_count(1)
        expect(page.locator(".view > .problem:not(:empty)")).to_have_count(0)
        if view != "jobs":
            expect(page.locator("main .panel").first).to_be_visible()


def test_damaged_stored_values_are_dropped_and_others_kept(page: Page) -> None:
    page.add_init_script("""localStorage.setItem("ricochet-cases", '{"Bad": 7, "Good": "projectile.mass_kg=15"}');""")
    open_explore(page)
    expect(page.get_by_label("Theme")).to_have_value("system")
    page.get_by_text("Saved cases").click()
    expect(page.get_by_role("link", name="Bad")).to_have_count(0)
    page.get_by_role("link", name="Good").click()
    expect(page.get_by_label("Mass")).to_have_value("15")


@pytest.mark.skipif(firefox.executable() is None, reason="needs Firefox: apt-get install firefox-esr")
def test_firefox_without_storage_shows_every_view(live_url: str, tmp_path: Path) -> None:
    path = firefox.executable()
    assert path is not None
    with firefox.running_firefox(path, tmp_path, {**firefox.OFF_THE_NETWORK, "dom.storage.enabled": False}) as tab:
        tab.open(f"{live_url}/")
        assert tab.evaluate("window.localStorage === null")
        assert "Critical angle 48.6° from the normal" in tab.evaluate(
            shown("document.querySelector('.outcome')?.textContent", "90\N{NO-BREAK SPACE}% range")
        )
        for view in VIEWS:
            tab.evaluate(f"location.hash = '#/{view}'")
            assert tab.evaluate(shown("document.querySelector('h1')?.textContent", ""))
            assert tab.evaluate("document.querySelectorAll('.view > .problem:not(:empty)').length") == 0
        assert tab.errors == []


def shown(text: str, part: str) -> str:
    """Return a script that waits until the value of an expression contains `part`, and returns the value."""
    return f"""new Promise((found) => {{
        const look = () => {{
            const text = {text};
            if (text?.includes("{part}")) found(text);
            else setTimeout(look, 100);
        }};
        look();
    }})"""
