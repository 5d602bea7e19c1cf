"""The view "Map": sweeps that run as jobs and are drawn while they run."""

import io
import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
from PIL import Image
from playwright.sync_api import Page, Route, expect

from service.schemas.strike import PAPER, PAPER_AT_45

from .conftest import NewPage, all_computed, expected, run_map
from .downloads import data_rows, saved

ROUGH = "search.tolerance_deg=1&search.lower_deg=40&search.upper_deg=80"


def open_map(page: Page, *, x: str, y: str, rest: str = ROUGH) -> None:
    page.goto(f"/#/map?x={x}&y={y}&{rest}")
    expect(page.get_by_role("button", name="Run")).to_be_enabled()


def job_of(page: Page) -> str:
    expect(page).to_have_url(re.compile("job=[0-9a-f]{32}"))
    return parse_qs(urlsplit(page.url).fragment.partition("?")[2])["job"][0]


def heat(page: Page, trace: int) -> list[list[float | None]]:
    """Return the values of a heat map, row by row."""
    values: list[list[float | None]] = page.evaluate(
        "trace => document.querySelector('.map .drawing').data[trace].z.map(row => [...row])", trace
    )
    return values


def test_large_map_is_cancelled_once_and_completed_once(page: Page, client: httpx.Client) -> None:
    open_map(page, x="impact.velocity_m_s,203,403,30", y="target.compressive_strength_pa,31e6,51e6,30")
    expect(page.locator("#map-size")).to_have_text("900 cases")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-progress")).to_have_text(re.compile(r"^[1-9]\d* of 900 cases"))
    bar = page.get_by_role("progressbar", name="Cases computed")
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#map-progress")).to_have_text(re.compile(r"^Cancelled after \d+ of 900 cases"))
    cancelled = client.get(f"/jobs/{job_of(page)}").json()
    assert cancelled["status"] == "dismissed"
    assert 0 < cancelled["counts"]["done"] < 900
    assert int(bar.get_attribute("value") or 0) == cancelled["counts"]["done"]

    seen = []
    page.get_by_role("button", name="Run").click()
    while not (words := page.locator("#map-progress").inner_text()).startswith("All"):
        seen.append(words)
        page.wait_for_timeout(250)
        assert len(seen) < 480
    assert len({words for words in seen if " of 900 cases" in words}) >= 2, seen
    assert sum(value is not None for row in heat(page, 1) for value in row) > 800
    completed = client.get(f"/jobs/{job_of(page)}").json()
    assert completed["id"] != cancelled["id"]
    assert completed["counts"]["done"] == 900


def test_map_shows_the_angles_of_the_service_and_the_clicked_cell(page: Page, client: httpx.Client) -> None:
    run_map(page, "x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3", 6)
    results = client.get(f"/jobs/{job_of(page)}/results").json()["results"]
    angles = [item["result"]["critical_angle_deg"] for item in results]
    assert heat(page, 1) == [angles[0:2], angles[2:4], angles[4:6]]
    assert abs(angles[0] - 48.63) < 0.02
    cell = page.get_by_role("region", name="One case")
    cell.get_by_label("Speed").select_option("238 m/s")
    cell.get_by_label("Mass").select_option("13 kg")
    expect(cell.get_by_role("status")).to_have_text(f"ricochet from {angles[0]:.2f}° on")
    expect(page.locator(".map .drawing")).to_contain_text("Critical angle [°]")
    expect(page.locator(".map .drawing")).to_contain_text("you are here")
    here = "() => { const { x, y } = document.querySelector('.map .drawing').data.at(-1); return [...x, ...y]; }"
    assert page.evaluate(here) == [238, 13]
    box = page.locator(".map .nsewdrag").bounding_box()
    assert box is not None
    place = (box["x"] + 0.8 * box["width"], box["y"] + 0.1 * box["height"])
    page.mouse.move(*place)
    expect(page.locator(".map .hovertext")).to_contain_text("300 m/s, 14 kg")
    page.mouse.click(*place)
    expect(cell.get_by_label("Speed")).to_have_value(re.compile(r"^300\sm/s$"))
    expect(cell.get_by_label("Mass")).to_have_value(re.compile(r"^14\skg$"))
    cell.get_by_role("link", name="Open in Explore").click()
    expect(page).to_have_url(re.compile(r"#/explore\?.*impact\.velocity_m_s=300"))
    assert "projectile.mass_kg=14" in page.url


