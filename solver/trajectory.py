"""Motion of a single strike: integration, outcome, history, and warnings."""

import math
from dataclasses import dataclass, fields
from typing import Generic, TypeVar

import numpy as np

from solver import warnings as model_warnings
from solver.arrays import ComparedByFields, FloatArray
from solver.bending import Bending, bending_of, has_inertia_of_shape
from solver.checks import ParameterError, require_one, require_positive
from solver.display import Axes, Columns, DataFrame, Figure, Row, card, dataframe, line, plot_motion
from solver.motion import Model, Run, Termination, sample, sample_accelerations, sample_loads
from solver.plausibility import check_depth, check_energy
from solver.prepared import (
    OUTCOMES,
    Exit,
    Outcome,
    PreparedCase,
    Protrusion,
    exit_of,
    integrate,
    prepare,
    protrusion_of,
)
from solver.projectile import Projectile
from solver.resistance import Resistance, StrengthPosterior, usual_unless_given
from solver.strength_scatter import ScatterSource, known_strength
from solver.strike import USUAL, Impact, Numerics, usual_termination_time
from solver.target import Target
from solver.units import whole_number
from solver.warnings import ModelWarning

# The default is the time step of the paper.
SAMPLE_INTERVAL = 1e-5
"""Default interval of a history. [s]"""
# A history has 14 quantities of 8 bytes at each instant: 112 MB at this limit.
MOST_INSTANTS = 1_000_000
"""Largest number of instants in a history."""
# An exact solution gains no energy. Rounding errors of the panel method are far below this limit.
ENERGY_GAIN_TOLERATED = 1e-6
"""Gain of kinetic energy in one step, over the initial energy, above which a warning appears. [1]"""

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Motion(ComparedByFields, Generic[Value]):
    """Motion at one instant (floats) or at many instants (arrays of equal length)."""

    time: Value
    """Time since first contact. [s]"""
    center_of_gravity_depth: Value
    """Depth of the centre of gravity, positive inside the target. [m]"""
    center_of_gravity_lateral: Value
    """Distance of the centre of gravity along the face from first contact. [m]"""
    nose_tip_depth: Value
    """Depth of the nose tip, positive inside the target. [m]"""
    axis_angle: Value
    """Angle from the inward normal of the face to the axis; grows as the nose turns toward the face. [rad]"""
    depth_velocity: Value
    """Velocity of the centre of gravity along the inward normal. [m/s]"""
    lateral_velocity: Value
    """Velocity of the centre of gravity along the face. [m/s]"""
    angular_velocity: Value
    """Rate of the axis angle. [rad/s]"""
    depth_force: Value
    """Resistance along the inward normal. [N]"""
    lateral_force: Value
    """Resistance along the face. [N]"""
    moment: Value
    """Moment of the resistance about the centre of gravity. [N m]"""
    axial_acceleration: Value
    """Acceleration of the centre of gravity along the axis, positive toward the nose. The resistance causes it, and it
    is negative while the body slows down. [m/s²]"""
    transverse_acceleration: Value
    """Acceleration of the centre of gravity across the axis, positive in the direction in which the nose moves as the
    axis angle grows. The resistance causes it. With the method `panels`, samples scatter about the mean while the body
    moves along its axis, because the load depends on a transverse speed of some mm/s. [m/s²]"""
    kinetic_energy: Value
    """Kinetic energy of translation and rotation. [J]"""

    def columns(self) -> Columns:
        """Return the quantities as arrays by name; a single instant gives arrays of length one."""
        return {field.name: np.atleast_1d(getattr(self, field.name)) for field in fields(self)}

    def to_dataframe(self) -> DataFrame:
        """Return the quantities over time as a ``pandas.DataFrame``, with units in its `attrs`; requires pandas."""
        return dataframe(self.columns(), Motion, index="time")

    def __repr__(self) -> str:
        times = np.atleast_1d(np.asarray(self.time, float))
        if times.size != 1:
            ends = f" from {1e3 * times[0]:g} to {1e3 * times[-1]:.2f} ms" if times.size else ""
            return line(self, f"{times.size} instants{ends}")
        return line(self, *(f"{name}={values[0]:.6g}" for name, values in self.columns().items()))


