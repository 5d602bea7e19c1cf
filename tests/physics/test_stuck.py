"""A shank that sticks in its hole, free along its axis but held across it."""

import math

from solver import Impact, Numerics, Outcome, simulate

from .strikes import CASE


def test_sliding_of_a_stuck_shank_takes_few_steps() -> None:
    """In the last two thirds of this run the shank slides straight, which once took 1,339 and 26,872 steps."""
    impact = Impact(velocity=450.0, oblique_angle=math.radians(45.0))
    for tolerance, most in ((3e-7, 300), (1e-8, 700)):
        numerics = Numerics(relative_tolerance=tolerance)
        run = simulate(**CASE, impact=impact, numerics=numerics)
        assert run.outcome is Outcome.EMBEDDED
        assert run.steps < most
