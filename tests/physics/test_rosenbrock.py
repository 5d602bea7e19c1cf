"""The Rosenbrock pair: its order, which a mistyped digit would reduce, its interpolation and its step control."""

import math

import numpy as np
import pytest

from solver import Flat, Impact, NoFreeSurface, Numerics, Projectile, Resistance
from solver.arrays import FloatArray
from solver.prepared import integrate, prepare
from solver.strike import PAPER_TARGET
from solver.time_integration import COUPLINGS, ERROR_WEIGHTS, GAMMA, STAGE_WEIGHTS, STAGES, WEIGHTS


def sums(weights: FloatArray) -> list[float]:
    """Return the left-hand sides of the order conditions, lowest order first (Hairer and Wanner 1996, IV.7)."""
    couplings, states = COUPLINGS[:STAGES], np.zeros((STAGES, STAGES))
    states[: STAGES - 1, : STAGES - 2] = STAGE_WEIGHTS
    states[STAGES - 1] = states[STAGES - 2]
    # The stored coefficients are for the form without matrix products; convert them.
    own = np.linalg.inv(np.eye(STAGES) / GAMMA - couplings)
    explicit = states @ own
    both, b = explicit + own, weights @ own
    at = explicit.sum(axis=1)
    through = both.sum(axis=1)
    return [
        b.sum(),
        b @ through,
        b @ at**2,
        b @ both @ through,
        b @ at**3,
        b @ (at * (explicit @ through)),
        b @ both @ at**2,
        b @ both @ both @ through,
    ]


CONDITIONS = [1, 1 / 2, 1 / 3, 1 / 6, 1 / 4, 1 / 8, 1 / 12, 1 / 24]


def test_solution_is_of_order_4() -> None:
    assert sums(WEIGHTS) == pytest.approx(CONDITIONS, abs=1e-13)


def test_embedded_solution_is_of_order_3() -> None:
    found = sums(WEIGHTS + ERROR_WEIGHTS)
    assert found[:4] == pytest.approx(CONDITIONS[:4], abs=1e-13)
    assert all(abs(value - condition) > 1e-3 for value, condition in zip(found[4:], CONDITIONS[4:], strict=True))


def test_difference_of_rates_over_a_step_is_of_order_3() -> None:
    """The difference is computed from a combination of stages, which is accurate to third order."""
    found = sums(-COUPLINGS[STAGES])
    assert found[:4] == pytest.approx([0, 1, 1, 1 / 2], abs=1e-13)


@pytest.mark.parametrize("velocity", [50.0, 100.0, 200.0, 400.0])
@pytest.mark.parametrize("tolerance", [1e-5, 1e-6, 1e-7])
def test_steps_end_at_an_abrupt_stop(velocity: float, tolerance: float) -> None:
    """A flat nose in a half-space is at rest when its resistance vanishes abruptly; it must not be pushed back."""
    prepared = prepare(
        projectile=Projectile(nose=Flat(), diameter=0.05, length=0.3, mass=3.0),
        target=PAPER_TARGET,
        resistance=Resistance(free_surface=NoFreeSurface()),
        numerics=Numerics(relative_tolerance=tolerance).resolved(),
    )
    strike = Impact(velocity=velocity, oblique_angle=0.0)
    _, steps = integrate(prepared, prepared.model._replace(law=prepared.law_at(strike)), strike, keep_steps=True)
    assert steps[:, 11].min() > -math.sqrt(tolerance) * velocity