def test_map_of_outcomes_names_each_outcome(page: Page, tmp_path: Path) -> None:
    page.goto("/#/map?operation=trajectory&x=impact.oblique_angle_deg,40,60,5&y=impact.velocity_m_s,237,239,2")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-counts")).to_have_text(re.compile(r"^4 embedded, 6 ricochet.* greatest depth \[mm\]"))
    all_computed(page, 10)
    saved(page, page.get_by_role("button", name="Download the data"), tmp_path / "map.csv")
    rows = data_rows(tmp_path / "map.csv")
    assert [row["outcome"] for row in rows] == (["embedded"] * 2 + ["ricochet"] * 3) * 2
    assert [float(row["impact.oblique_angle_deg"]) for row in rows[:5]] == [40, 45, 50, 55, 60]


def test_legend_has_the_colours_of_the_outcomes_and_marks_hide_no_numbers(page: Page) -> None:
    page.goto("/#/map?operation=trajectory&x=impact.oblique_angle_deg,45,65,5&y=impact.velocity_m_s,349,351,2")
    page.get_by_role("button", name="Run").click()
    all_computed(page, 10)
    legend: dict[str, str] = page.locator(".map .legend .traces").evaluate_all(
        """all => Object.fromEntries(all.map((each) => {
            const mark = each.querySelector('.legendpoints path');
            return [each.textContent.split(' ')[0], mark && getComputedStyle(mark).fill];
        }))"""
    )
    expect(page.locator(".map .scatterlayer path.point")).to_have_count(1)  # the star at the case
    picture = Image.open(io.BytesIO(page.locator(".map .nsewdrag").screenshot())).convert("RGB")
    for ending, across in (("embedded", 0.02), ("ricochet", 0.98)):
        colour = picture.getpixel((round(across * picture.width), round(0.9 * picture.height)))
        assert legend[ending] == f"rgb{colour}", legend


SPEEDS, ANGLES = "impact.velocity_m_s,138,338,5", "impact.oblique_angle_deg,5,85,9"
PHASES = f"operation=trajectory&x={SPEEDS}&y={ANGLES}"
BAND = "90 % range of the usual scatter"


def trace(page: Page, name: str) -> dict[str, Any]:
    """Return the trace of a map with this name in the legend."""
    found: list[dict[str, Any]] = page.locator(".map .drawing").evaluate(
        """(plot, name) => plot.data.filter((each) => each.name === name).map(({ x, y, z, visible }) =>
            ({ x: [...x], y: [...y], z: z && z.map((row) => [...row]), visible }))""",
        name,
    )
    assert len(found) == 1, f"{len(found)} traces {name}"
    return found[0]


def curve(page: Page) -> dict[float, float]:
    """Return the critical angles of a phase diagram by speed."""
    drawn = trace(page, "critical angle")
    return dict(zip(drawn["x"], drawn["y"], strict=True))


def critical_angle(client: httpx.Client, speed: float, **target: float) -> float:
    body = PAPER | {"impact": {"velocity_m_s": speed}, "target": PAPER["target"] | target}
    angle: float = client.post("/cra", json=body).raise_for_status().json()["critical_angle_deg"]
    return angle


def hold(page: Page, path: str) -> list[Route]:
    """Withhold requests until they are continued, and return the list to which they are added."""
    held: list[Route] = []
    page.route(path, lambda route: held.append(route))  # noqa: PLW0108 (Playwright takes no builtin)
    return held


