"""Laws of the strength factor: values, range of their fits, and warnings about them."""

import math
from dataclasses import replace
from typing import Any

import pytest

import solver
from solver import (
    Conical,
    ConstantStrengthFactor,
    Crater,
    Flat,
    ObliquityPolynomial,
    Ogive,
    Profile,
    PublishedTests,
    Resistance,
    Search,
    Spherical,
    StrengthPowerLaw,
    critical_angle,
    simulate,
    strength_factor_of_depth,
)
from solver.calibration import penetration_depths
from solver.resistance import StrengthFactor, strength_factor
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import CASE, codes, known, paper_run


def value_of(model: StrengthFactor, *, strength: float = 39e6, diameter: float = 0.08, degrees: float = 0.0) -> float:
    return strength_factor(
        resistance=Resistance(strength_factor=model),
        oblique_angle=math.radians(degrees),
        target=replace(PAPER_TARGET, compressive_strength=strength),
        projectile=replace(PAPER_PROJECTILE, diameter=diameter),
    )


def test_strength_power_law_uses_megapascals() -> None:
    for coefficient, exponent in ((82.6, -0.544), (72.0, -0.5)):
        model = StrengthPowerLaw(coefficient=coefficient, exponent=exponent)
        for strength in (20e6, 39e6, 97e6):
            for diameter in (0.0269, 0.08):
                expected = coefficient * (strength / 1e6) ** exponent
                assert value_of(model, strength=strength, diameter=diameter, degrees=40.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("strength", "diameter", "expected"),
    [(39e6, 0.0762, 8.84), (23e6, 0.0762, 9.72149), (39e6, 0.0269, 11.34961), (100e6, 0.0203, 10.24977)],
)
def test_law_of_published_tests_depends_on_strength_and_diameter(
    strength: float, diameter: float, expected: float
) -> None:
    written_out = StrengthPowerLaw(
        coefficient=8.84, exponent=-0.18, reference_strength=39e6, diameter_exponent=-0.24, reference_diameter=0.0762
    )
    for model in (written_out, PublishedTests()):
        assert value_of(model, strength=strength, diameter=diameter) == pytest.approx(expected, rel=1e-5)


def test_shape_of_equation_9_multiplies_any_law() -> None:
    equation_9 = ObliquityPolynomial()
    for law in (StrengthPowerLaw(), StrengthPowerLaw(diameter_exponent=-0.42), PublishedTests()):
        constant = replace(law, obliquity_shape="constant")
        shaped = replace(law, obliquity_shape="equation_9")
        for degrees in (0.0, 15.0, 45.0, 60.0):
            shape = value_of(equation_9, degrees=degrees) / value_of(equation_9)
            assert value_of(constant, degrees=degrees) == value_of(law)
            assert value_of(shaped, degrees=degrees) == pytest.approx(value_of(law) * shape, rel=1e-14)


def test_law_scaled_to_equation_9_gives_its_critical_angle() -> None:
    scaled = StrengthPowerLaw(coefficient=8.469, exponent=0.0, obliquity_shape="equation_9")
    case = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET, "velocity": PAPER_VELOCITY}
    by_law = critical_angle(**case, resistance=Resistance(strength_factor=scaled))  # type: ignore[arg-type]
    by_polynomial = critical_angle(**case)  # type: ignore[arg-type]
    assert by_law.angle == pytest.approx(by_polynomial.angle, abs=math.radians(1e-6))


@pytest.mark.parametrize("crater", [None, Crater(), Crater(depth_diameters=8.0)])
@pytest.mark.parametrize("inertia_factor", [0.0, 1.0, 2.0])
@pytest.mark.parametrize(
    "nose",
    [
        Ogive(caliber_radius_head=3.0),
        Conical(length_to_diameter=1.2),
        Spherical(caliber_radius_head=0.5),
        Flat(),
        Profile(points=((0.0, 0.01), (0.05, 0.03), (0.12, 0.04))),
    ],
)
def test_strength_factor_fitted_to_a_depth_reproduces_it(
    nose: Any, inertia_factor: float, crater: Crater | None
) -> None:
    projectile = replace(PAPER_PROJECTILE, nose=nose)
    law = Resistance(inertia_factor=inertia_factor, crater=crater)
    for velocity, factor in ((120.0, 5.0), (238.0, 8.5), (700.0, 14.0)):
        (depth,) = penetration_depths(
            projectile=projectile, target=PAPER_TARGET, velocities=[velocity], strength_factor=factor, resistance=law
        )
        found = strength_factor_of_depth(
            projectile=projectile,
            target=PAPER_TARGET,
            velocity=velocity,
            depth=float(depth),
            inertia_factor=inertia_factor,
            crater=crater,
        )
        assert found == pytest.approx(factor, rel=1e-3)


