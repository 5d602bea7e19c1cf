"""The answers as the contract has them."""

from collections.abc import Mapping
from typing import Annotated, Any, Generic, TypeVar

from pydantic import MISSING, Field

import solver
from service.columns import Column
from service.schemas.fields import GIVEN, NOT_TABLED, Behind, Described, Of, columns_of, history_columns, walk
from service.schemas.flight import LANDING, FlightResult
from service.schemas.problems import Problem
from service.schemas.quantities import Count, Num, Part, with_examples
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
    Field(pattern="^[0-9a-f]{64}$", description="Key of this result, which `/results/{key}` answers again."),
    GIVEN,
]
EngineVersion = Annotated[str, Field(description="Raised whenever results change."), GIVEN]
Bracket = Annotated[
    list[Num],
    Field(
        min_length=2,
        max_length=2,
        description="Angles between which the change was last pinned down, from the normal. [°]",
    ),
]


class ModelWarning(Part):
    """Something to know before relying on a result."""

    model_config = with_examples(WARNING)

    code: str
    """Stable, for programs."""
    detail: str
    """For people."""
    standing: bool | MISSING = MISSING
    """Present and true if it says of most answers what it says of this one, and hardly moves it."""
    angle_shift_deg: Num | MISSING = MISSING
    """Change of the critical angle by what it names, if that is computed. [°]"""


StrengthDispersion = Annotated[
    Num,
    Field(
        ge=0.0,
        description="Standard deviation of ln S of a next shot in the same concrete: by shots into it, or by the law "
        "of the published tests. [ln]",
    ),
]


class OwnTestsAnswer(Part):
    """What shots into the very concrete changed of what is known of its S. Values are of normal impact."""

    model_config = with_examples(OWN_TESTS)

    shots: Annotated[Count, Of(lambda tests: len(tests.factors))]
    median: Num
    """S of a next shot, with the shots. [1]"""
    dispersion: Num
    """Standard deviation of its logarithm, with the shots. [ln]"""
    spread: Annotated[list[Num], Field(min_length=2, max_length=2)]
    """90 % range of S of a next shot, with the shots. [1]"""
    prior_median: Num
    """S by the law of the published tests, without the shots. [1]"""
    prior_dispersion: Num
    """[ln]"""
    prior_spread: Annotated[list[Num], Field(min_length=2, max_length=2)]
    """90 % range of S without the shots. [1]"""


class Motion(Part, Generic[Value]):
    """Quantities of a motion. Depth is positive inside the target; lateral, the way the projectile travels."""

    time_s: Annotated[Value, Described("since first contact")]
    """Since first contact. [s]"""
    center_of_gravity_depth_m: Annotated[Value, Described("depth of the centre of gravity, positive inside the target")]
    """[m]"""
    center_of_gravity_lateral_m: Annotated[
        Value, Described("way of the centre of gravity along the face since first contact")
    ]
    """Along the face, from where it was at first contact. [m]"""
    nose_tip_depth_m: Annotated[Value, Described("depth of the nose tip, positive inside the target")]
    """[m]"""
    axis_angle_deg: Annotated[
        Value, Described("from the inward normal of the face to the axis; grows as the nose turns to the face")
    ]
    """From the inward normal to the axis; grows as the nose turns toward the face. [°]"""
    depth_velocity_m_s: Annotated[Value, Described("of the centre of gravity, along the inward normal")]
    """Velocity of the centre of gravity. [m/s]"""
    lateral_velocity_m_s: Annotated[Value, Described("of the centre of gravity, along the face")]
    """Velocity of the centre of gravity. [m/s]"""
    angular_velocity_rad_s: Annotated[Value, Described("rate of the axis angle")]
    """Rate of the axis angle. [rad/s]"""
    depth_force_n: Annotated[Value, Described("resistance along the inward normal")]
    """Resistance along the inward normal. [N]"""
    lateral_force_n: Annotated[Value, Described("resistance along the face")]
    """Resistance along the face. [N]"""
    moment_n_m: Annotated[Value, Described("moment of the resistance about the centre of gravity")]
    """Resistance, about the centre of gravity. [N m]"""
    kinetic_energy_j: Annotated[Value, Described("of translation and rotation")]
    """Energy of translation and rotation. [J]"""


