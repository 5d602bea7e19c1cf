"""The view "Explore": numbers, pictures, fields and downloads."""

import json
import math
import re
import statistics
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page, Route, expect

from service.schemas.strike import PAPER_AT_45

from .conftest import unfold
from .downloads import data_rows
from .side_view import IDLE, READY, points, transform

STEPS = 12
PATIENCE_MS = 2_000.0
"""Time limit for a step of a slider on a busy machine; it takes about 60 ms on an idle one. [ms]"""
NOSE_FIELDS = {
    "conical": "Cone height over diameter",
    "spherical": "Caliber radius head",
    "profile": "Points x, r",
    "flat": None,
}
PAPER_ANGLE_DEG = 48.6


def open_explore(page: Page, query: str = "") -> None:
    page.goto(f"/#/explore{query}")
    wait_for_picture(page)


def wait_for_picture(page: Page) -> None:
    expect(page.locator(READY)).to_be_visible()
    expect(page.locator(".angle")).to_be_visible()
    expect(page.locator(".histories .scatterlayer .trace").first).to_be_visible()


def critical_angle(page: Page) -> float:
    return float(page.locator(".angle").inner_text().rstrip("°"))


def side_view(page: Page) -> Locator:
    return page.locator(".side-view .drawing")


def outline(page: Page) -> list[list[float]]:
    """Return the coordinates of the projectile's outline. [m]"""
    return points(page, "moving")


def wait_for_another_outline(page: Page, before: list[list[float]]) -> None:
    page.wait_for_function(
        "before => document.querySelector('.side-view .moving').getAttribute('d').match(/[^MLZ]+/)[0] !== before",
        arg=f"{before[0][0]:g} {before[1][0]:g}",
    )


def set_slider(page: Page, name: str, value: float) -> None:
    page.get_by_label(f"{name}, slider").fill(str(value))


def test_paper_case_shows_its_critical_angle_and_the_picture(page: Page) -> None:
    page.goto("/")
    wait_for_picture(page)
    assert page.url.endswith("#/explore")
    assert critical_angle(page) == PAPER_ANGLE_DEG
    expect(page.get_by_label("Speed", exact=True)).to_have_value("238")
    expect(page.get_by_label("Compressive strength")).to_have_value("39")
    expect(page.locator("[data-outcome]")).to_contain_text(re.compile("At 45° from the normal.* embedded"))
    page.get_by_text(re.compile("^Standing notes")).click()
    expect(page.locator(".standing [data-code='mass_properties_assumed']")).to_be_visible()
    expect(page.get_by_role("img", name=re.compile("Side view to scale. Strike: embedded"))).to_be_visible()


def test_too_thin_wall_is_perforated(page: Page) -> None:
    strong = "projectile.yield_strength_pa=2e9"  # With less strength the first warning would be about bending.
    open_explore(page, f"?target.thickness_m=0.2&impact.oblique_angle_deg=20&{strong}")
    expect(page.get_by_label("Thickness")).to_have_value("200")
    verdict = page.get_by_role("region", name="Verdict")
    expect(verdict).to_contain_text(re.compile("At 20° from the normal.* perforated"))
    expect(page.get_by_role("group", name="Outcome")).to_contain_text("mm beyond the rear face")
    expect(verdict).to_contain_text(
        re.compile(r"Perforated from 5\.0° \(where the search begins\) to \d+\.\d+°, embedded")
    )
    expect(verdict.locator("summary", has_text="The rear face has no plug")).to_be_visible()
    expect(page.get_by_role("img", name=re.compile("Strike: perforated after .* wall of 200 mm"))).to_be_visible()
    concrete, face, rear = (set(points(page, *which)[1]) for which in (("concrete",), ("face", 0), ("face", 1)))
    assert (concrete, face, rear) == ({0, 0.2}, {0}, {0.2})


def test_axis_of_a_head_on_strike_is_at_zero(page: Page) -> None:
    open_explore(page, "?impact.oblique_angle_deg=0")
    expect(page.get_by_text("its axis at 0.0° from the normal")).to_be_visible()
    expect(page.locator("[data-outcome]")).to_contain_text("0° is not in the range searched")


