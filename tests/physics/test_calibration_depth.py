"""Calibration of the strength factor with depth tests."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from solver import (
    Numerics,
    OwnTests,
    ParameterError,
    Projectile,
    PublishedTests,
    Resistance,
    Shot,
    solid_properties,
)
from solver.arrays import FloatArray
from solver.calibration import DepthFit, DepthTest, fit_depth, penetration_depths
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET

from .strikes import CASE, codes
from .tables import table_1

NAN, INFINITE = math.nan, math.inf
VELOCITIES = (238.1, 275.7, 314.0, 369.5)
TESTS = table_1(with_masses=False)


def fit(
    tests: Sequence[DepthTest],
    *,
    projectile: Projectile = PAPER_PROJECTILE,
    resistance: Resistance | None = None,
    confidence_level: float = 0.95,
) -> DepthFit:
    return fit_depth(
        projectile=projectile,
        target=PAPER_TARGET,
        tests=tests,
        resistance=resistance,
        confidence_level=confidence_level,
    )


def depths(strength_factor: float, velocities: Sequence[float] = VELOCITIES) -> FloatArray:
    return penetration_depths(**CASE, velocities=velocities, strength_factor=strength_factor)


@pytest.mark.parametrize(
    ("with_masses", "diameter", "expected", "tolerance"),
    [(False, 0.08, 8.44, 0.02), (True, 0.08, 8.38, 0.02), (True, 0.0762, 9.2, 0.05)],
    ids=["one mass", "each its mass", "diameter as fired"],
)
def test_table_1_gives_its_strength_factor(
    with_masses: bool, diameter: float, expected: float, tolerance: float
) -> None:
    found = fit(table_1(with_masses=with_masses), projectile=replace(PAPER_PROJECTILE, diameter=diameter))
    assert found.estimate.strength_factor == pytest.approx(expected, abs=tolerance)
    assert found.warnings == ()


@pytest.mark.parametrize("strength_factor", [2.1, 5.0, 12.0, 40.0])
def test_fit_to_computed_depths_recovers_the_strength_factor(strength_factor: float) -> None:
    made = depths(strength_factor)
    found = fit([DepthTest(velocity=v, depth=float(z)) for v, z in zip(VELOCITIES, made, strict=True)])
    assert found.estimate.strength_factor == pytest.approx(strength_factor, rel=1e-5)
    np.testing.assert_allclose(found.predicted, made, rtol=1e-5)


def test_fit_to_the_closed_form_without_inertia_recovers_the_strength_factor() -> None:
    """If B = 0, ½ m V² is S f'c (π a² (z - nose length) + nose volume), apart from the energy at the end of the run."""
    strength_factor, area = 9.0, math.pi * PAPER_PROJECTILE.radius**2
    shank = area * (PAPER_PROJECTILE.length - PAPER_PROJECTILE.nose_length)
    entry = PAPER_PROJECTILE.nose_length - (solid_properties(PAPER_PROJECTILE).volume - shank) / area
    static = strength_factor * PAPER_TARGET.compressive_strength * area
    tests = [DepthTest(velocity=v, depth=entry + 0.5 * PAPER_PROJECTILE.mass * v**2 / static) for v in VELOCITIES]
    found = fit(tests, resistance=Resistance(inertia_factor=0.0))
    assert found.estimate.strength_factor == pytest.approx(strength_factor, rel=2e-4)


def test_standard_error_is_the_scatter_divided_by_the_slope() -> None:
    found = fit(TESTS)
    best = found.estimate.strength_factor
    slope = (depths(best + 0.01) - depths(best - 0.01)) / 0.02
    steepness = float(np.linalg.norm(slope))
    squares = float(np.sum(found.residuals**2))
    # The prior counts as three more tests with the scatter within published series.
    usual = (PublishedTests.within_series * best * steepness) ** 2 / 4.0
    scatter = math.sqrt((3.0 * usual + squares) / 6.0)
    assert float(found.residuals @ slope) == pytest.approx(0.0, abs=1e-5 * scatter * steepness)
    assert found.estimate.standard_error == pytest.approx(scatter / steepness, rel=1e-3)
    assert found.root_mean_square == pytest.approx(math.sqrt(squares / 4.0))
    np.testing.assert_allclose(found.residuals, [test.depth for test in TESTS] - found.predicted, rtol=1e-12)


def test_interval_follows_students_distribution() -> None:
    """The tabulated quantiles of Student's distribution with six degrees of freedom are 2.447 and 1.943."""
    for level, quantile in ((0.95, 2.447), (0.90, 1.943)):
        estimate = fit(TESTS, confidence_level=level).estimate
        low, high = estimate.confidence_interval
        assert (estimate.degrees_of_freedom, estimate.confidence_level) == (6, level)
        assert high - estimate.strength_factor == pytest.approx(quantile * estimate.standard_error, rel=2e-4)
        assert low + high == pytest.approx(2.0 * estimate.strength_factor)


def test_weight_of_two_equals_the_same_test_twice() -> None:
    heavy = fit([replace(TESTS[0], weight=2.0), *TESTS[1:]])
    twice = fit([TESTS[0], *TESTS])
    assert heavy.estimate.strength_factor == pytest.approx(twice.estimate.strength_factor, rel=1e-6)
    assert heavy.root_mean_square == pytest.approx(twice.root_mean_square, rel=1e-6)


