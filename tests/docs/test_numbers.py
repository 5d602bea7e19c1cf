"""The manual and the warnings state the numbers that the model computes for the paper's strike."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import pytest

from solver import (
    Conical,
    Crater,
    ElasticPlastic,
    Flat,
    FormulaResult,
    Impact,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    ObliquityPolynomial,
    Projectile,
    PublishedTests,
    Resistance,
    ShearPlug,
    Target,
    Trajectory,
    critical_angle,
    formulas,
    least_thickness,
    limit_velocity,
    mass_properties,
    simulate,
    strength_factor,
)
from solver.resistance import plug_height, shaped_as_finite_elements
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY
from solver.warnings import CRATER_AT_OBLIQUITY

from .blocks import ROOT

Numbers: TypeAlias = tuple[float, ...]

PLAIN = Resistance()
WITH_PLUG = Resistance(rear_plug=ShearPlug())
WITH_BOTH = Resistance(rear_plug=ShearPlug(), crater=Crater())
WITH_CRATER = Resistance(crater=Crater())
FLAT = replace(PAPER_PROJECTILE, nose=Flat())


def angle(
    *,
    velocity: float = PAPER_VELOCITY,
    projectile: Projectile = PAPER_PROJECTILE,
    target: Target = PAPER_TARGET,
    resistance: Resistance = PLAIN,
    retention: float = 0.01,
) -> float:
    """Return the critical angle of the paper's strike, with changes. [°]"""
    found = critical_angle(
        projectile=projectile,
        target=target,
        velocity=velocity,
        resistance=resistance,
        numerics=Numerics(retention_energy_fraction=retention),
    )
    assert found.angle is not None
    return math.degrees(found.angle)


def held_from(degrees: float) -> Resistance:
    """Return the default laws, with S kept constant from this angle on."""
    return Resistance(strength_factor=ObliquityPolynomial(held_from=math.radians(degrees)))


def with_own_fit(law: ElasticPlastic | MohrCoulomb) -> Resistance:
    """Return a decay law with the S(θ) that was fitted together with it."""
    return Resistance(free_surface=law, strength_factor=shaped_as_finite_elements(PLAIN.strength_factor))


def wall(thickness: float) -> Target:
    """Return a wall of the paper's concrete."""
    return replace(PAPER_TARGET, thickness=thickness)


def run(
    degrees: float,
    velocity: float = PAPER_VELOCITY,
    *,
    projectile: Projectile = PAPER_PROJECTILE,
    target: Target = PAPER_TARGET,
    resistance: Resistance = PLAIN,
) -> Trajectory:
    """Return the motion of the paper's strike at an angle, with changes."""
    impact = Impact(velocity=velocity, oblique_angle=math.radians(degrees))
    return simulate(projectile=projectile, target=target, impact=impact, resistance=resistance, sample_interval=None)


def thickness(
    degrees: float = 0.0, *, projectile: Projectile = PAPER_PROJECTILE, resistance: Resistance = PLAIN
) -> float:
    """Return the least thickness that stops the paper's strike, with changes. [m]"""
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=math.radians(degrees))
    found = least_thickness(projectile=projectile, target=PAPER_TARGET, impact=impact, resistance=resistance)
    assert found.value is not None
    return found.value


def limit_speed(degrees: float, thickness: float, *, resistance: Resistance = PLAIN) -> float:
    """Return the limit speed of the paper's projectile. [m/s]"""
    found = limit_velocity(
        projectile=PAPER_PROJECTILE,
        target=wall(thickness),
        oblique_angle=math.radians(degrees),
        resistance=resistance,
    )
    assert found.value is not None
    return found.value


def without_protrusion() -> Numbers:
    """Return the thickness, and the speed for a wall of 0.2 m, at which nothing comes out of the wall. [m, m/s]"""
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=0.0)
    thick = least_thickness(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact).without_protrusion
    slow = limit_velocity(projectile=PAPER_PROJECTILE, target=wall(0.2), oblique_angle=0.0).without_protrusion
    assert thick is not None
    assert slow is not None
    return thick, slow


def protrusion(thickness: float) -> float:
    """Return how far the nose protrudes from the rear face of a wall after normal impact. [mm]"""
    found = run(0.0, target=wall(thickness)).protrusion
    assert found is not None
    return 1e3 * found.greatest


def bending(degrees: float, velocity: float) -> Numbers:
    """Return the largest bending stress, its time and its place. [GPa, ms, mm]"""
    found = run(degrees, velocity).bending
    assert found is not None
    return found.peak_stress / 1e9, 1e3 * found.time, 1e3 * found.distance_behind_tip


