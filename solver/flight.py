"""Flight after a ricochet or a perforation: a point mass with quadratic drag over level ground."""

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from solver.arrays import FloatArray
from solver.checks import ParameterError, require_between, require_bounds
from solver.prepared import Exit
from solver.projectile import Projectile, solid_properties
from solver.units import shown_unit, whole_number, with_symbol

AIR_DENSITY = 1.225
"""Density of air at sea level, International Standard Atmosphere (ISO 2533:1975). [kg/m³]"""
GRAVITY = 9.80665
"""Standard gravity, 3rd CGPM (1901). [m/s²]"""
# Drag coefficients of blunt bodies are about 1; the value is a rough estimate.
TUMBLING_DRAG = 1.0
"""Default drag coefficient: that of a tumbling body, for its mean projected area. [1]"""
# With this tolerance distances are accurate to a millimetre in a kilometre, and vary with the elevation smoothly enough
# for the search for the greatest distance.
TOLERANCE = 1e-10
"""Relative tolerance of the integration. [1]"""
# The distance has zero slope at its maximum, so the relative error of the distance is of the order of the square of
# this tolerance.
ELEVATION_TOLERANCE = 1e-5
"""Tolerance of the elevation of the farthest flight. [rad]"""

IncidencePlane: TypeAlias = Literal["up", "level", "down"]
"""Direction in which the body travels along a tilted face: up, level or down."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """Flight of a body and where it lands, with the farthest landing over all elevations."""

    range: float
    """Horizontal distance from launch to landing. [m]"""
    flight_time: float
    """Time from launch to landing. [s]"""
    impact_speed: float
    """Speed at landing. [m/s]"""
    apex: float
    """Greatest height above the ground. [m]"""
    farthest_range: float
    """Greatest `range` over all elevations at this speed and height. [m]"""
    farthest_elevation: float
    """Elevation of the launch with the greatest range. [rad]"""
    range_without_drag: float
    """Greatest distance over all elevations without drag. [m]"""
    elevation: float
    """Elevation of the launch above the horizontal. [rad]"""
    drag_coefficient: float
    """Drag coefficient in use. [1]"""
    projected_area: float
    """Reference area of the drag coefficient. [m²]"""

    def __str__(self) -> str:
        return landing_sentence(self.range, self.farthest_range, self.range_without_drag)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightConditions:
    """Tilt and height of the struck face, and drag of the body, for its flight after it leaves the target.

    Parameters
    ----------
    face_tilt
        Angle between the impact face and level ground: from 0 to 90°, which is a vertical wall. [rad]
    incidence_plane
        Direction in which the body travels on the face: up, level or down. It has no effect on level ground.
    drag_coefficient
        Drag coefficient for the mean projected area; 0 for no drag. [1]
    height
        Height of the point of impact above the level ground on which the body lands. [m]

    Raises
    ------
    ParameterError
        If a value is outside its range.
    """

    face_tilt: float = 0.0
    incidence_plane: IncidencePlane = "up"
    drag_coefficient: float = TUMBLING_DRAG
    height: float = 0.0

    def __post_init__(self) -> None:
        launch_elevation(direction=0.0, face_tilt=self.face_tilt, incidence_plane=self.incidence_plane)
        require_bounds("flight.drag_coefficient", self.drag_coefficient)
        require_bounds("flight.height", self.height)


def mean_projected_area(projectile: Projectile) -> float:
    """Return the projected area of a body averaged over all directions, a quarter of its surface area. [m²]

    Notes
    -----
    Cauchy's theorem (1832) for convex bodies; the outlines of this package are convex.
    """
    base_radius = projectile.base.r_start
    return (solid_properties(projectile).surface_area + math.pi * base_radius**2) / 4.0


def launch_elevation(
    *, direction: float, face_tilt: float = 0.0, incidence_plane: IncidencePlane = "up", rear: bool = False
) -> float:
    """Return the elevation above the horizontal at which a body leaves a tilted face.

    Parameters
    ----------
    direction
        Angle of the exit velocity from the outward normal of the face through which the body leaves, as in `Exit`.
        [rad]
    face_tilt
        Angle between the impact face and level ground: from 0 to 90°, which is a vertical wall. [rad]
    incidence_plane
        Direction in which the body travels on the face: up, level or down. It has no effect on level ground.
    rear
        True if the body leaves through the rear face, whose outward normal is opposite.

    Returns
    -------
    float
        Elevation; negative below the horizontal. [rad]

    Raises
    ------
    ParameterError
        If the tilt is outside its range or the plane is unknown.
    """
    require_between("face_tilt", face_tilt, 0.0, math.pi / 2.0)
    climb = {"up": 1.0, "level": 0.0, "down": -1.0}
    if incidence_plane not in climb:
        raise ParameterError("incidence_plane", f"must be one of {', '.join(climb)}, got {incidence_plane!r}")
    # At tilt t, the vertical component of the outward normal is cos t, and that of the direction up the face is sin t.
    normal, along = math.cos(direction) * (-1.0 if rear else 1.0), math.sin(direction)
    vertical = normal * math.cos(face_tilt) + climb[incidence_plane] * along * math.sin(face_tilt)
    return math.asin(max(-1.0, min(1.0, vertical)))  # rounding may make it exceed 1


def flight(
    *,
    speed: float,
    elevation: float,
    mass: float,
    projected_area: float,
    drag_coefficient: float = TUMBLING_DRAG,
    height: float = 0.0,
) -> Flight:
    """Compute the flight of a point mass with quadratic drag, from a height above level ground.

    Parameters
    ----------
    speed
        Speed at launch. [m/s]
    elevation
        Elevation of the launch above the horizontal; negative below it. [rad]
    mass
        Mass of the body. [kg]
    projected_area
        Reference area of the drag coefficient; `mean_projected_area` for a body that tumbles. [m²]
    drag_coefficient
        Drag coefficient; 0 for no drag. [1]
    height
        Height of the launch above the ground. [m]

    Returns
    -------
    Flight

    Raises
    ------
    ParameterError
        If a value is outside its range.

    Notes
    -----
    Drag is ½ ρ c_D A v² against the velocity, in still air of 1.225 kg/m³; lift, spin and wind are left out. The
    direction in which a tumbling body leaves is the least certain input, so the farthest distance over all elevations
    is returned too.

    Examples
    --------
    >>> landed = flight(speed=101.1, elevation=math.radians(19.18), mass=13.0, projected_area=0.032076)
    >>> round(landed.range, 1), round(landed.farthest_range, 1)
    (405.8, 514.3)
    """
    require_bounds("flight.speed", speed)
    require_between("elevation", elevation, -math.pi / 2.0, math.pi / 2.0)
    require_bounds("projectile.mass", mass)
    require_bounds("flight.projected_area", projected_area)
    require_bounds("flight.drag_coefficient", drag_coefficient)
    require_bounds("flight.height", height)
    drag = 0.5 * AIR_DENSITY * drag_coefficient * projected_area / mass
    path = _path(speed, elevation, drag, height)
    farthest, highest = _farthest(speed, drag, height, elevation, path.range)
    return Flight(
        range=path.range,
        flight_time=path.time,
        impact_speed=path.speed,
        apex=path.apex,
        farthest_range=farthest,
        farthest_elevation=highest,
        range_without_drag=speed / GRAVITY * math.sqrt(speed**2 + 2.0 * GRAVITY * height),
        elevation=elevation,
        drag_coefficient=drag_coefficient,
        projected_area=projected_area,
    )


def flight_after(
    exit: Exit,  # noqa: A002 (named like `Trajectory.exit`)
    *,
    projectile: Projectile,
    conditions: FlightConditions | None = None,
    rear: bool = False,
) -> Flight:
    """Compute the flight of a tumbling body after it has left the target.

    Parameters
    ----------
    exit
        State of the body as it leaves the target: `Trajectory.exit`.
    projectile
        Body that flies; its mass and surface determine the deceleration by drag.
    conditions
        Tilt and height of the face, and drag; the defaults of `FlightConditions` unless given.
    rear
        True if the body leaves through the rear face of a wall.

    Returns
    -------
    Flight

    Examples
    --------
    >>> from solver import flight_after, simulate
    >>> from solver.strike import PAPER_PROJECTILE, PAPER_TARGET, paper_impact
    >>> impact = paper_impact(oblique_angle_degrees=60.0)
    >>> run = simulate(projectile=PAPER_PROJECTILE, target=PAPER_TARGET, impact=impact)
    >>> landed = flight_after(run.exit, projectile=PAPER_PROJECTILE)
    """
    conditions = conditions or FlightConditions()
    elevation = launch_elevation(
        direction=exit.direction,
        face_tilt=conditions.face_tilt,
        incidence_plane=conditions.incidence_plane,
        rear=rear,
    )
    return flight(
        speed=exit.speed,
        elevation=elevation,
        mass=projectile.mass,
        projected_area=mean_projected_area(projectile),
        drag_coefficient=conditions.drag_coefficient,
        height=conditions.height,
    )


def landing_sentence(distance: float, farthest: float, without_drag: float) -> str:
    """Return a sentence with three distances [m]: as computed, at any elevation, and without drag."""
    # Distances are rounded up, because a danger zone that is too large errs on the safe side.
    computed, any_elevation, no_drag = map(_rounded_up, (distance, farthest, without_drag))
    return (
        f"Lands about {computed} away if it tumbles as computed, up to {any_elevation} at any elevation, at most "
        f"{no_drag} without drag."
    )


def _rounded_up(distance: float) -> str:
    """Format a distance [m] rounded up to whole metres or feet, or to tens of them above 100."""
    shown = distance * shown_unit("m").factor
    step = 10 if shown > 100.0 else 1
    return with_symbol(whole_number(math.ceil(shown / step) * step), "m")


@dataclass(frozen=True, slots=True)
class _Path:
    """Landing of one flight, and its greatest height."""

    range: float
    """Horizontal distance. [m]"""
    time: float
    """Time of flight. [s]"""
    speed: float
    """Speed at landing. [m/s]"""
    apex: float
    """Greatest height above the ground. [m]"""


@dataclass(frozen=True, slots=True)
class _Event:
    """Event for `solve_ivp`: a component of the state falls through zero."""

    component: int
    terminal: bool
    direction: float = -1.0

    def __call__(self, _: float, state: FloatArray) -> float:
        return float(state[self.component])


def _path(speed: float, elevation: float, drag: float, height: float) -> _Path:
    """Integrate one flight to the ground; `drag` is the deceleration divided by the square of the speed. [1/m]"""
    climb = speed * math.sin(elevation)
    if height <= 0.0 and climb <= 0.0:
        return _Path(0.0, 0.0, speed, height)
    from scipy.integrate import solve_ivp  # noqa: PLC0415 (importing it takes a fifth of a second)

    def rates(_: float, state: FloatArray) -> list[float]:
        along, up = state[2], state[3]
        resistance = drag * math.hypot(along, up)
        return [along, up, -resistance * along, -resistance * up - GRAVITY]

    ground, top = _Event(1, terminal=True), _Event(3, terminal=False)
    # The equations are stiff where a light body sinks at its terminal speed; LSODA switches to an implicit method
    # there.
    found: Any = solve_ivp(  # the declared result type allows for missing events
        rates,
        (0.0, _longest(climb, drag, height)),
        [0.0, height, speed * math.cos(elevation), climb],
        method="LSODA",
        rtol=TOLERANCE,
        atol=TOLERANCE * max(height, speed**2 / GRAVITY, 1.0),
        events=(ground, top),
    )
    (time,), (landing,) = found.t_events[0], found.y_events[0]
    apex = float(found.y_events[1][0][1]) if len(found.y_events[1]) else height
    return _Path(float(landing[0]), float(time), math.hypot(landing[2], landing[3]), apex)


def _longest(climb: float, drag: float, height: float) -> float:
    """Return an upper bound on the time of flight, at which the integration ends. [s]"""
    # With drag the rise takes less time than in vacuum. The fall takes at most the sum of the time in vacuum, the time
    # at terminal speed, and a multiple of the time constant with which that speed is reached. The factor 2 is a margin.
    rise = max(climb, 0.0) / GRAVITY
    top = height + 0.5 * GRAVITY * rise**2
    fall = math.sqrt(2.0 * top / GRAVITY)
    terminal = math.inf if drag == 0.0 else math.sqrt(GRAVITY / drag)
    return 1.0 + 2.0 * (rise + fall + top / terminal + (10.0 * terminal / GRAVITY if drag else 0.0))


def _farthest(speed: float, drag: float, height: float, elevation: float, distance: float) -> tuple[float, float]:
    """Return the greatest distance over all elevations, and the elevation that gives it. [m, rad]"""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 (as above)

    # The distance has a single maximum over the elevation: at 45° from the ground without drag, lower with drag or from
    # a height. Brent's bounded minimisation finds it without derivatives.
    found = minimize_scalar(
        lambda angle: -_path(speed, float(angle), drag, height).range,
        bounds=(-math.pi / 2.0, math.pi / 2.0),
        method="bounded",
        options={"xatol": ELEVATION_TOLERANCE},
    )
    # The search ends within its tolerance of the maximum, so the flight at the given elevation may go slightly farther.
    return max((-float(found.fun), float(found.x)), (distance, elevation))
