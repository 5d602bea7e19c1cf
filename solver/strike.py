"""Parts of a strike: impact and numerical settings, access to fields by dotted names, and the paper's strike."""

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal, TypeAlias

from solver.checks import ParameterError, require, require_angle, require_between, require_bounds, require_positive
from solver.projectile import Ogive, Projectile
from solver.resistance import Resistance, usual_unless_given
from solver.target import Target

Method: TypeAlias = Literal["adaptive", "panels"]

# Usual strikes last a few milliseconds.
TERMINATION_TIME = 0.05
"""Default termination time, except for slow strikes. [s]"""
# Runs of long, slow bodies would otherwise last minutes of simulated time.
LONGEST_TERMINATION_TIME = 1.0
"""Longest default termination time. [s]"""
# Of 1,000 projectiles that are turned away, 999 leave within this time. A fixed time left large, slow ones undecided.
TRANSITS = 20.0
"""Default termination time of slow strikes, relative to the time to travel the length of the projectile. [1]"""
# With 3e-7, the work and the lost energy of a trajectory agree to 1e-6. A search only needs the angle, and uses a
# smaller tolerance where the angle is in doubt.
TRAJECTORY_TOLERANCE, SEARCH_TOLERANCE = 3e-7, 3e-4
"""Default relative tolerances of trajectories and of searches. [1]"""
# The integrands are smooth on each stretch of the outline (see `solver.surface`), so few stations suffice: with 8 and
# the tolerance of a search, the paper's angle is within 0.004° of its converged value.
TRAJECTORY_STATIONS, SEARCH_STATIONS = 12, 8
"""Default numbers of Gauss-Legendre points along a stretch of the outline, for trajectories and for searches."""
# One per cent of the energy is a tenth of the speed. Friction and rubble, which the model leaves out, decide what
# becomes of a slower body.
RETENTION_ENERGY_FRACTION = 0.01
"""Default retention energy relative to the initial kinetic energy. [1]"""
# The lower bound is the energy that counts as rest. The upper bound is arbitrary.
RETENTION_BOUNDS = (1e-4, 0.5)
"""Accepted retention energies, relative to the initial kinetic energy. [1]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """Motion of the projectile at first contact.

    Parameters
    ----------
    velocity
        Speed of the centre of gravity at first contact. Steel noses stay rigid up to about 800 m/s. [m/s]
    oblique_angle
        Angle from the inward normal of the face to the velocity: 0 is normal impact, 90° would be grazing. [rad]
    angle_of_attack
        Axis angle minus velocity angle, positive if the nose is turned toward the face. [rad]
    angular_velocity
        Rate of the axis angle, positive if the nose turns toward the face. Its bounds include every rate that a body
        survives. [rad/s]

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
        require_bounds("impact.velocity", self.velocity)
        require_angle("impact.oblique_angle", self.oblique_angle, below=True)
        require_angle("impact.angle_of_attack", self.angle_of_attack, below=False)
        require_bounds("impact.angular_velocity", self.angular_velocity)

    @property
    def axis_angle(self) -> float:
        """Angle from the inward normal of the face to the axis. [rad]"""
        return self.oblique_angle + self.angle_of_attack


@dataclass(frozen=True, slots=True, kw_only=True)
class Numerics:
    """Integration method and resolution of a run.

    Parameters
    ----------
    method
        ``"adaptive"``: Gauss points on closed-form arcs, and error-controlled steps. ``"panels"``: surface elements and
        fixed time step of the paper. The default is adaptive, or panels in the paper's searches.
    termination_time
        Time at which a run ends undecided. Unless given, it is 50 ms or, if that is longer, the time to travel 20
        lengths of the projectile, at most 1 s; with the method ``panels`` it is 50 ms, and in the paper's searches 5
        ms. [s]
    panels
        Number of surface elements of the panel method; 12,000 as in the paper unless given. [1]
    time_step
        Time step of the panel method; 0.01 ms as in the paper unless given. [s]
    relative_tolerance
        Error of one step of the adaptive method, relative to the scale of the motion. Unless given, it is 3e-7 for a
        trajectory, whose energy then balances to 1e-6; 3e-5 in a search for perforation; and 3e-4 in a search for the
        critical angle, which uses a finer level where the angle is in doubt. [1]
    stations
        Number of Gauss-Legendre points of the adaptive method along a stretch of the outline. Unless given, 12 for a
        trajectory and 8 for a search. [1]
    points
        Number of Gauss-Legendre points of the adaptive method around an arc. [1]
    retention_energy_fraction
        Share of the initial kinetic energy with which a projectile must leave to count as turned away; with less it
        is embedded, wherever its nose is. The searches ``bisection`` and ``secant`` do not use it: they decide by the
        depth of the nose tip. [1]

    Raises
    ------
    ParameterError
        If the method is unknown, or a value is outside its range.
    """

    method: Method | None = None
    termination_time: float | None = None
    # The number of panels and the time step are those of the paper.
    panels: int = 12_000
    time_step: float = 1e-5
    relative_tolerance: float | None = None
    stations: int | None = None
    points: int = 4
    retention_energy_fraction: float = RETENTION_ENERGY_FRACTION

    def __post_init__(self) -> None:
        require(self.method in (None, "adaptive", "panels"), "numerics.method", "must be 'adaptive' or 'panels'")
        if self.termination_time is not None:
            require_positive("numerics.termination_time", self.termination_time)
        # The lower bounds of stations and points are the values of the coarsest level of a search. At most 256 stations
        # are allowed because the rings of a stretch must fit into a batch, see `ROOM` in `solver.surface_integration`.
        # The other bounds are arbitrary, and far from the defaults.
        require_between("numerics.panels", self.panels, 100, 1_000_000)
        require_positive("numerics.time_step", self.time_step)
        if self.relative_tolerance is not None:
            require_between("numerics.relative_tolerance", self.relative_tolerance, 1e-10, 1e-2)
        if self.stations is not None:
            require_between("numerics.stations", self.stations, 2, 256)
        require_between("numerics.points", self.points, 2, 256)
        require_between("numerics.retention_energy_fraction", self.retention_energy_fraction, *RETENTION_BOUNDS)

    def resolved(
        self,
        *,
        method: Method = "adaptive",
        termination_time: float = TERMINATION_TIME,
        relative_tolerance: float = TRAJECTORY_TOLERANCE,
        stations: int = TRAJECTORY_STATIONS,
    ) -> "ResolvedNumerics":
        """Return the settings, with defaults for the values that were not given."""
        return ResolvedNumerics(
            method=self.method or method,
            termination_time=termination_time if self.termination_time is None else self.termination_time,
            panels=self.panels,
            time_step=self.time_step,
            relative_tolerance=relative_tolerance if self.relative_tolerance is None else self.relative_tolerance,
            stations=stations if self.stations is None else self.stations,
            points=self.points,
            retention_energy_fraction=self.retention_energy_fraction,
        )


