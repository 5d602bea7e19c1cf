"""Walls with a rear face, compared with an independent brute-force program, and properties of any wall."""

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from solver import (
    CriticalAngle,
    Impact,
    IntegrationError,
    MohrCoulomb,
    Numerics,
    ObliquityPolynomial,
    Ogive,
    Outcome,
    ParameterError,
    Projectile,
    Resistance,
    Search,
    StrengthPowerLaw,
    Target,
    Trajectory,
    critical_angle,
    least_thickness,
    least_thickness_many,
    limit_velocity,
    limit_velocity_many,
    simulate,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, paper_impact

from .strikes import (
    CASE,
    assert_panels_follow_the_gauss_points,
    assert_work_is_the_energy_lost,
    known,
    mirrored,
    paper_run,
    strikes,
)

WALL = replace(PAPER_TARGET, thickness=0.2)
"""Wall of the reference values. The independent program that computed them used elastic-plastic decay, eq. 9, 344 rows
of 40 panels and steps of 1 µs."""


def strike(angle: float, target: Target = WALL, **options: Any) -> Trajectory:
    return paper_run(angle, **{"target": target, "sample_interval": None} | options)


def search(target: Target = WALL, **options: Any) -> CriticalAngle:
    return critical_angle(projectile=PAPER_PROJECTILE, target=target, velocity=PAPER_VELOCITY, **options)


ROWS = [
    (0.0, Outcome.PERFORATED, 104.4, 104.4, 0.0, 0.0, 0.192),
    (20.0, Outcome.PERFORATED, 92.8, 87.8, 30.1, 19.2, 0.152),
    (40.0, Outcome.PERFORATED, 45.4, 33.6, 30.5, 42.5, 0.036),
    (52.0, Outcome.RICOCHET, 101.1, -33.2, 95.5, 100.1, 0.182),
]
"""Angle, outcome, exit speed, its components, axis angle and energy left over initial energy, by the
independent program. [°, m/s, °, 1]"""
IN_ITS_HOLE = {20.0, 40.0}
"""Angles at which the shank stops moving sideways in its hole and slides on along its axis. The load then
changes sign within every fixed step, which slowly turns the axis back, in proportion to the step: by 3° at 10 µs and by
0.4° at the 1 µs of the independent program. Adaptive steps do not have this error."""


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]:g} degrees")
def test_exit_state_agrees_with_an_independent_program(row: tuple[Any, ...]) -> None:
    angle, outcome, speed, depth_velocity, lateral_velocity, axis_angle, energy = row
    run = strike(angle)
    parts, degrees = (1.0, 0.6) if angle in IN_ITS_HOLE else (0.5, 0.3)
    assert run.outcome is outcome
    assert math.hypot(run.final.depth_velocity, run.final.lateral_velocity) == pytest.approx(speed, abs=0.5)
    assert run.final.depth_velocity == pytest.approx(depth_velocity, abs=parts)
    assert run.final.lateral_velocity == pytest.approx(lateral_velocity, abs=parts)
    assert math.degrees(run.final.axis_angle) == pytest.approx(axis_angle, abs=degrees)
    assert run.final.kinetic_energy == pytest.approx(energy * 0.5 * 13.0 * PAPER_VELOCITY**2, rel=0.01)


@pytest.mark.parametrize("row", [row for row in ROWS if row[0] in IN_ITS_HOLE], ids=lambda row: f"{row[0]:g} degrees")
def test_exit_state_by_panels_converges_to_the_default_method(row: tuple[Any, ...]) -> None:
    angle, _, _, depth_velocity, lateral_velocity, axis_angle, _ = row
    short, long = (
        strike(angle, numerics=Numerics(method="panels", time_step=step, termination_time=0.015)).final
        for step in (1e-6, 2e-6)
    )
    assert short.depth_velocity == pytest.approx(depth_velocity, abs=0.5)
    assert short.lateral_velocity == pytest.approx(lateral_velocity, abs=0.5)
    assert math.degrees(short.axis_angle) == pytest.approx(axis_angle, abs=0.3)
    no_step = 2.0 * short.axis_angle - long.axis_angle
    assert math.degrees(strike(angle).final.axis_angle) == pytest.approx(math.degrees(no_step), abs=0.1)


