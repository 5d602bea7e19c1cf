"""The view "Critical angle": every trial of the searches, and strikes just below and just above the angle."""

import re
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from service.schemas.strike import PAPER, PAPER_AT_45

from .conftest import unfold
from .downloads import data_rows

SEARCHES = {"Change of outcome": "outcome", "Bisection (paper)": "bisection", "Secant (paper)": "secant"}
PAPER_AT_52 = PAPER_AT_45 | {"impact": PAPER_AT_45["impact"] | {"oblique_angle_deg": 52.0}}


def open_view(page: Page, query: str = "") -> None:
    page.goto(f"/#/critical-angle{query}")
    page.get_by_text("How it was found").click()
    for caption in SEARCHES:
        expect(page.get_by_role("table", name=caption)).to_be_visible()
    expect(page.locator(".side-view svg .moving").last).to_be_visible()


def cells(page: Page, caption: str) -> list[list[str]]:
    rows = page.get_by_role("table", name=caption).locator("tbody tr")
    return [[" ".join(text.split()) for text in row.locator("td").all_inner_texts()] for row in rows.all()]


def drawn(page: Page, plot: int) -> list[list[float]]:
    """Return the y values of each search in one of the two plots of the trials (0 or 1)."""
    plots = page.locator(".trials .drawing")
    found: list[list[float]] = plots.nth(plot).evaluate("plot => plot.data.map(({ y }) => [...y])")
    return found


def test_searches_are_shown_side_by_side_with_the_numbers_of_the_service(page: Page, client: httpx.Client) -> None:
    open_view(page)
    summary = {row[0]: row[1:] for row in cells(page, "Results")}
    for number, (caption, method) in enumerate(SEARCHES.items()):
        answer = client.post("/cra", json=PAPER | {"search": {"method": method}}).json()
        trials = answer["iterations"]
        assert summary[caption][0] == f"{answer['critical_angle_deg']:.2f}°"
        assert summary[caption][2] == str(len(trials))
        assert [float(row[1]) for row in cells(page, caption)] == pytest.approx(
            [trial["oblique_angle_deg"] for trial in trials], abs=5e-4
        )
        assert drawn(page, 0)[number] == pytest.approx([trial["oblique_angle_deg"] for trial in trials])
        assert drawn(page, 1)[number] == pytest.approx([1e3 * trial["final_position_m"] for trial in trials])


def test_paper_case_shows_its_angle_and_strikes_around_it(page: Page) -> None:
    open_view(page)
    shown = float(page.locator(".angle").inner_text().rstrip("°"))
    assert shown == 48.6
    below, above = page.get_by_role("img", name=re.compile("Side view")).all()
    expect(below).to_have_attribute("aria-label", re.compile(r"48\.\d\d°: embedded"))
    expect(above).to_have_attribute("aria-label", re.compile(r"49\.\d\d°: ricochet"))


def test_distance_from_the_angle_is_stored_in_the_url(page: Page, new_page: Callable[..., Page]) -> None:
    open_view(page)
    page.get_by_label("Distance from the critical angle").select_option("2°")
    pictures = [re.compile(r"46\.6\d°: embedded"), re.compile(r"50\.6\d°: ricochet")]
    for picture in pictures:
        expect(page.get_by_role("img", name=picture)).to_be_visible()
    expect(page).to_have_url(re.compile("offset_deg=2"))
    other = new_page()
    other.goto(page.url)
    for picture in pictures:
        expect(other.get_by_role("img", name=picture)).to_be_visible()


def test_other_laws_are_listed(page: Page, client: httpx.Client) -> None:
    open_view(page)
    page.get_by_text("Under other laws").click()
    answer = client.post("/cra", json=PAPER | {"alternatives": True}).json()
    shown = [f"{each['critical_angle_deg']:.2f}°" for each in answer["alternatives"]]
    expect(page.get_by_role("table", name="Under other laws")).to_be_visible()
    rows = cells(page, "Under other laws")
    assert [row[2] for row in rows] == shown
    assert [row[3] for row in rows] == [each["fitted_to"] for each in answer["alternatives"]]


def test_range_without_ricochet_is_shown_in_words(page: Page) -> None:
    page.goto("/#/critical-angle?search.upper_deg=30")
    expect(page.locator("[data-outcome]")).to_contain_text("No critical angle: nothing from 5° to 30° is turned away")
    expect(page.get_by_role("heading", name="Just below and just above")).to_be_hidden()


