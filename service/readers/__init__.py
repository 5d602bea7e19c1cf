"""Readers of test tables and finite element results; they return objects of the solver, in SI units and radians."""

from service.readers.calibration import (
    DEPTH_TESTS,
    MOTION,
    OBLIQUITY_POINTS,
    Expected,
    MotionRunRow,
    read_depth_tests,
    read_motion,
    read_motion_runs,
    read_obliquity_points,
)
from service.readers.dyna import CoordinateAxis
from service.readers.files import FileError
from service.readers.table import Quantity

__all__ = [
    "DEPTH_TESTS",
    "MOTION",
    "OBLIQUITY_POINTS",
    "CoordinateAxis",
    "Expected",
    "FileError",
    "MotionRunRow",
    "Quantity",
    "read_depth_tests",
    "read_motion",
    "read_motion_runs",
    "read_obliquity_points",
]
