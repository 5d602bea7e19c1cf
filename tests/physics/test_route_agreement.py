"""Both methods agree on the end of random strikes over the whole input space: noses, walls, laws, attack and spin."""

import itertools
import math
from collections import Counter
from dataclasses import fields
from typing import get_args

import pytest

from solver import Impact, Projectile, Resistance, Target, warm_up
from solver.free_surface import FreeSurface
from solver.projectile import NoseShape
from validation.routes import (
    COMBINATIONS,
    DECAYS,
    FULL_TABLE,
    Combination,
    Comparison,
    combination,
    compare,
    random_strikes,
    table_of_combinations,
)

COUNT = 150
"""Number of strikes in this test; `make accuracy ARGS="--only routes"` compares 3,000."""


@pytest.fixture(scope="module")
def comparisons() -> list[Comparison]:
    warm_up()
    return [compare(number, strike) for number, strike in enumerate(random_strikes(COUNT, 1))]


def test_routes_agree_on_the_end_of_a_run(comparisons: list[Comparison]) -> None:
    """Outcome, exit speed and depth agree, or do so with finer panels or a shorter ramp."""
    assert [(row.number, row.difference, row.strike) for row in comparisons if row.difference] == []
    explained = Counter(row.explained for row in comparisons)
    assert explained[""] > 0.9 * COUNT


def test_every_pair_of_choices_is_compared(comparisons: list[Comparison]) -> None:
    compared = {row.strike.combination for row in comparisons}
    for first, second in itertools.combinations(range(len(Combination._fields)), 2):
        possible = {(each[first], each[second]) for each in COMBINATIONS}
        assert {(each[first], each[second]) for each in compared} == possible


def test_random_strikes_include_every_kind(comparisons: list[Comparison]) -> None:
    outcomes = Counter((row.strike.combination.wall, row.adaptive.outcome.value) for row in comparisons)
    assert set(outcomes) >= {(False, "embedded"), (False, "ricochet")}
    assert set(outcomes) >= {(True, "embedded"), (True, "ricochet"), (True, "perforated")}


def test_full_table_contains_every_combination() -> None:
    assert min(Counter(map(combination, range(FULL_TABLE))).values()) >= 1
    assert set(map(combination, range(FULL_TABLE))) == set(COMBINATIONS)
    assert sum(table_of_combinations(list(random_strikes(60, 2))).values()) == 60


def test_comparison_covers_every_choice_of_the_model() -> None:
    """After a new nose, decay law or field is added, this test fails until the compared strikes include it."""
    strikes = list(random_strikes(FULL_TABLE // 4, 3))
    assert {type(strike.projectile.nose) for strike in strikes} == set(get_args(NoseShape))
    assert {type(decay) for decay in DECAYS.values()} == set(get_args(FreeSurface))
    varied = {
        Projectile: {"nose", "diameter", "length", "mass", "boat_tail"},
        Target: {"compressive_strength", "density", "thickness"},
        Impact: {"velocity", "oblique_angle", "angle_of_attack", "angular_velocity"},
        Resistance: {"strength_factor", "inertia_factor", "free_surface", "crater", "rear_plug"},
    }
    follows_from_the_others = {
        Projectile: {"center_of_gravity", "moment_of_inertia"},
        Target: {"youngs_modulus", "poissons_ratio"},
    }
    in_no_motion: dict[type, set[str]] = {
        Projectile: {"inner_diameter", "yield_strength"},  # They affect the bending stress only.
        Target: {"characteristic_strength", "reinforcement_ratio_percent"},
    }
    for part, names in varied.items():
        others = follows_from_the_others.get(part, set()) | in_no_motion.get(part, set())
        assert {field.name for field in fields(part)} == names | others
        name = part.__name__.lower()
        for field in names:
            values = {repr(getattr(getattr(strike, name), field)) for strike in strikes}
            assert len(values) > 1, f"{name}.{field}"
    assert max(strike.impact.oblique_angle for strike in strikes) > math.radians(80.0)