@pytest.mark.parametrize("is_turned", [False, True], ids=["angle up", "angle across"])
def test_outcomes_meet_at_the_critical_angle_of_the_verdict(
    page: Page, client: httpx.Client, *, is_turned: bool
) -> None:
    hold(page, "**/cra/uncertainty/sweep")
    page.goto(f"/#/map?operation=trajectory&x={ANGLES}&y={SPEEDS}" if is_turned else f"/#/map?{PHASES}")
    all_computed(page, 45)
    drawn = trace(page, "critical angle")
    speeds, angles = (drawn["y"], drawn["x"]) if is_turned else (drawn["x"], drawn["y"])
    found = dict(zip(speeds, angles, strict=True))
    for speed in (138.0, 188.0, 238.0, 288.0, 338.0):
        assert found[speed] == critical_angle(client, speed), speed
    for speed in (163.0, 213.0, 263.0, 313.0):
        assert found[speed] == pytest.approx(critical_angle(client, speed), abs=0.1 * 10.0), "a tenth of a cell"
    expect(page.locator(".verdict .line")).to_contain_text(f"critical angle {found[238.0]:.1f}°")

    picture = Image.open(io.BytesIO(page.locator(".map .nsewdrag").screenshot())).convert("RGB")
    for speed in (163.0, 188.0, 213.0, 263.0, 288.0):
        along = (speed - 113.0) / 250.0
        colours = []
        for angle in (found[speed] - 1.2, found[speed] + 1.2):
            up = angle / 90.0
            across, down = (up, 1.0 - along) if is_turned else (along, 1.0 - up)
            x, y = round(across * picture.width), round(down * picture.height)
            block = picture.crop((x - 2, y - 2, x + 3, y + 3))
            colours.append(max(block.getcolors() or [])[1])
        assert colours == [(0x5B, 0x7F, 0xB5), (0xFD, 0xE7, 0x25)], (speed, "embedded below, ricochet above")


def test_cell_beside_the_critical_curve_keeps_its_words_and_its_row(page: Page, tmp_path: Path) -> None:
    """At 338 m/s the critical angle is above 55°, so the strike at 55° is embedded, in a cell that reaches to 60°."""
    page.goto(f"/#/map?{PHASES}")
    all_computed(page, 45)
    assert 55.0 < curve(page)[338.0] < 59.0
    box = page.locator(".map .nsewdrag").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + (1.0 - 59.5 / 90.0) * box["height"])
    expect(page.locator(".map .hovertext")).to_contain_text("338 m/s, 55°embedded")
    saved(page, page.get_by_role("button", name="Download the data"), tmp_path / "map.csv")
    rows = data_rows(tmp_path / "map.csv")
    assert len(rows) == 45
    outcome = {
        (float(row["impact.velocity_m_s"]), float(row["impact.oblique_angle_deg"])): row["outcome"] for row in rows
    }
    assert (outcome[338.0, 55.0], outcome[338.0, 65.0]) == ("embedded", "ricochet")


def test_band_of_the_critical_curve_is_that_of_the_verdict_and_moves_nothing(page: Page, client: httpx.Client) -> None:
    held = hold(page, "**/cra/uncertainty/sweep")
    page.goto(f"/#/map?{PHASES}")
    all_computed(page, 45)
    area = page.locator(".map .nsewdrag")
    expect(page.locator(".map .legend")).to_contain_text(BAND)
    assert trace(page, BAND)["visible"] == "legendonly"
    before = area.bounding_box()
    wait_for(page, held)
    page.route("**/cra/uncertainty/sweep", lambda route: route.continue_())
    held[0].continue_()
    page.wait_for_function(
        "name => document.querySelector('.map .drawing').data.find((each) => each.name === name).visible === true",
        arg=BAND,
    )
    assert area.bounding_box() == before
    expect(page.locator("#status")).to_have_text("The map shows the 90 % range of the critical angle too.")
    band = trace(page, BAND)
    column = band["x"].index(238.0)
    (low_end, high_end), (first, last) = band["y"], [row[column] for row in band["z"]]
    width = (high_end - low_end) / (last - first)
    lower = low_end - first * width
    judged = client.post("/verdict", json=PAPER_AT_45).json()["range"]
    assert lower == pytest.approx(judged["lower_deg"], abs=1.5), "256 samples"
    assert lower + width == pytest.approx(judged["upper_deg"], abs=1.5), "256 samples"


def test_legend_entry_of_the_band_does_nothing_before_the_band_is_drawn(page: Page) -> None:
    held = hold(page, "**/cra/uncertainty/sweep")
    page.goto(f"/#/map?{PHASES}")
    all_computed(page, 45)
    wait_for(page, held)
    expect(page.locator("#status")).to_contain_text("The 90 % range of the critical angle follows.")
    entry = page.locator(".map .legendtoggle").first
    expect(page.locator(".map .legendtext").first).to_have_text(BAND)
    entry.click()
    page.wait_for_timeout(600)  # Plotly waits for 300 ms for a second click.
    assert trace(page, BAND)["visible"] == "legendonly"
    for _ in range(2):
        page.locator(".map .legendtoggle").nth(1).dblclick()
        page.wait_for_timeout(600)
        assert trace(page, BAND)["visible"] == "legendonly"
        assert trace(page, "you are here")["visible"] != "legendonly"
    page.route("**/cra/uncertainty/sweep", lambda route: route.continue_())
    held[0].continue_()
    expect(page.locator("#status")).to_have_text("The map shows the 90 % range of the critical angle too.")
    assert trace(page, BAND)["visible"] is True
    page.wait_for_timeout(600)
    entry.click()
    page.wait_for_function(
        """name => document.querySelector('.map .drawing').data
            .find((each) => each.name === name).visible === 'legendonly'""",
        arg=BAND,
    )


