"""Fits of the strength factor to depths (section 3.1) and motions (section 3.2), and of a polynomial to it (eq. 9)."""

from solver.calibration.decay_laws import DecayLawFits, fit_decay_laws
from solver.calibration.depth import DepthFit, DepthTest, fit_depth, penetration_depths
from solver.calibration.history import MotionHistory, MotionRun, Weights, predict_motion
from solver.calibration.motion import MotionFit, MotionsFit, fit_motion, fit_motions
from solver.calibration.strength_factor import Estimate, ObliquityFit, ObliquityPoint, UndeterminedError, fit_obliquity
from solver.checks import name_keywords

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

name_keywords(globals())
