"""Laws with the shape of eq. 9 keep S constant from 60° on, the end of the paper's search range."""

import math
from typing import Any

import pytest

from solver import (
    ConstantStrengthFactor,
    Flat,
    Impact,
    Numerics,
    ObliquityPolynomial,
    OwnTests,
    ParameterError,
    Projectile,
    PublishedTests,
    Resistance,
    Search,
    SearchStatus,
    Shot,
    StrengthPowerLaw,
    critical_angle,
    simulate,
    strength_factor,
)
from solver.resistance import EQUATION_9_COEFFICIENTS, StrengthFactor
from solver.strike import PAPER_VELOCITY, paper_impact
from solver.uncertainty.strikes import scaled

from .strikes import CASE, codes, known

HELD_AT_60 = {238: 48.63, 300: 53.69, 400: 61.82, 500: 66.24, 600: 69.29, 700: 71.44, 800: 72.97}
"""Critical angle of the paper's body for each speed, by an independent program, if eq. 9 is held from 60° on at 4.683.
The next tables are for eq. 9 held from 55° on at S = 5.356, and not held. [m/s, °]"""
HELD_AT_55 = {400: 60.38, 500: 64.98, 600: 68.23, 700: 70.55, 800: 72.24}
NOT_HELD = {400: 62.75, 500: 69.26, 600: 72.96, 700: 74.80, 800: 75.51}
TABLE = [(60.0, *row) for row in HELD_AT_60.items()] + [(55.0, *row) for row in HELD_AT_55.items()]


def value_at(law: StrengthFactor, degrees: float) -> float:
    resistance = Resistance(strength_factor=law)
    return strength_factor(resistance=resistance, oblique_angle=math.radians(degrees), **CASE)


def angle_of(law: StrengthFactor, velocity: float, **changes: Any) -> float:
    found = critical_angle(**CASE, velocity=velocity, resistance=Resistance(strength_factor=law), **changes)
    return math.degrees(known(found.angle))


@pytest.mark.parametrize(
    ("held", "velocity", "angle"), TABLE + [(90.0, *row) for row in NOT_HELD.items()], ids=lambda value: f"{value:g}"
)
def test_critical_angles_agree_with_an_independent_program(held: float, velocity: float, angle: float) -> None:
    found = angle_of(ObliquityPolynomial(held_from=math.radians(held)), float(velocity))
    assert found == pytest.approx(angle, abs=0.02)


@pytest.mark.parametrize("velocity", [238.0, 400.0, 600.0])
def test_equation_9_is_constant_from_60_degrees_by_default(velocity: float) -> None:
    """The angle is the same with the defaults given explicitly; above 60° it is the angle for a constant S of 4.683."""
    plain = angle_of(ObliquityPolynomial(), velocity)
    assert plain == angle_of(ObliquityPolynomial(coefficients=EQUATION_9_COEFFICIENTS), velocity)
    assert plain == angle_of(ObliquityPolynomial(held_from=math.radians(60.0)), velocity)
    if plain > 60.0:
        assert plain == pytest.approx(angle_of(ConstantStrengthFactor(value=4.683), velocity), abs=0.01)


OWN = OwnTests(shots=(Shot(velocity=238.1, depth=0.30, mass=12.923),))
LAWS: dict[str, StrengthFactor] = {
    "equation 9": ObliquityPolynomial(),
    "published tests": PublishedTests(),
    "own tests": OWN,
    "power law": StrengthPowerLaw(obliquity_shape="equation_9"),
    "scaled equation 9": scaled(ObliquityPolynomial(), 1.2),
    "scaled published tests": scaled(PublishedTests(), 0.8),
    "scaled own tests": scaled(OWN, 1.1),
}


@pytest.mark.parametrize("name", LAWS)
def test_every_law_with_the_shape_of_equation_9_is_held(name: str) -> None:
    law = LAWS[name]
    for degrees in (60.0, 60.001, 75.0, -80.0, 89.99):
        assert value_at(law, degrees) == pytest.approx(value_at(law, 60.0), rel=1e-12)
    assert value_at(law, 60.0) / value_at(law, 0.0) == pytest.approx(4.683 / 8.469, rel=1e-12)
    assert value_at(law, 55.0) > value_at(law, 60.0)


def test_search_and_run_use_the_same_strength_factor_beyond_60_degrees() -> None:
    found = critical_angle(**CASE, velocity=600.0)
    assert found.strength_factor == pytest.approx(4.683)
    run = simulate(**CASE, impact=Impact(velocity=600.0, oblique_angle=math.radians(80.0)), sample_interval=None)
    assert run.strength_factor == pytest.approx(4.683)


