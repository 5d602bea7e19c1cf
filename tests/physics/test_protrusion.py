"""Greatest depth of a body and protrusion from the rear face, compared with points of its outline."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver import (
    Conical,
    ConstantStrengthFactor,
    Crater,
    Flat,
    Impact,
    Numerics,
    Ogive,
    Outcome,
    PerforationStatus,
    Projectile,
    Resistance,
    ShearPlug,
    Sphere,
    Target,
    Trajectory,
    columns,
    least_thickness,
    limit_velocity,
    mass_properties,
    simulate,
)
from solver.arrays import FloatArray
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import CASE, NOSES, STEEL, known

PIECE = np.linspace(0.0, 1.0, 2001)


def deepest_points(projectile: Projectile, run: Trajectory) -> FloatArray:
    """Return the greatest depth of many points of the outline at each instant of a history. [m]"""
    motion = known(run.history)
    pieces = [piece.at(PIECE) for piece in projectile.outline()]
    ahead = mass_properties(projectile).center_of_gravity - np.concatenate([x for x, *_ in pieces])
    radius = np.concatenate([r for _, r, *_ in pieces])
    turned = np.outer(np.cos(motion.axis_angle), ahead) + np.outer(np.abs(np.sin(motion.axis_angle)), radius)
    return np.asarray(motion.center_of_gravity_depth + turned.max(axis=1))


def wall(thickness: float) -> Target:
    return replace(PAPER_TARGET, thickness=thickness)


@pytest.mark.parametrize("nose", NOSES)
@pytest.mark.parametrize("degrees", [0.0, 40.0, 75.0, 86.0])
def test_greatest_depth_belongs_to_the_deepest_point_of_every_shape(nose: str, degrees: float) -> None:
    """The tolerance is the change of depth within half a sample interval near the maximum.

    Another point is deeper than the tip if a blunt nose is tilted, or if the axis is nearly parallel to the face.
    """
    body = replace(PAPER_PROJECTILE, nose=NOSES[nose])
    run = simulate(
        projectile=body, target=PAPER_TARGET, impact=paper_impact(oblique_angle_degrees=degrees), sample_interval=2e-6
    )
    deepest = deepest_points(body, run)
    assert run.maximum_depth == pytest.approx(deepest.max(), abs=2e-7)
    assert known(run.maximum_depth) > 0.0


@pytest.mark.parametrize("spin", [0.0, 900.0])
def test_depth_of_a_spinning_sphere_is_the_depth_of_its_front(spin: float) -> None:
    sphere = Projectile(nose=Sphere(), diameter=0.02, length=0.02, mass=STEEL * math.pi / 6.0 * 0.02**3)
    impact = Impact(velocity=300.0, oblique_angle=math.radians(20.0), angular_velocity=spin)
    run = simulate(projectile=sphere, target=PAPER_TARGET, impact=impact, sample_interval=1e-7)
    center = known(run.history).center_of_gravity_depth
    assert run.maximum_depth == pytest.approx(center.max() + 0.01, abs=1e-6)


@pytest.mark.parametrize(("degrees", "thickness"), [(0.0, 0.25), (20.0, 0.25), (40.0, 0.22), (49.0, 0.17)])
def test_protrusion_is_the_distance_of_the_deepest_point_from_the_rear_face(degrees: float, thickness: float) -> None:
    impact = paper_impact(oblique_angle_degrees=degrees)
    run = simulate(projectile=PAPER_PROJECTILE, target=wall(thickness), impact=impact, sample_interval=2e-6)
    assert run.outcome is Outcome.EMBEDDED
    found, beyond = known(run.protrusion), deepest_points(PAPER_PROJECTILE, run) - thickness
    assert found.greatest == pytest.approx(beyond.max(), abs=1e-6)
    assert found.final == pytest.approx(beyond[-1], abs=1e-6)
    assert known(run.maximum_depth) == pytest.approx(thickness + found.greatest)
    assert f"{run.maximum_depth:.3f} m deep" in repr(run)


def test_both_routes_give_the_same_protrusion() -> None:
    strike: dict[str, Any] = {
        "projectile": PAPER_PROJECTILE,
        "target": wall(0.25),
        "impact": paper_impact(oblique_angle_degrees=20.0),
        "sample_interval": None,
    }
    panels = Numerics(method="panels", panels=48_000, time_step=1e-6, termination_time=4e-3)
    one, other = simulate(**strike), simulate(**strike, numerics=panels)
    assert known(one.protrusion).greatest == pytest.approx(known(other.protrusion).greatest, abs=0.02 * 0.08)


def test_projectile_turned_away_has_no_final_protrusion() -> None:
    blunt = Projectile(nose=Conical(length_to_diameter=0.13), diameter=0.0112, length=0.044, mass=0.049)
    run = simulate(
        projectile=blunt,
        target=Target(compressive_strength=84e6, density=2085.0, thickness=3.25e-3),
        impact=Impact(velocity=60.0, oblique_angle=math.radians(80.6), angular_velocity=55.0),
        resistance=Resistance(strength_factor=ConstantStrengthFactor(value=7.14), crater=Crater(depth_diameters=1.4)),
        sample_interval=1e-6,
    )
    assert run.outcome is Outcome.RICOCHET
    found = known(run.protrusion)
    assert found.final is None
    assert found.greatest == pytest.approx(deepest_points(blunt, run).max() - 3.25e-3, abs=1e-7)


def test_perforation_has_no_depth_and_thick_concrete_no_protrusion() -> None:
    runs = [
        simulate(**CASE | {"target": target}, impact=paper_impact(oblique_angle_degrees=0.0), sample_interval=None)
        for target in (wall(0.2), wall(0.25), wall(0.4), PAPER_TARGET)
    ]
    assert [run.outcome for run in runs] == [Outcome.PERFORATED, *[Outcome.EMBEDDED] * 3]
    assert [run.maximum_depth is None for run in runs] == [True, False, False, False]
    assert [run.protrusion is None for run in runs] == [True, False, True, True]
    assert "deep" not in repr(runs[0])
    table = columns(runs)
    assert np.isnan(table["maximum_depth"]).tolist() == [True, False, False, False]
    assert np.isnan(table["protrusion_greatest"]).tolist() == [True, False, True, True]
    assert table["protrusion_final"][1] == known(runs[1].protrusion).final


SPALLED = Resistance(rear_plug=ShearPlug(), crater=Crater())


@pytest.mark.parametrize("resistance", [Resistance(), SPALLED])
@pytest.mark.parametrize("body", [PAPER_PROJECTILE, replace(PAPER_PROJECTILE, nose=Flat())])
@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_answers_without_protrusion_are_limits_of_protrusion(
    resistance: Resistance, body: Projectile, degrees: float
) -> None:
    strike: dict[str, Any] = {"projectile": body, "resistance": resistance}
    impact = paper_impact(oblique_angle_degrees=degrees)
    thickness = least_thickness(**strike, target=PAPER_TARGET, impact=impact)
    speed = limit_velocity(**strike, target=wall(0.3), oblique_angle=impact.oblique_angle)

    def comes_out(thickness: float, velocity: float) -> bool:
        struck = replace(impact, velocity=velocity)
        run = simulate(**strike, target=wall(thickness), impact=struck, sample_interval=None)
        return run.protrusion is not None or run.outcome is Outcome.PERFORATED

    least, most = known(thickness.without_protrusion), known(speed.without_protrusion)
    assert comes_out(0.999 * least, PAPER_VELOCITY)
    assert not comes_out(1.001 * least, PAPER_VELOCITY)
    assert comes_out(0.3, 1.001 * most)
    assert not comes_out(0.3, 0.999 * most)
    assert least >= known(thickness.value)
    assert most < known(speed.value)
    tried = {trial.value: trial for trial in thickness.iterations}
    assert not tried[least].comes_out
    # A flat nose meets no resistance once its face is out, so a body that protrudes at all perforates.
    if isinstance(body.nose, Ogive):
        assert known(tried[known(thickness.value)].protrusion).greatest > 0.1 * body.diameter


def test_value_without_protrusion_is_none_if_there_is_none() -> None:
    impact = Impact(velocity=20.0, oblique_angle=math.radians(85.0))
    assert least_thickness(**CASE, impact=impact).without_protrusion is None
    thick = limit_velocity(projectile=PAPER_PROJECTILE, target=wall(100.0), oblique_angle=0.0)
    assert (thick.status, thick.without_protrusion) == (PerforationStatus.NEVER_PERFORATED, None)
    slender = Projectile(nose=Ogive(caliber_radius_head=10.0), diameter=0.02, length=2.0, mass=4.0)
    held = limit_velocity(projectile=slender, target=wall(3.0), oblique_angle=0.0)
    assert held.without_protrusion is not None
