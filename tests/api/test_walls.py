"""`/thickness` and `/limit-speed`: results of the solver and of the formulas, single and in batches."""

import csv
import io
import math
from dataclasses import replace
from typing import Any

import httpx
import pytest

from service.schemas import LimitSpeedAnswer, ThicknessAnswer, WallAnswer
from service.schemas.strike import PAPER
from solver import Numerics, cea_edf_limit_speed, least_thickness, limit_velocity
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
from solver.uncertainty import judge_wall

from .calibrations import answered
from .many import ASYNC, LINES, check_results, file_at, finished, items_of, lines

STRIKE = PAPER | {"impact": PAPER["impact"] | {"oblique_angle_deg": 30.0}}
WALL = PAPER | {"target": PAPER["target"] | {"thickness_m": 0.2}, "impact": {"oblique_angle_deg": 0.0}}
HEAD_ON = PAPER["impact"] | {"oblique_angle_deg": 0.0}
COARSE = {"relative_tolerance": 1e-3}
ANGLES = {"field": "impact.oblique_angle_deg", "values": [0.0, 20.0, 40.0]}
BASES = {"thickness": STRIKE | {"numerics": COARSE}, "limit-speed": WALL | {"numerics": COARSE}}
FOUND = {"thickness": ("least_thickness_m", "bracket_m"), "limit-speed": ("limit_speed_m_s", "bracket_m_s")}


def test_thickness_equals_the_solver_and_comes_with_the_formulas(client: httpx.Client) -> None:
    answer = answered(client, "/thickness", STRIKE)
    ThicknessAnswer.model_validate(answer)
    impact = paper_impact(oblique_angle_degrees=30.0)
    found = least_thickness(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact)
    assert answer["status"] == "converged"
    assert answer["least_thickness_m"] == pytest.approx(found.value, rel=1e-6)
    assert answer["bracket_m"][1] == answer["least_thickness_m"]
    assert len(answer["iterations"]) == len(found.iterations)
    thicknesses = {row["formula"]: row["perforation_thickness_m"] for row in answer["formulas"]}
    assert thicknesses["modified_ndrc"] > answer["least_thickness_m"]
    assert answer["sentence"].startswith("Not perforated from ")
    assert answer["range"]["lower"] < answer["least_thickness_m"] < answer["range"]["upper"]
    assert answer["variants"]["plain"] == answer["least_thickness_m"] < answer["variants"]["rear_plug_and_crater"]
    details = {warning["code"]: warning["detail"] for warning in answer["warnings"]}
    within = [1e3 * row["perforation_thickness_m"] for row in answer["formulas"] if row["in_range"]]
    assert f"{math.ceil(min(within))} to {math.ceil(max(within))} mm" in details["rear_face_unconservative"]
    assert "238 m/s at 30° from the normal" in details["rear_face_unconservative"]


def test_limit_speed_equals_the_solver(client: httpx.Client) -> None:
    answer = client.post("/limit-speed", json=WALL).json()
    LimitSpeedAnswer.model_validate(answer)
    wall = replace(PAPER_TARGET, thickness=0.2)
    found = limit_velocity(projectile=PAPER_PROJECTILE, target=wall, oblique_angle=math.radians(0.0))
    assert answer["limit_speed_m_s"] == pytest.approx(found.value, rel=1e-6)
    by_formula = cea_edf_limit_speed(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, thickness=0.2)
    rows = {row["formula"]: row for row in answer["formulas"]}
    assert {"modified_ndrc", "degen", "cea_edf", "hughes"} <= rows.keys()
    assert rows["cea_edf"]["limit_speed_m_s"] == by_formula.limit_speed
    assert [each["pointer"] for each in rows["cea_edf"]["out_of_range"]] == ["/projectile/nose"]
    lowest = min(row["limit_speed_m_s"] for row in rows.values() if row["in_range"])
    assert answer["sentence"].startswith(f"Perforated from {math.floor(lowest)} m/s on by ")
    assert "This model, which is unconservative: " in answer["sentence"]
    assert answer["range"]["lower"] < answer["limit_speed_m_s"] < answer["range"]["upper"]
    assert answer["range"]["probability"] == 0.9
    assert answer["variants"]["plain"] == answer["limit_speed_m_s"] > answer["variants"]["rear_plug_and_crater"]
    perforated = [trial for trial in answer["iterations"] if trial["outcome"] == "perforated"]
    assert perforated
    assert all(trial["exit"]["speed_m_s"] < trial["velocity_m_s"] for trial in perforated)


