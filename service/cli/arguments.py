"""Flags, help texts and settings that several commands share."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from service.cli.errors import UsageError

if TYPE_CHECKING:
    from service.settings import Settings

URL, DATA_DIR = "RICOCHET_URL", "RICOCHET_DATA_DIR"
"""Variables that replace flags."""


class Flag(NamedTuple):
    """A flag for one number of a case.

    Parameters
    ----------
    steps
        Path of the field in the request body.
    """

    name: str
    steps: tuple[str, ...]
    help: str
    short: tuple[str, ...] = ()

    @property
    def pointer(self) -> str:
        """JSON pointer of the field."""
        return "".join(f"/{step}" for step in self.steps)


BODY = (
    Flag("--diameter", ("projectile", "diameter_m"), "shank diameter [m]"),
    Flag("--length", ("projectile", "length_m"), "length from nose tip to base [m]"),
    Flag("--mass", ("projectile", "mass_kg"), "mass [kg]"),
    Flag(
        "--caliber-radius-head",
        ("projectile", "nose", "caliber_radius_head"),
        "ogive radius over diameter [1]; other nose shapes need a file or --set",
    ),
    Flag(
        "--center-of-gravity",
        ("projectile", "center_of_gravity_m"),
        "distance behind the nose tip [m] (default: homogeneous projectile)",
    ),
    Flag(
        "--moment-of-inertia",
        ("projectile", "moment_of_inertia_kg_m2"),
        "transverse, about the centre of gravity [kg m²] (default: homogeneous projectile)",
    ),
    Flag("--compressive-strength", ("target", "compressive_strength_pa"), "strength of the concrete [Pa]"),
    Flag("--density", ("target", "density_kg_m3"), "density of the concrete [kg/m³]"),
    Flag(
        "--youngs-modulus",
        ("target", "youngs_modulus_pa"),
        "modulus of the concrete [Pa] (default: from the strength, ACI 318-19)",
    ),
    Flag("--poissons-ratio", ("target", "poissons_ratio"), "of the concrete [1] (default: 0.5)"),
)
VELOCITY = Flag("--velocity", ("impact", "velocity_m_s"), "speed at first contact [m/s]")
OBLIQUE_ANGLE = Flag(
    "--oblique-angle",
    ("impact", "oblique_angle_deg"),
    "angle from the inward normal to the velocity [°]",
    short=("--angle",),
)
ATTACK = (
    Flag("--angle-of-attack", ("impact", "angle_of_attack_deg"), "axis angle minus velocity angle [°] (default: 0)"),
    Flag("--angular-velocity", ("impact", "angular_velocity_rad_s"), "rotation of the axis [rad/s] (default: 0)"),
)
IMPACT = (VELOCITY, OBLIQUE_ANGLE, *ATTACK)


def add_case(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> None:
    """Add the inputs of one case: a file, flags for its numbers, and `--set` for any other field."""
    parser.add_argument(
        "case", nargs="?", metavar="CASE", help="TOML or JSON file with a request body; - reads JSON from a pipe"
    )
    group = add_numbers(parser, flags)
    group.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="FIELD=VALUE",
        help="set any field, such as resistance.free_surface.model=none or projectile.nose.shape=flat",
    )


def add_numbers(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> "argparse._ArgumentGroup":
    """Add the flags for the numbers of a case; return their group."""
    group = parser.add_argument_group("case", "SI units, angles in degrees from the normal; flags override the file")
    for flag in flags:
        group.add_argument(
            flag.name, *flag.short, dest="/".join(flag.steps), type=float, metavar="NUMBER", help=flag.help
        )
    return group


def add_formats(parser: argparse.ArgumentParser, *, json: str, csv: str) -> None:
    """Add `--json` and `--csv`, which exclude each other."""
    formats = parser.add_mutually_exclusive_group()
    formats.add_argument("--json", action="store_true", help=json)
    formats.add_argument("--csv", action="store_true", help=csv)


def add_plot(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--plot`."""
    parser.add_argument("--plot", type=Path, metavar="FILE", help=f"plot {what}, as .svg, .png or .pdf")


def add_alternatives(parser: argparse.ArgumentParser) -> None:
    """Add `--alternatives`."""
    parser.add_argument(
        "--alternatives",
        action="store_true",
        help="also compute the case with each decay law and strength law; with --csv print these alone",
    )


def add_url(parser: argparse.ArgumentParser, default: str = "compute locally") -> None:
    """Add `--url`."""
    parser.add_argument(
        "--url",
        default=os.environ.get(URL) or None,
        help=f"address of a service, also {URL} (default: {default}); RICOCHET_API_KEY is its API key",
    )


def add_data_dir(parser: argparse.ArgumentParser) -> None:
    """Add `--data-dir`."""
    parser.add_argument(
        "--data-dir",
        type=Path,
        default=os.environ.get(DATA_DIR) or None,
        metavar="FOLDER",
        help=f"keep locally computed results in this folder, also {DATA_DIR} (default: keep nothing)",
    )


def add_operation(parser: argparse.ArgumentParser) -> None:
    """Add `--operation`."""
    parser.add_argument(
        "--operation", choices=("cra", "trajectory"), default="cra", help="what to compute for each case (%(default)s)"
    )


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add `--output`."""
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write the results to a file, as CSV if its name ends in .csv"
    )


def add_actions(
    parser: argparse.ArgumentParser, actions: Sequence[tuple[str, str, str]]
) -> dict[str, argparse.ArgumentParser]:
    """Add the actions of a command, each with name, help and an example; return their parsers by name."""
    subparsers: Any = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    return {
        action: subparsers.add_parser(
            action,
            help=help_,
            description=f"{help_[0].upper()}{help_[1:]}.",
            formatter_class=Formatter,
            epilog=examples(example),
        )
        for action, help_, example in actions
    }


class Formatter(argparse.HelpFormatter):
    """Wraps prose, and leaves text of several lines, such as examples, as it is."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{"max_help_position": 28} | options)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)


def examples(*commands: str) -> str:
    """Return the examples at the end of a help text."""
    return "\n".join(("example:" if len(commands) == 1 else "examples:", *(f"  {command}" for command in commands)))


def read_settings(**fixed: Any) -> "Settings":
    """Return the service's settings from the environment; those given here override it.

    Raises
    ------
    UsageError
        If a setting is invalid.
    """
    from pydantic import ValidationError

    from service.settings import Settings

    try:
        return Settings(**fixed)
    except ValidationError as error:
        raise UsageError(f"invalid RICOCHET_... variable: {error}") from None