def test_band_of_previous_inputs_is_not_drawn(page: Page, client: httpx.Client) -> None:
    held = hold(page, "**/cra/uncertainty/sweep")
    page.goto(f"/#/map?{PHASES}")
    all_computed(page, 45)
    wait_for(page, held)
    page.get_by_text("The other fields").click()
    page.get_by_role("textbox", name="Compressive strength", exact=True).fill("60")
    expect(page.locator(".map[aria-busy=true]")).to_have_count(1)
    assert curve(page)[238.0] == critical_angle(client, 238.0)
    page.get_by_role("button", name="Run").click()
    expect(page.locator(".map[aria-busy=true]")).to_have_count(0)
    all_computed(page, 45)
    assert curve(page)[238.0] == critical_angle(client, 238.0, compressive_strength_pa=60e6)
    assert trace(page, BAND)["visible"] == "legendonly"


def test_phase_diagram_without_ricochet_has_no_critical_curve(page: Page) -> None:
    rod = "projectile.nose.shape=flat&projectile.diameter_m=0.08&x=impact.velocity_m_s,500,800,3"
    page.goto(f"/#/map?operation=trajectory&{rod}&y=impact.oblique_angle_deg,5,35,3")
    all_computed(page, 9)
    expect(page.locator("#map-counts")).to_contain_text("9 embedded")
    legend = page.locator(".map .legend")
    expect(legend).to_contain_text("you are here")
    expect(legend).not_to_contain_text("critical angle")
    expect(legend).not_to_contain_text(BAND)


def wait_for(page: Page, held: list[Route]) -> None:
    """Wait until a request has been intercepted and is held."""
    for _ in range(1800):
        if held:
            return
        page.wait_for_timeout(100)
    raise AssertionError("the band is not requested")


def test_axes_follow_the_case_which_is_a_star_on_the_map(page: Page) -> None:
    page.goto("/#/map?impact.velocity_m_s=600&target.compressive_strength_pa=90e6")
    all_computed(page, 81)
    for axis, value in (("Horizontal axis", 600.0), ("Vertical axis", 90.0)):
        group = page.get_by_role("group", name=axis)
        ends = [float(group.get_by_label(end).input_value()) for end in ("From", "To")]
        assert 0.55 * value < ends[0] < value < ends[1] < 1.45 * value
    page.get_by_text("The other fields").click()
    page.get_by_role("textbox", name="Speed", exact=True).fill("120")
    horizontal = page.get_by_role("group", name="Horizontal axis")
    expect(horizontal.get_by_label("From")).to_have_value("72")
    expect(horizontal.get_by_label("To")).to_have_value("170")


def test_phase_diagram_shows_the_case_as_a_draggable_point(page: Page) -> None:
    page.goto("/#/map")
    page.get_by_label("Show").select_option("trajectory")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-counts")).to_have_text(re.compile(r"^\d+ embedded, \d+ ricochet"))
    all_computed(page, 81)
    expect(page.locator("[data-outcome]")).to_contain_text("At 45° from the normal")
    handle = page.locator(".map .handle")
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 40, y - 120, steps=5)
    page.mouse.up()
    expect(page.locator("[data-outcome=ricochet]")).to_be_visible()
    page.wait_for_timeout(400)  # The address is updated after a delay.
    angle = float(re.findall(r"oblique_angle_deg=([\d.]+)", page.url)[0])
    speed = float(re.findall(r"velocity_m_s=([\d.]+)", page.url)[0])
    assert angle > 48.63
    assert speed < 238
    here = "() => { const { x, y } = document.querySelector('.map .drawing').data.at(-1); return [...x, ...y]; }"
    assert page.evaluate(here) == [speed, angle]
    expect(page.locator(".map[aria-busy=true]")).to_have_count(0)