class MotionState(Motion[Num]):
    """The motion at one instant. Depth is positive inside the target; lateral, the way the projectile travels."""

    model_config = with_examples(STATE)


class MotionInHistory(Motion[Value], Generic[Value]):
    """Quantities of a motion that a history has, beside those of its end."""

    axial_acceleration_g: Annotated[
        Value, Described("of the centre of gravity along the axis, positive toward the nose")
    ]
    """Of the centre of gravity by the resistance, along the axis of the body; positive toward the nose, so that it is
    negative as the body is slowed. In standard gravity, 9.80665 m/s². [g₀]"""
    transverse_acceleration_g: Annotated[
        Value, Described("of the centre of gravity across the axis, positive the way the nose moves as the angle grows")
    ]
    """Of the centre of gravity by the resistance, across the axis of the body; positive the way the nose moves as
    `axis_angle_deg` grows, toward the face. By `panels`, samples scatter about the mean where the body slides straight.
    In standard gravity, 9.80665 m/s². [g₀]"""


class MotionHistory(MotionInHistory[list[Num]]):
    """The motion over time, columns of equal length: even intervals, then the instant that ended it."""

    model_config = with_examples({name: [value] for name, value in (STATE | ACCELERATIONS).items()})


class Exit(Part):
    """How a projectile leaves the target, through the impact face or the rear face."""

    model_config = with_examples(EXIT)

    speed_m_s: Annotated[Num, Described("of the centre of gravity as the projectile leaves; empty if it stays")]
    """Speed of the centre of gravity. [m/s]"""
    direction_deg: Annotated[Num, Described("of that velocity, from the outward normal of the face left through")]
    """Angle of that velocity, from the outward normal of the face left through; positive the way the projectile
    travelled along the face. [°]"""
    elevation_deg: Annotated[Num, Described("of that velocity, above that face")]
    """Angle of that velocity above that face. [°]"""
    axis_angle_deg: Annotated[Num, Described("axis angle as the projectile leaves")]
    """From the inward normal of the impact face to the axis. [°]"""
    angular_velocity_rad_s: Annotated[Num, Described("rate of the axis angle as the projectile leaves")]
    """Rate of the axis angle. [rad/s]"""
    kinetic_energy_j: Annotated[Num, Described("as the projectile leaves")]
    """Energy of translation and rotation. [J]"""
    lateral_m: Annotated[Num, Described("way of the centre of gravity along the face since first contact")]
    """Way of the centre of gravity along the face, from where it was at first contact. [m]"""
    flight: Annotated[FlightResult | MISSING, GIVEN, columns_of(FlightResult, "flight_")] = MISSING
    """Where the body lands, in the answer to a trajectory with `flight`."""


class FlightAnswer(FlightResult):
    """Where a body lands on level ground, and how far it can land at most."""

    model_config = with_examples(LANDING | VERSIONED)

    key: Key
    engine_version: EngineVersion


class Protrusion(Part):
    """How far a projectile stands out of the rear face of a wall that it does not perforate."""

    model_config = with_examples(PROTRUSION)

    final_m: Annotated[
        Num | MISSING, Described("way of the deepest point out of the rear face at the end; empty if it leaves")
    ] = MISSING
    """Way of its deepest point out of the rear face at the end of the run; absent if it leaves by the front. [m]"""
    greatest_m: Annotated[Num, Described("greatest way of the deepest point out of the rear face")]
    """Greatest way of its deepest point out of the rear face. [m]"""