def test_search_range_up_to_89_degrees_is_kept_if_s_is_held() -> None:
    """If eq. 9 is not held, S falls to zero at 86.6°, where the search is cut off."""
    search = Search(lower=math.radians(5.0), upper=math.radians(89.0))
    assert "range_clipped" not in codes(critical_angle(**CASE, velocity=PAPER_VELOCITY, search=search))
    unheld = Resistance(strength_factor=ObliquityPolynomial(held_from=math.pi / 2.0))
    found = critical_angle(**CASE, velocity=PAPER_VELOCITY, search=search, resistance=unheld)
    assert "range_clipped" in codes(found)
    assert math.degrees(known(found.angle)) == pytest.approx(48.634, abs=0.01)


def test_flat_body_at_a_grazing_angle_is_resisted() -> None:
    """The body would go 435 mm deep with the extrapolated S of 0.34 at 85°."""
    flat = Projectile(nose=Flat(), diameter=0.08, length=0.53, mass=13.0)
    strike = CASE | {"projectile": flat, "impact": paper_impact(oblique_angle_degrees=85.0), "sample_interval": None}
    held = known(simulate(**strike).maximum_depth)
    constant = known(simulate(**strike, resistance=Resistance(strength_factor=LAWS["equation 9"])).maximum_depth)
    free = Resistance(strength_factor=ObliquityPolynomial(held_from=math.pi / 2.0))
    assert held == constant
    assert held < 0.08
    assert known(simulate(**strike, resistance=free).maximum_depth) > 0.4


def test_search_below_60_degrees_does_not_change_by_a_bit() -> None:
    search = Search(lower=math.radians(40.0), upper=math.radians(60.0))
    plain, unheld = (
        critical_angle(**CASE, velocity=PAPER_VELOCITY, search=search, resistance=Resistance(strength_factor=law))
        for law in (ObliquityPolynomial(), ObliquityPolynomial(held_from=math.pi / 2.0))
    )
    assert (plain.angle, plain.iterations) == (unheld.angle, unheld.iterations)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 90.0])
def test_s_may_be_held_from_any_angle_up_to_90_degrees(degrees: float) -> None:
    law = ObliquityPolynomial(held_from=math.radians(degrees))
    assert value_at(law, 40.0) == pytest.approx(value_at(ObliquityPolynomial(), min(degrees, 40.0)), rel=1e-12)


@pytest.mark.parametrize("value", [-0.01, 1.6, math.nan, math.inf])
def test_invalid_angles_for_holding_s_are_refused(value: float) -> None:
    with pytest.raises(ParameterError, match=r"strength_factor\.held_from"):
        ObliquityPolynomial(held_from=value)


OTHER = ObliquityPolynomial(coefficients=(9.0, 0.0, -0.001))


def test_other_polynomials_are_extrapolated_with_a_warning() -> None:
    assert value_at(OTHER, 80.0) == pytest.approx(9.0 - 6.4)

    def warned(law: StrengthFactor, degrees: float) -> bool:
        resistance = Resistance(strength_factor=law)
        impact = paper_impact(oblique_angle_degrees=degrees)
        return "strength_factor_not_held" in codes(simulate(**CASE, impact=impact, resistance=resistance))

    assert warned(OTHER, 70.0)
    assert warned(ObliquityPolynomial(held_from=math.pi / 2.0), 70.0)
    assert not warned(OTHER, 60.0)
    assert not warned(ObliquityPolynomial(coefficients=OTHER.coefficients, held_from=math.radians(60.0)), 70.0)
    assert not warned(ObliquityPolynomial(), 70.0)
    assert not warned(ObliquityPolynomial(coefficients=(9.0,)), 70.0)


def test_warning_beyond_the_fit_states_that_s_is_held() -> None:
    (detail,) = (
        each.detail
        for each in simulate(**CASE, impact=paper_impact(oblique_angle_degrees=70.0)).warnings
        if each.code == "strength_fit_extrapolated"
    )
    assert "held from 60° on" in detail


def test_standard_error_is_held_together_with_s() -> None:
    covariance = ((0.05, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1e-7))
    law = ObliquityPolynomial(covariance=covariance)
    assert law.standard_error(math.radians(80.0)) == law.standard_error(math.radians(60.0))
    found = critical_angle(
        **CASE,
        velocity=600.0,
        resistance=Resistance(strength_factor=law),
        numerics=Numerics(relative_tolerance=1e-3),
    )
    assert found.status is SearchStatus.CONVERGED
    assert math.degrees(known(found.standard_error)) < 2.0
