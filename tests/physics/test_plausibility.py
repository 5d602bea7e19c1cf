"""Rules of physics that every answer must satisfy: violations cause a warning, and the model does not violate them."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from solver import (
    Conical,
    ConstantStrengthFactor,
    Exit,
    Flat,
    Impact,
    ModelWarning,
    Numerics,
    Ogive,
    Outcome,
    ParameterError,
    Projectile,
    Resistance,
    RicochetError,
    ShearPlug,
    Spherical,
    Target,
    least_thickness,
    simulate,
)
from solver.checks import BOUNDS
from solver.free_surface import decay_laws
from solver.plausibility import check_depth, check_energy, check_walls, deepest_by_energy
from solver.prepared import PreparedCase, prepare
from solver.projectile import NoseShape
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
def test_gain_or_missing_loss_of_energy_is_reported(target: Target, outcome: Outcome, share: float, words: str) -> None:
    found = says(check_energy(prepared(target), HEAD_ON, outcome, leaving(share * ENERGY)))
    assert words in found
    assert bool(words) == bool(found)


def test_depth_beyond_the_available_energy_is_reported() -> None:
    case = prepared()
    most = deepest_by_energy(case, HEAD_ON)
    force = 8.469 * 39e6 * math.pi * 0.04**2
    assert most == pytest.approx(ENERGY / force + PAPER_PROJECTILE.nose_length, rel=1e-9)
    assert says(check_depth(case, HEAD_ON, 0.99 * most)) == ""
    assert "its energy is used up" in says(check_depth(case, HEAD_ON, 1.01 * most))
    assert says(check_depth(case, paper_impact(oblique_angle_degrees=10.0), 1.01 * most)) == ""


TURNED = replace(HEAD_ON, oblique_angle=0.1)


@pytest.mark.parametrize(
    ("impact", "first", "speeds", "words"),
    [
        (HEAD_ON, 11.0, [150.0], "use up its energy"),
        (TURNED, 11.0, [150.0], "use up its energy"),
        (HEAD_ON, 0.1, [], ""),
        (HEAD_ON, 0.1, [150.0, 120.0, 60.0], ""),
        (HEAD_ON, 0.1, [150.0, 60.0, 120.0], "faster than a thinner one"),
        (TURNED, 0.1, [150.0, 60.0, 120.0], ""),
    ],
)
def test_implausible_walls_are_reported(impact: Impact, first: float, speeds: list[float], words: str) -> None:
    passed = [(first + 0.02 * place, leaving(0.5 * ENERGY, speed)) for place, speed in enumerate(speeds)]
    found = says(check_walls(prepared(rear_plug=ShearPlug()), impact, reversed(passed)))
    assert words in found
    assert bool(words) == bool(found)


def test_answers_to_random_strikes_are_plausible() -> None:
    """The strikes are of every kind. `test_blunt_bodies.py` and `test_route_agreement.py` check their strikes, too."""
    for strike in random_strikes(600, 21):
        given = {name: getattr(strike, name) for name in ("projectile", "target", "impact", "resistance")}
        run = simulate(**given, sample_interval=None)
        assert "implausible" not in {warning.code for warning in run.warnings}, strike


def test_wall_without_resistance_causes_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error in the loads once led to walls without resistance; the test reproduces this."""
    lost = PreparedCase.law_at

    def without_resistance(case: PreparedCase, impact: Impact) -> object:
        return lost(case, impact)._replace(static_stress=1.0, dynamic_density=0.0)

    monkeypatch.setattr(PreparedCase, "law_at", without_resistance)
    run = simulate(projectile=PAPER_PROJECTILE, target=WALL, impact=HEAD_ON, sample_interval=None)
    assert run.outcome is Outcome.PERFORATED
    assert "implausible" in {warning.code for warning in run.warnings}


NOSES: tuple[NoseShape, ...] = (
    Ogive(caliber_radius_head=0.5),
    Ogive(caliber_radius_head=100.0),
    Conical(length_to_diameter=0.01),
    Conical(length_to_diameter=20.0),
    Spherical(caliber_radius_head=0.5),
    Spherical(caliber_radius_head=100.0),
    Flat(),
)
SLENDERNESS = 100.0
"""Largest ratio of length to diameter in these tests. On more slender bodies the stations of the quadrature are farther
apart than a wall is thick, and the resulting errors rightly cause the warning."""


def odd_strikes(count: int, seed: int) -> Iterator[tuple[Projectile, Target, Impact, Resistance]]:
    """Yield random valid strikes whose diameter, mass, concrete and velocity are log-uniform within their bounds."""
    random = np.random.default_rng(seed)

    def drawn(name: str) -> float:
        low, high = max(BOUNDS[name].lower, 1e-6), BOUNDS[name].upper
        return math.exp(random.uniform(math.log(low), math.log(high)))

    while count:
        diameter = drawn("projectile.diameter")
        try:
            nose = NOSES[random.integers(len(NOSES))]
            slenderness = math.exp(random.uniform(0.0, math.log(SLENDERNESS)))
            body = Projectile(
                nose=nose, diameter=diameter, length=slenderness * diameter, mass=drawn("projectile.mass")
            )
            target = Target(
                compressive_strength=drawn("target.compressive_strength"),
                density=drawn("target.density"),
                youngs_modulus=(None, drawn("target.youngs_modulus"))[random.integers(2)],
                thickness=(None, diameter * math.exp(random.uniform(-2.0, 4.0)))[random.integers(2)],
            )
            impact = Impact(
                velocity=drawn("impact.velocity"),
                oblique_angle=(0.0, math.radians(random.uniform(0.0, 89.0)))[random.integers(2)],
                angle_of_attack=(0.0, math.radians(random.uniform(-5.0, 5.0)))[random.integers(2)],
            )
            resistance = Resistance(
                strength_factor=ConstantStrengthFactor(value=math.exp(random.uniform(-7.0, 5.0))),
                inertia_factor=(0.0, 1.0)[random.integers(2)],
                free_surface=decay_laws()[random.integers(3)],
            )
            prepare(projectile=body, target=target, resistance=resistance, numerics=USUAL.resolved())
        except ParameterError:
            continue
        count -= 1
        yield body, target, impact, resistance


def test_answers_over_all_valid_inputs_are_plausible() -> None:
    """The numerics include the coarsest tolerance and fixed steps."""
    numerics = (None, Numerics(relative_tolerance=1e-2), Numerics(method="panels", panels=1000))
    finished = 0
    for number, (body, target, impact, resistance) in enumerate(odd_strikes(450, 46)):
        given = {"projectile": body, "target": target, "impact": impact, "resistance": resistance}
        try:
            run = simulate(**given, numerics=numerics[number % 3], sample_interval=None)  # type: ignore[arg-type]
        except RicochetError:
            continue
        finished += 1
        assert "implausible" not in {warning.code for warning in run.warnings}, (given, run.warnings)
    assert finished > 300


def test_answers_over_all_valid_walls_are_plausible() -> None:
    """One of the bodies, of 1 mm and 13 kg, perforates any wall."""
    rod = replace(PAPER_PROJECTILE, diameter=1e-3)
    odd = [(rod, PAPER_TARGET, HEAD_ON, Resistance()), *odd_strikes(25, 7)]
    finished = 0
    for body, target, impact, resistance in odd:
        try:
            found = least_thickness(
                projectile=body, target=replace(target, thickness=None), impact=impact, resistance=resistance
            )
        except RicochetError:
            continue
        finished += 1
        assert "implausible" not in {warning.code for warning in found.warnings}, (body, target, impact, resistance)
    assert finished > 15
