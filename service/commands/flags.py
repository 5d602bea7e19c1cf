"""The flags that several commands share."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

URL, DATA_DIR = "RICOCHET_URL", "RICOCHET_DATA_DIR"
"""Variables that stand for flags which are not given."""


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
    short: tuple[str, ...] = ()

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
        "of an ogive, its radius over the diameter; other noses come with a file [1]",
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
VELOCITY = Flag("--velocity", ("impact", "velocity_m_s"), "at first contact [m/s]")
OBLIQUE_ANGLE = Flag(
    "--oblique-angle",
    ("impact", "oblique_angle_deg"),
    "from the normal of the face to the velocity [°]",
    short=("--angle",),
)
ATTACK = (
    Flag("--angle-of-attack", ("impact", "angle_of_attack_deg"), "axis minus velocity; 0 if not given [°]"),
    Flag("--angular-velocity", ("impact", "angular_velocity_rad_s"), "of the axis; 0 if not given [rad/s]"),
)
STRIKE = (VELOCITY, OBLIQUE_ANGLE, *ATTACK)


def add_case(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> None:
    """Add what gives one case: a file, flags for its numbers, and any of its fields by name."""
    parser.add_argument(
        "case", nargs="?", metavar="CASE", help="TOML or JSON file with the body of a request; - is JSON from a pipe"
    )
    group = add_numbers(parser, flags)
    group.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="FIELD=VALUE",
        help="any field, such as resistance.free_surface.model=none or projectile.nose.shape=flat",
    )


def add_numbers(parser: argparse.ArgumentParser, flags: Sequence[Flag]) -> "argparse._ArgumentGroup":
    """Add the flags of the numbers of a case; return their group."""
    group = parser.add_argument_group("case", "SI units, angles in degrees from the normal; flags go before the file")
    for flag in flags:
        group.add_argument(
            flag.name, *flag.short, dest="/".join(flag.steps), type=float, metavar="NUMBER", help=flag.help
        )
    return group


def add_forms(parser: argparse.ArgumentParser, *, json: str, csv: str) -> None:
    """Add the forms of an answer for programs."""
    forms = parser.add_mutually_exclusive_group()
    forms.add_argument("--json", action="store_true", help=json)
    forms.add_argument("--csv", action="store_true", help=csv)


def add_plot(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the picture."""
    parser.add_argument("--plot", type=Path, metavar="FILE", help=f"draw {what}: .svg, .png or .pdf")


def add_alternatives(parser: argparse.ArgumentParser) -> None:
    """Add the answers under other laws."""
    parser.add_argument(
        "--alternatives",
        action="store_true",
        help="also the answer under each decay law with each strength law; with --csv these alone",
    )


def add_url(parser: argparse.ArgumentParser, otherwise: str = "computed here if not given") -> None:
    """Add the address of a service."""
    parser.add_argument(
        "--url",
        default=os.environ.get(URL) or None,
        help=f"of a service, or {URL}; {otherwise}. A key for it comes from RICOCHET_API_KEY",
    )


def add_data_dir(parser: argparse.ArgumentParser) -> None:
    """Add the folder of results of what is computed here."""
    parser.add_argument(
        "--data-dir",
        type=Path,
        default=os.environ.get(DATA_DIR) or None,
        metavar="FOLDER",
        help=f"keeps the results of what is computed here, or {DATA_DIR}; nothing is kept if not given",
    )


def add_operation(parser: argparse.ArgumentParser) -> None:
    """Add what is to be computed of many cases."""
    parser.add_argument("--operation", choices=("cra", "trajectory"), default="cra", help="of every case (%(default)s)")


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add the file for the results of many cases."""
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write the results there; a table if it ends in .csv"
    )
