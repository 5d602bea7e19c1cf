"""Front crater and rear plug: comparison with closed-form motions and the method `panels`, properties of any strike."""

import math
from dataclasses import replace
from typing import Any

import pytest

from solver import (
    ConstantStrengthFactor,
    Crater,
    Flat,
    Impact,
    NoFreeSurface,
    Numerics,
    Outcome,
    Projectile,
    Resistance,
    ShearPlug,
    Spherical,
    Target,
    Trajectory,
    critical_angle,
    formulas,
    least_thickness,
    limit_velocity,
    simulate,
)
from solver.formulas import spread
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import (
    CASE,
    assert_panels_follow_the_gauss_points,
    assert_work_is_the_energy_lost,
    codes,
    known,
    paper_run,
)

WALL = replace(PAPER_TARGET, thickness=0.2)
ROD = Projectile(nose=Flat(), diameter=0.05, length=0.4, mass=6.0)
STRESS = 8.0 * 39e6
FORCE = STRESS * math.pi * 0.025**2
"""Force on the flat nose of the rod for S = 8, without inertia and decay. [N]"""
PLAIN: dict[str, Any] = {
    "strength_factor": ConstantStrengthFactor(value=8.0),
    "inertia_factor": 0.0,
    "free_surface": NoFreeSurface(),
}


def rod_strikes(velocity: float, target: Target, **spalling: Any) -> Trajectory:
    return simulate(
        projectile=ROD,
        target=target,
        impact=Impact(velocity=velocity, oblique_angle=0.0),
        resistance=Resistance(**PLAIN, **spalling),
        numerics=Numerics(retention_energy_fraction=1e-4),
    )


def paper_strikes(angle: float, target: Target = WALL, **spalling: Any) -> Trajectory:
    return paper_run(angle, target=target, resistance=Resistance(**spalling), sample_interval=2e-6)


def test_rod_stops_in_a_crater_like_an_oscillator() -> None:
    found = rod_strikes(60.0, PAPER_TARGET, crater=Crater(depth_diameters=4.0))
    depth = 60.0 * math.sqrt(6.0 * 4.0 * 0.05 / FORCE)
    assert depth < 0.2
    assert found.maximum_depth == pytest.approx(depth, rel=2e-3)


def test_rod_leaves_a_wall_with_its_energy_at_the_plug() -> None:
    plug = ShearPlug()
    wall = replace(PAPER_TARGET, thickness=0.3)
    found = rod_strikes(300.0, wall, rear_plug=plug)
    reference = 8.84 * (50.0 / 76.2) ** -0.24  # S from the law of the published tests, for 39 MPa
    way = 0.3 - plug.height(strength_factor=reference, diameter=0.05)
    assert 0.1 < way < 0.3
    assert found.outcome is Outcome.PERFORATED
    assert found.final.kinetic_energy == pytest.approx(0.5 * 6.0 * 300.0**2 - FORCE * way, rel=1e-3)


def test_height_of_the_plug_follows_the_formula() -> None:
    # By hand: tan 66.1° = 2.2566, √3 · 8.52 · 2.2566 = 33.301, (√34.301 - 1) / (2 · 2.2566) = 1.0761.
    assert ShearPlug().height(strength_factor=8.52, diameter=0.08) == pytest.approx(1.0761 * 0.08, rel=1e-4)


def test_plug_is_at_most_nine_tenths_of_a_wall_with_a_warning() -> None:
    """The plug of the paper's strike would be 87 mm thick, 90 % of a wall of 97 mm; thinner walls cause a warning."""
    cases = ((0.05, True), (0.0969, True), (0.0972, False), (0.2, False))
    for thickness, bounded in cases:
        wall = replace(PAPER_TARGET, thickness=thickness)
        found = paper_strikes(0.0, wall, rear_plug=ShearPlug())
        assert found.outcome is Outcome.PERFORATED
        assert ("plug_through_wall" in codes(found)) is bounded
        lost = 0.5 * 13.0 * PAPER_VELOCITY**2 - found.final.kinetic_energy
        assert lost > 0.01 * 8.469 * 39e6 * math.pi * 0.04**2 * 0.1 * thickness
    still = rod_strikes(0.5, replace(PAPER_TARGET, thickness=0.02), rear_plug=ShearPlug())
    assert still.outcome is Outcome.EMBEDDED


@pytest.mark.parametrize("spalling", [{}, {"crater": Crater()}])
@pytest.mark.parametrize("thickness", [0.15, 0.24, 0.25])
def test_limit_speed_with_a_plug_rises_with_the_strength_factor(spalling: dict[str, Any], thickness: float) -> None:
    """The values of S are its 5, 50 and 95 % quantiles for this body and wall, and 14.5."""
    body = Projectile(nose=Spherical(caliber_radius_head=0.5), diameter=0.1683, length=0.64, mass=47.5)
    wall = Target(compressive_strength=60e6, density=2350.0, thickness=thickness)
    speeds = []
    for value in (3.96, 6.76, 11.56, 14.5):
        law = Resistance(strength_factor=ConstantStrengthFactor(value=value), rear_plug=ShearPlug(), **spalling)
        found = limit_velocity(projectile=body, target=wall, oblique_angle=0.0, resistance=law)
        speeds.append(known(found.value))
    assert speeds == sorted(speeds)
    assert speeds[0] > 10.0
    assert speeds[-1] > 1.3 * speeds[1]


