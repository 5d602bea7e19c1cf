"""The paper's strike, and converged answers to it as references."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from solver import CriticalAngle, Motion, Numerics, Search, critical_angle, simulate
from solver.arrays import FloatArray
from solver.search.trials import LAST_TOLERANCE
from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, PAPER_VELOCITY, TRAJECTORY_TOLERANCE, paper_impact

OBLIQUE_ANGLE_DEG = 45.0
"""Oblique angle of the trajectory that is measured. [°]"""
DEPTH_TIMES = (5e-4, 1e-3, 2e-3, 3e-3)
"""Times at which depths of this trajectory are compared. It ends later, and all are multiples of the first. [s]"""

CONVERGED = Numerics(method="adaptive", relative_tolerance=LAST_TOLERANCE / 30.0, stations=24, points=8)
SCANNED = Numerics(method="adaptive", relative_tolerance=1e-6, stations=24, points=6)
"""Numerics for trajectories of which only the outcome is needed."""
CONVERGED_SEARCH = Search(tolerance=math.radians(0.001))
CONVERGED_PATH = Numerics(method="adaptive", relative_tolerance=TRAJECTORY_TOLERANCE / 10.0, stations=32, points=16)

paper_critical_angle = partial(
    critical_angle, projectile=PAPER_PROJECTILE, target=PAPER_TARGET, velocity=PAPER_VELOCITY
)
paper_trajectory = partial(
    simulate,
    projectile=PAPER_PROJECTILE,
    target=PAPER_TARGET,
    impact=paper_impact(oblique_angle_degrees=OBLIQUE_ANGLE_DEG),
)


@dataclass(frozen=True, slots=True)
class References:
    """Converged answers for the paper's strike."""

    by_outcome: float
    """Smallest angle that ends in a ricochet. [°]"""
    by_tip: float
    """Angle at which the nose tip is back at the face of the target after 5 ms, the paper's criterion. [°]"""
    tip_depths: FloatArray
    """Depths of the nose tip at `DEPTH_TIMES`. [m]"""


def compute_references() -> References:
    """Compute the references, in a few seconds."""
    by_tip = Search(method="bisection", relative_tolerance=1e-6)
    return References(
        by_outcome=degrees(paper_critical_angle(numerics=CONVERGED, search=CONVERGED_SEARCH)),
        by_tip=degrees(paper_critical_angle(numerics=CONVERGED, search=by_tip)),
        tip_depths=tip_depths(CONVERGED_PATH),
    )


def degrees(answer: CriticalAngle) -> float:
    """Return the critical angle of an answer, which must have one. [°]"""
    assert answer.angle is not None  # noqa: S101 # the paper's strike has one
    return math.degrees(answer.angle)


def tip_depths(numerics: Numerics) -> FloatArray:
    """Return the depths of the nose tip at `DEPTH_TIMES`. [m]"""
    interval = DEPTH_TIMES[0]
    motion = paper_trajectory(numerics=numerics, sample_interval=interval).history
    assert isinstance(motion, Motion)  # noqa: S101 # it was requested
    rows = [round(time / interval) for time in DEPTH_TIMES]
    np.testing.assert_allclose(motion.time[rows], DEPTH_TIMES, rtol=1e-9)
    return np.asarray(motion.nose_tip_depth[rows])
