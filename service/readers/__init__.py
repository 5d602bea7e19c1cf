"""Files of tests and of finite element results, read into the solver's objects: SI units and radians."""

from service.readers.axes import Axis
from service.readers.depth_tests import DEPTH_TESTS, OBLIQUITY_POINTS, read_depth_tests, read_obliquity_points
from service.readers.errors import FileError
from service.readers.motion import MOTION, Expected, read_motion
from service.readers.units import Quantity

__all__ = [
    "DEPTH_TESTS",
    "MOTION",
    "OBLIQUITY_POINTS",
    "Axis",
    "Expected",
    "FileError",
    "Quantity",
    "read_depth_tests",
    "read_motion",
    "read_obliquity_points",
]