def test_only_the_ratio_of_weights_matters() -> None:
    plain, heavy = fit(TESTS), fit([replace(test, weight=7.0) for test in TESTS])
    assert heavy.estimate.strength_factor == pytest.approx(plain.estimate.strength_factor, rel=1e-6)
    assert heavy.estimate.standard_error == pytest.approx(plain.estimate.standard_error, rel=1e-6)


def test_each_group_is_fitted_as_if_alone() -> None:
    names = ["slow", "slow", "fast", "fast"]
    grouped = fit([replace(test, group=name) for test, name in zip(TESTS, names, strict=True)])
    assert grouped.estimate == fit(TESTS).estimate
    assert list(grouped.groups) == ["slow", "fast"]
    assert grouped.groups["slow"].estimate == fit(TESTS[:2]).estimate
    assert grouped.groups["fast"].estimate == fit(TESTS[2:]).estimate


def test_group_of_one_test_is_reported_but_not_fitted() -> None:
    found = fit([replace(test, group=name) for test, name in zip(TESTS, ["a", "a", "a", "b"], strict=True)])
    assert list(found.groups) == ["a"]
    assert codes(found) == {"group_of_one"}


def test_depths_grow_with_velocity_and_mass_and_fall_with_strength() -> None:
    plain = depths(8.0)
    assert np.all(np.diff(plain) > 0.0)
    assert np.all(depths(9.0) < plain)
    heavier = penetration_depths(**CASE, velocities=VELOCITIES, strength_factor=8.0, masses=[14.0] * 4)
    assert np.all(heavier > plain)


def test_warnings_are_part_of_the_fit() -> None:
    shallow = [DepthTest(velocity=150.0, depth=0.14), DepthTest(velocity=250.0, depth=0.3)]
    assert codes(fit(shallow)) == {"shallow_tests"}
    fast = [DepthTest(velocity=900.0, depth=2.4), DepthTest(velocity=700.0, depth=1.6)]
    assert codes(fit(fast)) == {"velocity_beyond_rigid"}
    early = fit_depth(**CASE, tests=TESTS, numerics=Numerics(termination_time=2.2e-3))
    assert "undecided" in codes(early)


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("velocity", {"velocity": 0.0}),
        ("velocity", {"velocity": NAN}),
        ("depth", {"depth": -0.3}),
        ("depth", {"depth": INFINITE}),
        ("mass", {"mass": 0.0}),
        ("weight", {"weight": 0.0}),
        ("weight", {"weight": NAN}),
    ],
)
def test_invalid_value_is_refused_with_its_place(field: str, change: dict[str, float]) -> None:
    tests = [*TESTS[:3], replace(TESTS[3], **change)]  # type: ignore[arg-type]
    with pytest.raises(ParameterError) as refused:
        fit(tests)
    assert refused.value.field == f"tests.3.{field}"


def test_empty_list_of_tests_is_refused() -> None:
    with pytest.raises(ParameterError, match="tests: must be at least one"):
        fit([])


def test_one_test_gives_a_strength_factor_and_a_posterior_but_no_error() -> None:
    found = fit(TESTS[:1])
    assert found.residuals == pytest.approx([0.0], abs=1e-6)
    assert math.isnan(found.estimate.standard_error)
    assert all(map(math.isnan, found.estimate.confidence_interval))
    shot = Shot(velocity=TESTS[0].velocity, depth=TESTS[0].depth, mass=TESTS[0].mass)
    own = OwnTests(shots=(shot,)).posterior(**CASE)
    assert (found.posterior.median, found.posterior.scale) == (own.median, own.scale)
    assert found.posterior.degrees_of_freedom == 4.0


def test_two_tests_that_agree_leave_an_error() -> None:
    made = depths(8.0)[:2]
    found = fit([DepthTest(velocity=v, depth=float(z)) for v, z in zip(VELOCITIES[:2], made, strict=True)])
    assert found.root_mean_square < 1e-6
    assert found.estimate.degrees_of_freedom == 4.0
    assert found.estimate.standard_error == pytest.approx(0.041 * 8.0, rel=0.02)


def test_groups_must_be_given_for_all_tests_or_none() -> None:
    with pytest.raises(ParameterError) as refused:
        fit([replace(TESTS[0], group="a"), *TESTS[1:]])
    assert refused.value.field == "tests.1.group"


@pytest.mark.parametrize("factor", [100.0, 1e-3], ids=["centimetres", "kilometres"])
def test_depths_without_a_fitting_strength_factor_are_refused(factor: float) -> None:
    with pytest.raises(ParameterError, match=r"tests: must determine the strength factor"):
        fit([replace(test, depth=test.depth * factor) for test in TESTS])


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0, NAN])
def test_confidence_level_must_be_between_zero_and_one(level: float) -> None:
    with pytest.raises(ParameterError) as refused:
        fit(TESTS, confidence_level=level)
    assert refused.value.field == "confidence_level"


def test_invalid_arguments_of_curves_are_named() -> None:
    for field, arguments in {
        "velocities.1": {"velocities": [200.0, 0.0], "strength_factor": 8.0},
        "strength_factor": {"velocities": [200.0], "strength_factor": 0.0},
        "masses": {"velocities": [200.0], "strength_factor": 8.0, "masses": [13.0, 13.0]},
        "masses.0": {"velocities": [200.0], "strength_factor": 8.0, "masses": [-1.0]},
    }.items():
        with pytest.raises(ParameterError) as refused:
            penetration_depths(**CASE, **arguments)  # type: ignore[arg-type]
        assert refused.value.field == field
