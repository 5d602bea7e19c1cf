"""The strike that a calibration is of, from flags and from a file with the body of a request."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

import solver
from service.commands.body import read_body
from service.commands.errors import CommandError
from service.commands.flags import Flag, add_numbers
from service.schemas.numerics import Method, Numerics
from service.schemas.pointers import pointer_of_location, pointer_of_parameter
from service.schemas.projectile import Projectile
from service.schemas.quantities import Part
from service.schemas.resistance import Resistance
from service.schemas.strike import Impact, Target
from solver.numerics import TERMINATION_TIME, TRAJECTORY_TOLERANCE

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
    add_numbers(parser, flags).add_argument(
        "--case", type=Path, metavar="FILE", help="TOML or JSON file with the body of a request to /trajectory"
    )


def case_arguments(asked: argparse.Namespace, model: type[DepthCase], flags: Sequence[Flag]) -> dict[str, Any]:
    """Return the arguments of the solver that flags and file give.

    Raises
    ------
    CommandError
        If there is no object in the file, or it does not fit the contract, naming the flag or the pointer.
    """
    body = read_body(asked.case, asked, flags)
    content = {name: value for name, value in body.content.items() if name not in NOT_USED}
    if "impact" not in model.model_fields:
        content.pop("impact", None)
    try:
        return model.model_validate_json(json.dumps(content)).arguments()
    except ValidationError as error:
        wrong = [(pointer_of_location(each["loc"]), each["msg"]) for each in error.errors()]
    except solver.ParameterError as error:
        wrong = [(pointer_of_parameter(error.field), error.requirement)]
    raise CommandError("\n".join(body.told(pointer, detail) for pointer, detail in wrong))