def changes_on_a_wall() -> Numbers:
    """Return the angles at which the outcome changes on 0.2 m of concrete. [°]"""
    found = critical_angle(projectile=PAPER_PROJECTILE, target=wall(0.2), velocity=PAPER_VELOCITY)
    return tuple(math.degrees(each.upper) for each in found.outcomes[:-1])


def by_formula(projectile: Projectile, name: str) -> float:
    """Return the least thickness that a formula requires against perforation in normal impact. [m]"""
    impact = Impact(velocity=PAPER_VELOCITY, oblique_angle=0.0)
    results: dict[str, FormulaResult] = {
        each.formula: each for each in formulas(projectile=projectile, target=PAPER_TARGET, impact=impact)
    }
    found = results[name].perforation_thickness
    assert found is not None
    return found


def heavier_to_turn() -> float:
    """Return the change of the critical angle if the moment of inertia is 10 % larger. [°]"""
    inertia = 1.1 * mass_properties(PAPER_PROJECTILE).moment_of_inertia
    return angle(projectile=replace(PAPER_PROJECTILE, moment_of_inertia=inertia)) - angle()


def steep(resistance: Resistance) -> float:
    """Return the depth of a flat body at 85°. [mm]"""
    found = run(85.0, projectile=FLAT, resistance=resistance).maximum_depth
    assert found is not None
    return 1e3 * found


