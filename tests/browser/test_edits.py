"""Editing a case: no error while a value is being typed, input in other units, and undo."""

import random
import re
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from service.schemas.strike import PAPER_AT_45
from solver.resistance import EQUATION_9_COEFFICIENTS

from .conftest import FOLDER, expected, unfold
from .downloads import data_rows, saved
from .side_view import IDLE, open_explore

CHECKED_EACH = 20
SPEED, ANGLE, STRENGTH, MASS, THICKNESS = "Speed", "Oblique angle", "Compressive strength", "Mass", "Thickness"
FIELDS: dict[str, tuple[tuple[str, ...], float, float, dict[str, float]]] = {
    SPEED: (("impact", "velocity_m_s"), 0.5, 3000.0, {"m/s": 1.0, "ft/s": 0.3048, "km/h": 1 / 3.6}),
    ANGLE: (("impact", "oblique_angle_deg"), 0.0, 89.9, {"°": 1.0}),
    STRENGTH: (("target", "compressive_strength_pa"), 15.0, 150.0, {"MPa": 1.0, "psi": 0.006894757293168}),
    MASS: (("projectile", "mass_kg"), 5.0, 40.0, {"kg": 1.0, "lb": 0.45359237}),
    THICKNESS: (("target", "thickness_m"), 50.0, 5000.0, {"mm": 1.0, "in": 25.4}),
    "Length": (("projectile", "length_m"), 300.0, 900.0, {"mm": 1.0, "cm": 10.0}),
    "Angle of attack": (("impact", "angle_of_attack_deg"), -9.0, 9.0, {"°": 1.0}),
}
"""Fields by label: path in the request, smallest and largest typed value in the unit shown, and the accepted units
with their size in the unit shown."""
LISTEN = """() => {
    window.errors = [];
    const look = () => {
        for (const part of document.querySelectorAll('.field .problem:not([hidden]), p.problem:not([hidden])'))
            if (part.textContent && !part.closest('.field [hidden]')) window.errors.push(part.textContent);
    };
    const all = {subtree: true, childList: true, characterData: true, attributes: true};
    new MutationObserver(look).observe(document.body, all);
}"""


def field(page: Page, label: str) -> Locator:
    return page.get_by_label(label, exact=True)


def type_into(page: Page, label: str, text: str, leave: bool = True) -> None:
    """Replace the content of a field by pressing keys."""
    field(page, label).focus()
    page.keyboard.press("ControlOrMeta+a")
    if not text:
        page.keyboard.press("Delete")
    page.keyboard.type(text)
    if leave:
        page.keyboard.press("Tab")


def drop_refusals(faults: list[str]) -> None:
    """Drop recorded refusals of incomplete input: browsers log every answer with a status of 400 or more."""
    faults[:] = [fault for fault in faults if "422" not in fault]


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("sequences", [60, pytest.param(400, marks=pytest.mark.slow)])
def test_typing_a_valid_value_never_shows_an_error(
    page: Page, client: httpx.Client, faults: list[str], sequences: int
) -> None:
    chance = random.Random(36)  # noqa: S311 (not for secrets)
    open_explore(page)
    page.evaluate(LISTEN)
    for number in range(1, sequences + 1):
        for _ in range(chance.choice((1, 1, 2))):
            label = chance.choice(list(FIELDS))
            (_, least, most, units) = FIELDS[label]
            unit, size = chance.choice(list(units.items()))
            value = chance.uniform(least, most) if least <= 0 else least * (most / least) ** chance.random()
            text = f"{value / size:.{chance.choice((3, 4, 5))}g}"
            if not least <= float(text) * size <= most or "e" in text:
                text, unit = f"{least:g}", next(iter(units))
            if len(text.rpartition(".")[2]) != 3:  # A comma before three digits separates thousands.
                text = text.replace(".", chance.choice(".,"))
            if label == THICKNESS and chance.random() < 0.5:
                text = ""
            elif size != 1.0 or chance.random() < 0.2:
                text += f" {unit}"
            type_into(page, label, text)
        if number % CHECKED_EACH == 0:
            page.wait_for_function(IDLE)
            check_shown(page, client)
    assert page.evaluate("window.errors") == []
    drop_refusals(faults)


