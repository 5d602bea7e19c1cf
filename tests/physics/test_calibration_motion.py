"""Calibration of the strength factor with motion histories."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import ConstantStrengthFactor, Numerics, Outcome, ParameterError, Resistance, Trajectory
from solver.arrays import FloatArray
from solver.calibration import MotionFit, MotionHistory, Weights, fit_motion, predict_motion
from solver.strike import paper_impact

from .strikes import CASE, codes, known, paper_run

ANGLES = (15.0, 30.0, 45.0)
TIMES = np.linspace(0.0, 5e-3, 101)
QUANTITIES = ("depth_displacement", "lateral_displacement", "rotation")
NOISE = {"depth_displacement": 1e-3, "lateral_displacement": 1e-3, "rotation": math.radians(0.5)}


def run(angle: float, strength_factor: float, sample_interval: float) -> Trajectory:
    resistance = Resistance(strength_factor=ConstantStrengthFactor(value=strength_factor))
    return paper_run(angle, resistance=resistance, sample_interval=sample_interval)


def motion(angle: float, strength_factor: float, times: FloatArray = TIMES, **more: Any) -> MotionHistory:
    return predict_motion(
        **CASE, impact=paper_impact(oblique_angle_degrees=angle), strength_factor=strength_factor, times=times, **more
    )


def fit(angle: float, history: MotionHistory, **more: Any) -> MotionFit:
    return fit_motion(**CASE, impact=paper_impact(oblique_angle_degrees=angle), history=history, **more)


def shifted(history: MotionHistory, shifts: dict[str, FloatArray]) -> MotionHistory:
    return replace(history, **{name: getattr(history, name) + shift for name, shift in shifts.items()})


def white(random: np.random.Generator, size: int) -> dict[str, FloatArray]:
    return {name: scatter * random.normal(size=size) for name, scatter in NOISE.items()}


@pytest.mark.parametrize("strength_factor", [5.0, 8.5, 12.0])
@pytest.mark.parametrize("angle", ANGLES)
def test_fit_to_a_computed_motion_recovers_the_strength_factor(angle: float, strength_factor: float) -> None:
    """The relative error of S is at most 10⁻⁴."""
    made = run(angle, strength_factor, 5e-5).history
    assert made is not None
    found = fit(
        angle,
        MotionHistory(
            time=made.time,
            depth_displacement=made.center_of_gravity_depth - made.center_of_gravity_depth[0],
            lateral_displacement=made.center_of_gravity_lateral,
            rotation=made.axis_angle - made.axis_angle[0],
        ),
    )
    assert found.estimate.strength_factor == pytest.approx(strength_factor, rel=1e-4)
    assert min(found.r_squared.values()) > 0.999999
    assert "poor_fit" not in codes(found)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_each_quantity_alone_determines_the_strength_factor(quantity: str) -> None:
    whole = motion(30.0, 8.0)
    found = fit(30.0, MotionHistory(time=TIMES, **{quantity: getattr(whole, quantity)}))
    assert found.estimate.strength_factor == pytest.approx(8.0, rel=1e-4)
    assert list(found.root_mean_square) == [quantity]
    assert list(found.residuals.columns) == [quantity]
    assert list(found.predicted.columns) == list(QUANTITIES)


def covered(trials: int) -> int:
    """Fit motions with random S from 5 to 12 and white noise of 1 mm and 0.5°; count 95 % intervals that contain S."""
    random, hits = np.random.default_rng(20180628), 0
    for trial in range(trials):
        angle, strength_factor = ANGLES[trial % 3], random.uniform(5.0, 12.0)
        history = shifted(motion(angle, strength_factor), white(random, TIMES.size))
        low, high = fit(angle, history).estimate.confidence_interval
        hits += low <= strength_factor <= high
    return hits


def test_intervals_contain_the_true_value_under_noise() -> None:
    assert covered(6) >= 5


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_95_percent_intervals_contain_the_true_value_in_93_percent_of_300_trials() -> None:
    assert covered(300) >= 279


def test_correlated_errors_widen_the_interval() -> None:
    """Noise with an autocorrelation of 0.9 contains fewer independent samples than white noise."""
    random, history = np.random.default_rng(3), motion(30.0, 8.0)
    noise = white(random, TIMES.size)
    alike = {name: values.copy() for name, values in noise.items()}
    for values in alike.values():
        for n in range(1, values.size):
            values[n] = 0.9 * values[n - 1] + math.sqrt(1.0 - 0.9**2) * values[n]
    plain, correlated = fit(30.0, shifted(history, noise)).estimate, fit(30.0, shifted(history, alike)).estimate
    assert correlated.standard_error > 2.0 * plain.standard_error
    assert correlated.degrees_of_freedom < plain.degrees_of_freedom / 3.0
    low, high = correlated.confidence_interval
    assert low < 8.0 < high


def test_standard_error_under_white_noise_agrees_with_weighted_least_squares() -> None:
    """The standard error is 1 / sqrt(Σ (slope / noise)²) with the true noise."""
    times = np.linspace(0.0, 3e-3, 400)
    history = shifted(motion(30.0, 8.0, times), white(np.random.default_rng(4), times.size))
    upper, lower = motion(30.0, 8.02, times), motion(30.0, 7.98, times)
    information = sum(
        float(np.sum(((getattr(upper, name) - getattr(lower, name)) / 0.04 / scatter) ** 2))
        for name, scatter in NOISE.items()
    )
    best = {name: (float(np.ptp(getattr(history, name))) / scatter) ** 2 for name, scatter in NOISE.items()}
    weights = Weights(**{name.removesuffix("_displacement"): weight for name, weight in best.items()})
    found = fit(30.0, history, weights=weights)
    assert found.estimate.standard_error == pytest.approx(information**-0.5, rel=0.15)
    for name, scatter in NOISE.items():
        assert found.root_mean_square[name] == pytest.approx(scatter, rel=0.1)


def test_weight_of_zero_excludes_a_quantity() -> None:
    random, history = np.random.default_rng(6), motion(30.0, 8.0)
    spoilt = shifted(history, {"rotation": 0.05 * random.normal(size=TIMES.size)})
    found = fit(30.0, spoilt, weights=Weights(rotation=0.0))
    assert found.estimate.strength_factor == pytest.approx(8.0, rel=1e-4)
    assert found.root_mean_square["rotation"] == pytest.approx(0.05, rel=0.2)


def test_only_the_ratio_of_weights_matters() -> None:
    history = shifted(motion(45.0, 8.0), white(np.random.default_rng(7), TIMES.size))
    plain, heavy = fit(45.0, history), fit(45.0, history, weights=Weights(depth=5.0, lateral=5.0, rotation=5.0))
    assert heavy.estimate.strength_factor == pytest.approx(plain.estimate.strength_factor, rel=1e-6)
    assert heavy.estimate.standard_error == pytest.approx(plain.estimate.standard_error, rel=1e-4)


def test_prediction_equals_a_run_at_the_requested_times() -> None:
    for angle in (30.0, 60.0):
        made = run(angle, 8.0, 1e-4)
        assert made.history is not None
        predicted = motion(angle, 8.0, made.history.time).columns
        depth, axis = made.history.center_of_gravity_depth, made.history.axis_angle
        for name, expected in (
            ("depth_displacement", depth - depth[0]),
            ("lateral_displacement", made.history.center_of_gravity_lateral),
            ("rotation", axis - axis[0]),
        ):
            np.testing.assert_allclose(predicted[name], expected, rtol=0, atol=1e-6)


def test_prediction_stays_at_rest_once_embedded() -> None:
    made = run(15.0, 8.0, 1e-4)
    assert made.outcome is Outcome.EMBEDDED
    late = motion(15.0, 8.0, made.final.time + np.array([1e-5, 1e-3, 1.0]))
    assert late.depth_displacement is not None
    np.testing.assert_allclose(late.depth_displacement, late.depth_displacement[0], rtol=0, atol=1e-12)
    assert known(late.lateral_displacement)[0] == pytest.approx(made.final.center_of_gravity_lateral, abs=1e-7)


def test_prediction_flies_freely_once_turned_away() -> None:
    made = run(60.0, 8.0, 1e-4)
    assert made.outcome is Outcome.RICOCHET
    flight = np.array([0.0, 1e-3, 0.1])
    late = motion(60.0, 8.0, made.final.time * (1.0 + 1e-9) + flight)
    for values, rate in (
        (late.depth_displacement, made.final.depth_velocity),
        (late.lateral_displacement, made.final.lateral_velocity),
        (late.rotation, made.final.angular_velocity),
    ):
        assert values is not None
        np.testing.assert_allclose(values - values[0], rate * flight, rtol=1e-5)


def test_prediction_by_panels_agrees_with_the_default_method() -> None:
    fine, panels = motion(30.0, 8.0), motion(30.0, 8.0, numerics=Numerics(method="panels", panels=3000))
    assert np.abs(known(fine.depth_displacement) - known(panels.depth_displacement)).max() < 5e-4


def test_history_can_be_cut_at_a_time_or_at_its_greatest_depth() -> None:
    history = MotionHistory(time=np.arange(5.0), depth_displacement=np.array([0.0, 2.0, 3.0, 2.5, 2.4]))
    assert history.time_of_greatest_depth == 2.0
    cut = history.until(history.time_of_greatest_depth)
    assert list(cut.time) == [0.0, 1.0, 2.0]
    assert list(known(cut.depth_displacement)) == [0.0, 2.0, 3.0]
    with pytest.raises(ParameterError, match="at least 2 rows"):
        history.until(0.5)
    with pytest.raises(ParameterError, match=r"history\.depth_displacement"):
        _ = MotionHistory(time=np.arange(2.0), rotation=np.zeros(2)).time_of_greatest_depth


def test_poor_fit_causes_a_warning() -> None:
    history = motion(30.0, 8.0)
    found = fit(30.0, replace(history, rotation=-known(history.rotation)))
    assert "poor_fit" in codes(found)
    assert found.r_squared["rotation"] < 0.5


def column(**columns: list[float]) -> Callable[[], MotionHistory]:
    return lambda: MotionHistory(**{name: np.array(values) for name, values in columns.items()})


REFUSED: list[tuple[str, str, Callable[[], MotionHistory]]] = [
    ("history", "depth displacement, lateral displacement or rotation", column(time=[0.0, 1.0])),
    ("history.time", "one leaves nothing to fit", column(time=[0.0], rotation=[0.0])),
    ("history.time", "at least 2", column(time=[], rotation=[])),
    ("history.time.0", "at least 0", column(time=[-1e-6, 1.0], rotation=[0.0, 0.0])),
    ("history.time.2", "later than the row before", column(time=[0.0, 2.0, 1.0], rotation=[0.0, 0.0, 0.0])),
    ("history.time.1", "later than the row before", column(time=[0.0, 0.0, 1.0], rotation=[0.0, 0.0, 0.0])),
    ("history.time.1", "finite", column(time=[0.0, math.nan], rotation=[0.0, 0.0])),
    ("history.rotation", "as long as time", column(time=[0.0, 1.0], rotation=[0.0, 0.0, 0.0])),
    ("history.lateral_displacement.1", "finite", column(time=[0.0, 1.0], lateral_displacement=[0.0, math.inf])),
    ("history.rotation", "column", lambda: MotionHistory(time=np.arange(2.0), rotation=np.zeros((2, 2)))),
]


@pytest.mark.parametrize(("field", "reason", "build"), REFUSED)
def test_invalid_history_is_refused(field: str, reason: str, build: Callable[[], MotionHistory]) -> None:
    with pytest.raises(ParameterError, match=reason) as refused:
        build()
    assert refused.value.field == field


@pytest.mark.parametrize(
    ("quantity", "factor"),
    [("depth_displacement", 1e3), ("lateral_displacement", 1e3), ("rotation", 180.0 / math.pi)],
    ids=["depth in mm", "lateral in mm", "rotation in degrees"],
)
def test_motion_beyond_the_energy_of_the_strike_is_refused(quantity: str, factor: float) -> None:
    history = motion(30.0, 8.0)
    wrong = replace(history, **{quantity: getattr(history, quantity) * factor})
    with pytest.raises(ParameterError, match="check the units") as refused:
        fit(30.0, wrong)
    assert refused.value.field.startswith(f"history.{quantity}.")


def test_history_that_does_not_determine_the_strength_factor_is_refused() -> None:
    """One history is of a projectile without resistance, the other ends before the contact has any effect."""
    impact = paper_impact(oblique_angle_degrees=30.0)
    on = MotionHistory(time=TIMES, depth_displacement=impact.velocity * math.cos(impact.oblique_angle) * TIMES)
    with pytest.raises(ParameterError, match=r"history: must determine the strength factor"):
        fit(30.0, on)
    still = MotionHistory(time=np.array([0.0, 1e-12]), depth_displacement=np.zeros(2))
    with pytest.raises(ParameterError, match=r"history: must determine the strength factor"):
        fit(30.0, still)


def test_weights_must_not_be_negative_or_all_zero() -> None:
    with pytest.raises(ParameterError) as refused:
        Weights(lateral=-1.0)
    assert refused.value.field == "weights.lateral"
    with pytest.raises(ParameterError, match=r"weights: must be greater than 0"):
        fit(30.0, MotionHistory(time=TIMES, rotation=np.zeros(TIMES.size)), weights=Weights(rotation=0.0))