def test_outline_is_drawn_to_scale_at_the_final_position(page: Page, client: httpx.Client) -> None:
    open_explore(page)
    final = client.post("/trajectory", json=PAPER_AT_45).json()["final"]
    lateral, depth = outline(page)
    assert depth[0] == pytest.approx(final["nose_tip_depth_m"], abs=1e-5)
    ends = [(lateral[i], depth[i]) for i in range(len(depth))]
    furthest = max(((x - ends[0][0]) ** 2 + (y - ends[0][1]) ** 2) ** 0.5 for x, y in ends)
    assert furthest == pytest.approx((0.53**2 + 0.04**2) ** 0.5, abs=1e-5)
    assert len(transform(page)) == 3, "one scale along the face and in depth"


def test_moving_a_slider_updates_the_picture_the_number_and_the_url(page: Page) -> None:
    open_explore(page)
    before, slow = outline(page), critical_angle(page)
    set_slider(page, "Speed", 400)
    expect(page.get_by_label("Speed", exact=True)).to_have_value("400")
    wait_for_another_outline(page, before)
    expect(page.locator(".angle")).not_to_have_text(f"{slow:.1f}°")
    assert critical_angle(page) > slow
    expect(page).to_have_url(re.compile(r"#/explore\?impact\.velocity_m_s=400$"))
    set_slider(page, "Oblique angle", 75)
    expect(page.locator("[data-outcome=ricochet]")).to_contain_text("At 75° from the normal")


def test_invalid_value_is_refused_at_its_field_and_greys_the_old_picture(page: Page) -> None:
    open_explore(page)
    before = outline(page)
    field = page.get_by_label("Speed", exact=True)
    field.fill("-5")
    expect(field).to_have_attribute("aria-invalid", "true")
    expect(field).to_have_accessible_description(re.compile(r"Speed must be at least 0.1\sm/s\."))
    field.fill("fast")
    expect(field).to_have_accessible_description(re.compile(r'Speed: "fast" is not a number\.'))
    expect(page.locator(".side-view.cleared[aria-busy=true] .drawing")).to_be_visible()
    field.fill("239")
    expect(field).not_to_have_attribute("aria-invalid", "true")
    wait_for_another_outline(page, before)


def test_error_of_the_service_is_shown_at_the_field(page: Page, faults: list[str]) -> None:
    open_explore(page)
    field = page.get_by_label("Length", exact=True)
    field.fill("50")
    words = re.compile(r"Length must be at least the length of the nose, 132\.665\smm, got 50\smm")
    expect(field).to_have_accessible_description(words)
    field.fill("530")
    expect(field).not_to_have_attribute("aria-invalid", "true")
    expect(page.locator("[data-outcome=embedded]")).to_be_visible()
    refused = [fault for fault in faults if "422" in fault]
    assert refused
    for fault in refused:
        faults.remove(fault)  # Browsers log every answer with a status of 400 or more.


def test_every_nose_has_its_fields_and_a_picture(page: Page) -> None:
    open_explore(page)
    for nose, label in NOSE_FIELDS.items():
        before = outline(page)
        page.get_by_label("Nose").select_option(nose)
        wait_for_another_outline(page, before)
        expect(page).to_have_url(re.compile(f"projectile.nose.shape={nose}"))
        expect(page.get_by_label("Nose")).to_be_focused()
        for other in filter(None, NOSE_FIELDS.values()):
            expect(page.get_by_label(other)).to_have_count(int(other == label))


def test_every_strength_law_has_its_fields_and_its_factor(page: Page) -> None:
    open_explore(page)
    outcome = page.get_by_role("group", name="Outcome")
    expect(outcome).to_contain_text("The strength factor S at this oblique angle is 6.51.")  # eq. 9 at 45°
    unfold(page)
    page.get_by_label("Strength factor").select_option("published_tests")
    shape = page.get_by_label("Over the angle")
    expect(shape).to_have_value("equation_9")
    shape.select_option("constant")
    expect(outcome).to_contain_text("The strength factor S at this oblique angle is 8.74.")  # 8.84 (80 / 76.2)^-0.24
    expect(page).to_have_url(re.compile("resistance.strength_factor.obliquity_shape=constant"))
    page.get_by_label("Strength factor").select_option("strength_power_law")
    expect(shape).to_have_value("constant")
    expect(outcome).to_contain_text("The strength factor S at this oblique angle is 11.3.")  # 82.6 39^-0.544
    page.get_by_label("Diameter exponent").fill("-1")
    expect(outcome).to_contain_text("The strength factor S at this oblique angle is 10.7.")


