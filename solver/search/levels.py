"""How finely the trials of a search by outcome are computed, level by level."""

import math
from functools import lru_cache
from typing import NamedTuple

from solver.adaptive import LARGEST_STEP, Accuracy
from solver.compilation import lean
from solver.events import LODGED_ENERGY
from solver.loads import Quadrature, build_quadrature
from solver.motion import RAMP_FRACTION
from solver.numerics import ResolvedNumerics

ROUGH, MIDDLE, ASKED, LAST, TIMED = range(5)
"""What was asked for is the third; the next is the last, but for a change that the termination time decides."""
STRIDE = 0.85
"""First stride of a level over its tolerance, so that two trials confirm what a level before has found."""
LAST_TOLERANCE, LAST_STATIONS, LAST_POINTS = 1e-5, 24, 6
"""Relative tolerance and Gauss-Legendre points of the last level, unless finer ones are asked for."""
TIMED_TOLERANCE = 1e-6
"""Likewise where the termination time decides: a body that creeps out until then gathers the errors of its steps."""


class Level(NamedTuple):
    """How finely trials are computed, and how far they narrow a change."""

    quadrature: Quadrature
    accuracy: Accuracy
    ramp_fraction: float
    smooth_ramp: bool
    stride: float
    """How far the change may lie from where the level before has found it; a first guess. [rad]"""
    tolerance: float
    """Width of the bracket. [rad]"""
    fine: bool
    """As asked for, or finer."""


Levels = tuple[Level, Level, Level, Level, Level]
ROUGH_LEVEL = Level(
    quadrature=build_quadrature(stations=3, points=2),
    accuracy=Accuracy(relative_tolerance=1e-2, largest_step=0.5, rest_energy=LODGED_ENERGY),
    ramp_fraction=5e-3,
    smooth_ramp=False,
    stride=0.0,
    tolerance=math.radians(0.1),
    fine=False,
)
"""Where a search first looks: right to a few tenths of a degree, at a quarter of the cost. What is so slow that it
would count as lodged is taken for embedded at once."""
MIDDLE_LEVEL = Level(
    quadrature=build_quadrature(stations=6, points=3),
    accuracy=Accuracy(relative_tolerance=1e-3, largest_step=LARGEST_STEP, rest_energy=LODGED_ENERGY),
    ramp_fraction=3e-4,
    smooth_ramp=False,
    stride=math.radians(0.1),
    tolerance=math.radians(0.04),
    fine=False,
)
"""Right to a few hundredths of a degree, at half of the cost, and likewise."""


@lru_cache  # the cases of a study share one
def search_levels(*, numerics: ResolvedNumerics, tolerance: float) -> Levels:
    """All of them, for what was asked for: its settings, and the width of its bracket. [rad]"""
    asked = Level(
        quadrature=build_quadrature(stations=numerics.stations, points=numerics.points),
        accuracy=Accuracy(numerics.relative_tolerance, LARGEST_STEP),
        ramp_fraction=RAMP_FRACTION,
        smooth_ramp=True,
        stride=STRIDE * tolerance,
        tolerance=tolerance,
        fine=True,
    )
    last = asked._replace(
        quadrature=build_quadrature(
            stations=max(numerics.stations, LAST_STATIONS), points=max(numerics.points, LAST_POINTS)
        ),
        accuracy=Accuracy(min(numerics.relative_tolerance, LAST_TOLERANCE), LARGEST_STEP),
    )
    timed = last._replace(accuracy=Accuracy(min(numerics.relative_tolerance, TIMED_TOLERANCE), LARGEST_STEP))
    return ROUGH_LEVEL, MIDDLE_LEVEL, asked, last, timed


@lean
def is_finer(level: Level, other: Level) -> bool:
    """Whether a level computes its trials more finely than another."""
    tolerance, stations, points = level.accuracy.relative_tolerance, level.quadrature.stations, level.quadrature.points
    return bool(
        tolerance < other.accuracy.relative_tolerance
        or stations.size > other.quadrature.stations.size
        or points.shape[0] > other.quadrature.points.shape[0]
    )