def test_searches_for_walls_accept_an_impact_or_its_numbers() -> None:
    impact = paper_impact(oblique_angle_degrees=20.0)
    angle = impact.oblique_angle
    options: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "tolerance": 0.05}
    solid, wall = options | {"target": PAPER_TARGET}, options | {"target": replace(PAPER_TARGET, thickness=0.2)}
    assert least_thickness(**solid, impact=impact) == least_thickness(
        **solid, velocity=PAPER_VELOCITY, oblique_angle=angle
    )
    assert limit_velocity(**wall, impact=impact) == limit_velocity(**wall, oblique_angle=angle)
    assert list(least_thickness_many(**solid, velocity=[PAPER_VELOCITY], oblique_angle=angle)) == list(
        least_thickness_many(**solid, impact=[impact])
    )
    assert list(limit_velocity_many(**wall, impact=impact)) == list(limit_velocity_many(**wall, oblique_angle=[angle]))
    wrong: list[tuple[Any, dict[str, Any], str]] = [
        (least_thickness, solid, "velocity"),
        (least_thickness, solid | {"velocity": 238.0}, "oblique_angle"),
        (limit_velocity, wall, "oblique_angle"),
        (limit_velocity, wall | {"impact": impact, "oblique_angle": 0.0}, "oblique_angle"),
        (least_thickness, solid | {"impact": impact, "angle_of_attack": 0.1}, "angle_of_attack"),
    ]
    for function, arguments, field in wrong:
        with pytest.raises(ParameterError, match=f"^{field}: "):
            function(**arguments)


def test_wall_holds_the_projectile_between_perforation_and_ricochet() -> None:
    assert strike(46.0).outcome is Outcome.EMBEDDED


def test_search_agrees_with_an_independent_program_in_angle_and_outcomes() -> None:
    found = search()
    assert found.angle is not None
    assert math.degrees(found.angle) == pytest.approx(50.92, abs=0.03)
    intervals = found.outcomes
    assert [each.outcome for each in intervals] == [Outcome.PERFORATED, Outcome.EMBEDDED, Outcome.RICOCHET]
    assert [intervals[0].lower, intervals[2].upper] == list(Search().bounds)
    assert intervals[2].lower == found.angle
    assert [each.upper for each in intervals[:2]] == [each.lower for each in intervals[1:]]
    for before, after in itertools.pairwise(intervals):
        assert strike(math.degrees(before.upper) - 0.02).outcome is before.outcome
        assert strike(math.degrees(after.lower) + 0.01).outcome is after.outcome


def test_half_space_has_no_intervals() -> None:
    assert search(PAPER_TARGET).outcomes == ()


@pytest.mark.parametrize(("diameters", "degrees"), [(5.0, 0.25), (7.0, 0.1), (25.0, 0.01)])
def test_thick_wall_has_the_critical_angle_of_the_half_space(diameters: float, degrees: float) -> None:
    wall, half_space = search(replace(WALL, thickness=diameters * PAPER_PROJECTILE.diameter)), search(PAPER_TARGET)
    assert abs(math.degrees(known(wall.angle) - known(half_space.angle))) < degrees


OFTEN_RUN = {(20.0, 0.2), (52.0, 0.2)}
HISTORIES = [
    pytest.param(angle, thickness, marks=() if (angle, thickness) in OFTEN_RUN else pytest.mark.slow)
    for angle in (0.0, 20.0, 40.0, 52.0)
    for thickness in (0.1, 0.2, 0.3)
]


@pytest.mark.parametrize(("angle", "thickness"), HISTORIES)
def test_brute_force_follows_the_same_history(angle: float, thickness: float) -> None:
    impact = paper_impact(oblique_angle_degrees=angle)
    wall = replace(WALL, thickness=thickness)
    assert_panels_follow_the_gauss_points(projectile=PAPER_PROJECTILE, target=wall, impact=impact)


