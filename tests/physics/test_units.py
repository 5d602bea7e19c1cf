"""Texts are written in SI or in US customary units from the same values."""

import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from solver import (
    Impact,
    ObliquityPolynomial,
    OwnTests,
    ParameterError,
    PublishedTests,
    Resistance,
    ShearPlug,
    Shot,
    Target,
    formulas,
    simulate,
)
from solver.flight import landing_sentence
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from solver.uncertainty import TruncatedNormal, judge_wall
from solver.units import (
    Amount,
    UnitSystem,
    fixed,
    interval,
    number,
    quantity,
    rounded,
    system_in_use,
    whole_number,
    written_in,
)
from tests.quantities_in_texts import check_converted

OTHER = replace(PAPER_TARGET, compressive_strength=120e6, density=2400.0)
THIN = replace(PAPER_TARGET, thickness=0.1)
SLENDER = replace(PAPER_PROJECTILE, length=1.2, mass=25.0)
SHOTS = OwnTests(shots=(Shot(velocity=238.0, depth=0.30), Shot(velocity=275.0, depth=0.38)))
STRIKES: dict[str, tuple[dict[str, Any], Impact]] = {
    "velocity_beyond_rigid": ({}, Impact(velocity=950.5, oblique_angle=0.3)),
    "strength_beyond_tests": ({"target": OTHER}, Impact(velocity=238.0, oblique_angle=0.8)),
    "strength_factor_of_other_concrete": ({"target": OTHER}, Impact(velocity=238.0, oblique_angle=0.8)),
    "published_tests_extrapolated": (
        {"target": OTHER, "resistance": Resistance(strength_factor=PublishedTests())},
        Impact(velocity=1100.0, oblique_angle=0.0),
    ),
    "mean_density_unusual": (
        {"projectile": replace(PAPER_PROJECTILE, mass=1.0)},
        Impact(velocity=238.0, oblique_angle=0.8),
    ),
    "rear_face_unconservative": ({"target": THIN}, Impact(velocity=238.0, oblique_angle=0.0)),
    "plug_through_wall": (
        {"target": replace(THIN, thickness=0.02), "resistance": Resistance(rear_plug=ShearPlug())},
        Impact(velocity=238.0, oblique_angle=0.0),
    ),
    "own_tests_deeper_than_wall": (
        {"target": THIN, "resistance": Resistance(strength_factor=SHOTS)},
        Impact(velocity=238.0, oblique_angle=0.0),
    ),
    "bends": ({"projectile": SLENDER}, Impact(velocity=600.0, oblique_angle=0.9)),
    "scatter_of_table_1": (
        {"resistance": Resistance(strength_factor=ObliquityPolynomial()), "strength_scatter": "paper_table_1"},
        Impact(velocity=238.0, oblique_angle=0.8),
    ),
}
"""Strikes that cause a warning with quantities, by the code of the warning."""


@pytest.mark.parametrize("code", STRIKES)
def test_warnings_in_both_systems_differ_only_in_units(code: str) -> None:
    changes, impact = STRIKES[code]
    case: dict[str, Any] = {
        "projectile": PAPER_PROJECTILE,
        "target": PAPER_TARGET,
        "impact": impact,
        "sample_interval": None,
    } | changes
    in_si = simulate(**case).warnings
    with written_in("us"):
        in_us = simulate(**case).warnings
    assert [each.code for each in in_us] == [each.code for each in in_si]
    assert code in {each.code for each in in_us}
    for si, us in zip(in_si, in_us, strict=True):
        check_converted(si.detail, us.detail)
    assert any(si.detail != us.detail for si, us in zip(in_si, in_us, strict=True))


