"""Rules that every true answer keeps: broken ones are named, and no answer of this model breaks them."""

import math
from dataclasses import replace

import pytest

from solver import Exit, Impact, ModelWarning, Outcome, Projectile, Resistance, ShearPlug, Target, simulate
from solver.plausibility import check_depth, check_energy, check_walls, deepest_by_energy
from solver.prepared import PreparedCase, prepare
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, USUAL, paper_impact
from validation.routes import random_strikes

from .strikes import known

WALL = replace(PAPER_TARGET, thickness=0.1)
HEAD_ON = paper_impact(oblique_angle_degrees=0.0)
ENERGY = 0.5 * PAPER_PROJECTILE.mass * HEAD_ON.velocity**2


def prepared(target: Target = PAPER_TARGET, projectile: Projectile = PAPER_PROJECTILE, **given: object) -> PreparedCase:
    resistance = Resistance(**given)  # type: ignore[arg-type]
    return prepare(projectile=projectile, target=target, resistance=resistance, numerics=USUAL.resolved())


def leaving(energy: float, speed: float = 200.0) -> Exit:
    left = simulate(projectile=PAPER_PROJECTILE, target=WALL, impact=HEAD_ON, sample_interval=None).exit
    return replace(known(left), kinetic_energy=energy, speed=speed)


def says(warnings: tuple[ModelWarning, ...]) -> str:
    assert {warning.code for warning in warnings} <= {"implausible"}
    return " ".join(warning.detail for warning in warnings)


@pytest.mark.parametrize(
    ("target", "outcome", "share", "words"),
    [
        (WALL, Outcome.PERFORATED, 0.99999, "hardly any loss of energy"),
        (WALL, Outcome.PERFORATED, 0.9, ""),
        (WALL, Outcome.RICOCHET, 0.99999, ""),
        (replace(WALL, thickness=0.03), Outcome.PERFORATED, 0.99999, ""),
        (PAPER_TARGET, Outcome.RICOCHET, 1.01, "1.01 times its energy"),
        (PAPER_TARGET, Outcome.RICOCHET, 1.0, ""),
    ],
)
def test_energy_that_is_gained_or_not_lost_is_named(target: Target, outcome: Outcome, share: float, words: str) -> None:
    found = says(check_energy(prepared(target), HEAD_ON, outcome, leaving(share * ENERGY)))
    assert words in found
    assert bool(words) == bool(found)


def test_depth_beyond_the_energy_is_named() -> None:
    case = prepared()
    most = deepest_by_energy(case, HEAD_ON)
    force = 8.469 * 39e6 * math.pi * 0.04**2
    assert most == pytest.approx(ENERGY / force + PAPER_PROJECTILE.nose_length, rel=1e-9)
    assert says(check_depth(case, HEAD_ON, 0.99 * most)) == ""
    assert "its energy is used up" in says(check_depth(case, HEAD_ON, 1.01 * most))
    assert says(check_depth(case, paper_impact(oblique_angle_degrees=10.0), 1.01 * most)) == ""


@pytest.mark.parametrize(
    ("thickness", "speeds", "words"),
    [
        (11.0, [], "more than the"),
        (None, [], "however thick"),
        (0.24, [150.0, 120.0, 60.0], ""),
        (0.24, [150.0, 60.0, 120.0], "faster than a thinner one"),
    ],
)
def test_walls_that_no_energy_explains_are_named(thickness: float | None, speeds: list[float], words: str) -> None:
    passed = [(0.1 + 0.02 * place, leaving(0.5 * ENERGY, speed)) for place, speed in enumerate(speeds)]
    found = says(check_walls(prepared(rear_plug=ShearPlug()), HEAD_ON, thickness, reversed(passed)))
    assert words in found
    assert bool(words) == bool(found)


def test_no_answer_of_the_model_is_implausible() -> None:
    """Over strikes of every kind; those on walls of `test_blunt_bodies` and all route comparisons look as well."""
    for strike in random_strikes(600, 21):
        given = {name: getattr(strike, name) for name in ("projectile", "target", "impact", "resistance")}
        run = simulate(**given, sample_interval=None)
        assert "implausible" not in {warning.code for warning in run.warnings}, strike


def test_lifeless_wall_is_named_in_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall whose resistance is lost, as a fault of the loads once lost it, is answered with the warning."""
    lost = PreparedCase.law_at

    def without_resistance(case: PreparedCase, impact: Impact) -> object:
        return lost(case, impact)._replace(static_stress=1.0, dynamic_density=0.0)

    monkeypatch.setattr(PreparedCase, "law_at", without_resistance)
    run = simulate(projectile=PAPER_PROJECTILE, target=WALL, impact=HEAD_ON, sample_interval=None)
    assert run.outcome is Outcome.PERFORATED
    assert "implausible" in {warning.code for warning in run.warnings}
