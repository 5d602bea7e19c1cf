"""Searches for a critical angle: trials, convergence, bands of outcomes and limits of the range."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from solver import (
    Conical,
    ConstantStrengthFactor,
    CriticalAngle,
    ElasticPlastic,
    Impact,
    MohrCoulomb,
    NoFreeSurface,
    Numerics,
    ObliquityPolynomial,
    Ogive,
    Outcome,
    ParameterError,
    Projectile,
    Resistance,
    Search,
    SearchStatus,
    StrengthPowerLaw,
    Target,
    critical_angle,
    mass_properties,
    simulate,
)
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, SEARCH_STATIONS, SEARCH_TOLERANCE
from solver.uncertainty.results import Crossings

from .strikes import CASE, codes, known

ADAPTIVE = Numerics(method="adaptive")


def find(
    *,
    strength_factor: ObliquityPolynomial | ConstantStrengthFactor | None = None,
    numerics: Numerics = ADAPTIVE,
    **search: Any,
) -> CriticalAngle:
    """Search for the critical angle of the paper's strike; angles are in degrees."""
    for name in ("lower", "upper", "tolerance", "scan_interval"):
        if name in search:
            search[name] = math.radians(search[name])
    resistance = Resistance() if strength_factor is None else Resistance(strength_factor=strength_factor)
    return critical_angle(
        **CASE, velocity=PAPER_VELOCITY, resistance=resistance, numerics=numerics, search=Search(**search)
    )


def angles(found: CriticalAngle) -> list[float]:
    return [math.degrees(trial.oblique_angle) for trial in found.iterations]


@pytest.mark.parametrize("method", ["outcome", "bisection", "secant"])
def test_range_without_ricochet_has_no_angle(method: str) -> None:
    found = find(method=method, lower=10.0, upper=35.0)
    assert found.status is SearchStatus.NO_RICOCHET
    assert (found.angle, found.bracket, found.other_crossings) == (None, None, ())
    assert all(trial.outcome is not Outcome.RICOCHET and trial.final_position > 0.0 for trial in found.iterations)


@pytest.mark.parametrize("method", ["outcome", "bisection", "secant"])
def test_range_that_begins_with_ricochet_has_its_angle_below(method: str) -> None:
    found = find(method=method, lower=60.0, upper=75.0)
    assert found.status is SearchStatus.ALWAYS_RICOCHET
    assert (found.angle, found.bracket, found.other_crossings) == (None, None, ())
    assert "ricochet_at_lower_bound" in codes(found)


def test_outcome_search_scans_the_range_and_sees_both_ends_of_its_bracket() -> None:
    found = find(lower=40.0, upper=60.0, tolerance=0.1)
    assert found.bracket is not None
    assert found.angle == found.bracket[1]
    assert math.degrees(found.bracket[1] - found.bracket[0]) <= 0.1
    assert sorted(angles(found)[:3]) == pytest.approx([40.0, 50.0, 60.0])
    seen = {trial.oblique_angle: trial.outcome for trial in found.iterations if trial.fine}
    assert seen[found.bracket[0]] is not Outcome.RICOCHET
    assert seen[found.bracket[1]] is Outcome.RICOCHET


@pytest.mark.parametrize("tolerance", [1.0, 0.1, 0.01, 0.001])
def test_outcome_search_needs_few_fine_trials_for_any_tolerance(tolerance: float) -> None:
    found = find(lower=40.0, upper=60.0, tolerance=tolerance)
    assert found.bracket is not None
    assert math.degrees(found.bracket[1] - found.bracket[0]) <= tolerance
    assert 2 <= sum(trial.fine for trial in found.iterations) <= 10
    assert math.degrees(found.bracket[0]) - 0.01 < 48.634 < math.degrees(found.bracket[1]) + 0.01


def test_dense_scan_finds_the_same_angle_and_is_refined_without_a_change() -> None:
    found = find(lower=5.0, upper=85.0, scan_interval=0.1)
    assert math.degrees(known(found.angle)) == pytest.approx(48.634, abs=0.012)
    nothing = find(lower=5.0, upper=40.0, scan_interval=0.1)
    assert nothing.status is SearchStatus.NO_RICOCHET
    assert sum(trial.fine for trial in nothing.iterations) >= 350 / 16


def test_every_fine_trial_equals_a_run_at_its_angle() -> None:
    found = find(lower=40.0, upper=60.0, tolerance=1.0)
    for trial in found.iterations:
        run = simulate(
            **CASE,
            impact=Impact(velocity=PAPER_VELOCITY, oblique_angle=trial.oblique_angle),
            numerics=Numerics(relative_tolerance=SEARCH_TOLERANCE, stations=SEARCH_STATIONS),
            sample_interval=None,
        )
        if trial.fine:
            assert (trial.outcome, trial.final_position) == (run.outcome, run.final.nose_tip_depth)
        else:
            assert trial.outcome == run.outcome or abs(math.degrees(trial.oblique_angle) - 48.634) < 1.0


