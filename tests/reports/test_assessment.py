"""The report on a strike: it agrees with the service's answers to the same case, and fits on two A4 sheets."""

import base64
import html
import io
import json
import math
import re
import shutil
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import pytest

from service import cli
from service.assessment import first_queries, require_extra, strike_queries
from service.cli.arguments import RefusedError
from service.cli.reports import make_report
from service.errors import ReportsMissingError
from service.names import FORMULAS
from service.reports.assessment_figures import curves
from service.reports.assessment_numbers import FIELDS, leaves, lookup
from service.schemas import ReportRequest
from service.schemas.strike import HEMISPHERE, PAPER, TRUNCATED_CONE
from service.schemas.verdict import next_shot_advice_in
from solver import Impact, critical_angle, formulas, mass_properties, simulate
from solver.formulas import PERFORATION_MARGIN, SCABBING_MARGIN
from solver.uncertainty.verdict import probability_angles
from tests.quantities_in_texts import HEAD_IN_SI, SI, US, US_SIZES, check_converted

COARSE = {"lower_deg": 42.0, "upper_deg": 58.0, "tolerance_deg": 0.5}
STRIKE: dict[str, Any] = PAPER | {"search": COARSE}
JUDGED: dict[str, Any] = STRIKE | {"impact": PAPER["impact"] | {"oblique_angle_deg": 52.3}}
NEVER: dict[str, Any] = STRIKE | {"search": COARSE | {"lower_deg": 20.0, "upper_deg": 25.0}}
SHOTS = [{"velocity_m_s": 238.0 + 5.0 * each, "depth_m": 0.30 + 0.02 * each, "mass_kg": 12.923} for each in range(6)]
WALL: dict[str, Any] = PAPER | {
    "target": PAPER["target"] | {"thickness_m": 0.3},
    "impact": {"velocity_m_s": 300.0, "oblique_angle_deg": 30.0},
    "resistance": {"strength_factor": {"model": "own_tests", "shots": SHOTS}},
    "search": COARSE | {"lower_deg": 25.0},
}
"""A strike whose report has every part."""
OF_A_CLASS = WALL | {
    "target": WALL["target"] | {"compressive_strength_pa": 38e6, "characteristic_strength_pa": 30e6},
    "resistance": {},
}
"""The wall in concrete of class C30/37."""
IN_US = {"units": "us"}
ALL = [JUDGED, WALL, NEVER]
NAMES = ["half-space", "wall", "no critical angle"]
DATA = re.compile(r'<data value="([^"]+)" data-from="([^"]+)" data-factor="([^"]+)">([^<]+)</data>')
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
Ask = Callable[[dict[str, Any]], Any]


@pytest.fixture(scope="module")
def report_of(client: httpx.Client) -> Ask:
    """Function that returns the report on a strike, which is cached because drawing takes long."""

    @cache
    def report(body: str) -> str:
        response = client.post("/report", content=body, headers={"Content-Type": "application/json"})
        assert response.status_code == 200, response.text
        assert response.headers["Content-Type"] == "text/html; charset=utf-8"
        return response.text

    return lambda body: report(json.dumps(body))


@pytest.fixture(scope="module")
def answers_of(client: httpx.Client) -> Ask:
    """Function that returns the service's answers to the single requests that a report consists of."""

    @cache
    def answers(body: str) -> dict[str, Any]:
        request, found = ReportRequest.model_validate_json(body), {}

        def send(queries: Mapping[str, Any]) -> None:
            for name, (operation, content) in queries.items():
                found[name] = client.post(f"/{operation.replace('_', '/')}", json=content).json()

        send(first_queries(request))
        send(strike_queries(request, found["cra"]))
        properties = mass_properties(request.projectile.to_solver())
        assumed = {
            "projectile": {
                "center_of_gravity_m": properties.center_of_gravity,
                "moment_of_inertia_kg_m2": properties.moment_of_inertia,
            },
            "target": {"youngs_modulus_pa": request.target.to_solver().elastic_modulus},
        }
        return found | {"case": request.canonical(), "assumed": assumed}

    return lambda body: answers(json.dumps(body))


