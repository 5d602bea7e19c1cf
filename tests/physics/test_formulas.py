"""Worked values, branches and ranges of the empirical formulas."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from solver import (
    FormulaResult,
    Impact,
    Ogive,
    ParameterError,
    Projectile,
    Spherical,
    Target,
    cea_edf_limit_speed,
    closed_form_depth,
    formulas,
)
from solver.formulas import NDRC_CONSTANT, li_chen, modified_ndrc
from solver.nose import Flat

FORRESTAL_SHOT = Projectile(nose=Ogive(caliber_radius_head=2.0), diameter=0.0269, length=0.2423, mass=0.906)
FORRESTAL_TARGET = Target(compressive_strength=35.2e6, density=2370.0)
"""Shot of Forrestal, Altman, Cargile and Hanchak (1994) with a measured depth of 173 mm, 6.43 diameters, at 277 m/s."""
PAPER = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
PAPER_TARGET = Target(compressive_strength=39e6, density=2250.0)


def by_name(projectile: Projectile, target: Target, impact: Impact) -> dict[str, FormulaResult]:
    return {answer.formula: answer for answer in formulas(projectile=projectile, target=target, impact=impact)}


def normal(velocity: float) -> Impact:
    return Impact(velocity=velocity, oblique_angle=0.0)


def depth_in_diameters(answer: FormulaResult, projectile: Projectile) -> float:
    assert answer.penetration_depth is not None
    return answer.penetration_depth / projectile.diameter


def test_published_shot_by_li_chen_and_ndrc() -> None:
    answer = li_chen(projectile=FORRESTAL_SHOT, target=FORRESTAL_TARGET, impact=normal(277.0), strength_factor=12.0)
    assert depth_in_diameters(answer, FORRESTAL_SHOT) == pytest.approx(6.21, abs=0.03)
    ndrc = modified_ndrc(projectile=FORRESTAL_SHOT, target=FORRESTAL_TARGET, impact=normal(277.0))
    assert depth_in_diameters(ndrc, FORRESTAL_SHOT) == pytest.approx(5.11, abs=0.005)


def test_closed_form_is_li_chen_with_a_crater_of_two_diameters() -> None:
    """Only the depth of the crater differs: 0.707 diameters and the nose, for two diameters."""
    projectile = replace(FORRESTAL_SHOT, nose=Ogive(caliber_radius_head=(1.0 + (2.0 * 1.293) ** 2) / 4.0))
    ours = closed_form_depth(projectile=projectile, target=FORRESTAL_TARGET, velocity=277.0, strength_factor=12.0)
    answer = li_chen(projectile=projectile, target=FORRESTAL_TARGET, impact=normal(277.0), strength_factor=12.0)
    assert answer.penetration_depth == pytest.approx(ours, rel=1e-9)


def test_heavy_sphere_by_ndrc() -> None:
    """100 kg, 0.2898 m, 60 m/s on 10 MPa: G = 0.0514 and x/d = 0.4535 with the constant of the US form."""
    sphere = Projectile(nose=Spherical(caliber_radius_head=0.5), diameter=0.2898, length=0.2898, mass=100.0)
    answer = modified_ndrc(
        projectile=sphere, target=Target(compressive_strength=10e6, density=2250.0), impact=normal(60.0)
    )
    ratio = depth_in_diameters(answer, sphere)
    assert (ratio / 2.0) ** 2 == pytest.approx(0.0514, abs=5e-5)
    assert ratio == pytest.approx(0.4535, abs=2e-4)


def test_constant_of_ndrc_from_us_units() -> None:
    """180 N W / (d sqrt(f'c)) (V / (1000 d))^1.8 in lb, in, ft/s and psi is 0.1 % above the constant in SI units."""
    pound, inch, foot, psi = 0.45359237, 0.0254, 0.3048, 6894.757
    converted = 180.0 / pound * inch * math.sqrt(psi) * (inch / foot / 1000.0) ** 1.8
    assert converted == pytest.approx(3.8034e-5, rel=2e-4)
    assert converted / NDRC_CONSTANT == pytest.approx(1.001, abs=5e-4)


def test_paper_strike_by_every_formula() -> None:
    """Figures worked out by hand for 238 m/s along the normal. [m]"""
    answers = by_name(PAPER, PAPER_TARGET, normal(238.0))
    ndrc = answers["modified_ndrc"]
    assert ndrc.penetration_depth == pytest.approx(0.241, abs=5e-4)
    assert ndrc.perforation_thickness == pytest.approx(0.405, abs=5e-4)
    assert ndrc.scabbing_thickness == pytest.approx(0.498, abs=5e-4)
    assert answers["degen"].perforation_thickness == pytest.approx(0.367, abs=7e-4)
    assert answers["chang"].perforation_thickness == pytest.approx(0.346, abs=5e-4)
    assert answers["chang"].scabbing_thickness == pytest.approx(0.522, abs=5e-4)
    assert answers["cea_edf"].perforation_thickness == pytest.approx(0.344, abs=5e-4)
    assert answers["kar"].perforation_thickness == ndrc.perforation_thickness


def test_limit_speed_of_cea_edf_inverts_its_thickness() -> None:
    thickness = by_name(PAPER, PAPER_TARGET, normal(150.0))["cea_edf"].perforation_thickness
    assert thickness is not None
    speed = cea_edf_limit_speed(projectile=PAPER, target=PAPER_TARGET, thickness=thickness)
    assert speed == pytest.approx(150.0, rel=3e-3)


@pytest.mark.parametrize("name", ["modified_ndrc", "degen", "ukaea", "hughes", "li_chen", "kar"])
@pytest.mark.parametrize("nose", [Flat(), Ogive(caliber_radius_head=3.0)])
def test_branches_meet(name: str, nose: Flat | Ogive) -> None:
    """No limit jumps by more than the printed digits allow as the speed rises through the branches."""
    projectile = replace(PAPER, nose=nose)
    speeds = [20.0 * 1.002**step for step in range(1800)]
    answers = [by_name(projectile, PAPER_TARGET, normal(speed))[name] for speed in speeds]
    for quantity in ("penetration_depth", "scabbing_thickness", "perforation_thickness"):
        values = [getattr(answer, quantity) for answer in answers]
        if values[0] is None:
            continue
        steps = [after / before - 1.0 for before, after in pairwise(values)]
        assert min(steps) > -0.01, quantity  # parabolas of NDRC turn at their ends
        assert max(steps) < 0.02, quantity


def test_oblique_strike_counts_with_its_normal_component() -> None:
    oblique = by_name(PAPER, PAPER_TARGET, Impact(velocity=238.0, oblique_angle=math.radians(60.0)))
    assert {name: answer.penetration_depth for name, answer in oblique.items()} == pytest.approx(
        {name: answer.penetration_depth for name, answer in by_name(PAPER, PAPER_TARGET, normal(119.0)).items()}
    )


def test_range_names_the_input_the_bounds_and_the_value() -> None:
    fast = by_name(PAPER, replace(PAPER_TARGET, compressive_strength=60e6), normal(400.0))
    assert [item.field for item in fast["chang"].out_of_range] == ["impact.velocity", "target.compressive_strength"]
    assert fast["chang"].out_of_range[1].detail == "fitted from 23 to 46 MPa, here 60"
    assert not fast["chang"].in_range
    assert by_name(PAPER, PAPER_TARGET, normal(150.0))["chang"].in_range
    assert by_name(PAPER, PAPER_TARGET, normal(150.0))["cea_edf"].in_range


def test_strike_along_the_face_is_refused() -> None:
    with pytest.raises(ParameterError, match="oblique_angle"):
        formulas(projectile=PAPER, target=PAPER_TARGET, impact=Impact(velocity=238.0, oblique_angle=math.pi / 2.0))
