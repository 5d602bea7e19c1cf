"""The usual scatter of a strike and the words of a verdict."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from solver import (
    ConstantStrengthFactor,
    ElasticPlastic,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    ObliquityPolynomial,
    Outcome,
    OwnTests,
    PublishedTests,
    Resistance,
    SearchStatus,
    StrengthPowerLaw,
    Target,
    critical_angle,
)
from solver.resistance import strength_factor
from solver.strength_scatter import TABLE_1, strength_scatter
from solver.strike import PAPER_PROJECTILE, PAPER_VELOCITY
from solver.uncertainty import Discrete, Lognormal, Verdict, usual_scatter, verdict
from tests.physics.strikes import CASE, known

OTHER: dict[str, Any] = CASE | {"target": Target(compressive_strength=40e6, density=2250.0)}
LAW = math.hypot(PublishedTests.between_series, PublishedTests.within_series)


@pytest.mark.parametrize(
    ("case", "model", "dispersion"),
    [
        (OTHER, PublishedTests(), LAW),
        (OTHER, ObliquityPolynomial(), LAW),
        (OTHER, StrengthPowerLaw(), LAW),
        (CASE, ObliquityPolynomial(coefficients=(8.5,)), LAW),
        (CASE, ObliquityPolynomial(), TABLE_1.posterior(**CASE).dispersion),
        (OTHER, TABLE_1, TABLE_1.posterior(**OTHER).dispersion),
        (OTHER, OwnTests(shots=TABLE_1.shots[:1]), OwnTests(shots=TABLE_1.shots[:1]).posterior(**OTHER).dispersion),
    ],
)
def test_strength_factor_scatters_as_its_tests_do_and_strength_is_not_counted_twice(
    case: dict[str, Any], model: Any, dispersion: float
) -> None:
    resistance = Resistance(strength_factor=model)
    found = strength_scatter(**case, resistance=resistance)
    assert found.dispersion == pytest.approx(dispersion)
    stronger = replace(case["target"], compressive_strength=case["target"].compressive_strength * math.exp(0.12))
    here, there = (
        each.compressive_strength * resistance.strength_polynomial(target=each, projectile=PAPER_PROJECTILE)[0]
        for each in (case["target"], stronger)
    )
    by_strength = math.log(there / here) * found.strength / 0.12
    assert math.hypot(by_strength, found.residual) == pytest.approx(dispersion, rel=1e-3)


def test_no_decay_is_in_no_range() -> None:
    resistance = Resistance(free_surface=NoFreeSurface())
    *_, strength_factor, theory = usual_scatter(**CASE, velocity=PAPER_VELOCITY, resistance=resistance)
    assert isinstance(strength_factor.distribution, Lognormal)
    assert isinstance(theory.distribution, Discrete)
    assert list(theory.distribution.values) == [ElasticPlastic(), MohrCoulomb()]


@cache
def verdict_of(velocity: float, **changes: Any) -> Verdict:
    return verdict(**CASE, velocity=velocity, threads=2, **changes)


@pytest.mark.parametrize(
    ("velocity", "special"), [(238.0, set()), (60.0, {"retention_decides"}), (500.0, {"strength_fit_extrapolated"})]
)
def test_warning_stands_alone_if_it_moves_the_angle_by_more_than_a_quarter_of_the_range(
    velocity: float, special: set[str]
) -> None:
    strike = CASE | {"velocity": velocity}
    found = verdict_of(velocity)
    assert found.angle is not None
    assert found.spread is not None
    assert {each.code for each in found.warnings if not each.standing} == special
    shifts = {each.code: each.angle_shift for each in found.warnings if each.angle_shift is not None}
    for code, shift in shifts.items():
        assert (abs(shift) > 0.25 * (found.spread[1] - found.spread[0])) is (code in special)
    if "retention_decides" in shifts:
        angles = [
            critical_angle(**strike, numerics=Numerics(retention_energy_fraction=each)).angle for each in (1e-3, 0.1)
        ]
        assert shifts["retention_decides"] == max((each - found.angle for each in angles if each), key=abs)
    if "strength_fit_extrapolated" in shifts:
        held = strength_factor(**CASE, resistance=Resistance(), oblique_angle=ObliquityPolynomial.fitted_to)
        constant = Resistance(strength_factor=ConstantStrengthFactor(value=held))
        angle = critical_angle(**strike, resistance=constant).angle
        assert shifts["strength_fit_extrapolated"] == known(angle) - found.angle


def test_range_is_wide_by_the_law_and_narrow_with_shots_into_the_concrete() -> None:
    def width(**changes: Any) -> float:
        found = verdict_of(PAPER_VELOCITY, **changes)
        assert found.spread is not None
        assert found.spread[0] < known(found.angle) < found.spread[1]
        return math.degrees(found.spread[1] - found.spread[0])

    preset = width()
    published, one, four = (
        width(resistance=Resistance(strength_factor=model))
        for model in (PublishedTests(), OwnTests(shots=TABLE_1.shots[:1]), TABLE_1)
    )
    assert published > 1.2 * one > 1.2 * four
    assert preset == pytest.approx(four, rel=0.15)


SEEN = Verdict(
    status=SearchStatus.CONVERGED,
    angle=math.radians(48.634),
    searched=(math.radians(5.0), math.radians(85.0)),
    spread=(math.radians(42.2), math.radians(60.1)),
    share_without=0.0,
    theories=(),
)
FIRST = "Critical angle 48.6° from the normal, 90 % range 42° to 60°"
THEORY = "elastic-plastic decay (weight 0.8)"
LAST = "the outcome also changes at 70.0°"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, f"{FIRST}."),
        (
            {"spread": (math.radians(48.0), math.radians(50.01))},
            "Critical angle 48.63° from the normal, 90 % range 48.0° to 50.0°.",
        ),
        ({"spread": None}, "Critical angle 48.63° from the normal."),
        (
            {"oblique_angle": math.radians(50.0), "outcome": Outcome.EMBEDDED, "probability": 0.2},
            f"At 50° from the normal: embedded (probability of ricochet 0.20). {FIRST}.",
        ),
        (
            {"share_without": 0.25, "theories": (math.radians(48.634), None), "other_crossings": (math.radians(70.0),)},
            f"{FIRST}, 25 % of the samples without one from 5° to 85°; {THEORY} 48.6°; {LAST}.",
        ),
        (
            {"status": SearchStatus.NO_RICOCHET, "angle": None, "spread": None},
            "No critical angle: nothing from 5° to 85° is turned away.",
        ),
    ],
)
def test_decimals_follow_the_range_and_nothing_is_left_unsaid(changes: dict[str, Any], sentence: str) -> None:
    assert str(replace(SEEN, **changes)) == sentence