def test_invalid_axis_is_refused_at_its_field(page: Page) -> None:
    page.goto("/#/map")
    start = page.get_by_role("group", name="Horizontal axis").get_by_label("From")
    start.fill("-3")
    expect(page.get_by_text("Must be at least 0.1 m/s.")).to_be_visible()
    expect(start).to_have_attribute("aria-invalid", "true")
    expect(page.get_by_role("button", name="Run")).to_be_disabled()
    start.fill("500")
    expect(page.get_by_text("From must not be above To.")).to_be_visible()
    expect(page.get_by_role("button", name="Run")).to_be_disabled()
    start.fill("100")
    expect(page.get_by_role("button", name="Run")).to_be_enabled()
    page.get_by_role("group", name="Vertical axis").get_by_label("Field").select_option(label="Speed [m/s]")
    expect(page.get_by_text("Both axes have the same field.").first).to_be_visible()


def test_map_reports_a_lost_service_and_continues_when_it_returns(page: Page, faults: list[str]) -> None:
    open_map(page, x="impact.velocity_m_s,238,300,2", y="projectile.mass_kg,13,14,3", rest="")
    page.route("**/jobs/**", lambda route: route.abort())
    page.get_by_role("button", name="Run").click()
    lost = page.get_by_role("alert").filter(has_text="The service does not answer.")
    expect(lost).to_be_visible()
    page.unroute("**/jobs/**")
    all_computed(page, 6)
    expect(page.locator("#map-counts")).to_contain_text("6 with an angle")
    expect(lost).to_have_count(0)
    expected(faults, "ERR_FAILED")


@pytest.mark.parametrize("size", [2, 12])
def test_lost_preview_and_coarse_grid_are_requested_again(page: Page, faults: list[str], size: int) -> None:
    page.route("**/cra/sweep", lambda route: route.abort())
    open_map(page, x=f"impact.velocity_m_s,238,300,{size}", y=f"projectile.mass_kg,13,14,{size}", rest="")
    if size > 10:
        page.get_by_role("button", name="Run").click()
    lost = page.get_by_role("alert").filter(has_text="The service does not answer.")
    expect(lost).to_be_visible()
    page.unroute("**/cra/sweep")
    expect(page.locator("#map-progress")).to_have_text(f"All {size * size} cases are computed.")
    expect(lost).to_have_count(0)
    expected(faults, "ERR_FAILED")


def test_map_of_probabilities_has_the_numbers_of_the_service(page: Page, client: httpx.Client, tmp_path: Path) -> None:
    run_map(page, "operation=probability&x=impact.oblique_angle_deg,30,70,3&y=impact.velocity_m_s,238,300,2", 6)
    expect(page.locator("#map-counts")).to_contain_text("6 with a probability")
    expect(page.locator("#map-counts")).to_contain_text("with the scatter of speed, compressive strength, density")
    drawn = heat(page, 1)
    scatter = client.post("/verdict", json=PAPER_AT_45).json()["usual_scatter"]
    sampling = {"max_samples": 256, "method": "direct", "half_width": 0.5}
    for column, angle in enumerate((30.0, 50.0, 70.0)):
        impact = {"velocity_m_s": 238.0, "oblique_angle_deg": angle}
        body = PAPER | {"impact": impact, "uncertain": scatter, "sampling": sampling}
        answer = client.post("/trajectory/uncertainty", json=body, timeout=60.0).raise_for_status().json()
        outcomes = {each["outcome"]: each["value"] for each in answer["outcomes"]}
        assert drawn[0][column] == pytest.approx(outcomes.get("ricochet", 0.0), abs=1e-9)
    assert drawn[0][0] is not None
    assert drawn[0][2] is not None
    assert drawn[0][0] < 0.2
    assert drawn[0][2] > 0.8
    saved(page, page.get_by_role("button", name="Download the data"), tmp_path / "map.csv")
    rows = data_rows(tmp_path / "map.csv")
    assert [float(row["ricochet_probability"]) for row in rows] == [value for row in drawn for value in row]
    assert all(re.fullmatch("[0-9a-f]{64}", row["key"]) for row in rows)