def text_of(page: str) -> str:
    """Return the text of an HTML page, without its style sheet."""
    words = re.sub(r"<style>.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(words))


def words_in_pictures(page: str) -> str:
    """Return the texts of the figures; matplotlib draws them as outlines and writes each into a comment beside them."""
    pictures = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', page)
    return "\n".join(
        text for each in pictures for text in re.findall("<!-- (.*?) -->", base64.b64decode(each).decode())
    )


@pytest.mark.parametrize(
    "body", [*ALL, *(each | IN_US for each in ALL)], ids=[*NAMES, *(f"{each} us" for each in NAMES)]
)
def test_every_number_of_a_report_is_in_the_answers_of_the_service(
    report_of: Ask, answers_of: Ask, body: dict[str, Any]
) -> None:
    page = report_of(body)
    answers = answers_of(body)
    shown = DATA.findall(page)
    assert len(shown) > 60
    for value, pointer, factor, text in shown:
        assert float(value) == lookup(answers, pointer), pointer
        number = float(html.unescape(text).replace("\N{MINUS SIGN}", "-").replace(",", ""))
        places = len(text.partition(".")[2].partition("e")[0])
        exact = float(value) * float(factor)
        if "stress" in pointer and body.get("units"):
            places = -2  # Stresses are in hundreds of psi instead of whole MPa.
        is_limit = "thickness" in pointer and "/case/" not in pointer
        step = 10.0**-places if is_limit else 0.51 * 10.0**-places  # A limit is rounded up.
        assert math.isclose(number, exact, rel_tol=6e-3, abs_tol=step), (pointer, text)
        assert not is_limit or number >= exact - 1e-6, (pointer, text)
    for name in ("cra", "uncertainty", "formulas"):
        assert answers[name]["key"] in page
    assert all(each["key"] in page for name, each in answers.items() if name in {"judged", "below", "above"})


@pytest.mark.parametrize("body", ALL, ids=NAMES)
def test_report_in_us_units_has_the_same_values_and_none_in_si(report_of: Ask, body: dict[str, Any]) -> None:
    in_si, in_us = report_of(body), report_of(body | IN_US)
    assert [each[:2] for each in DATA.findall(in_us)] == [each[:2] for each in DATA.findall(in_si)]
    for shown in (text_of(in_us), words_in_pictures(in_us)):
        assert SI.findall(shown) == HEAD_IN_SI.findall(shown) == []
    assert {"speed [ft/s]", "along the face [ft]", "depth [ft]"} <= set(words_in_pictures(in_us).splitlines())
    assert {"speed [m/s]", "along the face [m]", "depth [m]"} <= set(words_in_pictures(in_si).splitlines())
    assert US.findall(text_of(in_si)) == []
    assert "Quantities are in US customary units." in in_us
    sizes = {
        "/case/projectile/diameter_m": "in",
        "/case/projectile/mass_kg": "lb",
        "/case/target/density_kg_m3": "lb/ft³",
    }
    for value, pointer, factor, text in DATA.findall(in_us):
        if unit := sizes.get(pointer):
            assert float(factor) == pytest.approx(1.0 / US_SIZES[unit])
            assert float(text) * US_SIZES[unit] == pytest.approx(float(value), rel=3e-4)


def test_report_has_the_sentences_of_the_verdict_in_its_units(client: httpx.Client, report_of: Ask) -> None:
    si, us = (client.post("/verdict", json=body).json() for body in (WALL, WALL | IN_US))
    check_converted(si["sentence"], us["sentence"])
    assert us["sentence"].replace(" ", "") in text_of(report_of(WALL | IN_US)).replace(" ", "")


def test_numbers_of_a_report_equal_the_solver(report_of: Ask) -> None:
    page = report_of(JUDGED)
    request = ReportRequest.model_validate(JUDGED)
    arguments, _ = request.arguments()
    found = critical_angle(**arguments)
    assert found.angle is not None
    assert f"Critical angle with the inputs as given {math.degrees(found.angle):.2f} °" in text_of(page)
    values = {pointer: float(value) for value, pointer, _, _ in DATA.findall(page)}
    assert values["/cra/critical_angle_deg"] == pytest.approx(math.degrees(found.angle), abs=1e-9)
    case = {name: arguments[name] for name in ("projectile", "target")}
    impact = request.impact.arguments() | {"oblique_angle": math.radians(52.3)}
    run = simulate(**case, impact=Impact(**impact))
    assert run.outcome.value == "ricochet"
    assert run.exit is not None
    assert values["/judged/exit/speed_m_s"] == pytest.approx(run.exit.speed)
    assert "At θ = 52.3 ° the projectile is turned away" in text_of(page)
    for place, each in enumerate(formulas(**case, impact=Impact(**impact))):
        if each.perforation_thickness is not None:
            assert values[f"/formulas/formulas/{place}/perforation_thickness_m"] == each.perforation_thickness
        assert each.note in text_of(page)


def test_report_states_the_value_of_own_shots(report_of: Ask, answers_of: Ask) -> None:
    untested = JUDGED | {"resistance": {"strength_factor": {"model": "published_tests"}}}
    page, study = text_of(report_of(untested)), answers_of(untested)["uncertainty"]
    assert next_shot_advice_in(study) in page
    assert "with shots of your own into this concrete" in page
    tested = JUDGED | {"strength_scatter": "paper_table_1"}
    assert "more shots into this concrete would hardly narrow it" in text_of(report_of(tested))


def test_range_of_some_samples_is_named_as_in_the_verdict(client: httpx.Client, report_of: Ask) -> None:
    body = JUDGED | {"search": JUDGED["search"] | {"upper_deg": 50.0}}
    found = client.post("/verdict", json=body).json()
    assert found["share_without_angle"] > 0.1
    assert "90 % range of the others" in found["sentence"]
    text = text_of(report_of(body)).replace("\N{NO-BREAK SPACE}", " ")
    assert re.search(r"\(90 % range of the others, as \d+ ?% of the samples have no critical angle\)", text), text
    assert "(90 % range)" not in text


def test_own_shots_are_listed_with_their_effect_on_the_strength_factor(client: httpx.Client, report_of: Ask) -> None:
    shots = [{"velocity_m_s": 238.1, "depth_m": 0.30, "mass_kg": 12.923}, {"velocity_m_s": 275.7, "depth_m": 0.38}]
    body = JUDGED | {"resistance": {"strength_factor": {"model": "own_tests", "shots": shots}}}
    page = report_of(body)
    assert "238.1 m/s, 300 mm, 12.923 kg; 275.7 m/s, 380 mm" in text_of(page)
    assert "S at normal impact rests on 2 shots into this concrete" in text_of(page)
    values = {pointer: float(value) for value, pointer, _, _ in DATA.findall(page)}
    tests = client.post(
        "/cra", json={k: v for k, v in body.items() if k != "impact"} | {"impact": PAPER["impact"]}
    ).json()
    for name in ("median", "dispersion", "prior_median", "prior_dispersion"):
        assert values[f"/cra/own_tests/{name}"] == tests["own_tests"][name]


def test_report_judges_perforation_and_scabbing_of_a_wall(
    client: httpx.Client, report_of: Ask, answers_of: Ask
) -> None:
    page, sentence = text_of(report_of(WALL)), client.post("/wall", json=wall_of(WALL)).json()["sentence"]
    assert sentence.startswith("Wall of 300 mm at 30° from the normal: not enough against scabbing and perforation.")
    assert sentence == answers_of(WALL)["wall"]["sentence"]
    answer, _, design = sentence.partition(". ")
    assert page.index(f"{answer}.") < page.index("At 30° from the normal the projectile") < page.index(design)
    assert "Design value" not in text_of(report_of(JUDGED))


def test_first_sheet_has_a_large_verdict_and_the_design_values(report_of: Ask, answers_of: Ask) -> None:
    page, wall = report_of(WALL), answers_of(WALL)["wall"]
    leads = [text_of(each).strip() for each in re.findall(r'<span class="lead">.*?</span>', page, flags=re.DOTALL)]
    assert leads[0] == "Wall of 300 mm at 30° from the normal: not enough against scabbing and perforation."
    assert leads[1].startswith("At 30° from the normal")
    sizes = {name: float(size) for name, size in re.findall(r"([.\w ]+) \{[^}]*?font-size: ([\d.]+)rem", page)}
    assert sizes[".answer .lead"] > max(size for name, size in sizes.items() if name != ".answer .lead")
    table = page.partition('<table class="design">')[2].partition("</table>")[0]
    assert page.index(table) < page.index('<h2 id="case">')
    shown = {pointer: text for _, pointer, _, text in DATA.findall(table)}
    for name in ("perforation", "scabbing"):
        assert shown[f"/wall/{name}/design_m"] == f"{math.ceil(1e3 * wall[name]['design_m']):d}"
        assert f"/wall/normal_impact/{name}_design_m" in shown
    assert text_of(table).count("not enough") == 2
    assert '<table class="design">' not in report_of(JUDGED)


@pytest.mark.parametrize(
    ("body", "title", "design", "table"),
    [
        (
            WALL,
            "300 m/s, 39 MPa, 30°, 300 mm",
            "for the mean strength of 39 MPa",
            "for the mean strength of 39 MPa",
        ),
        (
            OF_A_CLASS,
            "300 m/s, 38 MPa (characteristic 30 MPa), 30°, 300 mm",
            "for the characteristic strength of 30 MPa",
            "for the mean strength of 38 MPa",
        ),
        (JUDGED, "238 m/s, 39 MPa, 52.3°", None, "for the mean strength of 39 MPa"),
    ],
    ids=["no characteristic strength", "characteristic strength", "half-space"],
)
def test_report_names_the_strength_behind_each_thickness(
    report_of: Ask, answers_of: Ask, body: dict[str, Any], title: str, design: str | None, table: str
) -> None:
    page = report_of(body)
    captions = [text_of(each).strip() for each in re.findall(r"<caption>.*?</caption>", page)]
    assert f"<h1>Ricochet assessment, {title}</h1>" in page
    assert re.search(rf'<h2 id="formulas">Design formulas .*, {table}</h2>', page)
    assert ("The design values of the wall are for the characteristic" in page) is (body == OF_A_CLASS)
    assert [each for each in captions if "Design values" in each] == (
        [f"Design values of the wall [mm], {design}"] if design else []
    )
    if design:
        wall, rest = answers_of(body)["wall"], design.removeprefix("for ")
        assert rest in wall["sentence"]
        governing = {FORMULAS[wall[name]["formula"]] for name in ("scabbing", "perforation")}
        rows = [text_of(each) for each in re.findall(r"<tr.*?</tr>", page, flags=re.DOTALL)]
        marked = [each.strip() for each in rows if re.search("gives (the|both) design value", each)]
        assert len(marked) == len(governing)
        assert all(any(each.startswith(name) for name in governing) for each in marked)
    else:
        assert "<strong>gives" not in page


def wall_of(body: dict[str, Any]) -> dict[str, Any]:
    return {name: part for name, part in body.items() if name != "search"}


def test_report_applies_the_recommended_margins(report_of: Ask) -> None:
    page = report_of(JUDGED)
    rows = {(pointer, factor): text for _, pointer, factor, text in DATA.findall(page)}
    values = {pointer: float(value) for value, pointer, _, _ in DATA.findall(page)}
    place = "/formulas/formulas/0"  # This is the modified NDRC formula.
    for name, margin in (("perforation", PERFORATION_MARGIN), ("scabbing", SCABBING_MARGIN)):
        pointer = f"{place}/{name}_thickness_m"
        assert rows[pointer, f"{1000 * margin:g}"] == f"{1e3 * margin * values[pointer]:.0f}"


def test_report_contains_the_warnings_of_the_verdict(client: httpx.Client, report_of: Ask, answers_of: Ask) -> None:
    page = text_of(report_of(WALL))
    warnings = client.post("/verdict", json=WALL).json()["warnings"]
    assert {"no_measured_angle", "rear_face_unconservative"} <= {each["code"] for each in warnings}
    of_strike, of_search = (
        {each["detail"] for each in answers_of(WALL)[name]["warnings"]} for name in ("judged", "cra")
    )
    assert of_strike - of_search
    assert of_search - of_strike
    for each in warnings:
        source = "Run at the angle to judge" if each["detail"] in of_strike - of_search else "Critical angle"
        said = f"{each['detail'][0].upper()}{each['detail'][1:]}."
        assert said in page.partition("Standing notes:")[2 if each.get("standing") else 0]
        assert (f"{source}: {said}" in page) is not each.get("standing", False)


def test_warning_of_a_run_names_that_run(report_of: Ask) -> None:
    page = text_of(report_of(JUDGED))
    assert "Run just below: At rest " in page
    assert "Run at the angle to judge: At rest " not in page, "that one is turned away"


def test_report_on_a_wall_has_outcomes_by_angle_and_least_thickness(report_of: Ask, answers_of: Ask) -> None:
    page = text_of(report_of(WALL))
    answers = answers_of(WALL)
    assert "By oblique angle: perforated from" in page
    assert f"This model, without margin {math.ceil(1e3 * answers['thickness']['least_thickness_m'])}" in page, (
        "as said above"
    )
    assert "300 mm" in page


def test_report_states_that_there_is_no_critical_angle(report_of: Ask) -> None:
    page = text_of(report_of(NEVER))
    assert "No critical angle: nothing from 20° to 25° is turned away" in page
    assert "Without a critical angle: 100.0 % of them" in page


def test_report_marks_defaults(report_of: Ask) -> None:
    page = text_of(report_of(JUDGED))
    assert "Poisson's ratio 0.5 (default)" in page
    assert "(default: ACI 318-19)" in page
    assert "Density 2250 kg/m³ Young" in page  # The density is given.
    assert "Width of the bracket 0.5 °" in page


@pytest.mark.parametrize("body", [PAPER, HEMISPHERE, TRUNCATED_CONE | {"search": {}}])
def test_every_input_has_a_label(body: dict[str, Any]) -> None:
    case = ReportRequest.model_validate(body).canonical()
    assert {pointer for pointer, _ in leaves(case)} <= FIELDS.keys()


def test_probabilities_include_the_angle_to_judge() -> None:
    for angle in (5.0, 30.0, 52.3, 84.999):
        start, stop, count = probability_angles(angle, 5.0, 85.0)
        step = (stop - start) / (count - 1)
        place = (angle - start) / step
        assert step == pytest.approx(0.5)
        assert place == pytest.approx(round(place), abs=1e-9)
        assert 0 <= round(place) < count
    assert probability_angles(None, 5.0, 85.0) == probability_angles(30.0, 5.0, 85.0) == (5.0, 85.0, 161)
    assert probability_angles(60.0, 40.0, 40.2) == (40.0, 40.2, 2)


def test_no_probability_is_stated_beyond_the_search_range() -> None:
    angles = first_queries(ReportRequest.model_validate(NEVER))["uncertainty"].body["oblique_angles_deg"]
    assert (angles["start"], angles["stop"]) == (20.0, 25.0)


def test_label_of_the_angle_is_no_longer_than_its_axis() -> None:
    speeds = [(speed, {"critical_angle_deg": 48.0}) for speed in (150.0, 250.0, 350.0)]
    figure = curves(speeds, None, speed=238.0, angle=48.6, judged=45.0)
    figure.savefig(io.BytesIO())  # This lays out the figure.
    (axes,) = figure.subfigs[0].axes
    label, title = (each.get_window_extent() for each in (axes.yaxis.label, axes.title))
    assert label.y0 >= figure.bbox.y0
    assert label.y1 <= title.y1


def test_report_loads_no_file_and_runs_no_script(client: httpx.Client) -> None:
    response = client.post("/report", json=JUDGED)
    assert not re.search(r"<script|<link|src=\"(?!data:)|url\(|@import|style=", response.text)
    assert "default-src 'none'" in response.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"search": {"method": "secant"}}, "/search/method"),
        ({"numerics": {"method": "panels"}}, "/numerics/method"),
        ({"impact": {"velocity_m_s": 238.0, "oblique_angle_deg": 90.0}}, "/impact/oblique_angle_deg"),
        ({"impact": {"velocity_m_s": -1.0}}, "/impact/velocity_m_s"),
        ({"target": PAPER["target"] | {"colour": "grey"}}, "/target/colour"),
        ({"units": "imperial"}, "/units"),
    ],
)
def test_invalid_field_of_a_report_request_is_named(client: httpx.Client, change: dict[str, Any], pointer: str) -> None:
    response = client.post("/report", json=PAPER | change)
    assert response.status_code == 422, response.text
    assert [error["pointer"] for error in response.json()["errors"]] == [pointer]


