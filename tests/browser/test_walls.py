"""The view "Walls": thicknesses by model and by formula, and the speed that perforates a wall."""

import json
import math
import re
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from service.schemas.strike import PAPER, PAPER_AT_45

from .conftest import NewPage, unfold


def rows(page: Page) -> dict[str, list[str]]:
    """Return the rows of the table, by the text of their first cell."""
    expect(page.get_by_role("table")).to_be_visible()
    expect(page.locator("[aria-busy=true]")).to_have_count(0)
    lines = page.get_by_role("table").locator("tbody tr")
    cells = [[" ".join(text.split()) for text in line.locator("td").all_inner_texts()] for line in lines.all()]
    return {first: rest for first, *rest in cells}


def test_thicknesses_equal_the_answers_of_the_service(page: Page, client: httpx.Client) -> None:
    page.goto("/#/walls")
    shown = rows(page)
    answer = client.post("/thickness", json=PAPER_AT_45).json()
    plugged = client.post("/thickness", json=PAPER_AT_45 | {"resistance": {"rear_plug": {}}}).json()
    assert answer["sentence"] in text_of(page, "Thicknesses")
    assert client.post("/wall", json=PAPER_AT_45).json()["sentence"] in text_of(page)
    assert shown["This model"][0] == upwards(answer["least_thickness_m"])
    assert shown["With a plug at the rear"][0] == upwards(plugged["least_thickness_m"])
    assert len(shown) == 3 + 11
    expect(page.locator("caption")).to_have_text(re.compile(r"with the mean strength of 39\sMPa, without margins$"))
    assert shown["Hughes *"][3] == "within; gives both design values"
    assert "in doubt" in shown["BRL *"][3]
    formulas = {row["formula"]: row for row in client.post("/formulas", json=PAPER_AT_45).json()["formulas"]}
    assert shown["Modified NDRC"][0] == upwards(formulas["modified_ndrc"]["perforation_thickness_m"])
    for name, row in (("Modified NDRC", formulas["modified_ndrc"]), ("CEA-EDF *", formulas["cea_edf"])):
        assert (shown[name][3] == "within") is row["in_range"]
    assert "rear face" in page.locator(".warnings summary").inner_text()


@pytest.mark.parametrize("thickness_mm", [100, 450, 600])
def test_verdict_on_a_thickness_is_the_sentence_of_the_service(
    page: Page, client: httpx.Client, thickness_mm: int
) -> None:
    page.goto("/#/walls")
    page.get_by_label("Thickness", exact=True).fill(str(thickness_mm))  # This is the only input.
    body = PAPER_AT_45 | {"target": PAPER["target"] | {"thickness_m": thickness_mm / 1e3}}
    judged = client.post("/wall", json=body).json()
    outcome = page.locator(".outcome")
    expect(outcome).to_contain_text(judged["sentence"])
    expect(outcome.locator("strong")).to_contain_text(": enough" if judged["enough"] else ": not enough against")
    for name in ("perforation", "scabbing"):
        value = upwards(judged[name]["design_m"])
        expect(outcome).to_contain_text(f"{name} {value} mm")
        assert page.get_by_text(f"{value} mm").count() == 1, "each fact once"


@pytest.mark.parametrize("characteristic", ["", "&target.characteristic_strength_pa=30e6"])
def test_note_of_the_table_agrees_with_the_strength_of_the_verdict(page: Page, characteristic: str) -> None:
    page.goto(f"/#/walls?target.thickness_m=0.3{characteristic}")
    rows(page)
    expect(page.locator("caption")).to_contain_text(
        "with the mean strength of 39\N{NO-BREAK SPACE}MPa, without margins"
    )
    note = "The design values of the wall are for the characteristic strength of 30 MPa."
    assert ("with the characteristic strength of 30 MPa" in text_of(page)) is bool(characteristic)
    assert (note in text_of(page, "Thicknesses")) is bool(characteristic)


def text_of(page: Page, region: str = "Verdict") -> str:
    """Return the text of a section with every line break and no-break space replaced by a blank."""
    return " ".join(page.get_by_role("region", name=region).inner_text().split())


def upwards(length_m: float) -> str:
    """Return a length in whole millimetres, rounded up, as the sentences of the service state it."""
    return f"{math.ceil(1e3 * length_m - 1e-9)}"


def test_limit_speed_of_a_given_thickness_is_shown(page: Page, client: httpx.Client) -> None:
    page.goto("/#/walls?target.thickness_m=0.2&impact.oblique_angle_deg=0")
    rows(page)
    body = PAPER | {"target": PAPER["target"] | {"thickness_m": 0.2}, "impact": {"oblique_angle_deg": 0.0}}
    assert client.post("/limit-speed", json=body).json()["sentence"] in text_of(page, "Thicknesses")


