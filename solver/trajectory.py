"""One run: integrate the motion, classify how it ended, return it as data."""

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np

from solver import advice
from solver.adaptive import STEP_LIMIT, integrate_adaptive
from solver.advice import ModelWarning
from solver.arrays import FloatArray
from solver.errors import IntegrationError, ParameterError, StepLimitError
from solver.events import End, Run
from solver.fixed_step import integrate_fixed
from solver.loads import Law, build_law, build_tables
from solver.motion import RAMP_FRACTION, STEP_WIDTH, Model, kinetic_energy, sample, sample_loads
from solver.numerics import Numerics, ResolvedNumerics
from solver.projectile import Projectile, mass_properties
from solver.resistance import Resistance, strength_factor
from solver.surface import NO_PANELS, Body, build_body, build_panels, deepest_offset
from solver.target import Target
from solver.validation import require, require_between, require_finite, require_positive

SAMPLE_INTERVAL = 1e-5
"""Of a history unless said otherwise. [s]"""
MOST_SAMPLES = 1_000_000
ENERGY_GAIN_TOLERATED = 1e-6
"""Over the initial energy; rounding of the panel route stays far below."""

Value = TypeVar("Value")


class Outcome(StrEnum):
    """How a run ended."""

    RICOCHET = "ricochet"
    EMBEDDED = "embedded"
    IN_MOTION = "in_motion"


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """The strike.

    Parameters
    ----------
    velocity
        Speed of the centre of gravity at first contact. [m/s]
    oblique_angle
        From the inward normal of the face to the velocity; 0 is normal impact. [rad]
    angle_of_attack
        Axis angle minus velocity angle, positive with the nose turned toward the face. [rad]
    angular_velocity
        Rate of the axis angle at first contact. [rad/s]

    Raises
    ------
    ParameterError
        If a value is not finite or outside its range.
    """

    velocity: float
    oblique_angle: float
    angle_of_attack: float = 0.0
    angular_velocity: float = 0.0

    def __post_init__(self) -> None:
        require_positive("impact.velocity", self.velocity)
        require(
            math.isfinite(self.oblique_angle) and abs(self.oblique_angle) < math.pi / 2.0,
            "impact.oblique_angle",
            f"must be less than 90° from the normal, got {math.degrees(self.oblique_angle):g}°",
        )
        require_between("impact.angle_of_attack", self.angle_of_attack, -math.pi / 2.0, math.pi / 2.0)
        require_finite("impact.angular_velocity", self.angular_velocity)

    @property
    def axis_angle(self) -> float:
        """From the inward normal to the axis. [rad]"""
        return self.oblique_angle + self.angle_of_attack


@dataclass(frozen=True, slots=True)
class Motion(Generic[Value]):
    """The motion at one instant (floats) or at many (arrays of equal length). Depth is positive inside the target."""

    time: Value
    """Since first contact. [s]"""
    center_of_gravity_depth: Value
    """[m]"""
    center_of_gravity_lateral: Value
    """Along the face, from its place at first contact. [m]"""
    nose_tip_depth: Value
    """[m]"""
    axis_angle: Value
    """From the inward normal; grows as the nose turns toward the face. [rad]"""
    depth_velocity: Value
    """Of the centre of gravity. [m/s]"""
    lateral_velocity: Value
    """Of the centre of gravity. [m/s]"""
    angular_velocity: Value
    """[rad/s]"""
    depth_force: Value
    """Resistance, along the inward normal. [N]"""
    lateral_force: Value
    """Resistance, along the face. [N]"""
    moment: Value
    """Resistance, about the centre of gravity. [N m]"""
    kinetic_energy: Value
    """Of translation and rotation. [J]"""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """How a run went and how it ended."""

    outcome: Outcome
    final: Motion[float]
    """At the event that ended the run."""
    history: Motion[FloatArray] | None
    """At even intervals and at that event; None if not asked for."""
    maximum_depth: float
    """Greatest depth of the nose tip. [m]"""
    strength_factor: float
    """S of this strike. [1]"""
    warnings: tuple[ModelWarning, ...]
    steps: int
    """Time steps taken."""
    evaluations: int
    """Evaluations of force and moment."""