def test_map_of_probabilities_is_reopened_from_its_address_or_from_the_jobs(new_page: NewPage) -> None:
    page = new_page()
    query = "operation=probability&x=impact.velocity_m_s,238,300,2&y=target.compressive_strength_pa,39e6,48e6,2"
    run_map(page, f"{query}&projectile.mass_kg=14", 4)
    job = job_of(page)
    words, drawn = page.locator("#map-counts").inner_text(), heat(page, 1)
    other = new_page()
    other.goto(page.url)
    all_computed(other, 4)
    expect(other.locator("#map-counts")).to_have_text(words)
    assert heat(other, 1) == drawn
    other.get_by_text("The other fields").click()
    expect(other.get_by_role("textbox", name="Mass", exact=True)).to_have_value("14")
    other.goto("/#/jobs")
    other.get_by_role("link", name=f"Open job {job[:8]} as a map").click()
    all_computed(other, 4)
    assert job_of(other) == job
    assert heat(other, 1) == drawn


def test_map_of_probabilities_is_limited_and_can_be_cancelled(page: Page, client: httpx.Client) -> None:
    page.goto("/#/map?operation=probability&x=impact.velocity_m_s,150,450,13&y=projectile.mass_kg,11,17,12")
    expect(page.get_by_text("Must be 1 to 12 values.")).to_be_visible()
    expect(page.get_by_role("button", name="Run")).to_be_disabled()
    page.get_by_role("group", name="Horizontal axis").get_by_label("Values").fill("12")
    page.get_by_role("button", name="Run").click()
    expect(page.locator("#map-progress")).to_have_text(re.compile(r"^[1-9]\d* of 144 cases"))
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#map-progress")).to_have_text(re.compile(r"^Cancelled after \d+ of 144 cases\.$"))
    words = page.locator("#map-progress").inner_text()
    assert client.get(f"/jobs/{job_of(page)}").json()["status"] == "dismissed"
    page.wait_for_timeout(1_000)
    assert page.locator("#map-progress").inner_text() == words
    expect(page.get_by_role("button", name="Cancel")).to_be_disabled()


def test_rare_warnings_are_named_in_the_legend(page: Page) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,100,900,9&y=target.compressive_strength_pa,20e6,100e6,9")
    all_computed(page, 81)
    legend = page.locator(".map .drawing").evaluate("plot => plot.data.map(({ name }) => name).filter(Boolean)")
    named = [each for each in legend if each.startswith("warning: ")]
    assert named, legend
    assert all(re.fullmatch(r"warning: [A-Za-z ]+ \(\d+\)", each) for each in named)


def test_downloads_of_a_map_name_the_axes_and_omit_their_base_values(page: Page, tmp_path: Path) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,238,300,2&y=target.compressive_strength_pa,39e6,50e6,2")
    all_computed(page, 4)
    for form, button in {"csv": "Download the data", "svg": "Download the plot as SVG"}.items():
        with page.expect_download() as download:
            page.get_by_role("button", name=button).click()
        name = f"ricochet-critical-angle-over-speed-and-compressive-strength.{form}"
        assert download.value.suggested_filename == name
        download.value.save_as(tmp_path / f"map.{form}")
    title, case, *rest = (tmp_path / "map.csv").read_text().splitlines()
    assert title == "# Critical angle over speed and compressive strength"
    fixed = json.loads(case.removeprefix("# case: "))
    assert fixed["target"] == {"density_kg_m3": 2250.0}
    assert "impact" not in fixed or "velocity_m_s" not in fixed["impact"]
    assert not any(line.startswith("# key") for line in rest), "a preview is no job"
    assert all(re.fullmatch("[0-9a-f]{64}", row["key"]) for row in data_rows(tmp_path / "map.csv"))
    picture = (tmp_path / "map.svg").read_text()
    assert "Critical angle over speed and compressive strength" in picture
    assert "ogive nose, ⌀ 80 mm, 530 mm long, 13 kg, 2250 kg/m³" in picture
    assert "238 m/s" not in picture


def test_map_whose_job_is_missing_can_be_run_again(page: Page, faults: list[str]) -> None:
    page.goto(f"/#/map?x=impact.velocity_m_s,238,300,2&y=projectile.mass_kg,13,14,3&job={'0' * 32}")
    expect(page.get_by_role("alert")).to_have_text("The job of this map has expired or was deleted. Run the map again.")
    page.get_by_role("button", name="Run").click()
    all_computed(page, 6)
    expected(faults, "404")


