"""Models of the requests and answers of the HTTP contract, and their conversion to and from the solver."""

from service.schemas.answers import (
    CriticalAngleAnswer,
    FlightAnswer,
    TrajectoryAnswer,
    critical_angle_answer,
    trajectory_answer,
)
from service.schemas.batches import TrajectoryBase
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
from service.schemas.flight import FlightRequest
from service.schemas.formulas import FormulasAnswer, FormulasRequest, formulas_answer
from service.schemas.perforation import (
    LimitSpeedAnswer,
    LimitSpeedBase,
    LimitSpeedRequest,
    ThicknessAnswer,
    ThicknessBase,
    ThicknessRequest,
    limit_speed_answer,
    thickness_answer,
)
from service.schemas.requests import CriticalAngleBase, CriticalAngleRequest, ReportRequest, TrajectoryRequest
from service.schemas.sweeps import CaseModels
from service.schemas.uncertainty import CriticalAngleUncertaintyRequest, TrajectoryUncertaintyRequest
from service.schemas.uncertainty_answers import (
    CriticalAngleUncertaintyAnswer,
    TrajectoryUncertaintyAnswer,
)
from service.schemas.verdict import VerdictAnswer, usual_inputs, verdict_answer
from service.schemas.wall import WallAnswer, WallRequest, wall_answer

__all__ = [
    "CaseModels",
    "CriticalAngleAnswer",
    "CriticalAngleBase",
    "CriticalAngleRequest",
    "CriticalAngleUncertaintyAnswer",
    "CriticalAngleUncertaintyRequest",
    "DepthCalibrationAnswer",
    "DepthCalibrationRequest",
    "FlightAnswer",
    "FlightRequest",
    "FormulasAnswer",
    "FormulasRequest",
    "LimitSpeedAnswer",
    "LimitSpeedBase",
    "LimitSpeedRequest",
    "MotionCalibrationAnswer",
    "MotionCalibrationRequest",
    "ObliquityCalibrationAnswer",
    "ObliquityCalibrationRequest",
    "ReportRequest",
    "ThicknessAnswer",
    "ThicknessBase",
    "ThicknessRequest",
    "TrajectoryAnswer",
    "TrajectoryBase",
    "TrajectoryRequest",
    "TrajectoryUncertaintyAnswer",
    "TrajectoryUncertaintyRequest",
    "VerdictAnswer",
    "WallAnswer",
    "WallRequest",
    "critical_angle_answer",
    "depth_answer",
    "formulas_answer",
    "limit_speed_answer",
    "motion_answer",
    "obliquity_answer",
    "thickness_answer",
    "trajectory_answer",
    "usual_inputs",
    "verdict_answer",
    "wall_answer",
]
