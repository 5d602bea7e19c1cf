"""The value of further shots: the range of the critical angle that a study predicts after one and three of them."""

import math
from collections.abc import Sequence
from typing import Any

import pytest
from scipy import stats

from solver import OwnTests, PublishedTests, Resistance, Shot
from solver.calibration import penetration_depths
from solver.strike import PAPER_VELOCITY
from solver.uncertainty import (
    RESIDUAL,
    AfterShots,
    AngleUncertainty,
    Lognormal,
    LogStudentT,
    Normal,
    Sampling,
    Uncertain,
    Uniform,
    critical_angle_uncertainty,
    usual_scatter,
)
from solver.uncertainty.verdict import next_shot_advice
from tests.physics.strikes import CASE

STRIKE: dict[str, Any] = CASE | {"velocity": PAPER_VELOCITY}
LAW = Resistance(strength_factor=PublishedTests())
BETWEEN, WITHIN = PublishedTests.between_series, PublishedTests.within_series
STRENGTH = 0.05
SHARE = (1.0 - 0.18) * STRENGTH
"""Standard deviation of ln(S f'c) that the scatter of the strength causes; S is proportional to strength^-0.18. [1]"""


def study(uncertain: Sequence[Uncertain], law: Resistance = LAW, method: str = "auto") -> AngleUncertainty:
    sampling = Sampling(max_samples=1024, method=method)
    return critical_angle_uncertainty(**STRIKE, resistance=law, uncertain=uncertain, sampling=sampling, threads=2)


def after_shots(found: AngleUncertainty) -> tuple[AfterShots, ...]:
    return next((each.after_shots for each in found.sensitivity if each.field == RESIDUAL), ())


def range_of(found: AngleUncertainty) -> tuple[float, float]:
    levels = dict(found.quantiles)
    return levels[0.05].value, levels[0.95].value


@pytest.fixture(scope="module")
def usual() -> AngleUncertainty:
    return study(usual_scatter(**STRIKE, resistance=LAW))


def test_more_shots_narrow_the_range_more(usual: AngleUncertainty) -> None:
    one, three = after_shots(usual)
    lower, upper = range_of(usual)
    assert (one.shots, three.shots) == (1, 3)
    assert upper - lower > 1.2 * (one.upper - one.lower)
    assert one.upper - one.lower > three.upper - three.lower


@pytest.mark.parametrize("place", [0, 1])
def test_dispersion_equals_the_posterior_after_as_many_shots(usual: AngleUncertainty, place: int) -> None:
    """All n shots have one S, which differs from the law by √n standard deviations of the mean of n shots."""
    expected = after_shots(usual)[place]
    distance = math.hypot(math.sqrt(expected.shots) * BETWEEN, WITHIN)
    factor = PublishedTests().polynomial(**CASE)[0] * math.exp(distance)
    (depth,) = penetration_depths(**CASE, velocities=[300.0], strength_factor=factor)
    fired = OwnTests(shots=(Shot(velocity=300.0, depth=float(depth)),) * expected.shots)
    assert expected.dispersion == pytest.approx(fired.posterior(**CASE).dispersion, rel=1e-3)


@pytest.mark.parametrize("method", ["auto", "direct"])
@pytest.mark.parametrize("tails", ["normal", "heavy"])
def test_range_equals_a_study_with_the_posterior_dispersion(method: str, tails: str) -> None:
    def inputs(scale: float, shots: int) -> list[Uncertain]:
        freedom = 3.0 + shots
        ratio = 1.0 if tails == "normal" else stats.t(freedom).ppf(0.95) / 1.645
        left = math.sqrt((scale * ratio) ** 2 - SHARE**2) / ratio
        heavy = LogStudentT(median=1.0, scale=left, degrees_of_freedom=freedom, lower=0.25, upper=7.0)
        factor = Lognormal(median=1.0, dispersion=left) if tails == "normal" else heavy
        return [
            Uncertain("target.compressive_strength", Lognormal(median=39e6, dispersion=STRENGTH)),
            Uncertain("impact.angle_of_attack", Normal(mean=0.0, standard_deviation=math.radians(1.0))),
            Uncertain(RESIDUAL, factor),
        ]

    found = study(inputs(math.hypot(BETWEEN, WITHIN), 0), method=method)
    posterior = math.sqrt(1.0 / (1.0 / BETWEEN**2 + 1.0 / WITHIN**2) + WITHIN**2)
    expected = after_shots(found)[0]
    assert (expected.lower, expected.upper) == pytest.approx(
        range_of(study(inputs(posterior, 1), method=method)), abs=math.radians(0.1 if method == "auto" else 0.4)
    )


def test_shots_into_known_concrete_change_little() -> None:
    found = study(usual_scatter(**STRIKE, strength_scatter="paper_table_1"))
    lower, upper = range_of(found)
    for each in after_shots(found):
        assert each.upper - each.lower == pytest.approx(upper - lower, rel=0.1)
    assert "would hardly narrow it" in next_shot_advice((lower, upper), after_shots(found))


def test_advice_states_the_ranges_after_one_and_three_shots(usual: AngleUncertainty) -> None:
    assert next_shot_advice(range_of(usual), after_shots(usual)) == (
        "The 90 % range of the critical angle is 44° to 56°; with shots of your own into this concrete it is expected "
        "to be 46° to 51° after one and 46° to 51° after three."
    )


@pytest.mark.parametrize(
    "uncertain",
    [
        Uncertain("impact.velocity", Normal(mean=238.0, standard_deviation=2.0)),
        Uncertain(RESIDUAL, Uniform(lower=0.9, upper=1.1)),
    ],
)
def test_value_of_shots_is_omitted_without_a_lognormal_factor(uncertain: Uncertain) -> None:
    assert after_shots(study([uncertain])) == ()


def test_scatter_smaller_than_within_a_series_is_not_reduced() -> None:
    found = study([Uncertain(RESIDUAL, Lognormal(median=1.0, dispersion=0.5 * WITHIN))])
    for each in after_shots(found):
        assert each.dispersion == pytest.approx(0.5 * WITHIN, rel=1e-6)
        assert (each.lower, each.upper) == pytest.approx(range_of(found), abs=1e-9)


def test_shots_narrow_the_range_even_if_strength_scatters_most() -> None:
    wide = [
        Uncertain("target.compressive_strength", Lognormal(median=39e6, dispersion=0.4)),
        Uncertain(RESIDUAL, Lognormal(median=1.0, dispersion=0.05)),
    ]
    found = study(wide)
    one, _ = after_shots(found)
    lower, upper = range_of(found)
    assert one.upper - one.lower < 0.6 * (upper - lower)
