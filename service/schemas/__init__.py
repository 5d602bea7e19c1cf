"""Requests and answers as the contract has them; the only place that converts degrees."""

from service.schemas.answers import CriticalAngleAnswer, Result, TrajectoryAnswer
from service.schemas.building import critical_angle_answer, trajectory_answer
from service.schemas.requests import CriticalAngleRequest, TrajectoryRequest

__all__ = [
    "CriticalAngleAnswer",
    "CriticalAngleRequest",
    "Result",
    "TrajectoryAnswer",
    "TrajectoryRequest",
    "critical_angle_answer",
    "trajectory_answer",
]
