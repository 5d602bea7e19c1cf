"""Strength factors from tests: from depths (section 3.1), from motion histories (3.2), and over obliquity (eq. 9)."""

from solver.calibration.decay_laws import DecayLawFits, fit_decay_laws
from solver.calibration.depth import DepthFit, DepthTest, fit_depth, penetration_depths
from solver.calibration.estimate import Estimate, UndeterminedError
from solver.calibration.history import MotionHistory, Weights
from solver.calibration.motion import MotionFit, MotionRun, MotionsFit, fit_motion, fit_motions
from solver.calibration.obliquity import ObliquityFit, ObliquityPoint, fit_obliquity
from solver.calibration.strike import predict_motion

__all__ = [
    "DecayLawFits",
    "DepthFit",
    "DepthTest",
    "Estimate",
    "MotionFit",
    "MotionHistory",
    "MotionRun",
    "MotionsFit",
    "ObliquityFit",
    "ObliquityPoint",
    "UndeterminedError",
    "Weights",
    "fit_decay_laws",
    "fit_depth",
    "fit_motion",
    "fit_motions",
    "fit_obliquity",
    "penetration_depths",
    "predict_motion",
]
