"""The strength factor from a user's shots, with the published tests as prior: posterior, limits, warnings and use."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from solver import (
    Crater,
    ObliquityPolynomial,
    OwnTests,
    ParameterError,
    Profile,
    PublishedTests,
    Resistance,
    Shot,
    StrengthPosterior,
    critical_angle,
    limit_velocity,
    simulate,
    strength_factor,
    strength_factor_of_depth,
)
from solver.calibration import DepthTest, fit_depth, penetration_depths
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact
from solver.uncertainty import LogStudentT

from .strikes import CASE, known, paper_run

TABLE_1 = [(238.1, 0.30, 12.923), (275.7, 0.38, 12.900), (314.0, 0.45, 12.910), (369.5, 0.53, 12.914)]
"""Velocity, depth and mass of the shots in the paper's Table 1. [m/s, m, kg]"""
SHOTS = tuple(Shot(velocity=velocity, depth=depth, mass=mass) for velocity, depth, mass in TABLE_1)
BETWEEN, WITHIN = PublishedTests.between_series, PublishedTests.within_series
FREEDOM = PublishedTests.degrees_of_freedom


def posterior_of(shots: Sequence[Shot]) -> StrengthPosterior:
    return OwnTests(shots=tuple(shots)).posterior(**CASE)


def shot_of(factor: float, *, velocity: float = 300.0) -> Shot:
    """Return a shot of the paper's projectile, with the depth that the model gives for this strength factor."""
    (depth,) = penetration_depths(**CASE, velocities=[velocity], strength_factor=factor)
    return Shot(velocity=velocity, depth=float(depth))


def by_grid(shots: Sequence[Shot]) -> tuple[float, tuple[float, float]]:
    """Return the median of S of the next shot, and the 5 and 95 % quantiles of ln S.

    They are computed by Bayes' rule on a grid of mean and variance.
    """
    prior = math.log(PublishedTests().polynomial(**CASE)[0])
    values = np.array(
        [
            math.log(
                strength_factor_of_depth(
                    projectile=replace(PAPER_PROJECTILE, mass=shot.mass or PAPER_PROJECTILE.mass),
                    target=PAPER_TARGET,
                    velocity=shot.velocity,
                    depth=shot.depth,
                )
            )
            for shot in shots
        ]
    )
    # A scaled inverse chi-square variable is scale² times the degrees of freedom over a chi-square variable.
    levels = (np.arange(400) + 0.5) / 400
    deviations = WITHIN * np.sqrt(FREEDOM / stats.chi2(FREEDOM).ppf(levels))[:, None]
    steps = stats.norm.ppf((np.arange(800) + 0.5) / 800)
    series = prior + BETWEEN / WITHIN * deviations * steps
    density = np.prod([stats.norm.pdf(value, series, deviations) for value in values], axis=0)
    density /= density.sum()
    grid = np.linspace(prior - 1.5, prior + 1.5, 601)
    cumulative = np.array([float((density * stats.norm.cdf(each, series, deviations)).sum()) for each in grid])
    low, middle, high = np.interp((0.05, 0.5, 0.95), cumulative, grid).tolist()
    return math.exp(middle), (low, high)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_posterior_agrees_with_an_integration_over_a_grid(count: int) -> None:
    found = posterior_of(SHOTS[:count])
    median, ends = by_grid(SHOTS[:count])
    assert found.median == pytest.approx(median, rel=0.01)
    reference = stats.t(found.degrees_of_freedom, math.log(found.median), found.scale)
    assert reference.ppf((0.05, 0.95)) == pytest.approx(ends, abs=0.005)


def test_posterior_does_not_depend_on_the_order_of_the_shots() -> None:
    forward, backward = posterior_of(SHOTS), posterior_of(SHOTS[::-1])
    assert (backward.median, backward.dispersion) == pytest.approx((forward.median, forward.dispersion), rel=1e-12)


def test_posterior_without_shots_is_the_law_of_the_published_tests() -> None:
    found = posterior_of(SHOTS[:1])
    assert found.prior_median == PublishedTests().polynomial(**CASE)[0]
    assert found.prior_dispersion == pytest.approx(math.sqrt(3.0) * math.hypot(BETWEEN, WITHIN))
    assert found.dispersion < 0.3 * found.prior_dispersion


def test_shots_of_the_paper_give_its_strength_factor_within_a_narrow_range() -> None:
    tests = [DepthTest(velocity=velocity, depth=depth, mass=mass) for velocity, depth, mass in TABLE_1]
    found = fit_depth(**CASE, tests=tests).posterior
    assert isinstance(found, LogStudentT)
    assert 8.0 <= found.median <= 8.8
    assert found.dispersion <= 0.12
    own = posterior_of(SHOTS)
    assert (found.median, found.scale, found.degrees_of_freedom) == (own.median, own.scale, own.degrees_of_freedom)