@settings(max_examples=8)
@given(strikes(), st.floats(0.5, 5.0))
def test_work_of_the_resistance_of_a_wall_equals_the_energy_lost(arguments: dict[str, Any], diameters: float) -> None:
    diameter, impact = arguments["projectile"].diameter, arguments["impact"]
    wall = replace(arguments["target"], thickness=diameters * diameter)
    interval = 1e-3 * diameter / impact.velocity
    run = simulate(**arguments | {"target": wall}, sample_interval=interval)
    assume(run.outcome is not Outcome.IN_MOTION)
    assert_work_is_the_energy_lost(known(run.history), rel=2e-3)


@settings(max_examples=5)
@given(strikes(), st.floats(0.5, 5.0))
def test_mirrored_strike_on_a_wall_has_the_mirrored_motion(arguments: dict[str, Any], diameters: float) -> None:
    target = replace(arguments["target"], thickness=diameters * arguments["projectile"].diameter)
    impact = arguments["impact"]
    impacts = impact, mirrored(impact)
    left, right = (simulate(**arguments | {"target": target, "impact": each}, sample_interval=None) for each in impacts)
    assert left.outcome is right.outcome
    assert left.final.depth_velocity == pytest.approx(right.final.depth_velocity, rel=1e-9, abs=1e-6)
    assert left.final.axis_angle == pytest.approx(-right.final.axis_angle, rel=1e-9, abs=1e-6)


@settings(max_examples=50)
@given(strikes(), st.floats(0.2, 6.0), st.floats(1.05, 3.0))
def test_wall_thicker_than_an_unperforated_one_is_not_perforated(
    arguments: dict[str, Any], diameters: float, ratio: float
) -> None:
    thin = diameters * arguments["projectile"].diameter
    outcomes = [
        simulate(**arguments | {"target": replace(arguments["target"], thickness=each)}, sample_interval=None).outcome
        for each in (thin, ratio * thin)
    ]
    assume(Outcome.IN_MOTION not in outcomes)
    assert outcomes[1] is not Outcome.PERFORATED or outcomes[0] is Outcome.PERFORATED


def test_plate_thinner_than_a_tenth_of_the_diameter_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"target\.thickness.*a tenth of the diameter, 0\.008 m.*bending"):
        strike(20.0, replace(WALL, thickness=0.0079))


def test_answer_about_a_wall_warns_that_it_is_not_conservative() -> None:
    assert "rear_face_unconservative" in [each.code for each in strike(20.0).warnings]
    assert "rear_face_unconservative" not in [each.code for each in strike(20.0, PAPER_TARGET).warnings]


@pytest.mark.parametrize(("thickness", "moves"), [(0.05, False), (0.1, False), (0.2, True), (0.18, True)])
def test_change_to_perforation_that_depends_on_the_retention_energy_causes_a_warning(
    thickness: float, moves: bool
) -> None:
    wall = replace(PAPER_TARGET, thickness=thickness)
    least, most = (_perforated_up_to(search(wall, numerics=Numerics(retention_energy_fraction=e))) for e in (1e-3, 0.1))
    assert (least - most > 0.5) == moves
    found = search(wall, search=Search(upper=math.radians(least + 1.0)))
    assert ("retention_decides_perforation" in [each.code for each in found.warnings]) == moves


def _perforated_up_to(found: CriticalAngle) -> float:
    """Return the largest angle at which the wall is perforated. [°]"""
    return math.degrees(next(each.upper for each in found.outcomes if each.outcome is Outcome.PERFORATED))


def test_warning_about_a_change_near_the_normal_states_the_energy_at_the_normal() -> None:
    limit = least_thickness(**CASE, impact=paper_impact(oblique_angle_degrees=0.0))
    wall = replace(PAPER_TARGET, thickness=0.9998 * known(limit.value))
    found = search(wall, search=Search(lower=0.0, upper=math.radians(5.0), tolerance=math.radians(0.01)))
    assert 0.0 < _perforated_up_to(found) < 0.5
    (detail,) = (each.detail for each in found.warnings if each.code == "retention_decides_perforation")
    assert "half a degree inside 1 %" in detail


