"""Study of the paper's strike with the usual scatter, compared with searches at random inputs and with SALib."""

import math
import os
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from solver import CriticalAngle, critical_angle_many
from solver.arrays import FloatArray
from solver.projectile import Projectile
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET
from solver.uncertainty import AngleUncertainty, Estimate, Normal, Sampling, Uncertain, critical_angle_uncertainty
from tests.physics.strikes import known
from tests.uncertainty.test_strikes import ANGLES, PAPER, SCATTER

COUNT = 20_000
NAMES = [each.field for each in SCATTER]
AT_DEG = (44.0, 47.0, 48.5, 50.0, 53.0)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def critical_angles(values: FloatArray) -> FloatArray:
    """Return the critical angle of the paper's projectile for each row of inputs, in the order of `SCATTER`."""
    speed, strength, density, mass, attack = values.T
    # For a given shape, the moment of inertia is proportional to the mass.
    projectiles = [with_mass(each) for each in mass]
    targets = [
        type(PAPER_TARGET)(compressive_strength=float(s), density=float(d))
        for s, d in zip(strength, density, strict=True)
    ]
    found = critical_angle_many(
        projectile=projectiles,
        target=targets,
        velocity=speed,
        angle_of_attack=attack,
        threads=os.cpu_count() or 1,
    )
    return np.array([angle_of(each) for each in found])


def with_mass(mass: float) -> Projectile:
    paper = PAPER_PROJECTILE
    return Projectile(nose=paper.nose, diameter=paper.diameter, length=paper.length, mass=float(mass))


def angle_of(found: object) -> float:
    assert isinstance(found, CriticalAngle)
    return known(found.angle)


@cache
def plain() -> FloatArray:
    """Return critical angles for inputs drawn by NumPy from the distributions of `SCATTER`."""
    generator = np.random.default_rng(20)
    draws = (
        generator.normal(238.0, 2.38, COUNT),
        39e6 * np.exp(generator.normal(0.0, 0.12, COUNT)),
        generator.normal(2250.0, 45.0, COUNT),
        generator.normal(13.0, 0.065, COUNT),
        generator.normal(0.0, math.radians(1.0), COUNT),
    )
    return critical_angles(np.column_stack(draws))


@cache
def answer(method: str) -> AngleUncertainty:
    return critical_angle_uncertainty(
        **PAPER,
        uncertain=SCATTER,
        oblique_angles=ANGLES,
        sampling=Sampling(method=method, seed=7, max_samples=16_384),
    )


@pytest.mark.parametrize("method", ["auto", "direct"])
def test_moments_agree_with_random_searches(method: str) -> None:
    angles, found = plain(), answer(method)
    error = 1.96 * angles.std() / math.sqrt(COUNT)
    assert agree(known(found.mean), angles.mean(), error)
    assert agree(known(found.standard_deviation), angles.std(ddof=1), 1.96 * deviation_error(angles))


def test_strike_is_answered_by_the_surrogate_by_default() -> None:
    assert answer("auto").method == "surrogate"
    assert answer("direct").method == "direct"


@pytest.mark.parametrize("method", ["auto", "direct"])
def test_moments_agree_with_the_sample_of_salib(method: str) -> None:
    angles, found = salib()[0], answer(method)
    assert agree(known(found.mean), angles.mean(), 1.96 * angles.std() / math.sqrt(angles.size))
    assert agree(known(found.standard_deviation), angles.std(ddof=1), 1.96 * deviation_error(angles))


@pytest.mark.parametrize("method", ["auto", "direct"])
@pytest.mark.parametrize("angle_deg", AT_DEG)
def test_probability_is_within_the_interval_of_random_searches(method: str, angle_deg: float) -> None:
    """The direct method has fewer samples than the random searches, so its wider interval need only overlap theirs."""
    found = answer(method)
    index = int(np.argmin(abs(ANGLES - math.radians(angle_deg))))
    count = int((plain() <= ANGLES[index]).sum())
    interval = stats.binomtest(count, COUNT).proportion_ci(0.95, method="wilson")
    if method == "auto":
        assert interval.low <= found.probability[index] <= interval.high
    assert interval.low <= found.upper[index]
    assert found.lower[index] <= interval.high
    assert found.probability[index] == pytest.approx(count / COUNT, abs=0.02)


@pytest.mark.parametrize("velocity", [238.0, 160.0, 100.0, 60.0])
def test_methods_agree_within_their_intervals(velocity: float) -> None:
    speed = Uncertain("impact.velocity", Normal(mean=velocity, coefficient_of_variation=0.01))
    strike = PAPER | {"velocity": velocity, "uncertain": [speed, *SCATTER[1:]], "sensitivity": False}
    surrogate, direct = (
        critical_angle_uncertainty(**strike, sampling=Sampling(method=method, seed=seed))
        for method, seed in (("auto", 7), ("direct", 8))
    )
    assert (surrogate.method, direct.method) == ("surrogate", "direct")
    assert surrogate.converged
    assert direct.converged
    assert (surrogate.lower <= direct.upper).all()
    assert (direct.lower <= surrogate.upper).all()
    for one, other in zip(moments_of(surrogate), moments_of(direct), strict=True):
        assert one.lower <= other.upper
        assert other.lower <= one.upper


def moments_of(found: AngleUncertainty) -> list[Estimate]:
    """Return mean, standard deviation and quantiles of the critical angle in an answer."""
    return [known(found.mean), known(found.standard_deviation), *(estimate for _, estimate in found.quantiles)]


@pytest.mark.parametrize("method", ["auto", "direct"])
def test_indices_agree_with_salib(method: str) -> None:
    pytest.importorskip("SALib", reason="SALib is not installed")
    found = answer(method)
    reference = salib()
    for name, first, first_error, total, total_error in zip(NAMES, *reference[1:], strict=True):
        each = next(each for each in found.sensitivity if each.field == name)
        assert agree(known(each.first_order), first, first_error), name
        assert agree(known(each.total), total, total_error), name


@cache
def salib() -> tuple[Any, ...]:
    """Return independent angles, and first-order and total indices with their errors, by Saltelli's scheme in SALib."""
    sobol_sample: Any = pytest.importorskip("SALib.sample.sobol")
    sobol_analysis: Any = pytest.importorskip("SALib.analyze.sobol")
    problem = {
        "num_vars": 5,
        "names": NAMES,
        "dists": ["norm", "lognorm", "norm", "norm", "norm"],
        "bounds": [[238.0, 2.38], [math.log(39e6), 0.12], [2250.0, 45.0], [13.0, 0.065], [0.0, math.radians(1.0)]],
    }
    values = sobol_sample.sample(problem, 2048, calc_second_order=False, seed=3)
    angles = critical_angles(values)
    found = sobol_analysis.analyze(problem, angles, calc_second_order=False, seed=3)
    # The other rows differ from these in one input only.
    independent = angles.reshape(-1, len(NAMES) + 2)[:, [0, -1]].ravel()
    return independent, found["S1"], found["S1_conf"], found["ST"], found["ST_conf"]


def agree(estimate: Estimate, value: float, error: float) -> bool:
    """Return whether the interval of an estimate overlaps value ± error."""
    return bool(estimate.lower <= value + error and value - error <= estimate.upper)


def deviation_error(values: FloatArray) -> float:
    """Return the standard error of a standard deviation, from the fourth moment."""
    centred = values - values.mean()
    variance = (centred**2).mean()
    return float(math.sqrt(((centred**4).mean() - variance**2) / len(values)) / (2.0 * math.sqrt(variance)))