SPEEDS = (400.0, 500.0, 600.0, 700.0, 800.0)
CLAIMS: dict[str, Callable[[], Numbers]] = {
    "With Mohr-Coulomb decay instead of the default the paper's angle is {}° instead of {}° if each law has the "
    "S(θ) that was fitted with it, and {}° if both have eq. 9": lambda: (
        angle(resistance=with_own_fit(MohrCoulomb())),
        angle(),
        angle(resistance=Resistance(free_surface=MohrCoulomb())),
    ),
    "Elastic-plastic decay with its own fit would give {}°": lambda: (
        angle(resistance=with_own_fit(ElasticPlastic())),
    ),
    "Without decay the paper's angle is {}°": lambda: (angle(resistance=Resistance(free_surface=NoFreeSurface())),),
    "{}° with 0.1 %, {}° with 10 %": lambda: (angle(retention=0.001), angle(retention=0.1)),
    "at 100 m/s {}°, {}° and {}° with 0.1, 1 and 10 %": lambda: tuple(
        angle(velocity=100.0, retention=each) for each in (0.001, 0.01, 0.1)
    ),
    "this law gives {}, 3 % more than the {} of eq. 9": lambda: tuple(
        strength_factor(
            resistance=Resistance(strength_factor=law),
            oblique_angle=0.0,
            target=PAPER_TARGET,
            projectile=PAPER_PROJECTILE,
        )
        for law in (PublishedTests(), ObliquityPolynomial())
    ),
    "is turned away from {}, {}, {}, {} and {}° on at 400, 500, 600, 700 and 800 m/s": lambda: tuple(
        angle(velocity=each) for each in SPEEDS
    ),
    "It would be from {}, {}, {}, {} and {}° on if S were extrapolated without end": lambda: tuple(
        angle(velocity=each, resistance=held_from(90.0)) for each in SPEEDS
    ),
    "from {}, {}, {}, {} and {}° on if S were held from 55° on": lambda: tuple(
        angle(velocity=each, resistance=held_from(55.0)) for each in SPEEDS
    ),
    "A flat body of 80 mm at 85° and 238 m/s goes {} mm deep": lambda: (steep(PLAIN),),
    "made it go {} mm deep": lambda: (steep(held_from(90.0)),),
    "A moment 10 % larger moves the paper's angle by {}°": lambda: (heavier_to_turn(),),
    "at 238 m/s it is {} GPa at 48.6°, about {} ms after first contact and {} mm behind the tip": lambda: bending(
        48.6, PAPER_VELOCITY
    ),
    "and {} GPa at 45°": lambda: bending(45.0, PAPER_VELOCITY)[:1],
    "at 45° and 150 m/s it is {} GPa, and at 100 m/s {} GPa": lambda: (
        bending(45.0, 150.0)[0],
        bending(45.0, 100.0)[0],
    ),
    "perforation up to {}°, embedding up to {}°": changes_on_a_wall,
    "above that of the half-space by {}° for a wall of 5 diameters, {}° for 7 and {}° for 10": lambda: tuple(
        angle(target=wall(each * PAPER_PROJECTILE.diameter)) - angle() for each in (5.0, 7.0, 10.0)
    ),
    "The least thickness that stops this strike is {} m in normal impact and {} m at 30°": lambda: (
        thickness(),
        thickness(30.0),
    ),
    "perforated from {} m/s on in normal impact, and from {} m/s on at 20°": lambda: (
        limit_speed(0.0, 0.2),
        limit_speed(20.0, 0.2),
    ),
    "a wall of 0.2403 m stops the strike in normal impact with the nose {} mm out of its rear face": lambda: (
        protrusion(0.2403),
    ),
    "Nothing comes out of a wall of {} m, or of 0.2 m below {} m/s": without_protrusion,
    "the same body with a flat nose needs {} m, and with cones of length over diameter 0.1 and 0.5 it needs {} and "
    "{} m": lambda: tuple(
        thickness(projectile=replace(PAPER_PROJECTILE, nose=nose))
        for nose in (Flat(), Conical(length_to_diameter=0.1), Conical(length_to_diameter=0.5))
    ),
    "With the flat nose it goes {} m into a half-space": lambda: (run(0.0, projectile=FLAT).maximum_depth or math.nan,),
    "modified NDRC requires {} m, Degen {} m, and for flat noses Chang {} m and CEA-EDF {} m": lambda: (
        by_formula(PAPER_PROJECTILE, "modified_ndrc"),
        by_formula(PAPER_PROJECTILE, "degen"),
        by_formula(FLAT, "chang"),
        by_formula(FLAT, "cea_edf"),
    ),
    "which is {} mm high in concrete of 39 MPa": lambda: (
        1e3 * plug_height(resistance=WITH_PLUG, target=wall(1.0), projectile=PAPER_PROJECTILE),
    ),
    "With a plug the same strike needs {} m, and with a plug and a crater {} m": lambda: (
        thickness(resistance=WITH_PLUG),
        thickness(resistance=WITH_BOTH),
    ),
    "with a plug the paper's body perforates 50 mm from {} m/s on": lambda: (
        limit_speed(0.0, 0.05, resistance=WITH_PLUG),
    ),
    "the long projectile of the paper reaches {} GPa at its critical angle": lambda: bending(48.6, PAPER_VELOCITY)[:1],
    "a bending stress of {} GPa in the paper's projectile": lambda: bending(48.6, PAPER_VELOCITY)[:1],
    "The three available laws, Mohr-Coulomb, elastic-plastic (the default) and none, give {}°, {}° and {}°": lambda: (
        tuple(
            angle(resistance=Resistance(free_surface=each))
            for each in (MohrCoulomb(), ElasticPlastic(), NoFreeSurface())
        )
    ),
    "Mohr-Coulomb gives {}° with the S that was fitted together with it": lambda: (
        angle(resistance=with_own_fit(MohrCoulomb())),
    ),
    "the defaults of ricochet give {}°": lambda: (angle(),),
    "the default, gives a critical angle of {}° with eq. 9 for the paper's strike": lambda: (angle(),),
    "A crater of two diameters moves the critical angle of the paper's strike from {}° to {}°": lambda: (
        angle(),
        angle(resistance=WITH_CRATER),
    ),
}
PAGES = ("README.md", "docs/model.md", "docs/how-to/choose-laws.md", "docs/tutorial/danger-zone.md")
TEXT = " ".join(word for page in PAGES for word in (ROOT / page).read_text(encoding="utf-8").split())


def check(claim: str, text: str, computed: Numbers) -> None:
    """Check the numbers that stand in place of the braces in a claim, each to its last digit."""
    pattern = re.escape(claim).replace(r"\{\}", r"(\d+(?:\.\d+)?)")
    found = re.search(pattern, text)
    assert found is not None, f"{claim!r} is not stated"
    for stated, value in zip(found.groups(), computed, strict=True):
        last_digit = 10.0 ** -len(stated.partition(".")[2])
        # A little more than half a digit, because the last bits differ between processors.
        assert abs(float(stated) - value) <= 0.52 * last_digit, f"{found[0]!r}: computed is {value:.5g}, not {stated}"


@pytest.mark.parametrize("claim", CLAIMS)
def test_manual_states_the_computed_numbers(claim: str) -> None:
    check(claim, TEXT, CLAIMS[claim]())


def test_warning_about_craters_states_the_computed_numbers() -> None:
    check("from {}° to {}° at two diameters", CRATER_AT_OBLIQUITY.detail, (angle(), angle(resistance=WITH_CRATER)))