def test_view_opens_with_a_small_map_without_a_job(page: Page, client: httpx.Client) -> None:
    before = client.get("/jobs").json()["jobs"]
    page.goto("/#/map?impact.velocity_m_s=260")
    all_computed(page, 81)
    angles = heat(page, 1)
    assert (len(angles), len(angles[0])) == (9, 9)
    body = PAPER | {"impact": {"velocity_m_s": 160.0}, "target": PAPER["target"] | {"compressive_strength_pa": 23e6}}
    assert angles[0][0] == client.post("/cra", json=body).json()["critical_angle_deg"]
    assert client.get("/jobs").json()["jobs"] == before
    expect(page.locator(".map .drawing")).to_contain_text("you are here")


def test_large_map_appears_on_a_coarse_grid_first(page: Page) -> None:
    open_map(page, x="impact.velocity_m_s,207,397,20", y="target.compressive_strength_pa,32e6,51e6,20")
    page.route("**/jobs/*/results?*", lambda route: route.abort())
    page.get_by_role("button", name="Run").click()
    expect(page.locator(".map .drawing .hm image").first).to_be_visible()
    coarse = heat(page, 1)
    assert len({value for row in coarse for value in row}) <= 64
    assert all(value is not None for row in coarse for value in row)
    assert all(value is None for row in heat(page, 2) for value in row), "a coarse grid has no contours"
    page.unroute("**/jobs/*/results?*")
    all_computed(page, 400)
    expect(page.locator("#map-counts")).to_contain_text("400 with an angle")
    fine = heat(page, 1)
    assert len({value for row in fine for value in row}) > 64
    assert any(value is not None for row in heat(page, 2) for value in row), "contours of the finished map"
    assert fine[0][0] == pytest.approx(coarse[0][0], abs=1.0)
    assert fine[-1][-1] == pytest.approx(coarse[-1][-1], abs=1.0)


def test_diameter_of_a_sphere_is_no_axis(page: Page) -> None:
    """Its length would have to vary with it, and a sweep varies each field by itself."""
    page.goto("/#/map?projectile.nose.shape=sphere&projectile.diameter_m=0.02&projectile.mass_kg=0.0329")
    fields = page.get_by_role("group", name="Horizontal axis").get_by_label("Field")
    expect(fields.locator("option", has_text="Mass [kg]")).to_have_count(1)
    expect(fields.locator("option", has_text="Diameter [mm]")).to_have_count(0)


def test_contour_lines_have_levels_of_the_quantity_that_is_drawn(page: Page) -> None:
    run_map(page, "x=impact.velocity_m_s,140,330,3&y=target.compressive_strength_pa,23e6,55e6,3", 9)
    expect(page.locator(".map .contourlabels text").first).to_be_visible()
    page.get_by_label("Show").select_option(label="Least thickness at an angle")
    page.get_by_role("button", name="Run").click()
    # The least of the thicknesses is greater than all angles of the map before [mm].
    drawn = page.wait_for_function(
        """() => {
            const lines = document.querySelector(".map .drawing").data?.find(({ type }) => type === "contour");
            const values = lines?.z.flatMap((row) => [...row]) ?? [0];
            const { start, end, size } = lines?.contours ?? {};
            return Math.min(...values) > 66 && [start, end, size, Math.min(...values), Math.max(...values)];
        }"""
    )
    first, last, step, least, most = drawn.json_value()
    assert least <= first <= last <= most
    assert 2 <= (most - least) / step <= 15


def test_map_of_least_thickness_has_the_numbers_of_the_service(
    page: Page, client: httpx.Client, tmp_path: Path
) -> None:
    run_map(page, "operation=thickness&x=impact.velocity_m_s,200,300,2&y=impact.oblique_angle_deg,0,30,2", 4)
    expect(page.locator("#map-counts")).to_contain_text("4 with a thickness")
    expect(page.locator(".map .drawing")).to_contain_text("Least thickness [mm]")
    results = client.get(f"/jobs/{job_of(page)}/results").json()["results"]
    thickness = [1e3 * item["result"]["least_thickness_m"] for item in results]
    assert heat(page, 1) == [pytest.approx(thickness[:2]), pytest.approx(thickness[2:])]
    expect(page.get_by_role("region", name="One case").get_by_role("status")).to_contain_text("stopped by")
    saved(page, page.get_by_role("button", name="Download the data"), tmp_path / "map.csv")
    rows = data_rows(tmp_path / "map.csv")
    assert [1e3 * float(row["least_thickness_m"]) for row in rows] == pytest.approx(thickness)


