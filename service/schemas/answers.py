"""Models of the answers to requests for trajectories and critical angles."""

from collections.abc import Mapping
from typing import Annotated, Any, Generic, TypeVar

from pydantic import MISSING, Field

import solver
from service.columns import Column
from service.schemas.fields import GIVEN, columns_of, history_columns, walk
from service.schemas.flight import LANDING, FlightResult
from service.schemas.problems import Problem
from service.schemas.quantities import Count, Num, Of, Part, with_examples
from service.schemas.resistance import FreeSurfaceModel, ObliquityShape, StrengthLaw
from solver import Outcome, SearchStatus
from solver.arrays import FloatArray

Value = TypeVar("Value")

STATE = {
    "time_s": 0.003115,
    "center_of_gravity_depth_m": 0.02240,
    "center_of_gravity_lateral_m": 0.3338,
    "nose_tip_depth_m": 0.1213,
    "axis_angle_deg": 70.36,
    "depth_velocity_m_s": 0.7625,
    "lateral_velocity_m_s": 2.254,
    "angular_velocity_rad_s": 0.3584,
    "depth_force_n": -367000.0,
    "lateral_force_n": -1082000.0,
    "moment_n_m": -2619.0,
    "kinetic_energy_j": 36.82,
}
ACCELERATIONS = {"axial_acceleration_g": -8961.0, "transverse_acceleration_g": -141.3}
EXIT = {
    "speed_m_s": 23.77,
    "direction_deg": 54.17,
    "elevation_deg": 35.83,
    "axis_angle_deg": 102.1,
    "angular_velocity_rad_s": 40.59,
    "kinetic_energy_j": 3880.0,
    "lateral_m": 0.5723,
}
PROTRUSION = {"final_m": 0.0402, "greatest_m": 0.0402}
BENDING = {
    "peak_stress_pa": 1.829e9,
    "time_s": 0.001615,
    "distance_behind_tip_m": 0.2954,
    "normal_force_n": -437000.0,
}
WARNING = {
    "code": "mass_properties_assumed",
    "detail": "moment of inertia not given: that of a homogeneous solid of the outer shape is used",
    "standing": True,
}
TRIAL = {"oblique_angle_deg": 45.0, "final_position_m": 0.120327, "outcome": "embedded", "fine": False}
INTERVAL = {"outcome": "perforated", "lower_deg": 5.0, "upper_deg": 41.02}
OWN_TESTS = {
    "shots": 4,
    "median": 8.055,
    "dispersion": 0.0964,
    "spread": [6.902, 9.4],
    "prior_median": 8.737,
    "prior_dispersion": 0.475,
    "prior_spread": [4.58, 16.67],
}
STRENGTH = {"strength_factor_dispersion": 0.0964, "own_tests": OWN_TESTS}
RUN = {
    "outcome": "embedded",
    "final": STATE,
    "maximum_depth_m": 0.128313,
    "strength_factor": 6.507,
    **STRENGTH,
    "bending": BENDING,
    "warnings": [WARNING],
}
FOUND = {
    "status": "converged",
    "critical_angle_deg": 48.63,
    "bracket_deg": [48.62, 48.63],
    "strength_factor": 6.119,
    **STRENGTH,
    "energy_fraction_below": 0.0,
    "energy_fraction_above": 0.0773,
    "exit": EXIT,
    "iterations": [TRIAL],
    "other_crossings_deg": [],
    "warnings": [WARNING],
}
NONE_FOUND = {"status": "no_ricochet", "iterations": [TRIAL], "other_crossings_deg": [], "warnings": [WARNING]}
LAWS = {
    "free_surface": "mohr_coulomb",
    "strength_factor": "obliquity_polynomial",
    "obliquity_shape": "equation_9",
    "fitted_to": "S: finite elements, 80 mm into 39 MPa, 0° to 45°; decay: theory, nearest to finite element motions",
}
OTHER_OUTCOME = LAWS | {"outcome": "ricochet"}
OTHER_ANGLE = LAWS | {"status": "converged", "critical_angle_deg": 43.59}
VERSIONED = {"key": "0" * 64, "engine_version": solver.ENGINE_VERSION}