def test_ranges_and_notes_in_both_systems_differ_only_in_units() -> None:
    impact = Impact(velocity=1200.0, oblique_angle=0.0)
    strike: dict[str, Any] = {"projectile": replace(PAPER_PROJECTILE, mass=0.1), "target": OTHER, "impact": impact}
    in_si = formulas(**strike)
    with written_in("us"):
        in_us = formulas(**strike)
    for si, us in zip(in_si, in_us, strict=True):
        check_converted(si.note, us.note)
        assert [each.field for each in si.out_of_range] == [each.field for each in us.out_of_range]
        for one, other in zip(si.out_of_range, us.out_of_range, strict=True):
            check_converted(one.detail, other.detail)
    details = [each.detail for row in in_us for each in row.out_of_range]
    assert "fitted from 52.49 ft/s to 1024 ft/s along the normal, here 3937 ft/s" in details
    assert any("lb/ft³" in each for each in details)


@pytest.mark.parametrize(("thickness", "oblique_angle"), [(0.3, 0.0), (0.5, 0.7), (None, 0.5)])
def test_verdicts_on_a_wall_in_both_systems_differ_only_in_units(thickness: float | None, oblique_angle: float) -> None:
    strike: dict[str, Any] = {
        "projectile": PAPER_PROJECTILE,
        "target": replace(PAPER_TARGET, thickness=thickness, characteristic_strength=31e6),
        "impact": Impact(velocity=238.0, oblique_angle=oblique_angle),
    }
    in_si = judge_wall(**strike)
    with written_in(UnitSystem.US):
        in_us = judge_wall(**strike)
    check_converted(in_si.sentence, in_us.sentence)
    assert in_us.perforation == in_si.perforation
    assert "psi" in in_us.sentence
    assert " in " in in_us.sentence


def test_warning_about_shots_deeper_than_formulas_is_in_both_systems() -> None:
    deep = OwnTests(shots=(Shot(velocity=238.0, depth=0.45), Shot(velocity=275.0, depth=0.50)))
    wall: dict[str, Any] = {
        "projectile": PAPER_PROJECTILE,
        "target": PAPER_TARGET,
        "impact": Impact(velocity=238.0, oblique_angle=0.0),
        "resistance": Resistance(strength_factor=deep),
    }
    (in_si,) = (each.detail for each in judge_wall(**wall).warnings if each.code == "own_tests_deeper_than_formulas")
    with written_in("us"):
        in_us = [each.detail for each in judge_wall(**wall).warnings if each.code == "own_tests_deeper_than_formulas"]
    check_converted(in_si, in_us[0])
    assert "450 mm" in in_si
    assert "17.72 in" in in_us[0]


def test_distances_of_a_flight_are_rounded_up_in_both_systems() -> None:
    assert landing_sentence(30.2, 95.0, 1204.0).startswith("Lands about 31 m away")
    with written_in("us"):
        sentence = landing_sentence(30.2, 95.0, 1204.0)
    assert sentence == (
        "Lands about 100 ft away if it tumbles as computed, up to 320 ft at any elevation, at most 3960 ft without "
        "drag."
    )


REFUSED: dict[str, Callable[[], object]] = {
    "projectile.length": lambda: replace(PAPER_PROJECTILE, length=0.1),
    "projectile.diameter": lambda: replace(PAPER_PROJECTILE, diameter=80.0),
    "projectile.inner_diameter": lambda: replace(PAPER_PROJECTILE, inner_diameter=0.09),
    "target.density": lambda: replace(PAPER_TARGET, density=2.25),
    "target.thickness": lambda: strike_into(replace(PAPER_TARGET, thickness=0.005)),
    "target.youngs_modulus": lambda: strike_into(replace(PAPER_TARGET, youngs_modulus=3e7)),
    "impact.velocity": lambda: Impact(velocity=2e4, oblique_angle=0.8),
    "target.characteristic_strength": lambda: judge_wall(
        projectile=PAPER_PROJECTILE,
        target=replace(PAPER_TARGET, characteristic_strength=50e6),
        impact=Impact(velocity=238.0, oblique_angle=0.0),
    ),
    "resistance.strength_factor.shots.0.depth": lambda: strike_into(
        PAPER_TARGET, Resistance(strength_factor=OwnTests(shots=(Shot(velocity=238.0, depth=30.0),)))
    ),
}
"""Calls with one wrong input, by the name of the input."""