def test_report_without_the_extra_is_answered_as_not_implemented(monkeypatch: pytest.MonkeyPatch) -> None:
    require_extra()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ReportsMissingError, match=r"install the extra reports from the wheel"):
        require_extra()
    assert ReportsMissingError.status == 501


@pytest.mark.parametrize("units", ["si", "us"])
def test_command_writes_the_report_of_the_service(report_of: Ask, live_url: str, tmp_path: Path, units: str) -> None:
    (tmp_path / "strike.json").write_text(json.dumps(JUDGED))
    target = tmp_path / "report.html"
    command = ["report", str(tmp_path / "strike.json"), "--units", units, "-o", str(target), "--url", live_url]
    assert cli.main(command) == 0
    made = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC")
    expected = report_of(JUDGED if units == "si" else JUDGED | IN_US)
    assert made.sub("", target.read_text()) == made.sub("", expected)


def test_unknown_system_of_units_is_refused_with_the_choices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tmp_path / "strike.json"
    case.write_text(json.dumps(JUDGED))
    assert cli.main(["report", str(case), "--units", "imperial"]) == 2
    told = capsys.readouterr().err
    assert "--units" in told
    assert "unknown value 'imperial'; expected si, us" in told
    case.write_text(json.dumps(JUDGED | {"units": "imperial"}))
    assert cli.main(["report", str(case)]) == 2
    assert "/units: must be 'si' or 'us', got 'imperial'" in capsys.readouterr().err