def test_map_of_earlier_inputs_is_marked(page: Page) -> None:
    page.goto("/#/map?x=impact.velocity_m_s,230,300,2&y=projectile.mass_kg,12,14,2")
    all_computed(page, 4)
    picture = page.get_by_role("region", name="Picture")
    stop = page.get_by_role("group", name="Horizontal axis").get_by_label("To")
    for value, marked in (("310", 1), ("300", 0)):
        stop.fill(value)
        expect(page.locator(".map[aria-busy=true]")).to_have_count(marked)
    expect(picture).to_be_visible()
    stop.fill("310")
    page.get_by_role("button", name="Run").click()
    all_computed(page, 4)
    expect(page.locator("[aria-busy=true]")).to_have_count(0)


def test_map_of_angles_of_a_wall_shows_no_probability(page: Page) -> None:
    page.goto(
        "/#/map?target.thickness_m=0.2&x=impact.velocity_m_s,230,250,3&y=target.compressive_strength_pa,38e6,40e6,3"
    )
    all_computed(page, 9)
    one = page.get_by_role("region", name="One case")
    expect(one.locator("output")).to_have_text(re.compile(r"^ricochet from \d\d\.\d\d° on$"))
    expect(one).to_contain_text("Warnings: retention energy decides the angle, ")
    expect(one).not_to_contain_text(re.compile("no measured angle|mass properties assumed"))


def test_legend_fits_the_width_of_a_phone(new_page: NewPage) -> None:
    page = new_page(width=390, height=844)
    open_map(page, x="impact.oblique_angle_deg,20,75,5", y="impact.velocity_m_s,100,300,5", rest="operation=trajectory")
    page.get_by_role("button", name="Run").click()
    all_computed(page, 25)
    page.locator(".map .drawing").evaluate(
        """async (plot) => {
            const files = performance.getEntriesByType('resource').map(({ name }) => name);
            const { mapTraces } = await import(files.find((name) => name.endsWith('/map-plot.js')));
            const axis = { label: '', unit: '', shown: [1, 2, 3] };
            const warnings = (i) => (i ? [] : ['implausible']);
            const cells = Array.from({ length: 9 }, (_, i) => ({ ending: 'embedded', warnings: warnings(i) }));
            const traces = mapTraces('trajectory', [axis, axis], cells, [], 9, [1, 1]);
            const longest = traces.find(({ name }) => /^warning/.test(name));
            await window.Plotly.addTraces(plot, { ...longest, x: [20], y: [100] });
        }"""
    )
    plot = page.locator(".map .drawing").bounding_box()
    assert plot is not None
    texts = page.locator(".map .legendtext").all()
    assert any("breaks a rule" in (text.text_content() or "") for text in texts)
    for text in texts:
        box = text.bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= plot["x"] + plot["width"], text.text_content()


def test_phase_diagram_has_a_line_above_which_the_body_yields(page: Page) -> None:
    """The line separates cells with the warning about bending from cells without it."""
    axes = "x=impact.oblique_angle_deg,30,60,4&y=impact.velocity_m_s,100,300,5"
    run_map(page, f"operation=trajectory&{axes}", 20)
    line = page.locator(".map .drawing").evaluate(
        "plot => plot.data.filter(({name}) => /yields in bending/.test(name)).map(({z, contours}) => ({z, contours}))"
    )
    assert len(line) == 1
    assert (line[0]["contours"]["start"], line[0]["contours"]["end"]) == (1, 1)
    for row, speed in enumerate((100.0, 150.0, 200.0, 250.0, 300.0)):
        for column, angle in enumerate((30.0, 40.0, 50.0, 60.0)):
            strike = PAPER_AT_45 | {"impact": {"velocity_m_s": speed, "oblique_angle_deg": angle}}
            codes = {
                each["code"]
                for each in httpx.post(f"{page.url.split('#')[0]}trajectory", json=strike).json()["warnings"]
            }
            assert ("bends" in codes) == (line[0]["z"][row][column] > 1.0), (speed, angle)