@pytest.mark.parametrize("angle", [0.0, 25.0, 42.0, 55.0])
@pytest.mark.parametrize(
    "spalling", [{"rear_plug": ShearPlug()}, {"crater": Crater()}, {"rear_plug": ShearPlug(), "crater": Crater()}]
)
def test_panels_and_gauss_points_agree(angle: float, spalling: dict[str, Any]) -> None:
    impact, resistance = paper_impact(oblique_angle_degrees=angle), Resistance(**spalling)
    assert_panels_follow_the_gauss_points(
        projectile=PAPER_PROJECTILE, target=WALL, impact=impact, resistance=resistance
    )


@pytest.mark.parametrize("angle", [10.0, 45.0, 60.0])
def test_work_done_is_energy_lost(angle: float) -> None:
    run = paper_strikes(angle, crater=Crater(), rear_plug=ShearPlug())
    assert_work_is_the_energy_lost(known(run.history), rel=5e-3)


def test_plug_requires_a_thicker_wall_and_lowers_the_limit_speed() -> None:
    case: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET}
    plug = Resistance(rear_plug=ShearPlug())
    for angle in (0.0, 30.0):
        impact = paper_impact(oblique_angle_degrees=angle)
        without, with_plug = (least_thickness(**case, impact=impact, resistance=each) for each in (None, plug))
        assert without.value is not None
        height = ShearPlug().height(strength_factor=8.84 * (80.0 / 76.2) ** -0.24, diameter=0.08)
        assert without.value < known(with_plug.value) < without.value + height
        speeds = [
            limit_velocity(
                projectile=PAPER_PROJECTILE, target=WALL, oblique_angle=impact.oblique_angle, resistance=each
            )
            for each in (None, plug)
        ]
        assert known(speeds[1].value) < known(speeds[0].value)


def test_plug_does_not_affect_half_spaces_and_thick_walls() -> None:
    plug = Resistance(rear_plug=ShearPlug())
    case: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "velocity": PAPER_VELOCITY}
    plain, plugged = (critical_angle(**case, target=PAPER_TARGET, resistance=each) for each in (None, plug))
    assert plugged.angle == plain.angle
    thick = critical_angle(**case, target=replace(PAPER_TARGET, thickness=0.7), resistance=plug)
    assert thick.angle == pytest.approx(plain.angle, abs=math.radians(0.1))


def test_deeper_crater_raises_the_critical_angle_more() -> None:
    angles = []
    for diameters in (1e-3, 0.5, 1.0, 2.0):
        resistance = Resistance(crater=Crater(depth_diameters=diameters))
        found = critical_angle(**CASE, velocity=PAPER_VELOCITY, resistance=resistance)
        angles.append(math.degrees(known(found.angle)))
    assert angles[0] == pytest.approx(48.63, abs=0.05)
    assert angles == sorted(angles)
    assert 1.0 < angles[2] - angles[0] < 15.0


def test_warning_states_what_the_rear_face_model_omits() -> None:
    def codes(**spalling: Any) -> set[str]:
        return {warning.code for warning in paper_strikes(30.0, **spalling).warnings}

    assert "rear_face_unconservative" in codes() & codes(crater=Crater())
    assert "rear_plug_quasi_static" in codes(rear_plug=ShearPlug()) - codes()
    assert "crater_at_obliquity" in codes(crater=Crater()) - codes()


@pytest.mark.parametrize("spalling", [{}, {"crater": Crater()}, {"rear_plug": ShearPlug()}])
def test_warning_about_the_rear_face_states_the_formulas_for_the_strike(spalling: dict[str, Any]) -> None:
    def detail(impact: Impact) -> str:
        run = paper_run(30.0, target=WALL, impact=impact, resistance=Resistance(**spalling), sample_interval=None)
        (found,) = (each for each in run.warnings if each.code.startswith("rear_"))
        return found.detail

    impact = paper_impact(oblique_angle_degrees=30.0)
    answers = formulas(**CASE, impact=impact)
    found = spread(answers, "perforation_thickness")
    assert found is not None
    assert detail(impact).endswith(
        f"against 238 m/s at 30° from the normal {found.count} formulas within their range require "
        f"{math.ceil(1e3 * found.lowest)} to {math.ceil(1e3 * found.highest)} mm"
    )
    fast = replace(impact, velocity=1000.0)
    assert detail(fast).endswith("no formula is within its range for 1000 m/s at 30° from the normal")
