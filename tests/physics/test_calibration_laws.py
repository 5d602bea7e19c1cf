"""Calibration on several motions at once, and comparison of the decay laws."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import ElasticPlastic, Impact, MohrCoulomb, NoFreeSurface, ParameterError, Resistance
from solver.calibration import (
    DecayLawFits,
    MotionHistory,
    MotionRun,
    MotionsFit,
    UndeterminedError,
    Weights,
    fit_decay_laws,
    fit_motion,
    fit_motions,
    predict_motion,
)
from solver.free_surface import FreeSurface

from .strikes import CASE, codes, known

LAWS: tuple[FreeSurface, ...] = (ElasticPlastic(), MohrCoulomb(), NoFreeSurface())


def run(
    angle: float, strength_factor: float, *, velocity: float = 238.0, law: FreeSurface | None = None, rows: int = 61
) -> MotionRun:
    """Return a strike, with the motion that the model computes for it as its history."""
    impact = Impact(velocity=velocity, oblique_angle=math.radians(angle))
    history = predict_motion(
        **CASE,
        impact=impact,
        strength_factor=strength_factor,
        times=np.linspace(0.0, 3e-3, rows),
        resistance=Resistance(free_surface=law or ElasticPlastic()),
    )
    return MotionRun(impact=impact, history=history)


def fit(*runs: MotionRun, **more: Any) -> MotionsFit:
    return fit_motions(**CASE, runs=runs, **more)


def compare(*runs: MotionRun, **more: Any) -> DecayLawFits:
    return fit_decay_laws(**CASE, runs=runs, **more)


def test_one_strength_factor_is_found_from_several_angles_and_speeds() -> None:
    found = fit(run(15.0, 7.5), run(30.0, 7.5, velocity=300.0), run(45.0, 7.5, velocity=200.0))
    assert found.estimate.strength_factor == pytest.approx(7.5, rel=1e-4)
    assert found.normalized_root_mean_square < 1e-4
    for alone in found.alone:
        assert known(alone).estimate.strength_factor == pytest.approx(7.5, rel=1e-4)


def test_comparison_of_one_run_equals_its_single_fit() -> None:
    one = run(30.0, 8.0)
    common, alone = fit(one), fit_motion(**CASE, impact=one.impact, history=one.history)
    assert common.estimate == alone.estimate
    assert common.normalized_root_mean_square == pytest.approx(alone.normalized_root_mean_square)
    assert common.runs == common.alone
    assert common.warnings == alone.warnings


def test_common_factor_lies_between_the_factors_of_the_runs() -> None:
    found = fit(run(15.0, 8.0), run(45.0, 6.0))
    first, second = found.alone
    assert first is not None
    assert first.estimate.strength_factor == pytest.approx(8.0, rel=1e-4)
    assert known(second).estimate.strength_factor == pytest.approx(6.0, rel=1e-4)
    assert 6.0 < found.estimate.strength_factor < 8.0
    low, high = found.estimate.confidence_interval
    assert high - low > 1.0
    assert found.normalized_root_mean_square > 100.0 * first.normalized_root_mean_square
    squares = [each.normalized_root_mean_square**2 for each in found.runs]
    assert found.normalized_root_mean_square == pytest.approx(math.sqrt(sum(squares) / 2.0))


def test_runs_have_equal_weight_whatever_their_number_of_rows() -> None:
    few, many = (fit(run(15.0, 8.0), run(45.0, 6.0, rows=rows)).estimate.strength_factor for rows in (61, 601))
    assert many == pytest.approx(few, rel=2e-3)


def test_order_of_runs_does_not_matter() -> None:
    one, other = run(15.0, 8.0), run(45.0, 6.0)
    first, second = fit(one, other), fit(other, one)
    # Motions have a relative error of 1e-6, so both fits agree within the tolerance of the search.
    assert first.normalized_root_mean_square == pytest.approx(second.normalized_root_mean_square, rel=1e-5)
    error = first.estimate.standard_error
    assert first.estimate.strength_factor == pytest.approx(second.estimate.strength_factor, abs=0.01 * error)


def test_normalised_root_mean_square_divides_residuals_by_spans() -> None:
    made = run(30.0, 8.0)
    noise = np.random.default_rng(8).normal(size=made.history.time.size)
    history = replace(made.history, rotation=known(made.history.rotation) + 0.01 * noise)
    weights = Weights(depth=1.0, lateral=2.0, rotation=3.0)
    found = fit_motion(**CASE, impact=made.impact, history=history, weights=weights)
    shares = {"depth_displacement": 1.0 / 6.0, "lateral_displacement": 2.0 / 6.0, "rotation": 3.0 / 6.0}
    square = sum(
        share * (found.root_mean_square[name] / float(np.ptp(history.columns[name]))) ** 2
        for name, share in shares.items()
    )
    assert found.normalized_root_mean_square == pytest.approx(math.sqrt(square))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_law_that_generated_the_motions_is_the_best(law: FreeSurface) -> None:
    found = compare(run(30.0, 6.0, law=law), run(45.0, 6.0, law=law))
    assert found.best == law.name
    made = found.laws[law.name]
    assert made is not None
    assert made.estimate.strength_factor == pytest.approx(6.0, rel=1e-4)
    assert made.normalized_root_mean_square < 1e-4
    for name, other in found.laws.items():
        assert name == law.name or other is None or other.normalized_root_mean_square > 0.01
    assert ("other_decay_law_fits_better" in codes(found)) == (law.name != "elastic_plastic")


def test_requested_law_is_the_law_of_the_resistance() -> None:
    motion = run(30.0, 6.0, law=MohrCoulomb())
    found = compare(motion, resistance=Resistance(free_surface=MohrCoulomb()))
    assert found.requested is found.laws["mohr_coulomb"]
    assert found.requested.estimate.strength_factor == pytest.approx(6.0, rel=1e-4)
    assert "other_decay_law_fits_better" not in codes(found)


def test_other_laws_have_the_inertia_of_the_requested_law() -> None:
    law = MohrCoulomb(inertia=True)
    found = compare(run(45.0, 6.0, law=law), resistance=Resistance(free_surface=ElasticPlastic(inertia=True)))
    assert found.best == "mohr_coulomb"
    best = found.laws["mohr_coulomb"]
    assert best is not None
    assert best.free_surface == law
    assert best.estimate.strength_factor == pytest.approx(6.0, rel=1e-4)


def test_law_that_does_not_determine_the_factor_is_left_out() -> None:
    """Without decay the misfit to this motion falls as S rises, however large S is, so S is not determined."""
    found = compare(run(48.0, 8.0, law=MohrCoulomb()), resistance=Resistance(free_surface=MohrCoulomb()))
    assert found.laws[NoFreeSurface.name] is None
    assert found.best == "mohr_coulomb"
    with pytest.raises(UndeterminedError):
        compare(run(48.0, 8.0, law=MohrCoulomb()), resistance=Resistance(free_surface=NoFreeSurface()))


def test_each_run_is_fitted_with_its_own_weights() -> None:
    made = run(30.0, 8.0)
    spoilt = replace(
        made, history=replace(made.history, rotation=-known(made.history.rotation)), weights=Weights(rotation=0.0)
    )
    found = fit(run(45.0, 8.0), spoilt)
    assert found.estimate.strength_factor == pytest.approx(8.0, rel=1e-4)
    assert found.normalized_root_mean_square < 1e-4
    assert "poor_fit" in codes(found)


def test_run_that_does_not_determine_the_factor_uses_the_common_one() -> None:
    """The history of the second run ends before the contact has any effect."""
    still = MotionRun(
        impact=Impact(velocity=238.0, oblique_angle=0.0),
        history=MotionHistory(time=np.array([0.0, 1e-12]), depth_displacement=np.zeros(2)),
    )
    found = fit(run(30.0, 8.0), still)
    assert found.estimate.strength_factor == pytest.approx(8.0, rel=1e-3)
    assert found.alone[1] is None
    assert "run_undetermined" in codes(found)
    with pytest.raises(UndeterminedError, match=r"runs: must determine the strength factor"):
        fit(still, still)
    with pytest.raises(UndeterminedError, match=r"history: must determine the strength factor"):
        fit(still)


@pytest.mark.parametrize(("name", "factor"), [("rotation", 60.0), ("depth_displacement", 1e3)])
def test_error_in_a_run_names_its_index(name: str, factor: float) -> None:
    good = run(30.0, 8.0)
    wrong = {name: factor * getattr(good.history, name)}
    with pytest.raises(ParameterError, match="check the units") as refused:
        fit(good, replace(good, history=replace(good.history, **wrong)))
    assert refused.value.field.startswith(f"runs.1.history.{name}.")


def test_comparison_needs_a_run_and_a_quantity_in_each() -> None:
    with pytest.raises(ParameterError, match=r"runs: must be at least 1"):
        fit()
    made = run(30.0, 8.0)
    bare = replace(made, history=MotionHistory(time=made.history.time, rotation=made.history.rotation))
    with pytest.raises(ParameterError) as refused:
        fit(made, replace(bare, weights=Weights(rotation=0.0)))
    assert refused.value.field == "runs.1.weights"