def usual_termination_time(*, length: float, velocity: float, method: Method = "adaptive") -> float:
    """Return the default termination time for a projectile with a given length [m] and velocity [m/s]. [s]"""
    if method == "panels":
        return TERMINATION_TIME
    return min(max(TERMINATION_TIME, TRANSITS * length / velocity), LONGEST_TERMINATION_TIME)


USUAL = Numerics()
"""Default numerical settings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolvedNumerics:
    """Numerical settings with all defaults filled in; the fields are those of `Numerics`."""

    method: Method
    termination_time: float
    panels: int
    time_step: float
    relative_tolerance: float
    stations: int
    points: int
    retention_energy_fraction: float

    @property
    def fixed_steps(self) -> int:
        """Number of steps of the panel method up to the termination time."""
        return math.ceil(self.termination_time / self.time_step)


def is_part(value: Any) -> bool:
    """Return whether a value is an instance of a dataclass."""
    return is_dataclass(value) and not isinstance(value, type)


def strike_parts(
    impact: Impact,
    projectile: Projectile,
    target: Target,
    resistance: Resistance | None,
    numerics: Numerics | None,
) -> dict[str, Any]:
    """Return the parts of a strike by name, with defaults for resistance and numerics."""
    return {
        "projectile": projectile,
        "target": target,
        "impact": impact,
        "resistance": usual_unless_given(resistance),
        "numerics": numerics or USUAL,
    }


def named_values(parts: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the parts, their fields, and the fields of nested objects, each with its dotted name."""
    for name, part in parts.items():
        yield f"{before}{name}", part
        if is_part(part):
            inside = {field.name: getattr(part, field.name) for field in fields(part)}
            yield from named_values(inside, f"{before}{name}.")


def full_name(parts: Mapping[str, Any], field: str, where: str, *others: str) -> str:
    """Return the full dotted name of a field, which may be given by its last part.

    Parameters
    ----------
    parts
        Parts of the strike, as `strike_parts` returns them.
    field
        Dotted name of a field, or its last part.
    where
        Name of the argument, for the error.
    others
        Other accepted names.

    Raises
    ------
    ParameterError
        If no field has this name, or several fields have it.
    """
    known = [*(name for name, _ in named_values(parts) if "." in name), *others]
    found = [field] if field in known else [name for name in known if name.endswith(f".{field}")]
    if len(found) == 1:
        return found[0]
    what = f"may be {' or '.join(found)}" if found else f"is unknown; expected {', '.join(known)}"
    raise ParameterError(where, f"{field!r} {what}")


def short_names(names: Sequence[str], taken: Container[str]) -> list[str]:
    """Return the last part of each dotted name, or the whole name where that part is ambiguous or in `taken`."""
    last = [name.rpartition(".")[2] for name in names]
    return [
        short if last.count(short) == 1 and short not in taken else name
        for short, name in zip(last, names, strict=True)
    ]


def label(value: Any) -> Any:
    """Return a value for a table: numbers and strings as they are, "none" for None, other objects by name or repr."""
    if isinstance(value, float | int | str):
        return value
    return "none" if value is None else getattr(value, "name", repr(value))


def put(part: Any, path: Sequence[str], value: Any) -> Any:
    """Return a copy of a dataclass with the nested field at `path` replaced by a value."""
    name, *rest = path
    return replace(part, **{name: put(getattr(part, name), rest, value) if rest else value})


PAPER_PROJECTILE = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
PAPER_TARGET = Target(compressive_strength=39e6, density=2250.0)
PAPER_VELOCITY = 238.0
"""Speed of the paper's strike at first contact. [m/s]"""


def paper_impact(*, oblique_angle_degrees: float) -> Impact:
    """Return the impact of the paper's strike at an oblique angle in degrees from the normal."""
    return Impact(velocity=PAPER_VELOCITY, oblique_angle=math.radians(oblique_angle_degrees))
