"""Uncertainty of a strike, computed here on some threads."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

import numpy as np

from solver.arrays import FloatArray
from solver.projectile import Projectile
from solver.resistance import Resistance
from solver.search.critical_angle import critical_angle
from solver.search.types import USUAL_SEARCH, Search
from solver.strike import Impact, Numerics, strike_parts
from solver.target import Target
from solver.trajectory import simulate
from solver.uncertainty.critical_angles import AngleStudy
from solver.uncertainty.inputs import Strike, Uncertain
from solver.uncertainty.results import AngleUncertainty, Crossings, TrajectoryUncertainty
from solver.uncertainty.sampling import Point, Sampling
from solver.uncertainty.trajectories import Ending, TrajectoryStudy
from solver.validation import RicochetError, require

Result = TypeVar("Result")
Answer = TypeVar("Answer")

USUAL_ANGLES = np.radians(np.linspace(5.0, 85.0, 161))


def critical_angle_uncertainty(
    *,
    projectile: Projectile,
    target: Target,
    velocity: float,
    uncertain: Sequence[Uncertain],
    angle_of_attack: float = 0.0,
    angular_velocity: float = 0.0,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    search: Search | None = None,
    oblique_angles: FloatArray | None = None,
    sampling: Sampling | None = None,
    sensitivity: bool = True,
    threads: int = 1,
) -> AngleUncertainty:
    """Probability of ricochet over the oblique angle, and what the critical angle is sensitive to.

    Parameters
    ----------
    projectile, target, velocity, angle_of_attack, angular_velocity, resistance, numerics, search
        As for `critical_angle`. [SI, rad]
    uncertain
        Inputs that scatter, each with its distribution, independent of each other.
    oblique_angles
        At which the probability is wanted, rising; every 0.5° from 5° to 85° unless given. [rad]
    sampling
        Accuracy, budget and seed.
    sensitivity
        Whether to compute Sobol indices and the swing of each input.
    threads
        How many searches run at a time.

    Returns
    -------
    AngleUncertainty

    Raises
    ------
    ParameterError
        If a distribution or a field is not valid.

    Notes
    -----
    A polynomial chaos stands in for the search where every sample has one change of outcome and the error at held-out
    points is at most 0.1°, as long as it gives the narrower intervals; otherwise, outcomes of randomised Sobol points
    are counted. A sample outside what the model accepts, or one that fails, counts as not known and widens the
    intervals. So does what no search has shown yet: of
    n searches that all have one change of outcome, about 3/n may have another at 95 %.

    Examples
    --------
    >>> answer = critical_angle_uncertainty(
    ...     projectile=projectile, target=target, velocity=238.0,
    ...     uncertain=[
    ...         Uncertain("impact.velocity", Normal(mean=238.0, coefficient_of_variation=0.01)),
    ...         Uncertain("target.compressive_strength", Lognormal(median=39e6, dispersion=0.12)),
    ...         Uncertain("resistance.free_surface", Discrete(values=[ElasticPlastic(), MohrCoulomb()])),
    ...     ],
    ... )
    >>> answer.probability, answer.mean, answer.sensitivity
    """
    impact = Impact(
        velocity=velocity, oblique_angle=0.0, angle_of_attack=angle_of_attack, angular_velocity=angular_velocity
    )
    for index, each in enumerate(uncertain):
        require(each.field != "impact.oblique_angle", f"uncertain.{index}.field", "is what a search varies")
    strike = Strike(strike_parts(impact, projectile, target, resistance, numerics), uncertain)
    search = search or USUAL_SEARCH
    study = AngleStudy(
        uncertain,
        USUAL_ANGLES if oblique_angles is None else oblique_angles,
        sampling or Sampling(),
        sensitivity=sensitivity,
        bounds=search.bounds,
        accepts=strike.accepts,
    )

    def find(parts: dict[str, Any]) -> Crossings:
        motion = parts.pop("impact")
        names = ("velocity", "angle_of_attack", "angular_velocity")
        return Crossings.of(critical_angle(**parts, **{name: getattr(motion, name) for name in names}, search=search))

    def evaluate(point: Point) -> Crossings:
        try:
            return find(strike.sample(point))
        except RicochetError as error:
            return Crossings.of(error)

    return _run(study.steps(), evaluate, threads)


def trajectory_uncertainty(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    uncertain: Sequence[Uncertain],
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    sampling: Sampling | None = None,
    threads: int = 1,
) -> TrajectoryUncertainty:
    """Probability of each outcome of one strike, with quantiles of depth, exit speed and exit angle.

    Parameters
    ----------
    projectile, target, impact, resistance, numerics
        As for `simulate`. [SI, rad]
    uncertain, sampling, threads
        As for `critical_angle_uncertainty`; ``impact.oblique_angle`` may scatter too.

    Returns
    -------
    TrajectoryUncertainty

    Raises
    ------
    ParameterError
        If a distribution or a field is not valid.
    """
    strike = Strike(strike_parts(impact, projectile, target, resistance, numerics), uncertain)

    def evaluate(point: Point) -> Ending:
        try:
            return Ending.of(simulate(**strike.sample(point), sample_interval=None))
        except RicochetError as error:
            return Ending.of(error)

    return _run(TrajectoryStudy(uncertain, sampling or Sampling()).steps(), evaluate, threads)


class _Batch(Protocol):
    @property
    def points(self) -> list[Point]: ...


def _run(
    steps: Generator[_Batch, Sequence[Result], Answer], evaluate: Callable[[Point], Result], threads: int
) -> Answer:
    """Evaluate every point of the batches of a study, some at a time; return its answer."""
    with ThreadPoolExecutor(threads) as pool:
        batch = next(steps)
        while True:
            try:
                batch = steps.send(list(pool.map(evaluate, batch.points)))
            except StopIteration as end:
                answer: Answer = end.value
                return answer
