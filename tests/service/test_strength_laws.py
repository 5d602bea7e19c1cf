"""Every list of strength laws by name contains all of them. mypy checks code that distinguishes them by type."""

from collections.abc import Collection
from pathlib import Path
from typing import get_args

import pytest

import solver
from service.cli.arguments import RESISTANCE
from service.names import CHOICES
from service.reports.assessment import LAW_LIMITS
from service.schemas.resistance import STRENGTH_FACTORS, PublishedTests
from solver.resistance import StrengthFactor
from solver.sweeps import fitted_to
from solver.units import written_in
from tests.odd_strikes import KINDS, odd_strikes

LAWS = {law.name: law for law in get_args(StrengthFactor)}
DEFAULT = {"model": "obliquity_polynomial"}


@pytest.mark.parametrize(
    "known",
    [STRENGTH_FACTORS, LAW_LIMITS, CHOICES["resistance.strength_factor.model"]],
    ids=["contract", "limits in the report", "display names"],
)
def test_every_list_of_strength_laws_is_complete(known: Collection[str]) -> None:
    assert set(known) == LAWS.keys()


def test_every_strength_law_is_exported_and_has_a_flag() -> None:
    assert all(getattr(solver, law.__name__) is law for law in LAWS.values())
    assert {law for flag in RESISTANCE for law in flag.implies} >= LAWS.keys()


def test_odd_strikes_have_every_strength_law() -> None:
    strikes = odd_strikes(20 * len(KINDS), seed=1)
    found = {each["resistance"].get("strength_factor", DEFAULT)["model"] for each in strikes}
    assert found == LAWS.keys()


def test_stated_ranges_of_the_published_tests_agree_with_the_data() -> None:
    tests = solver.PublishedTests
    strengths = [f"{each / 1e6:.0f}" for each in tests.compressive_strengths]
    speeds = [f"{each:.0f}" for each in tests.velocities]
    diameters = [1e3 * each for each in tests.diameters]
    fine, coarse = (" to ".join(f"{each:{layout}}" for each in diameters) for layout in (".3g", ".0f"))
    strength, speed = " to ".join(strengths), " to ".join(speeds)
    contract = " ".join((PublishedTests.__doc__ or "").split())
    assert f"{fine} mm at {speed} m/s, concrete of {strength} MPa" in contract
    manual = (Path(__file__).parents[2] / "docs" / "how-to" / "choose-laws.md").read_text()
    assert f"concrete of {strength} MPa, {coarse} mm, {speed} m/s" in manual
    assert f"{coarse} mm, {strength} MPa" in data_behind(solver.PublishedTests())


def test_texts_of_alternatives_state_the_data_of_each_law() -> None:
    expected = {
        solver.ObliquityPolynomial: "S: finite elements, 80 mm into 39 MPa, 0° to 45°",
        solver.PublishedTests: "S: 251 tests at 0°, 10 to 203 mm, 13 to 108 MPa, over the angle as eq. 9",
        solver.StrengthPowerLaw: "S: tests at 0° of Frew et al. (1998), over the angle constant",
    }
    assert {law: data_behind(law()) for law in expected} == expected
    with written_in("us"):
        assert "0.3937 to 7.992 in, 1885 to 15,660 psi" in data_behind(solver.PublishedTests())


def data_behind(law: StrengthFactor) -> str:
    return fitted_to(solver.Resistance(strength_factor=law)).split("; ")[0]