@pytest.mark.parametrize("body", [*ALL, WALL | IN_US, OF_A_CLASS], ids=[*NAMES, "wall us", "class"])
@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no browser here")
def test_printed_report_takes_at_most_two_sheets_of_a4(live_url: str, tmp_path: Path, body: dict[str, Any]) -> None:
    (tmp_path / "strike.json").write_text(json.dumps(body))
    target = tmp_path / "report.pdf"
    assert cli.main(["report", str(tmp_path / "strike.json"), "-o", str(target), "--url", live_url]) == 0
    content = target.read_bytes()
    sizes = re.findall(rb"/MediaBox\s*\[\s*0\s+0\s+([\d.]+)\s+([\d.]+)\s*\]", content)
    assert 1 <= len(sizes) <= 2
    assert {(round(float(width)), round(float(height))) for width, height in sizes} == {(595, 842)}
    assert [each.name for each in tmp_path.iterdir() if each.is_dir()] == []


def test_command_without_a_browser_suggests_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "strike.json").write_text(json.dumps(PAPER))
    monkeypatch.setenv("PATH", str(tmp_path))
    assert cli.main(["report", str(tmp_path / "strike.json"), "-o", str(tmp_path / "report.pdf")]) == 1
    assert "open it in any browser and print it" in capsys.readouterr().err


def test_other_kinds_of_files_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", "--output", str(tmp_path / "report.doc")]) == 2
    assert "must end in .html or .pdf" in capsys.readouterr().err


def test_report_from_python_equals_the_report_of_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = make_report(JUDGED)
    (tmp_path / "case.json").write_text(json.dumps(JUDGED))
    assert cli.main(["report", str(tmp_path / "case.json"), "-o", str(tmp_path / "report.html")]) == 0, (
        capsys.readouterr()
    )
    written = (tmp_path / "report.html").read_text()
    made = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC")
    assert made.sub("", page) == made.sub("", written)
    with pytest.raises(RefusedError) as refused:
        make_report(JUDGED | {"impact": JUDGED["impact"] | {"oblique_angle_deg": 91.0}})
    assert refused.value.problem["errors"][0]["pointer"] == "/impact/oblique_angle_deg"
