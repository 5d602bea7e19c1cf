"""Walls: thicknesses by model and by formula, and the speed that perforates a wall."""

import json
import math
import re

import httpx
import pytest
from playwright.sync_api import Page, expect

from service.schemas.strike import PAPER, PAPER_AT_45


def rows(page: Page) -> dict[str, list[str]]:
    """Cells of the table by their first."""
    expect(page.get_by_role("table")).to_be_visible()
    expect(page.locator("[aria-busy=true]")).to_have_count(0)
    lines = page.get_by_role("table").locator("tbody tr")
    cells = [line.locator("td").all_inner_texts() for line in lines.all()]
    return {first.replace("\N{NO-BREAK SPACE}", " "): rest for first, *rest in cells}


def test_thicknesses_are_those_of_the_service(page: Page, client: httpx.Client) -> None:
    page.goto("/#/walls")
    shown = rows(page)
    answer = client.post("/thickness", json=PAPER_AT_45).json()
    plugged = client.post("/thickness", json=PAPER_AT_45 | {"resistance": {"rear_plug": {}}}).json()
    expect(page.get_by_role("region", name="Verdict")).to_contain_text(
        f"this model {1e3 * answer['least_thickness_m']:.0f} mm, with a plug at the rear"
    )
    assert shown["This model"][0] == f"{1e3 * answer['least_thickness_m']:.0f}"
    assert shown["With a plug at the rear"][0] == f"{1e3 * plugged['least_thickness_m']:.0f}"
    assert len(shown) == 3 + 11
    assert "in doubt" in shown["BRL *"][3]
    formulas = {row["formula"]: row for row in client.post("/formulas", json=PAPER_AT_45).json()["formulas"]}
    assert shown["Modified NDRC"][0] == f"{1e3 * formulas['modified_ndrc']['perforation_thickness_m']:.0f}"
    for name, row in (("Modified NDRC", formulas["modified_ndrc"]), ("CEA-EDF *", formulas["cea_edf"])):
        assert (shown[name][3] == "within") is row["in_range"]
    assert "rear face" in page.locator(".warnings summary").inner_text()


@pytest.mark.parametrize("thickness_mm", [100, 438, 500])
def test_thickness_gets_a_yes_or_no_by_the_formulas_and_their_margin(
    page: Page, client: httpx.Client, thickness_mm: int
) -> None:
    page.goto("/#/walls")
    page.get_by_label("Thickness", exact=True).fill(str(thickness_mm))  # one input
    rows(page)
    table = client.post("/formulas", json=PAPER_AT_45).json()
    spread = table["perforation_thickness_spread"]
    design_mm = 1e3 * table["perforation_margin"] * spread["highest"]
    word = "enough" if thickness_mm >= design_mm else "not enough"
    least = f"{math.ceil(design_mm):,} mm (largest formula within its range × 1.2)"
    expect(page.locator(".outcome")).to_have_text(f"{thickness_mm} mm: {word}. Design value at least {least}.")
    expect(page.locator(".figures")).to_contain_text(
        f"{1e3 * spread['lowest']:.0f} to {1e3 * spread['highest']:.0f} mm"
    )


def test_wall_with_a_thickness_has_a_speed_that_perforates_it(page: Page, client: httpx.Client) -> None:
    page.goto("/#/walls?target.thickness_m=0.2&impact.oblique_angle_deg=0")
    rows(page)
    body = PAPER | {"target": PAPER["target"] | {"thickness_m": 0.2}, "impact": {"oblique_angle_deg": 0.0}}
    speed = client.post("/limit-speed", json=body).json()["limit_speed_m_s"]
    found = re.search(
        r"perforates a wall of 200\smm: ([\d.]+)\sm/s", page.get_by_role("region", name="Verdict").inner_text()
    )
    assert found is not None
    assert abs(float(found[1]) - speed) < 1.0


def test_every_number_of_a_range_is_in_the_units_shown(page: Page) -> None:
    page.goto("/#/walls?impact.oblique_angle_deg=0")
    page.get_by_label("Units").select_option("US")
    assert "from 65.62 ft/s to 656.2 ft/s along the normal, here 780.8 ft/s" in rows(page)["CEA-EDF *"][-1]


def test_case_with_a_plug_is_computed_with_it_alone_and_shared_by_its_address(page: Page) -> None:
    page.goto("/#/walls")
    plugged = rows(page)["With a plug at the rear"]
    page.get_by_label("Rear plug, angle of its cone").fill("66.1")
    expect(page.get_by_role("table").locator("tbody tr")).to_have_count(12)
    assert rows(page)["This model"] == plugged
    expect(page).to_have_url(re.compile(r"resistance\.rear_plug\.cone_angle_deg=66\.1"))
    page.reload()
    assert rows(page)["This model"] == plugged


def test_numerics_of_the_address_are_kept(page: Page, client: httpx.Client) -> None:
    numerics = {"retention_energy_fraction": 0.2}
    with page.expect_request("**/thickness") as posted:
        page.goto("/#/walls?numerics.retention_energy_fraction=0.2")
    assert json.loads(posted.value.post_data or "")["numerics"] == numerics
    shown = rows(page)
    answer = client.post("/thickness", json=PAPER_AT_45 | {"numerics": numerics}).json()
    assert shown["This model"][0] == f"{1e3 * answer['least_thickness_m']:.0f}"


def test_field_out_of_its_bounds_says_so(page: Page) -> None:
    page.goto("/#/walls")
    rows(page)
    page.get_by_label("Crater depth over diameter").fill("30")
    expect(page.get_by_text("Crater depth over diameter must be at most 20.")).to_be_visible()
