"""Calibrations of the strength factor as the contract has them, a file for each."""

from service.schemas.calibration.depth import (
    DepthCalibrationAnswer,
    DepthCalibrationRequest,
    ObliquityCalibrationAnswer,
    ObliquityCalibrationRequest,
    depth_answer,
    obliquity_answer,
)
from service.schemas.calibration.motion import MotionCalibrationRequest
from service.schemas.calibration.motion_answer import MotionCalibrationAnswer, motion_answer

__all__ = [
    "DepthCalibrationAnswer",
    "DepthCalibrationRequest",
    "MotionCalibrationAnswer",
    "MotionCalibrationRequest",
    "ObliquityCalibrationAnswer",
    "ObliquityCalibrationRequest",
    "depth_answer",
    "motion_answer",
    "obliquity_answer",
]