def test_other_laws_include_this_strike_and_its_angle(page: Page) -> None:
    open_explore(page)
    table = page.get_by_role("table", name="Under other laws")
    rows = table.locator("tbody tr")
    page.get_by_text("Under other laws").click()
    expect(rows).to_have_count(11)
    for degrees in ("45", "55"):
        page.get_by_label("Oblique angle", exact=True).fill(degrees)
        expect(page.locator(".laws-table")).to_have_attribute("aria-busy", "true")  # It shows the old strike.
        expect(page.locator(".laws-table")).not_to_have_attribute("aria-busy", "true")
        for row in rows.all():
            _, _, angle, outcome, fitted_to = row.locator("td").all_inner_texts()
            assert outcome == ("ricochet" if float(angle.rstrip("°")) < float(degrees) else "embedded")
            assert fitted_to


def test_shared_url_reopens_the_same_view(page: Page, new_page: Any) -> None:
    open_explore(page)
    page.get_by_label("Nose").select_option("conical")
    page.get_by_label("Cone height over diameter").fill("2")
    page.get_by_label("Diameter", exact=True).fill("90")
    unfold(page)
    page.get_by_label("Free surface").select_option("mohr_coulomb")
    set_slider(page, "Oblique angle", 62)
    expect(side_view(page)).to_have_attribute("aria-label", re.compile("ricochet"))
    page.get_by_label("Instant").fill("40")
    expect(page).to_have_url(re.compile(r"oblique_angle_deg=62&.*time_ms="))
    expect(page.locator("[data-outcome]")).to_contain_text("90 % range")
    other = new_page()
    other.goto(page.url)
    wait_for_picture(other)
    for label, value in {
        "Nose": "conical",
        "Cone height over diameter": "2",
        "Diameter": "90",
        "Free surface": "mohr_coulomb",
        "Oblique angle": "62",
    }.items():
        expect(other.get_by_label(label, exact=True)).to_have_value(value)
    # The inner text leaves out the line for narrow windows, which is hidden here.
    outcome = page.locator("[data-outcome]").inner_text()
    expect(other.locator("[data-outcome]")).to_have_text(outcome, use_inner_text=True)
    assert other.locator(".angle").inner_text() == page.locator(".angle").inner_text()
    assert other.locator("output.instant").inner_text() == page.locator("output.instant").inner_text()
    assert outline(other) == [pytest.approx(each) for each in outline(page)]


def test_case_is_kept_when_the_view_changes(page: Page) -> None:
    open_explore(page, "?projectile.mass_kg=15")
    page.get_by_role("link", name="Critical angle").click()
    expect(page).to_have_url(re.compile(r"#/critical-angle\?projectile\.mass_kg=15"))
    page.get_by_role("link", name="Explore").click()
    expect(page.get_by_label("Mass")).to_have_value("15")
    page.get_by_role("link", name="The paper's strike").click()
    expect(page.get_by_label("Mass")).to_have_value("13")


@pytest.mark.parametrize(
    ("name", "diameter"), [("155 mm body", "155"), ("Flat rod", "20"), ("Cone", "50"), ("The paper's strike", "80")]
)
def test_preset_takes_one_click(page: Page, name: str, diameter: str) -> None:
    open_explore(page, "?projectile.diameter_m=0.09")
    page.get_by_role("group", name="Start from").get_by_role("link", name=name).click()
    expect(page.get_by_label("Diameter", exact=True)).to_have_value(diameter)
    expect(page.locator("[data-outcome]")).to_be_visible()


def test_help_of_a_field_is_visible_while_it_is_used_or_on_request(page: Page) -> None:
    open_explore(page)
    words = page.get_by_text("Distance from the nose tip to the flat base, at least the length of the nose")
    expect(words).to_be_hidden()
    page.get_by_label("Length", exact=True).focus()
    expect(words).to_be_visible()
    page.get_by_label("Speed", exact=True).focus()
    expect(words).to_be_hidden()
    page.get_by_label("Describe every field").check()
    expect(words).to_be_visible()
    expect(page.locator("form [title]")).to_have_count(0)


