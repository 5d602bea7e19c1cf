"""Both methods follow twelve histories of an independent brute-force program (`tests/reference/SOURCES.md`)."""

import numpy as np

from solver import Motion, Numerics, mass_properties, simulate
from solver.arrays import FloatArray

from .conftest import Reference
from .strikes import known

SIDEWAYS_REST = {"oblique-45-no-free-surface": 1.6e-3}
"""Time at which the shank stops moving sideways in its hole while it still moves along its axis. [s]

Turning and sideways speed vanish together and the load changes sign with them, so fixed steps oscillate from there
on. The brute-force history with steps of 1 µs then turns back at 1 rad/s, and panels with steps of 10 µs deviate by
1.06 mm and 0.41°."""


def samples(reference: Reference, *, method: str) -> Motion[FloatArray]:
    numerics = Numerics(method="panels" if method == "panels" else "adaptive", termination_time=6e-3)
    history = simulate(**reference.strike, numerics=numerics, sample_interval=1e-4).history
    return known(history)


def errors(reference: Reference, history: Motion[FloatArray], until: float) -> tuple[float, float]:
    """Return the largest errors of tip depth [m] and axis angle [°] up to a time; every listed time must be present."""
    count = int(np.sum(reference.time <= until * (1.0 + 1e-9)))
    np.testing.assert_allclose(history.time[:count], reference.time[:count], rtol=0, atol=1e-12)
    depth = np.abs(history.nose_tip_depth[:count] - reference.nose_tip_depth[:count])
    angle = np.abs(np.degrees(history.axis_angle[:count]) - reference.axis_angle_degrees[:count])
    return float(depth.max()), float(angle.max())


def test_adaptive_route_follows_the_history_within_three_tenths_of_a_millimetre(reference: Reference) -> None:
    depth, angle = errors(reference, samples(reference, method="adaptive"), reference.time[-1])
    assert depth < 0.3e-3
    assert angle < 0.1


def test_panels_of_the_paper_follow_the_history_within_a_millimetre_before_rest(reference: Reference) -> None:
    rest = SIDEWAYS_REST.get(reference.name, reference.time[-1])
    depth, angle = errors(reference, samples(reference, method="panels"), rest)
    assert depth < 1e-3
    assert angle < 0.3


def test_mass_properties_agree_with_the_reference(reference: Reference) -> None:
    properties = mass_properties(reference.strike["projectile"])
    assert abs(properties.center_of_gravity / reference.center_of_gravity - 1.0) < 1e-8
    assert abs(properties.moment_of_inertia / reference.moment_of_inertia - 1.0) < 1e-8