def check_shown(page: Page, client: httpx.Client) -> None:
    """Check the figures shown against the service's answer to the case in the address, which is in SI units."""
    expect(page.locator("[aria-invalid=true]")).to_have_count(0)
    page.wait_for_timeout(400)  # The address is updated after a delay.
    body: dict[str, Any] = {part: dict(content) for part, content in PAPER_AT_45.items()}
    for name, text in re.findall(r"([a-z_.]+)=([-\d.e]+)", page.url):
        part, _, key = name.partition(".")
        body[part][key] = float(text)
    impact = {name: value for name, value in body["impact"].items() if name != "oblique_angle_deg"}
    found = client.post("/cra", json=body | {"impact": impact}).json()
    angle = found.get("critical_angle_deg")
    figures = page.locator(".figures").inner_text()
    shown = ["none", "No critical angle"] if angle is None else [f"{angle:.{decimals}f}°" for decimals in (1, 2)]
    assert any(each in figures for each in shown), (page.url, figures)
    assert f"{body['impact']['oblique_angle_deg']:g}°" in figures


@pytest.mark.timeout(900)  # Verdicts on slow strikes wait behind other tests on a busy machine.
@pytest.mark.parametrize("speeds", [("0.5", "3000", "0.5", "238"), ("3000", "1", "2500", "0.7")])
def test_speeds_can_be_entered_in_any_order(page: Page, faults: list[str], speeds: tuple[str, ...]) -> None:
    open_explore(page)
    page.evaluate(LISTEN)
    for speed in speeds:
        type_into(page, SPEED, speed)
        page.wait_for_function(IDLE)
        expect(page.locator(".side-view .moving")).to_be_visible()
    assert page.evaluate("window.errors") == []
    assert all("422" in fault for fault in faults), "the slowest takes too many steps"
    faults.clear()


def test_every_angle_of_the_slider_has_an_outcome(page: Page) -> None:
    open_explore(page)
    slider = page.get_by_label("Oblique angle, slider")
    for degrees in ("86.5", "86.7", "88", "89.9", "0"):
        slider.fill(degrees)
        page.wait_for_function(IDLE)
        expect(page.locator("[data-outcome]")).to_contain_text(f"At {degrees}°")
    text = (FOLDER / "run.js").read_text()
    assert f"EQUATION_9 = {list(EQUATION_9_COEFFICIENTS)}" in text


def test_error_appears_once_after_the_field_is_left(page: Page) -> None:
    open_explore(page)
    type_into(page, SPEED, "0", leave=False)
    expect(page.locator("[aria-busy=true]").filter(has=page.locator(".figures"))).to_have_count(1)
    expect(field(page, SPEED)).not_to_have_attribute("aria-invalid", "true")
    page.keyboard.press("Tab")
    expect(page.get_by_text("Speed must be at least 0.1 m/s.")).to_have_count(1)
    expect(page.locator(".problem:visible")).to_have_count(1)
    type_into(page, SPEED, "20000")
    expect(page.get_by_text("Speed must be at most 10,000 m/s.")).to_have_count(1)


@pytest.mark.parametrize(
    ("label", "typed", "shown", "value"),
    [
        (SPEED, "250,5", "250.5", "velocity_m_s=250.5"),
        (SPEED, "250 m/s", "250", "velocity_m_s=250"),
        (SPEED, "900 km/h", "250", "velocity_m_s=250"),
        (STRENGTH, "5656 psi", "38.9967", "compressive_strength_pa=38996747"),
        ("Diameter", "3 in", "76.2", "diameter_m=0.0762"),
        (MASS, "30 lb", "13.6077711", "mass_kg=13.6077711"),
        (THICKNESS, "1,200.0 mm", "1200", "thickness_m=1.2"),
        (THICKNESS, "12,5 cm", "125", "thickness_m=0.125"),
    ],
)
def test_units_and_commas_are_accepted_in_fields(
    page: Page, faults: list[str], label: str, typed: str, shown: str, value: str
) -> None:
    open_explore(page)
    type_into(page, label, typed)
    assert float(field(page, label).input_value()) == pytest.approx(float(shown), rel=1e-5)
    expect(page).to_have_url(re.compile(re.escape(value)))
    drop_refusals(faults)


