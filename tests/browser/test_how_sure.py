"""The view "How sure": the probability of ricochet of a case with scattering inputs."""

import re
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, Request, Route, expect

from service.schemas.strike import PAPER

from .conftest import NewPage, expected
from .downloads import data_rows, saved

SVG = "{http://www.w3.org/2000/svg}"
SPEED, STRENGTH = "impact.velocity_m_s", "target.compressive_strength_pa"
TWO = f"scatter={SPEED},normal,coefficient_of_variation:0.02&scatter={STRENGTH},lognormal,dispersion:0.15"
TWO_INPUTS = [
    {"field": SPEED, "distribution": {"type": "normal", "mean": 238.0, "coefficient_of_variation": 0.02}},
    {"field": STRENGTH, "distribution": {"type": "lognormal", "median": 39e6, "dispersion": 0.15}},
]


def run(page: Page) -> None:
    page.get_by_role("button", name="Run").click()
    wait(page)


def wait(page: Page) -> None:
    expect(page.locator("#study-progress")).to_have_text("Done.")


def answer_of(client: httpx.Client, **rest: Any) -> dict[str, Any]:
    """Return the service's answer to the paper's case with the inputs of `TWO_INPUTS`."""
    answer = client.post("/cra/uncertainty", json=PAPER | {"uncertain": TWO_INPUTS} | rest)
    answer.raise_for_status()
    found: dict[str, Any] = answer.json()
    return found


def drawn(page: Page) -> list[list[float]]:
    """Return the plotted probabilities: lower and upper limit of the band, the curve, and the point of the case."""
    plot = page.get_by_role("img", name=re.compile("Probability of ricochet"))
    found: list[list[float]] = plot.evaluate("plot => plot.data.map(({ y }) => [...y])")
    return found