@dataclass(frozen=True, slots=True, repr=False)
class Trajectory:
    """Result of `simulate`: outcome, final state and history of a run."""

    outcome: Outcome
    """Outcome of the run."""
    final: Motion[float]
    """Motion at the event that ended the run."""
    history: Motion[FloatArray] | None
    """Motion at even intervals and at the event that ended the run; None if not requested."""
    maximum_depth: float | None
    """Greatest depth of the deepest point of the projectile; None if it perforates a wall. [m]"""
    protrusion: Protrusion | None
    """Protrusion from the rear face of a wall; None if nothing protrudes, or if the projectile perforates."""
    strength_factor: float
    """Strength factor at the oblique angle of the strike. [1]"""
    warnings: tuple[ModelWarning, ...]
    """Warnings about the inputs and the run."""
    steps: int
    """Number of time steps."""
    evaluations: int
    """Number of evaluations of force and moment."""
    exit: Exit | None
    """State of the projectile as it leaves the target; None if it stays."""
    strength_factor_dispersion: float
    """Standard deviation of ln S for the next shot into the same concrete, from shots or published tests. [ln]"""
    own_tests: StrengthPosterior | None
    """Posterior of S from the shots of `OwnTests` or, with ``paper_table_1``, from those of the paper; None without
    shots."""
    bending: Bending | None
    """Largest bending stress; None if a given centre of gravity or moment of inertia is not that of the shape."""

    def row(self) -> Row:
        """Return the row of a table: outcome, depth, protrusion, bending stress, strength factor and final state.

        Values are in SI units and radians.
        """
        protrusion = self.protrusion
        return {
            "outcome": self.outcome.value,
            "maximum_depth": self.maximum_depth,
            "protrusion_final": protrusion and protrusion.final,
            "protrusion_greatest": protrusion and protrusion.greatest,
            "bending_peak_stress": self.bending and self.bending.peak_stress,
            "strength_factor": self.strength_factor,
            **{f"final_{field.name}": getattr(self.final, field.name) for field in fields(self.final)},
        }

    def columns(self) -> Columns:
        """Return the history as arrays by name, in SI units and radians.

        Raises
        ------
        ParameterError
            If the run has no history.
        """
        if self.history is None:
            raise ParameterError("sample_interval", "must be given: without a history there are no columns")
        return self.history.columns()

    def to_dataframe(self) -> DataFrame:
        """Return the history as a ``pandas.DataFrame``, with units in its `attrs`; requires pandas."""
        return dataframe(self.columns(), Motion, index="time")

    def plot(self, projectile: Projectile | None = None, *, ax: "Axes | None" = None) -> Figure:
        """Plot the side view and the histories; return the ``matplotlib.figure.Figure``.

        Parameters
        ----------
        projectile
            Projectile of the strike, whose outline is drawn; without it, only the axis from the nose tip to the centre
            of gravity is drawn.
        ax
            Axes for the side view alone; a new pyplot figure with all plots unless given.

        Raises
        ------
        ParameterError
            If there is no history.
        """
        return plot_motion(self.columns(), self._summary(), projectile, ax)

    def _summary(self) -> str:
        depth = "" if self.maximum_depth is None else f", {self.maximum_depth:.3f} m deep"
        return f"{self.outcome.replace('_', ' ')} after {1e3 * self.final.time:.2f} ms{depth}"

    def __repr__(self) -> str:
        final = f"axis at {math.degrees(self.final.axis_angle):.1f}°"
        left = "" if self.exit is None else f"leaves at {self.exit.speed:.1f} m/s"
        return line(self, self._summary(), final, left)

    def _repr_html_(self) -> str:
        exit_ = self.exit
        rows = {
            "greatest depth": "" if self.maximum_depth is None else f"{self.maximum_depth:.4g} m",
            "out of the rear face at most": "" if self.protrusion is None else f"{self.protrusion.greatest:.4g} m",
            "axis at the end": f"{math.degrees(self.final.axis_angle):.1f}° from the normal",
            "leaves at": ""
            if exit_ is None
            else f"{exit_.speed:.1f} m/s, {math.degrees(exit_.elevation):.1f}° above the face",
            "bends at": "" if self.bending is None else str(self.bending),
            "strength factor": f"{self.strength_factor:.4g}",
            "history": "none" if self.history is None else f"{self.history.time.size} instants",
        }
        return card(self._summary(), rows, self.warnings)