def test_dispersion_grows_with_the_scatter_of_the_shots() -> None:
    """The standard deviation of ln S of the four shots is 0.23.

    Without a prior, the standard deviation for the next shot would be 1.12 times as large.
    """
    factors = (6.99, 10.49, 7.43, 10.93)
    scattered = posterior_of([shot_of(each) for each in factors])
    assert scattered.factors == pytest.approx(factors, rel=1e-3)
    assert 0.2 < scattered.dispersion < 0.26
    assert scattered.degrees_of_freedom == 7.0
    alike = posterior_of([shot_of(8.7)] * 4)
    assert alike.dispersion < 0.4 * scattered.dispersion


def test_shots_far_from_the_law_leave_a_wider_posterior() -> None:
    law = posterior_of(SHOTS[:1]).prior_median
    on, off = (posterior_of([shot_of(law * by)]).dispersion for by in (1.0, 2.5))
    assert off > 1.5 * on


def test_many_identical_shots_determine_the_strength_factor() -> None:
    twelve = posterior_of([SHOTS[0]] * 12)
    thousand = posterior_of([SHOTS[0]] * 1000)
    assert thousand.dispersion < 0.2 * twelve.dispersion < 0.2 * WITHIN
    assert thousand.median == pytest.approx(thousand.factors[0], rel=1e-3)


@pytest.mark.parametrize("nose", [PAPER_PROJECTILE.nose, Profile(points=((0.0, 0.0), (0.1, 0.03), (0.16, 0.04)))])
def test_shots_of_another_diameter_are_scaled_by_the_exponent_of_the_law(nose: Any) -> None:
    """A body of half the size goes half as deep at the same speed if S is the same."""
    projectile = replace(PAPER_PROJECTILE, nose=nose)
    full = Shot(velocity=300.0, depth=0.4)
    half = Shot(velocity=300.0, depth=0.2, mass=PAPER_PROJECTILE.mass / 8.0, diameter=0.04)
    found = OwnTests(shots=(full, half)).posterior(projectile=projectile, target=PAPER_TARGET)
    assert found.factors[1] == pytest.approx(found.factors[0] * 2.0**PublishedTests.law.diameter_exponent, rel=1e-6)


def test_shots_of_another_size_do_not_use_the_mass_properties_of_the_strike() -> None:
    body = replace(PAPER_PROJECTILE, center_of_gravity=0.5, moment_of_inertia=0.2)
    small = OwnTests(shots=(Shot(velocity=300.0, depth=0.2, mass=1.6, diameter=0.04),))
    plain = small.posterior(**CASE)
    assert small.posterior(projectile=body, target=PAPER_TARGET) == plain


def test_strike_uses_the_median_with_the_chosen_obliquity_shape() -> None:
    median, equation_9 = posterior_of(SHOTS).median, ObliquityPolynomial()
    for degrees in (0.0, 30.0):
        values = [
            strength_factor(resistance=Resistance(strength_factor=model), oblique_angle=math.radians(degrees), **CASE)
            for model in (OwnTests(shots=SHOTS), OwnTests(shots=SHOTS, obliquity_shape="constant"), equation_9)
        ]
        shape = values[2] / equation_9.coefficients[0]
        assert values[:2] == pytest.approx([median * shape, median], rel=1e-12)


@pytest.mark.parametrize(
    "other", [{"inertia_factor": 0.0}, {"inertia_factor": 1.5}, {"crater": Crater()}], ids=["B0", "B1.5", "crater"]
)
def test_shots_are_evaluated_with_the_inertia_and_crater_of_the_strike(other: dict[str, Any]) -> None:
    """A strike equal to the shots goes as deep as they did, apart from the influence of the prior."""
    law = OwnTests(shots=(SHOTS[0],) * 1000)
    run = simulate(
        projectile=replace(PAPER_PROJECTILE, mass=12.923),
        target=PAPER_TARGET,
        impact=replace(paper_impact(oblique_angle_degrees=0.0), velocity=238.1),
        resistance=Resistance(strength_factor=law, **other),
        sample_interval=None,
    )
    assert run.maximum_depth == pytest.approx(0.30, rel=5e-3)


def test_search_and_limit_speed_accept_own_tests() -> None:
    law = Resistance(strength_factor=OwnTests(shots=SHOTS))
    found = critical_angle(**CASE, velocity=PAPER_VELOCITY, resistance=law)
    assert math.degrees(known(found.angle)) == pytest.approx(48.6, abs=0.5)
    wall = replace(PAPER_TARGET, thickness=0.2)  # The wall is thinner than the depth of the shots.
    limit = limit_velocity(projectile=PAPER_PROJECTILE, target=wall, oblique_angle=0.0, resistance=law).value
    assert limit == pytest.approx(214.2, rel=0.03)


def codes_of(shots: Sequence[Shot]) -> dict[str, str]:
    law = Resistance(strength_factor=OwnTests(shots=tuple(shots)))
    run = paper_run(0.0, resistance=law, sample_interval=None)
    return {each.code: each.detail for each in run.warnings}


