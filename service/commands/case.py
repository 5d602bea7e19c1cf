"""The strike that a calibration is of, from flags and from a file with the body of a request to the service."""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

import solver
from service.readers import FileError
from service.readers.text import lines_of, read_bytes
from service.schemas.numerics import Method, Numerics
from service.schemas.pointers import pointer_of_location, pointer_of_parameter
from service.schemas.projectile import Projectile
from service.schemas.quantities import Part
from service.schemas.resistance import Resistance
from service.schemas.strike import Impact, Target
from solver.numerics import TERMINATION_TIME, TRAJECTORY_TOLERANCE


class CommandError(Exception):
    """What was asked for cannot be done; the text is for people."""


@dataclass(frozen=True, slots=True)
class Flag:
    """A flag that gives one number of the case.

    Parameters
    ----------
    steps
        Where it stands in the body of a request.
    """

    name: str
    steps: tuple[str, ...]
    help: str

    @property
    def pointer(self) -> str:
        """Of its place."""
        return "".join(f"/{step}" for step in self.steps)


BODY = (
    Flag("--diameter", ("projectile", "diameter_m"), "of the shank [m]"),
    Flag("--length", ("projectile", "length_m"), "from the nose tip to the base [m]"),
    Flag("--mass", ("projectile", "mass_kg"), "[kg]"),
    Flag(
        "--caliber-radius-head",
        ("projectile", "nose", "caliber_radius_head"),
        "of an ogive, its radius over the diameter; other noses come with --case [1]",
    ),
    Flag("--center-of-gravity", ("projectile", "center_of_gravity_m"), "behind the tip; homogeneous if not given [m]"),
    Flag(
        "--moment-of-inertia",
        ("projectile", "moment_of_inertia_kg_m2"),
        "transverse, about it; homogeneous if not given [kg m²]",
    ),
    Flag("--compressive-strength", ("target", "compressive_strength_pa"), "of the concrete [Pa]"),
    Flag("--density", ("target", "density_kg_m3"), "of the concrete [kg/m³]"),
    Flag("--youngs-modulus", ("target", "youngs_modulus_pa"), "from the strength by ACI 318-19 if not given [Pa]"),
    Flag("--poissons-ratio", ("target", "poissons_ratio"), "0.5 if not given [1]"),
)
STRIKE = (
    Flag("--velocity", ("impact", "velocity_m_s"), "at first contact [m/s]"),
    Flag("--oblique-angle", ("impact", "oblique_angle_deg"), "from the normal of the face to the velocity [°]"),
    Flag("--angle-of-attack", ("impact", "angle_of_attack_deg"), "axis minus velocity; 0 if not given [°]"),
    Flag("--angular-velocity", ("impact", "angular_velocity_rad_s"), "of the axis; 0 if not given [rad/s]"),
)
NOT_USED = ("output", "search", "custom_id")
"""Of a request: what no calibration has."""


class DepthCase(Part):
    """What tests in normal impact share."""

    projectile: Projectile
    target: Target
    resistance: Annotated[Resistance, Field(default_factory=Resistance)]
    numerics: Annotated[Numerics, Field(default_factory=Numerics)]

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of the solver's fits."""
        numerics = self.numerics.resolved(
            method=Method.ADAPTIVE, termination_time_s=TERMINATION_TIME, relative_tolerance=TRAJECTORY_TOLERANCE
        )
        return {
            "projectile": self.projectile.to_solver(),
            "target": self.target.to_solver(),
            "resistance": self.resistance.to_solver(),
            "numerics": numerics.to_solver(),
        }


class MotionCase(DepthCase):
    """One strike."""

    impact: Impact

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of the solver's fits."""
        return super().arguments() | {"impact": self.impact.to_solver()}


def add_case_flags(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> None:
    """Add the flags of a case."""
    group = parser.add_argument_group("case", "SI units, angles in degrees from the normal of the face")
    group.add_argument(
        "--case",
        type=Path,
        metavar="FILE.json",
        help="the body of a request to /trajectory; flags go before what it says",
    )
    for flag in flags:
        group.add_argument(flag.name, dest="/".join(flag.steps), type=float, metavar="NUMBER", help=flag.help)


def case_arguments(asked: argparse.Namespace, model: type[DepthCase], flags: Sequence[Flag]) -> dict[str, Any]:
    """Return the arguments of the solver that flags and file give.

    Raises
    ------
    CommandError
        If they do not fit the contract, naming the flag or the pointer.
    FileError
        If the file is no JSON object.
    """
    body: dict[str, Any] = {} if asked.case is None else _read_object(asked.case)
    body = {name: value for name, value in body.items() if name not in NOT_USED}
    if "impact" not in model.model_fields:
        body.pop("impact", None)
    given = {flag.pointer for flag in flags if getattr(asked, "/".join(flag.steps)) is not None}
    for flag in flags:
        _put(body, flag, getattr(asked, "/".join(flag.steps)))
    by_pointer = {flag.pointer: flag for flag in flags}
    try:
        return model.model_validate_json(json.dumps(body)).arguments()
    except ValidationError as error:
        wrong = [(pointer_of_location(each["loc"]), each["msg"]) for each in error.errors()]
    except solver.ParameterError as error:
        wrong = [(pointer_of_parameter(error.field), error.requirement)]
    raise CommandError("\n".join(_told(asked.case, by_pointer, given, pointer, detail) for pointer, detail in wrong))


def _put(body: dict[str, Any], flag: Flag, value: float | None) -> None:
    """Put the value of a flag at its place; without one, see to it that the place can be missed."""
    place: Any = body
    for step in flag.steps[:-1]:
        place = place.setdefault(step, {}) if isinstance(place, dict) else None
    if value is not None and isinstance(place, dict):
        if flag.steps[-2] == "nose":
            place.clear()
            place["shape"] = "ogive"
        place[flag.steps[-1]] = value


def _told(case: Path | None, flags: Mapping[str, Flag], given: set[str], pointer: str, detail: str) -> str:
    if pointer == "/projectile/nose" and case is None:
        return "--caliber-radius-head is missing"
    flag = flags.get(pointer)
    if flag is not None and (pointer in given or case is None):
        return f"{flag.name}: {detail}" if pointer in given else f"{flag.name} is missing"
    return f"{case}: {pointer or '/'}: {detail}" if case is not None else f"{pointer}: {detail}"


def _read_object(path: Path) -> dict[str, Any]:
    try:
        content = json.loads("\n".join(lines_of(path, read_bytes(path))))
    except json.JSONDecodeError as error:
        raise FileError(path, f"not JSON: {error.msg}", error.lineno) from None
    except RecursionError:
        raise FileError(path, "not JSON: nested too deep") from None
    if not isinstance(content, dict):
        raise FileError(path, "must be a JSON object")
    return content
