"""Requests and answers as the contract has them; the only place that converts degrees."""

from service.schemas.answers import CriticalAngleAnswer, Result, TrajectoryAnswer
from service.schemas.batches import (
    CriticalAngleBatch,
    CriticalAngleCase,
    CriticalAngleResults,
    TrajectoryBase,
    TrajectoryBatch,
    TrajectoryCase,
    TrajectoryResults,
)
from service.schemas.building import critical_angle_answer, trajectory_answer
from service.schemas.jobs import Job, JobResults, Jobs
from service.schemas.requests import CriticalAngleRequest, TrajectoryRequest
from service.schemas.sweeps import CriticalAngleSweep, TrajectorySweep

__all__ = [
    "CriticalAngleAnswer",
    "CriticalAngleBatch",
    "CriticalAngleCase",
    "CriticalAngleRequest",
    "CriticalAngleResults",
    "CriticalAngleSweep",
    "Job",
    "JobResults",
    "Jobs",
    "Result",
    "TrajectoryAnswer",
    "TrajectoryBase",
    "TrajectoryBatch",
    "TrajectoryCase",
    "TrajectoryRequest",
    "TrajectoryResults",
    "TrajectorySweep",
    "critical_angle_answer",
    "trajectory_answer",
]