def test_every_number_of_a_range_uses_the_units_shown(page: Page) -> None:
    page.goto("/#/walls?impact.oblique_angle_deg=0")
    page.get_by_label("Units").select_option("US")
    assert "from 65.62 ft/s to 656.2 ft/s along the normal, here 780.8 ft/s" in rows(page)["CEA-EDF *"][-1]


@pytest.mark.parametrize("width", [1440, 1024, 960, 768])
def test_formula_names_stay_on_one_line_within_the_panel(new_page: NewPage, width: int) -> None:
    page = new_page(width=width)
    page.goto("/#/walls?impact.velocity_m_s=900")  # At this speed several formulas are outside their range.
    rows(page)
    names = page.locator(".thicknesses tbody td:first-child").filter(has_not_text="With a plug")
    lines = names.evaluate_all(
        """all => all.map((each) => {
            const text = document.createRange();
            text.selectNodeContents(each);
            return [each.textContent, new Set([...text.getClientRects()].map(({ top }) => top)).size];
        })"""
    )
    assert [name for name, count in lines if count > 1] == []
    assert page.locator(".wide").evaluate("each => each.scrollWidth <= each.clientWidth")


def test_plug_has_a_row_of_its_own_and_is_stored_in_the_url(page: Page) -> None:
    page.goto("/#/walls")
    before = rows(page)
    unfold(page)
    page.get_by_label("Rear plug, angle of its cone").fill("60")
    expect(page.get_by_role("region", name="Thicknesses")).to_contain_text("without a plug and a crater")
    changed = rows(page)
    assert changed["This model"] == before["This model"]
    assert changed["With a plug at the rear"] != before["With a plug at the rear"]
    expect(page).to_have_url(re.compile(r"resistance\.rear_plug\.cone_angle_deg=60"))
    page.reload()
    assert rows(page) == changed


def test_report_and_link_of_a_wall_are_offered_beside_its_verdict(page: Page) -> None:
    page.goto("/#/walls?target.thickness_m=0.5&search.lower_deg=44&search.upper_deg=54&search.tolerance_deg=0.5")
    with page.expect_popup() as opened:
        page.get_by_role("button", name="Report", exact=True).click()
    report = opened.value
    expect(report.get_by_role("heading", name="Answer")).to_be_visible()
    expect(report.locator("body")).to_contain_text(re.compile(r"Wall of 500\smm"))
    page.get_by_role("button", name="Copy link").click()
    expect(page.get_by_label("Link to this case")).to_have_value(page.url)
    page.get_by_label("Thickness", exact=True).fill("-1")
    expect(page.get_by_role("button", name="Report", exact=True)).to_be_disabled()


def test_numerics_in_the_url_are_kept(page: Page, client: httpx.Client) -> None:
    numerics = {"retention_energy_fraction": 0.2}
    with page.expect_request("**/thickness") as posted:
        page.goto("/#/walls?numerics.retention_energy_fraction=0.2")
    assert json.loads(posted.value.post_data or "")["numerics"] == numerics
    shown = rows(page)
    answer = client.post("/thickness", json=PAPER_AT_45 | {"numerics": numerics}).json()
    assert shown["This model"][0] == upwards(answer["least_thickness_m"])


def test_field_out_of_bounds_is_named_in_place_of_results(page: Page) -> None:
    page.goto("/#/walls")
    rows(page)
    unfold(page)
    page.get_by_label("Crater depth over diameter").fill("30")
    expect(page.get_by_text("Crater depth over diameter must be at most 20.")).to_be_visible()
    for region in ("Verdict", "Thicknesses"):
        expect(page.get_by_role("region", name=region)).to_contain_text("No result: a field is not accepted.")
    expect(page.get_by_role("region", name="Thicknesses").get_by_text("No result")).to_have_count(1)


def test_tutorial_quotes_the_words_of_the_page(page: Page) -> None:
    text = (Path(__file__).parents[2] / "docs" / "tutorial" / "page.md").read_text(encoding="utf-8")
    quote = " ".join(line.removeprefix("> ") for line in text.splitlines() if line.startswith("> "))
    page.goto("/")
    page.get_by_role("link", name="155 mm body").click()
    page.get_by_role("link", name="Walls", exact=True).click()
    page.get_by_label("Concrete class").select_option(label="C30/37")
    thickness, verdict = page.get_by_label("Thickness", exact=True), page.locator(".verdict .outcome")
    thickness.fill("500")
    expect(verdict).to_contain_text("Wall of 500 mm at 45° from the normal: not enough")
    thickness.fill("1000")
    expect(verdict).to_contain_text(quote)