@pytest.mark.parametrize(("name", "value"), [("depth", 0.0), ("depth", math.nan), ("velocity", -1.0), ("depth", 1e9)])
def test_strength_factor_of_an_impossible_depth_is_refused(name: str, value: float) -> None:
    shot: dict[str, Any] = {"velocity": 238.0, "depth": 0.3} | {name: value}
    with pytest.raises(solver.ParameterError, match=name):
        strength_factor_of_depth(**CASE, **shot)


def test_answers_state_the_strength_factor_they_used() -> None:
    impact = paper_impact(oblique_angle_degrees=30.0)
    case = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
    for model in (ObliquityPolynomial(), ConstantStrengthFactor(value=7.0), StrengthPowerLaw(), PublishedTests()):
        resistance = Resistance(strength_factor=model)
        run = simulate(**case, impact=impact, resistance=resistance, sample_interval=None)  # type: ignore[arg-type]
        assert run.strength_factor == pytest.approx(value_of(model, degrees=30.0), rel=1e-12)
        found = critical_angle(**case, velocity=PAPER_VELOCITY, resistance=resistance)  # type: ignore[arg-type]
        expected = value_of(model, degrees=math.degrees(known(found.angle)))
        assert found.strength_factor == pytest.approx(expected, rel=1e-12)


def test_search_without_an_angle_has_no_strength_factor() -> None:
    answers = [
        critical_angle(
            **CASE, velocity=PAPER_VELOCITY, search=Search(lower=math.radians(10.0), upper=math.radians(upper))
        )
        for upper in (20.0, 60.0)
    ]
    assert (answers[0].angle, answers[0].strength_factor) == (None, None)
    column = solver.columns(answers)["strength_factor"]
    assert math.isnan(column[0])
    assert column[1] == answers[1].strength_factor


def warnings_of(
    model: StrengthFactor, *, strength: float = 39e6, diameter: float = 0.08, velocity: float = PAPER_VELOCITY
) -> dict[str, str]:
    """Return the warnings about the strength factor; check that a trajectory and a search have the same."""
    case: dict[str, Any] = {
        "projectile": replace(PAPER_PROJECTILE, diameter=diameter),
        "target": replace(PAPER_TARGET, compressive_strength=strength),
        "resistance": Resistance(strength_factor=model),
    }
    impact = replace(paper_impact(oblique_angle_degrees=30.0), velocity=velocity)
    search = Search(lower=math.radians(10.0), upper=math.radians(20.0))
    found = [
        {
            each.code: each.detail
            for each in answer.warnings
            if each.code in ("strength_factor_of_other_concrete", "published_tests_extrapolated")
        }
        for answer in (
            simulate(**case, impact=impact, sample_interval=None),
            critical_angle(**case, velocity=velocity, search=search),
        )
    ]
    assert found[0] == found[1]
    return found[0]


@pytest.mark.parametrize(
    ("strength", "diameter", "warned"),
    [
        (39e6, 0.08, False),
        (35.1e6, 0.06, False),
        (42.9e6, 0.1, False),
        (35.0e6, 0.08, True),
        (43.0e6, 0.08, True),
        (39e6, 0.0595, True),
        (39e6, 0.1005, True),
    ],
)
def test_equation_9_for_other_concrete_or_size_causes_a_warning(strength: float, diameter: float, warned: bool) -> None:
    assert (
        "strength_factor_of_other_concrete" in warnings_of(ObliquityPolynomial(), strength=strength, diameter=diameter)
    ) is warned


def test_warning_states_the_value_of_the_other_law() -> None:
    detail = warnings_of(ObliquityPolynomial(), strength=97e6, diameter=0.0269)["strength_factor_of_other_concrete"]
    other = value_of(PublishedTests(), strength=97e6, diameter=0.0269)
    assert f"eq. 9 gives 8.47, the law published_tests {other:.3g}" in detail


def test_other_strength_factors_are_not_mistaken_for_equation_9() -> None:
    for model in (ObliquityPolynomial(coefficients=(8.4,)), StrengthPowerLaw(), ConstantStrengthFactor(value=8.52)):
        assert not warnings_of(model, strength=97e6, diameter=0.0269)


def test_law_of_published_tests_warns_where_it_is_extrapolated() -> None:
    assert not warnings_of(PublishedTests(), strength=39e6, diameter=0.0762)
    outside = {"strength": 120e6, "diameter": 0.3, "velocity": 920.0}
    for name, value in outside.items():
        inside = {"diameter": 0.0762} | {name: value}
        (detail,) = warnings_of(PublishedTests(), **inside).values()
        assert detail.count("outside") == 1
    (detail,) = warnings_of(PublishedTests(), **outside).values()
    assert detail.count("outside") == 3


def test_shape_of_equation_9_is_extrapolated_beyond_45_degrees() -> None:
    for shape, warned in (("equation_9", True), ("constant", False)):
        resistance = Resistance(strength_factor=StrengthPowerLaw(obliquity_shape=shape))  # type: ignore[arg-type]
        run = paper_run(46.0, resistance=resistance, sample_interval=None)
        assert ("strength_fit_extrapolated" in codes(run)) is warned