def test_bisection_keeps_the_sign_change_and_stops_within_the_tolerance() -> None:
    found = find(method="bisection", relative_tolerance=0.01)
    positions = {trial.oblique_angle: trial.final_position for trial in found.iterations}
    tried = list(positions)
    left, right = tried[:2]
    for angle in tried[2:]:
        assert angle == pytest.approx((left + right) / 2.0, rel=1e-12)
        left, right = (angle, right) if positions[angle] > 0.0 else (left, angle)
    steps = [abs(b - a) / a for a, b in pairwise(tried[1:])]
    assert steps[-1] < 0.01 <= min(steps[:-1])
    assert found.angle == tried[-1]
    assert found.bracket == (left, right)


def test_secant_steps_follow_equation_8() -> None:
    found = find(method="secant", relative_tolerance=0.01)
    assert found.status is SearchStatus.CONVERGED
    trials = found.iterations
    for old, new, following in zip(trials, trials[1:], trials[2:], strict=False):
        slope = (new.final_position - old.final_position) / (new.oblique_angle - old.oblique_angle)
        assert following.oblique_angle == pytest.approx(new.oblique_angle - new.final_position / slope, rel=1e-9)
    steps = [abs(b - a) / a for a, b in pairwise(angles(found)[1:])]
    assert steps[-1] < 0.01 <= min(steps[:-1])


def test_secant_that_leaves_the_quarter_turn_is_not_converged() -> None:
    """From 20° and 80° the second step would go beyond 90°, where there is no strike."""
    found = find(method="secant", lower=20.0, upper=80.0, strength_factor=ConstantStrengthFactor(value=8.0))
    assert found.status is SearchStatus.NOT_CONVERGED
    assert found.angle is None
    assert len(found.iterations) == 3


COMES_AND_GOES = ObliquityPolynomial(
    coefficients=tuple(float(c) for c in np.polynomial.polynomial.polyfit([40, 50, 55, 60, 70], [8, 9, 3, 1.5, 8], 4))
)
"""A strength factor of 9 at 50°, 1.5 at 60° and 8 at 70°, so projectiles near 60° are embedded again."""


def test_all_bands_of_ricochet_are_reported() -> None:
    found = find(lower=40.0, upper=70.0, tolerance=0.02, strength_factor=COMES_AND_GOES)
    assert found.status is SearchStatus.CONVERGED
    assert found.angle is not None
    ceases, returns = found.other_crossings
    assert 40.0 < math.degrees(found.angle) < 45.0
    assert 50.0 < math.degrees(ceases) < 55.0
    assert 60.0 < math.degrees(returns) < 65.0

    looked = {round(math.degrees(trial.oblique_angle), 6): trial.outcome for trial in found.iterations}
    turned = [looked.get(angle) is Outcome.RICOCHET for angle in (40.0, 50.0, 60.0, 70.0)]
    assert turned == [False, True, False, True]
    seen = {trial.oblique_angle: trial.outcome is Outcome.RICOCHET for trial in found.iterations if trial.fine}
    for crossing, turned_away in ((found.angle, True), (ceases, False), (returns, True)):
        nearest_below = max(angle for angle in seen if angle < crossing)
        assert math.degrees(crossing - nearest_below) <= 0.02
        assert (seen[nearest_below], seen[crossing]) == (not turned_away, turned_away)


def test_range_that_begins_in_a_later_band_has_its_critical_angle_below() -> None:
    """The limits of the embedded band, at 50-55° and 60-65°, are changes of outcome, but not the critical angle."""
    found = find(lower=47.0, upper=70.0, strength_factor=COMES_AND_GOES)
    assert (found.status, found.angle, found.bracket) == (SearchStatus.ALWAYS_RICOCHET, None, None)
    ceases, returns = found.other_crossings
    assert 50.0 < math.degrees(ceases) < 55.0
    assert 60.0 < math.degrees(returns) < 65.0
    assert "ricochet_at_lower_bound" in codes(found)
    kept = Crossings.of(found)
    assert (kept.angles, kept.starts_turned_away) == (found.other_crossings, True)
    assert math.isnan(kept.angle)


@pytest.mark.parametrize("method", ["bisection", "secant"])
def test_searches_of_the_paper_do_not_mistake_the_end_of_ricochet_for_its_onset(method: str) -> None:
    found = find(method=method, lower=47.0, upper=58.0, strength_factor=COMES_AND_GOES)
    assert (found.status, found.angle) == (SearchStatus.ALWAYS_RICOCHET, None)
    assert "ricochet_at_lower_bound" in codes(found)