@dataclass(frozen=True, slots=True)
class Shot:
    """All of a strike but its angle, ready for the compiled code."""

    projectile: Projectile
    target: Target
    resistance: Resistance
    numerics: ResolvedNumerics
    model: Model

    def law_at(self, impact: Impact) -> Law:
        """Resistance with the strength factor of this strike."""
        factor = strength_factor(resistance=self.resistance, oblique_angle=impact.oblique_angle, target=self.target)
        return self.model.law._replace(
            static_stress=factor * self.target.compressive_strength,
            ramp_velocity=RAMP_FRACTION * impact.velocity,
        )


def prepare(*, projectile: Projectile, target: Target, resistance: Resistance, numerics: ResolvedNumerics) -> Shot:
    """Build what every strike of these has in common."""
    properties = mass_properties(projectile)
    if numerics.method == "panels":
        require(
            numerics.fixed_steps <= 10 * STEP_LIMIT,
            "numerics.time_step",
            f"must give at most {10 * STEP_LIMIT} steps up to the termination time, got {numerics.fixed_steps}",
        )
        panels = build_panels(projectile, properties, numerics.panels)
    else:
        panels = NO_PANELS
    model = Model(
        body=build_body(projectile, properties),
        law=build_law(resistance=resistance, target=target, strength_factor=1.0, ramp_velocity=1.0),
        tables=build_tables(resistance=resistance, target=target, stations=numerics.stations, points=numerics.points),
        panels=panels,
    )
    return Shot(projectile, target, resistance, numerics, model)


def simulate(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    sample_interval: float | None = SAMPLE_INTERVAL,
) -> Trajectory:
    """Motion of a rigid projectile from first contact until it is turned away, at rest, or out of time.

    Parameters
    ----------
    projectile, target, impact
        What strikes, what is struck, and how.
    resistance
        Resistance of the target; eq. 9 and elastic-plastic decay unless given.
    numerics
        Route and resolution; adaptive unless given.
    sample_interval
        Of the history; None for no history. [s]

    Returns
    -------
    Trajectory

    Raises
    ------
    ParameterError
        If an input is outside what the model accepts.
    IntegrationError
        If the motion could not be integrated.

    Notes
    -----
    Eq. 6. A run ends when nothing is loaded any more and the projectile moves out for good (`Outcome.RICOCHET`), when
    kinetic energy is below 1e-4 of its initial value (`Outcome.EMBEDDED`) or at the termination time.
    """
    if sample_interval is not None:
        require_positive("sample_interval", sample_interval)
    shot = prepare(
        projectile=projectile,
        target=target,
        resistance=resistance or Resistance(),
        numerics=(numerics or Numerics()).resolved(),
    )
    return run_shot(shot, impact, sample_interval)


def run_shot(shot: Shot, impact: Impact, sample_interval: float | None) -> Trajectory:
    """One strike of a prepared shot."""
    model = shot.model._replace(law=shot.law_at(impact))
    run, steps = integrate(shot, model, impact, keep_steps=sample_interval is not None)
    outcome = outcome_of(run)
    return Trajectory(
        outcome=outcome,
        final=_motion_at(run, model),
        history=None if sample_interval is None else _history(run, steps, model, sample_interval),
        maximum_depth=run.maximum_tip_depth,
        strength_factor=model.law.static_stress / shot.target.compressive_strength,
        warnings=_warnings(shot, impact, run, outcome),
        steps=run.steps,
        evaluations=run.evaluations,
    )


def integrate(shot: Shot, model: Model, impact: Impact, *, keep_steps: bool) -> tuple[Run, FloatArray]:
    """Run the compiled integrator of the chosen route; return the run and its table of steps."""
    numerics, start = shot.numerics, initial_state(impact, model.body)
    end_time = numerics.termination_time
    if numerics.method == "panels":
        steps = np.empty((numerics.fixed_steps + 1 if keep_steps else 1, STEP_WIDTH))
        run = integrate_fixed(start, model, end_time, numerics.time_step, steps)
    else:
        steps = np.empty((STEP_LIMIT if keep_steps else 1, STEP_WIDTH))
        run = integrate_adaptive(start, model, end_time, numerics.relative_tolerance, steps)
    if run.end == End.STEP_LIMIT:
        raise StepLimitError(f"more than {STEP_LIMIT} steps, stopped at {run.time:g} s")
    if run.end == End.NOT_FINITE or not np.isfinite(run.state).all():
        raise IntegrationError(f"the motion is no longer finite at {run.time:g} s")
    return run, steps[: run.steps]