def simulate(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
    sample_interval: float | None = SAMPLE_INTERVAL,
    strength_scatter: ScatterSource = "law",
) -> Trajectory:
    """Compute the motion of a rigid projectile from first contact to exit, rest or termination time.

    Parameters
    ----------
    projectile, target, impact
        Projectile, concrete, and motion at first contact.
    resistance
        Resistance of the target; by default the strength factor of eq. 9 with elastic-plastic decay.
    numerics
        Integration method and resolution; adaptive unless given.
    sample_interval
        Interval of the history; None for no history. [s]
    strength_scatter
        Tests from which the dispersion of the strength factor S is taken, see `known_strength`. It does not affect the
        motion.

    Returns
    -------
    Trajectory

    Raises
    ------
    ParameterError
        If an input is outside its range.
    IntegrationError
        If the motion could not be integrated.

    Notes
    -----
    The equations of motion are eq. 6 of the source paper. The outcome is `Outcome.EMBEDDED` if the kinetic energy falls
    below ``numerics.retention_energy_fraction`` of its initial value, wherever the nose is; the run then continues
    until the body is at rest, with 1e-4 of the energy, or no longer loaded, so depths are final. The outcome is
    `Outcome.RICOCHET` if the body is released before that and leaves through the impact face, `Outcome.PERFORATED` if
    it leaves through the rear face of a wall, and `Outcome.IN_MOTION` if the termination time comes first or the axis
    has turned by more than 360° in the target.

    Examples
    --------
    >>> from solver import simulate
    >>> from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
    >>> impact = paper_impact(oblique_angle_degrees=60.0)
    >>> run = simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact)
    >>> run.outcome.value
    'ricochet'
    """
    if sample_interval is not None:
        require_positive("sample_interval", sample_interval)
    require_one("projectile", projectile, Projectile)
    require_one("impact", impact, Impact)
    numerics = numerics or USUAL
    end_time = usual_termination_time(
        length=projectile.length, velocity=impact.velocity, method=numerics.method or "adaptive"
    )
    prepared = prepare(
        projectile=projectile,
        target=target,
        resistance=usual_unless_given(resistance),
        numerics=numerics.resolved(termination_time=end_time),
    )
    return run_prepared(prepared, impact, sample_interval, strength_scatter)


def run_prepared(
    prepared: PreparedCase, impact: Impact, sample_interval: float | None, strength_scatter: ScatterSource
) -> Trajectory:
    """Run a strike of a prepared case; other arguments are as for `simulate`."""
    model = prepared.model._replace(law=prepared.law_at(impact))
    run, steps = integrate(prepared, model, impact, keep_steps=True)
    outcome = OUTCOMES[run.end]
    scatter, own_tests = known_strength(
        projectile=prepared.projectile,
        target=prepared.target,
        resistance=prepared.resistance,
        strength_scatter=strength_scatter,
    )
    bending = bending_of(prepared.projectile, model, steps, with_history=sample_interval is not None)
    warnings = run_warnings(prepared, impact, run, outcome) + _bending_warnings(prepared, bending)
    if strength_scatter == "paper_table_1":
        warnings += (model_warnings.scatter_of_table_1(prepared.projectile, prepared.target),)
    return Trajectory(
        outcome=outcome,
        final=_motion_at(run, model),
        history=None if sample_interval is None else _history(run, steps, model, sample_interval),
        maximum_depth=None if outcome is Outcome.PERFORATED else run.maximum_depth,
        protrusion=protrusion_of(outcome, run, model.body, prepared.target.thickness),
        strength_factor=model.law.static_stress / prepared.target.compressive_strength,
        warnings=warnings,
        steps=run.steps,
        evaluations=run.evaluations,
        exit=exit_of(outcome, run.state.tolist(), model.body),
        strength_factor_dispersion=scatter.dispersion,
        own_tests=own_tests,
        bending=bending,
    )


def _bending_warnings(prepared: PreparedCase, bending: Bending | None) -> tuple[ModelWarning, ...]:
    if bending is None:
        shape_is_known = has_inertia_of_shape(prepared.projectile)
        return () if shape_is_known else (model_warnings.BENDING_UNKNOWN,)
    return model_warnings.bends(
        stress=bending.peak_stress,
        time=bending.time,
        distance=bending.distance_behind_tip,
        yield_strength=prepared.projectile.yield_strength,
    )


