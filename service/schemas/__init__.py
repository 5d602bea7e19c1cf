"""Requests and answers as the contract has them; the only place that converts degrees."""

from service.schemas.answers import CriticalAngleAnswer, TrajectoryAnswer
from service.schemas.batches import (
    CriticalAngleBatch,
    CriticalAngleCase,
    CriticalAngleResults,
    LimitSpeedBatch,
    LimitSpeedCase,
    LimitSpeedResults,
    ThicknessBatch,
    ThicknessCase,
    ThicknessResults,
    TrajectoryBase,
    TrajectoryBatch,
    TrajectoryCase,
    TrajectoryResults,
)
from service.schemas.building import critical_angle_answer, trajectory_answer
from service.schemas.calibration_depth import (
    DepthCalibrationAnswer,
    DepthCalibrationRequest,
    ObliquityCalibrationAnswer,
    ObliquityCalibrationRequest,
    depth_answer,
    obliquity_answer,
)
from service.schemas.calibration_motion import MotionCalibrationRequest
from service.schemas.calibration_motion_answer import MotionCalibrationAnswer, motion_answer
from service.schemas.formulas import FormulasAnswer, FormulasRequest, formulas_answer
from service.schemas.jobs import Job, JobChange, JobResults, Jobs, Result
from service.schemas.perforation import (
    LimitSpeedAnswer,
    LimitSpeedRequest,
    ThicknessAnswer,
    ThicknessRequest,
    limit_speed_answer,
    thickness_answer,
)
from service.schemas.requests import CriticalAngleBase, CriticalAngleRequest, ReportRequest, TrajectoryRequest
from service.schemas.sweeps import CriticalAngleSweep, LimitSpeedSweep, ThicknessSweep, TrajectorySweep
from service.schemas.uncertainty import CriticalAngleUncertaintyRequest, TrajectoryUncertaintyRequest
from service.schemas.uncertainty_answers import (
    CriticalAngleUncertaintyAnswer,
    TrajectoryUncertaintyAnswer,
    critical_angle_uncertainty_answer,
    trajectory_uncertainty_answer,
)

__all__ = [
    "CriticalAngleAnswer",
    "CriticalAngleBase",
    "CriticalAngleBatch",
    "CriticalAngleCase",
    "CriticalAngleRequest",
    "CriticalAngleResults",
    "CriticalAngleSweep",
    "CriticalAngleUncertaintyAnswer",
    "CriticalAngleUncertaintyRequest",
    "DepthCalibrationAnswer",
    "DepthCalibrationRequest",
    "FormulasAnswer",
    "FormulasRequest",
    "Job",
    "JobChange",
    "JobResults",
    "Jobs",
    "LimitSpeedAnswer",
    "LimitSpeedBatch",
    "LimitSpeedCase",
    "LimitSpeedRequest",
    "LimitSpeedResults",
    "LimitSpeedSweep",
    "MotionCalibrationAnswer",
    "MotionCalibrationRequest",
    "ObliquityCalibrationAnswer",
    "ObliquityCalibrationRequest",
    "ReportRequest",
    "Result",
    "ThicknessAnswer",
    "ThicknessBatch",
    "ThicknessCase",
    "ThicknessRequest",
    "ThicknessResults",
    "ThicknessSweep",
    "TrajectoryAnswer",
    "TrajectoryBase",
    "TrajectoryBatch",
    "TrajectoryCase",
    "TrajectoryRequest",
    "TrajectoryResults",
    "TrajectorySweep",
    "TrajectoryUncertaintyAnswer",
    "TrajectoryUncertaintyRequest",
    "critical_angle_answer",
    "critical_angle_uncertainty_answer",
    "depth_answer",
    "formulas_answer",
    "limit_speed_answer",
    "motion_answer",
    "obliquity_answer",
    "thickness_answer",
    "trajectory_answer",
    "trajectory_uncertainty_answer",
]