Key = Annotated[
    str,
    Field(pattern="^[0-9a-f]{64}$", description="Key of this result, under which `/results/{key}` returns it again."),
    GIVEN,
]
EngineVersion = Annotated[str, Field(description="Version of the solver, raised whenever results change."), GIVEN]
Bracket = Annotated[list[Num], Field(min_length=2, max_length=2)]


class ModelWarning(Part):
    """A warning about the reliability of a result."""

    model_config = with_examples(WARNING)

    code: str
    """Stable code of the warning, for programs."""
    detail: str
    """Text of the warning, for people."""
    standing: bool | MISSING = MISSING
    """Present and true for a standing note: a warning that comes with most answers or hardly affects this one."""
    angle_shift_deg: Num | MISSING = MISSING
    """Change of the critical angle caused by the effect that the warning names, if it is computed. [°]"""


StrengthDispersion = Annotated[
    Num,
    Field(
        ge=0.0,
        description="Standard deviation of ln S for the next shot into the same concrete, from the user's own tests or "
        "from the law of the published tests. [1]",
    ),
]


class OwnTestsAnswer(Part):
    """Strength factor S in normal impact before and after the user's own tests of the concrete."""

    model_config = with_examples(OWN_TESTS)

    shots: Annotated[Count, Of(lambda tests: len(tests.factors))]
    median: Num
    """Posterior median of S for the next shot. [1]"""
    dispersion: Num
    """Posterior standard deviation of ln S. [1]"""
    spread: Annotated[list[Num], Field(min_length=2, max_length=2)]
    """Posterior 90 % range of S for the next shot. [1]"""
    prior_median: Num
    """Prior median of S, from the law of the published tests. [1]"""
    prior_dispersion: Num
    """Prior standard deviation of ln S. [1]"""
    prior_spread: Annotated[list[Num], Field(min_length=2, max_length=2)]
    """Prior 90 % range of S. [1]"""


class Motion(Part, Generic[Value]):
    """Position, velocity, loads and energy of the projectile.

    Depth is positive inside the target, and the lateral position is positive in the direction of travel.
    """

    solved = solver.Motion

    time_s: Value
    center_of_gravity_depth_m: Value
    center_of_gravity_lateral_m: Value
    nose_tip_depth_m: Value
    axis_angle_deg: Value
    depth_velocity_m_s: Value
    lateral_velocity_m_s: Value
    angular_velocity_rad_s: Value
    depth_force_n: Value
    lateral_force_n: Value
    moment_n_m: Value
    kinetic_energy_j: Value


class MotionState(Motion[Num]):
    """State of the motion at one instant.

    Depth is positive inside the target, and the lateral position is positive in the direction of travel.
    """

    model_config = with_examples(STATE)


class MotionInHistory(Motion[Value], Generic[Value]):
    """Quantities of a motion over time: the quantities of a state, and accelerations."""

    axial_acceleration_g: Value
    transverse_acceleration_g: Value


class MotionHistory(MotionInHistory[list[Num]]):
    """Motion over time, as columns of equal length: at regular intervals and at the event that ended the run."""

    model_config = with_examples({name: [value] for name, value in (STATE | ACCELERATIONS).items()})


class Exit(Part):
    """State of a projectile that leaves the target through the impact face or the rear face."""

    model_config = with_examples(EXIT)

    solved = solver.Exit

    speed_m_s: Num
    direction_deg: Num
    elevation_deg: Num
    axis_angle_deg: Num
    angular_velocity_rad_s: Num
    kinetic_energy_j: Num
    lateral_m: Num
    flight: Annotated[FlightResult | MISSING, GIVEN, columns_of(FlightResult, "flight_")] = MISSING
    """Flight to the ground after the exit, if the request has `flight`."""


class FlightAnswer(FlightResult):
    """Landing point of a body on level ground, and the farthest landing point over all elevations."""

    model_config = with_examples(LANDING | VERSIONED)

    key: Key
    engine_version: EngineVersion


