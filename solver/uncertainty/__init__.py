"""Uncertainty of critical angles, trajectories and limits of perforation, and verdicts on strikes and walls."""

from solver.checks import name_keywords
from solver.uncertainty.critical_angles import AngleStudy
from solver.uncertainty.distributions import (
    Discrete,
    Distribution,
    Lognormal,
    LogStudentT,
    Normal,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from solver.uncertainty.next_shot import RESIDUAL
from solver.uncertainty.results import (
    AfterShots,
    AngleUncertainty,
    Batch,
    Change,
    Crossings,
    Round,
    Sensitivity,
    TrajectoryUncertainty,
)
from solver.uncertainty.sampling import Estimate, Sampling, Uncertain
from solver.uncertainty.strikes import compute_study, critical_angle_uncertainty, scaled, trajectory_uncertainty
from solver.uncertainty.trajectories import Ending, TrajectoryStudy
from solver.uncertainty.usual import usual_scatter
from solver.uncertainty.verdict import Verdict, verdict
from solver.uncertainty.walls import (
    DesignValue,
    PerforationSpread,
    RearFaceVariants,
    WallVerdict,
    judge_wall,
    limit_speed_spread,
    thickness_spread,
)

__all__ = [
    "RESIDUAL",
    "AfterShots",
    "AngleStudy",
    "AngleUncertainty",
    "Batch",
    "Change",
    "Crossings",
    "DesignValue",
    "Discrete",
    "Distribution",
    "Ending",
    "Estimate",
    "LogStudentT",
    "Lognormal",
    "Normal",
    "PerforationSpread",
    "RearFaceVariants",
    "Round",
    "Sampling",
    "Sensitivity",
    "TrajectoryStudy",
    "TrajectoryUncertainty",
    "Triangular",
    "TruncatedNormal",
    "Uncertain",
    "Uniform",
    "Verdict",
    "WallVerdict",
    "compute_study",
    "critical_angle_uncertainty",
    "judge_wall",
    "limit_speed_spread",
    "scaled",
    "thickness_spread",
    "trajectory_uncertainty",
    "usual_scatter",
    "verdict",
]

name_keywords(globals())
