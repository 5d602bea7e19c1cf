"""Sample the posterior of the strength factor, given depth tests, with emcee (`pip install emcee`).

The tests are those of Table 1 of the source paper: normal impact on concrete of 39 MPa. The scatter of the depths about
the model is unknown, so it is sampled too. No service is needed.
"""

import emcee
import numpy as np

from solver import Ogive, Projectile, Target
from solver.arrays import FloatArray
from solver.calibration import penetration_depths

VELOCITIES = np.array([238.1, 275.7, 314.0, 369.5])  # [m/s]
MASSES = np.array([12.923, 12.9, 12.91, 12.914])  # [kg]
DEPTHS = np.array([0.30, 0.38, 0.45, 0.53])  # [m]
PROJECTILE = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
TARGET = Target(compressive_strength=39e6, density=2250.0)
WALKERS, STEPS, DISCARDED = 12, 300, 100


def log_posterior(parameters: FloatArray) -> float:
    """Return the logarithm of the posterior density, up to a constant; the parameters are ln S and ln(scatter in m)."""
    strength_factor, scatter = np.exp(parameters)
    if not (1.0 < strength_factor < 100.0 and 0.001 < scatter < 0.1):  # The prior is uniform in the logarithms.
        return -np.inf
    depths = penetration_depths(
        projectile=PROJECTILE,
        target=TARGET,
        velocities=VELOCITIES,
        masses=MASSES,
        strength_factor=float(strength_factor),
    )
    residuals = (DEPTHS - depths) / scatter
    return float(-0.5 * residuals @ residuals - DEPTHS.size * np.log(scatter))


def main() -> None:
    """Sample the posterior and print its quantiles."""
    start = np.log([8.0, 0.03]) + 0.1 * np.random.default_rng(7).standard_normal((WALKERS, 2))
    sampler = emcee.EnsembleSampler(WALKERS, 2, log_posterior)
    sampler.random_state = np.random.RandomState(7).get_state()  # Every run draws the same samples.
    sampler.run_mcmc(start, STEPS)
    samples = np.exp(sampler.get_chain(discard=DISCARDED, flat=True))
    for name, column, unit in (("S", samples[:, 0], "1"), ("scatter", 1e3 * samples[:, 1], "mm")):
        low, median, high = np.quantile(column, (0.025, 0.5, 0.975))
        print(f"{name:8}{median:6.2f} (95 %: {low:.2f} to {high:.2f}) [{unit}]")


if __name__ == "__main__":
    main()