def _motion_at(run: Run, model: Model) -> Motion[float]:
    columns = _columns(np.array([run.time]), run.state[None, :], sample_loads(run.state[None, :], model), model)
    return Motion(*(float(getattr(columns, field.name)[0]) for field in fields(columns)))


def _history(run: Run, steps: FloatArray, model: Model, sample_interval: float) -> Motion[FloatArray]:
    # The end of the run is appended as the last instant, and a sample that equals it up to rounding is dropped. The
    # factor beside 1 makes `count` independent of such rounding.
    count = math.floor(run.time / sample_interval * (1.0 + 1e-12)) + 1
    if count > MOST_INSTANTS:
        most, found = map(whole_number, (MOST_INSTANTS, count))
        raise ParameterError("sample_interval", f"must give at most {most} samples, got {found}")
    times: FloatArray = sample_interval * np.arange(count, dtype=np.float64)
    times = np.concatenate((times[times < run.time * (1.0 - 1e-12)], [run.time]))
    states = sample(steps, times) if len(steps) else np.repeat(run.state[None, :], times.size, axis=0)
    states[-1] = run.state
    # The final load is evaluated, as in `Trajectory.final`. Earlier loads follow from the slope of the interpolated
    # velocities, for the reason given in `sample_accelerations`.
    loads = sample_loads(states[-1:], model)
    if len(steps):
        inertia = np.array([model.body.mass, model.body.mass, model.body.moment_of_inertia])
        loads = np.concatenate((inertia * sample_accelerations(steps, times[:-1]), loads))
    else:
        loads = np.repeat(loads, times.size, axis=0)
    return _columns(times, states, loads, model)


def _columns(times: FloatArray, states: FloatArray, forces: FloatArray, model: Model) -> Motion[FloatArray]:
    body = model.body
    cosine, sine = np.cos(states[:, 2]), np.sin(states[:, 2])
    translation = body.mass * (states[:, 3] ** 2 + states[:, 4] ** 2)
    return Motion(
        time=times,
        center_of_gravity_depth=states[:, 0],
        center_of_gravity_lateral=states[:, 1],
        nose_tip_depth=states[:, 0] + body.tip * cosine,
        axis_angle=states[:, 2],
        depth_velocity=states[:, 3],
        lateral_velocity=states[:, 4],
        angular_velocity=states[:, 5],
        depth_force=forces[:, 0],
        lateral_force=forces[:, 1],
        moment=forces[:, 2],
        axial_acceleration=(forces[:, 0] * cosine + forces[:, 1] * sine) / body.mass,
        transverse_acceleration=(forces[:, 1] * cosine - forces[:, 0] * sine) / body.mass,
        kinetic_energy=0.5 * (translation + body.moment_of_inertia * states[:, 5] ** 2),
    )


def run_warnings(prepared: PreparedCase, impact: Impact, run: Run, outcome: Outcome) -> tuple[ModelWarning, ...]:
    """Return the warnings about the inputs and about a run."""
    found = list(
        model_warnings.input_warnings(
            projectile=prepared.projectile,
            target=prepared.target,
            velocity=impact.velocity,
            angle_of_attack=impact.angle_of_attack,
        )
    )
    found += model_warnings.law_warnings(
        projectile=prepared.projectile,
        target=prepared.target,
        resistance=prepared.resistance,
        impact=impact,
    )
    if abs(impact.axis_angle) > math.pi / 2.0:
        found.append(model_warnings.BASE_FIRST)
    if run.energy_gain > ENERGY_GAIN_TOLERATED:
        found.append(model_warnings.ENERGY_GAIN)
    if run.end == Termination.TIME:
        found.append(model_warnings.undecided(termination_time=run.time))
    turned = 0.0 if prepared.is_centred else abs(float(run.state[2]) - impact.axis_angle)
    found += model_warnings.tumbling(turned=turned, oblique_angle=impact.oblique_angle)
    left = exit_of(outcome, run.state.tolist(), prepared.model.body)
    found += check_energy(prepared, impact, outcome, left)
    found += check_depth(prepared, impact, run.maximum_depth)
    if outcome is Outcome.EMBEDDED:
        found += model_warnings.shallow(depth=run.maximum_depth, diameter=prepared.projectile.diameter)
    return tuple(found)
