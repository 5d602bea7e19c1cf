"""Least thickness and limit velocity, compared with an independent program and with runs just below and above them."""

import math
from dataclasses import replace

import pytest

from solver import (
    Impact,
    Numerics,
    Outcome,
    ParameterError,
    PerforationStatus,
    Projectile,
    Spherical,
    Target,
    least_thickness,
    limit_velocity,
    simulate,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import CASE, codes, known

WALL = replace(PAPER_TARGET, thickness=0.2)


def outcome(target: Target, impact: Impact) -> Outcome:
    return simulate(projectile=PAPER_PROJECTILE, target=target, impact=impact, sample_interval=None).outcome


@pytest.mark.parametrize(("angle", "thickness"), [(0.0, 0.2404), (30.0, 0.2233)])
def test_least_thickness_agrees_with_an_independent_program(angle: float, thickness: float) -> None:
    impact = paper_impact(oblique_angle_degrees=angle)
    found = least_thickness(**CASE, impact=impact)
    assert found.status is PerforationStatus.CONVERGED
    assert found.value == pytest.approx(thickness, abs=5e-4)
    thin, thick = known(found.bracket)
    assert thick == found.value
    assert thick - thin <= 1e-4 * thick
    assert outcome(replace(PAPER_TARGET, thickness=0.999 * thin), impact) is Outcome.PERFORATED
    assert outcome(replace(PAPER_TARGET, thickness=1.001 * thick), impact) is Outcome.EMBEDDED
    assert [warning.code for warning in found.warnings].count("rear_face_unconservative") == 1


@pytest.mark.parametrize(("angle", "velocity"), [(0.0, 214.2), (20.0, 218.7)])
def test_limit_velocity_agrees_with_an_independent_program(angle: float, velocity: float) -> None:
    found = limit_velocity(projectile=PAPER_PROJECTILE, target=WALL, oblique_angle=math.radians(angle))
    assert found.value == pytest.approx(velocity, abs=0.3)
    perforated = [trial.value for trial in found.iterations if trial.outcome is Outcome.PERFORATED]
    assert min(perforated) == found.value
    assert max(trial.value for trial in found.iterations if trial.value not in perforated) == known(found.bracket)[0]


def test_thickness_and_velocity_are_inverse_functions() -> None:
    wall = least_thickness(**CASE, impact=paper_impact(oblique_angle_degrees=10.0))
    back = limit_velocity(
        projectile=PAPER_PROJECTILE,
        target=replace(PAPER_TARGET, thickness=known(wall.value)),
        oblique_angle=math.radians(10.0),
    )
    assert back.value == pytest.approx(PAPER_VELOCITY, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 30.0])
def test_warnings_belong_to_the_wall_of_least_thickness(angle: float) -> None:
    """The sphere stops within the crater, which causes a warning that perforating runs do not have."""
    sphere = Projectile(nose=Spherical(caliber_radius_head=0.5), diameter=0.08, length=0.08, mass=2.1)
    impact = replace(paper_impact(oblique_angle_degrees=angle), velocity=100.0)
    found = least_thickness(projectile=sphere, target=PAPER_TARGET, impact=impact)
    wall = replace(PAPER_TARGET, thickness=1.001 * known(found.value))
    run = simulate(projectile=sphere, target=wall, impact=impact, sample_interval=None)
    assert codes(found) == codes(run)
    assert "shallow_penetration" in codes(found)


SHORT = Numerics(termination_time=4e-3)
"""Numerics with a termination time at which slow projectiles, and all projectiles in thick walls, still move."""


def test_limit_next_to_a_trial_in_motion_is_uncertain() -> None:
    impact = paper_impact(oblique_angle_degrees=0.0)
    thickness = least_thickness(**CASE, impact=impact, numerics=SHORT)
    velocity = limit_velocity(projectile=PAPER_PROJECTILE, target=WALL, oblique_angle=0.0, numerics=SHORT)
    for found in (thickness, velocity):
        ends = {trial.outcome for trial in found.iterations if found.bracket and trial.value in found.bracket}
        assert ends == {Outcome.PERFORATED, Outcome.IN_MOTION}
        (undecided,) = (warning for warning in found.warnings if warning.code == "undecided")
        assert "next to a change of outcome" in undecided.detail
    usual = least_thickness(**CASE, impact=impact)
    assert known(thickness.value) < known(usual.value)
    assert "undecided" not in codes(usual)


def test_search_without_a_limit_warns_of_trials_in_motion() -> None:
    impact = paper_impact(oblique_angle_degrees=0.0)
    numerics = Numerics(termination_time=2e-3)
    found = least_thickness(**CASE, impact=impact, numerics=numerics)
    assert found.status is PerforationStatus.NEVER_PERFORATED
    assert found.iterations[0].outcome is Outcome.IN_MOTION
    assert [warning.code for warning in found.warnings].count("undecided") == 1


def test_finer_runs_find_the_same_limits() -> None:
    strike = CASE | {"impact": paper_impact(oblique_angle_degrees=0.0)}
    usual = least_thickness(**strike).value
    fine = least_thickness(**strike, numerics=Numerics(relative_tolerance=1e-7, stations=16, points=6), tolerance=1e-5)
    assert usual == pytest.approx(fine.value, rel=2e-4)


def test_strike_turned_away_by_any_wall_perforates_none() -> None:
    impact = Impact(velocity=20.0, oblique_angle=math.radians(85.0))
    found = least_thickness(**CASE, impact=impact)
    assert found.status is PerforationStatus.NEVER_PERFORATED
    assert (found.value, found.bracket, len(found.iterations)) == (None, None, 1)


def test_wall_that_no_speed_perforates_has_that_status() -> None:
    wall = replace(PAPER_TARGET, thickness=100.0)
    found = limit_velocity(projectile=PAPER_PROJECTILE, target=wall, oblique_angle=0.0)
    assert found.status is PerforationStatus.NEVER_PERFORATED
    assert found.value is None


def test_quantity_searched_for_must_not_be_given() -> None:
    with pytest.raises(ParameterError, match=r"target\.thickness.*must not be given"):
        least_thickness(projectile=PAPER_PROJECTILE, target=WALL, impact=paper_impact(oblique_angle_degrees=0.0))
    with pytest.raises(ParameterError, match=r"target\.thickness.*must be given"):
        limit_velocity(**CASE, oblique_angle=0.0)


def test_trials_of_a_wall_become_columns() -> None:
    impact = paper_impact(oblique_angle_degrees=0.0)
    found = least_thickness(**CASE, impact=impact, tolerance=0.01)
    columns = found.columns()
    assert columns["value"].tolist() == [trial.value for trial in found.iterations]
    assert set(columns["outcome"]) == {"perforated", "embedded"}
