"""What a key may stand for."""

from typing import Annotated

from pydantic import Field
from typing_extensions import TypeAliasType

from service.schemas.answers import CriticalAngleAnswer, TrajectoryAnswer
from service.schemas.calibration import DepthCalibrationAnswer, MotionCalibrationAnswer, ObliquityCalibrationAnswer

Result = TypeAliasType(
    "Result",
    Annotated[
        TrajectoryAnswer
        | CriticalAngleAnswer
        | DepthCalibrationAnswer
        | MotionCalibrationAnswer
        | ObliquityCalibrationAnswer,
        Field(description="Any answer."),
    ],
)
