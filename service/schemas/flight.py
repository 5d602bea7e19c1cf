"""Models of the flight after an exit through either face: request, answer, and flight conditions in other requests."""

from enum import StrEnum
from typing import Annotated, Any

from pydantic import MISSING, Field

import solver
from service.schemas.fields import NOT_TABLED, walk
from service.schemas.quantities import Num, Part, SolverPart, solver_arguments, with_examples, within
from solver.flight import TUMBLING_DRAG

LAUNCH = {"speed_m_s": 101.1, "elevation_deg": 19.18, "mass_kg": 13.0, "projected_area_m2": 0.032076}
LANDING = {
    "range_m": 405.8,
    "flight_time_s": 5.916,
    "impact_speed_m_s": 57.34,
    "apex_m": 43.32,
    "farthest_range_m": 514.3,
    "farthest_elevation_deg": 39.59,
    "range_without_drag_m": 1042.3,
    "drag_coefficient": 1.0,
    "projected_area_m2": 0.032076,
}
FACE = {"face_tilt_deg": 0.0, "incidence_plane": "up", "drag_coefficient": TUMBLING_DRAG, "height_m": 0.0}

DragCoefficient = Annotated[
    Num,
    Field(
        **within("flight.drag_coefficient"),
        description="Drag coefficient of the projected area: 1 for a tumbling body, 0.5 for a sphere. [1]",
    ),
]
LaunchHeight = Annotated[
    Num,
    Field(
        **within("flight.height"),
        description="Height of the launch above the level ground on which the body lands. [m]",
    ),
]


class IncidencePlane(StrEnum):
    """Direction of travel on a tilted face: up the face, level along it, or down it."""

    UP = "up"
    LEVEL = "level"
    DOWN = "down"


class FlightInput(SolverPart[solver.FlightConditions]):
    """Tilt of the face, drag and height, for the flight of a body that leaves the target."""

    model_config = with_examples(FACE)

    face_tilt_deg: Annotated[Num, Field(ge=0.0, le=90.0)] = 0.0
    """Angle between the impact face and level ground: 0 for a slab, 90 for a wall. [°]"""
    incidence_plane: IncidencePlane = IncidencePlane.UP
    """Direction of travel on a tilted face. It has no effect on level ground."""
    drag_coefficient: DragCoefficient = TUMBLING_DRAG
    height_m: LaunchHeight = 0.0


class FlightRequest(Part):
    """Launch conditions of a body that leaves the target."""

    model_config = with_examples(LAUNCH, LAUNCH | {"drag_coefficient": 0.5, "height_m": 12.0})

    speed_m_s: Annotated[Num, Field(**within("flight.speed"))]
    """Speed at launch. [m/s]"""
    elevation_deg: Annotated[Num, Field(ge=-90.0, le=90.0)]
    """Angle of the launch above the horizontal. [°]"""
    mass_kg: Annotated[Num, Field(**within("projectile.mass"))]
    projected_area_m2: Annotated[Num, Field(**within("flight.projected_area"))]
    """Area to which the drag coefficient refers. For a tumbling convex body it is a quarter of the surface area.
    [m²]"""
    drag_coefficient: DragCoefficient = TUMBLING_DRAG
    height_m: LaunchHeight = 0.0

    def canonical(self) -> dict[str, Any]:
        """Return all fields as JSON data, with defaults filled in."""
        return self.model_dump(mode="json")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `solver.flight`."""
        return solver_arguments(self)


class FlightResult(Part):
    """Landing point of a body on level ground, and the farthest landing point over all elevations."""

    model_config = with_examples(LANDING)

    range_m: Num
    """Horizontal distance from the launch to the landing. [m]"""
    flight_time_s: Annotated[Num, NOT_TABLED]
    """Time in the air. [s]"""
    impact_speed_m_s: Num
    """Speed at landing. [m/s]"""
    apex_m: Annotated[Num, NOT_TABLED]
    """Greatest height above the ground. [m]"""
    farthest_range_m: Num
    """Greatest distance over all elevations at this speed and height. [m]"""
    farthest_elevation_deg: Annotated[Num, NOT_TABLED]
    """Elevation of the farthest flight. [°]"""
    range_without_drag_m: Annotated[Num, NOT_TABLED]
    """Greatest distance over all elevations without drag. [m]"""
    drag_coefficient: Annotated[Num, NOT_TABLED]
    """Drag coefficient used. [1]"""
    projected_area_m2: Annotated[Num, NOT_TABLED]
    """Projected area used. [m²]"""


def flight_of(
    wanted: FlightInput | MISSING, projectile: solver.Projectile, found: solver.Trajectory
) -> dict[str, Any] | None:
    """Return the flight of a body after its exit; None if it is not requested or the body has not left the target."""
    if wanted is MISSING or found.exit is None:
        return None
    rear = found.outcome is solver.Outcome.PERFORATED
    landed = solver.flight_after(found.exit, projectile=projectile, conditions=wanted.to_solver(), rear=rear)
    return walk(FlightResult, landed)