class Protrusion(Part):
    """Protrusion of a projectile from the rear face of a wall that it does not perforate."""

    model_config = with_examples(PROTRUSION)

    solved = solver.Protrusion

    final_m: Num | MISSING = MISSING
    greatest_m: Num


class BendingHistory(Part):
    """Largest bending stress in the body over time, at the times at which it was computed."""

    model_config = with_examples({"time_s": [0.0, 0.001615], "stress_pa": [0.0, 1.829e9]})

    solved = solver.BendingHistory

    time_s: list[Num]
    stress_pa: list[Num]


class Bending(Part):
    """Largest bending stress until the projectile first comes free of the concrete or has lost 95 % of its energy.

    It follows from D'Alembert's principle, with the loads of the model and the inertia of a homogeneous body of the
    outer shape, solid or hollow.
    """

    model_config = with_examples(BENDING)

    solved = solver.Bending

    peak_stress_pa: Num
    time_s: Num
    distance_behind_tip_m: Num
    normal_force_n: Num
    history: BendingHistory | MISSING = MISSING
    """Bending stress over time, if a history is requested."""


class Trajectory(Part):
    """Result of one run: outcome, final state and motion."""

    model_config = with_examples(RUN)

    solved = solver.Trajectory
    tabled = ("outcome", "maximum_depth_m", "protrusion", "strength_factor", "final", "exit", "bending")

    outcome: Outcome
    final: Annotated[MotionState, columns_of(MotionState, "final_", "; at the event that ended the run")]
    exit: Annotated[Exit | MISSING, columns_of(Exit, "exit_")] = MISSING
    """State at the exit, if the projectile left the target."""
    maximum_depth_m: Num | MISSING = MISSING
    protrusion: Annotated[Protrusion | MISSING, columns_of(Protrusion, "protrusion_")] = MISSING
    """Protrusion from the rear face of a wall that is not perforated, if any part comes out."""
    bending: Annotated[Bending | MISSING, columns_of(Bending, "bending_")] = MISSING
    """Bending stress. Absent if a given centre of gravity differs from that of the homogeneous body by more than 0.5 %
    of the length, or a given moment of inertia by more than 2 %."""
    strength_factor: Num
    strength_factor_dispersion: StrengthDispersion
    own_tests: OwnTestsAnswer | MISSING = MISSING
    """Effect of the user's own tests on S, if there are any. With `paper_table_1` as `strength_scatter`, the four shots
    in Table 1 of the paper count as the user's tests."""
    history: Annotated[MotionHistory | MISSING, GIVEN] = MISSING
    """Motion over time, if requested."""
    warnings: list[ModelWarning]


class Alternative(Part):
    """Result of the same case with one combination of a decay law and a strength law."""

    free_surface: FreeSurfaceModel
    strength_factor: StrengthLaw
    obliquity_shape: ObliquityShape
    fitted_to: str
    """Tests or computations to which the strength law was fitted, and the basis of the decay law."""
    problem: Problem | MISSING = MISSING
    """Reason why there is no result with these laws."""


class TrajectoryAlternative(Alternative):
    """Outcome of the same strike with one combination of a decay law and a strength law."""

    model_config = with_examples(OTHER_OUTCOME)

    outcome: Outcome | MISSING = MISSING


class CriticalAngleAlternative(Alternative):
    """Result of the same search with one combination of a decay law and a strength law."""

    model_config = with_examples(OTHER_ANGLE)

    status: SearchStatus | MISSING = MISSING
    critical_angle_deg: Num | MISSING = MISSING
    """Critical angle; absent if there is none. [°]"""


class TrajectoryAnswer(Trajectory):
    """Answer to a request for a trajectory."""

    model_config = with_examples(RUN | VERSIONED, RUN | VERSIONED | {"alternatives": [OTHER_OUTCOME]})

    alternatives: Annotated[list[TrajectoryAlternative] | MISSING, GIVEN] = MISSING
    """Results with each combination of decay and strength law, if requested; one may have the laws of the request."""
    key: Key
    engine_version: EngineVersion