class Trajectory(Part):
    """One run: how it ended, and how it went."""

    model_config = with_examples(RUN)

    outcome: Annotated[Outcome, Described("how the run ended")]
    final: Annotated[
        MotionState, columns_of(MotionState, "final_", "; at the event that ended the run"), Behind("strength_factor")
    ]
    """At the event that ended the run."""
    exit: Annotated[Exit | MISSING, columns_of(Exit, "exit_"), Behind("strength_factor")] = MISSING
    """If the projectile left."""
    maximum_depth_m: Annotated[
        Num | MISSING, Described("greatest depth of the deepest point; empty if the projectile perforates")
    ] = MISSING
    """Greatest depth of the deepest point of the projectile; absent if it perforates a wall. [m]"""
    protrusion: Annotated[Protrusion | MISSING, columns_of(Protrusion, "protrusion_")] = MISSING
    """In a wall, if anything of the projectile ever comes out of the rear face, and it does not perforate."""
    strength_factor: Annotated[Num, Described("in use, at this oblique angle")]
    """Strength factor in use, at this oblique angle. [1]"""
    strength_factor_dispersion: Annotated[StrengthDispersion, NOT_TABLED]
    own_tests: OwnTestsAnswer | MISSING = MISSING
    """If S rests on shots into the very concrete, the paper's with eq. 9 in its concrete among them."""
    history: Annotated[MotionHistory | MISSING, GIVEN] = MISSING
    """If requested."""
    warnings: list[ModelWarning]


class Alternative(Part):
    """The same case under other laws."""

    free_surface: FreeSurfaceModel
    strength_factor: StrengthLaw
    obliquity_shape: ObliquityShape
    fitted_to: str
    """What the two laws were fitted to."""
    problem: Problem | MISSING = MISSING
    """Why there is no answer under these laws."""


class TrajectoryAlternative(Alternative):
    """How the same strike ends under other laws."""

    model_config = with_examples(OTHER_OUTCOME)

    outcome: Outcome | MISSING = MISSING


class CriticalAngleAlternative(Alternative):
    """What the same search finds under other laws."""

    model_config = with_examples(OTHER_ANGLE)

    status: SearchStatus | MISSING = MISSING
    critical_angle_deg: Num | MISSING = MISSING
    """If there is one. [°]"""


class TrajectoryAnswer(Trajectory):
    """Answer to a trajectory."""

    model_config = with_examples(RUN | VERSIONED, RUN | VERSIONED | {"alternatives": [OTHER_OUTCOME]})

    alternatives: Annotated[list[TrajectoryAlternative] | MISSING, GIVEN] = MISSING
    """If wanted."""
    key: Key
    engine_version: EngineVersion


class Trial(Part):
    """One angle tried in a search."""

    model_config = with_examples(TRIAL)

    oblique_angle_deg: Annotated[Num, Described("angle tried, from the inward normal of the face to the velocity")]
    """From the normal. [°]"""
    final_position_m: Annotated[Num, Described("depth of the nose tip at the end of the trial")]
    """Depth of the nose tip at the end, or at the termination time in the paper's searches. [m]"""
    outcome: Annotated[Outcome, Described("how the trial ended")]
    fine: Annotated[
        bool, Column("fine", "whether it was computed at the final resolution, or only to see where to look", "?")
    ]
    """False for a trial that only showed where to look: it was computed more roughly."""
    exit: Annotated[Exit | MISSING, Of(lambda trial: trial.exit if trial.fine else None)] = MISSING
    """If the projectile left, of a fine trial."""


class OutcomeInterval(Part):
    """Oblique angles at which the strike has one outcome."""

    model_config = with_examples(INTERVAL)

    outcome: Outcome
    lower_deg: Num
    """From the normal. [°]"""
    upper_deg: Num
    """From the normal. [°]"""