@pytest.mark.parametrize("operation", ["thickness", "limit-speed"])
def test_lines_of_a_batch_are_answered_despite_an_invalid_one(client: httpx.Client, operation: str) -> None:
    base = BASES[operation]
    short = base | {"projectile": base["projectile"] | {"length_m": 0.1}, "custom_id": "short"}
    cases = [base | {"impact": base["impact"] | {"oblique_angle_deg": angle}} for angle in (0.0, 15.0)]
    items = items_of(client.post(f"/{operation}/batch", content=lines([cases[0], short, cases[1]]), headers=LINES))
    check_results(operation, items)
    assert items[1]["custom_id"] == "short"
    assert items[1]["problem"]["errors"][0]["pointer"] == "/projectile/length_m"
    for item, case in ((items[0], cases[0]), (items[2], cases[1])):
        alone = client.post(f"/{operation}", json=case | {"output": {"range": False}})
        assert alone.headers["Cache-Status"] == "ricochet; hit"
        assert alone.json() == item["result"]


@pytest.mark.parametrize("operation", BASES)
def test_sweep_over_the_angle_has_tables_and_is_cached(client: httpx.Client, operation: str) -> None:
    sweep, (value, bracket) = {"base": BASES[operation], "axes": [ANGLES]}, FOUND[operation]
    job = finished(client, client.post(f"/{operation}/sweep", json=sweep, headers=ASYNC).json())
    assert (job["operation"], job["status"], job["counts"]["failed"]) == (operation, "successful", 0)
    answers = [item["result"] for item in client.get(job["links"]["results"]).json()["results"]]
    table = client.get(job["links"]["results"], headers={"Accept": "text/csv"}).text
    now = client.post(f"/{operation}/sweep", json=sweep, headers={"Accept": "text/csv"})
    assert (now.text, now.headers["Cache-Status"]) == (table, "ricochet; hit")
    rows = list(csv.DictReader(io.StringIO(table)))
    assert [float(row["impact.oblique_angle_deg"]) for row in rows] == ANGLES["values"]
    for row, answer in zip(rows, answers, strict=True):
        assert (row["status"], row["key"]) == ("converged", answer["key"])
        assert float(row[value]) == answer[value]
        assert [float(row[bracket.replace("_", f"_{end}_", 1)]) for end in ("low", "high")] == answer[bracket]
        assert int(row["trials"]) == len(answer["iterations"])
        assert set(row["warnings"].split()) == {warning["code"] for warning in answer["warnings"]}
    again = finished(client, client.post(f"/{operation}/sweep", json=sweep, headers=ASYNC).json())
    assert again["counts"]["cached"] == again["counts"]["total"] == len(rows)
    with file_at(client, job["links"]["results"]) as file:
        assert file["summary"][value][()].tolist() == [answer[value] for answer in answers]
        tried = [trial for answer in answers for trial in answer["iterations"]]
        for name in tried[0].keys() - {"outcome", "exit"}:
            assert file["iterations"][name][()].tolist() == [trial[name] for trial in tried]


def test_thickness_falls_and_limit_speed_rises_with_the_angle(client: httpx.Client) -> None:
    found = {}
    for operation, (value, _) in FOUND.items():
        items = items_of(client.post(f"/{operation}/sweep", json={"base": BASES[operation], "axes": [ANGLES]}))
        found[operation] = [item["result"][value] for item in items]
    assert found["thickness"] == sorted(found["thickness"], reverse=True)
    assert found["limit-speed"] == sorted(found["limit-speed"])


def test_expensive_batch_becomes_a_job_with_fewer_cases(client: httpx.Client) -> None:
    """A least thickness counts as 20 cases, and only up to 100 cases are answered directly."""
    strengths = {"field": "target.compressive_strength_pa", "start": 30e6, "stop": 50e6}
    base = BASES["thickness"] | {"impact": STRIKE["impact"] | {"oblique_angle_deg": 0.0}}
    few, more = (
        client.post("/thickness/sweep", json={"base": base, "axes": [strengths | {"count": count}]}) for count in (5, 6)
    )
    assert (few.status_code, more.status_code) == (200, 202)
    assert finished(client, more.json())["counts"]["done"] == 6


def test_plug_and_crater_require_a_thicker_wall(client: httpx.Client) -> None:
    resistances: list[dict[str, Any]] = [{}, {"rear_plug": {}}, {"rear_plug": {}, "crater": {}}]
    found = [client.post("/thickness", json=STRIKE | {"resistance": each}).json() for each in resistances]
    thicknesses = [each["least_thickness_m"] for each in found]
    assert thicknesses == sorted(thicknesses)
    assert thicknesses[1] > 1.1 * thicknesses[0]
    assert "rear_plug_quasi_static" in {warning["code"] for warning in found[1]["warnings"]}
    assert len({each["key"] for each in found}) == 3


