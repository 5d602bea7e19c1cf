"""A shank that sticks in its hole: free along its axis, held across it."""

import math

from solver import (
    ElasticPlastic,
    Impact,
    Numerics,
    Ogive,
    Outcome,
    Projectile,
    Resistance,
    SearchStatus,
    StrengthPowerLaw,
    Target,
    critical_angle,
    simulate,
)
from solver.cases import PAPER_PROJECTILE, PAPER_TARGET


def test_sticking_costs_no_more_steps_than_getting_there() -> None:
    """The last two thirds of this run are a straight slide; chattering, it took 1,339 and 26,872 steps."""
    impact = Impact(velocity=450.0, oblique_angle=math.radians(45.0))
    for tolerance, most in ((3e-7, 300), (1e-8, 700)):
        numerics = Numerics(relative_tolerance=tolerance)
        run = simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact, numerics=numerics)
        assert run.outcome is Outcome.EMBEDDED
        assert run.steps < most


def test_band_in_which_a_slow_strike_stays_is_found() -> None:
    """Turned away below 27.7° and above 32.27°, by a scan at 0.5° with stations, points and steps ten times finer."""
    found = critical_angle(
        projectile=Projectile(
            nose=Ogive(caliber_radius_head=2.3984227410070993),
            diameter=0.07224441730120977,
            length=0.2744521422656396,
            mass=6.754210676990972,
        ),
        target=Target(compressive_strength=69198917.96005702, density=2375.053630702226),
        velocity=105.03130525528756,
        angle_of_attack=0.05052400365531268,
        resistance=Resistance(strength_factor=StrengthPowerLaw(), free_surface=ElasticPlastic(inertia=True)),
    )
    assert found.status is SearchStatus.CONVERGED
    assert found.angle is not None
    assert abs(math.degrees(found.angle) - 32.27) < 0.02
