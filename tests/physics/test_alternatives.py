"""`alternatives`: a case computed under other laws."""

import math
from dataclasses import replace
from typing import Any

import pytest

from solver import (
    ConstantStrengthFactor,
    CriticalAngle,
    ElasticPlastic,
    MohrCoulomb,
    NoFreeSurface,
    ObliquityPolynomial,
    Outcome,
    ParameterError,
    PublishedTests,
    Resistance,
    Search,
    StrengthPowerLaw,
    alternatives,
    critical_angle,
    simulate,
    to_dataframe,
)
from solver.resistance import StrengthFactor
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import known

CASE: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET, "velocity": PAPER_VELOCITY}
EQUATION_9 = ("obliquity_polynomial", "equation_9")
MOTIONS = ("strength_power_law", "finite_elements")
OTHERS = [("published_tests", "equation_9"), ("strength_power_law", "constant")]
LAWS = [
    *(("elastic_plastic", *law) for law in (EQUATION_9, MOTIONS, *OTHERS)),
    *(("mohr_coulomb", *law) for law in (EQUATION_9, MOTIONS, *OTHERS)),
    *(("none", *law) for law in (EQUATION_9, *OTHERS)),
]
"""Decay law, law of S and shape of S over the angle of each alternative. Both cavity theories occur with eq. 9 and with
the S that was fitted to finite element motions with that theory; the case without decay has no such fit."""


def test_critical_angle_under_each_law_equals_a_search_with_that_law() -> None:
    found = alternatives(critical_angle, **CASE)
    assert [(each.free_surface, each.strength_factor, each.obliquity_shape) for each in found] == LAWS
    decays = {model.name: model for model in (ElasticPlastic(), MohrCoulomb(), NoFreeSurface())}
    own = StrengthPowerLaw(coefficient=8.469, exponent=0.0, obliquity_shape="finite_elements")
    models: tuple[StrengthFactor, ...] = (ObliquityPolynomial(), own, PublishedTests(), StrengthPowerLaw())
    strengths = dict(zip((EQUATION_9, MOTIONS, *OTHERS), models, strict=True))
    for each in found:
        resistance = Resistance(
            free_surface=decays[each.free_surface],
            strength_factor=strengths[each.strength_factor, each.obliquity_shape],
        )
        assert each.resistance == resistance
        assert each.answer == critical_angle(**CASE, resistance=resistance)


def test_stronger_decay_lowers_the_critical_angle_under_every_strength_law() -> None:
    found = {
        (each.free_surface, each.strength_factor): each.answer
        for each in alternatives(critical_angle, **CASE)
        if each.obliquity_shape != "finite_elements"
    }
    for strength in ("obliquity_polynomial", "published_tests", "strength_power_law"):
        angles = [found[decay, strength].angle for decay in ("mohr_coulomb", "elastic_plastic", "none")]  # type: ignore[union-attr]
        assert angles == sorted(angles)  # type: ignore[type-var]


def test_outcomes_under_each_law_agree_with_its_critical_angle() -> None:
    strike = {name: CASE[name] for name in ("projectile", "target")} | {
        "impact": paper_impact(oblique_angle_degrees=50.0),
        "sample_interval": None,
    }
    for run, search in zip(alternatives(simulate, **strike), alternatives(critical_angle, **CASE), strict=True):
        assert run.resistance == search.resistance
        assert not isinstance(run.answer, Exception)
        assert not isinstance(search.answer, Exception)
        turned_away = known(search.answer.angle) < math.radians(50.0)
        assert run.answer.outcome is (Outcome.RICOCHET if turned_away else Outcome.EMBEDDED)


def test_alternatives_keep_the_inertia_of_the_case_but_not_its_laws() -> None:
    own = Resistance(
        strength_factor=ConstantStrengthFactor(value=6.0), inertia_factor=0.8, free_surface=MohrCoulomb(inertia=True)
    )
    found = alternatives(lambda resistance: resistance, resistance=own)
    assert [each.answer for each in found] == [each.resistance for each in found]
    assert {each.resistance.inertia_factor for each in found} == {0.8}
    assert all(getattr(each.resistance.free_surface, "inertia", True) for each in found)
    assert "constant" not in {each.strength_factor for each in found}


def test_law_without_an_answer_has_its_error_beside_the_other_answers() -> None:
    def angle(resistance: Resistance, **case: Any) -> CriticalAngle:
        if isinstance(resistance.strength_factor, ObliquityPolynomial):
            resistance = replace(resistance, strength_factor=ObliquityPolynomial(held_from=math.radians(90.0)))
        return critical_angle(**case, resistance=resistance)

    beyond = Search(lower=math.radians(87.0), upper=math.radians(88.0))
    for each in alternatives(angle, **CASE, search=beyond):
        is_polynomial = each.strength_factor == "obliquity_polynomial"  # S, not held here, is negative beyond 86.6°.
        assert isinstance(each.answer, ParameterError) is is_polynomial


def test_each_theory_occurs_with_eq_9_and_with_its_own_strength_factor() -> None:
    """With the S fitted to finite element motions, the angles of the two theories are closer to each other."""
    found: dict[tuple[str, str], float] = {
        (each.free_surface, each.obliquity_shape): math.degrees(each.answer.angle)  # type: ignore[union-attr,arg-type]
        for each in alternatives(critical_angle, **CASE)
    }
    expected = {"equation_9": 48.39, "finite_elements": 50.18}, {"equation_9": 43.38, "finite_elements": 47.44}
    for decay, angles in zip(("elastic_plastic", "mohr_coulomb"), expected, strict=True):
        for shape, angle in angles.items():
            assert found[decay, shape] == pytest.approx(angle, abs=0.05)


@pytest.mark.parametrize("law", LAWS)
def test_each_alternative_states_what_it_was_fitted_to(law: tuple[str, str, str]) -> None:
    (found,) = [
        each
        for each in alternatives(lambda resistance: None)
        if (each.free_surface, each.strength_factor, each.obliquity_shape) == law
    ]
    assert found.fitted_to.startswith("S: ")
    assert "decay" in found.fitted_to
    assert len(found.fitted_to) <= 140


def test_alternatives_become_a_table_with_their_laws() -> None:
    pytest.importorskip("pandas")
    found = alternatives(critical_angle, **CASE)
    table = to_dataframe(found)
    assert table["decay_law"].tolist() == [each.free_surface for each in found]
    assert table["strength_law"].tolist() == [each.strength_factor for each in found]
    angles = [getattr(each.answer, "angle", None) for each in found]
    assert table["angle"].tolist() == pytest.approx(
        [math.nan if angle is None else angle for angle in angles], nan_ok=True
    )
    assert table.attrs["units"]["angle"] == "rad"
