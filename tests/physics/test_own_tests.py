"""Strength factor from one's own shots, with the published tests as prior: the posterior, its limits, its use."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

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
from solver.uncertainty import Lognormal

from .strikes import CASE, known, paper_run

TABLE_1 = [(238.1, 0.30, 12.923), (275.7, 0.38, 12.900), (314.0, 0.45, 12.910), (369.5, 0.53, 12.914)]
"""Velocity, depth and mass of the shots of the paper. [m/s, m, kg]"""
SHOTS = tuple(Shot(velocity=velocity, depth=depth, mass=mass) for velocity, depth, mass in TABLE_1)
BETWEEN, WITHIN = PublishedTests.between_series, PublishedTests.within_series


def posterior_of(shots: Sequence[Shot]) -> StrengthPosterior:
    return OwnTests(shots=tuple(shots)).posterior(**CASE)


def shot_of(factor: float, *, velocity: float = 300.0) -> Shot:
    """A shot of the paper's projectile that goes as deep as a strength factor says."""
    (depth,) = penetration_depths(**CASE, velocities=[velocity], strength_factor=factor)
    return Shot(velocity=velocity, depth=float(depth))


def by_grid(shots: Sequence[Shot]) -> tuple[float, float]:
    """Median and dispersion of the next S by integration over a grid of ln S of the series, from Bayes' rule."""
    prior = math.log(PublishedTests().polynomial(**CASE)[0])
    values = [
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
    grid = np.linspace(prior - 8.0 * BETWEEN, prior + 8.0 * BETWEEN, 20_001)
    density = np.exp(
        -0.5 * ((grid - prior) / BETWEEN) ** 2 - 0.5 * sum(((value - grid) / WITHIN) ** 2 for value in values)
    )
    density /= density.sum()
    mean = float(grid @ density)
    return math.exp(mean), math.sqrt(float((grid - mean) ** 2 @ density) + WITHIN**2)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_posterior_is_that_of_an_integration_over_a_grid(count: int) -> None:
    found = posterior_of(SHOTS[:count])
    assert (found.median, found.dispersion) == pytest.approx(by_grid(SHOTS[:count]), rel=0.01)


def test_posterior_does_not_depend_on_the_order_of_the_shots() -> None:
    forward, backward = posterior_of(SHOTS), posterior_of(SHOTS[::-1])
    assert (backward.median, backward.dispersion) == pytest.approx((forward.median, forward.dispersion), rel=1e-12)


def test_without_shots_the_law_of_the_published_tests_holds() -> None:
    found = posterior_of(SHOTS[:1])
    assert found.prior_median == PublishedTests().polynomial(**CASE)[0]
    assert found.prior_dispersion == pytest.approx(math.hypot(BETWEEN, WITHIN))
    assert found.dispersion < 0.7 * found.prior_dispersion


def test_papers_own_shots_give_its_strength_factor_within_a_narrow_range() -> None:
    tests = [DepthTest(velocity=velocity, depth=depth, mass=mass) for velocity, depth, mass in TABLE_1]
    found = fit_depth(**CASE, tests=tests).posterior
    assert isinstance(found, Lognormal)
    assert found.median is not None
    assert found.dispersion is not None
    assert 8.0 <= found.median <= 8.8
    assert found.dispersion <= 0.12
    own = posterior_of(SHOTS)
    assert (found.median, found.dispersion) == (own.median, own.dispersion)


def test_identical_shots_leave_the_scatter_within_a_series() -> None:
    twelve = posterior_of([SHOTS[0]] * 12)
    thousand = posterior_of([SHOTS[0]] * 1000)
    assert WITHIN < thousand.dispersion < twelve.dispersion < 1.06 * WITHIN
    assert thousand.median == pytest.approx(thousand.factors[0], rel=1e-3)


@pytest.mark.parametrize("nose", [PAPER_PROJECTILE.nose, Profile(points=((0.0, 0.0), (0.1, 0.03), (0.16, 0.04)))])
def test_shots_of_another_diameter_are_carried_by_the_exponent_of_the_law(nose: Any) -> None:
    """A model of half the size at the same speed goes half as deep in concrete of the same S."""
    projectile = replace(PAPER_PROJECTILE, nose=nose)
    full = Shot(velocity=300.0, depth=0.4)
    half = Shot(velocity=300.0, depth=0.2, mass=PAPER_PROJECTILE.mass / 8.0, diameter=0.04)
    found = OwnTests(shots=(full, half)).posterior(projectile=projectile, target=PAPER_TARGET)
    assert found.factors[1] == pytest.approx(found.factors[0] * 2.0**PublishedTests.law.diameter_exponent, rel=1e-6)


def test_mass_properties_of_the_strike_do_not_count_for_shots_of_another_size() -> None:
    body = replace(PAPER_PROJECTILE, center_of_gravity=0.5, moment_of_inertia=0.2)
    small = OwnTests(shots=(Shot(velocity=300.0, depth=0.2, mass=1.6, diameter=0.04),))
    plain = small.posterior(**CASE)
    assert small.posterior(projectile=body, target=PAPER_TARGET) == plain


def test_strike_takes_the_median_and_follows_eq_9_over_the_angle_unless_constant() -> None:
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
def test_shots_are_read_with_the_inertia_and_the_crater_of_the_strike(other: dict[str, Any]) -> None:
    """So that a normal strike like the shots goes as deep as they did, but for the pull of the prior."""
    law = OwnTests(shots=(SHOTS[0],) * 1000)
    run = simulate(
        projectile=replace(PAPER_PROJECTILE, mass=12.923),
        target=PAPER_TARGET,
        impact=replace(paper_impact(oblique_angle_degrees=0.0), velocity=238.1),
        resistance=Resistance(strength_factor=law, **other),
        sample_interval=None,
    )
    assert run.maximum_depth == pytest.approx(0.30, rel=5e-3)


def test_search_and_limit_speed_take_own_tests() -> None:
    law = Resistance(strength_factor=OwnTests(shots=SHOTS))
    found = critical_angle(**CASE, velocity=PAPER_VELOCITY, resistance=law)
    assert math.degrees(known(found.angle)) == pytest.approx(48.6, abs=0.5)
    wall = replace(PAPER_TARGET, thickness=0.2)  # thinner than the shots are deep: they were fired into a thick block
    limit = limit_velocity(projectile=PAPER_PROJECTILE, target=wall, oblique_angle=0.0, resistance=law).value
    assert limit == pytest.approx(214.2, rel=0.03)


def codes_of(shots: Sequence[Shot]) -> dict[str, str]:
    law = Resistance(strength_factor=OwnTests(shots=tuple(shots)))
    run = paper_run(0.0, resistance=law, sample_interval=None)
    return {each.code: each.detail for each in run.warnings}


def test_shot_three_dispersions_off_is_warned_of_and_named() -> None:
    usual = [shot_of(8.0), shot_of(8.4), shot_of(7.6)]
    assert "own_tests_apart" not in codes_of(usual)
    (detail,) = [text for code, text in codes_of([*usual, shot_of(13.0)]).items() if code == "own_tests_apart"]
    assert "shot 4 (S 13, " in detail
    assert "above" in detail
    assert detail.count("shot ") == 1
    alone = PublishedTests().polynomial(**CASE)[0]
    just_below, just_above = (alone * math.exp(by * math.hypot(BETWEEN, WITHIN)) for by in (2.9, 3.1))
    assert "own_tests_apart" not in codes_of([shot_of(just_below)])
    assert "own_tests_apart" in codes_of([shot_of(just_above)])


def test_fit_of_depths_warns_of_the_same_shot() -> None:
    tests = [DepthTest(velocity=shot.velocity, depth=shot.depth) for shot in (*map(shot_of, (8.0, 8.4, 7.6, 13.0)),)]
    assert "own_tests_apart" in {each.code for each in fit_depth(**CASE, tests=tests).warnings}


@pytest.mark.parametrize(
    ("field", "shots"),
    [
        ("strength_factor.shots: must hold 1 to 1,000 shots, got 0", ()),
        ("strength_factor.shots: must hold 1 to 1,000 shots, got 1,001", (SHOTS[0],) * 1001),
        ("shots.1.depth", (SHOTS[0], Shot(velocity=300.0, depth=0.0))),
        ("shots.0.depth", (Shot(velocity=300.0, depth=math.nan),)),
        ("shots.0.velocity", (Shot(velocity=-1.0, depth=0.3),)),
        ("shots.0.mass", (Shot(velocity=300.0, depth=0.3, mass=0.0),)),
        ("shots.0.diameter", (Shot(velocity=300.0, depth=0.3, diameter=math.inf),)),
        ("shots.0", ((300.0, 0.3),)),
    ],
)
def test_bad_shots_are_refused_by_name(field: str, shots: Any) -> None:
    with pytest.raises(ParameterError, match=field):
        OwnTests(shots=shots)


def test_depth_that_no_strength_factor_gives_is_refused_by_the_name_of_the_shot() -> None:
    with pytest.raises(ParameterError, match=r"strength_factor\.shots\.1\.depth: of 90 m at 300 m/s"):
        posterior_of([SHOTS[0], Shot(velocity=300.0, depth=90.0)])


def test_perforated_target_shows_no_depth() -> None:
    tests = [DepthTest(velocity=velocity, depth=depth) for velocity, depth, _ in TABLE_1]
    with pytest.raises(ParameterError, match=r"tests\.2\.depth: must be less than the thickness"):
        fit_depth(projectile=PAPER_PROJECTILE, target=replace(PAPER_TARGET, thickness=0.4), tests=tests)
