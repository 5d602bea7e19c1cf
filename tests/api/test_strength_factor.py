"""Models of the strength factor over HTTP, and the strength factor in answers."""

from typing import Any

import httpx
import pytest

from service.schemas.resistance import PUBLISHED, STRENGTH_AND_DIAMETER
from service.schemas.strike import PAPER, PAPER_AT_45

from .calibrations import answered
from .many import file_at, rows_at
from .refused import changed

CONSTANT = {"model": "constant", "value": 82.6 * 39.0**-0.544}


def with_model(body: dict[str, Any], model: dict[str, Any]) -> dict[str, Any]:
    return body | {"resistance": {"strength_factor": model}}


def test_strength_power_law_equals_the_constant_it_gives(client: httpx.Client) -> None:
    law = {"model": "strength_power_law", "coefficient": 82.6, "exponent": -0.544}
    by_law, by_value = (answered(client, "/trajectory", with_model(PAPER_AT_45, model)) for model in (law, CONSTANT))
    assert by_law["strength_factor"] == pytest.approx(CONSTANT["value"], rel=1e-12)
    assert by_law["final"] == pytest.approx(by_value["final"], rel=1e-9)


def test_published_tests_law_equals_the_explicit_power_law(client: httpx.Client) -> None:
    answers = [answered(client, "/cra", with_model(PAPER, model)) for model in (PUBLISHED, STRENGTH_AND_DIAMETER)]
    ready_made, written_out = answers
    assert ready_made["critical_angle_deg"] == pytest.approx(written_out["critical_angle_deg"], abs=1e-9)
    assert ready_made["strength_factor"] == pytest.approx(written_out["strength_factor"], rel=1e-12)
    constant = answered(client, "/cra", with_model(PAPER, PUBLISHED | {"obliquity_shape": "constant"}))
    assert constant["strength_factor"] == pytest.approx(8.84 * (80.0 / 76.2) ** -0.24, rel=1e-12)
    assert constant["critical_angle_deg"] < ready_made["critical_angle_deg"]


@pytest.mark.parametrize(("decay", "ratio"), [("elastic_plastic", 0.6398), ("mohr_coulomb", 0.4734), ("none", 0.8899)])
def test_finite_element_shape_depends_on_the_decay_law(client: httpx.Client, decay: str, ratio: float) -> None:
    """The ratio of S at 45° to S at 0° is the one that was fitted with the decay law."""
    law = PUBLISHED | {"obliquity_shape": "finite_elements"}
    body = PAPER_AT_45 | {"resistance": {"strength_factor": law, "free_surface": {"model": decay}}}
    head_on = body | {"impact": PAPER_AT_45["impact"] | {"oblique_angle_deg": 0.0}}
    oblique, normal = (answered(client, "/trajectory", each)["strength_factor"] for each in (body, head_on))
    assert oblique / normal == pytest.approx(ratio, abs=1e-3)


def test_strength_factor_in_the_answer_belongs_to_the_angle(client: httpx.Client) -> None:
    run = answered(client, "/trajectory", PAPER_AT_45)
    assert run["strength_factor"] == pytest.approx(8.469 + 0.0149 * 45.0 - 0.0013 * 45.0**2, rel=1e-12)
    found = answered(client, "/cra", PAPER | {"output": {"history": True}})
    angle = found["critical_angle_deg"]
    assert found["strength_factor"] == pytest.approx(8.469 + 0.0149 * angle - 0.0013 * angle**2, rel=1e-12)
    assert found["trajectory"]["strength_factor"] == pytest.approx(found["strength_factor"], rel=1e-12)
    none = answered(client, "/cra", PAPER | {"search": {"lower_deg": 10.0, "upper_deg": 20.0}})
    assert "strength_factor" not in none


@pytest.mark.parametrize(("path", "body"), [("/trajectory", PAPER_AT_45), ("/cra", PAPER)])
def test_tables_have_the_strength_factor(client: httpx.Client, path: str, body: dict[str, Any]) -> None:
    answer = answered(client, path, body)
    with file_at(client, f"/results/{answer['key']}") as file:
        assert file["summary"]["strength_factor"][()].tolist() == [answer["strength_factor"]]
    sent = {"headers": {"Prefer": "respond-async, wait=30"}, "json": {"cases": [body]}}
    job = client.post(f"{path}/batch", **sent).headers["Content-Location"]  # type: ignore[arg-type]
    (row,) = rows_at(client, job)
    assert float(row["strength_factor"]) == answer["strength_factor"]


def test_exponent_of_the_diameter_can_be_swept(client: httpx.Client) -> None:
    axis = {"field": "resistance.strength_factor.diameter_exponent", "values": [-0.5, 0.0]}
    answer = answered(client, "/cra/sweep", {"base": with_model(PAPER, STRENGTH_AND_DIAMETER), "axes": [axis]})
    weaker, stronger = (each["result"]["strength_factor"] for each in answer["results"])
    assert weaker < stronger  # S falls with the diameter, and 80 mm exceed the reference diameter of 76.2 mm.


def test_equation_9_in_other_concrete_causes_a_warning(client: httpx.Client) -> None:
    target = PAPER["target"] | {"compressive_strength_pa": 20e6}
    for path, body in (("/trajectory", PAPER_AT_45), ("/cra", PAPER)):
        codes = {each["code"] for each in answered(client, path, body | {"target": target})["warnings"]}
        assert "strength_factor_of_other_concrete" in codes
        codes = {each["code"] for each in answered(client, path, body)["warnings"]}
        assert "strength_factor_of_other_concrete" not in codes


EQUATION_9 = {"model": "obliquity_polynomial"}
GRAZING = changed(PAPER_AT_45, "/impact/oblique_angle_deg", 75.0)


def test_equation_9_is_held_from_60_degrees_by_default(client: httpx.Client) -> None:
    laws = (EQUATION_9, EQUATION_9 | {"coefficients": [8.469, 0.0149, -0.0013]}, EQUATION_9 | {"held_from_deg": 60.0})
    runs = [answered(client, "/trajectory", with_model(GRAZING, law)) for law in laws]
    assert [run["strength_factor"] for run in runs] == [pytest.approx(4.683, rel=1e-12)] * 3
    assert runs[0]["final"] == runs[1]["final"] == runs[2]["final"]
    published = answered(client, "/trajectory", with_model(GRAZING, PUBLISHED))
    assert published["strength_factor"] == pytest.approx(8.84 * (80.0 / 76.2) ** -0.24 * 4.683 / 8.469, rel=1e-9)


@pytest.mark.parametrize(("held", "value"), [(0.0, 8.469), (55.0, 5.356), (90.0, 2.274)])
def test_polynomial_may_be_held_from_any_angle(client: httpx.Client, held: float, value: float) -> None:
    run = answered(client, "/trajectory", with_model(GRAZING, EQUATION_9 | {"held_from_deg": held}))
    assert run["strength_factor"] == pytest.approx(value, rel=1e-9)
    assert ("strength_factor_not_held" in {each["code"] for each in run["warnings"]}) is (held == 90.0)


def test_other_polynomials_are_not_held_and_cause_a_warning(client: httpx.Client) -> None:
    law = EQUATION_9 | {"coefficients": [9.0, 0.0, -0.001]}
    run = answered(client, "/trajectory", with_model(GRAZING, law))
    assert run["strength_factor"] == pytest.approx(9.0 - 5.625)
    assert "strength_factor_not_held" in {each["code"] for each in run["warnings"]}