def curve_of(picture: Path) -> list[tuple[float, float]]:
    """Return the points of the curve in an SVG file, in the units of its axes."""
    root = ET.parse(picture).getroot()  # noqa: S314 (the page's own)

    def ticks(name: str, index: int) -> np.ndarray:
        """Fit the straight line from positions to values of an axis; return its slope and offset."""
        marks = [
            (float(re.findall(r"-?[\d.]+", text.get("transform", ""))[index]), float("".join(text.itertext())))
            for group in root.iter(f"{SVG}g")
            if group.get("class") == name
            for text in group.iter(f"{SVG}text")
        ]
        places, numbers = np.array(marks).T
        slope_and_offset: np.ndarray = np.polyfit(places, numbers, 1)
        return slope_and_offset

    across, up = ticks("xtick", 0), ticks("ytick", 1)
    plot = next(group for group in root.iter(f"{SVG}g") if group.get("class") == "xy" and group.get("transform"))
    left, top = map(float, re.findall(r"-?[\d.]+", plot.get("transform", "")))
    lines = [path for path in plot.iter(f"{SVG}path") if path.get("class") == "js-line"]
    path = next(each for each in lines if "stroke-width: 2px" in each.get("style", ""))
    numbers = np.array(re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", path.get("d", "")), dtype=float).reshape(-1, 2)
    return [(float(np.polyval(across, x + left)), float(np.polyval(up, y + top))) for x, y in numbers]


def test_band_has_the_numbers_of_the_service_also_in_link_and_download(
    page: Page, new_page: NewPage, client: httpx.Client, tmp_path: Path
) -> None:
    page.goto("/#/how-sure")
    for name in ("Density", "Mass", "Angle of attack", "Theory of the decay", "Factor on the strength factor"):
        page.get_by_role("button", name=f"Remove {name}", exact=True).click()
    page.get_by_role("group", name="Speed").get_by_label("Coefficient of variation").fill("2")
    page.get_by_role("group", name="Compressive strength").get_by_label("Dispersion").fill("0.15")
    run(page)
    answer = answer_of(client)
    probability = answer["probability"]
    assert answer["converged"]
    lower, upper, curve, [mine] = drawn(page)
    assert mine == pytest.approx(np.interp(45.0, probability["oblique_angle_deg"], curve))
    plot = page.get_by_role("img", name=re.compile(r"At 45°: 0\.\d+, sampling error ± 0\.\d+"))
    frame, label = plot.bounding_box(), plot.locator(".annotation").bounding_box()
    assert frame is not None
    assert label is not None
    assert frame["x"] <= label["x"]
    assert label["x"] + label["width"] <= frame["x"] + frame["width"]
    assert (lower, upper, curve) == (
        probability["lower"],
        probability["upper"],
        probability["ricochet_probability"],
    )
    assert max(np.subtract(upper, lower)) > 0.001
    expect(page.get_by_role("region", name="Answer")).to_contain_text("verdict has the angle with the inputs as given")
    headline = page.locator(".range").inner_text()
    quantiles = {each["level"]: each["value"] for each in answer["critical_angle"]["quantiles"]}
    assert re.findall(r"[\d.]+", headline) == [f"{quantiles[level]:.0f}" for level in (0.5, 0.05, 0.95)]
    table = page.get_by_role("table", name="Sobol indices of the critical angle")
    for row, each in zip(table.locator("tbody tr").all(), answer["sensitivity"], strict=True):
        index, *ends = (f"{each['total'][name]:.2f}" for name in ("value", "lower", "upper"))
        whole = index if ends == [index, index] else f"{index} ({' to '.join(ends)})"
        expect(row.locator("td").nth(1)).to_have_text(whole)

    other = new_page(theme="dark")
    other.goto(page.url)
    wait(other)
    assert other.url == page.url
    assert drawn(other)[:3] == [lower, upper, curve]

    for name in ("SVG", "CSV"):
        what = "the plot as SVG" if name == "SVG" else "the data of the plot as CSV"
        saved(page, page.get_by_role("button", name=f"Download {what}").first, tmp_path / f"curve.{name.lower()}")
    rows = data_rows(tmp_path / "curve.csv")
    table_of = {name: [float(row[name]) for row in rows] for name in rows[0]}
    assert table_of == probability
    picture = tmp_path / "curve.svg"
    assert headline in picture.read_text()
    points = curve_of(picture)
    assert len(points) > 10
    assert all(first[0] < second[0] for first, second in pairwise(points))
    for angle, value in points:
        expected = np.interp(angle, table_of["oblique_angle_deg"], table_of["ricochet_probability"])
        assert value == pytest.approx(expected, abs=0.01)


def test_study_of_the_usual_scatter_is_computed_once(page: Page, client: httpx.Client) -> None:
    asked: list[Any] = []

    def hear(request: Request) -> None:
        if request.method == "POST" and request.url.endswith("/cra/uncertainty"):
            asked.append(request.post_data_json)

    page.on("request", hear)
    with page.expect_response("**/verdict") as judged:
        page.goto("/#/how-sure?impact.velocity_m_s=251")
    wait(page)
    verdict = judged.value.json()
    study = client.get(f"/results/{verdict['keys']['uncertainty']}").json()
    sampling = client.get("/openapi.json").json()["components"]["schemas"]["SamplingSettings"]["properties"]
    is_enough = study["convergence"]["half_width"][-1] <= sampling["half_width"]["x-default"]
    # The study of the verdict is shown; more samples are computed only if its sampling error is too large.
    assert [body["uncertain"] for body in asked] == ([] if is_enough else [verdict["usual_scatter"]])
    if is_enough:
        assert drawn(page)[2] == study["probability"]["ricochet_probability"]


def test_invalid_distributions_are_marked_at_their_fields(page: Page, faults: list[str]) -> None:
    page.goto("/#/how-sure")
    # The answer of /verdict contains the usual scatter of the case, which overwrites the fields.
    expect(page.get_by_role("region", name="Verdict")).to_contain_text("90 % range")
    dispersion = page.get_by_role("group", name="Compressive strength").get_by_label("Dispersion")
    dispersion.fill("-0.12")
    page.get_by_role("button", name="Run").click()
    expect(dispersion).to_have_attribute("aria-invalid", "true")
    expect(dispersion).to_have_accessible_description(re.compile("must be greater than 0, got -0.12"))
    dispersion.fill("0.12")
    expect(dispersion).not_to_have_attribute("aria-invalid", "true")
    strength = page.get_by_role("group", name="Compressive strength")
    strength.get_by_label("Distribution").select_option("Truncated normal")
    strength.get_by_label("Coefficient of variation").fill("-12")
    strength.get_by_label("Lower").fill("45")
    page.get_by_role("button", name="Run").click()
    variation = strength.get_by_label("Coefficient of variation")
    expect(variation).to_have_accessible_description(re.compile(r"must be greater than 0\s%, got -12\s%"))
    variation.fill("12")
    page.get_by_role("button", name="Run").click()
    expect(strength.get_by_label("Lower")).to_have_accessible_description(
        re.compile(r"must be below the mean, 39\sMPa")
    )
    strength.get_by_label("Lower").fill("30")
    decay = page.get_by_role("group", name="Theory of the decay")
    decay.get_by_label("Mohr-Coulomb").fill("0.3")
    page.get_by_role("button", name="Run").click()
    expect(decay.get_by_text("must sum to 1, got 1.1")).to_be_visible()
    refusals = [fault for fault in faults if "422" in fault and "/cra/uncertainty" in fault]
    assert len(refusals) >= 4
    for each in refusals:
        faults.remove(each)
    variation.fill("wide")
    expect(variation).to_have_accessible_description(re.compile("not a number"))
    expect(page.get_by_role("button", name="Run")).to_be_disabled()


def test_lost_submission_is_repeated(page: Page, faults: list[str]) -> None:
    page.route("**/cra/uncertainty", lambda route: route.abort())
    page.goto(f"/#/how-sure?{TWO}")
    expect(page.get_by_role("alert").filter(has_text="The service does not answer.")).to_be_visible()
    page.wait_for_timeout(9_000)  # This allows more than five tries.
    page.unroute("**/cra/uncertainty")
    wait(page)
    expect(page.get_by_role("alert").filter(has_text="The service does not answer.")).to_have_count(0)
    expected(faults, "ERR_FAILED")


def test_study_stopped_during_its_submission_leaves_no_job_running(page: Page) -> None:
    held: list[Route] = []

    def hold(route: Route) -> None:
        held.append(route)

    page.route("**/cra/uncertainty", hold)
    with page.expect_request("**/cra/uncertainty"):
        page.goto(f"/#/how-sure?{TWO}&sampling.half_width=0.0001&sampling.max_samples=4096&sampling.seed=4")
    page.get_by_role("button", name="Stop").click()
    with page.expect_response("**/cancel") as cancelled:
        held[0].continue_()
    assert cancelled.value.json()["status"] == "dismissed"


def test_study_is_stopped_by_button_and_by_a_changed_form(page: Page) -> None:
    page.goto(f"/#/how-sure?{TWO}&sampling.half_width=0.0001&sampling.max_samples=1024&sampling.seed=3")
    stop = page.get_by_role("button", name="Stop")
    expect(stop).to_be_enabled()
    stop.click()
    expect(page.locator("#study-progress")).to_have_text("Stopped.")
    expect(stop).to_be_disabled()
    page.get_by_role("button", name="Run").click()
    expect(stop).to_be_enabled()
    page.get_by_label("Dispersion").fill("0.2")
    expect(stop).to_be_disabled()
    expect(page).to_have_url(re.compile("dispersion%3A0.2"))


def test_study_reruns_automatically_and_marks_the_old_numbers(page: Page) -> None:
    page.goto(f"/#/how-sure?{TWO}&sampling.max_samples=1024")
    wait(page)
    stale = page.locator("[aria-busy=true]").filter(has=page.locator(".range"))
    dispersion = page.get_by_label("Dispersion")
    dispersion.fill("0.2")
    expect(stale).to_have_count(1)
    wait(page)  # No click is needed.
    expect(stale).to_have_count(0)
    page.get_by_text("The case", exact=True).click()
    page.get_by_role("textbox", name="Speed", exact=True).fill("-5")
    expect(page.locator(".range")).to_be_hidden()
    expect(page.get_by_role("button", name="Run")).to_be_disabled()
    page.get_by_role("textbox", name="Speed", exact=True).fill("240")
    expect(page.get_by_role("button", name="Run")).to_be_enabled()


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
def test_button_and_results_stay_in_reach_of_a_long_form(page: Page, size: tuple[int, int]) -> None:
    width, height = size
    page.set_viewport_size({"width": width, "height": height})
    page.goto("/#/how-sure")
    expect(page.get_by_role("button", name="Run")).to_be_in_viewport()
    page.goto(f"/#/how-sure?{TWO}&sampling.max_samples=512")
    wait(page)
    page.mouse.wheel(0, 400)
    expect(page.get_by_role("button", name="Run")).to_be_in_viewport()
    page.get_by_role("button", name="Show the results").click()
    expect(page.get_by_role("region", name="Answer")).to_be_in_viewport()


def test_label_of_the_case_stands_above_the_curve_on_a_phone(new_page: NewPage) -> None:
    page = new_page(width=390, height=844)
    page.goto(f"/#/how-sure?{TWO}&sampling.max_samples=512")
    wait(page)
    page.get_by_text("The case", exact=True).click()
    plot = page.locator(".curve .drawing")
    for angle in ("40", "47", "48.5", "50", "55.25"):
        page.get_by_label("Oblique angle", exact=True).fill(angle)
        note = plot.locator(".annotation")
        expect(note).to_contain_text(f"{angle}°: ")
        words, axes, frame = (part.bounding_box() for part in (note, plot.locator(".nsewdrag"), plot))
        assert words is not None
        assert axes is not None
        assert frame is not None
        assert words["y"] + words["height"] <= axes["y"] + 1.0
        assert frame["x"] <= words["x"]
        assert words["x"] + words["width"] <= frame["x"] + frame["width"]
        title = plot.locator(".gtitle").bounding_box()
        assert title is not None
        assert title["y"] + title["height"] <= words["y"] + 4.0, "the box of a text has some room above and below"