def test_default_angle_of_the_plug_is_66_1_degrees(client: httpx.Client) -> None:
    keys = {
        client.post("/limit-speed", json=WALL | {"resistance": {"rear_plug": plug}}).json()["key"]
        for plug in ({}, {"cone_angle_deg": 66.1})
    }
    assert len(keys) == 1


def test_plug_and_crater_can_be_swept_and_uncertain(client: httpx.Client) -> None:
    cone = {"field": "resistance.rear_plug.cone_angle_deg", "values": [50.0, 66.1]}
    wall = STRIKE | {"target": WALL["target"], "resistance": {"rear_plug": {}}}
    swept = client.post("/trajectory/sweep", json={"base": wall, "axes": [cone]}).json()["results"]
    speeds = [each["result"]["exit"]["speed_m_s"] for each in swept]
    assert speeds[0] > speeds[1]  # A cone of 50° gives a thicker plug, so less of the wall resists.
    depth = {
        "field": "resistance.crater.depth_diameters",
        "distribution": {"type": "uniform", "lower": 0.5, "upper": 1.5},
    }
    study = STRIKE | {"resistance": {"crater": {}}, "uncertain": [depth], "sampling": {"half_width": 0.2}}
    answered(client, "/trajectory/uncertainty", study)


def test_alternatives_keep_the_plug(client: httpx.Client) -> None:
    wall = STRIKE | {"target": STRIKE["target"] | {"thickness_m": 0.2}, "alternatives": True}
    wall["impact"] = STRIKE["impact"] | {"oblique_angle_deg": 44.0}
    outcomes = []
    resistances: list[dict[str, Any]] = [{}, {"rear_plug": {}}]
    for resistance in resistances:
        answer = client.post("/trajectory", json=wall | {"resistance": resistance}).json()
        codes = {warning["code"] for warning in answer["warnings"]}
        assert ("rear_plug_quasi_static" in codes) == bool(resistance)
        outcomes.append(
            {(each["free_surface"], each["strength_factor"]): each["outcome"] for each in answer["alternatives"]}
        )
    assert len(outcomes[0]) == len(outcomes[1]) == 9
    other = ("elastic_plastic", "obliquity_polynomial")
    assert [outcomes[0][other], outcomes[1][other]] == ["embedded", "perforated"]


def test_protrusion_is_reported_and_a_perforation_has_no_depth(client: httpx.Client) -> None:
    def strike(thickness: float) -> dict[str, Any]:
        return WALL | {"target": PAPER["target"] | {"thickness_m": thickness}, "impact": HEAD_ON}

    through, out, held = (answered(client, "/trajectory", strike(thickness)) for thickness in (0.2, 0.25, 0.4))
    assert through["outcome"] == "perforated"
    assert not {"maximum_depth_m", "protrusion"} & through.keys()
    protrusion = out["protrusion"]
    assert protrusion["greatest_m"] == pytest.approx(out["maximum_depth_m"] - 0.25)
    assert protrusion["final_m"] == protrusion["greatest_m"]
    assert "protrusion" not in held
    cases = [strike(thickness) | {"output": {"history": False}} for thickness in (0.2, 0.25, 0.4)]
    answer = client.post("/trajectory/batch", content=lines(cases), headers=LINES | {"Accept": "text/csv"})
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [row["maximum_depth_m"] for row in rows] == ["", str(out["maximum_depth_m"]), str(held["maximum_depth_m"])]
    assert [row["protrusion_greatest_m"] for row in rows] == ["", str(protrusion["greatest_m"]), ""]


@pytest.mark.parametrize(("operation", "unit"), [("thickness", "m"), ("limit-speed", "m_s")])
def test_value_without_protrusion_equals_the_solver_and_has_a_column(
    client: httpx.Client, operation: str, unit: str
) -> None:
    body = {"thickness": STRIKE, "limit-speed": WALL}[operation]
    answer = answered(client, f"/{operation}", body)
    strike: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
    if operation == "thickness":
        found = least_thickness(**strike, impact=paper_impact(oblique_angle_degrees=30.0))
    else:
        found = limit_velocity(**strike | {"target": replace(PAPER_TARGET, thickness=0.2)}, oblique_angle=0.0)
    assert answer["without_protrusion"] == pytest.approx(found.without_protrusion, rel=1e-9)
    stands_out = [each for each in answer["iterations"] if each["outcome"] == "embedded" and "protrusion" in each]
    assert all(each["protrusion"]["greatest_m"] > 0.0 for each in stands_out)
    assert stands_out
    table = client.post(f"/{operation}/batch", content=lines([body]), headers=LINES | {"Accept": "text/csv"}).text
    (row,) = csv.DictReader(io.StringIO(table))
    assert float(row[f"without_protrusion_{unit}"]) == answer["without_protrusion"]


