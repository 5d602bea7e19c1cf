"""Tables 1 and 2 of the paper, as inputs of calibrations."""

import math

from solver.calibration import DepthTest, ObliquityPoint
from validation import reference


def table_1(*, with_masses: bool) -> list[DepthTest]:
    """Return the depth tests in normal impact."""
    return [
        DepthTest(velocity=shot.velocity, depth=shot.depth, mass=shot.mass if with_masses else None)
        for shot in reference.table_1()
    ]


def table_2() -> list[ObliquityPoint]:
    """Return the strength factor at each oblique angle."""
    return [
        ObliquityPoint(oblique_angle=math.radians(angle), strength_factor=value) for angle, value in reference.table_2()
    ]