def test_outlying_shot_is_named_in_a_warning() -> None:
    usual = [shot_of(8.0), shot_of(8.4), shot_of(7.6)]
    assert "own_tests_apart" not in codes_of(usual)
    (detail,) = [text for code, text in codes_of([*usual, shot_of(13.0)]).items() if code == "own_tests_apart"]
    assert "shot 4 (S 13, " in detail
    assert "above" in detail
    assert detail.count("shot ") == 1
    alone = PublishedTests().polynomial(**CASE)[0]
    dispersion = posterior_of(SHOTS).prior_dispersion
    just_below, just_above = (alone * math.exp(by * dispersion) for by in (2.45, 2.55))
    assert "own_tests_apart" not in codes_of([shot_of(just_below)])
    assert "own_tests_apart" in codes_of([shot_of(just_above)])


def test_shots_within_the_front_crater_cause_a_warning() -> None:
    """The crater is two diameters deep: 160 mm for the paper's projectile, 80 mm for one of half its size."""
    deep, shallow = Shot(velocity=238.0, depth=0.17), Shot(velocity=150.0, depth=0.15)
    small = Shot(velocity=238.0, depth=0.15, mass=1.6, diameter=0.04)
    assert "shallow_tests" not in codes_of([deep, small])
    assert "1 of 3 tests, the first of them number 3" in codes_of([deep, small, shallow])["shallow_tests"]


@pytest.mark.parametrize(
    ("shot", "slip"),
    [
        (Shot(velocity=238.0, depth=30.0), "centimetres given as metres: with a depth of 0.3 m it is 7.63"),
        (Shot(velocity=238.0, depth=11.81), "inches given as metres: with a depth of 0.3 m"),
        (Shot(velocity=238.0, depth=0.0003), "metres given as millimetres: with a depth of 0.3 m"),
        (Shot(velocity=0.238, depth=0.3), "km/s given as m/s: with a velocity of 238 m/s"),
        (Shot(velocity=780.0, depth=0.3), "ft/s given as m/s: with a velocity of 237.7 m/s"),
        (Shot(velocity=238.0, depth=0.3, mass=13000.0), "grams given as kilograms: with a mass of 13 kg"),
        (Shot(velocity=238.0, depth=0.03), "compare speed, depth, mass, diameter and strength"),
    ],
)
def test_unexplainable_shot_is_refused_with_the_likely_mistake(shot: Shot, slip: str) -> None:
    with pytest.raises(ParameterError) as refused:
        posterior_of([SHOTS[0], shot])
    assert refused.value.field == "resistance.strength_factor.shots.1.depth"
    assert "must be between 2 and 60" in refused.value.requirement
    assert slip in refused.value.requirement


def test_millimetres_given_as_metres_are_recognised() -> None:
    """A depth of 30 mm is given as 30 m; a number above 100 would exceed the bound on the depth."""
    body = replace(PAPER_PROJECTILE, diameter=0.005, length=0.033, mass=0.003)
    with pytest.raises(ParameterError, match=r"millimetres given as metres: with a depth of 0\.03 m"):
        OwnTests(shots=(Shot(velocity=300.0, depth=30.0),)).posterior(projectile=body, target=PAPER_TARGET)


def test_fit_of_depths_warns_about_the_same_shot() -> None:
    tests = [DepthTest(velocity=shot.velocity, depth=shot.depth) for shot in (*map(shot_of, (8.0, 8.4, 7.6, 13.0)),)]
    assert "own_tests_apart" in {each.code for each in fit_depth(**CASE, tests=tests).warnings}


@pytest.mark.parametrize(
    ("field", "shots"),
    [
        ("strength_factor.shots: must hold 1 to 1000 shots, got 0", ()),
        ("strength_factor.shots: must hold 1 to 1000 shots, got 1001", (SHOTS[0],) * 1001),
        ("shots.1.depth", (SHOTS[0], Shot(velocity=300.0, depth=0.0))),
        ("shots.0.depth", (Shot(velocity=300.0, depth=math.nan),)),
        ("shots.0.velocity", (Shot(velocity=-1.0, depth=0.3),)),
        ("shots.0.mass", (Shot(velocity=300.0, depth=0.3, mass=0.0),)),
        ("shots.0.diameter", (Shot(velocity=300.0, depth=0.3, diameter=math.inf),)),
        ("shots.0", ((300.0, 0.3),)),
    ],
)
def test_invalid_shots_are_refused_by_name(field: str, shots: Any) -> None:
    with pytest.raises(ParameterError, match=field):
        OwnTests(shots=shots)


def test_impossible_depth_is_refused_with_the_name_of_the_shot() -> None:
    with pytest.raises(ParameterError, match=r"strength_factor\.shots\.1\.depth: of 90 m at 300 m/s"):
        posterior_of([SHOTS[0], Shot(velocity=300.0, depth=90.0)])


def test_depth_beyond_the_thickness_of_the_target_is_refused() -> None:
    tests = [DepthTest(velocity=velocity, depth=depth) for velocity, depth, _ in TABLE_1]
    with pytest.raises(ParameterError, match=r"tests\.2\.depth: must be less than the thickness"):
        fit_depth(projectile=PAPER_PROJECTILE, target=replace(PAPER_TARGET, thickness=0.4), tests=tests)