@pytest.mark.parametrize("operation", ["thickness", "limit-speed"])
def test_batch_has_ranges_only_on_request(client: httpx.Client, operation: str) -> None:
    base = BASES[operation]
    cases = [base, base | {"output": {"range": True}}]
    plain, ranged = (item["result"] for item in items_of(client.post(f"/{operation}/batch", json={"cases": cases})))
    added = {"range", "variants", "sentence"}
    assert not added & plain.keys()
    assert added <= ranged.keys()
    alone = answered(client, f"/{operation}", base)
    assert {name: alone[name] for name in added} == {name: ranged[name] for name in added}
    swept = client.post(f"/{operation}/sweep", json={"base": base, "axes": [ANGLES]}).json()["results"]
    assert not added & swept[0]["result"].keys()


def test_wall_by_panels_has_the_answer_of_the_adaptive_method_with_the_same_settings(client: httpx.Client) -> None:
    """No run has panels, so the limit on the size of such a run does not apply."""
    wall = PAPER | {
        "target": PAPER["target"] | {"thickness_m": 0.35},
        "impact": PAPER["impact"] | {"oblique_angle_deg": 50.0},
    }
    given = {"retention_energy_fraction": 0.3}
    by_panels, adaptive, usual = (
        answered(client, "/wall", wall | {"numerics": numerics})
        for numerics in ({"method": "panels", "panels": 100_000, "time_step_s": 1e-7} | given, given, {})
    )
    assert {name: value for name, value in by_panels.items() if name != "key"} == {
        name: value for name, value in adaptive.items() if name != "key"
    }
    assert by_panels["variants"] != usual["variants"]
    found = judge_wall(
        projectile=PAPER_PROJECTILE,
        target=replace(PAPER_TARGET, thickness=0.35),
        impact=paper_impact(oblique_angle_degrees=50.0),
        numerics=Numerics(method="panels", retention_energy_fraction=0.3),
    )
    assert by_panels["sentence"] == str(found)


def test_slow_wall_by_panels_has_the_usual_termination_time(client: httpx.Client) -> None:
    """With panels a run ends after 50 ms by default, when a slow strike would still be in motion."""
    slow = PAPER | {
        "target": PAPER["target"] | {"thickness_m": 0.35},
        "impact": {"velocity_m_s": 5.0, "oblique_angle_deg": 0.0},
    }
    by_panels, usual = (answered(client, "/wall", slow | {"numerics": each}) for each in ({"method": "panels"}, {}))
    assert by_panels["key"] == usual["key"]


def test_wall_is_judged_for_perforation_and_scabbing_as_in_the_verdict(client: httpx.Client) -> None:
    body = STRIKE | {"target": PAPER["target"] | {"thickness_m": 0.45}}
    judged = answered(client, "/wall", body)
    WallAnswer.model_validate(judged)
    found = judge_wall(
        projectile=PAPER_PROJECTILE,
        target=replace(PAPER_TARGET, thickness=0.45),
        impact=paper_impact(oblique_angle_degrees=30.0),
    )
    assert judged["sentence"] == str(found)
    assert judged["perforation"]["design_m"] == pytest.approx(found.perforation.design)
    assert judged["scabbing"]["enough"] is judged["enough"] is False
    verdict = answered(client, "/verdict", body | {"search": {"lower_deg": 40.0, "tolerance_deg": 0.1}})
    assert verdict["wall"] == {name: judged[name] for name in ("enough", "perforation", "scabbing", "normal_impact")}
    # In the verdict, the sentences on the strike stand between the first sentence on the wall and the others.
    first, _, others = judged["sentence"].partition(". ")
    assert verdict["sentence"].startswith(f"{first}. ")
    assert verdict["sentence"].endswith(f" {others}")
    assert verdict["keys"]["wall"] == judged["key"]
    free = answered(client, "/wall", STRIKE)
    assert "enough" not in free
    assert free["scabbing"]["design_m"] == judged["scabbing"]["design_m"]