class CriticalAngleAnswer(Part):
    """Answer to a critical angle."""

    model_config = with_examples(
        FOUND | VERSIONED, NONE_FOUND | VERSIONED, FOUND | VERSIONED | {"alternatives": [OTHER_ANGLE]}
    )

    status: Annotated[SearchStatus, Described("how the search ended")]
    critical_angle_deg: Annotated[
        Num | MISSING,
        Of("angle"),
        Described("smallest oblique angle, from the normal, at which the projectile is turned away"),
    ] = MISSING
    """Smallest oblique angle, from the normal, that ends in ricochet; if there is one. [°]"""
    critical_angle_standard_error_deg: Annotated[
        Annotated[Num, Field(ge=0.0)] | MISSING,
        Of("standard_error"),
        Described("of the angle, from the covariance of the strength factor"),
        Behind("bracket_deg"),
    ] = MISSING
    """From the covariance of the strength factor, if that was given. [°]"""
    bracket_deg: Annotated[
        Bracket | MISSING,
        Column("bracket_low_deg", "lower of the angles between which the change was last pinned down"),
        Column("bracket_high_deg", "upper of these"),
    ] = MISSING
    strength_factor: Annotated[Num | MISSING, Described("in use at the critical angle")] = MISSING
    """Strength factor in use at the critical angle, if there is one. [1]"""
    strength_factor_dispersion: Annotated[StrengthDispersion | MISSING, NOT_TABLED] = MISSING
    own_tests: OwnTestsAnswer | MISSING = MISSING
    """If S rests on shots into the very concrete, the paper's with eq. 9 in its concrete among them."""
    energy_fraction_below: Annotated[
        Annotated[Num, Field(ge=0.0)] | MISSING,
        Described("share of the kinetic energy left half a degree below the critical angle"),
    ] = MISSING
    """Share of the initial kinetic energy left half a degree below the critical angle, 0 if it is less than a tenth of
    `numerics.retention_energy_fraction`. [1]"""
    energy_fraction_above: Annotated[Annotated[Num, Field(ge=0.0)] | MISSING, Described("half a degree above it")] = (
        MISSING
    )
    """That half a degree above: the less it is, the more the threshold decides. [1]"""
    exit: Annotated[Exit | MISSING, columns_of(Exit, "exit_")] = MISSING
    """At the critical angle, if there is one."""
    iterations: list[Trial]
    """Every angle tried, in order."""
    other_crossings_deg: list[Num]
    """Other angles of the range at which the outcome changes, either way. [°]"""
    outcomes: list[OutcomeInterval] | MISSING = MISSING
    """Over the whole range in order, each end to the tolerance; for a target with a thickness in a search by
    outcome."""
    trajectory: Annotated[Trajectory | MISSING, GIVEN] = MISSING
    """At the critical angle, if requested."""
    alternatives: Annotated[list[CriticalAngleAlternative] | MISSING, GIVEN] = MISSING
    """If wanted."""
    warnings: list[ModelWarning]
    key: Key
    engine_version: EngineVersion


Columns = dict[str, FloatArray]
"""Columns of a history, by their names in the contract."""


def trajectory_answer(
    found: solver.Trajectory, flight: Mapping[str, Any] | None = None
) -> tuple[dict[str, Any], Columns | None]:
    """Return the answer without its history, and the columns of the history if there is one.

    Parameters
    ----------
    found
        The run.
    flight
        Of the body that has left, if it is wanted.
    """
    history = None if found.history is None else history_columns(MotionHistory, found.history)
    answer = walk(TrajectoryAnswer, found)
    if flight is not None:
        answer["exit"]["flight"] = flight
    return answer, history


def critical_angle_answer(
    found: solver.CriticalAngle, trajectory: solver.Trajectory | None
) -> tuple[dict[str, Any], Columns | None]:
    """Return the answer without the history of its trajectory, and the columns of that if there is one."""
    run, history = (None, None) if trajectory is None else trajectory_answer(trajectory)
    return walk(CriticalAngleAnswer, found, trajectory=run), history