def test_help_of_a_field_does_not_move_other_fields(page: Page) -> None:
    open_explore(page)
    fields = page.locator("form .field input[type=text]")
    places = "inputs => inputs.map(input => input.getBoundingClientRect().top)"
    before = fields.evaluate_all(places)
    for label in ("Length", "Mass", "Speed", "Density", "Thickness"):
        page.get_by_label(label, exact=True).click()
        expect(page.get_by_label(label, exact=True)).to_be_focused()
        page.evaluate("() => scrollTo(0, 0)")
        assert fields.evaluate_all(places) == before


def test_no_field_shows_the_unit_1(page: Page) -> None:
    open_explore(page)
    assert "1" not in page.locator(".unit").all_inner_texts()


def test_hidden_histories_are_drawn_after_the_inputs_have_settled(page: Page) -> None:
    """Histories take longer to draw than all other parts of the view. Visible ones are drawn without that delay."""
    later = """() => {
        const [side, histories] = ['side view', 'histories'].map(
            (part) => performance.getEntriesByName(`ricochet: ${part}`),
        );
        const of = ({ startTime }) => side.find((each) => each.startTime === startTime);
        return histories.map((each) => each.duration - of(each).duration);
    }"""
    move = """(slider, speed) => {
        slider.value = speed;
        slider.dispatchEvent(new Event('input', { bubbles: true }));
    }"""
    open_explore(page)
    slider = page.get_by_label("Speed, slider")

    def after_the_side_view(speed: int) -> float:
        count = len(page.evaluate(later))
        slider.evaluate(move, speed)  # `fill` would scroll to the slider.
        page.wait_for_function(f"count => ({later})().length > count", arg=count)
        found: float = page.evaluate(later)[-1]
        return found

    assert after_the_side_view(250) >= 990.0
    page.locator(".histories").evaluate("part => scrollTo(0, part.getBoundingClientRect().top - 300)")
    assert min(after_the_side_view(speed) for speed in range(260, 300, 5)) < 990.0


