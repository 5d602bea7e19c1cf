"""Every list of strength laws by name contains all of them. mypy checks code that distinguishes them by type."""

from collections.abc import Collection
from typing import get_args

import pytest

import solver
from service.cli.arguments import RESISTANCE
from service.names import CHOICES
from service.reports.assessment import LAW_LIMITS
from service.schemas.resistance import STRENGTH_FACTORS
from solver.resistance import StrengthFactor
from tests.odd_strikes import KINDS, odd_strikes

LAWS = {law.name: law for law in get_args(StrengthFactor)}
DEFAULT = {"model": "obliquity_polynomial"}


@pytest.mark.parametrize(
    "known",
    [STRENGTH_FACTORS, LAW_LIMITS, CHOICES["resistance.strength_factor.model"]],
    ids=["contract", "limits in the report", "display names"],
)
def test_places_that_list_strength_laws_know_all_of_them(known: Collection[str]) -> None:
    assert set(known) == LAWS.keys()


def test_every_strength_law_is_exported_and_has_a_flag() -> None:
    assert all(getattr(solver, law.__name__) is law for law in LAWS.values())
    assert {law for flag in RESISTANCE for law in flag.implies} >= LAWS.keys()


def test_odd_strikes_have_every_strength_law() -> None:
    strikes = odd_strikes(20 * len(KINDS), seed=1)
    found = {each["resistance"].get("strength_factor", DEFAULT)["model"] for each in strikes}
    assert found == LAWS.keys()
