"""Conversion of a case for the compiled code, its integration, and the interpretation of the result.

A prepared case holds everything that strikes of one projectile on one target share, so it is built only once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.cancellation import compute
from solver.checks import IntegrationError, StepLimitError, require, require_one
from solver.loads import build_law, build_quadrature
from solver.motion import (
    RAMP_FRACTION,
    REST_FRACTION,
    STEP_WIDTH,
    Model,
    Run,
    Termination,
    Thresholds,
    make_workspace,
    sample,
    start_state,
)
from solver.projectile import Projectile, mass_properties
from solver.resistance import Resistance, strength_factor
from solver.strike import Impact, ResolvedNumerics
from solver.surface import CENTRED, NO_PANELS, Body, build_body, build_panels, deepest_offset
from solver.surface_integration import Law
from solver.target import Target
from solver.time_integration import (
    LARGEST_STEP,
    STEP_LIMIT,
    Accuracy,
    integrate_adaptive,
    integrate_fixed,
    make_linearisation,
)
from solver.units import Amount

# A thinner plate fails by bending and tearing, which the model does not include.
LEAST_THICKNESS = 0.1
"""Least thickness of a wall, relative to the diameter of the projectile. [1]"""
# Above 1e154 m/s the square of a velocity overflows. The limit is far below that, and far above any real motion.
LARGEST_STATE = 1e100
"""Position, angle or rate beyond which a run counts as diverged. [m, rad, s]"""


class Outcome(StrEnum):
    """Outcome of a run: turned away, stopped in the target, still moving in it, or through a wall."""

    RICOCHET = "ricochet"
    EMBEDDED = "embedded"
    IN_MOTION = "in_motion"
    PERFORATED = "perforated"


@dataclass(frozen=True, slots=True)
class Exit:
    """State of a projectile as it leaves the target, through the impact face or the rear face."""

    speed: float
    """Speed of the centre of gravity as the projectile leaves. [m/s]"""
    direction: float
    """Angle of the exit velocity from the outward normal of the face through which the projectile leaves; positive on
    the side toward which the impact velocity points along the face. [rad]"""
    elevation: float
    """Angle of the exit velocity above the face through which the projectile leaves. [rad]"""
    axis_angle: float
    """Angle from the inward normal of the impact face to the axis as the projectile leaves. [rad]"""
    angular_velocity: float
    """Rate of the axis angle as the projectile leaves. [rad/s]"""
    kinetic_energy: float
    """Kinetic energy of translation and rotation as the projectile leaves. [J]"""
    lateral: float
    """Distance of the centre of gravity along the face from first contact. [m]"""


def exit_of(outcome: Outcome, state: Sequence[float], body: Body) -> Exit | None:
    """Return the state in which a projectile leaves the target, given its final state; None if it stays in the target.

    Parameters
    ----------
    state
        Depth and lateral position of the centre of gravity, axis angle, and their rates. [m, rad, s]
    """
    if outcome not in (Outcome.RICOCHET, Outcome.PERFORATED):
        return None
    _, lateral, axis_angle, inward_speed, lateral_speed, spin = state
    outward = inward_speed if outcome is Outcome.PERFORATED else -inward_speed
    speed, direction = math.hypot(inward_speed, lateral_speed), math.atan2(lateral_speed, outward)
    return Exit(
        speed=speed,
        direction=direction,
        elevation=math.pi / 2.0 - abs(direction),
        axis_angle=axis_angle,
        angular_velocity=spin,
        kinetic_energy=0.5 * (body.mass * speed * speed + body.moment_of_inertia * spin * spin),
        lateral=lateral,
    )


@dataclass(frozen=True, slots=True)
class Protrusion:
    """Protrusion of a projectile from the rear face of a wall that it does not perforate."""

    final: float | None
    """Distance of the deepest point beyond the rear face at the end of the run; None if the projectile leaves through
    the impact face. [m]"""
    greatest: float
    """Greatest distance of the deepest point beyond the rear face. [m]"""


def protrusion_of(outcome: Outcome, run: Run, body: Body, thickness: float | None) -> Protrusion | None:
    """Return the protrusion in a run; None if the projectile perforates, or never extends beyond the rear face.

    Parameters
    ----------
    thickness
        Thickness of the wall; None for a half-space. [m]
    """
    if thickness is None or outcome is Outcome.PERFORATED or run.maximum_depth <= thickness:
        return None
    greatest = run.maximum_depth - thickness
    if outcome is Outcome.RICOCHET:
        return Protrusion(None, greatest)
    depth, _, axis_angle, *_ = run.state.tolist()
    return Protrusion(max(depth + deepest_offset(body, axis_angle) - thickness, 0.0), greatest)


@dataclass(frozen=True, slots=True)
class PreparedCase:
    """Strike except for its impact: projectile, target, laws and settings, converted for the compiled code."""

    projectile: Projectile
    target: Target
    resistance: Resistance
    numerics: ResolvedNumerics
    model: Model
    """Parameters of the compiled code. `law_at` replaces their strength factor of 1 and ramp velocity of 1 m/s."""

    @property
    def is_centred(self) -> bool:
        """True if no load turns the projectile, because all its normals pass through its centre of gravity."""
        return bool(self.model.body.bounds & CENTRED)

    def strength_factor_at(self, oblique_angle: float) -> float:
        """Return the strength factor of a strike at an oblique angle. [1]

        Raises
        ------
        ParameterError
            If the law gives a value that is not above zero.
        """
        return strength_factor(
            resistance=self.resistance, oblique_angle=oblique_angle, target=self.target, projectile=self.projectile
        )

    def law_at(self, impact: Impact) -> Law:
        """Return the resistance for the strength factor and ramp velocity of a strike."""
        factor = self.strength_factor_at(impact.oblique_angle)
        return self.model.law._replace(
            static_stress=float(factor * self.target.compressive_strength),
            ramp_velocity=float(RAMP_FRACTION * impact.velocity),
        )


def prepare(
    *, projectile: Projectile, target: Target, resistance: Resistance, numerics: ResolvedNumerics
) -> PreparedCase:
    """Convert a case for the compiled code.

    Raises
    ------
    ParameterError
        If projectile, target and settings do not fit together, or an argument is of the wrong type.
    """
    check_case(projectile, target)
    if target.thickness is not None:
        least = LEAST_THICKNESS * projectile.diameter
        require(
            target.thickness >= least,
            "target.thickness",
            "must be at least a tenth of the diameter, {}, got {}: a thinner plate fails by bending and tearing, which "
            "the model does not include",
            Amount(least, "mm"),
            Amount(target.thickness, "mm"),
        )
    properties = mass_properties(projectile)
    if numerics.method == "panels":
        require(
            numerics.fixed_steps <= 2 * STEP_LIMIT,
            "numerics.time_step",
            f"must give at most {2 * STEP_LIMIT} steps up to the termination time, got {numerics.fixed_steps}",
        )
        panels = build_panels(projectile, properties, numerics.panels)
    else:
        panels = NO_PANELS
    model = Model(
        body=build_body(projectile, properties),
        law=build_law(
            resistance=resistance,
            target=target,
            projectile=projectile,
            strength_factor=1.0,
            ramp_velocity=1.0,
        ),
        quadrature=build_quadrature(stations=numerics.stations, points=numerics.points),
        panels=panels,
    )
    return PreparedCase(projectile, target, resistance, numerics, model)


def check_case(projectile: Projectile, target: Target) -> None:
    """Check that the arguments are a single projectile and a single target.

    Raises
    ------
    ParameterError
        If the projectile or the target is of another type, such as a list.
    """
    require_one("projectile", projectile, Projectile)
    require_one("target", target, Target)


def integrate(
    prepared: PreparedCase, model: Model, impact: Impact, *, keep_steps: bool, thresholds: Thresholds | None = None
) -> tuple[Run, FloatArray]:
    """Integrate a strike with the method of the case; return the run and its table of steps.

    Parameters
    ----------
    model
        Model of the case with the law of the strike.
    keep_steps
        Keep every step in the table, instead of only the last one.
    thresholds
        Energies that end the run, relative to the initial energy; by default the retention energy of the case and
        `REST_FRACTION`. [1]

    Raises
    ------
    IntegrationError
        If the motion diverges or takes too many steps.
    CancelledError
        If the computation was cancelled.
    """
    numerics, start = prepared.numerics, initial_state(impact, model.body)
    end_time = float(numerics.termination_time)
    retention, rest = thresholds or (numerics.retention_energy_fraction, REST_FRACTION)
    thresholds = Thresholds(float(retention), float(rest))  # compiled code accepts no integers here

    def run_to_end(control: IntArray) -> tuple[Run, FloatArray]:
        state, work = np.empty(6), make_workspace()
        if numerics.method == "panels":
            steps = np.empty((numerics.fixed_steps + 1 if keep_steps else 1, STEP_WIDTH))
            time_step = float(numerics.time_step)
            values = integrate_fixed(start, model, end_time, thresholds, time_step, steps, state, control, work)
        else:
            steps = np.empty((STEP_LIMIT if keep_steps else 1, STEP_WIDTH))
            accuracy, linear = Accuracy(float(numerics.relative_tolerance), LARGEST_STEP), make_linearisation()
            values = integrate_adaptive(
                start, model, end_time, thresholds, accuracy, steps, state, control, work, linear
            )
        end, time, maximum_depth, count, evaluations, energy_gain = values
        return Run(end, time, state, maximum_depth, count, evaluations, energy_gain), steps

    run, steps = compute(run_to_end, model.panels.area.size)
    finite = all(abs(value) < LARGEST_STATE for value in run.state.tolist())
    check_end(run.end if finite else Termination.NOT_FINITE, run.time)
    return run, steps[: run.steps]


def initial_state(impact: Impact, body: Body) -> FloatArray:
    """Return the (6,) state at first contact, when the deepest point of the surface touches the face."""
    state = np.empty(6)
    start_state(
        body,
        float(impact.velocity),
        float(impact.oblique_angle),
        float(impact.angle_of_attack),
        float(impact.angular_velocity),
        state,
    )
    return state


OUTCOMES: dict[float, Outcome] = {
    Termination.EXIT: Outcome.RICOCHET,
    Termination.REST: Outcome.EMBEDDED,
    Termination.RETAINED: Outcome.EMBEDDED,
    Termination.TIME: Outcome.IN_MOTION,
    Termination.PERFORATED: Outcome.PERFORATED,
    Termination.TUMBLED: Outcome.IN_MOTION,
}
"""Outcome for each termination that is not a failure."""
RELEASED = (Termination.EXIT, Termination.RETAINED, Termination.PERFORATED)
"""Terminations after which the motion is continued as free flight."""


def check_end(end: float, time: float) -> None:
    """Raise an `IntegrationError` if a run ended at `time` [s] because it could not be integrated."""
    if end in OUTCOMES:
        return
    if end == Termination.STEP_LIMIT:
        raise StepLimitError(STEP_LIMIT, float(time))
    raise IntegrationError(
        f"the motion diverges at {time:g} s: it is no longer finite, or has gained as much energy as it had"
    )


def final_tip_depth(run: Run, body: Body, time: float) -> float:
    """Return the depth of the nose tip at `time` [s]; a projectile released earlier flies freely. [m]"""
    flight = max(0.0, time - run.time) if run.end in RELEASED else 0.0
    angle = run.state[2] + run.state[5] * flight
    return float(run.state[0] + run.state[3] * flight + body.tip * math.cos(angle))


def positions_at(run: Run, steps: FloatArray, times: FloatArray) -> FloatArray:
    """Return the (n, 3) depth, lateral position and axis angle at sorted `times`. [m, m, rad]

    After the end of the run the projectile flies freely if it was released; otherwise it stays in place.
    """
    inside = int(np.searchsorted(times, run.time, side="right")) if len(steps) else 0
    flight = times[inside:, None] - run.time if run.end in RELEASED else 0.0
    after = run.state[:3] + flight * np.repeat(run.state[None, 3:], times.size - inside, axis=0)
    return np.concatenate((sample(steps, times[:inside])[:, :3], after))
