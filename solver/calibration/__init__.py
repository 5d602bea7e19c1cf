"""Strength factors from tests: from depths (section 3.1), from motion histories (3.2), and over obliquity (eq. 9)."""

from solver.calibration.depth import DepthFit, DepthTest, fit_depth, penetration_depths
from solver.calibration.estimate import Estimate
from solver.calibration.history import MotionHistory, Weights
from solver.calibration.motion import MotionFit, fit_motion
from solver.calibration.obliquity import ObliquityFit, ObliquityPoint, fit_obliquity
from solver.calibration.strike import predict_motion

__all__ = [
    "DepthFit",
    "DepthTest",
    "Estimate",
    "MotionFit",
    "MotionHistory",
    "ObliquityFit",
    "ObliquityPoint",
    "Weights",
    "fit_depth",
    "fit_motion",
    "fit_obliquity",
    "penetration_depths",
    "predict_motion",
]