UNHELD = ObliquityPolynomial(held_from=math.pi / 2.0)


@pytest.mark.parametrize("method", ["outcome", "bisection", "secant"])
def test_search_ends_where_equation_9_falls_to_zero(method: str) -> None:
    """S of eq. 9 is zero at 86.6°."""
    found = find(method=method, lower=40.0, upper=88.0, strength_factor=UNHELD)
    assert max(trial.oblique_angle for trial in found.iterations) == pytest.approx(math.radians(86.6), abs=2e-3)
    (warning,) = (warning for warning in found.warnings if warning.code == "range_clipped")
    assert "not at 88°" in warning.detail


def test_band_below_a_vanishing_strength_factor_is_found() -> None:
    """The projectile is turned away from 49.3° to 64.0°. Above, the resistance is so low that it is embedded."""
    falling = ObliquityPolynomial(coefficients=(8.5084, -0.061243, -0.00091189))  # S is zero at 68.75°
    resistance = Resistance(free_surface=MohrCoulomb(), strength_factor=falling)
    found = critical_angle(**CASE, velocity=PAPER_VELOCITY, resistance=resistance)
    assert math.degrees(known(found.angle)) == pytest.approx(49.3, abs=0.1)
    assert any(math.degrees(crossing) == pytest.approx(64.0, abs=0.1) for crossing in found.other_crossings)


def test_strength_factor_of_zero_over_the_range_is_refused_by_name() -> None:
    with pytest.raises(ParameterError, match=r"greater than 0 at the initial oblique angle of 87") as caught:
        find(lower=87.0, upper=88.0, strength_factor=UNHELD)
    assert caught.value.field == "resistance.strength_factor"


def test_strength_factor_that_vanishes_between_the_angles_of_the_scan_ends_the_range() -> None:
    """S is 6.2 at both ends of the range, and negative from 45.2° to 49.8°."""
    dips = ObliquityPolynomial(coefficients=(14631.24, -617.5, 6.5))
    found = find(lower=45.0, upper=50.0, strength_factor=dips)
    assert max(trial.oblique_angle for trial in found.iterations) < math.radians(45.2)
    assert "range_clipped" in codes(found)
    assert "range_clipped" not in codes(find())


def test_energy_next_to_the_angle_tells_its_shift_with_the_retention_energy() -> None:
    found = find(numerics=Numerics(retention_energy_fraction=0.01))
    assert found.energy_fraction_below == 0.0
    low, high = (find(numerics=Numerics(retention_energy_fraction=share)).angle for share in (0.001, 0.1))
    moves = math.degrees(known(high) - known(low))
    assert ("retention_decides" in codes(found)) == (moves > 0.5)
    above = simulate(
        **CASE,
        impact=Impact(velocity=PAPER_VELOCITY, oblique_angle=known(found.angle) + math.radians(0.5)),
        sample_interval=1e-4,
    )
    left = above.final.kinetic_energy / known(above.history).kinetic_energy[0]
    assert found.energy_fraction_above == pytest.approx(left, abs=0.005)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1])
def test_strike_at_the_critical_angle_leaves_with_the_retention_energy(share: float) -> None:
    numerics = Numerics(retention_energy_fraction=share)
    found = find(numerics=numerics)
    assert found.bracket is not None
    energies = []
    for angle, outcome in zip(found.bracket, (Outcome.EMBEDDED, Outcome.RICOCHET), strict=True):
        widened = angle + math.copysign(math.radians(0.02), angle - sum(found.bracket) / 2.0)
        run = simulate(
            **CASE,
            impact=Impact(velocity=PAPER_VELOCITY, oblique_angle=widened),
            numerics=numerics,
            sample_interval=None,
        )
        assert run.outcome is outcome
        energies.append(run.final.kinetic_energy)
    assert energies[0] < energies[1]


@pytest.mark.parametrize(
    "whole",
    [
        {"velocity": 238},
        {"angle_of_attack": 0, "angular_velocity": 0},
        {"projectile": replace(PAPER_PROJECTILE, mass=13)},
        {"target": replace(PAPER_TARGET, compressive_strength=39_000_000, density=2250)},
        {"velocity": np.float32(238.0)},
    ],
    ids=["speed", "attack", "mass", "target", "single precision"],
)
def test_integers_give_the_same_angle_as_floats(whole: dict[str, Any]) -> None:
    usual: dict[str, Any] = {"projectile": PAPER_PROJECTILE, "target": PAPER_TARGET, "velocity": 238.0}
    assert critical_angle(**usual | whole).angle == critical_angle(**usual).angle