def test_unit_of_another_quantity_is_named(page: Page) -> None:
    open_explore(page)
    type_into(page, SPEED, "250 kg")
    expect(page.get_by_text('Speed: "kg" is not a unit here, as m/s is.')).to_be_visible()


def test_us_units_are_shown_throughout_and_exported(page: Page, tmp_path: Any) -> None:
    open_explore(page, "?target.thickness_m=0.508&impact.oblique_angle_deg=60")
    page.get_by_label("Units").select_option("US")
    page.wait_for_function(IDLE)
    for label, shown in {SPEED: "780.84", "Diameter": "3.14961", STRENGTH: "5656.47", THICKNESS: "20"}.items():
        expect(field(page, label)).to_have_value(shown)
    words = page.locator("main").inner_text().replace("155\N{NO-BREAK SPACE}mm body", "")
    assert not re.search(r"\d\s(m/s|mm|MPa|kg|kN|kJ)\b|\[(m/s|mm|m|MPa|kN|kJ)\]", words), words
    saved(
        page,
        page.locator(".side-view").get_by_role("button", name="Download the data of the plot as CSV"),
        tmp_path / "side.csv",
    )
    rows = data_rows(tmp_path / "side.csv")
    assert float(rows[0]["speed_ft_s"]) == pytest.approx(238 / 0.3048, rel=1e-4)
    assert "nose_tip_depth_in" in rows[0]
    page.get_by_role("link", name="Walls").click()
    expect(page.locator(".outcome")).to_contain_text("Wall of 20 in at 60°")
    page.get_by_label("Units").select_option("SI")
    expect(page.locator(".outcome")).to_contain_text("Wall of 508 mm at 60°")


def test_edits_are_undone_one_by_one(page: Page) -> None:
    open_explore(page)
    undo = page.get_by_role("button", name="Undo")
    expect(undo).to_be_disabled()
    type_into(page, SPEED, "300")
    type_into(page, MASS, "15")
    page.get_by_label("Nose").select_option("flat")
    undo.click()
    expect(page.get_by_label("Nose")).to_have_value("ogive")
    expect(field(page, MASS)).to_have_value("15")
    undo.click()
    undo.click()
    expect(field(page, SPEED)).to_have_value("238")
    expect(undo).to_be_disabled()
    expect(page).to_have_url(re.compile("#/explore$"))