TUMBLING: dict[str, Any] = {
    "projectile": Projectile(
        nose=Ogive(caliber_radius_head=2.138339435115425),
        diameter=0.09735998346263668,
        length=0.8502825430574642,
        mass=33.98285616711883,
    ),
    "target": Target(compressive_strength=83506119.05974251, density=2488.7656325658056, thickness=0.0701537343192152),
    "resistance": Resistance(
        strength_factor=ObliquityPolynomial(held_from=math.radians(90.0)), free_surface=MohrCoulomb()
    ),
}
"""A strike whose S is nearly zero at grazing angles, because eq. 9 is not held."""


def test_tumbling_in_a_wall_causes_a_warning() -> None:
    """From 84.2 to 84.9°, between two trial angles of the search, the projectile would tumble in the wall."""
    attack, velocity = 0.03895949452329724, 598.1511893212602
    found = critical_angle(**TUMBLING, velocity=velocity, angle_of_attack=attack)
    assert "tumbling" in [each.code for each in found.warnings]
    for angle, tumbles in ((30.0, False), (84.5, True)):
        impact = Impact(velocity=velocity, oblique_angle=math.radians(angle), angle_of_attack=attack)
        run = simulate(**TUMBLING, impact=impact, sample_interval=None)
        assert ("tumbling" in [each.code for each in run.warnings]) == tumbles
        assert (abs(run.final.axis_angle - impact.axis_angle) > math.pi) == tumbles


def test_run_ends_in_motion_after_a_full_turn_in_the_target() -> None:
    """The warning is `tumbling` with either method, not the one about the termination time."""
    impact = Impact(velocity=598.15, oblique_angle=math.radians(84.5), angle_of_attack=0.03895949452329724)
    for numerics in (None, Numerics(method="panels", panels=4000, time_step=4e-6)):
        run = simulate(**TUMBLING, impact=impact, numerics=numerics, sample_interval=None)
        assert run.outcome is Outcome.IN_MOTION
        assert 2.0 * math.pi < abs(run.final.axis_angle - impact.axis_angle) < 3.0 * math.pi
        assert run.final.time < 0.025
        codes = [each.code for each in run.warnings]
        assert codes.count("tumbling") == 1
        assert "undecided" not in codes


def test_run_that_gains_energy_between_the_faces_diverges_at_once() -> None:
    """Such a run with few stations once took 100,000 shorter and shorter steps, and searches took seconds."""
    nose = Ogive(caliber_radius_head=5.690303148099852)
    body = Projectile(nose=nose, diameter=0.12287467948546833, length=0.7013633683649022, mass=56.95403029714366)
    wall = Target(compressive_strength=38067137.271900564, density=2238.9669610416436, thickness=0.06518926882855638)
    power_law = Resistance(strength_factor=StrengthPowerLaw(), free_surface=MohrCoulomb())
    case: dict[str, Any] = {"projectile": body, "target": wall, "resistance": power_law}
    impact = Impact(velocity=233.33, oblique_angle=math.radians(69.942), angle_of_attack=0.048124079120554955)
    coarse = Numerics(relative_tolerance=2e-3, stations=5, points=3)
    with pytest.raises(IntegrationError, match="gained as much energy"):
        simulate(**case, impact=impact, numerics=coarse, sample_interval=None)
    assert simulate(**case, impact=impact, sample_interval=None).evaluations < 5000


def test_coarse_trial_that_gains_energy_is_repeated() -> None:
    """With coarse numerics this shank hits the rear of its hole harder and harder, and the run would not end."""
    wall = replace(PAPER_TARGET, compressive_strength=78451171.59555532, thickness=0.15)
    found = critical_angle(projectile=PAPER_PROJECTILE, target=wall, velocity=262.67797193455965)
    assert found.angle is not None
    ends = [each.outcome for each in found.outcomes]
    assert ends == [Outcome.PERFORATED, Outcome.EMBEDDED, Outcome.RICOCHET]
    for interval in found.outcomes:
        middle = 0.5 * (interval.lower + interval.upper)
        impact = replace(paper_impact(oblique_angle_degrees=math.degrees(middle)), velocity=262.67797193455965)
        run = simulate(projectile=PAPER_PROJECTILE, target=wall, impact=impact, sample_interval=None)
        assert run.outcome is interval.outcome
