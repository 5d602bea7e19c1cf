"""Where in a request body something is: JSON pointers (RFC 6901)."""

from collections.abc import Iterable

TAGGED = frozenset({"distribution", "nose", "strength_factor"})
"""Fields of several shapes. Where pydantic tells a place inside one of them, it names the shape after the field."""

PLACES = {"velocity": "impact.velocity", "sample_interval": "output.sample_interval"}
"""Arguments of the solver that are elsewhere in a request."""

UNITS = {
    "diameter": "m",
    "length": "m",
    "mass": "kg",
    "center_of_gravity": "m",
    "moment_of_inertia": "kg_m2",
    "compressive_strength": "pa",
    "density": "kg_m3",
    "youngs_modulus": "pa",
    "reference_strength": "pa",
    "reference_diameter": "m",
    "velocity": "m_s",
    "oblique_angle": "deg",
    "angle_of_attack": "deg",
    "angular_velocity": "rad_s",
    "termination_time": "s",
    "time_step": "s",
    "lower": "deg",
    "upper": "deg",
    "tolerance": "deg",
    "sample_interval": "s",
    "time": "s",
    "until": "s",
    "depth": "m",
    "depth_displacement": "m",
    "lateral_displacement": "m",
    "rotation": "deg",
}
"""What the contract adds to the names of the solver."""

UNITLESS = frozenset({"distribution", "weights"})
"""Parts whose numbers are named after quantities, but have no units."""


def json_pointer(steps: Iterable[str | int]) -> str:
    """Pointer of these steps."""
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)


def pointer_of_location(location: Iterable[str | int]) -> str:
    """Pointer of a place as pydantic tells it."""
    steps: list[str | int] = []
    in_tagged = False
    for step in location:
        if in_tagged:
            in_tagged = False
        else:
            steps.append(step)
            in_tagged = step in TAGGED
    return json_pointer(steps)


def pointer_of_parameter(field: str) -> str:
    """Pointer of an input as the solver names it, such as ``projectile.length``."""
    names = PLACES.get(field, field).split(".")
    units = {} if UNITLESS & set(names) else UNITS
    return json_pointer(f"{name}_{units[name]}" if name in units else name for name in names)