def test_case_can_be_saved_by_name_and_its_link_copied(page: Page) -> None:
    open_explore(page, "?projectile.mass_kg=15")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy link").click()
    expect(page.get_by_text("Copied the link.")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == page.url
    page.get_by_text("Saved cases").click()
    page.get_by_label("Name of the case").fill("South wall")
    page.get_by_role("button", name="Save", exact=True).click()
    page.goto("/#/walls")
    page.get_by_text("Saved cases").click()
    page.get_by_role("link", name="South wall").click()
    expect(field(page, MASS)).to_have_value("15")
    page.get_by_text("Saved cases").click()
    page.get_by_role("button", name="Forget South wall").click()
    expect(page.get_by_role("link", name="South wall")).to_have_count(0)


def test_view_opened_while_the_service_is_down_recovers(page: Page, faults: list[str]) -> None:
    open_explore(page)
    page.route("**/*", lambda route: route.abort())
    page.get_by_role("link", name="Walls").click()
    expect(page.locator("#status")).to_contain_text("The service does not answer. Trying again.")
    page.unroute("**/*")
    expect(page.locator(".outcome")).to_contain_text("Design value against")
    expect(page.locator("#status")).to_have_text("Up to date.")
    expected(faults, "ERR_FAILED")


def ninety_per_cent(page: Page) -> tuple[float, float]:
    figures = page.locator(".figures")
    expect(figures).to_contain_text("90 % range")
    found = re.search(r"90\s% range ([\d.]+)° to ([\d.]+)°", figures.inner_text())
    assert found is not None
    return float(found[1]), float(found[2])


@pytest.mark.parametrize(
    "shots",
    ["velocity_m_s,depth_m\n238.1,0.30\n275.7,0.38\n300,0.44\n200,0.23", "238.1, 300\n275.7, 380\n300 m/s, 44 cm"],
    ids=["csv", "typed"],
)
def test_own_shots_narrow_the_range(page: Page, shots: str) -> None:
    open_explore(page, "?resistance.strength_factor.model=published_tests")
    before = ninety_per_cent(page)
    unfold(page)
    page.get_by_label("Strength factor", exact=True).select_option("own_tests")
    page.get_by_label("Shots: speed, depth").fill(shots)  # This is the second and last action.
    fit = page.get_by_label("Own depth tests", exact=True)
    expect(fit).to_contain_text(f"With {3 if 'cm' in shots else 4} depth tests")
    expect(fit).to_be_visible()
    after = ninety_per_cent(page)
    rows = fit.locator("tbody tr")
    expect(rows).to_have_count(4)
    changes = {row.locator("th").inner_text(): row.locator("td").all_inner_texts() for row in rows.all()}
    assert list(changes) == ["S at 0°", "Critical angle", "90\N{NO-BREAK SPACE}% range", "Ricochet at 45°"]
    ranges = [tuple(map(float, re.findall(r"[\d.]+", text))) for text in changes["90\N{NO-BREAK SPACE}% range"]]
    assert ranges == [before, after]
    assert changes["Critical angle"][1] == page.locator(".angle").inner_text()
    probability = changes["Ricochet at 45°"][1]
    assert probability in page.locator(".outcome").inner_text()
    assert all(first != second for first, second in changes.values())
    assert after[1] - after[0] < 0.85 * (before[1] - before[0])
    expect(page).to_have_url(re.compile("shots"))


@pytest.mark.parametrize("view", ["critical-angle", "how-sure"])
def test_link_beside_the_range_opens_the_place_of_own_shots(page: Page, view: str) -> None:
    page.goto(f"/#/{view}?impact.velocity_m_s=250")
    page.get_by_role("link", name="Enter own shots").click()
    shots = page.get_by_label("Shots: speed, depth")
    expect(shots).to_be_focused()
    expect(shots).to_be_in_viewport()
    expect(field(page, "Strength factor")).to_have_value("own_tests")
    expect(field(page, SPEED)).to_have_value("250")
    page.keyboard.insert_text("250, 310\n300 deep")  # at once: a depth of 3 mm would be refused by the service
    problem = page.locator(".field .problem:visible")
    expect(problem).to_contain_text('"300 deep" is not valid')
    expect(problem).to_be_in_viewport(ratio=1)
    shots.fill("250, 310")
    expect(page.get_by_label("Own depth tests", exact=True)).to_contain_text("With 1 depth test")
    page.get_by_role("link", name="Enter own shots").click()
    expect(shots).to_be_focused()
    expect(shots).to_have_value("250, 310")


def test_address_of_the_place_of_own_shots_has_links_and_says_what_is_missing(page: Page) -> None:
    page.goto("/#/explore?impact.velocity_m_s=250&enter=shots")
    expect(page.get_by_label("Shots: speed, depth")).to_be_focused()
    expect(page.locator("#status")).to_have_text("Shots: speed, depth: none yet.")
    for name in ("Enter own shots", "How sure, input by input"):
        link = page.locator(".verdict a", has_text=name)
        expect(link).to_have_attribute("href", re.compile("velocity_m_s=250"))


def test_list_of_shots_begins_empty_and_names_an_invalid_line(page: Page) -> None:
    open_explore(page)
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.post_data or ""))
    unfold(page)
    page.get_by_label("Strength factor", exact=True).select_option("own_tests")
    field = page.get_by_label("Shots: speed, depth")
    expect(field).to_have_value("")
    expect(page.locator("#status")).to_have_text("Shots: speed, depth: none yet.")
    picture = page.locator(".side-view .drawing")
    field.fill("250, 310\n300 deep")
    expect(field).to_have_accessible_description(re.compile('"300 deep" is not valid; each line must be a speed'))
    expect(picture).to_be_visible()
    assert not any("own_tests" in body for body in sent), "an example would count as evidence"
    field.fill("250, 310")
    expect(page.get_by_label("Own depth tests", exact=True)).to_contain_text("With 1 depth test")
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_label("Strength factor", exact=True)).not_to_have_value("own_tests")
    expect(page.locator("#status")).to_have_text("Strength factor is as before.")