def test_trials_are_downloaded_as_csv(page: Page, tmp_path: Path) -> None:
    open_view(page)
    with page.expect_download() as data:
        page.locator(".angles").get_by_role("button", name="Download the data of the plot as CSV").click()
    data.value.save_as(tmp_path / "trials.csv")
    rows = data_rows(tmp_path / "trials.csv")
    assert {row["search"] for row in rows} == set(SEARCHES.values())
    for caption, method in SEARCHES.items():
        assert sum(row["search"] == method for row in rows) == len(cells(page, caption))


def test_verdict_equals_the_verdict_of_the_service(page: Page, client: httpx.Client) -> None:
    page.goto("/#/critical-angle?impact.oblique_angle_deg=52")
    models = {"strength_factor": {"model": "obliquity_polynomial"}, "free_surface": {"model": "elastic_plastic"}}
    answer = client.post("/verdict", json=PAPER_AT_52 | {"resistance": models}).json()
    verdict = page.get_by_role("region", name="Verdict")
    first, *others = re.split(r"(?<=\.) (?=[A-Z])", answer["sentence"])
    card = page.locator("[data-outcome=ricochet]")
    expect(card.locator("strong").first).to_have_text(first)
    for sentence in others:
        plain, _, _ = sentence.partition(";")  # The rest of the sentence, about the theories, is shown on the strip.
        expect(card.locator(".rest")).to_contain_text(plain.rstrip("."))
    expect(card).to_contain_text(f"90 % range {answer['range_text']}")
    theories = [each["critical_angle_deg"] for each in answer["theories"]]
    strip = verdict.locator(".head .strip")
    assert strip.locator("line:is(.theory, .critical)").count() == len(theories), "one of them has the critical angle"
    for words in (
        "your angle 52°",
        "critical angle, elastic-plastic",
        f"Mohr-Coulomb {theories[1]:.1f}° with its S",
        "90 % range",
    ):
        expect(strip).to_contain_text(words)
    expect(
        verdict.get_by_role("img", name=re.compile("Your angle 52°, critical angle 48.6°, theories"))
    ).to_be_visible()
    page.get_by_text("What the range stands for").click()
    for angle in theories:
        expect(page.get_by_role("group", name="Spread")).to_contain_text(f"{angle:.1f}°")


def test_angle_changes_with_the_choice_of_model(page: Page, client: httpx.Client) -> None:
    page.goto("/#/critical-angle")
    unfold(page)
    page.get_by_label("Free surface").select_option("mohr_coulomb")
    body = PAPER | {"resistance": {"free_surface": {"model": "mohr_coulomb"}}}
    angle = client.post("/cra", json=body).json()["critical_angle_deg"]
    expect(page.locator(".angle")).to_have_text(f"{angle:.1f}°")


def test_curves_are_computed_by_a_sweep_around_the_case(page: Page, client: httpx.Client) -> None:
    page.goto("/#/critical-angle")
    expect(page.locator(".curves .scatterlayer .trace").last).to_be_visible()
    curves = page.locator(".curves .drawing").evaluate("plot => plot.data.map(({ x, y }) => [[...x], [...y]])")
    speeds, angles = curves[0]
    assert 238.0 in speeds
    for i in (0, 6, 12):
        answer = client.post("/cra", json=PAPER | {"impact": {"velocity_m_s": speeds[i]}}).json()
        assert angles[i] == pytest.approx(answer["critical_angle_deg"], abs=1e-9)
    assert curves[1] == [[238.0], [angles[speeds.index(238.0)]]]


def test_warnings_of_most_cases_are_merged_into_one_note(page: Page) -> None:
    page.goto("/#/critical-angle")
    expect(page.locator(".verdict .warnings summary")).to_be_visible()
    expect(page.locator(".verdict .standing summary")).to_have_text(re.compile("^Standing notes: .*no measured angle"))
    expect(page.locator(".warnings [data-code='no_measured_angle']")).to_have_count(0)
    expect(page.get_by_role("contentinfo")).to_contain_text("no test of the critical angle is known")


def test_strikes_just_below_and_above_share_a_scale_and_have_captions(page: Page) -> None:
    page.goto("/#/critical-angle")
    captions = page.locator(".side-view .caption")
    expect(captions.first).to_have_text(re.compile(r"^Just below, at 48\.\d\d°: embedded$"))
    expect(captions.last).to_have_text(re.compile(r"^Just above, at 49\.\d\d°: ricochet$"))
    drawings = page.locator(".pair .side-view .metres")
    expect(drawings).to_have_count(2)
    below, above = (each.get_attribute("transform") for each in drawings.all())
    assert below == above
