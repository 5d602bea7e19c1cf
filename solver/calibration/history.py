"""Motion histories to fit: displacements and rotation over time, their weights, and their prediction."""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Final

import numpy as np

from solver.arrays import ComparedByFields, FloatArray
from solver.checks import ParameterError, require, require_positive
from solver.prepared import initial_state, integrate, positions_at, prepare
from solver.projectile import Projectile, mass_properties
from solver.resistance import ConstantStrengthFactor, Resistance, usual_unless_given
from solver.strike import Impact, Numerics, ResolvedNumerics
from solver.target import Target
from solver.units import Amount

QUANTITIES: Final = ("depth_displacement", "lateral_displacement", "rotation")
"""Names of the quantities of a history."""
# Measured histories may be off by some per cent, and start slightly before or after contact; in a wrong unit they are
# off by far more. Both values are arbitrary.
REACH, SLACK = 1.1, 0.1
"""Tolerances of `check_reach`: a factor on distance and rotation, and an allowance in body lengths or radians. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionHistory(ComparedByFields):
    """Motion of a projectile from first contact on; at least one of its three quantities must be given.

    Parameters
    ----------
    time
        (n,) times since first contact, increasing. [s]
    depth_displacement
        (n,) displacements of the centre of gravity along the inward normal of the face. [m]
    lateral_displacement
        (n,) displacements of the centre of gravity along the face, in the direction of travel. [m]
    rotation
        (n,) rotations of the axis, positive as the nose turns toward the face. [rad]

    Raises
    ------
    ParameterError
        If there are fewer than two rows or no quantities, if columns differ in length, if a value is not finite, or if
        times are negative or do not increase.
    """

    time: FloatArray
    depth_displacement: FloatArray | None = None
    lateral_displacement: FloatArray | None = None
    rotation: FloatArray | None = None

    def __post_init__(self) -> None:
        for each in fields(self):
            if getattr(self, each.name) is not None:
                object.__setattr__(self, each.name, _column(each.name, getattr(self, each.name)))
        rows = len(self.time)
        require(rows >= 2, "history.time", f"must hold at least 2 rows, since one leaves nothing to fit, got {rows}")
        require(bool(self.columns), "history", "must hold depth displacement, lateral displacement or rotation")
        require(self.time[0] >= 0.0, "history.time.0", f"must be at least 0, first contact, got {self.time[0]:g}")
        steps = np.diff(self.time)
        if not np.all(steps > 0.0):
            index = int(np.argmin(steps > 0.0)) + 1
            raise ParameterError(
                f"history.time.{index}",
                f"must be later than the row before, {self.time[index - 1]:g} s, got {self.time[index]:g} s",
            )
        for name, values in self.columns.items():
            require(len(values) == rows, f"history.{name}", f"must be as long as time, {rows} rows, got {len(values)}")

    @property
    def columns(self) -> dict[str, FloatArray]:
        """Quantities that are not None, by name."""
        given = {name: getattr(self, name) for name in QUANTITIES}
        return {name: values for name, values in given.items() if values is not None}

    @property
    def time_of_greatest_depth(self) -> float:
        """Time at which the centre of gravity is deepest. [s]"""
        if self.depth_displacement is None:
            raise ParameterError("history.depth_displacement", "must be given to find the time of greatest depth")
        return float(self.time[int(np.argmax(self.depth_displacement))])

    def until(self, time: float) -> "MotionHistory":
        """Return the rows up to and including `time` [s]."""
        kept = int(np.searchsorted(self.time, time, side="right"))
        return MotionHistory(time=self.time[:kept], **{name: values[:kept] for name, values in self.columns.items()})


def _column(name: str, values: FloatArray) -> FloatArray:
    """Check a column and return it as an array.

    Raises
    ------
    ParameterError
        If it is not a column of finite numbers.
    """
    column: FloatArray = np.asarray(values, dtype=np.float64)
    require(column.ndim == 1, f"history.{name}", "must be a column of numbers")
    finite = np.isfinite(column)
    if not finite.all():
        index = int(np.argmin(finite))
        raise ParameterError(f"history.{name}.{index}", f"must be a finite number, got {column[index]}")
    return column


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """Relative weights of the squared residuals, where each quantity has been divided by its span.

    Parameters
    ----------
    depth, lateral, rotation
        Weights of the depth displacement, the lateral displacement and the rotation; 0 leaves a quantity out. [1]
    """

    depth: float = 1.0
    lateral: float = 1.0
    rotation: float = 1.0

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            require(math.isfinite(value) and value >= 0.0, f"weights.{each.name}", f"must be at least 0, got {value:g}")

    def of(self, quantity: str) -> float:
        """Return the weight of one of the three quantities of a history."""
        return float(getattr(self, quantity.removesuffix("_displacement")))


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionRun:
    """Strike with its motion, to which a strength factor is fitted.

    Parameters
    ----------
    impact
        Motion of the projectile at first contact.
    history
        Motion to fit.
    weights
        Weights of the quantities; equal unless given.
    """

    impact: Impact
    history: MotionHistory
    weights: Weights = field(default_factory=Weights)


def check_reach(projectile: Projectile, impact: Impact, history: MotionHistory) -> None:
    """Check that the energy of the strike allows a motion, to detect wrong units.

    Raises
    ------
    ParameterError
        If a displacement or rotation is too large.
    """
    # No displacement can exceed the distance covered if all energy is translation, and no rotation the angle if all
    # energy is rotation.
    properties = mass_properties(projectile)
    ratio = properties.moment_of_inertia / properties.mass
    fastest = math.sqrt(impact.velocity**2 + ratio * impact.angular_velocity**2)
    length = projectile.length
    bounds = {
        "depth_displacement": REACH * fastest * history.time + SLACK * length,
        "lateral_displacement": REACH * fastest * history.time + SLACK * length,
        "rotation": REACH * fastest / math.sqrt(ratio) * history.time + SLACK,
    }
    for q, values in history.columns.items():
        bound = bounds[q]
        beyond = np.abs(values) > bound
        if beyond.any():
            row = int(np.argmax(beyond))
            most, found = (
                Amount(math.degrees(each), "°", 4) if q == "rotation" else Amount(each, "mm", 3)
                for each in (float(bound[row]), float(values[row]))
            )
            raise ParameterError(
                f"history.{q}.{row}",
                f"must be within {{}} at {history.time[row]:g} s, which is as far as the energy of the strike allows, "
                "got {}: check the units",
                most,
                found,
            )


class FittedStrike:
    """Strike that is prepared once, and whose motion can then be computed for any strength factor."""

    def __init__(
        self,
        projectile: Projectile,
        target: Target,
        impact: Impact,
        resistance: Resistance | None,
        numerics: ResolvedNumerics,
        times: FloatArray,
    ) -> None:
        self.impact, self.times = impact, times
        self.prepared = prepare(
            projectile=projectile,
            target=target,
            resistance=usual_unless_given(resistance),
            numerics=replace(numerics, termination_time=float(times[-1])),
        )

    def columns(self, strength_factor: float) -> dict[str, FloatArray]:
        """Return the three quantities at `times` for a strength factor."""
        law = replace(self.prepared.resistance, strength_factor=ConstantStrengthFactor(value=strength_factor))
        prepared = replace(self.prepared, resistance=law)
        run, steps = integrate(
            prepared, prepared.model._replace(law=prepared.law_at(self.impact)), self.impact, keep_steps=True
        )
        moved = positions_at(run, steps, self.times) - initial_state(self.impact, prepared.model.body)[:3]
        return dict(zip(QUANTITIES, moved.T, strict=True))


def predict_motion(
    *,
    projectile: Projectile,
    target: Target,
    impact: Impact,
    strength_factor: float,
    times: FloatArray,
    resistance: Resistance | None = None,
    numerics: Numerics | None = None,
) -> MotionHistory:
    """Compute the motion of a projectile at given times.

    Parameters
    ----------
    projectile, target, impact
        Projectile, concrete, and motion at first contact.
    strength_factor
        Strength factor S. [1]
    times
        (n,) two or more increasing times since first contact. [s]
    resistance
        Inertia factor and decay; its strength factor is not used.
    numerics
        Integration method and resolution; adaptive unless given. The termination time is the last of `times`.

    Returns
    -------
    MotionHistory
        Motion at the given times. After the end of the run the body stays where it came to rest, or flies freely if it
        was released.

    Raises
    ------
    ParameterError
        If an input is outside its range.
    """
    require_positive("strength_factor", strength_factor)
    sampled = MotionHistory(time=times, rotation=np.zeros(len(times))).time
    strike = FittedStrike(projectile, target, impact, resistance, (numerics or Numerics()).resolved(), sampled)
    return MotionHistory(time=sampled, **strike.columns(strength_factor))