def strike_into(target: Target, resistance: Resistance | None = None) -> object:
    impact = Impact(velocity=238.0, oblique_angle=0.8)
    return simulate(projectile=PAPER_PROJECTILE, target=target, impact=impact, resistance=resistance)


@pytest.mark.parametrize("field", REFUSED)
def test_errors_are_in_the_units_of_the_inputs_unless_a_system_is_set(field: str) -> None:
    with pytest.raises(ParameterError) as caught:
        REFUSED[field]()
    error: ParameterError = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 (as from a worker)
    assert error.field == field
    in_input_units = str(error)
    condition, _, advice = in_input_units.partition("; ")
    assert not re.search(r"\d (mm|[MG]Pa)\b", condition), "numbers are given without prefixes"
    with written_in("si"):
        in_si = str(error)
    with written_in("us"):
        in_us = str(error)
    check_converted(in_si.removesuffix(advice), in_us.removesuffix(advice))
    assert str(error) == in_input_units
    assert error.args == (field, error.requirement)


def test_amounts_without_a_unit_take_that_of_their_field() -> None:
    with pytest.raises(ParameterError) as caught:
        TruncatedNormal(mean=39e6, standard_deviation=1e6, lower=45e6)
    error = caught.value.at("uncertain.0", before="with {braces} ", unit="MPa")
    assert str(caught.value) == "distribution.lower: must be below the mean, 3.9e7"
    assert str(error) == "uncertain.0: with {braces} must be below the mean, 3.9e7 Pa"
    with written_in("si"):
        assert str(error) == "uncertain.0: with {braces} must be below the mean, 39 MPa"


def test_limits_are_rounded_towards_the_safe_side() -> None:
    assert rounded(0.3001, "mm", math.ceil) == "301"
    assert rounded(0.3, "mm", math.ceil) == "300", "what rounding errors add is not another millimetre"
    assert rounded(238.9, "m/s", math.floor) == "238"
    with written_in("us"):
        assert rounded(0.3, "mm", math.ceil) == "11.9"
        assert rounded(11.0 * 0.0254, "mm", math.ceil) == "11.0"
        assert rounded(100.0 * 0.3048, "m/s", math.floor) == "100"


def test_numbers_of_ordinary_size_have_no_exponent() -> None:
    assert number(1.17, "mm", 3) == "1170"
    assert quantity(12346.0, "m/s") == "12,350 m/s"
    assert interval(0.473, 0.629, "mm") == "473 to 629 mm"
    assert fixed(-1e-9, "mm") == "0"
    assert number(1.2e6, "", 12) == "1,200,000"
    assert quantity(1e30, "Pa") == "1e30 Pa"


def test_thousands_are_grouped_from_five_digits_on() -> None:
    for value, text in ((9999, "9999"), (-9999, "-9999"), (10_000, "10,000"), (-1_234_567, "-1,234,567")):
        assert whole_number(value) == number(float(value), "", 7) == fixed(float(value), "") == text
    assert number(12345.6, "m/s", 6) == "12,345.6"
    assert rounded(12.3451, "mm", math.ceil) == "12,346"
    assert interval(5000.0, 12000.0, "kg/m³") == "5000 to 12,000 kg/m³"
    assert str(Amount(math.nan, "mm")) == "nan m"
    assert str(Amount(-math.inf, "mm")) == "-inf m"


def test_quantities_of_us_units_have_no_exponent_either() -> None:
    with written_in("us"):
        assert interval(0.473, 0.629, "mm") == "18.62 to 24.76 in"
        assert quantity(97e6, "MPa") == "14,070 psi"
        assert quantity(45.0, "°") == "45°", "common to both systems"


def test_units_apply_only_within_the_context() -> None:
    assert system_in_use() is UnitSystem.SI
    with written_in("us"):
        with written_in("si"):
            assert quantity(1.0, "m") == "1 m"
        assert quantity(1.0, "m") == "3.281 ft"
    assert system_in_use() is UnitSystem.SI
    with pytest.raises(ValueError, match="imperial"), written_in("imperial"):
        pass