def test_assumed_inertia_is_reported_with_its_effect_on_the_angle() -> None:
    given = mass_properties(PAPER_PROJECTILE).moment_of_inertia
    changed = replace(PAPER_PROJECTILE, moment_of_inertia=1.1 * given)
    angle, other = find().angle, critical_angle(projectile=changed, target=PAPER_TARGET, velocity=PAPER_VELOCITY).angle
    (warning,) = (warning for warning in find().warnings if warning.code == "mass_properties_assumed")
    (stated,) = (float(number) for number in re.findall(r"about ([+-][\d.]+)°", warning.detail))
    assert stated == pytest.approx(math.degrees(known(other) - known(angle)), rel=0.35)


SLOW: dict[str, dict[str, Any]] = {
    "power law": {
        "projectile": Projectile(nose=Ogive(caliber_radius_head=4.36), diameter=0.137, length=0.797, mass=67.9),
        "target": Target(compressive_strength=32.2e6, density=2270.0),
        "velocity": 109.0,
        "angle_of_attack": math.radians(0.633),
        "resistance": Resistance(strength_factor=StrengthPowerLaw()),
    },
    "endless target": {
        "projectile": Projectile(nose=Ogive(caliber_radius_head=3.85), diameter=0.135, length=0.760, mass=52.1),
        "target": Target(compressive_strength=56.3e6, density=2420.0),
        "velocity": 111.0,
        "angle_of_attack": math.radians(0.325),
        "resistance": Resistance(free_surface=NoFreeSurface()),
    },
    "long": {
        "projectile": Projectile(nose=Ogive(caliber_radius_head=4.31), diameter=0.137, length=1.15, mass=88.8),
        "target": Target(compressive_strength=37.5e6, density=2450.0),
        "velocity": 104.0,
        "angle_of_attack": math.radians(1.93),
    },
    "blunt, on strong concrete": {
        "projectile": Projectile(nose=Ogive(caliber_radius_head=2.16), diameter=0.14655, length=0.712, mass=89.81),
        "target": Target(compressive_strength=82.86e6, density=2109.5),
        "velocity": 106.8,
        "angle_of_attack": -0.0181,
        "resistance": Resistance(strength_factor=StrengthPowerLaw(), free_surface=ElasticPlastic(inertia=True)),
    },
    "slender, on strong concrete": {
        "projectile": Projectile(nose=Ogive(caliber_radius_head=4.908), diameter=0.1337, length=0.9932, mass=98.41),
        "target": Target(compressive_strength=87.76e6, density=2364.0),
        "velocity": 159.2,
        "angle_of_attack": math.radians(0.7535),
        "resistance": Resistance(free_surface=ElasticPlastic(inertia=True)),
    },
    "inertia factor above 1": {
        "projectile": Projectile(nose=Ogive(caliber_radius_head=6.2), diameter=0.0762, length=0.53, mass=13.0),
        "target": Target(compressive_strength=59e6, density=2300.0),
        "velocity": 122.0,
        "angle_of_attack": math.radians(3.8),
        "resistance": Resistance(inertia_factor=1.3, free_surface=MohrCoulomb()),
    },
}
"""Slow strikes whose outcome used to alternate with the angle, because it depended on the last, very slow motion."""


@pytest.mark.parametrize("strike", SLOW.values(), ids=SLOW.keys())
def test_slow_strike_has_one_converged_angle(strike: dict[str, Any]) -> None:
    found = critical_angle(**strike)
    fine = critical_angle(
        **strike,
        numerics=Numerics(relative_tolerance=1e-7, stations=48, points=8),
        search=Search(tolerance=math.radians(0.001)),
    )
    assert math.degrees(known(found.angle)) == pytest.approx(math.degrees(known(fine.angle)), abs=0.02)
    assert found.other_crossings == ()
    assert "undecided" not in codes(found)


def test_change_decided_by_the_termination_time_causes_a_warning() -> None:
    found = find(numerics=Numerics(termination_time=4e-3))
    (warning,) = (warning for warning in found.warnings if warning.code == "undecided")
    assert "0.004 s" in warning.detail


def test_band_above_the_critical_angle_is_found_at_low_energy() -> None:
    strike: dict[str, Any] = {
        "projectile": Projectile(nose=Conical(length_to_diameter=2.378), diameter=0.0911, length=0.4398, mass=12.145),
        "target": Target(compressive_strength=122.3e6, density=2505.0),
        "resistance": Resistance(free_surface=NoFreeSurface()),
    }
    found = critical_angle(**strike, velocity=73.47, angle_of_attack=-0.05277)
    begin, end = found.other_crossings
    assert known(found.angle) + math.radians(3.0) < begin < end - math.radians(1.0)
    for angle, turned_away in ((begin - 0.005, True), (0.5 * (begin + end), False), (end + 0.005, True)):
        impact = Impact(velocity=73.47, oblique_angle=angle, angle_of_attack=-0.05277)
        run = simulate(**strike, impact=impact, sample_interval=None)
        assert (run.outcome is Outcome.RICOCHET) is turned_away