def test_scrubbing_moves_the_outline_and_the_line_in_the_histories(page: Page) -> None:
    open_explore(page)
    last = outline(page)
    page.get_by_label("Instant").fill("0")
    expect(page.locator("output.instant")).to_have_text("0.00 ms")
    lateral, depth = outline(page)
    assert [lateral[0], depth[0]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert depth[0] != last[1][0]
    times = page.locator(".histories .drawing").evaluate("plot => plot.layout.shapes.map(line => line.x0)")
    assert times == [0] * 7


def test_histories_show_the_acceleration_in_units_of_standard_gravity(page: Page) -> None:
    open_explore(page)
    read = "plot => plot.data.map(({y, yaxis}) => [plot.layout.annotations[(yaxis.slice(1) || 1) - 1].text, [...y]])"
    lines = page.locator(".histories .drawing").evaluate(read)
    inward, along = (y for text, y in lines if "<b>Resistance [kN]</b>" in text)
    axial, across = (y for text, y in lines if "<b>Acceleration [g₀]</b>" in text)
    forces = [1e3 * math.hypot(*pair) for pair in zip(inward, along, strict=True)]
    accelerations = [math.hypot(*pair) for pair in zip(axial, across, strict=True)]
    assert accelerations == pytest.approx([force / (13.0 * 9.80665) for force in forces])
    assert -2e4 < min(axial) < -5e3


def test_bending_stress_is_plotted_and_marked_in_the_side_view(page: Page, client: httpx.Client) -> None:
    """The curve peaks at the stress and time in the answer, and the side view marks the section that bends most."""
    open_explore(page)
    body = PAPER_AT_45 | {"output": {"history": True, "sample_interval_s": 1e-4}}
    bending = client.post("/trajectory", json=body).json()["bending"]
    [curve] = page.locator(".histories .drawing").evaluate(
        "plot => plot.data.filter(({yaxis}) => yaxis === 'y7').map(({x, y}) => ({x: [...x], y: [...y]}))"
    )
    assert max(curve["y"]) == pytest.approx(bending["peak_stress_pa"] / 1e6, rel=0.01)
    at = curve["x"][curve["y"].index(max(curve["y"]))]
    assert at == pytest.approx(1e3 * bending["time_s"], abs=0.05)
    expect(page.locator(".side-view text.mark", has_text="bends most")).to_have_text("bends most: 1829 MPa")
    expect(page.locator(".side-view path.bending")).to_have_count(1)


def test_flight_after_a_ricochet_is_drawn_to_the_landing_point_of_the_service(page: Page, client: httpx.Client) -> None:
    open_explore(page)
    panel = page.get_by_role("region", name="Where it lands")
    expect(panel).to_be_hidden()
    mass = page.get_by_label("Mass", exact=True)
    mass.fill("-3")
    expect(page.locator(".verdict")).to_contain_text("No result: a field is not accepted.")
    mass.fill("13")
    strike = PAPER_AT_45 | {"impact": PAPER_AT_45["impact"] | {"oblique_angle_deg": 55.0}}
    flight = client.post("/trajectory", json=strike | {"flight": {}}).json()["exit"]["flight"]
    page.get_by_label("Oblique angle", exact=True).fill("55")
    expect(panel.locator(".main-svg").first).to_be_visible()
    path, *arcs, landing = panel.locator(".drawing").evaluate(
        "plot => plot.data.map(({x, y}) => ({x: [...x], y: [...y]}))"
    )
    assert path["x"][-1] == pytest.approx(flight["range_m"], rel=0.002)
    assert path["y"][-1] == pytest.approx(0.0, abs=0.02 * flight["apex_m"])
    assert max(path["y"]) == pytest.approx(flight["apex_m"], rel=0.02)
    radii = [math.hypot(arc["x"][0], arc["y"][0]) for arc in arcs]
    assert radii == pytest.approx([flight[name] for name in ("range_m", "farthest_range_m", "range_without_drag_m")])
    assert landing["x"] == pytest.approx([flight["range_m"]])
    expect(panel).not_to_contain_text("No result")
    expect(panel).to_contain_text("even that without drag, are for the exit as computed")
    labels = panel.locator(".annotation-text").all_text_contents()
    sentence = page.get_by_role("region", name="Verdict").inner_text().replace("\N{NO-BREAK SPACE}", " ")
    for distance in re.findall(r"[\d,]+ m(?= away| at any| without)", sentence):
        assert any(label.endswith(distance) for label in labels), (distance, labels)
    page.get_by_label("Oblique angle", exact=True).fill("40")
    expect(panel).to_be_hidden()


def test_animation_runs_in_steps_if_reduced_motion_is_preferred(page: Page) -> None:
    open_explore(page)
    page.get_by_label("Instant").fill("0")
    seen = page.evaluate(
        """async () => {
            const seen = new Set();
            const shown = document.querySelector('output.instant');
            new MutationObserver(() => seen.add(shown.textContent)).observe(shown, {childList: true});
            document.querySelector('.scrubber button').click();
            while (document.querySelector('.scrubber button').textContent === 'Pause')
                await new Promise(done => setTimeout(done, 50));
            return [...seen];
        }"""
    )
    assert 1 < len(seen) <= 6
    assert page.get_by_label("Instant").input_value() == page.get_by_label("Instant").get_attribute("max")


def test_downloads_of_a_plot_describe_themselves(page: Page, tmp_path: Path) -> None:
    open_explore(page)
    panel = page.locator(".side-view")
    for form in ("SVG", "PNG", "CSV"):
        name = "Download the data of the plot as CSV" if form == "CSV" else f"Download the plot as {form}"
        with page.expect_download() as download:
            panel.get_by_role("button", name=name).click()
        assert download.value.suggested_filename == f"ricochet-238mps-39MPa-45deg.{form.lower()}"
        download.value.save_as(tmp_path / f"side-view.{form.lower()}")
    picture = (tmp_path / "side-view.svg").read_text()
    assert picture.startswith("<svg")
    for words in (
        "Side view: embedded",
        "238 m/s, 45° from the normal, ogive nose, ⌀ 80 mm, 530 mm long, 13 kg, 39 MPa",
    ):
        assert words in picture
    assert re.search(r"key [0-9a-f]{64}", picture)
    assert (tmp_path / "side-view.png").read_bytes().startswith(b"\x89PNG")
    title, case, key, *_ = (tmp_path / "side-view.csv").read_text().splitlines()
    assert title == "# Side view: embedded"
    assert json.loads(case.removeprefix("# case: "))["impact"] == {"velocity_m_s": 238, "oblique_angle_deg": 45}
    assert re.fullmatch(r"# key: [0-9a-f]{64}", key)
    rows = data_rows(tmp_path / "side-view.csv")
    assert 60 <= len(rows) <= 600
    assert float(rows[0]["speed_m_s"]) == pytest.approx(238.0)
    assert float(rows[-1]["nose_tip_depth_m"]) == pytest.approx(outline(page)[1][0], rel=1e-5)


def test_copied_command_and_program_request_the_case_shown(page: Page) -> None:
    open_explore(page, "?impact.oblique_angle_deg=52")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy as curl").click()
    expect(page.get_by_text("Copied as curl.")).to_be_visible()
    command = page.evaluate("navigator.clipboard.readText()")
    body = json.loads(re.search(r"-d '(.*)'", command, re.DOTALL)[1])  # type: ignore[index]
    address = command.split()[2]
    assert httpx.post(address, json=body, trust_env=False, timeout=60.0).json()["outcome"] == "ricochet"
    page.get_by_role("button", name="Copy as Python").click()
    expect(page.get_by_text("Copied as Python.")).to_be_visible()
    program = page.evaluate("navigator.clipboard.readText()")
    compile(program, "copied", "exec")
    assert '"oblique_angle_deg": 52' in program
    copied = page.get_by_label("Copied text")
    expect(copied).to_be_visible()
    page.get_by_label("Oblique angle", exact=True).fill("53")
    expect(copied).to_be_hidden()


def test_message_after_a_click_is_not_replaced_by_a_later_update(page: Page) -> None:
    held: list[Route] = []

    def hold(route: Route) -> None:
        if "flight" in (route.request.post_data or ""):
            held.append(route)
        else:
            route.continue_()

    page.route("**/trajectory", hold)
    open_explore(page, "?impact.oblique_angle_deg=52")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    while not held:  # The flight is requested last.
        page.wait_for_timeout(50)
    status = page.locator("#status")
    expect(status).to_have_text("Out of date. Computing ...")
    page.get_by_role("button", name="Copy as curl").click()
    expect(status).to_have_text("Copied as curl.")
    for route in held:
        route.continue_()
    page.wait_for_function(IDLE)
    expect(status).to_have_text("Copied as curl.")


def test_chosen_theme_is_remembered(page: Page) -> None:
    open_explore(page)
    page.get_by_label("Theme").select_option("dark")
    page.reload()
    wait_for_picture(page)
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")


def test_every_step_of_a_moving_slider_updates_the_page(page: Page) -> None:
    open_explore(page)
    for speed in range(300, 300 + 7 * STEPS, 7):
        drawn = page.evaluate("performance.getEntriesByName('ricochet: side view').length")
        set_slider(page, "Speed", speed)
        page.wait_for_function("drawn => performance.getEntriesByName('ricochet: side view').length > drawn", arg=drawn)
    steps = page.evaluate("performance.getEntriesByName('ricochet: side view').map(entry => entry.duration)")
    assert statistics.median(steps[-STEPS:]) < PATIENCE_MS


def test_moving_slider_sends_one_request_at_a_time_with_the_latest_value(page: Page) -> None:
    open_explore(page)
    requested: list[float] = []
    running = [0]
    most = [0]

    def begin(request: Any) -> None:
        if request.url.endswith("/trajectory"):
            requested.append(json.loads(request.post_data)["impact"]["velocity_m_s"])
            running[0] += 1
            most[0] = max(most[0], running[0])

    def end(request: Any) -> None:
        running[0] -= request.url.endswith("/trajectory")

    page.on("request", begin)
    page.on("requestfinished", end)
    page.evaluate(
        """async () => {
            const slider = document.querySelector('[aria-label="Speed, slider"]');
            for (let speed = 300; speed <= 360; speed += 2) {
                slider.value = speed;
                slider.dispatchEvent(new Event('input', {bubbles: true}));
                if (speed === 300) await new Promise((resolve) => setTimeout(resolve)); // its request is on the way
            }
        }"""
    )
    page.wait_for_function("() => performance.getEntriesByName('ricochet: side view').length >= 3")
    assert most[0] == 1
    assert requested == [300, 360]