def initial_state(impact: Impact, body: Body) -> FloatArray:
    """State at first contact, when the deepest point of the surface touches the face."""
    return np.array(
        [
            -deepest_offset(body, impact.axis_angle),
            0.0,
            impact.axis_angle,
            impact.velocity * math.cos(impact.oblique_angle),
            impact.velocity * math.sin(impact.oblique_angle),
            impact.angular_velocity,
        ]
    )


def outcome_of(run: Run) -> Outcome:
    """How the run ended."""
    if run.end == End.EXIT:
        return Outcome.RICOCHET
    return Outcome.EMBEDDED if run.end in (End.REST, End.LODGED) else Outcome.IN_MOTION


def final_tip_depth(run: Run, body: Body, time: float) -> float:
    """Depth of the nose tip at `time`, after free flight if the projectile was turned away before. [m]"""
    flight = max(0.0, time - run.time) if run.end in (End.EXIT, End.LODGED) else 0.0
    angle = run.state[2] + run.state[5] * flight
    return float(run.state[0] + run.state[3] * flight + body.tip * math.cos(angle))


def _motion_at(run: Run, model: Model) -> Motion[float]:
    columns = _columns(np.array([run.time]), run.state[None, :], model)
    return Motion(*(float(getattr(columns, field.name)[0]) for field in fields(columns)))


def _history(run: Run, steps: FloatArray, model: Model, sample_interval: float) -> Motion[FloatArray]:
    count = math.floor(run.time / sample_interval * (1.0 + 1e-12)) + 1
    if count > MOST_SAMPLES:
        raise ParameterError("sample_interval", f"must give at most {MOST_SAMPLES} samples, got {count}")
    times: FloatArray = sample_interval * np.arange(count, dtype=np.float64)
    times = np.concatenate((times[times < run.time * (1.0 - 1e-12)], [run.time]))
    states = sample(steps, times) if len(steps) else np.repeat(run.state[None, :], times.size, axis=0)
    states[-1] = run.state
    return _columns(times, states, model)


def _columns(times: FloatArray, states: FloatArray, model: Model) -> Motion[FloatArray]:
    body = model.body
    forces = sample_loads(states, model)
    return Motion(
        time=times,
        center_of_gravity_depth=states[:, 0],
        center_of_gravity_lateral=states[:, 1],
        nose_tip_depth=states[:, 0] + body.tip * np.cos(states[:, 2]),
        axis_angle=states[:, 2],
        depth_velocity=states[:, 3],
        lateral_velocity=states[:, 4],
        angular_velocity=states[:, 5],
        depth_force=forces[:, 0],
        lateral_force=forces[:, 1],
        moment=forces[:, 2],
        kinetic_energy=np.array([kinetic_energy(state, body) for state in states]),
    )


def _warnings(shot: Shot, impact: Impact, run: Run, outcome: Outcome) -> tuple[ModelWarning, ...]:
    found = list(
        advice.input_warnings(
            projectile=shot.projectile,
            target=shot.target,
            velocity=impact.velocity,
            angle_of_attack=impact.angle_of_attack,
        )
    )
    found += advice.strength_fit_warning(resistance=shot.resistance, oblique_angle=impact.oblique_angle)
    if abs(impact.axis_angle) > math.pi / 2.0:
        found.append(advice.BASE_FIRST)
    if run.energy_gain > ENERGY_GAIN_TOLERATED:
        found.append(advice.ENERGY_GAIN)
    if outcome is Outcome.IN_MOTION:
        found.append(advice.undecided(termination_time=run.time))
    if run.end == End.LODGED:
        found.append(advice.LODGED)
    if outcome is Outcome.EMBEDDED:
        found += advice.shallow(depth=run.maximum_tip_depth, diameter=shot.projectile.diameter)
    return tuple(found)