class Trial(Part):
    """One angle tried in a search."""

    model_config = with_examples(TRIAL)

    solved = solver.Trial

    oblique_angle_deg: Num
    final_position_m: Num
    outcome: Outcome
    fine: Annotated[
        bool, Column("fine", "true if computed at the final resolution, false if only to locate the angle", "?")
    ]
    exit: Annotated[Exit | MISSING, Of(lambda trial: trial.exit if trial.fine else None)] = MISSING
    """State at the exit, if the trial has the final resolution and the projectile left the target."""


class OutcomeInterval(Part):
    """Interval of oblique angles in which all strikes have the same outcome."""

    model_config = with_examples(INTERVAL)

    solved = solver.OutcomeInterval

    outcome: Outcome
    lower_deg: Num
    upper_deg: Num


class CriticalAngleAnswer(Part):
    """Answer to a request for a critical angle."""

    model_config = with_examples(
        FOUND | VERSIONED, NONE_FOUND | VERSIONED, FOUND | VERSIONED | {"alternatives": [OTHER_ANGLE]}
    )

    solved = solver.CriticalAngle
    tabled = (
        "status",
        "critical_angle_deg",
        "bracket_deg",
        "critical_angle_standard_error_deg",
        "strength_factor",
        "energy_fraction_below",
        "energy_fraction_above",
        "exit",
    )

    status: SearchStatus
    critical_angle_deg: Annotated[Num | MISSING, Of("angle")] = MISSING
    critical_angle_standard_error_deg: Annotated[Annotated[Num, Field(ge=0.0)] | MISSING, Of("standard_error")] = (
        MISSING
    )
    bracket_deg: Annotated[
        Bracket | MISSING,
        Column("bracket_low_deg", "lower end of the last bracket of the critical angle"),
        Column("bracket_high_deg", "upper end of the last bracket of the critical angle"),
    ] = MISSING
    strength_factor: Num | MISSING = MISSING
    strength_factor_dispersion: StrengthDispersion | MISSING = MISSING
    own_tests: OwnTestsAnswer | MISSING = MISSING
    """Effect of the user's own tests on S, if there are any. With `paper_table_1` as `strength_scatter`, the four shots
    in Table 1 of the paper count as the user's tests."""
    energy_fraction_below: Annotated[Num, Field(ge=0.0)] | MISSING = MISSING
    energy_fraction_above: Annotated[Num, Field(ge=0.0)] | MISSING = MISSING
    exit: Annotated[Exit | MISSING, columns_of(Exit, "exit_")] = MISSING
    """State at the exit of the strike at the critical angle, if there is such an angle."""
    iterations: list[Trial]
    other_crossings_deg: list[Num]
    outcomes: list[OutcomeInterval] | MISSING = MISSING
    """Intervals of equal outcome over the whole range, in increasing order, with ends accurate to the tolerance.
    Present if the target has a thickness and the search method is `outcome`."""
    trajectory: Annotated[Trajectory | MISSING, GIVEN] = MISSING
    """Run at the critical angle, if requested."""
    alternatives: Annotated[list[CriticalAngleAlternative] | MISSING, GIVEN] = MISSING
    """Results with each combination of decay and strength law, if requested; one may have the laws of the request."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


Columns = dict[str, FloatArray]
"""Columns of a history, keyed by their names in the contract."""


def trajectory_answer(
    found: solver.Trajectory, flight: Mapping[str, Any] | None = None
) -> tuple[dict[str, Any], Columns | None]:
    """Return the answer without its history, and the columns of the history if there is one.

    Parameters
    ----------
    found
        Result of the run.
    flight
        Flight of the body after its exit, if requested.
    """
    history = None if found.history is None else history_columns(MotionHistory, found.history)
    answer = walk(TrajectoryAnswer, found)
    if flight is not None:
        answer["exit"]["flight"] = flight
    return answer, history


def critical_angle_answer(
    found: solver.CriticalAngle, trajectory: solver.Trajectory | None
) -> tuple[dict[str, Any], Columns | None]:
    """Return the answer without the history of its trajectory, and the columns of that history if there is one."""
    run, history = (None, None) if trajectory is None else trajectory_answer(trajectory)
    return walk(CriticalAngleAnswer, found, trajectory=run), history
