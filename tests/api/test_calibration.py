"""Calibration over HTTP, and the critical angle with its standard error."""

import math
from typing import Any

import httpx
import numpy as np
import pytest

from service.schemas import DepthCalibrationAnswer, MotionCalibrationAnswer, ObliquityCalibrationAnswer
from service.schemas.calibration_depth import CURVE_POINTS, TABLE_1, TABLE_2
from service.schemas.strike import PAPER

from .calibrations import BODY, POINTS, TESTS, answered, history_at, strike_at
from .refused import problem_of

EQ_9 = {"model": "obliquity_polynomial", "coefficients": [8.469, 0.0149, -0.0013]}
COVARIANCE = [[0.01, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
"""Covariance of the coefficients that gives S a standard error of 0.1 at every angle."""
NARROW = {"lower_deg": 40.0, "upper_deg": 60.0}


@pytest.fixture(scope="module")
def motion(client: httpx.Client) -> dict[str, Any]:
    """Request with a history that the service computed with a strength factor of 7.5."""
    return strike_at(30.0, history_at(client, 30.0, 7.5))


@pytest.mark.parametrize(("with_masses", "strength_factor"), [(False, 8.44), (True, 8.38)])
def test_depths_of_the_paper_give_its_strength_factor(
    client: httpx.Client, with_masses: bool, strength_factor: float
) -> None:
    tests = [test if with_masses else {**test, "mass_kg": 13.0} for test in TABLE_1]
    answer = DepthCalibrationAnswer.model_validate(answered(client, "/calibration/depth", BODY | {"tests": tests}))
    assert answer.strength_factor == pytest.approx(strength_factor, abs=0.02)
    assert isinstance(answer.confidence_interval, list)
    assert isinstance(answer.standard_error, float)
    low, high = answer.confidence_interval
    assert answer.strength_factor - low == pytest.approx(high - answer.strength_factor)
    assert high - answer.strength_factor == pytest.approx(2.447 * answer.standard_error, rel=1e-3)
    measured = [test["depth_m"] for test in TABLE_1]
    assert np.add(answer.predicted_depth_m, answer.residuals).tolist() == pytest.approx(measured)
    assert answer.root_mean_square_m == pytest.approx(math.hypot(*answer.residuals) / 2.0)


def test_one_shot_has_a_posterior_and_no_standard_error(client: httpx.Client) -> None:
    answer = answered(client, "/calibration/depth", BODY | {"tests": TABLE_1[:1]})
    assert answer["strength_factor"] == pytest.approx(7.58, abs=0.02)
    assert not {"standard_error", "confidence_interval"} & answer.keys()
    posterior = answer["posterior"]
    assert posterior["type"] == "log_student_t"
    assert posterior["median"] == pytest.approx(7.65, abs=0.05)
    assert posterior["degrees_of_freedom"] == 4.0
    assert 0.07 < posterior["scale"] < 0.1


def test_test_without_a_mass_has_the_mass_of_the_projectile(client: httpx.Client) -> None:
    light = {name: value for name, value in TABLE_1[0].items() if name != "mass_kg"}
    bodies = [BODY | {"tests": [first, *TABLE_1[1:]]} for first in (light, light | {"mass_kg": 13.0})]
    one, other = (answered(client, "/calibration/depth", body) for body in bodies)
    assert one["strength_factor"] == other["strength_factor"]


def test_groups_get_strength_factors_of_their_own(client: httpx.Client) -> None:
    tests = [test | {"group": "slow" if number < 2 else "fast"} for number, test in enumerate(TABLE_1)]
    answer = answered(client, "/calibration/depth", BODY | {"tests": tests})
    slow, fast = answer["groups"]
    assert (slow["group"], fast["group"]) == ("slow", "fast")
    alone = answered(client, "/calibration/depth", BODY | {"tests": TABLE_1[:2]})
    assert slow["strength_factor"] == pytest.approx(alone["strength_factor"], rel=1e-4)
    assert slow["strength_factor"] < answer["strength_factor"] < fast["strength_factor"]


def test_curves_are_computed_by_the_trajectory_model(client: httpx.Client) -> None:
    answer = answered(client, "/calibration/depth", TESTS | {"compare_strength_factors": [7.0, 10.0]})
    curves = answer["curves"]
    assert [curve["strength_factor"] for curve in curves] == [7.0, 10.0]
    for curve in curves:
        assert len(curve["velocity_m_s"]) == len(curve["depth_m"]) == CURVE_POINTS
        assert (np.diff(curve["depth_m"]) > 0.0).all()
    assert np.less(curves[1]["depth_m"], curves[0]["depth_m"]).all()
    strike = BODY | {
        "impact": {"velocity_m_s": curves[0]["velocity_m_s"][10], "oblique_angle_deg": 0.0},
        "resistance": {"strength_factor": {"model": "constant", "value": 7.0}},
    }
    deepest = answered(client, "/trajectory", strike)["maximum_depth_m"]
    assert curves[0]["depth_m"][10] == pytest.approx(deepest, rel=1e-4)


def test_fit_to_a_computed_motion_recovers_its_strength_factor(client: httpx.Client, motion: dict[str, Any]) -> None:
    answer = answered(client, "/calibration/motion", motion)
    told = MotionCalibrationAnswer.model_validate(answer)
    assert told.strength_factor == pytest.approx(7.5, rel=1e-3)
    low, high = told.confidence_interval
    assert low <= told.strength_factor <= high
    for part in ("residuals", "predicted"):
        assert list(answer[part]) == list(motion["history"])
        assert answer[part]["time_s"] == motion["history"]["time_s"]
    for name, tolerance in {"depth_displacement_m": 1e-4, "lateral_displacement_m": 1e-4, "rotation_deg": 0.05}.items():
        assert answer["predicted"][name] == pytest.approx(motion["history"][name], abs=tolerance)
        assert answer["root_mean_square"][name] < tolerance
        assert answer["r_squared"][name] == pytest.approx(1.0, abs=1e-4)


def test_omitted_quantities_are_absent_from_the_answer(client: httpx.Client, motion: dict[str, Any]) -> None:
    history = {name: motion["history"][name] for name in ("time_s", "rotation_deg")}
    body = motion | {"history": history, "compare_strength_factors": [7.0]}
    answer = answered(client, "/calibration/motion", body)
    assert answer["strength_factor"] == pytest.approx(7.5, rel=1e-3)
    columns = ["time_s", "rotation_deg"]
    assert list(answer["residuals"]) == list(answer["predicted"]) == columns
    assert list(answer["compared"][0]["history"]) == columns
    assert list(answer["root_mean_square"]) == list(answer["r_squared"]) == ["rotation_deg"]


def test_rows_after_the_requested_end_are_not_used(client: httpx.Client, motion: dict[str, Any]) -> None:
    history = motion["history"]
    deepest = int(np.argmax(history["depth_displacement_m"]))
    until = answered(client, "/calibration/motion", motion | {"until_s": 0.001})
    assert until["residuals"]["time_s"] == history["time_s"][:21]
    greatest = answered(client, "/calibration/motion", motion | {"until_greatest_depth": True})
    assert greatest["residuals"]["time_s"] == history["time_s"][: deepest + 1]
    spoiled = history | {"rotation_deg": history["rotation_deg"][:21] + [90.0] * (len(history["time_s"]) - 21)}
    again = answered(client, "/calibration/motion", motion | {"until_s": 0.001, "history": spoiled})
    assert again["strength_factor"] == until["strength_factor"]


def test_quantity_with_zero_weight_is_not_used(client: httpx.Client, motion: dict[str, Any]) -> None:
    spoiled = motion["history"] | {"rotation_deg": [-angle for angle in motion["history"]["rotation_deg"]]}
    body = motion | {"history": spoiled, "weights": {"rotation": 0.0}}
    answer = answered(client, "/calibration/motion", body)
    assert answer["strength_factor"] == pytest.approx(7.5, rel=1e-3)


def test_every_decay_law_is_fitted_and_the_best_is_named(client: httpx.Client) -> None:
    law = {"free_surface": {"model": "mohr_coulomb"}}
    made = strike_at(30.0, history_at(client, 30.0, 7.5, **law))
    answer = MotionCalibrationAnswer.model_validate(answered(client, "/calibration/motion", made))
    laws = {fit.free_surface.value: fit for fit in answer.decay_laws}
    assert list(laws) == ["elastic_plastic", "mohr_coulomb", "none"]
    assert answer.best_decay_law == "mohr_coulomb"
    assert laws["mohr_coulomb"].strength_factor == pytest.approx(7.5, rel=1e-3)
    assert laws["elastic_plastic"].strength_factor == answer.strength_factor != laws["mohr_coulomb"].strength_factor
    assert laws["elastic_plastic"].normalized_root_mean_square == answer.normalized_root_mean_square
    assert [warning.code for warning in answer.warnings if warning.code == "other_decay_law_fits_better"]
    requested = answered(client, "/calibration/motion", made | {"resistance": law})
    assert requested["strength_factor"] == laws["mohr_coulomb"].strength_factor
    assert [fit["free_surface"] for fit in requested["decay_laws"]] == list(laws)


def test_calibration_computes_with_the_crater_and_numerics_of_the_request(client: httpx.Client) -> None:
    crater = {"crater": {"depth_diameters": 3.0}}
    made = strike_at(30.0, history_at(client, 30.0, 7.5, **crater))
    with_crater = answered(client, "/calibration/motion", made | {"resistance": crater, "numerics": {}})
    assert with_crater["strength_factor"] == pytest.approx(7.5, rel=1e-3)
    assert with_crater["r_squared"]["depth_displacement_m"] > 0.9999
    without = answered(client, "/calibration/motion", made)
    assert without["normalized_root_mean_square"] > 10.0 * with_crater["normalized_root_mean_square"]
    rough = answered(client, "/calibration/depth", TESTS | {"numerics": {"relative_tolerance": 1e-2}})
    fine = answered(client, "/calibration/depth", TESTS)
    assert rough["strength_factor"] == pytest.approx(fine["strength_factor"], rel=1e-2)
    assert rough["key"] != fine["key"]


def test_decay_law_that_does_not_determine_the_factor_has_no_result(client: httpx.Client) -> None:
    law = {"free_surface": {"model": "mohr_coulomb"}}
    made = strike_at(48.0, history_at(client, 48.0, 8.0, **law)) | {"until_s": 0.003, "resistance": law}
    answer = answered(client, "/calibration/motion", made)
    assert answer["decay_laws"][2] == {"free_surface": "none"}
    problem_of(client.post("/calibration/motion", json=made | {"resistance": {"free_surface": {"model": "none"}}}), 422)


def test_runs_at_several_angles_get_a_common_and_separate_factors(client: httpx.Client) -> None:
    runs = [
        {name: strike_at(angle, history_at(client, angle, factor))[name] for name in ("impact", "history")}
        for angle, factor in ((15.0, 8.0), (30.0, 8.0), (45.0, 6.5))
    ]
    body = BODY | {"runs": runs, "until_s": 0.002, "compare_strength_factors": [7.0]}
    answer = answered(client, "/calibration/motion", body)
    told = MotionCalibrationAnswer.model_validate(answer)
    assert 6.5 < told.strength_factor < 8.0
    assert {"residuals", "predicted", "root_mean_square", "r_squared", "compared"}.isdisjoint(answer)
    for run, fitted in zip(runs, answer["runs"], strict=True):
        assert fitted["predicted"]["time_s"] == [time for time in run["history"]["time_s"] if time <= 0.002]
        for name, residuals in fitted["residuals"].items():
            if name != "time_s":
                given = run["history"][name][: len(residuals)]
                assert np.add(fitted["predicted"][name], residuals).tolist() == pytest.approx(given)
        assert [motion["strength_factor"] for motion in fitted["compared"]] == [7.0]
    (plain,) = (law for law in answer["decay_laws"] if law["free_surface"] == "elastic_plastic")
    assert [run["alone"]["strength_factor"] for run in plain["runs"]] == pytest.approx([8.0, 8.0, 6.5], rel=1e-3)
    for run, fitted in zip(plain["runs"], answer["runs"], strict=True):
        assert run["normalized_root_mean_square"] == fitted["normalized_root_mean_square"]
        assert run["alone"]["normalized_root_mean_square"] < run["normalized_root_mean_square"]
    squares = [run["normalized_root_mean_square"] ** 2 for run in answer["runs"]]
    assert answer["normalized_root_mean_square"] == pytest.approx(math.sqrt(sum(squares) / 3.0))
    assert answer["best_decay_law"] == "elastic_plastic"


def test_list_of_one_run_gives_the_result_of_a_single_strike(client: httpx.Client, motion: dict[str, Any]) -> None:
    alone = answered(client, "/calibration/motion", motion)
    runs = [{"impact": motion["impact"], "history": motion["history"]}]
    answer = answered(client, "/calibration/motion", BODY | {"runs": runs})
    assert answer["strength_factor"] == alone["strength_factor"]
    assert answer["runs"][0] == {name: alone[name] for name in answer["runs"][0]}


def test_settings_of_a_run_take_precedence_over_the_request(client: httpx.Client, motion: dict[str, Any]) -> None:
    """End time and weights of a run replace the end time and weights of the request."""
    history = motion["history"] | {"rotation_deg": [-angle for angle in motion["history"]["rotation_deg"]]}
    plain = {"impact": motion["impact"], "history": motion["history"]}
    spoiled = {"impact": motion["impact"], "history": history, "weights": {"rotation": 0.0}, "until_s": 0.001}
    body = BODY | {"runs": [plain, spoiled], "until_greatest_depth": True}
    answer = answered(client, "/calibration/motion", body)
    assert answer["strength_factor"] == pytest.approx(7.5, rel=1e-3)
    deepest = int(np.argmax(history["depth_displacement_m"]))
    ends = [len(run["residuals"]["time_s"]) for run in answer["runs"]]
    assert ends == [deepest + 1, 21]


def test_table_2_gives_equation_9(client: httpx.Client) -> None:
    answer = ObliquityCalibrationAnswer.model_validate(answered(client, "/calibration/obliquity", POINTS))
    assert [round(value, digits) for value, digits in zip(answer.coefficients, (3, 4, 4), strict=True)] == [
        8.469,
        0.0149,
        -0.0013,
    ]
    assert sum(answer.residuals) == pytest.approx(0.0, abs=1e-12)
    assert answer.strength_factor_model.coefficients == answer.coefficients
    assert answer.strength_factor_model.covariance == answer.covariance
    assert np.array(answer.covariance).shape == (3, 3)


def test_polynomial_through_every_point_has_no_covariance(client: httpx.Client) -> None:
    answer = answered(client, "/calibration/obliquity", POINTS | {"order": 3})
    assert "covariance" not in answer
    assert "covariance" not in answer["strength_factor_model"]
    known = [point | {"standard_error": 0.1} for point in TABLE_2]
    assert "covariance" in answered(client, "/calibration/obliquity", {"points": known, "order": 3})


def test_covariance_gives_the_critical_angle_a_standard_error(client: httpx.Client) -> None:
    certain = PAPER | {"search": NARROW, "resistance": {"strength_factor": EQ_9}}
    uncertain = certain | {"resistance": {"strength_factor": EQ_9 | {"covariance": COVARIANCE}}}
    one, other = answered(client, "/cra", certain), answered(client, "/cra", uncertain)
    assert "critical_angle_standard_error_deg" not in one
    assert one["critical_angle_deg"] == other["critical_angle_deg"]
    shifted = [
        answered(client, "/cra", certain | {"resistance": {"strength_factor": {**EQ_9, "coefficients": [low, *rest]}}})
        for low, *rest in ([8.369, 0.0149, -0.0013], [8.569, 0.0149, -0.0013])
    ]
    half = 0.5 * abs(shifted[1]["critical_angle_deg"] - shifted[0]["critical_angle_deg"])
    assert other["critical_angle_standard_error_deg"] == pytest.approx(half, abs=0.01)


def test_angles_of_batches_have_standard_errors_too(client: httpx.Client) -> None:
    case = PAPER | {"search": NARROW, "resistance": {"strength_factor": EQ_9 | {"covariance": COVARIANCE}}}
    alone = answered(client, "/cra", case)
    axes = [{"field": "impact.velocity_m_s", "values": [238.0]}]
    bodies = {"/cra/batch": {"cases": [case, PAPER | {"search": NARROW}]}, "/cra/sweep": {"base": case, "axes": axes}}
    for path, body in bodies.items():
        results = answered(client, path, body)["results"]
        assert results[0]["result"] == alone
    job = client.post("/cra/batch", json=bodies["/cra/batch"], headers={"Prefer": "wait=20, respond-async"}).json()
    assert [item["result"].get("critical_angle_standard_error_deg") for item in job["results"]] == [
        alone["critical_angle_standard_error_deg"],
        None,
    ]


def test_factors_of_several_strikes_lead_to_an_angle_with_a_standard_error(client: httpx.Client) -> None:
    factors = {15.0: 8.25, 30.0: 7.91, 40.0: 7.1, 45.0: 6.48}
    noise = np.random.default_rng(5)
    points = []
    for angle, factor in factors.items():
        history = history_at(client, angle, factor)
        for name, scatter in {
            "depth_displacement_m": 1e-3,
            "lateral_displacement_m": 1e-3,
            "rotation_deg": 0.5,
        }.items():
            history[name] = np.add(history[name], noise.normal(scale=scatter, size=len(history[name]))).tolist()
        body = strike_at(angle, history) | {"until_greatest_depth": True}
        fit = answered(client, "/calibration/motion", body)
        assert fit["strength_factor"] == pytest.approx(factor, abs=4.0 * fit["standard_error"])
        points.append(
            {"oblique_angle_deg": angle} | {name: fit[name] for name in ("strength_factor", "standard_error")}
        )
    model = answered(client, "/calibration/obliquity", {"points": points})["strength_factor_model"]
    answer = answered(client, "/cra", PAPER | {"search": NARROW, "resistance": {"strength_factor": model}})
    assert answer["status"] == "converged"
    assert answer["critical_angle_deg"] == pytest.approx(48.6, abs=2.0)
    assert 0.0 < answer["critical_angle_standard_error_deg"] < 2.0
