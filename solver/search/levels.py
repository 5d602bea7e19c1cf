"""How finely the trials of a search by outcome are computed, level by level."""

import math
from functools import lru_cache
from typing import NamedTuple

from solver.compilation import lean
from solver.loads import Quadrature, build_quadrature
from solver.motion import RAMP_FRACTION
from solver.time_integration import LARGEST_STEP, Accuracy

ROUGH, MIDDLE, REQUESTED, LAST = range(4)
"""What the numerical settings give is the third; the last decides where the two before do not agree."""
LAST_TOLERANCE, LAST_STATIONS, LAST_POINTS = 3e-5, 16, 5
"""Relative tolerance and Gauss-Legendre points of the last level, unless finer ones are set."""


class Level(NamedTuple):
    """How finely trials are computed, and how far they narrow a change."""

    quadrature: Quadrature
    accuracy: Accuracy
    ramp_fraction: float
    smooth_ramp: bool
    stride: float
    """Longest first stride from where the level before has placed a change. [rad]"""
    tolerance: float
    """Width of the bracket. [rad]"""
    fine: bool
    """As requested, or finer."""


Levels = tuple[Level, Level, Level, Level]
ROUGH_LEVEL = Level(
    quadrature=build_quadrature(stations=2, points=2),
    accuracy=Accuracy(relative_tolerance=3e-2, largest_step=1.0),
    ramp_fraction=5e-3,
    smooth_ramp=False,
    stride=0.0,
    tolerance=math.radians(1.25),
    fine=False,
)
"""Where a search first looks: right to a few tenths of a degree, at a quarter of the cost."""
MIDDLE_LEVEL = Level(
    quadrature=build_quadrature(stations=5, points=3),
    accuracy=Accuracy(relative_tolerance=2e-3, largest_step=LARGEST_STEP),
    ramp_fraction=RAMP_FRACTION,
    smooth_ramp=True,
    stride=math.radians(0.5),
    tolerance=math.radians(0.3),
    fine=False,
)
"""Right to a few hundredths of a degree, at two thirds of the cost."""


@lru_cache  # the cases of a study share one
def search_levels(*, relative_tolerance: float, stations: int, points: int, tolerance: float) -> Levels:
    """All of them, for the requested settings and width of the bracket. [rad]"""
    requested = Level(
        quadrature=build_quadrature(stations=stations, points=points),
        accuracy=Accuracy(float(relative_tolerance), LARGEST_STEP),
        ramp_fraction=RAMP_FRACTION,
        smooth_ramp=True,
        stride=math.radians(0.1),
        tolerance=float(tolerance),
        fine=True,
    )
    last = requested._replace(
        quadrature=build_quadrature(stations=max(stations, LAST_STATIONS), points=max(points, LAST_POINTS)),
        accuracy=Accuracy(float(min(relative_tolerance, LAST_TOLERANCE)), LARGEST_STEP),
    )
    return ROUGH_LEVEL, MIDDLE_LEVEL, requested, last


@lean
def is_finer(level: Level, other: Level) -> bool:
    """Whether a level computes its trials more finely than another."""
    tolerance, stations, points = level.accuracy.relative_tolerance, level.quadrature.stations, level.quadrature.points
    return bool(
        tolerance < other.accuracy.relative_tolerance
        or stations.size > other.quadrature.stations.size
        or points.shape[0] > other.quadrature.points.shape[0]
    )
