"""Problems as the contract has them (RFC 9457), and JSON pointers into requests (RFC 6901)."""

from collections.abc import Iterable
from typing import Annotated

from pydantic import Field

from service.schemas.quantities import Part, with_examples

TAGGED = frozenset({"distribution", "nose", "strength_factor"})
"""Fields of several shapes. In a place inside one of them, pydantic names the shape after the field."""

PLACES = {"velocity": "impact.velocity", "sample_interval": "output.sample_interval"}
"""Arguments of the solver that are elsewhere in a request."""

UNITS = {
    "diameter": "m",
    "length": "m",
    "mass": "kg",
    "base_diameter": "m",
    "center_of_gravity": "m",
    "moment_of_inertia": "kg_m2",
    "compressive_strength": "pa",
    "density": "kg_m3",
    "youngs_modulus": "pa",
    "thickness": "m",
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
    "cone_angle": "deg",
    "penetration_depth": "m",
    "scabbing_thickness": "m",
    "perforation_thickness": "m",
}
"""What the contract adds to the names of the solver."""

UNITLESS = frozenset({"distribution", "weights"})
"""Parts whose numbers are named after quantities, but have no units."""


def json_pointer(steps: Iterable[str | int]) -> str:
    """Pointer of these steps."""
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)


def pointer_of_location(location: Iterable[str | int]) -> str:
    """Pointer of a location of pydantic."""
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


TOO_SHORT = {
    "pointer": "/projectile/length_m",
    "detail": "must be at least the length of the nose, 0.132665 m, got 0.1 m",
}
INVALID = {
    "type": "urn:ricochet:problem:invalid-request",
    "title": "The request does not fit the contract",
    "status": 422,
    "detail": ": ".join(TOO_SHORT.values()),
    "instance": "/cra",
    "errors": [TOO_SHORT],
}


class ProblemError(Part):
    """One thing that is wrong with the request."""

    model_config = with_examples(TOO_SHORT)

    pointer: Annotated[
        str,
        Field(
            description="JSON pointer (RFC 6901) into the request body; empty for all of it. Of a JSONL body the first "
            "step is the line, counted from 0."
        ),
    ]
    detail: Annotated[str, Field(description="What is wrong with it.")]


class Problem(Part):
    """Why there is no answer (RFC 9457)."""

    model_config = with_examples(INVALID)

    type: Annotated[str, Field(description="Stable, for programs; `about:blank` where the status says it all.")]
    title: Annotated[str, Field(description="Title of the type.")]
    status: Annotated[int, Field(ge=400, le=599, description="The HTTP status.")]
    detail: Annotated[str, Field(description="What happened in this occurrence.")]
    instance: Annotated[str, Field(description="Path of the request.")]
    errors: Annotated[list[ProblemError], Field(description="What is wrong with the request body, if anything is.")]
